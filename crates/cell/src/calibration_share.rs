//! The share of the calibration in the covariances of estimates, from the covariance in the calibration file.

use nalgebra::{Matrix6, Vector2};
use pb3dp_estimation::calibration_term::{CalibrationShare, CalibrationTerm, CalibrationTermError, FirstPair};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};
use pb3dp_record::calibration_files::StereoCalibration;

/// The term of a calibration; `None` if its file states no covariance.
///
/// # Errors
/// A covariance that does not fit the rig.
pub fn term_of(calibration: &StereoCalibration) -> Result<Option<CalibrationTerm>, CalibrationTermError> {
    let covariance = calibration.judgement.as_ref().and_then(|judgement| judgement.covariance.as_ref());
    covariance.map(|known| CalibrationTerm::new(&calibration.rig, &known.names, &known.rows)).transpose()
}

/// As [`term_of`]; a covariance that does not fit the rig is logged.
pub fn term_or_warning(calibration: &StereoCalibration) -> Option<CalibrationTerm> {
    term_of(calibration).unwrap_or_else(|error| {
        tracing::warn!("{}", not_reported(&calibration.source, &error));
        None
    })
}

/// The warning for a covariance that does not fit the rig.
pub fn not_reported(source: &str, error: &CalibrationTermError) -> String {
    format!("{source}: {error}; its share in the covariances is not reported")
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
    pub fn new(rig: StereoRig, term: Option<CalibrationTerm>, targets: usize) -> Self {
        Self { rig, term, first: vec![None; targets] }
    }

    /// Begins again with another first pair of a target.
    pub fn restart(&mut self, target: usize) {
        if let Some(first) = self.first.get_mut(target) {
            *first = None;
        }
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
