//! Selection of the cameras of a command: from a setup or from the command line.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_camera_settings::{
    CameraConfig, CameraName, ControlSettings, ModeRequest, PixelFormat, Setting, StampModel, StereoConfig,
};
use pb3dp_cell::calibration_facts::CalibrationFacts;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::{ImageSize, StereoRig};
use pb3dp_record::calibration_files::{StereoCalibration, load_stereo};
use pb3dp_setup::layers::SetupArgs;
use pb3dp_setup::region_spec::RegionSpec;
use pb3dp_setup::setup::{interval, read_cameras};

use crate::commands::rig::numbers::{millis, number, size};

/// Default speed of the target for the effect of skew, m/s.
const SPEED_M_PER_S: f64 = 0.1;

/// Origin of the settings: the setup.
const OF_NO_SETUP: [&str; 8] = ["left", "right", "calib", "format", "size", "rate", "exposure", "skew_max"];

/// The cameras of a command.
#[derive(Debug, Args)]
pub(in crate::commands) struct CameraChoice {
    /// A setup with these cameras: a file or a built-in one; may be repeated, later ones override. Replaces all other camera
    /// options.
    #[arg(long, value_name = "FILE|NAME", conflicts_with_all = OF_NO_SETUP)]
    config: Vec<PathBuf>,
    /// Set one key of the setup.
    #[arg(long, value_name = "KEY=VALUE", requires = "config")]
    set: Vec<String>,
    /// The left camera: bus:PLACE, serial:NUMBER (as `pb3dp cameras list` shows them) or /dev/videoN.
    #[arg(long, value_name = "NAME", requires = "right")]
    left: Option<CameraName>,
    /// The right camera, in the same form.
    #[arg(long, value_name = "NAME", requires = "left")]
    right: Option<CameraName>,
    /// Calibration of both cameras, in any format that `pb3dp estimate` reads.
    #[arg(long, value_name = "FILE[,FILE]", value_delimiter = ',')]
    pub(in crate::commands) calib: Vec<PathBuf>,
    /// Pixel format: YUYV, MJPG, GREY, RGB3, BGR3, RGGB, GRBG, GBRG or BA81.
    #[arg(long, value_name = "FOURCC", default_value = "YUYV", requires = "left")]
    format: PixelFormat,
    /// Image size; default: that of the calibration, or 640x480.
    #[arg(long, value_name = "WxH", value_parser = size, requires = "left")]
    size: Option<ImageSize>,
    /// Images per second.
    #[arg(long, value_name = "HZ", value_parser = number("images per second", 0.1..=1000.0), default_value = "30", requires = "left", allow_negative_numbers = true)]
    rate: f64,
    /// Exposure time, ms; default: unchanged.
    #[arg(long, value_name = "MS", value_parser = millis(0.05..=1000.0), requires = "left", allow_negative_numbers = true)]
    exposure: Option<f64>,
    /// Largest time between the two exposures of a pair, ms; other pairs are refused.
    #[arg(long, value_name = "MS", value_parser = millis(0.01..=1000.0), default_value = "5", requires = "left", allow_negative_numbers = true)]
    skew_max: f64,
}

/// The selected cameras.
#[derive(Clone, Debug)]
pub(in crate::commands) struct Chosen {
    pub(in crate::commands) config: StereoConfig,
    /// The calibration, if there is one.
    pub(in crate::commands) rig: Option<StereoRig>,
    /// What its file states about itself.
    pub(in crate::commands) calibration: Option<CalibrationFacts>,
    /// Target settings of the setup.
    pub(in crate::commands) target: ChosenTarget,
}

/// Target settings of a setup; empty without a setup.
#[derive(Clone, Debug, Default)]
pub(in crate::commands) struct ChosenTarget {
    /// Region in the first left image.
    pub(in crate::commands) region: Option<RegionSpec>,
    /// Search range.
    pub(in crate::commands) range: Option<SearchRange>,
}

impl CameraChoice {
    fn setup(&self) -> Option<SetupArgs> {
        let setup = SetupArgs { configs: self.config.clone(), set: self.set.clone(), ..SetupArgs::default() };
        (!setup.configs.is_empty()).then_some(setup)
    }

    /// The cameras with all settings, and their calibration.
    ///
    /// # Errors
    /// If no cameras are named, or a file cannot be used.
    pub(in crate::commands) fn chosen(&self) -> Result<Chosen> {
        match self.setup() {
            Some(setup) => of_setup(&setup, true),
            None => self.typed(),
        }
    }

    /// As [`Self::chosen`], but the calibration of a setup need not exist yet: the cameras are shown without it, with a warning.
    ///
    /// # Errors
    /// As [`Self::chosen`].
    pub(in crate::commands) fn to_show(&self) -> Result<Chosen> {
        match self.setup() {
            Some(setup) => of_setup(&setup, false),
            None => self.typed(),
        }
    }

    /// The cameras of the command line.
    fn typed(&self) -> Result<Chosen> {
        let (Some(left), Some(right)) = (&self.left, &self.right) else {
            bail!(
                "no cameras are named: give --config FILE (as configs/rig.toml), or --left NAME --right NAME; `pb3dp cameras list` shows the \
                 names"
            );
        };
        let loaded = match self.calib.as_slice() {
            [] => None,
            files => Some(load_stereo(files).context("--calib")?),
        };
        let rig = loaded.as_ref().map(|loaded| loaded.rig);
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
        Ok(Chosen { config, rig, calibration: loaded.as_ref().map(facts), target: ChosenTarget::default() })
    }
}

/// The cameras of a setup.
fn of_setup(setup: &SetupArgs, needs_calibration: bool) -> Result<Chosen> {
    let (cameras, range) = read_cameras(setup)?;
    let loaded = match cameras.calibration() {
        Ok(loaded) => Some(loaded),
        Err(error) if needs_calibration => return Err(error),
        Err(error) => {
            tracing::warn!("the cameras are shown without a calibration: {error:#}");
            None
        }
    };
    let target = ChosenTarget { region: cameras.region, range: Some(range) };
    let (rig, calibration) = (loaded.as_ref().map(|loaded| loaded.rig), loaded.as_ref().map(facts));
    Ok(Chosen { config: cameras.stereo, rig, calibration, target })
}

fn facts(loaded: &StereoCalibration) -> CalibrationFacts {
    CalibrationFacts::of("camera", &loaded.source, loaded.judgement.as_ref())
}

/// Refuses a calibration for images of another size.
///
/// # Errors
/// See above.
pub(in crate::commands) fn check_size(rig: &StereoRig, images: ImageSize) -> Result<()> {
    let calibrated = rig.left().size();
    if calibrated != images {
        bail!(
            "the images have {}x{} pixels, the calibration {}x{}: ask the cameras for its size, or calibrate for this one",
            images.width,
            images.height,
            calibrated.width,
            calibrated.height
        );
    }
    Ok(())
}
