//! The table `[truth]`: where things of a simulation truly are, if not where the other tables say.
//!
//! A real cell differs from what its setup says of it, by what its calibration has left over; a simulated one does so with this table
//! only. Images and errors follow the truth, everything that moves and estimates the other tables.

use std::path::PathBuf;

use pb3dp_geometry::frames::{Base, CamLeft, Flange, Target, World};
use pb3dp_geometry::{ImageSize, Pose, StereoRig};
use serde::Deserialize;

use super::super::load::Checker;
use super::calibration::load_files;
use super::{IN_THE_CELL_MM, ON_THE_ARM_MM, PoseEntry};

/// Where things of a simulation truly are; what is `None` is where the setup says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// Both cameras, and how they stand to each other.
    pub rig: Option<StereoRig>,
    /// Where the left camera is on the first arm.
    pub flange_from_cam_left: Option<Pose<Flange, CamLeft>>,
    /// Where the target is on the second arm.
    pub flange_from_target: Option<Pose<Flange, Target>>,
    /// Where the second arm stands, if the first one stands where the setup says.
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
    /// With images of this size.
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

/// The cameras of a calibration for images of this size, beside the configuration.
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
