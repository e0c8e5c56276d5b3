//! The direct method: planes and poses from grey levels at sub-pixel precision, of any texture.
//!
//! Everything that looks for planes works on rectified images, where a plane is an affine disparity
//! ([`disparity_plane`]): images of a rectified pair as they are, others through a map ([`front_end`]).

pub mod colour_planes;
pub mod disparity_plane;
pub mod front_end;
pub mod image_plane;
pub mod region_pyramid;
pub mod row_offset;
mod row_shift;
