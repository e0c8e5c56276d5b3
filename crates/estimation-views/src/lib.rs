//! Views of a stereo pair for the direct method: what it computes of the images before it searches.
//!
//! The [front end](front_end) rectifies windows of raw images: those of a rectified pair are used unchanged, others are resampled. Their
//! [channels](colour_planes) and the region form a [pyramid](region_pyramid) of both images. A plane is an affine disparity in them
//! ([`disparity_plane`]), and [`raw_view`] converts it to the raw left camera.
//!
//! This crate is internal to the crates of the direct method. It searches nothing, and knows no cost, score or verdict.

pub mod colour_planes;
pub mod disparity_plane;
pub mod filters;
pub mod front_end;
pub mod image_plane;
pub mod raw_view;
pub mod reach;
pub mod region_pyramid;
mod resample;
pub mod row_shift;

pub use resample::ReducedImage;
