//! Integration tests of the conversion of pixels.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod pixels;
mod views;
