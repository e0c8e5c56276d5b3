//! Kernels from one source, compiled for several vector widths.
//!
//! The body of a kernel is an `#[inline(always)]` function. [`wide!`] compiles it for every processor (on aarch64 that
//! includes NEON), for AVX2 and for AVX-512, and calls the version that the given [`Kernels`](crate::cpu::Kernels) prove to
//! run here. Rust neither reorders nor fuses floating-point operations, so all versions give the same bits: sums that are to
//! run in vector lanes are written as such, with [`LANES`] partial sums.

/// Partial sums of a vectorised sum: two AVX-512 registers of single precision would be 32, one is 16.
pub const LANES: usize = 16;

/// Defines a function that runs a kernel (an `#[inline(always)]` function of the same arguments) with the vectors of the
/// [`Kernels`](crate::cpu::Kernels) that it gets as its first argument.
#[macro_export]
macro_rules! wide {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) $(-> $out:ty)? = $kernel:path;) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments, reason = "a kernel takes its buffers one by one")]
        $vis fn $name(kernels: $crate::cpu::Kernels, $($arg: $type),*) $(-> $out)? {
            #[cfg(target_arch = "x86_64")]
            {
                #[target_feature(enable = "avx2")]
                #[allow(clippy::too_many_arguments, reason = "as above")]
                fn with_avx2($($arg: $type),*) $(-> $out)? {
                    $kernel($($arg),*)
                }
                #[target_feature(enable = "avx512f,avx512bw,avx512vl,avx512dq")]
                #[allow(clippy::too_many_arguments, reason = "as above")]
                fn with_avx512($($arg: $type),*) $(-> $out)? {
                    $kernel($($arg),*)
                }
                match kernels.set() {
                    // SAFETY: `Kernels` of this set exist only where the processor has AVX-512 F, BW, VL and DQ.
                    $crate::cpu::KernelSet::Avx512 => return unsafe { with_avx512($($arg),*) },
                    // SAFETY: `Kernels` of this set exist only where the processor has AVX2.
                    $crate::cpu::KernelSet::Avx2 => return unsafe { with_avx2($($arg),*) },
                    $crate::cpu::KernelSet::Scalar => {}
                }
            }
            let _ = kernels;
            $kernel($($arg),*)
        }
    };
}
pub use wide;

/// The sum of partial sums, always in the same order.
#[inline(always)]
#[allow(dead_code, reason = "the first kernels that sum are on their way")]
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
    use super::*;
    use crate::cpu::every_kernel;

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
