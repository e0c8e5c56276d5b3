//! Integration tests of the simulated workcell.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod placement;
mod raster_accuracy;
mod raster_behaviour;
mod support;
mod trajectory;
