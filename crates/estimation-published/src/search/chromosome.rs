//! Chromosomes: 24 bits for three unknowns, 10 for the depth, 7 and 7 for the tilts.

use pb3dp_estimation_core::plane_hypothesis::{PlaneHypothesis, SearchRange};

/// Number of bits of the depth.
pub const Z_BITS: u32 = 10;
/// Number of bits of each tilt.
pub const TILT_BITS: u32 = 7;
/// Number of bits of a chromosome.
pub const BITS: u32 = Z_BITS + 2 * TILT_BITS;
/// Number of depth codes.
pub const Z_CODES: u32 = 1 << Z_BITS;
/// Number of codes of each tilt.
pub const TILT_CODES: u32 = 1 << TILT_BITS;

/// An individual: from the highest bit, 10 bits of z, 7 of theta_x, 7 of theta_y.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Chromosome(u32);

impl Chromosome {
    /// The last chromosome: all bits set.
    pub const LAST: Self = Self((1 << BITS) - 1);

    /// Creates a chromosome from the lowest 24 bits of a word.
    pub fn from_bits(bits: u32) -> Self {
        Self(bits & ((1 << BITS) - 1))
    }

    /// The 24 bits.
    pub fn bits(self) -> u32 {
        self.0
    }

    /// Combines the bits `first..end` (counted from the lowest) of `other` with the remaining bits of `self`.
    #[must_use]
    pub fn crossed(self, other: Self, first: u32, end: u32) -> Self {
        let mask = ((1u32 << end) - 1) & !((1u32 << first) - 1);
        Self((self.0 & !mask) | (other.0 & mask))
    }

    /// Flips bit `bit` (counted from the lowest, below 24).
    #[must_use]
    pub fn flipped(self, bit: u32) -> Self {
        Self(self.0 ^ (1 << bit))
    }
}

/// Binary coding of a number in a gene. The paper does not define it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Coding {
    /// Plain binary.
    Binary,
    /// Gray code: consecutive numbers differ in one bit. The default: no Hamming cliffs.
    #[default]
    Gray,
}

/// Codes of the three genes as integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Codes {
    /// Depth, 0 to 1023.
    pub z: u32,
    /// First tilt, 0 to 127.
    pub theta_x: u32,
    /// Second tilt, 0 to 127.
    pub theta_y: u32,
}

/// Converts between chromosomes and hypotheses: each gene covers its part of the search range linearly, both ends included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Codec {
    range: SearchRange,
    coding: Coding,
}

impl Codec {
    /// Creates a codec for a search range.
    pub fn new(range: SearchRange, coding: Coding) -> Self {
        Self { range, coding }
    }

    /// The search range.
    pub fn range(&self) -> &SearchRange {
        &self.range
    }

    /// Depth step, metres.
    pub fn z_step_m(&self) -> f64 {
        (self.range.z_max_m - self.range.z_min_m) / f64::from(Z_CODES - 1)
    }

    /// Tilt step, radians.
    pub fn tilt_step_rad(&self) -> f64 {
        2.0 * self.range.tilt_max_rad / f64::from(TILT_CODES - 1)
    }

    /// The hypothesis of a chromosome.
    pub fn decode(&self, chromosome: Chromosome) -> PlaneHypothesis {
        self.hypothesis(self.codes(chromosome))
    }

    /// The hypothesis of three codes.
    pub fn hypothesis(&self, codes: Codes) -> PlaneHypothesis {
        // The centre is the sum of the ends, so that codes k and 127 - k give exactly opposite tilts.
        let tilt = |code: u32| {
            let numerator = 2 * i64::from(code) - i64::from(TILT_CODES - 1);
            self.range.tilt_max_rad * numerator as f64 / f64::from(TILT_CODES - 1)
        };
        PlaneHypothesis {
            z_m: self.range.z_min_m + f64::from(codes.z) * self.z_step_m(),
            theta_x_rad: tilt(codes.theta_x),
            theta_y_rad: tilt(codes.theta_y),
        }
    }

    /// The chromosome with the nearest hypothesis; values outside the range are clamped.
    pub fn encode(&self, psi: &PlaneHypothesis) -> Chromosome {
        let code = |value: f64, step: f64, max: u32| (value / step).round().clamp(0.0, f64::from(max)) as u32;
        let tilt = |angle_rad: f64| match self.range.tilt_max_rad {
            0.0 => TILT_CODES / 2,
            max_rad => code(angle_rad + max_rad, self.tilt_step_rad(), TILT_CODES - 1),
        };
        self.chromosome(Codes {
            z: code(psi.z_m - self.range.z_min_m, self.z_step_m(), Z_CODES - 1),
            theta_x: tilt(psi.theta_x_rad),
            theta_y: tilt(psi.theta_y_rad),
        })
    }

    /// The codes of a chromosome.
    pub fn codes(&self, chromosome: Chromosome) -> Codes {
        let bits = chromosome.bits();
        let number = |gene: u32, width: u32| match self.coding {
            Coding::Binary => gene,
            Coding::Gray => number_from_gray(gene, width),
        };
        Codes {
            z: number(bits >> (2 * TILT_BITS), Z_BITS),
            theta_x: number((bits >> TILT_BITS) & (TILT_CODES - 1), TILT_BITS),
            theta_y: number(bits & (TILT_CODES - 1), TILT_BITS),
        }
    }

    /// The chromosome of given codes; each is truncated to its gene's width.
    pub fn chromosome(&self, codes: Codes) -> Chromosome {
        let gene = |number: u32, count: u32| {
            let number = number & (count - 1);
            match self.coding {
                Coding::Binary => number,
                Coding::Gray => number ^ (number >> 1),
            }
        };
        let (z, x, y) = (gene(codes.z, Z_CODES), gene(codes.theta_x, TILT_CODES), gene(codes.theta_y, TILT_CODES));
        Chromosome::from_bits(z << (2 * TILT_BITS) | x << TILT_BITS | y)
    }
}

fn number_from_gray(gray: u32, width: u32) -> u32 {
    let mut number = gray;
    let mut shift = 1;
    while shift < width {
        number ^= number >> shift;
        shift *= 2;
    }
    number
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn codec(coding: Coding) -> Codec {
        Codec::new(SearchRange::new(0.35, 0.65, 0.6).expect("range"), coding)
    }

    #[test]
    fn steps_are_those_of_the_method() {
        // docs: z +-150 mm in 10 bits is 0.29 mm per step.
        let codec = codec(Coding::Gray);
        assert!((codec.z_step_m() - 0.3 / 1023.0).abs() < 1e-15);
        assert!((codec.tilt_step_rad() - 1.2 / 127.0).abs() < 1e-15);
    }

    #[test]
    fn ends_of_the_range_are_reached() {
        for coding in [Coding::Binary, Coding::Gray] {
            let codec = codec(coding);
            let first = codec.hypothesis(Codes { z: 0, theta_x: 0, theta_y: 127 });
            let last = codec.hypothesis(Codes { z: 1023, theta_x: 127, theta_y: 0 });
            assert_eq!((first.z_m, first.theta_x_rad, first.theta_y_rad), (0.35, -0.6, 0.6));
            assert!((last.z_m - 0.65).abs() < 1e-12);
            assert_eq!((last.theta_x_rad, last.theta_y_rad), (0.6, -0.6));
            assert!(codec.range().contains(&last));
        }
    }

    #[test]
    fn layout_is_ten_seven_seven() {
        let codes = Codes { z: 0b10_0000_0001, theta_x: 0b100_0001, theta_y: 0b110_0001 };
        let chromosome = codec(Coding::Binary).chromosome(codes);
        assert_eq!(format!("{:024b}", chromosome.bits()), ["1000000001", "1000001", "1100001"].concat());
        // Gray: 1000000001 -> 1100000001, 1000001 -> 1100001, 1100001 -> 1010001.
        let gray = codec(Coding::Gray).chromosome(codes);
        assert_eq!(format!("{:024b}", gray.bits()), ["1100000001", "1100001", "1010001"].concat());
    }

    #[test]
    fn gray_neighbours_differ_in_one_bit() {
        let codec = codec(Coding::Gray);
        let bits = |z| codec.chromosome(Codes { z, theta_x: 5, theta_y: 9 }).bits();
        for z in 1..Z_CODES {
            assert_eq!((bits(z) ^ bits(z - 1)).count_ones(), 1, "z code {z}");
        }
    }

    #[test]
    fn crossover_takes_the_bits_between_the_points() {
        let (ones, zeros) = (Chromosome::from_bits(u32::MAX), Chromosome::from_bits(0));
        assert_eq!(ones.bits(), 0xFF_FFFF);
        assert_eq!(zeros.crossed(ones, 4, 9).bits(), 0b1_1111_0000);
        assert_eq!(zeros.crossed(ones, 0, 24).bits(), 0xFF_FFFF);
        assert_eq!(ones.crossed(zeros, 3, 3).bits(), 0xFF_FFFF);
    }

    #[test]
    fn a_fixed_tilt_encodes() {
        let codec = Codec::new(SearchRange::new(0.3, 0.5, 0.0).expect("range"), Coding::Gray);
        let psi = PlaneHypothesis { z_m: 0.4, theta_x_rad: 0.1, theta_y_rad: 0.0 };
        let back = codec.decode(codec.encode(&psi));
        assert_eq!((back.theta_x_rad, back.theta_y_rad), (0.0, 0.0));
    }

    proptest! {
        #[test]
        fn every_chromosome_survives(bits in 0u32..1 << BITS) {
            for coding in [Coding::Binary, Coding::Gray] {
                let codec = codec(coding);
                let chromosome = Chromosome::from_bits(bits);
                prop_assert_eq!(codec.encode(&codec.decode(chromosome)), chromosome);
                prop_assert_eq!(codec.chromosome(codec.codes(chromosome)), chromosome);
            }
        }

        #[test]
        fn encoding_is_within_half_a_step(z in 0.35..0.65, x in -0.6..0.6, y in -0.6..0.6) {
            let codec = codec(Coding::Gray);
            let back = codec.decode(codec.encode(&PlaneHypothesis { z_m: z, theta_x_rad: x, theta_y_rad: y }));
            prop_assert!((back.z_m - z).abs() <= 0.5001 * codec.z_step_m());
            prop_assert!((back.theta_x_rad - x).abs() <= 0.5001 * codec.tilt_step_rad());
            prop_assert!((back.theta_y_rad - y).abs() <= 0.5001 * codec.tilt_step_rad());
        }
    }
}
