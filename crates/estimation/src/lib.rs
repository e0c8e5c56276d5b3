//! Projection-based 3D perception: pose of an unknown object from one stereo pair.
//!
//! The method: a [photo model](photo_model) is taken from the left image, a [hypothesis](plane_hypothesis) puts it on a
//! plane in space, the plane's homography puts it into the right image, and the [fitness] counts how many points find
//! their own hue there. A [search] finds the hypothesis with the highest fitness.
//!
//! This crate knows images, calibration and geometry. It touches no file, clock, thread or environment; a caller who wants
//! threads splits the work with the interfaces given here.

pub mod cpu;
pub mod direct;
pub mod error;
pub mod estimate;
pub mod estimator;
pub mod fitness;
pub mod hue;
pub mod observability;
pub mod pair_check;
pub mod photo_model;
pub mod plane_hypothesis;
pub mod published;
pub mod region;
pub mod rig_plan;
pub mod search;
pub mod status;
mod trig;
mod wide;

#[cfg(test)]
#[path = "../tests/support/naive.rs"]
mod naive;
#[cfg(test)]
#[path = "../tests/support/scene.rs"]
mod scene;

pub use error::EstimationError;
