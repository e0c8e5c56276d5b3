//! Integration tests of the kinematics.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod clearance;
mod pa10;
mod refusals;
mod six_axes;
