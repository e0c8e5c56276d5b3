//! What a pair of real cameras is asked for: names, modes, controls, stamps. Nothing here opens a device.
//!
//! A setup says it, a camera driver is told it; so neither has to know the other.

mod names;
mod pixels;
mod timing;

use std::time::Duration;

use pb3dp_geometry::ImageSize;

pub use names::{CameraName, CameraNameError};
pub use pixels::{BayerOrder, PixelFormat, UnknownFormat};
pub use timing::{StampModel, StampSource, nanos};

/// Seconds from image to image, as a fraction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Interval {
    /// Seconds, times `denominator`.
    pub numerator: u32,
    /// See there.
    pub denominator: u32,
}

impl Interval {
    /// The interval in seconds; `None` for a fraction that is none.
    pub fn seconds(self) -> Option<f64> {
        let is_fraction = self.numerator > 0 && self.denominator > 0;
        is_fraction.then(|| f64::from(self.numerator) / f64::from(self.denominator))
    }

    /// Images per second; `None` for a fraction that is none.
    pub fn per_second(self) -> Option<f64> {
        self.seconds().map(|seconds| 1.0 / seconds)
    }
}

/// What is asked of a camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModeRequest {
    /// Layout of the pixels.
    pub format: PixelFormat,
    /// Size of images.
    pub size: ImageSize,
    /// Time from image to image.
    pub interval: Interval,
    /// Connector of a device with several, in the driver's numbering.
    pub input: Option<u32>,
    /// Television standard of a device that has such (`V4L2_STD_*`).
    pub standard: Option<u64>,
    /// Takes images whose even and odd lines were exposed one after the other, which tears what moves.
    pub takes_interlaced: bool,
}

/// What is wished of one property.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Setting<T> {
    /// Not by the camera; the value stays as it is.
    #[default]
    Keep,
    /// That value.
    Manual(T),
    /// By the camera itself.
    Auto,
}

/// Wishes for one camera. The default keeps all values and switches every automatic mode off.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ControlSettings {
    /// Time of exposure.
    pub exposure: Setting<Duration>,
    /// Gain, in units of the driver's own.
    pub gain: Setting<i32>,
    /// White balance, kelvin.
    pub white_balance: Setting<i32>,
    /// Focus, in units of the driver's own.
    pub focus: Setting<i32>,
    /// Further controls by their numbers, set last and in this order.
    pub others: Vec<(u32, i32)>,
}

/// One camera of the two.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraConfig {
    /// Which device.
    pub name: CameraName,
    /// What is asked of it.
    pub mode: ModeRequest,
    /// Exposure, gain, white balance, focus.
    pub controls: ControlSettings,
    /// Time of exposure where the camera does not tell it; the camera's own word counts more.
    pub exposure: Option<Duration>,
    /// What its stamps mean besides.
    pub stamps: StampModel,
}

/// Both, and what holds for pairs.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoConfig {
    /// Left.
    pub left: CameraConfig,
    /// Right.
    pub right: CameraConfig,
    /// Pairs whose exposures are further apart are refused.
    pub skew_max: Duration,
    /// Speed of the target against the cameras for which messages tell what a skew costs, metres per second.
    pub speed_max_m_per_s: f64,
}

/// The limit for cameras of a moving hand: 0.5 mm at 100 mm/s.
pub const SKEW_MAX: Duration = Duration::from_millis(5);
