//! Kernels compiled twice: for every processor, and for those with AVX2.
//!
//! Both versions are the same source. Rust neither reorders nor fuses floating-point operations, so the results are equal
//! bit for bit; a test of the renderer compares them.

/// Defines a function that runs a kernel (an `#[inline(always)]` function of the same arguments) with the widest vectors.
macro_rules! wide {
    ($(#[$meta:meta])* $vis:vis fn $name:ident($($arg:ident: $type:ty),* $(,)?) = $kernel:path;) => {
        $(#[$meta])*
        $vis fn $name($($arg: $type),*) {
            #[cfg(target_arch = "x86_64")]
            if $crate::wide::has_avx2() {
                #[target_feature(enable = "avx2")]
                fn with_avx2($($arg: $type),*) {
                    $kernel($($arg),*)
                }
                // SAFETY: the processor has AVX2, as was just asked.
                return unsafe { with_avx2($($arg),*) };
            }
            $kernel($($arg),*)
        }
    };
}
pub(crate) use wide;

/// Whether the processor has AVX2 (and no test has switched it off).
#[cfg(target_arch = "x86_64")]
pub(crate) fn has_avx2() -> bool {
    #[cfg(test)]
    if tests::PLAIN_ONLY.with(std::cell::Cell::get) {
        return false;
    }
    std::arch::is_x86_feature_detected!("avx2")
}

#[cfg(test)]
pub(crate) mod tests {
    use std::cell::Cell;

    thread_local! {
        pub(crate) static PLAIN_ONLY: Cell<bool> = const { Cell::new(false) };
    }

    /// Whether this processor can run both.
    pub(crate) fn has_two_versions() -> bool {
        #[cfg(target_arch = "x86_64")]
        return super::has_avx2();
        #[cfg(not(target_arch = "x86_64"))]
        false
    }

    /// Runs `f` with the kernels for every processor.
    pub(crate) fn without_avx2<T>(f: impl FnOnce() -> T) -> T {
        PLAIN_ONLY.with(|plain| plain.set(true));
        let result = f();
        PLAIN_ONLY.with(|plain| plain.set(false));
        result
    }
}
