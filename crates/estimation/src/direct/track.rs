//! The direct method over time: six degrees of freedom from kept views.

mod align;
mod config;
mod images;
mod kernels;
mod lanes;
mod normal;
mod predict;
mod relief;
mod surface;
mod tracker;
mod view;

pub use config::DirectTrackerConfig;
pub use predict::FramePrior;
pub use tracker::DirectTracker;
