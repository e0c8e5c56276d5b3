//! Typed frames, SE(3), pinhole cameras with distortion, and stereo rigs.
//!
//! Everything is in SI units (metres, radians, seconds) and `f64`; image coordinates are pixels with integer pixel
//! centres. The frames and their axes are described in `docs/frames.md`. This crate does no I/O and knows no arm.
//!
//! Main types: [`Pose`] (a rigid transform `a_from_b` with its frames in the type), [`Twist`], [`Camera`],
//! [`StereoRig`], [`maps::RemapTable`] (undistortion and rectification of images), [`MonotonicTime`], and the functions
//! of [`so3`] and [`se3`].

pub mod camera;
pub mod frames;
pub mod maps;
pub mod pose;
pub mod rectification;
pub mod se3;
pub mod so3;
pub mod stereo_rig;
pub mod time;
pub mod twist;

pub use camera::{Camera, CameraError, Distortion, ImageSize, Pinhole};
pub use frames::Frame;
pub use pose::Pose;
pub use rectification::{Rectification, RectificationError};
pub use stereo_rig::{StereoRig, StereoRigError};
pub use time::MonotonicTime;
pub use twist::Twist;
