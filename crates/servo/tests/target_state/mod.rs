//! The state of the target: consistent with its own model, low noise at rest, no lag in motion, and independent of the order of
//! the measurements.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // In helpers of tests.

mod bench;
mod consistency;
mod figures;
mod following;
mod measurements;
mod settings;
