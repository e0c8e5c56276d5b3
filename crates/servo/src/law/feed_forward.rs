//! Position-based law with feed-forward of the target's velocity and compensation of the arm's delay and lag; the default.
//!
//! The joints follow velocity commands u after a dead time d with a first-order lag T: v' = (u(t - d) - v) / T. For such joints the
//! angles at which they come to rest without further commands,
//!
//! ```text
//! q_rest = q + T v + (all commands in flight, each times its duration),        q_rest' = u,
//! ```
//!
//! respond to a command at once, without delay or lag. The loop is closed around these angles (a Smith predictor, O. J. M. Smith
//! 1957, for an integrating plant; [`crate::given_commands`] computes them). When the present command takes effect, at now + d, the
//! hand at rest should be where a hand at the desired pose with the desired velocity comes to rest:
//!
//! ```text
//! x_rest,d = x_d + T v_d,        u = v_d + T a_d + K (x_rest,d - x_rest)
//! ```
//!
//! with the target predicted to now + d. If the predictions of target and arm are exact, there is no lag: the error e follows e + T
//! e' = e_rest with e_rest' = -K e_rest, two real poles at -K and -1/T, without overshoot for any K. The unknown part of delay and
//! lag is a delay in this loop and bounds K: a gain of 1 / (e T') has no overshoot for a delay of T'. The default assumes half of
//! delay and lag as unknown ([`ArmResponse::gain_without_overshoot`]).
//!
//! The correction K e grows with the error only up to a speed from which the hand can decelerate, see [`correction_speed`]: with
//! the configured accelerations, or less if the joints cannot provide them ([`Aim::gains_within`]).

use nalgebra::Vector3;
use pb3dp_geometry::frames::{Base, Hand, Model};
use pb3dp_geometry::{Pose, Twist, so3};
use pb3dp_kinematics::JointVector;

use crate::config::{ArmResponse, CartesianSpeed, FeedForwardGains};
use crate::target_state::{Acceleration, Prediction};

/// Share of the joints' accelerations that is used for corrections; the rest is for the motion of the target and for the jerk at
/// both ends.
const BRAKING_SHARE: f64 = 0.7;

/// Desired motion of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DesiredMotion {
    /// Pose.
    pub base_from_hand: Pose<Base, Hand>,
    /// Velocity of its origin, and angular velocity.
    pub twist: Twist<Base>,
    /// Linear and angular acceleration.
    pub acceleration: Acceleration<Base>,
}

impl DesiredMotion {
    /// Motion of a hand that is rigidly attached to the target.
    pub fn before(target: &Prediction, model_from_hand_desired: &Pose<Model, Hand>) -> Self {
        Self {
            base_from_hand: target.base_from_model * *model_from_hand_desired,
            twist: target.twist_of(model_from_hand_desired),
            acceleration: target.acceleration_of(model_from_hand_desired),
        }
    }
}

/// Goal for the time at which the present command takes effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aim {
    /// Desired resting pose of the hand.
    pub base_from_hand_at_rest: Pose<Base, Hand>,
    /// Velocity that keeps the error constant, in `base`.
    pub feed_forward: Twist<Base>,
}

impl Aim {
    /// For a hand with the motion `desired` when the command takes effect. The command is held for `period_s`, and is exact in the
    /// middle of this time.
    pub fn new(desired: &DesiredMotion, arm: &ArmResponse, period_s: f64) -> Self {
        let DesiredMotion { base_from_hand, twist, acceleration } = desired;
        let ahead_s = arm.lag_s + 0.5 * period_s;
        let position_m = base_from_hand.translation_m() + twist.linear_m_per_s * arm.lag_s;
        let rotation = so3::exp(&(twist.angular_rad_per_s * arm.lag_s)) * base_from_hand.rotation();
        Self {
            base_from_hand_at_rest: Pose::from_parts(position_m, rotation),
            feed_forward: Twist::new(
                twist.linear_m_per_s + acceleration.linear_m_per_s2 * ahead_s,
                twist.angular_rad_per_s + acceleration.angular_rad_per_s2 * ahead_s,
            ),
        }
    }

    /// Translation (metres) and rotation vector, in `base`, from the predicted resting pose of the hand to the desired one.
    fn error(&self, base_from_hand_at_rest: &Pose<Base, Hand>) -> (Vector3<f64>, Vector3<f64>) {
        let aimed = &self.base_from_hand_at_rest;
        let position = aimed.translation_m() - base_from_hand_at_rest.translation_m();
        (position, so3::log(&(aimed.rotation() * base_from_hand_at_rest.rotation().inverse())))
    }

    /// Speeds of the corrections at which translation and rotation end together: the shorter one takes as long as the longer one. A
    /// hand that rotated first and translated slowly would lose sight of the target.
    pub fn together(
        &self,
        gains: &FeedForwardGains,
        base_from_hand_at_rest: &Pose<Base, Hand>,
        most: &CartesianSpeed,
    ) -> CartesianSpeed {
        let (position, rotation) = self.error(base_from_hand_at_rest);
        let takes_s = |size: f64, gain_per_s: f64, acceleration: f64, most: f64| {
            if size > 0.0 { size / correction_speed(size, gain_per_s, acceleration).min(most) } else { 0.0 }
        };
        let (way_m, turn_rad) = (position.norm(), rotation.norm());
        let way_s = takes_s(way_m, gains.position_per_s, gains.linear_m_per_s2, most.linear_m_per_s);
        let turn_s = takes_s(turn_rad, gains.orientation_per_s, gains.angular_rad_per_s2, most.angular_rad_per_s);
        let both_s = way_s.max(turn_s);
        if both_s <= 0.0 {
            return *most;
        }
        CartesianSpeed {
            linear_m_per_s: most.linear_m_per_s.min(way_m / both_s),
            angular_rad_per_s: most.angular_rad_per_s.min(turn_rad / both_s),
        }
    }

    /// Gains for which the deceleration from a correction of this error stays within the joint accelerations.
    /// `joint_velocity` maps a velocity of the hand to joint velocities (rad/s).
    pub fn gains_within(
        &self,
        gains: &FeedForwardGains,
        base_from_hand_at_rest: &Pose<Base, Hand>,
        joint_acceleration_max_rad_per_s2: &JointVector,
        joint_velocity: impl Fn(&Twist<Base>) -> JointVector,
    ) -> FeedForwardGains {
        let (position, rotation) = self.error(base_from_hand_at_rest);
        // Deceleration vector, and its weight in the joint limit of the other correction: below 1 for a small error.
        let braked = |error: &Vector3<f64>, gain_per_s: f64, acceleration: f64| {
            let size = error.norm();
            let direction = if size > 0.0 { error * (acceleration / size) } else { Vector3::zeros() };
            (direction, (size * gain_per_s * gain_per_s / acceleration).min(1.0))
        };
        let (linear, linear_weight) = braked(&position, gains.position_per_s, gains.linear_m_per_s2);
        let (angular, angular_weight) = braked(&rotation, gains.orientation_per_s, gains.angular_rad_per_s2);
        let of_linear = joint_velocity(&Twist::new(linear, Vector3::zeros())).abs();
        let of_angular = joint_velocity(&Twist::new(Vector3::zeros(), angular)).abs();
        let share_of = |demanded: JointVector| {
            let both = demanded.iter().zip(joint_acceleration_max_rad_per_s2.iter());
            both.fold(1.0_f64, |share, (demanded, most)| {
                if *demanded > BRAKING_SHARE * most { share.min(BRAKING_SHARE * most / demanded) } else { share }
            })
        };
        FeedForwardGains {
            linear_m_per_s2: gains.linear_m_per_s2 * share_of(of_linear + of_angular * angular_weight),
            angular_rad_per_s2: gains.angular_rad_per_s2 * share_of(of_angular + of_linear * linear_weight),
            ..*gains
        }
    }
}

/// Desired velocity of the hand: of its origin, and angular, in `base`. `base_from_hand_at_rest` is the predicted resting pose of
/// the hand; the correction of its error is limited to `most`.
pub fn hand_twist(
    gains: &FeedForwardGains,
    aim: &Aim,
    base_from_hand_at_rest: &Pose<Base, Hand>,
    most: &CartesianSpeed,
) -> Twist<Base> {
    let (position, rotation) = aim.error(base_from_hand_at_rest);
    let linear = correction(&position, gains.position_per_s, gains.linear_m_per_s2, most.linear_m_per_s);
    let angular = correction(&rotation, gains.orientation_per_s, gains.angular_rad_per_s2, most.angular_rad_per_s);
    Twist::new(aim.feed_forward.linear_m_per_s + linear, aim.feed_forward.angular_rad_per_s + angular)
}

/// Velocity along an error.
fn correction(error: &Vector3<f64>, gain_per_s: f64, acceleration: f64, most: f64) -> Vector3<f64> {
    let size = error.norm();
    if size <= 0.0 {
        return Vector3::zeros();
    }
    error * (correction_speed(size, gain_per_s, acceleration).min(most) / size)
}

/// Speed of the correction of an error, per second in the unit of the error. K e as long as the deceleration stays below
/// `acceleration` (up to e = a / K^2); beyond it sqrt(2 a (e - a / (2 K^2))), the speed of a constant deceleration, with a
/// continuous slope.
pub fn correction_speed(error: f64, gain_per_s: f64, acceleration: f64) -> f64 {
    let linear_up_to = acceleration / (gain_per_s * gain_per_s);
    if error <= linear_up_to { gain_per_s * error } else { (2.0 * acceleration * (error - 0.5 * linear_up_to)).sqrt() }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;

    const GAINS: FeedForwardGains = FeedForwardGains {
        position_per_s: 8.0,
        orientation_per_s: 5.0,
        linear_m_per_s2: 0.64,
        angular_rad_per_s2: 2.0,
    };
    const WIDE: CartesianSpeed = CartesianSpeed { linear_m_per_s: 2.0, angular_rad_per_s: 6.0 };

    fn rotation(x: f64, y: f64, z: f64) -> UnitQuaternion<f64> {
        UnitQuaternion::from_scaled_axis(Vector3::new(x, y, z))
    }

    /// The arm needs 4 rad/s^2 of its second joint for every m/s^2 along y: this joint limits the deceleration.
    #[test]
    fn braking_takes_no_more_than_the_joints_have() {
        let hand = Pose::from_parts(Vector3::new(0.6, -0.1, 0.4), rotation(0.3, -1.1, 0.7));
        let aim = |by: Vector3<f64>| Aim {
            base_from_hand_at_rest: Pose::from_parts(hand.translation_m() + by, hand.rotation()),
            feed_forward: Twist::zero(),
        };
        let most = JointVector::from_element(2.0);
        let joints = |twist: &Twist<Base>| {
            let mut joints = JointVector::zeros();
            (joints[0], joints[1]) = (twist.linear_m_per_s.x, -4.0 * twist.linear_m_per_s.y);
            joints
        };
        let within = |by: Vector3<f64>| aim(by).gains_within(&GAINS, &hand, &most, joints);
        assert_eq!(within(Vector3::new(0.3, 0.0, 0.0)), GAINS);
        let along_y = within(Vector3::new(0.0, 0.3, 0.0));
        assert!((along_y.linear_m_per_s2 - 0.7 * 2.0 / 4.0).abs() < 1e-12, "{along_y:?}");
        assert!((along_y.angular_rad_per_s2 / GAINS.angular_rad_per_s2 - along_y.linear_m_per_s2 / 0.64).abs() < 1e-12);
        // Close to the desired position the linear deceleration takes a smaller share of the joint: 0.75 at 0.75 x a / K^2.
        let near = within(Vector3::new(0.0, 0.0075, 0.0));
        assert!((near.angular_rad_per_s2 - 2.0 * 1.4 / (0.75 * 4.0 * 0.64)).abs() < 1e-12, "{near:?}");
        // Close to the desired position the speed does not depend on the acceleration: K e.
        let speed_m_per_s = |y_m: f64| {
            let by = Vector3::new(0.0, y_m, 0.0);
            let found = hand_twist(&within(by), &aim(by), &hand, &WIDE).linear_m_per_s;
            assert!(found.x.abs() < 1e-12 && found.z.abs() < 1e-12, "{found}");
            found.y
        };
        assert!((speed_m_per_s(0.005) - 8.0 * 0.005).abs() < 1e-12);
        // The speed decreases with the error, without a jump, and with no more than the available deceleration.
        let step_m = 1e-4;
        let speeds: Vec<f64> = (1..3000).map(|i| speed_m_per_s(f64::from(i) * step_m)).collect();
        for pair in speeds.windows(2) {
            let braking = 0.5 * (pair[1] * pair[1] - pair[0] * pair[0]) / step_m;
            assert!(pair[1] > pair[0] && braking <= 0.35 * 1.001, "{pair:?}: {braking}");
        }
    }

    /// A hand with an orientation error only has no linear deceleration; the angular deceleration is limited all the same.
    #[test]
    fn a_turn_in_place_is_braked_with_what_the_joints_have() {
        let hand = Pose::from_parts(Vector3::new(0.6, -0.1, 0.4), rotation(0.3, -1.1, 0.7));
        let aimed = Pose::from_parts(hand.translation_m(), rotation(0.0, 0.0, 0.5) * hand.rotation());
        let aim = Aim { base_from_hand_at_rest: aimed, feed_forward: Twist::zero() };
        let joints = |twist: &Twist<Base>| {
            let mut joints = JointVector::zeros();
            joints[2] = 3.0 * twist.angular_rad_per_s.z + twist.linear_m_per_s.x;
            joints
        };
        let within = aim.gains_within(&GAINS, &hand, &JointVector::from_element(2.0), joints);
        // 2 rad/s^2 need 6 rad/s^2 of the joint; corrections may use 1.4 rad/s^2.
        assert!((within.angular_rad_per_s2 - 2.0 * 1.4 / 6.0).abs() < 1e-12, "{within:?}");
    }

    /// 400 mm at 100 mm/s take 4 s: 0.4 rad, which are possible in 1 s, take as long.
    #[test]
    fn on_the_way_to_a_target_way_and_turn_end_together() {
        let hand = Pose::from_parts(Vector3::new(0.6, -0.1, 0.4), rotation(0.3, -1.1, 0.7));
        let aimed = Pose::from_parts(
            hand.translation_m() + Vector3::new(0.0, 0.4, 0.0),
            rotation(0.0, 0.4, 0.0) * hand.rotation(),
        );
        let aim = Aim { base_from_hand_at_rest: aimed, feed_forward: Twist::zero() };
        let most = CartesianSpeed { linear_m_per_s: 0.1, angular_rad_per_s: 0.4 };
        let together = aim.together(&GAINS, &hand, &most);
        assert!((together.linear_m_per_s - 0.1).abs() < 1e-12 && (together.angular_rad_per_s - 0.1).abs() < 1e-9);
        let there = Aim { base_from_hand_at_rest: hand, ..aim }.together(&GAINS, &hand, &most);
        assert!(there.linear_m_per_s <= 0.1 && there.angular_rad_per_s <= 0.4, "{there:?}");
    }

    /// A lagging hand with the desired pose and velocity receives the command that inverts the lag, and no correction.
    #[test]
    fn a_hand_without_error_is_commanded_what_inverts_its_lag() {
        let arm = ArmResponse { delay_s: 0.02, lag_s: 0.04 };
        let (velocity, turning) = (Vector3::new(0.1, -0.05, 0.02), Vector3::new(0.3, 0.1, -0.4));
        let (push, twirl) = (Vector3::new(-0.2, 0.3, 0.1), Vector3::new(0.5, -0.7, 0.2));
        let hand = Pose::from_parts(Vector3::new(0.6, -0.1, 0.4), rotation(0.3, -1.1, 0.7));
        let desired = DesiredMotion {
            base_from_hand: hand,
            twist: Twist::new(velocity, turning),
            acceleration: Acceleration::new(push, twirl),
        };
        let aim = Aim::new(&desired, &arm, 0.0);
        // With v' = -v / T from now on the hand still moves by T v and rotates by T w.
        let rests_at =
            Pose::from_parts(hand.translation_m() + velocity * 0.04, rotation(0.012, 0.004, -0.016) * hand.rotation());
        let commanded = hand_twist(&GAINS, &aim, &rests_at, &WIDE);
        // The acceleration must be v' = (u - v) / T.
        assert!(((commanded.linear_m_per_s - velocity) / 0.04 - push).norm() < 1e-9, "{commanded:?}");
        assert!(((commanded.angular_rad_per_s - turning) / 0.04 - twirl).norm() < 1e-7, "{commanded:?}");
        // Half a period later the velocity has changed by the acceleration times this time.
        let held = Aim::new(&desired, &arm, 0.01);
        assert!((held.feed_forward.linear_m_per_s - aim.feed_forward.linear_m_per_s - push * 0.005).norm() < 1e-12);
        assert!(
            (held.feed_forward.angular_rad_per_s - aim.feed_forward.angular_rad_per_s - twirl * 0.005).norm() < 1e-12
        );
        assert_eq!(held.base_from_hand_at_rest, aim.base_from_hand_at_rest);
    }

    #[test]
    fn an_error_is_corrected_along_the_shorter_way_and_in_proportion_to_the_angle() {
        let hand = Pose::<Base, Hand>::from_parts(Vector3::new(0.3, -0.2, 0.9), rotation(0.4, 1.1, -0.3));
        let by = Vector3::new(-0.004, 0.002, 0.004);
        let turn = Vector3::new(0.02, -0.03, 0.06);
        let aimed = Pose::from_parts(hand.translation_m() + by, rotation(turn.x, turn.y, turn.z) * hand.rotation());
        let aim =
            Aim { base_from_hand_at_rest: aimed, feed_forward: Twist::new(Vector3::x() * 0.1, Vector3::y() * 0.2) };
        let commanded = hand_twist(&GAINS, &aim, &hand, &WIDE);
        assert!((commanded.linear_m_per_s - (by * 8.0 + Vector3::x() * 0.1)).norm() < 1e-12, "{commanded:?}");
        assert!((commanded.angular_rad_per_s - (turn * 5.0 + Vector3::y() * 0.2)).norm() < 1e-9, "{commanded:?}");
        // 200 degrees about an axis are 160 degrees about the opposite axis; the negated quaternion is the same rotation.
        let axis = Vector3::new(1.0, -2.0, 2.0) / 3.0;
        let long = UnitQuaternion::from_scaled_axis(axis * 200f64.to_radians()) * hand.rotation();
        for rotation in [long, UnitQuaternion::new_unchecked(-long.into_inner())] {
            let aimed = Pose::from_parts(hand.translation_m(), rotation);
            let aim = Aim { base_from_hand_at_rest: aimed, feed_forward: Twist::zero() };
            let commanded = hand_twist(&GAINS, &aim, &hand, &WIDE).angular_rad_per_s;
            // sqrt(2 a (e - a / (2 K^2))), a = 2, K = 5, e = 160 degrees.
            let expected = (4.0 * (160f64.to_radians() - 0.04)).sqrt();
            assert!((commanded + axis * expected).norm() < 1e-9, "{commanded}");
        }
    }

    #[test]
    fn corrections_can_be_braked_away_and_have_a_largest_speed() {
        // Calculated by hand: a / K^2 = 0.01 m; below it K e, at 0.055 m sqrt(2 x 0.64 x 0.05).
        assert!((correction_speed(0.008, 8.0, 0.64) - 0.064).abs() < 1e-15);
        assert!((correction_speed(0.055, 8.0, 0.64) - 0.064f64.sqrt()).abs() < 1e-15);
        let mut error: f64 = 0.4;
        let dt = 1e-5;
        while error > 1e-4 {
            let speed = correction_speed(error, 8.0, 0.64);
            let next = correction_speed(error - speed * dt, 8.0, 0.64);
            assert!((speed - next) / dt < 0.64 * 1.001, "deceleration {} at {error}", (speed - next) / dt);
            error -= speed * dt;
        }
        let hand = Pose::<Base, Hand>::from_parts(Vector3::new(0.3, -0.2, 0.9), rotation(0.4, 1.1, -0.3));
        let aimed = Pose::from_parts(hand.translation_m() + Vector3::new(0.0, 3.0, -4.0), hand.rotation());
        let aim = Aim { base_from_hand_at_rest: aimed, feed_forward: Twist::new(Vector3::x() * 0.1, Vector3::zeros()) };
        let most = CartesianSpeed { linear_m_per_s: 0.05, angular_rad_per_s: 0.1 };
        let commanded = hand_twist(&GAINS, &aim, &hand, &most);
        assert!((commanded.linear_m_per_s - Vector3::new(0.1, 0.03, -0.04)).norm() < 1e-12, "{commanded:?}");
    }
}
