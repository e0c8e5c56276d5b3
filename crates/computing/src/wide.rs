//! Portable vector kernels: one source, compiled for several vector widths.
//!
//! The body of a kernel is an `#[inline(always)]` function. [`wide!`](crate::wide!) compiles it for every processor (on aarch64
//! that includes NEON), for AVX2 and for AVX-512. It calls the version that the given [`Kernels`](crate::cpu::Kernels) permit.
//! Rust neither reorders nor fuses floating-point operations, so all versions give bit-identical results. Sums in vector lanes
//! are therefore written explicitly with partial sums.

/// Defines a function that runs a kernel (an `#[inline(always)]` function of the same arguments) with the vectors of the
/// [`Kernels`](crate::cpu::Kernels) passed as its first argument.
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
