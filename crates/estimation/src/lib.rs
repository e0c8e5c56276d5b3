//! Projection-based 3D perception: pose of an unknown object from one stereo pair.
//!
//! The entry: estimators and trackers [by the name of their method](estimator), what a rig can reach
//! ([`rig_plan`]), and whether its calibration still holds ([`pair_check`]).
//!
//! This crate knows images, calibration and geometry. It touches no file, clock, thread or environment; a caller who wants
//! threads splits the work with the interfaces given here.

pub mod estimator;
pub mod pair_check;
pub mod rig_plan;

pub use pb3dp_estimation_core::error::EstimationError;

#[cfg(doctest)]
#[doc = include_str!("../../../docs/how-to/add-an-estimation-method.md")]
mod add_an_estimation_method {}
