//! Test benches for the PA-10 driver, its link and its gateway. For tests only.
//!
//! * In virtual time: [`driver_bench`], [`link_rig`], [`bus_bench`], [`chain`], [`gateway_bench`], [`byte_bus`].
//! * In real time: [`far_end`] and [`cell_end`] serve the other end of a line, [`arm_rig`] is an arm with such an end, [`world`]
//!   an emulated controller with a host.
//! * In the kernel: [`tunnel`] is the far end of an ARCNET interface.
//! * Bodies of the fuzz targets: [`codec_abuse`], [`gateway_abuse`].

#![allow(missing_docs, clippy::new_without_default, clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

pub mod arm_rig;
pub mod bus_bench;
pub mod bus_link;
pub mod byte_bus;
pub mod byte_links;
pub mod cell_end;
pub mod chain;
pub mod codec_abuse;
pub mod driver_bench;
pub mod far_end;
pub mod gateway;
pub mod gateway_abuse;
pub mod gateway_bench;
pub mod injection;
pub mod link_rig;
pub mod plant_config;
pub mod tunnel;
pub mod world;
