//! Requested settings of a pair of real cameras: names, modes, controls, timestamps. Nothing here opens a device.
//!
//! A setup defines the settings and a camera driver receives them, so that neither depends on the other.

mod exposure;
mod layout;
mod names;
mod pixels;
mod skew;
mod timing;

use std::time::Duration;

use pb3dp_geometry::{ImageSize, StereoRig};

pub use exposure::{CommonExposure, SharedExposure, TooBlurred};
pub use layout::{Crop, DeviceLayout, ImageLayout, LayoutError, UnknownLayout};
pub use names::{CameraName, CameraNameError};
pub use pb3dp_geometry::{ValueRange, WrongRange};
pub use pixels::{BayerOrder, PixelFormat, UnknownFormat};
pub use skew::SkewCost;
pub use timing::{StampModel, StampSource, nanos};

/// Frame interval in seconds, as a fraction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Interval {
    /// Seconds, times `denominator`.
    pub numerator: u32,
    /// See `numerator`.
    pub denominator: u32,
}

impl Interval {
    /// The interval in seconds; `None` for an invalid fraction.
    pub fn seconds(self) -> Option<f64> {
        let is_fraction = self.numerator > 0 && self.denominator > 0;
        is_fraction.then(|| f64::from(self.numerator) / f64::from(self.denominator))
    }

    /// Images per second; `None` for an invalid fraction.
    pub fn per_second(self) -> Option<f64> {
        self.seconds().map(|seconds| 1.0 / seconds)
    }
}

/// The requested mode of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModeRequest {
    /// Pixel format.
    pub format: PixelFormat,
    /// Size of the images of one view, before they are cropped.
    pub size: ImageSize,
    /// Frame interval.
    pub interval: Interval,
    /// Input of a device with several inputs, in the driver's numbering.
    pub input: Option<u32>,
    /// Television standard, for devices that have one (`V4L2_STD_*`).
    pub standard: Option<u64>,
    /// Accepts interlaced images, in which moving objects are torn because even and odd lines are exposed one after the other.
    pub takes_interlaced: bool,
}

/// The requested setting of one property.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Setting<T> {
    /// The value is kept, without automatic control.
    #[default]
    Keep,
    /// This value.
    Manual(T),
    /// Automatic control by the camera.
    Auto,
}

/// Requested controls of one camera. The default keeps all values and disables every automatic mode.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ControlSettings {
    /// Exposure time.
    pub exposure: Setting<Duration>,
    /// Gain, in units of the driver.
    pub gain: Setting<i32>,
    /// White balance, kelvin.
    pub white_balance: Setting<i32>,
    /// Focus, in units of the driver.
    pub focus: Setting<i32>,
    /// Additional controls by their numbers, set last and in this order.
    pub others: Vec<(u32, i32)>,
}

/// One camera of the two.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraConfig {
    /// Name of the device.
    pub name: CameraName,
    /// Requested mode.
    pub mode: ModeRequest,
    /// Exposure, gain, white balance, focus.
    pub controls: ControlSettings,
    /// Exposure time if the camera does not report it; the value reported by the camera takes precedence.
    pub exposure: Option<Duration>,
    /// Timestamp model.
    pub stamps: StampModel,
    /// The part of the view that is used; `None`: all of it.
    pub crop: Option<Crop>,
}

impl CameraConfig {
    /// The part of the view that is used.
    pub fn crop(&self) -> Crop {
        self.crop.unwrap_or_else(|| Crop::whole(self.mode.size))
    }
}

/// Both cameras, and the limits for pairs.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoConfig {
    /// Whether each view has a device of its own. If one device has both, `left` describes it, and of `right` only `crop` is used.
    pub layout: DeviceLayout,
    /// The values that become black and white in formats with more than 8 bits; `None`: all values of the format.
    pub range: Option<ValueRange>,
    /// Left.
    pub left: CameraConfig,
    /// Right.
    pub right: CameraConfig,
    /// Maximum time between the exposures of a pair; pairs above it are refused.
    pub skew_max: Duration,
    /// The motion for which messages state the cost of a skew.
    pub skew_cost: SkewCost,
    /// One exposure for both cameras that the program controls; `None`: each camera has that of its controls.
    pub shared_exposure: Option<SharedExposure>,
}

impl StereoConfig {
    /// Uses a calibration for the cost of a skew, and for the longest exposure.
    ///
    /// # Errors
    /// If the shortest exposure blurs more than is allowed.
    pub fn calibrate(&mut self, rig: &StereoRig) -> Result<(), TooBlurred> {
        self.skew_cost.baseline_m = Some(rig.baseline_m());
        let speed_m_per_s = self.skew_cost.speed_m_per_s;
        self.shared_exposure.as_mut().map_or(Ok(()), |shared| shared.limit_blur(rig, speed_m_per_s))
    }

    /// Size of the images of a pair.
    pub fn size(&self) -> ImageSize {
        self.left.crop().size
    }

    /// The values that become black and white; `None` for formats with 8 bits.
    pub fn value_range(&self) -> Option<ValueRange> {
        let of_format = self.left.mode.format.full_range()?;
        Some(self.range.unwrap_or(of_format))
    }
}

/// The limit for cameras on a moving hand. At 100 mm/s the target moves by 0.5 mm meanwhile: a depth error of 2.5 mm at 500 mm with a
/// baseline of 100 mm.
pub const SKEW_MAX: Duration = Duration::from_millis(5);
