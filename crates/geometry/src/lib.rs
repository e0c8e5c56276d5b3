//! Typed frames, SE(3), pinhole cameras with distortion, and stereo rigs.
//!
//! Geometric quantities are `f64` in SI units (metres, radians, seconds), with two exceptions: [`MonotonicTime`] holds whole
//! nanoseconds, and angles in error types are in degrees. Image coordinates are in pixels, and the centre of a pixel has integer coordinates. `docs/frames.md` describes the frames and their axes. This crate does no I/O
//! and is independent of any arm.
//!
//! Main types: [`Pose`] (a rigid transform `a_from_b`, which maps coordinates in frame b to frame a; the type names both
//! frames), [`Twist`], [`Camera`], [`StereoRig`], [`maps::RemapTable`] (undistortion and rectification of images),
//! [`MonotonicTime`], and the functions of [`so3`] and [`se3`]. [`ranges!`] declares the allowed values of parameters.

pub mod camera;
pub mod frames;
pub mod maps;
pub mod pose;
pub mod ranges;
pub mod rectification;
pub mod se3;
pub mod so3;
pub mod stereo_rig;
pub mod time;
pub mod twist;
mod value_range;

pub use camera::{Camera, CameraError, Distortion, ImageSize, Pinhole};
pub use frames::Frame;
pub use pose::Pose;
pub use rectification::{Rectification, RectificationError};
pub use stereo_rig::{RectificationObstacle, StereoRig, StereoRigError};
pub use time::MonotonicTime;
pub use twist::Twist;
pub use value_range::{ValueRange, WrongRange};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}
