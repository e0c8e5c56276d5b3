//! Code shared by the measurements.

pub mod circumstances;
