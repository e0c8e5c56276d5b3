//! Integration tests of limiter, guard, coupling and flight recorder.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod common;
mod coupling;
mod emulated_controller;
mod guard;
mod last_command;
mod limiter;
mod real_time;
mod recent_failures;
mod recorder;
