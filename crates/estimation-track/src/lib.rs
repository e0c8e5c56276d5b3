//! The direct method over time: six degrees of freedom from kept views.
//!
//! The target is a `surface` (points of the first view on a plane with a relief) and a few kept `view`s of it. A frame is
//! one small problem (`align`): at which pose does the nearest view explain both images? Unknown beside the pose are gain
//! and offset of each channel of each camera, the row offset of the right camera, an offset of each patch that both cameras
//! share (shading that does not turn with the target), and what the first pair left open about the plane of the surface.
//! View, left and right image have noise of their own each, so three differences are weighed together: view against left,
//! view against right, left against right; where the view no longer fits (light), the last one still holds depth and tilt.
//!
//! Full resolution is read from the raw images, through the lens, made linear about the expected place of each point: nothing
//! is undistorted or rectified.
//!
//! Several targets are several [`DirectTracker`]s on the same pair: they share nothing, and cost adds up.

mod align;
pub mod cells;
mod config;
mod dense;
mod distinct;
mod export;
mod images;
mod judge;
mod kernels;
mod lanes;
mod normal;
mod one_surface;
mod predict;
mod reach;
mod relief;
mod repeated;
mod search;
mod shape;
mod stereo_relief;
mod surface;
mod target;
mod tracker;
mod view;

pub use config::DirectTrackerConfig;
pub use judge::Fit;
pub use tracker::DirectTracker;
