//! Random numbers of one pose of one configuration, independent of the other measurements.

use pb3dp_sim::noise::{hash, unit};

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Random {
    words: [u32; 3],
    count: u32,
}

impl Random {
    /// The stream of one pose of the configuration or sequence `name`.
    pub fn of(seed: u32, name: &str, pose: usize) -> Self {
        Self { words: [seed, hash_of(name), pose as u32], count: 0 }
    }

    /// The next number, uniform between two limits.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        self.count += 1;
        let [seed, name, pose] = self.words;
        low + (high - low) * unit(hash(&[seed, name, pose, self.count]))
    }
}

/// Hash of a name.
pub fn hash_of(name: &str) -> u32 {
    hash(&name.bytes().map(u32::from).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_even_and_their_own() {
        let numbers = |name: &str, pose: usize| {
            let mut random = Random::of(3, name, pose);
            (0..500).map(|_| random.between(-1.0, 3.0)).collect::<Vec<_>>()
        };
        let one = numbers("noise/8", 4);
        let mean = one.iter().sum::<f64>() / 500.0;
        assert!((mean - 1.0).abs() < 0.2, "{mean}");
        assert!(one.iter().all(|x| (-1.0..3.0).contains(x)));
        assert_eq!(one, numbers("noise/8", 4));
        assert_ne!(one, numbers("noise/8", 5));
        assert_ne!(one, numbers("noise/4", 4));
    }
}
