//! Vector kernels from one source ([`wide!`]), and random numbers from a seed ([`rng`]): the same bits on every machine.

pub mod cpu;
pub mod rng;
mod wide;
