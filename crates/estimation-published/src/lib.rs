//! The published method, for comparison: Pb3DP with hue and a real-time multi-step genetic algorithm.
//!
//! A [photo model](photo_model) is sampled from the left image. A [plane hypothesis](pb3dp_estimation_core::plane_hypothesis)
//! places it on a plane in space, and the plane's homography projects it into the right image. The [fitness] counts the points
//! that find their own hue there. A [search] finds the hypothesis with the highest fitness; [`observability`] evaluates it.

pub mod estimator;
pub mod fitness;
pub mod hue;
pub mod observability;
pub mod photo_model;
pub mod search;
