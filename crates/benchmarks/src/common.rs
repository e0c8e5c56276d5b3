//! What the measurements share.

pub mod circumstances;
pub mod cpu_time;
