//! The table `[mounts]`: poses of the cameras and the target on the arms, from a drawing or a calibration.

use std::path::PathBuf;

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Flange, Hand, Target};
use pb3dp_record::calibration_files::load_hand_eye;
use serde::Deserialize;

use super::super::load::Checker;
use super::calibration::CalibrationInUse;
use super::{ON_THE_ARM_MM, PoseEntry};

/// Mounting poses.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MountsSection {
    flange_from_hand: PoseEntry,
    hand_from_cam_left: Option<PoseEntry>,
    hand_eye: Option<PathBuf>,
    waived_gates: Option<Vec<String>>,
    calibration_age_max_days: Option<f64>,
    flange_from_target: PoseEntry,
}

/// [`MountsSection`] as transforms.
#[derive(Clone, Debug)]
pub(super) struct Mounts {
    pub(super) flange_from_hand: Pose<Flange, Hand>,
    pub(super) hand_from_cam_left: Pose<Hand, CamLeft>,
    pub(super) flange_from_target: Pose<Flange, Target>,
    /// The mounting of the cameras from a hand-eye calibration, if there is one.
    pub(super) calibration: Option<CalibrationInUse>,
}

impl MountsSection {
    pub(super) fn build(&self, check: &mut Checker) -> Mounts {
        let flange_from_hand = self.flange_from_hand.build("mounts.flange_from_hand", ON_THE_ARM_MM, check);
        let (hand_from_cam_left, calibration) = self.cameras(&flange_from_hand, check);
        Mounts {
            flange_from_hand,
            hand_from_cam_left,
            flange_from_target: self.flange_from_target.build("mounts.flange_from_target", ON_THE_ARM_MM, check),
            calibration,
        }
    }

    fn cameras(
        &self,
        flange_from_hand: &Pose<Flange, Hand>,
        check: &mut Checker,
    ) -> (Pose<Hand, CamLeft>, Option<CalibrationInUse>) {
        let waivers = (self.waived_gates.as_deref(), self.calibration_age_max_days);
        match (&self.hand_from_cam_left, &self.hand_eye) {
            (Some(drawn), None) => {
                if self.waived_gates.is_some() || self.calibration_age_max_days.is_some() {
                    check.refuse(
                        "mounts.waived_gates, mounts.calibration_age_max_days: are about mounts.hand_eye, which is not set"
                            .to_owned(),
                    );
                }
                (drawn.build("mounts.hand_from_cam_left", ON_THE_ARM_MM, check), None)
            }
            (None, Some(file)) => match load_hand_eye(file) {
                Ok(found) => {
                    let name = ("mounts", file.display().to_string());
                    let in_use = CalibrationInUse::new(name, Some(found.judgement), waivers, check);
                    (flange_from_hand.inverse() * found.flange_from_cam_left, Some(in_use))
                }
                Err(error) => {
                    check.refuse(format!("mounts.hand_eye: {error}"));
                    (Pose::coincident(), None)
                }
            },
            (drawn, _) => {
                let what = if drawn.is_some() { "both are set" } else { "neither is set" };
                check.refuse(format!(
                    "mounts.hand_from_cam_left, mounts.hand_eye: {what}; where the left camera is says either a pose as drawn, or a file of \
                     pb3dp calibrate hand-eye"
                ));
                (Pose::coincident(), None)
            }
        }
    }
}
