//! Stereo camera backend that replays recorded pairs.
//!
//! [`Recording::open`] opens sequence folders, cases (one pair), MCAP files, EuRoC folders and plain folders of images, which
//! `docs/recordings.md` describes; [`ReplayCamera`] plays them. It plays at maximum speed, in the original timing on an injected clock, or step
//! by step; once or endlessly. A pair with an image that is missing, damaged or of another size gives one error of kind `BadPair`
//! that names the file; the next call continues after it.
//!
//! Images are delivered as they were recorded, not undistorted or rectified.

mod bag;
mod euroc;
mod folder;
mod pacing;
mod recording;
mod source;

use std::path::Path;
use std::time::Duration;

use pb3dp_geometry::{ImageSize, MonotonicTime, StereoRig};
use pb3dp_hal_api::{CameraError, CameraErrorKind, FramePair, StereoCamera, StereoCameraInfo};
use pb3dp_record::calibration_files::StereoCalibration;
use pb3dp_record::images::{ImageFileError, StoredImage, check_size};
use pb3dp_record::value_range::ValueRange;

use bag::BagImages;
pub use pacing::{Pacing, Stepper};
pub use recording::{Recording, RecordingOptions};
pub use source::Layout;
use source::{Place, Source};

/// Behaviour after the last pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repeat {
    /// The stream ends.
    Once,
    /// The recording starts again; sequence numbers and times keep increasing.
    Forever,
}

/// Replay options.
#[derive(Clone, Debug)]
pub struct ReplayOptions {
    /// Delivery timing.
    pub pacing: Pacing,
    /// Behaviour after the last pair.
    pub repeat: Repeat,
    /// Time between pairs if the recording has no times (plain folders), and between the last and the first pair of a recording
    /// with a single pair.
    pub period: Duration,
}

impl Default for ReplayOptions {
    /// As fast as possible, once, 30 pairs per second.
    fn default() -> Self {
        Self { pacing: Pacing::Unpaced, repeat: Repeat::Once, period: Duration::from_nanos(33_333_333) }
    }
}

/// Replays recorded pairs.
#[derive(Debug)]
pub struct ReplayCamera {
    info: StereoCameraInfo,
    calibration: StereoCalibration,
    source: Source,
    /// The images of pairs that are in an MCAP recording.
    bag: Option<BagImages>,
    range: Option<ValueRange>,
    pacing: Pacing,
    repeat: Repeat,
    /// Number of pairs delivered, damaged or passed over, over all rounds.
    position: u64,
    notes: Vec<String>,
    /// Time of the first pair on the clock of `exposed_at`; set by the first call.
    started_at: Option<MonotonicTime>,
}

impl ReplayCamera {
    fn new(
        folder: &Path,
        source: Source,
        calibration: StereoCalibration,
        options: ReplayOptions,
    ) -> Result<Self, CameraError> {
        if options.period.is_zero() {
            let message = format!("cannot replay {}: the period is zero; it must be longer", folder.display());
            return Err(CameraError::new(CameraErrorKind::Unusable, message));
        }
        let info = StereoCameraInfo {
            name: format!("replay {}", folder.display()),
            size: calibration.rig.left().size(),
            period: source.period(),
        };
        let ReplayOptions { pacing, repeat, .. } = options;
        Ok(Self {
            info,
            calibration,
            source,
            bag: None,
            range: None,
            notes: Vec::new(),
            pacing,
            repeat,
            position: 0,
            started_at: None,
        })
    }

    /// The two cameras and the pose between them.
    pub fn rig(&self) -> &StereoRig {
        &self.calibration.rig
    }

    /// The calibration with its source.
    pub fn calibration(&self) -> &StereoCalibration {
        &self.calibration
    }

    /// Number of pairs in the recording, good or bad.
    pub fn pairs(&self) -> u64 {
        self.source.pairs()
    }

    /// Passes over the pairs that are followed by another due pair, if the timing is that of a real camera.
    fn skip_missed(&mut self) {
        let (Pacing::Live(clock), Some(started_at)) = (&self.pacing, self.started_at) else { return };
        let now = clock.now();
        let has_next = |position| self.repeat == Repeat::Forever || position + 1 < self.source.pairs();
        while has_next(self.position) && started_at + self.source.since_start(self.position + 1) <= now {
            self.position += 1;
        }
    }

    /// Waits until the pair at `position` is due and returns its exposure time.
    fn wait(&mut self, timeout: Duration) -> Result<MonotonicTime, CameraError> {
        let since_start = self.source.since_start(self.position);
        match &self.pacing {
            Pacing::Unpaced => Ok(self.source.first_at() + since_start),
            Pacing::Stepped(stepper) => match stepper.take(timeout) {
                true => Ok(self.source.first_at() + since_start),
                false => Err(self.timed_out(timeout)),
            },
            Pacing::Original(clock) | Pacing::Live(clock) => {
                let now = clock.now();
                let due = *self.started_at.get_or_insert(now) + since_start;
                let deadline = now + timeout;
                clock.sleep_until(due.min(deadline));
                if due <= deadline { Ok(due) } else { Err(self.timed_out(timeout)) }
            }
        }
    }

    fn timed_out(&self, timeout: Duration) -> CameraError {
        let message = format!("{}: pair {} is not due within {timeout:?}", self.info.name, self.position);
        CameraError::new(CameraErrorKind::Timeout, message)
    }

    fn bad_pair(&self, error: ImageFileError) -> CameraError {
        let message = format!("{}: pair {} is skipped: {}", self.info.name, self.position, error.file.display());
        CameraError::caused_by(CameraErrorKind::BadPair, message, error)
    }

    /// Loads the images of the pair at the present position.
    fn load_into(&mut self, pair: &mut FramePair) -> Result<(), CameraError> {
        let number = self.position % self.source.pairs();
        let (images, notes) = match &self.source.pair(self.position).place {
            Place::Files(left, right) => {
                let loaded =
                    [left, right].map(|file| StoredImage::load(file).and_then(|image| self.checked(file, image)));
                let [left, right] = loaded.map(|image| image.map_err(|e| self.bad_pair(e)));
                let (images, note) = StoredImage::to_rgb_pair([left?, right?], &mut self.range);
                (images, Vec::from_iter(note))
            }
            Place::Both(file, layout) => {
                let both = StoredImage::load(file).and_then(|both| self.halves(file, both, *layout));
                let (images, note) = StoredImage::to_rgb_pair(both.map_err(|e| self.bad_pair(e))?, &mut self.range);
                (images, Vec::from_iter(note))
            }
            Place::Bag => {
                let bag = self.bag.as_mut().ok_or_else(|| {
                    CameraError::new(CameraErrorKind::Unusable, "replay: bug: a recording without its file, report it")
                })?;
                bag.images(number).map_err(|error| {
                    let message = format!("{}: pair {number} is skipped", self.info.name);
                    CameraError::caused_by(CameraErrorKind::BadPair, message, error)
                })?
            }
        };
        for (image, buffer) in images.into_iter().zip([&mut pair.left, &mut pair.right]) {
            let (found, size) = ((image.width(), image.height()), (self.info.size.width, self.info.size.height));
            if found != size {
                let message = format!(
                    "{}: pair {number} is skipped: an image has {}x{} pixels, but {} has {}x{}; use the calibration of this size",
                    self.info.name, found.0, found.1, self.calibration.source, size.0, size.1
                );
                return Err(CameraError::new(CameraErrorKind::BadPair, message));
            }
            // Its memory stays where it is.
            if buffer.dimensions() == found {
                buffer.copy_from_slice(&image);
            } else {
                *buffer = image;
            }
        }
        self.notes.extend(notes);
        Ok(())
    }

    fn checked(&self, file: &Path, image: StoredImage) -> Result<StoredImage, ImageFileError> {
        check_size(file, image.size(), (self.info.size, &self.calibration.source))?;
        Ok(image)
    }

    /// Both views of an image.
    fn halves(&self, file: &Path, both: StoredImage, layout: Layout) -> Result<[StoredImage; 2], ImageFileError> {
        let ImageSize { width, height } = self.info.size;
        let (whole, second) = match layout {
            Layout::SideBySide => (ImageSize { width: 2 * width, height }, [width, 0]),
            Layout::TopBottom => (ImageSize { width, height: 2 * height }, [0, height]),
        };
        let because_of = format!("a pair of {}", self.calibration.source);
        check_size(file, both.size(), (whole, &because_of))?;
        Ok([[0, 0], second].map(|[x, y]| both.part((x, y), self.info.size)))
    }

    /// Continues with the pair of this number, from 0.
    pub fn skip_to(&mut self, number: u64) {
        self.position = number;
    }

    /// What the user should know since the last call.
    pub fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }
}

impl StereoCamera for ReplayCamera {
    fn info(&self) -> &StereoCameraInfo {
        &self.info
    }

    fn next_pair_into(&mut self, pair: &mut FramePair, timeout: Duration) -> Result<(), CameraError> {
        if self.repeat == Repeat::Once && self.position >= self.source.pairs() {
            let message = format!("{}: all {} pairs have been played", self.info.name, self.source.pairs());
            return Err(CameraError::new(CameraErrorKind::EndOfStream, message));
        }
        self.skip_missed();
        let exposed_at = self.wait(timeout)?;
        let (sequence, skew_nanos) = (self.position, self.source.pair(self.position).skew_nanos);
        let loaded = self.load_into(pair);
        // This pair is consumed, even if it is bad: the next call continues after it.
        self.position += 1;
        loaded?;
        pair.sequence = sequence;
        pair.exposed_at = exposed_at;
        pair.skew_nanos = skew_nanos;
        pair.clear_jpegs();
        Ok(())
    }
}

fn unusable(folder: &Path, error: pb3dp_record::dataset::DatasetError) -> CameraError {
    CameraError::caused_by(CameraErrorKind::Unusable, format!("cannot replay {}", folder.display()), error)
}
