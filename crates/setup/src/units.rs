//! Ranges of the parts, which are in SI units, in the units of a file.

use std::ops::RangeInclusive;

/// A range in metres, as millimetres.
pub(crate) fn in_mm(metres: RangeInclusive<f64>) -> RangeInclusive<f64> {
    converted(metres, 1e3)
}

/// A range in seconds, as milliseconds.
pub(crate) fn in_millis(seconds: RangeInclusive<f64>) -> RangeInclusive<f64> {
    converted(seconds, 1e3)
}

/// A range in radians, as degrees.
pub(crate) fn in_deg(radians: RangeInclusive<f64>) -> RangeInclusive<f64> {
    converted(radians, 1f64.to_degrees())
}

/// The range times a factor, with ends of at most four digits inside it.
fn converted(range: RangeInclusive<f64>, factor: f64) -> RangeInclusive<f64> {
    let (start, end) = range.into_inner();
    four_digits(start * factor, f64::ceil)..=four_digits(end * factor, f64::floor)
}

/// `value` with four digits: the nearest number if only rounding errors differ, otherwise that of `inwards`.
fn four_digits(value: f64, inwards: fn(f64) -> f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let decimals = 4 - value.abs().log10().ceil() as i32;
    let scaled = value * 10f64.powi(decimals);
    let nearest = scaled.round();
    let whole = if (scaled - nearest).abs() < ROUNDING { nearest } else { inwards(scaled) };
    // Division by a power of ten is exact to the last digit, multiplication by its inverse is not.
    if decimals >= 0 { whole / 10f64.powi(decimals) } else { whole * 10f64.powi(-decimals) }
}

/// Rounding errors of a conversion, in units of the fourth digit.
const ROUNDING: f64 = 1e-6;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_rounded_inwards() {
        assert_eq!(in_mm(1e-6..=2.0), 0.001..=2000.0);
        assert_eq!(in_mm(1e-4..=100.0), 0.1..=100_000.0);
        assert_eq!(in_deg(0.001..=6.0), 0.0573..=343.7);
        assert_eq!(in_deg(-0.5..=0.5), -28.64..=28.64);
        assert_eq!(in_deg(0.0..=std::f64::consts::PI), 0.0..=180.0);
        assert_eq!(in_millis(0.0001..=0.05), 0.1..=50.0);
    }
}
