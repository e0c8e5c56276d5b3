//! Integration tests of the calibration.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

#[path = "support/arm.rs"]
mod arm;
mod boards;
mod coach;
mod command;
mod corners;
#[path = "support/film.rs"]
mod film;
mod hand_eye;
mod hand_eye_command;
mod opencv;
#[path = "support/program.rs"]
mod program;
mod propose;
mod recording;
#[path = "support/rendered.rs"]
mod renderer;
mod simulated_rigs;
mod support;
mod verify;
