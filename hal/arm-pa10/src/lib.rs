//! Mitsubishi PA-10 arm backends.
//!
//! [`mock`] is an arm without hardware: the state machine and the contract of a real one over simulated joints.

pub mod mock;

pub use mock::{MockArm, MockArmConfig, MockArmFaults};
