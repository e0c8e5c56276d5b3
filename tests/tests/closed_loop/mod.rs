//! The whole loop in the simulated workcell: cameras, estimation, servo, limiter, arms. Images are small and the experiment
//! is short for a quick suite; otherwise the setup is that of the repository.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests may fail the test")]

mod both_arms;
mod drifting;
mod failing;
mod following;
mod geometric;
mod paths;
mod repeatable;
mod seeing_again;
mod six_axes;
pub mod support;
