//! Stereo camera backend on two V4L2 devices, or on one whose images have both views.
//!
//! [`V4l2StereoCamera`] opens the cameras by persistent names ([`names`]), requests a mode and refuses silent changes by the
//! driver ([`modes`]), and disables automatic modes ([`controls`]). It delivers pairs: the newest images of both sides, with the
//! middle of their exposures ([`timing`]), matched by time ([`pairing`]). Damaged, short, old and wrongly stamped images are
//! dropped and counted ([`StreamCounters`]). A lost or silent camera is an error two periods after its last image.
//! One exposure for both cameras adapts to the light if the configuration requests it ([`ExposureEvent`]).
//! [`ReopeningCamera`] continues when lost devices are available again.
//!
//! `pb3dp-camera-pixels` converts the bytes of a driver buffer to an image, from every supported format. [`video`] is the interface to the
//! operating system, call by call; [`linux`] implements it on Linux, [`emulated`] provides cameras that fail on request.

mod brightness;
mod camera;
pub mod controls;
pub mod emulated;
mod error;
mod exposure_control;
pub mod known_models;
pub mod linux;
pub mod modes;
pub mod names;
mod opening;
pub mod pairing;
mod reopening;
mod shared_exposure;
mod stream;
pub mod timing;
pub mod video;

pub use camera::{CameraIdentity, StereoCounters, V4l2StereoCamera};
pub use reopening::ReopeningCamera;
pub use shared_exposure::ExposureEvent;
pub use stream::{Side, StreamCounters};
