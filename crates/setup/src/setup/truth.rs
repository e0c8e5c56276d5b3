//! The table `[truth]`: true poses and cameras of a simulation, if they differ from the other tables.
//!
//! A real workcell differs from its setup by calibration errors; a simulated one only by this table. Images and errors use the
//! truth, motion and estimation use the other tables.

use std::path::PathBuf;

use pb3dp_geometry::frames::{Base, CamLeft, Flange, Target, World};
use pb3dp_geometry::{ImageSize, Pose, StereoRig};
use serde::Deserialize;

use super::super::load::Checker;
use super::calibration::load_files;
use super::{IN_THE_CELL_MM, ON_THE_ARM_MM, PoseEntry};

/// True values of a simulation; `None` means the value of the setup.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// Both cameras with their relative pose.
    pub rig: Option<StereoRig>,
    /// Pose of the left camera on the first arm.
    pub flange_from_cam_left: Option<Pose<Flange, CamLeft>>,
    /// Pose of the target on the second arm.
    pub flange_from_target: Option<Pose<Flange, Target>>,
    /// Base pose of the second arm, if the first one is where the setup states.
    pub tc_world_from_base: Option<Pose<World, Base>>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TruthSection {
    calibration: Option<Vec<PathBuf>>,
    flange_from_cam_left: Option<PoseEntry>,
    flange_from_target: Option<PoseEntry>,
    tc_world_from_base: Option<PoseEntry>,
}

impl TruthSection {
    /// For images of this size.
    pub(super) fn build(&self, size: Option<ImageSize>, check: &mut Checker) -> Truth {
        let rig = self.calibration.as_deref().zip(size);
        Truth {
            rig: rig.and_then(|(files, size)| load_rig("truth.calibration", files, size, check)),
            flange_from_cam_left: pose("flange_from_cam_left", &self.flange_from_cam_left, ON_THE_ARM_MM, check),
            flange_from_target: pose("flange_from_target", &self.flange_from_target, ON_THE_ARM_MM, check),
            tc_world_from_base: pose("tc_world_from_base", &self.tc_world_from_base, IN_THE_CELL_MM, check),
        }
    }
}

fn pose<To: pb3dp_geometry::Frame, From: pb3dp_geometry::Frame>(
    key: &str,
    entry: &Option<PoseEntry>,
    length_max_mm: f64,
    check: &mut Checker,
) -> Option<Pose<To, From>> {
    entry.as_ref().map(|entry| entry.build(&format!("truth.{key}"), length_max_mm, check))
}

/// The cameras of a calibration for images of this size, relative to the configuration.
fn load_rig(key: &str, files: &[PathBuf], size: ImageSize, check: &mut Checker) -> Option<StereoRig> {
    let loaded = load_files(files, size).inspect_err(|error| check.refuse(format!("{key}: {error}"))).ok()?;
    let ImageSize { width, height } = loaded.rig.left().size();
    if (ImageSize { width, height }) != size {
        check.refuse(format!(
            "{key}: {} is for images of {width}x{height}, the cameras have {}x{}",
            loaded.source, size.width, size.height
        ));
    }
    Some(loaded.rig)
}
