//! Numbers and lists in a form that YAML readers of every dialect accept.

use pb3dp_geometry::Distortion;

/// A number with the fewest digits that read back as the same number.
///
/// YAML 1.1 readers (PyYAML, so ROS) read `1e-7` as a string; a decimal point and a signed exponent make it a number everywhere.
pub(super) fn number(value: f64) -> String {
    let text = format!("{value:?}");
    let Some((mantissa, exponent)) = text.split_once('e') else {
        return text;
    };
    let point = if mantissa.contains('.') { "" } else { ".0" };
    let sign = if exponent.starts_with('-') { "" } else { "+" };
    format!("{mantissa}{point}e{sign}{exponent}")
}

/// `[a, b, c]`.
pub(super) fn list<'a>(values: impl IntoIterator<Item = &'a f64>) -> String {
    let numbers = values.into_iter().map(|value| number(*value)).collect::<Vec<_>>();
    format!("[{}]", numbers.join(", "))
}

/// The elements of a matrix row by row.
pub(super) fn row_major<const R: usize, const C: usize>(matrix: &nalgebra::SMatrix<f64, R, C>) -> Vec<f64> {
    matrix.transpose().as_slice().to_vec()
}

/// Model name and coefficients in ROS convention; an ideal lens is a `plumb_bob` of zeros.
pub(super) fn distortion(distortion: &Distortion) -> (&'static str, Vec<f64>) {
    match distortion {
        Distortion::None => ("plumb_bob", vec![0.0; 5]),
        Distortion::BrownConrady5 { coefficients } => ("plumb_bob", coefficients.to_vec()),
        Distortion::BrownConrady8 { coefficients } => ("rational_polynomial", coefficients.to_vec()),
        Distortion::Equidistant { coefficients } => ("equidistant", coefficients.to_vec()),
    }
}
