//! The share of the calibration in the covariances of estimates, from the covariance in the calibration file.

use nalgebra::{Matrix6, Vector2};
use pb3dp_estimation::calibration_term::{CalibrationTerm, CalibrationTermError, FirstPair};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};
use pb3dp_record::calibration_files::{Judgement, StereoCalibration};
use pb3dp_setup::setup::{CAMERA_TABLE, Setup};

/// The term of a calibration; `None` if its file states no covariance.
///
/// # Errors
/// A covariance that does not fit the rig.
pub fn term_of(calibration: &StereoCalibration) -> Result<Option<CalibrationTerm>, CalibrationTermError> {
    stated(&calibration.rig, calibration.judgement.as_ref())
}

fn stated(rig: &StereoRig, judgement: Option<&Judgement>) -> Result<Option<CalibrationTerm>, CalibrationTermError> {
    let covariance = judgement.and_then(|judgement| judgement.covariance.as_ref());
    covariance.map(|known| CalibrationTerm::new(rig, &known.names, &known.rows)).transpose()
}

/// As [`term_of`]; a covariance that does not fit the rig is logged.
pub fn term_or_warning(calibration: &StereoCalibration) -> Option<CalibrationTerm> {
    or_warning(term_of(calibration), &calibration.source)
}

/// The term of the cameras of a setup, likewise.
pub fn term_of_setup(setup: &Setup) -> Option<CalibrationTerm> {
    let used = setup.rig.calibrations.iter().find(|used| used.table == CAMERA_TABLE)?;
    or_warning(stated(&setup.rig.stereo, used.judgement.as_ref()), &used.source)
}

fn or_warning(term: Result<Option<CalibrationTerm>, CalibrationTermError>, source: &str) -> Option<CalibrationTerm> {
    term.unwrap_or_else(|error| {
        tracing::warn!("{}", not_reported(source, &error));
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
    term.share_of_first(&first)
}
