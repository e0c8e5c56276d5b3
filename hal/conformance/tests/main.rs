//! Integration tests of the conformance suite: broken backends must fail it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod broken_arms;
mod broken_cameras;
mod broken_clocks;
