//! What the measurements share.

pub mod cpu_time;
