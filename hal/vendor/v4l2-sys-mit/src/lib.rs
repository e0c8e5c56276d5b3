//! Structures and numbers of the kernel's header `linux/videodev2.h`, for the crate `v4l`.
//!
//! In the place of the crate of this name on crates.io, which makes them anew in every build and needs libclang for it. Only what `v4l` and
//! `pb3dp-camera-v4l2` use is here. README.md says how it was made.

#![allow(non_camel_case_types, non_snake_case, non_upper_case_globals, missing_docs)]
#![allow(clippy::all, clippy::pedantic)]

#[cfg(not(all(target_os = "linux", target_pointer_width = "64", target_endian = "little")))]
compile_error!("src/bindings.rs was made for 64-bit little-endian Linux: run generate.sh for this target");

mod bindings;
pub use bindings::*;
