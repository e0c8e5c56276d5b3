//! Projection-based 3D perception: pose of an unknown object from one stereo pair.
//!
//! Contents: estimators and trackers [by the name of their method](estimator), planning of a stereo rig's accuracy
//! ([`rig_plan`]), checks of images against their calibration ([`pair_check`], [`rig_watch`]), the skew of cameras that do not expose at once
//! ([`skew_watch`]), and the share of an uncertain calibration in the covariance of a pose ([`calibration_term`]).
//!
//! A user needs this crate only: what requests and answers consist of is re-exported here.
//!
//! This crate works on images, calibration and geometry. It uses no file, clock, thread or environment; a caller that needs
//! threads distributes the work itself.

pub mod calibration_term;
pub mod estimator;
pub mod pair_check;
pub mod rig_plan;
pub mod rig_watch;
pub mod skew_watch;

pub use pb3dp_estimation_core::error::EstimationError;
pub use pb3dp_estimation_core::estimate::{PlaneEstimate, TrackEstimate};
pub use pb3dp_estimation_core::image_view::ImageView;
pub use pb3dp_estimation_core::plane_hypothesis::SearchRange;
pub use pb3dp_estimation_core::region::Region;
pub use pb3dp_estimation_core::status::Status;
pub use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};
// Their types are a part of this interface: a user needs the same versions.
pub use {image, nalgebra};

#[cfg(doctest)]
#[doc = include_str!("../../../docs/how-to/add-an-estimation-method.md")]
mod add_an_estimation_method {}

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}
