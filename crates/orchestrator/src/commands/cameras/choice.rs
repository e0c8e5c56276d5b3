//! Which cameras a command uses: those of a configuration, or those named on the command line.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_camera_v4l2::controls::{ControlSettings, Setting};
use pb3dp_camera_v4l2::modes::ModeRequest;
use pb3dp_camera_v4l2::names::CameraName;
use pb3dp_camera_v4l2::pixels::PixelFormat;
use pb3dp_camera_v4l2::timing::StampModel;
use pb3dp_camera_v4l2::video::Interval;
use pb3dp_camera_v4l2::{CameraConfig, StereoConfig};
use pb3dp_geometry::{ImageSize, StereoRig};
use pb3dp_record::calibration_files::load_stereo;

use crate::commands::rig::numbers::{millis, number, size};

/// Speed of the target for which messages tell what a skew costs, where no setup says another one, m/s.
const SPEED_M_PER_S: f64 = 0.1;

/// Where the cameras come from.
#[derive(Debug, Args)]
pub(super) struct CameraChoice {
    /// The left camera: bus:PLACE, serial:NUMBER (as `pb3dp cameras list` shows them) or /dev/videoN.
    #[arg(long, value_name = "NAME", requires = "right")]
    left: Option<CameraName>,
    /// The right camera.
    #[arg(long, value_name = "NAME", requires = "left")]
    right: Option<CameraName>,
    /// Calibration of both, in any format that `pb3dp estimate` reads.
    #[arg(long, value_name = "FILE[,FILE]", value_delimiter = ',', requires = "left")]
    calib: Vec<PathBuf>,
    /// Layout of the pixels: YUYV, MJPG, GREY, RGB3, BGR3, RGGB, GRBG, GBRG or BA81.
    #[arg(long, value_name = "FOURCC", value_parser = format, default_value = "YUYV", requires = "left")]
    format: PixelFormat,
    /// Size of the pictures; without it that of the calibration, or 640x480.
    #[arg(long, value_name = "WxH", value_parser = size, requires = "left")]
    size: Option<ImageSize>,
    /// Pictures per second.
    #[arg(long, value_name = "HZ", value_parser = number("pictures per second", 0.1..=1000.0), default_value = "30", requires = "left")]
    rate: f64,
    /// Time of exposure, ms; without it as it is set in the cameras.
    #[arg(long, value_name = "MS", value_parser = millis(0.05..=1000.0), requires = "left")]
    exposure: Option<f64>,
    /// Refuse pairs whose exposures are further apart, ms.
    #[arg(long, value_name = "MS", value_parser = millis(0.01..=1000.0), default_value = "5", requires = "left")]
    skew_max: f64,
}

/// What was chosen.
#[derive(Clone, Debug)]
pub(super) struct Chosen {
    pub(super) config: StereoConfig,
    /// The calibration, if there is one.
    pub(super) rig: Option<StereoRig>,
}

impl CameraChoice {
    /// The cameras with all that is asked of them, and their calibration.
    ///
    /// # Errors
    /// If no cameras are named, or a file can not be used.
    pub(super) fn chosen(&self) -> Result<Chosen> {
        let (Some(left), Some(right)) = (&self.left, &self.right) else {
            bail!("no cameras are named: give --left NAME --right NAME; `pb3dp cameras list` shows the names");
        };
        let rig = match self.calib.as_slice() {
            [] => None,
            files => Some(load_stereo(files).context("--calib")?.rig),
        };
        let calibrated = rig.as_ref().map(|rig| rig.left().size());
        let size = self.size.or(calibrated).unwrap_or(ImageSize { width: 640, height: 480 });
        if let Some(rig) = &rig {
            check_size(rig, size).context("--size")?;
        }
        let mode = ModeRequest {
            format: self.format,
            size,
            interval: interval(self.rate),
            input: None,
            standard: None,
            takes_interlaced: false,
        };
        let exposure = self.exposure.map_or(Setting::Keep, |ms| Setting::Manual(Duration::from_secs_f64(ms * 1e-3)));
        let camera = |name: &CameraName| CameraConfig {
            name: name.clone(),
            mode,
            controls: ControlSettings { exposure, ..ControlSettings::default() },
            exposure: None,
            stamps: StampModel::default(),
        };
        let config = StereoConfig {
            left: camera(left),
            right: camera(right),
            skew_max: Duration::from_secs_f64(self.skew_max * 1e-3),
            speed_max_m_per_s: SPEED_M_PER_S,
        };
        Ok(Chosen { config, rig })
    }
}

/// A calibration of another size than the pictures have is refused.
///
/// # Errors
/// See above.
pub(super) fn check_size(rig: &StereoRig, pictures: ImageSize) -> Result<()> {
    let calibrated = rig.left().size();
    if calibrated != pictures {
        bail!(
            "the pictures have {}x{} pixels, the calibration {}x{}: ask the cameras for its size, or calibrate for this one",
            pictures.width,
            pictures.height,
            calibrated.width,
            calibrated.height
        );
    }
    Ok(())
}

fn format(text: &str) -> Result<PixelFormat, String> {
    let fourcc = <[u8; 4]>::try_from(text.as_bytes()).ok();
    fourcc.and_then(PixelFormat::of_fourcc).ok_or_else(|| {
        let all: Vec<String> = PixelFormat::ALL.iter().map(ToString::to_string).collect();
        format!("{text:?} is not taken; write one of: {}", all.join(", "))
    })
}

/// The time from picture to picture as drivers have it: the rates of television are a thousandth below whole ones.
fn interval(rate_hz: f64) -> Interval {
    let whole = (rate_hz * 1.001).round();
    let is_television = (rate_hz - rate_hz.round()).abs() > 1e-3 && (rate_hz - whole / 1.001).abs() < 5e-3;
    if is_television {
        Interval { numerator: 1001, denominator: (whole * 1000.0) as u32 }
    } else if (rate_hz - rate_hz.round()).abs() <= 1e-3 {
        Interval { numerator: 1, denominator: rate_hz.round() as u32 }
    } else {
        Interval { numerator: 1000, denominator: (rate_hz * 1000.0).round() as u32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_become_the_fractions_of_drivers() {
        for (rate_hz, expected) in
            [(30.0, (1, 30)), (29.97, (1001, 30_000)), (59.94, (1001, 60_000)), (7.5, (1000, 7500)), (0.5, (1000, 500))]
        {
            let Interval { numerator, denominator } = interval(rate_hz);
            assert_eq!((numerator, denominator), expected, "{rate_hz}");
        }
    }

    #[test]
    fn formats_are_those_that_can_be_converted() {
        assert_eq!(format("MJPG"), Ok(PixelFormat::Mjpg));
        for bad in ["", "H264", "yuyv", "MJPEG"] {
            assert!(format(bad).unwrap_err().contains("write one of: YUYV"), "{bad}");
        }
    }
}
