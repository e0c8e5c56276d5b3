//! The program as its user meets it: arguments and files in, lines, pictures and exit code out.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests may fail the test")]

mod arm;
mod arm_on_bus;
mod arm_test;
mod behind_gateway;
mod calibrate;
mod cameras;
mod deploy;
mod doctor;
mod estimate;
mod identify;
mod mock_arm;
#[path = "../../../../hal/arm-pa10/tests/common/patience.rs"]
mod patience;
mod refusals;
mod rig;
mod run;
mod silent_gateway;
mod support;
mod track;
mod visit;
