//! The simulated workcell: scene, rasteriser, arm dynamics, with exact ground truth.
//!
//! Everything is deterministic: time and seeds are inputs; this crate uses no clock, thread or file.

pub mod camera_faults;
pub mod geometric;
pub mod joint_dynamics;
pub mod noise;
pub mod placement;
pub mod pushed;
pub mod raster;
pub mod scene;
pub mod sensor;
pub mod targets;
pub mod trajectory;
mod wide;
