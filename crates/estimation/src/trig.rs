//! Sine and cosine that give the same bits on every platform: the system libraries differ in the last place, and the same
//! seed must give the same answer everywhere.

/// Terms of the power series behind the first; the last one is below half a unit in the last place at pi/2.
const TERMS: usize = 11;

/// `1 / ((2k + 2)(2k + 3))` and `1 / ((2k + 1)(2k + 2))`: quotients of successive terms of sin x / x and of cos x.
const QUOTIENTS: [(f64, f64); TERMS] = quotients();

const fn quotients() -> [(f64, f64); TERMS] {
    let mut table = [(0.0, 0.0); TERMS];
    let mut k = 0;
    while k < TERMS {
        let n = (2 * k + 2) as f64;
        table[k] = (1.0 / (n * (n + 1.0)), 1.0 / (n * (n - 1.0)));
        k += 1;
    }
    table
}

/// Sine and cosine of an angle in `[-pi/2, pi/2]` radians; error below 5e-16 there, growing outside.
#[inline]
pub(crate) fn sin_cos(angle_rad: f64) -> (f64, f64) {
    let square = angle_rad * angle_rad;
    let (mut sine, mut cosine) = (1.0, 1.0);
    // Horner from the smallest term: sin x / x = 1 - x2/(2*3) (1 - x2/(4*5) (...)), cos x = 1 - x2/(1*2) (1 - x2/(3*4) (...)).
    for (of_sine, of_cosine) in QUOTIENTS.iter().rev() {
        sine = 1.0 - square * of_sine * sine;
        cosine = 1.0 - square * of_cosine * cosine;
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
