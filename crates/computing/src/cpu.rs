//! Selection of the vector kernels at run time, from the instruction sets of the processor.

/// A family of kernels. All families give bit-identical results; they differ in speed only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum KernelSet {
    /// Portable code, on every processor.
    Scalar,
    /// 256-bit vectors (x86-64 with AVX2).
    Avx2,
    /// 512-bit vectors (x86-64 with AVX-512 F, BW, VL and DQ).
    Avx512,
}

impl KernelSet {
    /// All families, slowest first.
    pub const ALL: [Self; 3] = [Self::Scalar, Self::Avx2, Self::Avx512];

    /// The fastest family that this processor can run.
    pub fn best() -> Self {
        Self::ALL.into_iter().rev().find(|set| set.is_available()).unwrap_or(Self::Scalar)
    }

    /// Whether this processor can run the family.
    pub fn is_available(self) -> bool {
        match self {
            Self::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => std::arch::is_x86_feature_detected!("avx2"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                std::arch::is_x86_feature_detected!("avx512f")
                    && std::arch::is_x86_feature_detected!("avx512bw")
                    && std::arch::is_x86_feature_detected!("avx512vl")
                    && std::arch::is_x86_feature_detected!("avx512dq")
            }
            #[cfg(not(target_arch = "x86_64"))]
            Self::Avx2 | Self::Avx512 => false,
        }
    }

    /// Name for reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Avx2 => "AVX2",
            Self::Avx512 => "AVX-512",
        }
    }
}

/// A family that this processor is known to support. The kernels require it as an argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Kernels(KernelSet);

impl Kernels {
    /// The fastest family of this processor.
    pub fn best() -> Self {
        Self(KernelSet::best())
    }

    /// The given family, if this processor has its instructions.
    pub fn of(set: KernelSet) -> Option<Self> {
        set.is_available().then_some(Self(set))
    }

    /// The families that this processor can run, slowest first.
    pub fn available() -> impl Iterator<Item = Self> {
        KernelSet::ALL.into_iter().filter(|set| set.is_available()).map(Self)
    }

    /// The family of these kernels.
    pub fn set(self) -> KernelSet {
        self.0
    }
}

impl Default for Kernels {
    fn default() -> Self {
        Self::best()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scalar_runs_everywhere_and_best_is_available() {
        assert!(KernelSet::Scalar.is_available());
        assert!(Kernels::of(KernelSet::best()).is_some());
        assert_eq!(Kernels::available().last(), Some(Kernels::best()));
    }
}
