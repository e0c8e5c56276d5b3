//! The whole loop in the simulated cell: cameras, estimation, servo, limiter, arms. Images are small and the experiment
//! short, so that the suite is quick; the setup is the repository's otherwise.
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
