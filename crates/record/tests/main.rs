//! Integration tests of the file formats.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod calibration_files;
mod calibration_refusals;
mod dataset;
mod hand_eye_file;
mod judged_calibration;
mod stops;
