//! Confidence intervals of a NEES.

/// Standard normal quantile of 97.5 %.
const Z_975: f64 = 1.959_963_985;

/// Quantile of the chi-square distribution with `freedom` degrees of freedom at the standard normal quantile `z`, over
/// `freedom`: the cube of Wilson and Hilferty (1931, eq 7), accurate to 1 % from ten degrees of freedom on.
fn relative_quantile(freedom: f64, z: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    (1.0 - spread + z * spread.sqrt()).max(0.0).powi(3)
}

/// 95 % interval of the ratio of true to stated variance, from a NEES of `freedom` independent squared errors: the NEES
/// over the quantiles of chi-square over its degrees of freedom.
pub fn interval(nees: f64, freedom: f64) -> [f64; 2] {
    [Z_975, -Z_975].map(|z| nees / relative_quantile(freedom, z).max(f64::MIN_POSITIVE))
}

/// Degrees of freedom of the mean of independent positive values, by their spread (Satterthwaite 1946): a chi-square
/// variable over its degrees of freedom n has the variance 2 / n. `None` for less than two values or equal ones.
pub fn freedom_of_mean(values: &[f64]) -> Option<f64> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (values.len() >= 2 && variance > 0.0).then(|| 2.0 * count * mean * mean / variance)
}

#[cfg(test)]
mod tests {
    use super::super::random::Random;
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_tables() {
        // Chi-square tables: 97.5 % and 2.5 % for 10, 100 and 600 degrees of freedom.
        for (freedom, high, low) in [(10.0, 20.483, 3.247), (100.0, 129.561, 74.222), (600.0, 669.769, 534.019)] {
            assert!((freedom * relative_quantile(freedom, Z_975) / high - 1.0).abs() < 2e-3, "{freedom}");
            assert!((freedom * relative_quantile(freedom, -Z_975) / low - 1.0).abs() < 1e-2, "{freedom}");
        }
        let [low, high] = interval(1.0, 600.0);
        assert!((low - 600.0 / 669.769).abs() < 1e-3 && (high - 600.0 / 534.019).abs() < 1e-3);
    }

    #[test]
    fn the_spread_of_sequences_tells_their_degrees_of_freedom() {
        // Each value is the mean of three squares of normal numbers: three degrees of freedom each.
        let normal = |random: &mut Random| (0..12).map(|_| random.between(-0.5, 0.5)).sum::<f64>();
        let mut random = Random::of(1, "freedom", 0);
        let values: Vec<f64> =
            (0..3000).map(|_| (0..3).map(|_| normal(&mut random).powi(2)).sum::<f64>() / 3.0).collect();
        let freedom = freedom_of_mean(&values).unwrap();
        assert!((freedom / 9000.0 - 1.0).abs() < 0.1, "{freedom}");
        assert_eq!(freedom_of_mean(&[1.0]), None);
        assert_eq!(freedom_of_mean(&[1.0, 1.0]), None);
    }
}
