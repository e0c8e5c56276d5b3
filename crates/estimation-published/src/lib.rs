//! The method as published, for comparison: Pb3DP by hue and a real-time multi-step genetic algorithm.
//!
//! A [photo model](photo_model) is taken from the left image, a
//! [plane hypothesis](pb3dp_estimation_core::plane_hypothesis) puts it on a plane in space, the plane's homography puts it into
//! the right image, and the [fitness] counts how many points find their own hue there. A [search] finds the hypothesis with the
//! highest fitness; [`observability`] judges it.

pub mod estimator;
pub mod fitness;
pub mod hue;
pub mod observability;
pub mod photo_model;
pub mod search;
