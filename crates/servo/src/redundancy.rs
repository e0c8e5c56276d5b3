//! Null motion of a seven-axis arm: the elbow moves about the line from shoulder to wrist, away from joint limits and singular
//! poses, while the hand stays in place.
//!
//! The motion follows the negative gradient of a cost, projected on the null space of the Jacobian (Liegeois 1977). The cost is
//!
//! ```text
//! C(q) = sum_i 1 / (1 - x_i^2)  -  ln w(q)
//! ```
//!
//! x_i: offset of joint i from the middle of its range, 1 at the limit. The first term is a barrier that hardly acts in the middle,
//! after Zghal, Dubey and Euler (1990). w: Yoshikawa's manipulability (1985), 0 at singular poses, independent of the chosen point
//! of the hand.

use pb3dp_kinematics::{Chain, DOF, Jacobian, JointLimits, JointVector};

use crate::config::RedundancyConfig;

/// Step of the central difference of the cost, rad: the third derivative of the cost is of the order of 10, so truncation is below
/// 1e-6.
const DIFFERENCE_RAD: f64 = 5e-4;
/// Beyond this share of half the range the barrier of a joint is constant.
const BARRIER_UP_TO: f64 = 0.99;

/// The joint motion that keeps the hand in place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NullMotion {
    /// Direction in joint space, of length 1; zero where the Jacobian is rank-deficient.
    pub direction: JointVector,
    /// Manipulability sqrt(det(J J^T)).
    pub manipulability: f64,
}

impl NullMotion {
    /// Generalised cross product of the rows of the Jacobian. Its components are the minors of order 6, and its length is the
    /// manipulability (Cauchy and Binet).
    ///
    /// Computed by elimination with complete pivoting: the solution with a 1 in the remaining column is the cross product divided
    /// by the determinant of the other six columns.
    pub fn of(jacobian: &Jacobian) -> Self {
        let negligible = jacobian.amax() * f64::EPSILON;
        let mut rest = *jacobian;
        let mut joints: [usize; DOF] = std::array::from_fn(|joint| joint);
        let mut determinant = 1.0;
        for step in 0..6 {
            let (row, column) = largest(&rest, step);
            let pivot = rest[(row, column)];
            let is_sound = pivot.abs() > negligible;
            if !is_sound {
                return Self { direction: JointVector::zeros(), manipulability: 0.0 };
            }
            rest.swap_rows(row, step);
            rest.swap_columns(column, step);
            joints.swap(column, step);
            determinant *= if (row == step) == (column == step) { pivot } else { -pivot };
            for below in step + 1..6 {
                let factor = rest[(below, step)] / pivot;
                for behind in step + 1..DOF {
                    rest[(below, behind)] -= factor * rest[(step, behind)];
                }
            }
        }
        let mut solution = JointVector::zeros();
        solution[6] = determinant.signum();
        for row in (0..6).rev() {
            let sum: f64 = (row + 1..DOF).map(|column| rest[(row, column)] * solution[column]).sum();
            solution[row] = -sum / rest[(row, row)];
        }
        let length = solution.norm();
        let mut direction = JointVector::zeros();
        for (joint, share) in joints.into_iter().zip(solution.iter()) {
            direction[joint] = share / length;
        }
        Self { direction, manipulability: determinant.abs() * length }
    }
}

/// Row and column, from `step` on, of the element with the largest absolute value.
fn largest(matrix: &Jacobian, step: usize) -> (usize, usize) {
    let mut place = (step, step);
    for column in step..DOF {
        for row in step..6 {
            if matrix[(row, column)].abs() > matrix[place].abs() {
                place = (row, column);
            }
        }
    }
    place
}

/// Cost of an arm pose, see the module documentation.
pub fn cost(chain: &Chain, limits: &JointLimits, position_rad: &JointVector) -> f64 {
    let manipulability = NullMotion::of(&chain.jacobian(position_rad)).manipulability;
    let mut barriers = 0.0;
    for joint in 0..DOF {
        let (min, max) = (limits.position_min_rad()[joint], limits.position_max_rad()[joint]);
        let share = (2.0 * position_rad[joint] - min - max) / (max - min);
        let share = share.clamp(-BARRIER_UP_TO, BARRIER_UP_TO);
        barriers += 1.0 / (1.0 - share * share);
    }
    barriers - manipulability.max(f64::MIN_POSITIVE).ln()
}

/// Joint velocities (rad/s) that lower the cost and keep the hand in place. `weight`, 0 to 1, fades them out near singular poses,
/// where the null space turns faster than the joints can follow.
pub fn secondary_velocity(
    chain: &Chain,
    limits: &JointLimits,
    position_rad: &JointVector,
    jacobian: &Jacobian,
    config: &RedundancyConfig,
    weight: f64,
) -> JointVector {
    if config.speed_max_rad_per_s <= 0.0 || weight <= 0.0 {
        return JointVector::zeros();
    }
    let direction = NullMotion::of(jacobian).direction;
    let step = direction * DIFFERENCE_RAD;
    let rise = cost(chain, limits, &(position_rad + step)) - cost(chain, limits, &(position_rad - step));
    let slope = rise / (2.0 * DIFFERENCE_RAD);
    let wanted = -config.gain_rad_per_s * slope;
    // A smooth bound.
    let speed = wanted / (1.0 + (wanted / config.speed_max_rad_per_s).powi(2)).sqrt();
    direction * (speed * weight.min(1.0))
}

#[cfg(test)]
mod tests {
    use pb3dp_kinematics::{manipulability, smallest_singular_value};

    use super::*;

    const CONFIG: RedundancyConfig = RedundancyConfig { gain_rad_per_s: 0.2, speed_max_rad_per_s: 0.1 };
    const BENT: [f64; 7] = [0.15, 0.75, -0.2, 1.6, 0.1, -0.9, 0.25];

    fn chain() -> Chain {
        let urdf = include_str!("../../../configs/robots/pa10_gen2.urdf");
        Chain::from_urdf_str(urdf, "base_link", "flange").unwrap()
    }

    #[test]
    fn the_null_motion_leaves_the_hand_where_it_is() {
        let chain = chain();
        for position in [BENT, [1.0, -0.6, 0.9, -1.2, -2.0, 1.1, 3.0]] {
            let jacobian = chain.jacobian(&position.into());
            let null = NullMotion::of(&jacobian);
            assert!((null.direction.norm() - 1.0).abs() < 1e-12);
            assert!((jacobian * null.direction).norm() < 1e-12);
            for joint in 0..DOF {
                let minor: nalgebra::SMatrix<f64, 6, 6> =
                    jacobian.fixed_columns::<DOF>(0).into_owned().remove_column(joint);
                let sign = if joint % 2 == 0 { 1.0 } else { -1.0 };
                let of_rows = sign * minor.determinant();
                let found = null.direction[joint] * null.manipulability;
                assert!((found - of_rows).abs() < 1e-12, "joint {joint}: {found}, the minor is {of_rows}");
            }
            assert!(
                (null.manipulability / manipulability(&jacobian) - 1.0).abs() < 1e-9,
                "the product of singular values"
            );
        }
        // Stretched arm: the Jacobian is rank-deficient, and the direction is undefined.
        let stretched = NullMotion::of(&chain.jacobian(&JointVector::from([0.3, 0.5, 0.1, 0.0, 0.2, 0.6, 0.0])));
        assert!(stretched.manipulability < 1e-12, "{stretched:?}");
    }

    /// The null motion ends at a minimum of the cost along the null space, and the hand has not moved.
    #[test]
    fn the_elbow_goes_where_the_cost_is_least_and_the_hand_stays() {
        let (chain, start) = (chain(), JointVector::from([0.9, 0.75, -0.9, 1.6, 0.5, -0.9, 2.0]));
        let limits = chain.limits();
        let hand = chain.forward(&start);
        let mut position = start;
        let mut before = cost(&chain, limits, &position);
        let first = before;
        for _ in 0..4000 {
            let jacobian = chain.jacobian(&position);
            let velocity = secondary_velocity(&chain, limits, &position, &jacobian, &CONFIG, 1.0);
            assert!(velocity.norm() <= 0.1, "{velocity}");
            position += velocity * 0.01;
            let now = cost(&chain, limits, &position);
            assert!(now <= before + 1e-12, "{now} after {before}");
            before = now;
        }
        assert!(before < first - 0.2, "{before} from {first}");
        let off = hand.inverse() * chain.forward(&position);
        assert!(off.translation_m().norm() < 1e-3 && off.rotation_angle_rad() < 1e-3, "{off:?}");
        let direction = NullMotion::of(&chain.jacobian(&position)).direction;
        for side in [-0.05, 0.05] {
            assert!(cost(&chain, limits, &(position + direction * side)) > before);
        }
    }

    #[test]
    fn a_joint_near_the_end_of_its_range_is_led_away_from_it() {
        let chain = chain();
        let limits = chain.limits();
        for (joint, side) in [(0, 1.0), (2, -1.0), (4, 1.0), (6, -1.0)] {
            let mut position = JointVector::from(BENT);
            let end = if side > 0.0 { limits.position_max_rad()[joint] } else { limits.position_min_rad()[joint] };
            position[joint] = end - side * 0.05;
            let jacobian = chain.jacobian(&position);
            let velocity = secondary_velocity(&chain, limits, &position, &jacobian, &CONFIG, 1.0);
            assert!(velocity[joint] * side < 0.0, "joint {joint} at {}: {velocity}", position[joint]);
        }
    }

    /// Near q2 = q6 = 0 the elbow moves so that the smallest singular value increases.
    #[test]
    fn near_a_singular_pose_the_arm_is_led_away_from_it() {
        let chain = chain();
        let mut position = JointVector::from([0.2, 0.08, 0.4, 1.6, 0.5, 0.06, 0.3]);
        let begin = smallest_singular_value(&chain.jacobian(&position));
        for _ in 0..6000 {
            let jacobian = chain.jacobian(&position);
            position += secondary_velocity(&chain, chain.limits(), &position, &jacobian, &CONFIG, 1.0) * 0.01;
        }
        let end = smallest_singular_value(&chain.jacobian(&position));
        assert!(end > 1.15 * begin, "{end} from {begin}");
    }

    #[test]
    fn it_is_off_where_it_has_no_speed_or_no_weight() {
        let chain = chain();
        let position = JointVector::from([0.9, 0.75, -0.9, 1.6, 0.5, -0.9, 2.0]);
        let jacobian = chain.jacobian(&position);
        let off = RedundancyConfig { speed_max_rad_per_s: 0.0, ..CONFIG };
        let velocity =
            |config, weight| secondary_velocity(&chain, chain.limits(), &position, &jacobian, config, weight);
        assert_eq!(velocity(&off, 1.0), JointVector::zeros());
        assert_eq!(velocity(&CONFIG, 0.0), JointVector::zeros());
        let whole = velocity(&CONFIG, 1.0);
        assert!(whole.norm() > 0.01);
        assert!((velocity(&CONFIG, 0.25) - whole * 0.25).norm() < 1e-15);
    }
}
