//! Lateness of cycles and of answers.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Bins per doubling of the lateness: figures are accurate to an eighth.
const PARTS: usize = 8;

/// Covers a lateness of up to a minute.
const BUCKETS: usize = PARTS * 24;

/// Lateness statistics.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Jitter {
    /// Number of cycles.
    pub cycles: u64,
    /// Median.
    pub p50: Duration,
    /// 99th percentile.
    pub p99: Duration,
    /// Maximum.
    pub max: Duration,
}

/// Histogram of lateness. Written by one thread and read by any, without blocking.
#[derive(Debug)]
pub struct JitterMeter {
    buckets: [AtomicU64; BUCKETS],
    max_nanos: AtomicU64,
}

impl Default for JitterMeter {
    fn default() -> Self {
        Self { buckets: [const { AtomicU64::new(0) }; BUCKETS], max_nanos: AtomicU64::new(0) }
    }
}

impl JitterMeter {
    /// Adds a lateness.
    pub fn record(&self, late: Duration) {
        let nanos = u64::try_from(late.as_nanos()).unwrap_or(u64::MAX);
        self.buckets[bucket(nanos / 1000)].fetch_add(1, Ordering::Relaxed);
        self.max_nanos.fetch_max(nanos, Ordering::Relaxed);
    }

    /// Number of values above this one; those in the same bin do not count.
    pub fn later_than(&self, limit: Duration) -> u64 {
        let last = bucket(u64::try_from(limit.as_micros()).unwrap_or(u64::MAX));
        self.buckets[last + 1..].iter().map(|count| count.load(Ordering::Relaxed)).sum()
    }

    /// The figures so far; the percentiles are accurate to an eighth, rounded up.
    pub fn summary(&self) -> Jitter {
        let counts = self.buckets.each_ref().map(|count| count.load(Ordering::Relaxed));
        let cycles: u64 = counts.iter().sum();
        let max = Duration::from_nanos(self.max_nanos.load(Ordering::Relaxed));
        let at_most = |percent: u64| {
            let wanted = (cycles * percent).div_ceil(100);
            let mut counted = 0;
            let found = counts.iter().position(|count| {
                counted += count;
                counted >= wanted
            });
            found.map_or(max, |index| Duration::from_micros(upper_bound_us(index)).min(max))
        };
        Jitter { cycles, p50: at_most(50), p99: at_most(99), max }
    }
}

fn bucket(us: u64) -> usize {
    if us < PARTS as u64 {
        return us as usize;
    }
    let octave = us.ilog2();
    let part = (us >> (octave - PARTS.ilog2())) as usize % PARTS;
    let index = (octave - PARTS.ilog2() + 1) as usize * PARTS + part;
    index.min(BUCKETS - 1)
}

fn upper_bound_us(index: usize) -> u64 {
    let (octave, part) = (index / PARTS, (index % PARTS) as u64);
    if octave == 0 { part + 1 } else { (PARTS as u64 + part + 1) << (octave - 1) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_lateness_falls_below_the_bound_of_its_bucket_and_above_the_one_before() {
        for us in (0..5000).chain((12..25).map(|power| (1 << power) + 77)) {
            let index = bucket(us);
            assert!(us < upper_bound_us(index), "{us} in {index}");
            assert!(index == 0 || us >= upper_bound_us(index - 1), "{us} in {index}");
            assert!(upper_bound_us(index) <= us + 1 + us / 8, "{us}: {}", upper_bound_us(index));
        }
        assert_eq!(bucket(u64::MAX), BUCKETS - 1);
    }

    #[test]
    fn figures_are_those_of_the_cycles() {
        let meter = JitterMeter::default();
        assert_eq!(meter.summary(), Jitter::default());
        for cycle in 0..1000 {
            let late_us = if cycle % 100 == 0 { 3000 } else { 40 };
            meter.record(Duration::from_micros(late_us));
        }
        meter.record(Duration::from_nanos(7_654_321));
        let later = [39, 2800, 5000, 7000, 8000].map(|us| meter.later_than(Duration::from_micros(us)));
        assert_eq!(later, [1001, 11, 1, 1, 0]);
        let Jitter { cycles, p50, p99, max } = meter.summary();
        assert_eq!((cycles, max), (1001, Duration::from_nanos(7_654_321)));
        assert!(p50 > Duration::from_micros(40) && p50 <= Duration::from_micros(45), "{p50:?}");
        assert!(p99 > Duration::from_micros(3000) && p99 <= Duration::from_micros(3375), "{p99:?}");
    }
}
