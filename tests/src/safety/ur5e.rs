//! Positions of the links of an arm with six axes, from its Denavit-Hartenberg table.
//!
//! Standard (distal) convention, T_i = Rz(q_i) Tz(d_i) Tx(a_i) Rx(alpha_i), no offsets of the angles. Numbers of Universal Robots, "DH
//! Parameters for calculations of kinematics and dynamics", UR5e:
//!
//! | i | a_i, m | d_i, m | alpha_i |
//! |---|---|---|---|
//! | 1 | 0 | 0.1625 | +90 degrees |
//! | 2 | -0.425 | 0 | 0 |
//! | 3 | -0.3922 | 0 | 0 |
//! | 4 | 0 | 0.1333 | +90 |
//! | 5 | 0 | 0.0997 | -90 |
//! | 6 | 0 | 0.0996 | 0 |

use super::truth::{Joints, Placement};

/// a_i, metres.
const A_M: [f64; 6] = [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0];
/// d_i, metres.
const D_M: [f64; 6] = [0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996];
/// Sines of alpha_i, which is -90, 0 or +90 degrees.
const SINE_OF_ALPHA: [f64; 6] = [1.0, 0.0, 0.0, 1.0, -1.0, 0.0];
/// Distances of the upper arm and of the forearm from the plane of the shoulder, metres: the arm lies beside it.
const BESIDE_M: [f64; 2] = [0.138, 0.007];

/// Longest distance from an axis to the flange, metres: the sum of all lengths, and the offset of the upper arm.
pub const REACH_M: f64 = 0.425 + 0.3922 + 0.1333 + 0.0997 + 0.0996 + BESIDE_M[0];

/// Bodies of base, upper arm, forearm and wrist as line segments, and `base_from_flange`. The seventh angle does not exist.
pub fn links(q_rad: &Joints) -> ([[[f64; 3]; 2]; 4], Placement) {
    let mut at = Placement::IDENTITY;
    let mut after = [at; 6];
    for joint in 0..6 {
        at = at.then(&transform(q_rad[joint], joint));
        after[joint] = at;
    }
    let beside = |joint: usize, beside_m: f64| {
        [[-A_M[joint], 0.0, beside_m], [0.0, 0.0, beside_m]].map(|end| after[joint].point(&end))
    };
    let base = [[0.0; 3], after[0].translation_m];
    let wrist = [after[2].translation_m, after[3].translation_m];
    ([base, beside(1, BESIDE_M[0]), beside(2, BESIDE_M[1]), wrist], at)
}

fn transform(q_rad: f64, joint: usize) -> Placement {
    let (s, c) = q_rad.sin_cos();
    let (a_m, d_m, sa) = (A_M[joint], D_M[joint], SINE_OF_ALPHA[joint]);
    let ca = 1.0 - sa.abs();
    Placement {
        rotation: [[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]],
        translation_m: [a_m * c, a_m * s, d_m],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flange_m(degrees: [f64; 6]) -> [f64; 3] {
        let mut q_rad = [0.0; 7];
        q_rad.iter_mut().zip(degrees).for_each(|(q, degrees)| *q = degrees.to_radians());
        links(&q_rad).1.translation_m
    }

    /// By hand: with all angles 0 the arm is stretched along -x; with S at -90 degrees it points up.
    #[test]
    fn flange_is_where_the_table_puts_it() {
        for (degrees, expected_m) in [
            ([0.0; 6], [-0.8172, -0.2329, 0.0628]),
            ([0.0, -90.0, 0.0, 0.0, 0.0, 0.0], [-0.0997, -0.2329, 0.9797]),
            ([90.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.2329, -0.8172, 0.0628]),
        ] {
            let found_m = flange_m(degrees);
            for (found, expected) in found_m.iter().zip(expected_m) {
                assert!((found - expected).abs() < 1e-9, "{degrees:?}: {found_m:?}, not {expected_m:?}");
            }
        }
    }

    #[test]
    fn bodies_are_as_long_as_the_links() {
        let (bodies, _) = links(&[0.3, -1.2, 1.1, 0.7, -0.9, 2.0, 0.0]);
        let length_m = |[a, b]: [[f64; 3]; 2]| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
        for (body, expected_m) in bodies.into_iter().zip([0.1625, 0.425, 0.3922, 0.1333]) {
            assert!((length_m(body) - expected_m).abs() < 1e-12, "{body:?}");
        }
    }
}
