//! What tests of every crate share. For tests only: no program of the product links this crate.
//!
//! * [`in_real_time`] runs a test whose threads must run in time, and decides whether a failure is the product's or the machine's.
//! * [`sweep`] is the size of a sweep, which `cargo xtask test --all` makes long.
//! * [`not_checked`] reports a test that this machine cannot run. `cargo xtask test` counts these reports.

#![allow(clippy::expect_used, reason = "a test that cannot be set up fails")]

mod not_checked;
pub mod real_time;
pub mod scheduling;
mod sweep;
pub mod verdict;
pub mod witness;

pub use not_checked::not_checked;
pub use real_time::{
    in_real_time, in_real_time_beside_others, programs_in_real_time, programs_in_real_time_beside_others,
};
pub use sweep::sweep;
