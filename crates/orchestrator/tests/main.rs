//! Integration tests of the program `pb3dp`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod cli;
mod real_time;
