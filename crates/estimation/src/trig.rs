//! Sine and cosine that give the same bits on every platform: the system libraries differ in the last place, and the same
//! seed must give the same answer everywhere.

/// Terms of the power series; the last one is below half a unit in the last place at pi/2.
const TERMS: u32 = 11;

/// Sine and cosine of an angle in `[-pi/2, pi/2]` radians; error below 4e-16 there, growing outside.
pub(crate) fn sin_cos(angle_rad: f64) -> (f64, f64) {
    let square = angle_rad * angle_rad;
    let (mut sine, mut cosine) = (1.0, 1.0);
    // Horner from the smallest term: sin x / x = 1 - x2/(2*3) (1 - x2/(4*5) (...)), cos x = 1 - x2/(1*2) (1 - x2/(3*4) (...)).
    let mut k = TERMS;
    while k > 0 {
        let n = f64::from(2 * k);
        sine = 1.0 - square / (n * (n + 1.0)) * sine;
        cosine = 1.0 - square / (n * (n - 1.0)) * cosine;
        k -= 1;
    }
    (angle_rad * sine, cosine)
}

#[cfg(test)]
mod tests {
    use super::sin_cos;

    #[test]
    fn agrees_with_the_system_library() {
        for i in -1570..=1570 {
            let angle = f64::from(i) * 1e-3;
            let (s, c) = sin_cos(angle);
            assert!((s - angle.sin()).abs() < 5e-16, "sin {angle}");
            assert!((c - angle.cos()).abs() < 5e-16, "cos {angle}");
        }
    }

    #[test]
    fn exact_at_zero() {
        assert_eq!(sin_cos(0.0), (0.0, 1.0));
    }
}
