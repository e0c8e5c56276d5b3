//! Integration tests of the geometry.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod frames_and_rigs;
mod lens;
mod lie_groups;
mod maps;
mod value_range;
