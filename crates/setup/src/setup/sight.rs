//! The table `[camera]` for any backend.

use std::time::Duration;

use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::StereoRig;
use serde::Deserialize;

use super::super::load::{Checker, ConfigFile};
use super::calibration::CalibrationInUse;
use super::camera::{self, CameraSection, SceneSection};
use super::real_cameras::{self, RealCameras, V4l2Section};
use super::{FrameTiming, SimulatedWorld, Truth};

/// The key that all backends have; the others depend on it.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct CameraEntry {
    backend: CameraBackend,
}

/// Camera backends; further ones are added by name.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum CameraBackend {
    Sim,
    V4l2,
}

/// The table with the keys of its backend.
pub(super) enum CameraTable {
    /// Simulated cameras.
    Sim(Box<CameraSection>),
    /// Cameras of this computer.
    V4l2(Box<V4l2Section>),
}

/// Vision settings of a run; see [`Setup`](super::Setup).
pub(super) struct VisionSettings {
    pub(super) rig: StereoRig,
    pub(super) frames: FrameTiming,
    pub(super) real_cameras: Option<RealCameras>,
    pub(super) world: Option<SimulatedWorld>,
    pub(super) nominal_calibration: Option<String>,
    pub(super) calibration: Option<CalibrationInUse>,
}

impl CameraEntry {
    /// The whole table.
    pub(super) fn table(self, config: &ConfigFile) -> Option<CameraTable> {
        Some(match self.backend {
            CameraBackend::Sim => CameraTable::Sim(Box::new(config.at("camera", camera::OWNER)?)),
            CameraBackend::V4l2 => CameraTable::V4l2(Box::new(config.at("camera", real_cameras::OWNER)?)),
        })
    }
}

impl CameraTable {
    /// Whether the cameras are real.
    pub(super) fn is_real(&self) -> bool {
        matches!(self, Self::V4l2(_))
    }

    /// Vision settings of a run, with the speed limit of the hand and the distances of the target, and with the scene for simulated cameras.
    pub(super) fn build(
        &self,
        motion: (f64, &SearchRange),
        scene: Option<&SceneSection>,
        check: &mut Checker,
    ) -> Option<VisionSettings> {
        match self {
            Self::Sim(section) => {
                let (rig, frames, sensor) = section.build(check);
                let (rig, calibration) = section.calibrated(rig, check);
                let faults = section.faults(check);
                if scene.is_none() {
                    check.refuse("scene: missing; camera.backend = \"sim\" needs it".to_owned());
                }
                let (scene, blur_moments) = (scene?.build(check), section.blur_moments());
                let world =
                    SimulatedWorld { scene, sensor, sensor_seed: 0, blur_moments, faults, truth: Truth::default() };
                Some(VisionSettings {
                    rig: rig?,
                    frames,
                    real_cameras: None,
                    world: Some(world),
                    nominal_calibration: None,
                    calibration,
                })
            }
            Self::V4l2(section) => {
                if scene.is_some() {
                    check.refuse("scene: camera.backend = \"v4l2\" sees what there is; remove the table".to_owned());
                }
                let mut cameras = section.build(motion, check)?;
                let calibration = cameras.calibration().inspect_err(|error| check.refuse(format!("{error:#}"))).ok()?;
                if let Err(error) = cameras.calibrate(&calibration.rig) {
                    check.refuse(format!("{error:#}"));
                }
                let exposure = cameras.exposure().max(Duration::from_micros(1));
                let period = cameras.period();
                let in_use = section.in_use((calibration.source, calibration.judgement), check);
                Some(VisionSettings {
                    rig: calibration.rig,
                    nominal_calibration: calibration.not_measured,
                    calibration: Some(CalibrationInUse { warnings: calibration.warnings, ..in_use }),
                    frames: FrameTiming { period, exposure },
                    real_cameras: Some(cameras),
                    world: None,
                })
            }
        }
    }
}
