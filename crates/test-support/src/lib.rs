//! Shared test support of all crates. For tests only: no program of the product links this crate.
//!
//! * [`in_real_time`] runs a test whose threads must meet deadlines, and decides whether a failure is caused by the product or
//!   the machine.
//! * [`sweep`] is the size of a sweep; `cargo xtask test --all` uses the long size.
//! * [`program_lines`] reads what a program writes.
//! * [`not_checked`] reports a test that this machine cannot run. `cargo xtask test` counts these reports.

#![allow(clippy::expect_used, reason = "a test that cannot be set up fails")]

mod not_checked;
mod program_lines;
pub mod real_time;
pub mod scheduling;
mod sweep;
pub mod verdict;
pub mod witness;

pub use not_checked::not_checked;
pub use program_lines::program_lines;
pub use real_time::{beside_each_other, in_real_time, in_real_time_beside_others, programs_in_real_time_beside_others};
pub use sweep::{scenes, sweep};
