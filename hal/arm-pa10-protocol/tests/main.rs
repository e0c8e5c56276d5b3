//! Integration tests of the wire formats of the PA-10.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod codec_golden;
mod codec_properties;
mod frame_parser;
mod gateway_protocol;
