//! Random numbers from a seed: the same on every machine.

use pb3dp_sim::noise::{hash, unit};

/// A sequence of random numbers.
#[derive(Clone, Debug)]
pub(super) struct Random {
    seed: u64,
    count: u64,
}

impl Random {
    pub fn new(seed: u64) -> Self {
        Self { seed, count: 0 }
    }

    fn next(&mut self) -> u32 {
        self.count += 1;
        let halves = |value: u64| [(value & 0xFFFF_FFFF) as u32, (value >> 32) as u32];
        let ([a, b], [c, d]) = (halves(self.seed), halves(self.count));
        hash(&[a, b, c, d])
    }

    /// From 0 to below 1.
    pub fn unit(&mut self) -> f64 {
        unit(self.next())
    }

    /// From 0 to below `count`; 0 if `count` is 0.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count.saturating_sub(1))
    }
}
