//! Integration tests of the controller and the supervisor.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod closed_loop;
mod common;
mod executed_command;
mod experiment;
mod feed_forward;
mod holding;
mod identification;
mod no_allocation;
mod servo;
mod settings;
mod singular;
mod supervisor;
mod supervisor_no_allocation;
mod target_state;
mod unobserved;
