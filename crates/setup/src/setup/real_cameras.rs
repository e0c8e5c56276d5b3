//! The table `[camera]` with `backend = "v4l2"`: two cameras of this computer, or one with both views, in the types of [`pb3dp_camera_settings`].

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_camera_settings::{
    CameraConfig, CameraName, ControlSettings, Crop, DeviceLayout, ImageLayout, Interval, ModeRequest, PixelFormat,
    SKEW_MAX, Setting, SharedExposure, SkewCost, StampModel, StereoConfig, ValueRange,
};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::{ImageSize, StereoRig};
use pb3dp_record::calibration_files::{Judgement, StereoCalibration};
use serde::Deserialize;

use super::super::layers::{Layers, SetupArgs};
use super::super::load::{Checker, ConfigError, ConfigFile, FileKind, whole};
use super::calibration::{CAMERA_TABLE, CalibrationInUse, load_files};
use super::image_stream::{check_size, frame_rate_hz};
use super::millis;
use super::range::read_search_range;
use super::servo::linear_mm_per_s;
use super::shared_exposure::{self, SharedExposureSection};
use crate::region_spec::RegionSpec;

/// Suffix of keys of this table in messages.
pub(super) const OWNER: &str = "(with camera.backend = \"v4l2\")";

/// Upper bound of the exposure time and of the timestamp delay, milliseconds.
const TIME_MAX_MILLIS: f64 = 1000.0;

/// Cameras of this computer: all settings that `pb3dp run` and `pb3dp cameras` need to open them.
#[derive(Clone, Debug, PartialEq)]
pub struct RealCameras {
    /// Devices, modes, controls and the limit of the exposure skew.
    pub stereo: StereoConfig,
    /// Synchronisation of the exposures.
    pub synchronisation: Synchronisation,
    /// Time for which a run searches for a disconnected camera; zero: the run ends.
    pub reopen_for: Duration,
    /// The calibration: one or two files, or a folder, as for `--calib` of `pb3dp estimate`.
    pub calibration_files: Vec<PathBuf>,
    /// The target in the first left image, if the file states it.
    pub region: Option<RegionSpec>,
}

/// Synchronisation of the exposures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Synchronisation {
    /// One trigger signal for both cameras.
    HardwareTrigger,
    /// Each camera has its own clock: the skew drifts through a whole period.
    FreeRunning,
}

impl RealCameras {
    /// Size of the images.
    pub fn size(&self) -> ImageSize {
        self.stereo.size()
    }

    /// Names of the devices, for reports.
    pub fn names(&self) -> String {
        let StereoConfig { layout, left, right, .. } = &self.stereo;
        if layout.is_one_device() {
            format!("{} ({layout})", left.name)
        } else {
            format!("{} and {}", left.name, right.name)
        }
    }

    /// Requested time between images.
    pub fn period(&self) -> Duration {
        Duration::from_secs_f64(self.stereo.left.mode.interval.seconds().unwrap_or(1.0))
    }

    /// Exposure time of the left camera from the file, the longest one if the program controls it; zero if the camera reports it.
    pub fn exposure(&self) -> Duration {
        if let Some(shared) = &self.stereo.shared_exposure {
            return shared.time[1];
        }
        match (self.stereo.left.controls.exposure, self.stereo.left.exposure) {
            (Setting::Manual(time), _) | (Setting::Keep | Setting::Auto, Some(time)) => time,
            (Setting::Keep | Setting::Auto, None) => Duration::ZERO,
        }
    }

    /// Uses the calibration for the cost of a skew, and for the longest exposure.
    ///
    /// # Errors
    /// If the shortest exposure blurs more than is allowed.
    pub fn calibrate(&mut self, rig: &StereoRig) -> Result<()> {
        self.stereo.calibrate(rig).context("camera.shared_exposure.exposure_min_millis")
    }

    /// Reads the calibration.
    ///
    /// # Errors
    /// Files that cannot be used, or that are for images of another size.
    pub fn calibration(&self) -> Result<StereoCalibration> {
        load_calibration(&self.calibration_files, self.size())
    }
}

/// Reads the calibration of the table `[camera]`, for images of this size.
///
/// # Errors
/// Unusable files, or a calibration for images of another size.
pub(super) fn load_calibration(files: &[PathBuf], size: ImageSize) -> Result<StereoCalibration> {
    let calibration = load_files(files, size)?;
    let calibrated = calibration.rig.left().size();
    if calibrated != size {
        let is_whole = |whole: ImageSize, view: ImageSize| {
            [(2 * view.width, view.height), (view.width, 2 * view.height)].contains(&(whole.width, whole.height))
        };
        let remedy = match is_whole(size, calibrated) {
            true => "camera.width_px and camera.height_px are those of one view, also of a device with both views",
            false => "calibrate again in that size",
        };
        bail!(
            "camera.calibration: {} is for images of {}x{}, the cameras are asked for {}x{}: {remedy}",
            calibration.source,
            calibrated.width,
            calibrated.height,
            size.width,
            size.height
        );
    }
    Ok(calibration)
}

/// Reads the real cameras of a setup and the search range of the target. Of the other tables it reads only
/// `servo.speed.linear_max_mm_per_s`, for messages about skew and for the longest exposure. It does not read the calibration: see
/// [`RealCameras::calibration`] and [`RealCameras::calibrate`].
///
/// # Errors
/// An unreadable file, simulated cameras, unknown or missing keys, values out of range.
pub fn read_cameras(args: &SetupArgs) -> Result<(RealCameras, SearchRange), ConfigError> {
    let config = ConfigFile::of(args.name().to_path_buf(), FileKind::Setup, Layers::read(args)?);
    let mut check = Checker::default();
    let found = cameras_of(&config, &mut check);
    config.finish(check)?;
    let lines = "  camera: not complete".to_owned();
    found.ok_or_else(|| ConfigError::Values { file: args.name().to_path_buf(), lines })
}

/// Whether a setup names cameras of this computer but neither arms nor mounts: `pb3dp cameras` needs no more.
///
/// # Errors
/// As [`Layers::read`].
pub fn is_for_cameras_only(args: &SetupArgs) -> Result<bool, ConfigError> {
    let stated = Layers::read(args)?.effective();
    let is_of_an_arm = |key: &str| key.strip_prefix("arms.").is_some_and(|key| key.contains('.'));
    let is_for_more = |key: &str| key.starts_with("mounts.") || is_of_an_arm(key);
    Ok(stated.iter().any(|setting| setting.key == "camera.left.device")
        && !stated.iter().any(|setting| is_for_more(&setting.key)))
}

fn cameras_of(config: &ConfigFile, check: &mut Checker) -> Option<(RealCameras, SearchRange)> {
    let backend: String = config.at("camera.backend", "")?;
    if backend != "v4l2" {
        check.refuse(format!(
            "camera.backend = {backend:?}: cameras of this machine are needed here, \"v4l2\", as in configs/rig.toml"
        ));
        return None;
    }
    let section: Option<V4l2Section> = config.at("camera", OWNER);
    let key = "servo.speed.linear_max_mm_per_s";
    let speed_mm_per_s: Option<f64> = config.at(key, "");
    let range = read_search_range(config, check);
    check.number(key, speed_mm_per_s?, linear_mm_per_s());
    let range = range?;
    section?.build((speed_mm_per_s? * 1e-3, &range), check).zip(Some(range))
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct V4l2Section {
    #[serde(rename = "backend")]
    _backend: String,
    calibration: Vec<PathBuf>,
    waived_gates: Option<Vec<String>>,
    calibration_age_max_days: Option<f64>,
    region: Option<String>,
    #[serde(default)]
    layout: LayoutName,
    format: String,
    value_range: Option<[i64; 2]>,
    width_px: i64,
    height_px: i64,
    frame_rate_hz: f64,
    #[serde(default)]
    interlaced: bool,
    synchronisation: Synchronisation,
    skew_max_millis: Option<f64>,
    reopen_for_s: f64,
    shared_exposure: Option<SharedExposureSection>,
    left: SideSection,
    right: SideSection,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SideSection {
    device: Option<String>,
    crop_px: Option<[i64; 4]>,
    input: Option<i64>,
    standard: Option<i64>,
    exposure_millis: ControlValue<f64>,
    stated_exposure_millis: Option<f64>,
    gain: ControlValue<i64>,
    white_balance_kelvin: ControlValue<i64>,
    focus: ControlValue<i64>,
    #[serde(default)]
    further_controls: Vec<ControlEntry>,
    readout_millis: f64,
    stamp_delay_millis: f64,
}

/// The devices that deliver both views.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum LayoutName {
    #[default]
    TwoDevices,
    SideBySide,
    TopBottom,
    Interleaved,
}

impl From<LayoutName> for DeviceLayout {
    fn from(name: LayoutName) -> Self {
        match name {
            LayoutName::TwoDevices => Self::TwoDevices,
            LayoutName::SideBySide => Self::OneImage(ImageLayout::SideBySide),
            LayoutName::TopBottom => Self::OneImage(ImageLayout::TopBottom),
            LayoutName::Interleaved => Self::Interleaved,
        }
    }
}

/// A number, "keep" or "auto"; exposure and gain also "shared".
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(
    untagged,
    expecting = "a number (a whole one, but for exposure_millis), \"keep\" (the value stays as it is), \"auto\" (the camera chooses) or, for exposure_millis and gain, \"shared\" (the program sets both cameras)"
)]
enum ControlValue<T> {
    Number(T),
    ControlKeyword(ControlKeyword),
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ControlKeyword {
    Keep,
    Auto,
    Shared,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ControlEntry {
    id: i64,
    value: i64,
}

impl<T> ControlValue<T> {
    fn setting<U>(self, turned: impl FnOnce(T) -> U) -> Setting<U> {
        match self {
            Self::Number(number) => Setting::Manual(turned(number)),
            // The program changes a shared value, and the camera does not.
            Self::ControlKeyword(ControlKeyword::Keep | ControlKeyword::Shared) => Setting::Keep,
            Self::ControlKeyword(ControlKeyword::Auto) => Setting::Auto,
        }
    }

    fn is_shared(&self) -> bool {
        matches!(self, Self::ControlKeyword(ControlKeyword::Shared))
    }
}

impl V4l2Section {
    /// The cameras, for the largest speed of the hand relative to the target, and the distances of the target.
    pub(super) fn build(
        &self,
        (speed_max_m_per_s, range_of_target): (f64, &SearchRange),
        check: &mut Checker,
    ) -> Option<RealCameras> {
        check_size(self.width_px, self.height_px, check);
        let rate_hz = frame_rate_hz(self.frame_rate_hz, check);
        // A skew of one period cannot be distinguished from the next image.
        let skew_max_millis = self.skew_max_millis.unwrap_or(SKEW_MAX.as_secs_f64() * 1e3);
        check.number("camera.skew_max_millis", skew_max_millis, 0.1..=900.0 / rate_hz);
        check.number("camera.reopen_for_s", self.reopen_for_s, 0.0..=86_400.0);
        if self.calibration.is_empty() {
            check.refuse(
                "camera.calibration = []: name the calibration file, as for --calib of `pb3dp estimate`".to_owned(),
            );
        }
        let format = self.format(check);
        let layout = DeviceLayout::from(self.layout);
        let shared_exposure = self.shared_exposure((1e3 / rate_hz, range_of_target.z_min_m), check);
        format.inspect(|format| self.check_layout(layout, *format, check));
        let view = self.view();
        let crops = self.crops(format, check);
        let range = format.and_then(|format| self.value_range(format, check));
        let region = self.region(crops.map_or(view, |[left, _]| left.map_or(view, |crop| crop.size)), check);
        let interval = interval(rate_hz);
        let mode = |format, side: &SideSection| ModeRequest {
            format,
            size: view,
            interval,
            input: side.input.map(whole),
            standard: side.standard.map(whole),
            takes_interlaced: self.interlaced,
        };
        let left = self.left.check("camera.left", 1e3 / rate_hz, check);
        let right = if layout.is_one_device() {
            self.right.check_unused(left.as_ref(), check);
            left.clone()
        } else {
            self.right.check("camera.right", 1e3 / rate_hz, check)
        };
        let (left, right) = (left?, right?);
        if left == right && !layout.is_one_device() {
            check.refuse(format!(
                "camera.right.device = \"{right}\": camera.left.device is the same; each side has a camera of its own, unless \
                 camera.layout says how one device has both views"
            ));
        }
        let (format, [left_crop, right_crop]) = (format?, crops?);
        let of_right = if layout.is_one_device() { &self.left } else { &self.right };
        Some(RealCameras {
            stereo: StereoConfig {
                layout,
                range: range?,
                left: CameraConfig { crop: left_crop, ..self.left.build(left, mode(format, &self.left)) },
                right: CameraConfig { crop: right_crop, ..of_right.build(right, mode(format, of_right)) },
                skew_max: millis(skew_max_millis),
                skew_cost: SkewCost {
                    speed_m_per_s: speed_max_m_per_s,
                    distance_m: range_of_target.z_max_m,
                    baseline_m: None,
                },
                shared_exposure,
            },
            synchronisation: self.synchronisation,
            reopen_for: millis(self.reopen_for_s * 1e3),
            calibration_files: self.calibration.clone(),
            region: region?,
        })
    }

    /// The exposure that the program controls, if both cameras request it.
    fn shared_exposure(&self, times: (f64, f64), check: &mut Checker) -> Option<SharedExposure> {
        let is_one_device = DeviceLayout::from(self.layout).is_one_device();
        let [time, gain] = [
            ("exposure_millis", [self.left.exposure_millis.is_shared(), self.right.exposure_millis.is_shared()]),
            ("gain", [self.left.gain.is_shared(), self.right.gain.is_shared()]),
        ]
        .map(|(key, [left, right])| {
            let side = if left { "right" } else { "left" };
            if left != right && !is_one_device {
                check.refuse(format!(
                    "camera.{side}.{key}: \"shared\" in the other camera; both cameras get the same value, so set \"shared\" in both"
                ));
            }
            left || right
        });
        if gain && !time {
            check.refuse("camera.left.gain: \"shared\" needs exposure_millis = \"shared\", too".to_owned());
        }
        for (key, side) in [("left", &self.left), ("right", &self.right)] {
            for (name, value) in [("white_balance_kelvin", side.white_balance_kelvin), ("focus", side.focus)] {
                if value.is_shared() {
                    check.refuse(format!(
                        "camera.{key}.{name} = \"shared\": only exposure_millis and gain can be shared"
                    ));
                }
            }
        }
        let section = self.shared_exposure.map(|section| section.build(gain, times, check));
        if time && section.is_none() {
            check.refuse(format!("{}: missing; exposure_millis = \"shared\" needs it", shared_exposure::TABLE));
        }
        section.filter(|_| time)
    }

    /// Size of a view before it is cropped.
    fn view(&self) -> ImageSize {
        ImageSize { width: whole(self.width_px), height: whole(self.height_px) }
    }

    /// Checks that images of this format have the layout.
    fn check_layout(&self, layout: DeviceLayout, format: PixelFormat, check: &mut Checker) {
        if let Err(error) = layout.check(format, self.view()) {
            check.refuse(format!("camera.layout: {error}"));
        }
    }

    /// The parts of both views that are used; `None` if one is refused, or if their sizes differ.
    fn crops(&self, format: Option<PixelFormat>, check: &mut Checker) -> Option<[Option<Crop>; 2]> {
        let mut is_refused = false;
        let mut crop = |key: &str, side: &SideSection| {
            let stated = side.crop_px?;
            for (name, value) in ["left", "top", "width", "height"].into_iter().zip(stated) {
                check.count(&format!("{key}.crop_px ({name})"), value, 0..=4096);
            }
            let [left, top, width, height] = stated.map(whole);
            let crop = Crop { left, top, size: ImageSize { width, height } };
            if let Some(Err(error)) = format.map(|format| crop.check(self.view(), format)) {
                check.refuse(format!("{key}.crop_px: {error}"));
                is_refused = true;
            }
            Some(crop)
        };
        let crops = [crop("camera.left", &self.left), crop("camera.right", &self.right)];
        let [left, right] = crops.map(|crop| crop.map_or(self.view(), |crop| crop.size));
        if left != right && !is_refused {
            check.refuse(format!(
                "camera.right.crop_px: the right image would have {}x{} pixels, the left one {}x{}; crop both to the same width and height",
                right.width, right.height, left.width, left.height
            ));
            is_refused = true;
        }
        (!is_refused).then_some(crops)
    }

    /// The values that become black and white; `None` if they are refused.
    fn value_range(&self, format: PixelFormat, check: &mut Checker) -> Option<Option<ValueRange>> {
        let Some(stated) = self.value_range else { return Some(None) };
        if format.full_range().is_none() {
            check.refuse(format!(
                "camera.value_range: only formats with more than 8 bits have one (Y10, Y12, Y16), {format} has not; remove it"
            ));
            return None;
        }
        let [low, high] = stated.map(|value| u16::try_from(value).ok());
        let range = low.zip(high).and_then(|(low, high)| ValueRange::new(low, high));
        if range.is_none() {
            check.refuse(format!(
                "camera.value_range = {stated:?}: state [LOW, HIGH] with 0 <= LOW < HIGH <= 65535, such as [0, 4095] for 12 bits"
            ));
            return None;
        }
        Some(range)
    }

    /// The calibration with the waivers of this table.
    pub(super) fn in_use(
        &self,
        (source, judgement): (String, Option<Judgement>),
        check: &mut Checker,
    ) -> CalibrationInUse {
        let waivers = (self.waived_gates.as_deref(), self.calibration_age_max_days);
        CalibrationInUse::new((CAMERA_TABLE, source), judgement, waivers, check)
    }

    fn format(&self, check: &mut Checker) -> Option<PixelFormat> {
        let format: Result<PixelFormat, _> = self.format.parse();
        format.inspect_err(|error| check.refuse(format!("camera.format: {error}"))).ok()
    }

    /// The region; `None` if it is refused.
    fn region(&self, size: ImageSize, check: &mut Checker) -> Option<Option<RegionSpec>> {
        let Some(text) = &self.region else { return Some(None) };
        let region = text.parse().and_then(|region: RegionSpec| region.check_inside(size).map(|()| region));
        match region {
            Ok(region) => Some(Some(region)),
            Err(why) => {
                check.refuse(format!("camera.region: {why}"));
                None
            }
        }
    }
}

/// The time between images as the shortest fraction that is accurate to a thousandth of an image per second.
pub fn interval(rate_hz: f64) -> Interval {
    let (thousandths, mut a, mut b) = ((rate_hz * 1e3).round() as u32, (rate_hz * 1e3).round() as u32, 1000);
    while b > 0 {
        (a, b) = (b, a % b);
    }
    Interval { numerator: 1000 / a.max(1), denominator: thousandths / a.max(1) }
}

impl SideSection {
    /// Checks every key separately, and the name of the device. The camera checks its controls when it is opened.
    fn check(&self, key: &str, period_millis: f64, check: &mut Checker) -> Option<CameraName> {
        let number = i64::from(i32::MAX);
        if let ControlValue::Number(exposure_millis) = self.exposure_millis {
            check.number(&format!("{key}.exposure_millis"), exposure_millis, 0.1..=period_millis);
        }
        if let Some(stated) = self.stated_exposure_millis {
            check.number(&format!("{key}.stated_exposure_millis"), stated, 0.0..=TIME_MAX_MILLIS);
        }
        for (name, request, allowed) in [
            ("gain", self.gain, 0..=100_000),
            ("white_balance_kelvin", self.white_balance_kelvin, 1000..=20_000),
            ("focus", self.focus, 0..=100_000),
        ] {
            if let ControlValue::Number(value) = request {
                check.count(&format!("{key}.{name}"), value, allowed);
            }
        }
        for (name, value, max) in [("input", self.input, 63), ("standard", self.standard, i64::from(u32::MAX))] {
            if let Some(value) = value {
                check.count(&format!("{key}.{name}"), value, 0..=max);
            }
        }
        for (index, control) in self.further_controls.iter().enumerate() {
            check.count(&format!("{key}.further_controls[{index}].id"), control.id, 1..=i64::from(u32::MAX));
            check.count(&format!("{key}.further_controls[{index}].value"), control.value, -number - 1..=number);
            if let Some(before) = self.further_controls[..index].iter().position(|before| before.id == control.id) {
                check.refuse(format!(
                    "{key}.further_controls[{index}].id = {}: further_controls[{before}] sets the same control; remove one of them",
                    control.id
                ));
            }
        }
        check.number(&format!("{key}.readout_millis"), self.readout_millis, 0.0..=TIME_MAX_MILLIS);
        check.number(&format!("{key}.stamp_delay_millis"), self.stamp_delay_millis, 0.0..=TIME_MAX_MILLIS);
        let Some(device) = &self.device else {
            let unless =
                if key == "camera.right" { ", unless camera.layout says how one device has both views" } else { "" };
            check.refuse(format!("{key}.device: missing; the setup must state it{unless}"));
            return None;
        };
        let name: Result<CameraName, _> = device.parse();
        name.inspect_err(|error| check.refuse(format!("{key}.device: {error}"))).ok()
    }

    /// Checks the right side of one device with both views: it has the settings of the left side, and states none of its own.
    fn check_unused(&self, device: Option<&CameraName>, check: &mut Checker) {
        let is_kept = |setting: Setting<()>| setting == Setting::Keep;
        let is_other_device = match (&self.device, device) {
            (Some(stated), Some(device)) => stated.parse::<CameraName>().as_ref() != Ok(device),
            _ => false,
        };
        let stated = [
            ("device", is_other_device),
            ("input", self.input.is_some()),
            ("standard", self.standard.is_some()),
            ("exposure_millis", !is_kept(self.exposure_millis.setting(drop)) || self.exposure_millis.is_shared()),
            ("stated_exposure_millis", self.stated_exposure_millis.is_some()),
            ("gain", !is_kept(self.gain.setting(drop)) || self.gain.is_shared()),
            ("white_balance_kelvin", !is_kept(self.white_balance_kelvin.setting(drop))),
            ("focus", !is_kept(self.focus.setting(drop))),
            ("further_controls", !self.further_controls.is_empty()),
            ("readout_millis", self.readout_millis != 0.0),
            ("stamp_delay_millis", self.stamp_delay_millis != 0.0),
        ];
        for (name, _) in stated.into_iter().filter(|(_, is_stated)| *is_stated) {
            check.refuse(format!(
                "camera.right.{name}: with this camera.layout one device has both views, and [camera.left] has its settings; remove this key"
            ));
        }
    }

    fn build(&self, name: CameraName, mode: ModeRequest) -> CameraConfig {
        CameraConfig {
            name,
            mode,
            controls: ControlSettings {
                exposure: self.exposure_millis.setting(millis),
                gain: self.gain.setting(whole),
                white_balance: self.white_balance_kelvin.setting(whole),
                focus: self.focus.setting(whole),
                others: self.further_controls.iter().map(|control| (whole(control.id), whole(control.value))).collect(),
            },
            exposure: self.stated_exposure_millis.map(millis),
            stamps: StampModel { readout: millis(self.readout_millis), delay: millis(self.stamp_delay_millis) },
            crop: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// The size of the whole image of a device with both views, in the place of that of one view.
    #[test]
    fn a_calibration_of_one_view_tells_which_size_is_meant() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/calibration/nominal.json");
        let refused = |width, height| {
            let size = ImageSize { width, height };
            format!("{:#}", load_calibration(std::slice::from_ref(&file), size).unwrap_err())
        };
        assert!(load_calibration(std::slice::from_ref(&file), ImageSize { width: 640, height: 480 }).is_ok());
        for (width, height) in [(1280, 480), (640, 960)] {
            assert!(refused(width, height).contains("those of one view"), "{}", refused(width, height));
        }
        assert!(refused(320, 240).contains("calibrate again in that size"), "{}", refused(320, 240));
    }
}
