//! Positions of the links of a PA-10, from its Denavit-Hartenberg table.
//!
//! Standard (distal) convention, T_i = Rz(q_i) Tz(d_i) Rx(alpha_i), a = 0 and no offsets of the angles:
//!
//! | i | axis | alpha_i | d_i |
//! |---|---|---|---|
//! | 1 | S1 | -90 degrees | base to shoulder |
//! | 2 | S2 | +90 | 0 |
//! | 3 | S3 | -90 | shoulder to elbow |
//! | 4 | E1 | +90 | 0 |
//! | 5 | E2 | -90 | elbow to wrist |
//! | 6 | W1 | +90 | 0 |
//! | 7 | W2 | 0 | wrist to flange |
//!
//! Lengths of the PA10-7CE: `KinematicData.maple` of INRIA's HuMAnS toolbox (2005), and `modelMitsubishiPA10` of OpenBionics.

use super::truth::{Joints, Placement};

/// Lengths of the PA10-7CE (second generation), metres.
pub const SECOND_GENERATION_M: Lengths = Lengths { shoulder: 0.317, elbow: 0.450, wrist: 0.480, flange: 0.070 };
/// Lengths of the first generation, metres.
pub const FIRST_GENERATION_M: Lengths = Lengths { shoulder: 0.315, elbow: 0.450, wrist: 0.500, flange: 0.080 };

/// d1, d3, d5 and d7 of the table, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lengths {
    /// From the base.
    pub shoulder: f64,
    /// From the shoulder.
    pub elbow: f64,
    /// From the elbow.
    pub wrist: f64,
    /// From the wrist.
    pub flange: f64,
}

/// Positions of the joint axes' intersections and of the flange, in `base`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Links {
    /// Metres.
    pub shoulder_m: [f64; 3],
    /// Metres.
    pub elbow_m: [f64; 3],
    /// Metres.
    pub wrist_m: [f64; 3],
    /// `base_from_flange`.
    pub flange: Placement,
}

/// Forward kinematics: positions of the links in `base` from angles in radians.
pub fn links(lengths: &Lengths, q_rad: &Joints) -> Links {
    let Lengths { shoulder, elbow, wrist, flange } = *lengths;
    let d_m = [shoulder, 0.0, elbow, 0.0, wrist, 0.0, flange];
    let sine_of_alpha = [-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, 0.0];
    let mut at = Placement::IDENTITY;
    let mut after = [at; 7];
    for joint in 0..7 {
        at = at.then(&transform(q_rad[joint], d_m[joint], sine_of_alpha[joint]));
        after[joint] = at;
    }
    Links {
        shoulder_m: after[0].translation_m,
        elbow_m: after[2].translation_m,
        wrist_m: after[4].translation_m,
        flange: after[6],
    }
}

/// Rz(q) Tz(d) Rx(alpha) for alpha of -90, 0 or +90 degrees, given by its sine.
fn transform(q_rad: f64, d_m: f64, sine_of_alpha: f64) -> Placement {
    let (s, c) = q_rad.sin_cos();
    let (sa, ca) = (sine_of_alpha, 1.0 - sine_of_alpha.abs());
    Placement { rotation: [[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]], translation_m: [0.0, 0.0, d_m] }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Golden vectors from the product of the joint chain Rz Tz Ry Rz Tz Ry Rz Tz Ry Rz Tz in another program, first and second
    /// generation; zero is straight up.
    #[test]
    fn flange_is_where_independent_programs_have_it() {
        let degrees = |degrees: [f64; 7]| degrees.map(f64::to_radians);
        for (q_rad, first_m, second_m) in [
            ([0.0; 7], [0.0, 0.0, 1.345], [0.0, 0.0, 1.317]),
            ([0.0, 0.5, 0.0, 1.0, 0.0, 0.6, 0.0], [0.783545735, 0.0, 0.704893065], [0.754963742, 0.0, 0.710526782]),
            (
                degrees([45.0, 30.0, 0.0, 60.0, 0.0, 45.0, 0.0]),
                [0.552652416, 0.552652416, 0.648142889],
                [0.533510281, 0.533510281, 0.657213957],
            ),
            (
                [0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7],
                [-0.412437565, -0.138485044, 1.20436003],
                [-0.394670490, -0.129479982, 1.18554239],
            ),
        ] {
            for (lengths, expected_m) in [(&FIRST_GENERATION_M, first_m), (&SECOND_GENERATION_M, second_m)] {
                let found_m = links(lengths, &q_rad).flange.translation_m;
                for (found, expected) in found_m.iter().zip(expected_m) {
                    assert!((found - expected).abs() < 1e-8, "{q_rad:?}: {found_m:?}, not {expected_m:?}");
                }
            }
        }
        let found = links(&SECOND_GENERATION_M, &[0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]).flange.rotation;
        let expected = [
            [-0.378465689, -0.593897943, -0.709964052],
            [0.812521242, 0.154235243, -0.562157203],
            [0.443365485, -0.789618087, 0.424181946],
        ];
        for (found, expected) in found.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-8, "{found} {expected}");
        }
    }

    #[test]
    fn links_are_as_long_as_the_table_says() {
        let found = links(&SECOND_GENERATION_M, &[0.3, 0.4, -0.8, 1.1, 0.7, -0.9, 2.0]);
        let distance = |a: [f64; 3], b: [f64; 3]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
        assert!((distance(found.shoulder_m, [0.0; 3]) - 0.317).abs() < 1e-12);
        assert!((distance(found.shoulder_m, found.elbow_m) - 0.450).abs() < 1e-12);
        assert!((distance(found.elbow_m, found.wrist_m) - 0.480).abs() < 1e-12);
        assert!((distance(found.wrist_m, found.flange.translation_m) - 0.070).abs() < 1e-12);
    }
}
