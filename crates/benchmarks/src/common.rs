//! What the measurements share.

pub mod circumstances;
