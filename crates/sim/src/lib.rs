//! The simulated cell: scene, rasteriser, arm dynamics, with exact ground truth.
//!
//! Everything is deterministic: time and seeds come from outside, there is no clock, no thread and no file in here.

pub mod camera_faults;
pub mod geometric;
pub mod joint_dynamics;
pub mod noise;
pub mod placement;
pub mod raster;
pub mod scene;
pub mod sensor;
pub mod targets;
pub mod trajectory;
mod wide;
