//! Converts `YUYV` to red, green and blue in integer arithmetic: the vector kernels give the same bytes as the scalar code.
//!
//! The equations follow the kernel documentation, "Detailed Colorspace Descriptions" and "Defining Colorspaces in V4L2": Y' = Kr
//! R' + (1 - Kr - Kb) G' + Kb B', Cb = (B' - Y') / (2 (1 - Kb)), Cr = (R' - Y') / (2 (1 - Kr)), with Kr, Kb of ITU-R BT.601 or
//! BT.709; in the limited range black is 16, white 235, and colour differences span 16 to 240.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "aarch64")]
mod neon;
mod scalar;

/// Weights of the colours in the luminance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum YuvMatrix {
    /// ITU-R BT.601: Kr = 0.299, Kb = 0.114. The V4L2 default if a driver specifies no other (`V4L2_COLORSPACE_SRGB`).
    #[default]
    Bt601,
    /// ITU-R BT.709: Kr = 0.2126, Kb = 0.0722.
    Bt709,
}

/// Used part of the range 0 to 255.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum YuvRange {
    /// Luma 16 to 235, chroma 16 to 240. The V4L2 default if a driver specifies no other.
    #[default]
    Limited,
    /// The full range.
    Full,
}

/// Conversion kernels. All give the same bytes; they differ only in speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct YuvKernels(Family);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Family {
    Scalar,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "aarch64")]
    Neon,
}

impl YuvKernels {
    /// Portable code.
    pub const SCALAR: Self = Self(Family::Scalar);

    /// The fastest kernels of this processor.
    pub fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return Self(Family::Avx2);
        }
        #[cfg(target_arch = "aarch64")]
        if std::arch::is_aarch64_feature_detected!("neon") {
            return Self(Family::Neon);
        }
        Self::SCALAR
    }

    /// Name for reports.
    pub fn name(self) -> &'static str {
        match self.0 {
            Family::Scalar => "scalar",
            #[cfg(target_arch = "x86_64")]
            Family::Avx2 => "AVX2",
            #[cfg(target_arch = "aarch64")]
            Family::Neon => "NEON",
        }
    }
}

/// Fractional bits of the sums before rounding.
const FRACTION_BITS: i32 = 5;

/// The equations in 16-bit integers.
///
/// A product is `(a * b + 2^14) >> 15`, which processors have as one instruction. Luma enters as (Y - black) 2^7 and is
/// multiplied by 2^13 k, chroma as (C - 128) 2^8 and 2^12 k, so both products have 5 fractional bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Coefficients {
    /// Black, in units of 2^-7.
    black: i16,
    luma: i16,
    red_of_v: i16,
    /// Negative.
    green_of_u: i16,
    /// Negative.
    green_of_v: i16,
    blue_of_u: i16,
}

impl Coefficients {
    fn of(matrix: YuvMatrix, range: YuvRange) -> Self {
        let (kr, kb) = match matrix {
            YuvMatrix::Bt601 => (0.299, 0.114),
            YuvMatrix::Bt709 => (0.2126, 0.0722),
        };
        let (black, luma, chroma) = match range {
            YuvRange::Limited => (16, 255.0 / 219.0, 255.0 / 224.0),
            YuvRange::Full => (0, 1.0, 1.0),
        };
        let (red, blue) = (2.0 * (1.0 - kr), 2.0 * (1.0 - kb));
        let kg = 1.0 - kr - kb;
        let fixed = |value: f64, bits: i32| (value * f64::from(1 << bits)).round() as i16;
        Self {
            black: black << 7,
            luma: fixed(luma, 13),
            red_of_v: fixed(chroma * red, 12),
            green_of_u: fixed(-chroma * blue * kb / kg, 12),
            green_of_v: fixed(-chroma * red * kr / kg, 12),
            blue_of_u: fixed(chroma * blue, 12),
        }
    }
}

/// The equations of one matrix and range, in the form needed by each kernel family.
#[derive(Clone, Debug)]
pub(super) struct Equations {
    coefficients: Coefficients,
    tables: scalar::Tables,
}

impl Equations {
    pub(super) fn of(matrix: YuvMatrix, range: YuvRange) -> Self {
        let coefficients = Coefficients::of(matrix, range);
        Self { coefficients, tables: scalar::Tables::of(&coefficients) }
    }
}

/// Converts one row: four bytes per two pixels, to three bytes per pixel. An odd last pixel uses the first half of its four
/// bytes.
pub(super) fn convert_row(source: &[u8], target: &mut [u8], equations: &Equations, kernels: YuvKernels) {
    match kernels.0 {
        Family::Scalar => scalar::convert_row(source, target, &equations.tables),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: this family is created only in `YuvKernels::best`, which checks the processor.
        Family::Avx2 => unsafe { avx2::convert_row(source, target, equations) },
        #[cfg(target_arch = "aarch64")]
        // SAFETY: as above.
        Family::Neon => unsafe { neon::convert_row(source, target, equations) },
    }
}

#[cfg(test)]
mod tests;
