//! Integration tests of the emulated PA-10.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod conformance;
mod mock_controller;
mod mock_exposes_bugs;
mod mock_line;
mod mock_script;
mod real_time;
