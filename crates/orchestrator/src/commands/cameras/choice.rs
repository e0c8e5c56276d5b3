//! Selection of the cameras of a command: from a setup or from the command line.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use pb3dp_camera_settings::{
    CameraConfig, CameraName, ControlSettings, Crop, DeviceLayout, ModeRequest, PixelFormat, Setting, SkewCost,
    StampModel, StereoConfig, ValueRange,
};
use pb3dp_cell::calibration_facts::CalibrationFacts;
use pb3dp_cell::calibration_share::term_or_warning;
use pb3dp_estimation::calibration_term::CalibrationTerm;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::{ImageSize, StereoRig};
use pb3dp_record::calibration_files::{StatedCalibration, StereoCalibration, load_stated};
use pb3dp_setup::layers::SetupArgs;
use pb3dp_setup::region_spec::RegionSpec;
use pb3dp_setup::setup::{interval, read_cameras};

use crate::numbers::{millis, number, size};

/// Origin of the settings: the setup.
const OF_NO_SETUP: [&str; 13] = [
    "left",
    "right",
    "both",
    "views",
    "crop_left",
    "crop_right",
    "values",
    "calib",
    "format",
    "size",
    "rate",
    "exposure",
    "skew_max",
];

/// The group of the options that name cameras.
const NAMED: &str = "named_cameras";

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
    #[arg(long, value_name = "NAME", requires = "right", group = NAMED)]
    left: Option<CameraName>,
    /// The right camera, in the same form.
    #[arg(long, value_name = "NAME", requires = NAMED)]
    right: Option<CameraName>,
    /// One device whose images have both views, in the same form.
    #[arg(long, value_name = "NAME", requires = "views", conflicts_with_all = ["left", "right"], group = NAMED)]
    both: Option<CameraName>,
    /// Arrangement of both views in the images of --both.
    #[arg(long, value_name = "LAYOUT", value_parser = one_device(), requires = "both")]
    views: Option<DeviceLayout>,
    /// The part of the left view that is used, px: left, top, width, height; default: all of it.
    #[arg(long, value_name = "L,T,W,H", requires = NAMED)]
    crop_left: Option<Crop>,
    /// The part of the right view that is used, px; as wide and high as that of the left view.
    #[arg(long, value_name = "L,T,W,H", requires = NAMED)]
    crop_right: Option<Crop>,
    /// Values that become black and white in Y10, Y12 and Y16, such as 0,4095; default: all values of the format.
    #[arg(long, value_name = "LOW,HIGH", requires = NAMED)]
    values: Option<ValueRange>,
    /// Calibration of both cameras, in any format that `pb3dp estimate` reads.
    #[arg(long, value_name = "FILE[,FILE]", value_delimiter = ',')]
    pub(in crate::commands) calib: Vec<PathBuf>,
    /// Pixel format: YUYV, NV12, MJPG, GREY, Y10, Y12, Y16, Y8I, RGB3, BGR3, RGGB, GRBG, GBRG or BA81.
    #[arg(long, value_name = "FOURCC", default_value = "YUYV", requires = NAMED)]
    format: PixelFormat,
    /// Size of one view; default: that of the calibration, or 640x480.
    #[arg(long, value_name = "WxH", value_parser = size, requires = NAMED)]
    size: Option<ImageSize>,
    /// Images per second.
    #[arg(long, value_name = "HZ", value_parser = number("images per second", 0.1..=1000.0), default_value = "30", requires = NAMED, allow_negative_numbers = true)]
    rate: f64,
    /// Exposure time, ms; default: unchanged.
    #[arg(long, value_name = "MS", value_parser = millis(0.05..=1000.0), requires = NAMED, allow_negative_numbers = true)]
    exposure: Option<f64>,
    /// Largest time between the two exposures of a pair, ms; other pairs are refused.
    #[arg(long, value_name = "MS", value_parser = millis(0.01..=1000.0), default_value = "5", requires = NAMED, allow_negative_numbers = true)]
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
    /// Its errors, if its file states them.
    pub(in crate::commands) calibration_term: Option<CalibrationTerm>,
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

    /// The cameras with all settings, and their calibration, with what the user states about --calib.
    ///
    /// # Errors
    /// If no cameras are named, or a file cannot be used.
    pub(in crate::commands) fn chosen(&self, stated: &StatedCalibration) -> Result<Chosen> {
        self.of_any(stated, true)
    }

    /// As [`Self::chosen`]; but the calibration of a setup need not exist yet: the cameras are shown without it, with a warning.
    ///
    /// # Errors
    /// As [`Self::chosen`].
    pub(in crate::commands) fn to_show(&self, stated: &StatedCalibration) -> Result<Chosen> {
        self.of_any(stated, false)
    }

    fn of_any(&self, stated: &StatedCalibration, needs_calibration: bool) -> Result<Chosen> {
        if self.calib.is_empty() && *stated != StatedCalibration::default() {
            bail!(
                "--calib-unit, --calib-size, --calib-lens and --rectified have no effect: they are about the file of --calib; leave them out"
            );
        }
        match self.setup() {
            Some(setup) => of_setup(&setup, needs_calibration),
            None => self.typed(stated),
        }
    }

    /// The cameras of the command line.
    fn typed(&self, stated: &StatedCalibration) -> Result<Chosen> {
        let (layout, left, right) = self.devices()?;
        let loaded = match self.calib.as_slice() {
            [] => None,
            files => {
                Some(load_stated(files, self.size, stated).and_then(StereoCalibration::decided).context("--calib")?)
            }
        };
        warn_of(loaded.as_ref());
        let rig = loaded.as_ref().map(|loaded| loaded.rig);
        let calibrated = rig.as_ref().map(|rig| rig.left().size());
        let size = self.size.or(calibrated).unwrap_or(ImageSize { width: 640, height: 480 });
        if self.values.is_some() && self.format.full_range().is_none() {
            bail!("--values: only Y10, Y12 and Y16 have more than 8 bits, {} has not; leave it out", self.format);
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
        let camera = |name: &CameraName, crop: Option<Crop>| CameraConfig {
            name: name.clone(),
            mode,
            controls: ControlSettings { exposure, ..ControlSettings::default() },
            exposure: None,
            stamps: StampModel::default(),
            crop,
        };
        let mut config = StereoConfig {
            layout,
            range: self.values,
            left: camera(left, self.crop_left),
            right: camera(right, self.crop_right),
            skew_max: Duration::from_secs_f64(self.skew_max * 1e-3),
            skew_cost: SkewCost::OF_NO_SETUP,
            shared_exposure: None,
        };
        if let Some(rig) = &rig {
            config.calibrate(rig)?;
            check_size(rig, config.size()).context("--size")?;
        }
        Ok(Chosen {
            config,
            rig,
            calibration: loaded.as_ref().map(facts),
            calibration_term: loaded.as_ref().and_then(term_or_warning),
            target: ChosenTarget::default(),
        })
    }

    /// The layout, and the device of the left and of the right view.
    ///
    /// # Errors
    /// If no cameras are named.
    fn devices(&self) -> Result<(DeviceLayout, &CameraName, &CameraName)> {
        match (&self.left, &self.right, &self.both, self.views) {
            (.., Some(both), Some(layout)) => Ok((layout, both, both)),
            (Some(left), Some(right), ..) => Ok((DeviceLayout::TwoDevices, left, right)),
            _ => bail!(
                "no cameras are named: give --config FILE (as configs/rig.toml), --left NAME --right NAME, or --both NAME --views LAYOUT for one \
                 device with both views; `pb3dp cameras list` shows the names"
            ),
        }
    }
}

/// Layouts of one device.
fn one_device() -> impl TypedValueParser<Value = DeviceLayout> {
    let layouts = DeviceLayout::ALL.into_iter().filter(|layout| layout.is_one_device());
    PossibleValuesParser::new(layouts.map(DeviceLayout::name)).try_map(|name| name.parse::<DeviceLayout>())
}

/// The cameras of a setup.
fn of_setup(setup: &SetupArgs, needs_calibration: bool) -> Result<Chosen> {
    let (mut cameras, range) = read_cameras(setup)?;
    let loaded = match cameras.calibration() {
        Ok(loaded) => Some(loaded),
        Err(error) if needs_calibration => return Err(error),
        Err(error) => {
            tracing::warn!("the cameras are shown without a calibration: {error:#}");
            None
        }
    };
    warn_of(loaded.as_ref());
    if let Some(loaded) = &loaded {
        cameras.calibrate(&loaded.rig)?;
    }
    let target = ChosenTarget { region: cameras.region, range: Some(range) };
    let (rig, calibration) = (loaded.as_ref().map(|loaded| loaded.rig), loaded.as_ref().map(facts));
    let calibration_term = loaded.as_ref().and_then(term_or_warning);
    Ok(Chosen { config: cameras.stereo, rig, calibration, calibration_term, target })
}

fn warn_of(loaded: Option<&StereoCalibration>) {
    for warning in loaded.iter().flat_map(|loaded| &loaded.warnings) {
        tracing::warn!("{warning}");
    }
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
