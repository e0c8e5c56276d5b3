//! The direct method: planes and poses from grey levels at sub-pixel precision, of any texture.
//!
//! Everything that looks for planes works on rectified images, where a plane is an affine disparity
//! ([`disparity_plane`]): images of a rectified pair as they are, others through a map ([`front_end`]).

mod beyond;
pub mod cold_start;
pub mod colour_planes;
pub mod cramer_rao;
pub mod disparity_plane;
pub mod estimator;
mod filters;
pub mod front_end;
pub mod image_plane;
mod named_sums;
pub mod outcome;
pub mod patches;
pub mod photometric;
pub mod reach;
pub mod region_pyramid;
mod repetition;
pub mod row_measurement;
mod row_shift;
pub mod search;
mod surroundings;
pub mod verdict;
