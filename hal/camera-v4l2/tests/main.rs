//! Integration tests of the V4L2 camera, on emulated devices.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod camera;
mod jpeg;
mod one_device;
mod reopening;
mod shared_exposure;
mod support;
