//! Sums in vector lanes, for the portable vector kernels ([`wide!`]).

pub use pb3dp_computing::wide;

/// Number of partial sums of a vectorised sum, 16: one AVX-512 register of single precision (two would be 32).
pub const LANES: usize = 16;

/// Adds the partial sums, always in the same order.
#[inline(always)]
pub fn sum_lanes(lanes: &[f32; LANES]) -> f32 {
    let mut eight: [f32; 8] = std::array::from_fn(|i| lanes[i] + lanes[i + 8]);
    for width in [4, 2, 1] {
        for i in 0..width {
            eight[i] += eight[i + width];
        }
    }
    eight[0]
}

#[cfg(test)]
mod tests {
    use pb3dp_estimation_test_support::every_kernel;

    use super::*;

    #[inline(always)]
    fn dot_kernel(a: &[f32], b: &[f32]) -> f32 {
        let mut lanes = [0.0; LANES];
        for (a, b) in a.chunks_exact(LANES).zip(b.chunks_exact(LANES)) {
            for i in 0..LANES {
                lanes[i] += a[i] * b[i];
            }
        }
        sum_lanes(&lanes)
    }

    wide! { fn dot(a: &[f32], b: &[f32]) -> f32 = dot_kernel; }

    #[test]
    fn every_width_gives_the_same_bits() {
        let values = |seed: u32| -> Vec<f32> {
            (0..512u32).map(|i| ((i.wrapping_mul(2_654_435_761) ^ seed) >> 8) as f32 * 1e-5 - 80.0).collect()
        };
        let (a, b) = (values(1), values(77));
        let plain = dot_kernel(&a, &b);
        for kernels in every_kernel() {
            assert_eq!(dot(kernels, &a, &b).to_bits(), plain.to_bits(), "{}", kernels.set().name());
        }
    }
}
