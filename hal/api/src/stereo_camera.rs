//! The stereo camera trait and its data.

use std::time::Duration;

use image::RgbImage;
use pb3dp_geometry::{ImageSize, MonotonicTime};

/// A stereo pair.
#[derive(Clone, Debug)]
pub struct FramePair {
    /// Counts pairs from 0; a gap means that pairs were lost before they reached this backend.
    pub sequence: u64,
    /// Middle of the left image's exposure on the program's monotonic clock.
    pub exposed_at: MonotonicTime,
    /// Middle of the right exposure minus middle of the left exposure, nanoseconds.
    pub skew_nanos: i64,
    /// Left image: sRGB, 8 bits, row-major, as recorded (not undistorted).
    pub left: RgbImage,
    /// Right image.
    pub right: RgbImage,
    /// Left and right image as the camera delivered them; empty if it delivers RGB, or if the images above were changed since.
    pub delivered: [DeliveredImage; 2],
    /// Exposure of both images, if the program controls it.
    pub exposure: Option<PairExposure>,
}

impl FramePair {
    /// As [`Self::skew_nanos`], seconds.
    pub fn skew_s(&self) -> f64 {
        self.skew_nanos as f64 * 1e-9
    }
}

/// What the cameras are used for: it decides how an exposure that the program controls may change.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FollowedTarget {
    /// No target: the exposure may change at once.
    #[default]
    Nothing,
    /// A target whose depth is known with confidence: slow changes.
    Confident,
    /// A target whose pose is not confident, or which is lost: no change for a while, then slow ones.
    Doubtful,
}

/// Exposure time and gain that both cameras were asked for, of cameras whose exposure the program adapts to the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairExposure {
    /// Exposure time.
    pub time: Duration,
    /// Gain, in units of the driver; `None` if the program does not change it.
    pub gain: Option<i32>,
    /// Number of changes since the cameras were opened. The first pair with another number announces a change.
    pub changes: u64,
    /// Factor of the newest change on the exposure time; 1 if only the gain was changed, whose effect on the images is not known.
    pub factor: f64,
    /// The newest change is so recent that one or both images may still have the exposure before it.
    pub is_settling: bool,
}

/// An image as a camera delivers it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeliveredImage {
    /// Name of its encoding in ROS 2 (`sensor_msgs/image_encodings.hpp`), or `jpeg` for a whole JPEG file; empty for none.
    pub encoding: &'static str,
    /// The file, or the rows without padding.
    pub bytes: Vec<u8>,
}

impl DeliveredImage {
    /// Encoding of a JPEG file.
    pub const JPEG: &str = "jpeg";

    /// The JPEG file, if it is one.
    pub fn jpeg(&self) -> Option<&[u8]> {
        (self.encoding == Self::JPEG).then_some(&*self.bytes)
    }

    /// Removes the image; its memory stays.
    pub fn clear(&mut self) {
        self.encoding = "";
        self.bytes.clear();
    }
}

impl FramePair {
    /// A buffer for [`StereoCamera::next_pair_into`], black, of the given size.
    pub fn black(size: ImageSize) -> Self {
        Self {
            sequence: 0,
            exposed_at: MonotonicTime::ZERO,
            skew_nanos: 0,
            left: RgbImage::new(size.width, size.height),
            right: RgbImage::new(size.width, size.height),
            delivered: Default::default(),
            exposure: None,
        }
    }

    /// Removes the delivered images, which are no longer those of the pair.
    pub fn clear_delivered(&mut self) {
        self.delivered.iter_mut().for_each(DeliveredImage::clear);
    }
}

/// Stream parameters of a camera, as read back from the device after negotiation.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoCameraInfo {
    /// Name for messages: `replay /data/run7`, `v4l2 usb-1.2 + usb-1.3`.
    pub name: String,
    /// Size of both images.
    pub size: ImageSize,
    /// Time between pairs; `None` if it is not fixed.
    pub period: Option<Duration>,
}

/// The kind of a camera error: policies decide by it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CameraErrorKind {
    /// No pair arrived in time; the next call may succeed.
    Timeout,
    /// One pair is damaged or missing and was skipped; the next call continues after it.
    BadPair,
    /// A recording has ended; every further call reports this again.
    EndOfStream,
    /// The device is gone; it must be reopened.
    Disconnected,
    /// The device, file or configuration cannot be used at all.
    Unusable,
}

/// A camera error: its kind, a sentence that names the device and the value, and the cause.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct CameraError {
    kind: CameraErrorKind,
    message: String,
    #[source]
    source: Option<Box<dyn std::error::Error + Send + Sync>>,
}

impl CameraError {
    /// An error without an underlying cause.
    pub fn new(kind: CameraErrorKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into(), source: None }
    }

    /// An error with its underlying cause.
    pub fn caused_by(
        kind: CameraErrorKind,
        message: impl Into<String>,
        source: impl Into<Box<dyn std::error::Error + Send + Sync>>,
    ) -> Self {
        Self { kind, message: message.into(), source: Some(source.into()) }
    }

    /// The kind: policies decide by it.
    pub fn kind(&self) -> CameraErrorKind {
        self.kind
    }

    /// The error with its causes, in one line.
    pub fn with_causes(&self) -> String {
        let mut text = self.to_string();
        let mut cause = std::error::Error::source(self);
        while let Some(error) = cause {
            text = format!("{text}: {error}");
            cause = error.source();
        }
        text
    }
}

/// A calibrated pair of cameras that delivers images.
///
/// # For backend authors
/// * `next_pair_into` blocks until a pair that was not yet delivered is complete, or `timeout` (on the backend's own clock) has
///   passed, whichever is first; it never blocks for longer than twice `timeout`.
/// * A delivered pair is complete, of the size that `info` states, and newer than every pair before: `sequence` and `exposed_at`
///   both increase strictly. Stale or damaged images are an error, never delivered as new.
/// * After an error `pair` may contain anything; its fields must not be used.
/// * After `Timeout` or `BadPair` the next call continues. After `EndOfStream` or `Disconnected` every call returns the same kind
///   until the backend is created again.
/// * A backend of recordings or simulations may ignore `timeout`; it then never waits.
pub trait StereoCamera: Send {
    /// Stream parameters of this camera.
    fn info(&self) -> &StereoCameraInfo;

    /// Fills `pair` with the next stereo pair, re-using its buffers.
    ///
    /// # Errors
    /// See [`CameraErrorKind`].
    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError>;

    /// For a camera that makes its images, in simulated time: waits for the end of the next exposure and keeps what it shows, so that
    /// the next [`Self::next_pair_into`] delivers this pair whenever it is called, from any thread. Returns the middle of the exposure.
    /// `None` for other cameras, and where the exposure fails: then `next_pair_into` waits as without this call, or says what failed.
    fn expose(&mut self, _timeout: Duration) -> Option<MonotonicTime> {
        None
    }

    /// The next pair in newly allocated buffers.
    ///
    /// # Errors
    /// As [`Self::next_pair_into`].
    fn next_pair(&mut self, timeout: Duration) -> Result<FramePair, CameraError> {
        let mut pair = FramePair::black(self.info().size);
        self.next_pair_into(&mut pair, timeout)?;
        Ok(pair)
    }
}
