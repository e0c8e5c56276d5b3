//! The simulated cell: scene, rasteriser, arm dynamics, with exact ground truth.
//!
//! Everything is deterministic: time and seeds come from outside, there is no clock, no thread and no file in here.

pub mod joint_dynamics;
pub mod placement;
pub mod scene;
pub mod trajectory;
