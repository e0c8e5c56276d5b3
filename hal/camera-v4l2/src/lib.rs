//! Stereo camera backend on two V4L2 devices.
//!
//! * [`pixels`] turns the bytes of a driver's buffer into a picture, from every format that is taken.
//! * [`video`] is what is needed of the operating system, call by call; [`linux`] is how Linux does it.

pub mod linux;
pub mod pixels;
pub mod video;
