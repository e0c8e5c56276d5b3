//! The codes of all messages of a cell, but for those of its devices.

use std::error::Error;

use pb3dp_bag::BagError;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::region::RegionError;
use pb3dp_hal_api::{ArmError, ArmErrorKind, CameraError, CameraErrorKind};
use pb3dp_message_codes::{Coded, MessageCode};
use pb3dp_record::calibration_files::CalibrationFileError;
use pb3dp_record::dataset::DatasetError;
use pb3dp_record::images::{ImageFileError, ImageProblem};
use pb3dp_servo::supervisor::{Condition, RefusedFor};
use pb3dp_setup::load::ConfigError;
use pb3dp_sim::placement::PathRefusal;

use crate::attended_motion::EndedByPerson;

/// A table of codes with its heading.
pub type CodeTable = (&'static str, &'static [MessageCode]);

/// The table of one type.
pub const fn table<T: Coded>() -> CodeTable {
    (T::TITLE, T::CODES)
}

/// All tables, in the order of the reference.
pub const TABLES: [CodeTable; 12] = [
    table::<Condition>(),
    table::<RefusedFor>(),
    table::<ConfigError>(),
    table::<ImageProblem>(),
    table::<CalibrationFileError>(),
    table::<DatasetError>(),
    table::<BagError>(),
    table::<RegionError>(),
    table::<EstimationError>(),
    table::<PathRefusal>(),
    table::<CameraErrorKind>(),
    table::<ArmErrorKind>(),
];

/// The code of one error, not of its sources; `None` if it has none.
pub fn code_of(error: &(dyn Error + 'static)) -> Option<&'static MessageCode> {
    fn as_is<T: Coded + Error + 'static>(error: &(dyn Error + 'static)) -> Option<&'static MessageCode> {
        error.downcast_ref::<T>().map(Coded::message_code)
    }
    // What only passes on another error has the code of that one.
    match (error.downcast_ref::<DatasetError>(), error.downcast_ref::<EstimationError>()) {
        (Some(DatasetError::Image(inner)), _) => return Some(inner.problem.message_code()),
        (Some(DatasetError::Calibration(inner)), _) => return Some(inner.message_code()),
        (_, Some(EstimationError::Region(inner))) => return Some(inner.message_code()),
        _ => {}
    }
    let of_image = || error.downcast_ref::<ImageFileError>().map(|error| error.problem.message_code());
    let of_camera = || error.downcast_ref::<CameraError>().map(|error| error.kind().message_code());
    let of_arm = || error.downcast_ref::<ArmError>().map(|error| error.kind().message_code());
    let of_silence = || match error.downcast_ref::<EndedByPerson>() {
        Some(EndedByPerson::Silent(cause)) => Some(cause.condition.message_code()),
        _ => None,
    };
    as_is::<ConfigError>(error)
        .or_else(of_image)
        .or_else(|| as_is::<CalibrationFileError>(error))
        .or_else(|| as_is::<DatasetError>(error))
        .or_else(|| as_is::<BagError>(error))
        .or_else(|| as_is::<RegionError>(error))
        .or_else(|| as_is::<EstimationError>(error))
        .or_else(|| as_is::<PathRefusal>(error))
        .or_else(of_camera)
        .or_else(of_arm)
        .or_else(of_silence)
}
