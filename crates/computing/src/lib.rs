//! Vector kernels ([`wide!`]) and seeded random numbers ([`rng`]) with bit-identical results on every machine.

pub mod cpu;
pub mod rng;
mod wide;
