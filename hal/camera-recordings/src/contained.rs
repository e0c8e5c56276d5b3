//! The calibration that a recording contains.

use std::path::Path;

use pb3dp_hal_api::CameraError;
use pb3dp_record::calibration_files::StereoCalibration;

use crate::kind::{Kind, folder_of};
use crate::options::RecordingOptions;
use crate::pairs::{PERIOD, RecordedPairs};

/// The calibration that a recording contains; [`StereoCalibration::other_lens`] is left to be decided.
///
/// # Errors
/// As [`Kind::of`], and as [`Kind::calibration`].
pub fn calibration_of(path: &Path, asked: &RecordingOptions) -> Result<StereoCalibration, CameraError> {
    let path = folder_of(path);
    let kind = Kind::of(path, asked)?;
    let size = RecordedPairs::of(path, &kind, asked, PERIOD)?.image_size();
    kind.calibration(path, &[], (&asked.calibration.stated(), size))
}
