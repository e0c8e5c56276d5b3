//! The direct tracker: six degrees of freedom from stored views.
//!
//! The target is represented by a `surface` (points of the first view on a plane with a relief) and a few stored `view`s. Each
//! frame is one small problem (`align`): the pose at which the nearest view explains both images. Further unknowns are gain and
//! offset of each channel of each camera, the row offset of the right camera, an offset of each patch common to both cameras
//! (shading that does not rotate with the target), and the components of the surface's plane that the first pair left
//! undetermined. View, left and right image each have independent noise. Therefore three differences are weighted jointly: view
//! against left, view against right, left against right. If the light changes and the view no longer fits, the last difference
//! still determines depth and tilt.
//!
//! Full resolution is read from the raw images. The lens model is linearised at the expected position of each point, so no
//! image is undistorted or rectified.
//!
//! Constants state where their values come from, as in [`pb3dp_estimation_direct`].
//!
//! To track several targets, use several [`DirectTracker`]s on the same pair: they share nothing, and their costs add up.

mod align;
pub mod cells;
mod clipped;
mod config;
mod correlation;
mod dense;
mod distinct;
mod export;
mod images;
mod judge;
mod kernels;
mod lanes;
mod normal;
mod observed;
mod one_surface;
mod periods;
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
mod visible_planes;

pub use config::DirectTrackerConfig;
pub use judge::Fit;
pub use tracker::DirectTracker;
