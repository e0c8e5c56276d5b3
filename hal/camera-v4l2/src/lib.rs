//! Stereo camera backend on two V4L2 devices.
//!
//! [`V4l2StereoCamera`] opens two cameras by names that stay theirs ([`names`]), asks for a mode and refuses what the driver has made of
//! it in silence ([`modes`]), switches automatic modes off ([`controls`]), and delivers pairs: the newest images of both sides, with the
//! middle of their exposures ([`timing`]), matched by time ([`pairing`]). Damaged, short, old and wrongly stamped images are left out
//! and counted ([`StreamCounters`]); a camera that is lost or silent is an error two periods after its last image.
//! [`ReopeningCamera`] goes on once lost devices are there again.
//!
//! [`pixels`] turns the bytes of a driver's buffer into an image, from every format that is taken. [`video`] is what is needed of the
//! operating system, call by call; [`linux`] is how Linux does it, [`emulated`] are cameras that fail on request.

mod camera;
pub mod controls;
pub mod emulated;
mod error;
pub mod linux;
pub mod modes;
pub mod names;
pub mod pairing;
pub mod pixels;
mod reopening;
mod stream;
pub mod timing;
pub mod video;

pub use camera::{CameraIdentity, Side, StereoCounters, V4l2StereoCamera};
pub use reopening::ReopeningCamera;
pub use stream::StreamCounters;
