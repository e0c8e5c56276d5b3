//! `pb3dp run`: cameras, estimation, servo and arms in one loop.

pub mod cell;
pub mod log;
pub mod summary;
