//! Integration tests of the gateway of the PA-10.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod gateway_abort;
mod gateway_limits;
mod gateway_local;
mod gateway_properties;
mod gateway_rest;
mod gateway_restart;
mod gateway_table;
mod gateway_watchdogs;
mod gateway_work;
mod io_bus;
mod random_bytes;
mod real_time;
