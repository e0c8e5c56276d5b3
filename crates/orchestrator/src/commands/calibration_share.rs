//! The share of the calibration in the covariances of `estimate` and `track`, from the covariance in the calibration file.

use nalgebra::{Matrix6, Vector2};
use pb3dp_estimation::calibration_term::{CalibrationShare, CalibrationTerm, FirstPair};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};
use pb3dp_record::calibration_files::StereoCalibration;

/// The term of a calibration; `None` if its file states no covariance. A covariance that does not fit the rig is logged.
pub fn term_of(calibration: &StereoCalibration) -> Option<CalibrationTerm> {
    let covariance = calibration.judgement.as_ref()?.covariance.as_ref()?;
    match CalibrationTerm::new(&calibration.rig, &covariance.names, &covariance.rows) {
        Ok(term) => Some(term),
        Err(error) => {
            tracing::warn!("{}: {error}; its share in the covariances is not reported", calibration.source);
            None
        }
    }
}

/// The share in the first pose of a target with this outline in the left image.
pub fn of_first(
    term: &CalibrationTerm,
    rig: &StereoRig,
    pose: &Pose<CamLeft, Model>,
    outline_px: &[Vector2<f64>],
) -> Option<Matrix6<f64>> {
    let first = FirstPair::of_outline(rig, pose, outline_px)?;
    Some(term.share(&first, pose)?.pose)
}

/// The shares in the poses of the targets of a sequence.
pub struct TrackShares {
    rig: StereoRig,
    term: Option<CalibrationTerm>,
    /// Per target: its first pair, once it has a pose.
    first: Vec<Option<FirstPair>>,
}

impl TrackShares {
    /// For a number of targets.
    pub fn new(calibration: &StereoCalibration, targets: usize) -> Self {
        Self { rig: calibration.rig, term: term_of(calibration), first: vec![None; targets] }
    }

    /// The share in an estimate of a target; `None` without a pose, or without a covariance of the calibration.
    pub fn share(&mut self, target: usize, estimate: &TrackEstimate) -> Option<CalibrationShare> {
        let (term, pose) = (self.term.as_ref()?, estimate.cam_left_from_model?);
        let first = self.first.get_mut(target)?;
        if first.is_none() {
            *first = FirstPair::of_outline(&self.rig, &pose, &estimate.outline_px);
        }
        term.share(first.as_ref()?, &pose)
    }
}
