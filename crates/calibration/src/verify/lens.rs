//! Decides an unstated lens model by views of a board.

use pb3dp_record::calibration_files::{CalibrationFileError, LensModel, StereoCalibration};

use super::check;
use super::limits::REPROJECTION;
use crate::board::Chessboard;
use crate::fit::View;

/// Reprojection error of the refused reading, at least, as a multiple of that of the other one. Chosen by hand, not varied: as for the rows of
/// images without a board.
const CLEARLY_BETTER: f64 = 2.0;

/// The reading of a calibration that views of a board agree with, where the file leaves the lens model unstated. A calibration that needs no
/// decision is returned as it is.
///
/// # Errors
/// The views do not decide; the message names the option that does.
pub fn decide_lens(
    calibration: StereoCalibration,
    views: &[View<2>],
    board: &Chessboard,
) -> Result<StereoCalibration, CalibrationFileError> {
    let Some(other) = &calibration.other_lens else { return Ok(calibration) };
    let error_px = |rig| check(rig, views, board).map_or(f64::INFINITY, |checked| checked.reprojection_rms_px);
    let (brown, equidistant) = (error_px(&calibration.rig), error_px(other));
    let limit = REPROJECTION.refused;
    let is_clear = |one: f64, two: f64| one <= limit && two > limit && two >= CLEARLY_BETTER * one;
    let (lens, found, against) = match (is_clear(brown, equidistant), is_clear(equidistant, brown)) {
        (true, false) => (LensModel::BrownConrady, brown, equidistant),
        (false, true) => (LensModel::Equidistant, equidistant, brown),
        _ => {
            let errors = format!("reprojection errors of {brown:.2} px and {equidistant:.2} px");
            return Err(calibration.undecided_lens(&format!("the views of the board do not decide ({errors})")));
        }
    };
    let because =
        format!("the reprojection error of the board is then {found:.2} px, with the other model {against:.2} px");
    Ok(calibration.with_lens(lens, &because))
}
