//! The direct method over time: six degrees of freedom from kept views.

mod align;
mod config;
mod images;
mod judge;
mod kernels;
mod lanes;
mod normal;
mod predict;
mod relief;
mod search;
mod stereo_relief;
mod surface;
mod target;
mod tracker;
mod view;

pub use config::DirectTrackerConfig;
pub use judge::Fit;
pub use predict::FramePrior;
pub use tracker::DirectTracker;
