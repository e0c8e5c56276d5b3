//! The program as its user meets it: arguments and files in, lines, images and exit codes out.

mod cameras;
mod config;
mod deploy;
mod doctor;
mod estimate;
mod estimate_calibrations;
mod identify;
pub mod mock_arm;
mod progress;
mod reference;
mod refusals;
mod rig;
pub mod run;
pub mod silent_gateway;
pub mod support;
mod track;
mod visit;
