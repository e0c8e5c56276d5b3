//! The direct method: planes and poses from grey levels with sub-pixel precision, on any texture.
//!
//! The plane search works on rectified images, in which a plane is an affine disparity ([`pb3dp_estimation_views`]).
//!
//! The comment of each constant that decides something states where its value comes from. "Chosen by hand, not varied": no other
//! value was measured, and the comment says what depends on it. "Chosen", with figures: the figures were measured when the rule
//! was written, and are not measured again.

mod beyond;
pub mod cold_start;
mod compression;
mod copies;
pub mod cramer_rao;
mod directions;
pub mod estimator;
mod final_plane;
mod named_sums;
pub mod outcome;
pub mod patches;
pub mod photometric;
mod repetition;
pub mod row_measurement;
pub mod search;
mod shape;
mod spread;
pub mod surface_choice;
mod surface_plane;
mod surroundings;
mod tilt_limits;
pub mod verdict;
