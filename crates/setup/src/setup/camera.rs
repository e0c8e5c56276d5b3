//! The tables `[camera]` with `backend = "sim"` and `[scene]`: the simulated stereo rig and its scene.

use pb3dp_geometry::frames::{CamLeft, CamRight};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};
use pb3dp_sim::camera_faults::CameraFaults;
use pb3dp_sim::scene::SceneConfig;
use pb3dp_sim::sensor::{BLUR_MOMENTS, CameraResponse, SensorConfig};
use pb3dp_sim::targets::{BackdropConfig, TargetConfig};
use serde::Deserialize;
use std::path::PathBuf;

use super::super::load::{Checker, whole};
use super::super::table::{Builds, table};
use super::super::units::in_mm;
use super::calibration::{CAMERA_TABLE, CalibrationInUse};
use super::camera_faults::{self, FaultSection};
use super::image_stream::{check_size, frame_rate_hz};
use super::real_cameras::load_calibration;
use super::{FrameTiming, millis};

/// Suffix of keys of this table in messages.
pub(super) const OWNER: &str = "(with camera.backend = \"sim\")";

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraSection {
    #[serde(rename = "backend")]
    _backend: String,
    calibration: Option<Vec<PathBuf>>,
    region: Option<String>,
    waived_gates: Option<Vec<String>>,
    calibration_age_max_days: Option<f64>,
    width_px: i64,
    height_px: i64,
    focal_px: f64,
    baseline_mm: f64,
    distortion: [f64; 5],
    frame_rate_hz: f64,
    exposure_millis: f64,
    motion_blur_moments: i64,
    lens_blur_px: f64,
    read_noise_grey: f64,
    shot_noise_grey: f64,
    left: SideSection,
    right: SideSection,
    #[serde(default)]
    faults: Vec<FaultSection>,
}

table! {
    struct SideSection builds CameraResponse {
        exposure: f64 => exposure = number(CameraResponse::EXPOSURE);
        gain: [f64; 3] => gain = numbers(CameraResponse::GAIN);
        offset_grey: [f64; 3] => offset_grey = numbers(CameraResponse::OFFSET_GREY);
    }
}

impl CameraSection {
    pub(super) fn build(&self, check: &mut Checker) -> (Option<StereoRig>, FrameTiming, SensorConfig) {
        self.check(check);
        let frames =
            FrameTiming { period: millis(1000.0 / self.frame_rate_hz), exposure: millis(self.exposure_millis) };
        let sensor = SensorConfig {
            lens_blur_px: self.lens_blur_px,
            read_noise_grey: self.read_noise_grey,
            shot_noise_grey: self.shot_noise_grey,
            left: self.left.build("camera.left", check),
            right: self.right.build("camera.right", check),
        };
        check.together("camera", sensor.validate());
        (self.rig(check), frames, sensor)
    }

    /// Rendered moments of an exposure.
    pub(super) fn blur_moments(&self) -> u32 {
        whole(self.motion_blur_moments)
    }

    /// The assumed cameras: those of the calibration, if one is named, else the rendered ones.
    pub(super) fn calibrated(
        &self,
        drawn: Option<StereoRig>,
        check: &mut Checker,
    ) -> (Option<StereoRig>, Option<CalibrationInUse>) {
        let Some((rig, files)) = drawn.zip(self.calibration.as_deref()) else { return (drawn, None) };
        let loaded = match load_calibration(files, rig.left().size()) {
            Ok(loaded) => loaded,
            Err(error) => {
                check.refuse(format!("{error:#}"));
                return (None, None);
            }
        };
        let waivers = (self.waived_gates.as_deref(), self.calibration_age_max_days);
        let in_use = CalibrationInUse::new((CAMERA_TABLE, loaded.source), loaded.judgement, waivers, check);
        (Some(loaded.rig), Some(CalibrationInUse { warnings: loaded.warnings, ..in_use }))
    }

    pub(super) fn faults(&self, check: &mut Checker) -> CameraFaults {
        camera_faults::build(&self.faults, check)
    }

    /// Checks every key separately. The ranges of the sensor are those of the simulation; focal length and distortion are limited
    /// to the values of real lenses.
    fn check(&self, check: &mut Checker) {
        if let Some(region) = &self.region {
            check.refuse(format!(
                "camera.region = {region:?}: the cameras are simulated, and where the target is in their images is known"
            ));
        }
        check_size(self.width_px, self.height_px, check);
        check.number("camera.focal_px", self.focal_px, 50.0..=20_000.0);
        check.number("camera.baseline_mm", self.baseline_mm, 5.0..=2000.0);
        check.numbers("camera.distortion", &self.distortion, -10.0..=10.0);
        let period_millis = 1000.0 / frame_rate_hz(self.frame_rate_hz, check);
        check.number("camera.exposure_millis", self.exposure_millis, 0.01..=period_millis);
        check.count("camera.motion_blur_moments", self.motion_blur_moments, BLUR_MOMENTS);
        check.number("camera.lens_blur_px", self.lens_blur_px, SensorConfig::LENS_BLUR_PX);
        check.number("camera.read_noise_grey", self.read_noise_grey, SensorConfig::READ_NOISE_GREY);
        check.number("camera.shot_noise_grey", self.shot_noise_grey, SensorConfig::SHOT_NOISE_GREY);
    }

    /// Two identical parallel cameras, the right one `baseline_mm` to the right.
    fn rig(&self, check: &mut Checker) -> Option<StereoRig> {
        if !check.is_clean() {
            return None;
        }
        let size = ImageSize { width: whole(self.width_px), height: whole(self.height_px) };
        let centre = |pixels: u32| (f64::from(pixels) - 1.0) / 2.0;
        let (cx, cy) = (centre(size.width), centre(size.height));
        let pinhole = Pinhole { fx: self.focal_px, fy: self.focal_px, cx, cy };
        let distortion = match self.distortion {
            [0.0, 0.0, 0.0, 0.0, 0.0] => Distortion::None,
            coefficients => Distortion::BrownConrady5 { coefficients },
        };
        let baseline = nalgebra::Vector3::new(-self.baseline_mm * 1e-3, 0.0, 0.0);
        let cam_right_from_cam_left = Pose::<CamRight, CamLeft>::from_translation(baseline);
        let camera = match Camera::new(size, pinhole, distortion) {
            Ok(camera) => camera,
            Err(error) => {
                check.refuse(format!("camera: {error}"));
                return None;
            }
        };
        StereoRig::new(camera, camera, cam_right_from_cam_left)
            .inspect_err(|error| check.refuse(format!("camera: {error}")))
            .ok()
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneSection {
    target: TargetName,
    relief_mm: f64,
    backdrop: bool,
    backdrop_size_mm: [f64; 2],
    backdrop_gap_mm: f64,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum TargetName {
    Crab,
    Card,
    Box,
    Potato,
}

impl SceneSection {
    pub(super) fn build(&self, check: &mut Checker) -> SceneConfig {
        check.number("scene.relief_mm", self.relief_mm, in_mm(TargetConfig::RELIEF_M));
        check.numbers("scene.backdrop_size_mm", &self.backdrop_size_mm, in_mm(BackdropConfig::SIZE_M));
        check.number("scene.backdrop_gap_mm", self.backdrop_gap_mm, in_mm(BackdropConfig::GAP_M));
        let target = match self.target {
            TargetName::Crab => TargetConfig::crab(self.relief_mm * 1e-3),
            TargetName::Card => TargetConfig::card(),
            TargetName::Box => TargetConfig::grey_box(),
            TargetName::Potato => TargetConfig::potato(),
        };
        let backdrop = BackdropConfig {
            size_m: self.backdrop_size_mm.map(|size| size * 1e-3),
            gap_m: self.backdrop_gap_mm * 1e-3,
        };
        SceneConfig { backdrop: self.backdrop.then_some(backdrop), ..SceneConfig::new(target) }
    }
}
