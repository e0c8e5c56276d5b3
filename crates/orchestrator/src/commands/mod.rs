//! The subcommands, one file each: arguments in, exit code out.

pub mod arm;
pub mod calibrate;
pub mod cameras;
pub mod doctor;
pub mod estimate;
pub mod gateway;
pub mod identify;
pub mod mock_arm;
pub mod pair;
pub mod rig;
pub mod run;
pub mod track;
mod typed_lines;
