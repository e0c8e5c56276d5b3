//! Resolved-rate control: from the velocity of the hand to joint velocities within the limits.
//!
//! All reductions but one scale the whole motion, so the direction of the hand is kept. A hand near the target loses only its speed
//! towards it.

use nalgebra::{Point3, Vector3};
use pb3dp_geometry::Twist;
use pb3dp_geometry::frames::Base;
use pb3dp_kinematics::{Chain, DOF, Damping, Jacobian, JointFrames, JointLimits, JointVector, SingularForm};

use crate::config::CartesianSpeed;

/// Time in which the hand may use up its distance to the nearest allowed place, seconds: four times the 60 ms by which a command acts late
/// on a PA-10, so the distance does not swing.
const CLOSING_S: f64 = 0.25;

/// The strongest limit that makes the hand slower than the law requests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Limitation {
    /// Speed limit of the hand.
    HandSpeed,
    /// Speed limit of a joint, counted from 0 at the base.
    JointSpeed {
        /// Index from the base.
        joint: usize,
    },
    /// A joint near its limit moves towards it.
    JointRange {
        /// Index from the base.
        joint: usize,
    },
    /// The elbow ([`Chain::elbow`]) is nearly straight and would straighten further: the target is at the end of the reach.
    ElbowStretched,
    /// Soft start after a hold.
    SoftStart,
    /// The target is nearer than it should be: the hand comes no closer.
    TargetNear,
    /// The target was not observed for a while: the hand slows down to a hold.
    Fading,
}

/// Jacobian of the hand at one moment.
#[derive(Clone, Copy, Debug)]
pub struct HandJacobian {
    jacobian: Jacobian,
    singular_form: SingularForm,
}

impl HandJacobian {
    /// Jacobian of the point `hand_origin_in_base` (metres), which is fixed to the flange.
    pub fn new(chain: &Chain, frames: &JointFrames, hand_origin_in_base: &Point3<f64>) -> Self {
        let jacobian = chain.jacobian_at(frames, hand_origin_in_base);
        Self { jacobian, singular_form: SingularForm::new(&jacobian) }
    }

    /// Rows: velocity of the hand's origin and angular velocity in `base`; columns: joints.
    pub fn matrix(&self) -> &Jacobian {
        &self.jacobian
    }

    /// Smallest singular value, metres and radians.
    pub fn smallest_singular_value(&self) -> f64 {
        self.singular_form.smallest_value()
    }

    /// Velocity of the hand's origin and its angular velocity, in `base`, at these joint velocities (rad/s).
    pub fn twist(&self, velocity_rad_per_s: &JointVector) -> Twist<Base> {
        Twist::from_vector(&(self.jacobian * velocity_rad_per_s))
    }

    /// Joint velocities (rad/s) that give the hand this velocity, damped near singular poses.
    pub fn joint_velocity(&self, twist: &Twist<Base>, damping: &Damping) -> JointVector {
        self.singular_form.damped_inverse(damping) * twist.to_vector()
    }
}

/// Joint velocities within all limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LimitedVelocity {
    /// Joint velocities, rad/s.
    pub velocity_rad_per_s: JointVector,
    /// Share of the requested speed that is left, 0 to 1.
    pub share: f64,
    /// The strongest limit; `None` if none acts.
    pub limited_by: Option<Limitation>,
}

/// Scales a twist down to the speed limit of the hand.
pub fn limit_twist(twist: &Twist<Base>, most: &CartesianSpeed) -> (Twist<Base>, f64) {
    let linear = share_of(twist.linear_m_per_s.norm(), most.linear_m_per_s);
    let share = linear.min(share_of(twist.angular_rad_per_s.norm(), most.angular_rad_per_s));
    (Twist::new(twist.linear_m_per_s * share, twist.angular_rad_per_s * share), share)
}

/// Takes away what brings the camera too fast towards the target. `target_m` is the target from the camera and `lever_m` the camera from the
/// origin of the hand, metres in `base`; at the distance `least_m` no speed towards the target is left. Returns whether something was taken.
///
/// Of a target that turns faster than the hand can follow, the saturated law keeps the tangent and loses the radius: the hand drifts
/// towards it.
pub fn keep_apart(
    twist: &Twist<Base>,
    (target_m, lever_m): (&Vector3<f64>, &Vector3<f64>),
    least_m: f64,
) -> (Twist<Base>, bool) {
    let distance_m = target_m.norm();
    let towards = target_m / distance_m.max(f64::EPSILON);
    let closing_m_per_s = (twist.linear_m_per_s + twist.angular_rad_per_s.cross(lever_m)).dot(&towards);
    let excess_m_per_s = closing_m_per_s - ((distance_m - least_m) / CLOSING_S).max(0.0);
    if excess_m_per_s <= 0.0 {
        return (*twist, false);
    }
    (Twist::new(twist.linear_m_per_s - towards * excess_m_per_s, twist.angular_rad_per_s), true)
}

/// Limits of the joints.
#[derive(Clone, Copy, Debug)]
pub struct JointBounds<'a> {
    /// Ranges and speed limits.
    pub limits: &'a JointLimits,
    /// Largest joint speed towards a limit per remaining angle, 1/s.
    pub limit_approach_per_s: f64,
    /// The elbow joint and its least angle, rad; `None` if the elbow is not bounded.
    pub elbow: Option<(usize, f64)>,
}

impl JointBounds<'_> {
    /// Speed limits (rad/s) of a joint at this angle in the direction of `velocity`: for the joint, and for its remaining range.
    fn most(&self, joint: usize, velocity: f64, position_rad: f64) -> [(f64, Limitation); 2] {
        let limits = self.limits;
        let speed = limits.velocity_max_rad_per_s()[joint];
        let mut room_rad = if velocity > 0.0 {
            limits.position_max_rad()[joint] - position_rad
        } else {
            position_rad - limits.position_min_rad()[joint]
        };
        let mut limitation = Limitation::JointRange { joint };
        if let Some((_, least_rad)) = self.elbow.filter(|(elbow, _)| *elbow == joint && velocity * position_rad < 0.0) {
            room_rad = position_rad.abs() - least_rad;
            limitation = Limitation::ElbowStretched;
        }
        let here = room_rad.max(0.0) * self.limit_approach_per_s;
        [(speed, Limitation::JointSpeed { joint }), (here, limitation)]
    }

    /// Scales joint velocities down to the speed limits of the joints and of their remaining ranges.
    pub fn limit(&self, velocity_rad_per_s: &JointVector, position_rad: &JointVector) -> LimitedVelocity {
        let mut share = 1.0;
        let mut limited_by = None;
        for joint in 0..DOF {
            let velocity = velocity_rad_per_s[joint];
            for (most, limitation) in self.most(joint, velocity, position_rad[joint]) {
                let left = share_of(velocity.abs(), most);
                if left < share {
                    share = left;
                    limited_by = Some(limitation);
                }
            }
        }
        LimitedVelocity { velocity_rad_per_s: velocity_rad_per_s * share, share, limited_by }
    }

    /// Share, 0 to 1, of a secondary velocity that leaves the primary speed unchanged: no joint exceeds a bound because of it.
    pub fn share_beside(&self, primary: &JointVector, secondary: &JointVector, position_rad: &JointVector) -> f64 {
        let mut share: f64 = 1.0;
        for joint in 0..DOF {
            let (first, second) = (primary[joint], secondary[joint]);
            if second == 0.0 {
                continue;
            }
            // Remaining velocity in the direction of the secondary motion.
            let most = self
                .most(joint, second, position_rad[joint])
                .map(|(most, _)| most)
                .into_iter()
                .fold(f64::MAX, f64::min);
            let left = most - first * second.signum();
            share = share.min((left / second.abs()).clamp(0.0, 1.0));
        }
        share
    }
}

fn share_of(speed: f64, most: f64) -> f64 {
    if speed > most { most / speed } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn limits() -> JointLimits {
        let max = JointVector::from([2.9, 1.5, 2.9, 2.2, 4.3, 2.7, 4.3]);
        JointLimits::new(-max, max, JointVector::from([0.5, 0.5, 1.0, 1.0, 3.0, 3.0, 3.0])).unwrap()
    }

    const HAND: CartesianSpeed = CartesianSpeed { linear_m_per_s: 0.5, angular_rad_per_s: 1.0 };
    const LIMIT_APPROACH_PER_S: f64 = 2.0;
    const ELBOW: usize = 3;

    #[test]
    fn only_the_speed_towards_a_near_target_is_taken_away() {
        let (target_m, lever_m) = (Vector3::new(0.0, 0.36, 0.48), Vector3::new(0.1, 0.0, 0.0));
        // Towards the target the camera moves with 0.6 y + 0.8 (z - 0.1 wy).
        let twist = Twist::<Base>::new(Vector3::new(0.3, 0.1, 0.5), Vector3::new(0.2, -0.5, 0.1));
        let closing = |twist: &Twist<Base>| {
            (twist.linear_m_per_s + twist.angular_rad_per_s.cross(&lever_m)).dot(&Vector3::new(0.0, 0.6, 0.8))
        };
        assert!((closing(&twist) - (0.6 * (0.1 + 0.1 * 0.1) + 0.8 * (0.5 + 0.5 * 0.1))).abs() < 1e-12);
        assert_eq!(
            keep_apart(&twist, (&target_m, &lever_m), 0.4),
            (twist, false),
            "0.8 m/s are allowed 0.2 m before it"
        );
        let (kept, was_taken) = keep_apart(&twist, (&target_m, &lever_m), 0.55);
        assert!(was_taken && (closing(&kept) - 0.05 / CLOSING_S).abs() < 1e-12, "{kept:?}");
        assert_eq!((kept.linear_m_per_s.x, kept.angular_rad_per_s), (0.3, twist.angular_rad_per_s));
        // Nearer than allowed: it does not come closer, and it may leave.
        let (stays, _) = keep_apart(&twist, (&target_m, &lever_m), 0.7);
        assert!(closing(&stays).abs() < 1e-12, "{stays:?}");
        let leaves = Twist::new(-twist.linear_m_per_s, -twist.angular_rad_per_s);
        assert_eq!(keep_apart(&leaves, (&target_m, &lever_m), 0.7), (leaves, false));
    }

    #[test]
    fn a_twist_keeps_its_direction() {
        let twist = Twist::new(Vector3::new(0.3, 0.0, -0.4), Vector3::new(0.0, -2.5, 0.0));
        let (slow, share) = limit_twist(&twist, &HAND);
        assert!((share - 0.4).abs() < 1e-12);
        assert!((slow.to_vector() - twist.to_vector() * 0.4).norm() < 1e-12);
        let (same, share) = limit_twist(&slow, &HAND);
        assert_eq!((share, same), (1.0, slow));
    }

    fn limit(velocity: &JointVector, position: &JointVector) -> LimitedVelocity {
        JointBounds { limits: &limits(), limit_approach_per_s: LIMIT_APPROACH_PER_S, elbow: Some((ELBOW, 0.1)) }
            .limit(velocity, position)
    }

    #[test]
    fn the_joint_that_is_most_too_fast_decides() {
        let wanted = JointVector::from([0.75, -1.5, 0.2, 0.0, 0.0, 0.0, 4.0]);
        let limited = limit(&wanted, &JointVector::zeros());
        assert_eq!(limited.limited_by, Some(Limitation::JointSpeed { joint: 1 }));
        assert!((limited.velocity_rad_per_s - wanted / 3.0).norm() < 1e-12, "{limited:?}");
        let limited = limit(&(wanted * 0.3), &JointVector::zeros());
        assert_eq!((limited.limited_by, limited.share), (None, 1.0));
    }

    #[test]
    fn a_joint_near_its_end_slows_outwards_and_not_inwards() {
        let mut position = JointVector::zeros();
        position[3] = -2.15;
        let outwards = JointVector::from([0.1, 0.0, 0.0, -0.4, 0.0, 0.0, 0.0]);
        let limited = limit(&outwards, &position);
        assert_eq!(limited.limited_by, Some(Limitation::JointRange { joint: 3 }));
        assert!((limited.velocity_rad_per_s - outwards * 0.25).norm() < 1e-12, "{limited:?}");
        assert_eq!(limit(&-outwards, &position).share, 1.0);
        position[3] = -2.25;
        assert_eq!(limit(&outwards, &position).share, 0.0);
        assert_eq!(limit(&-outwards, &position).share, 1.0);
    }

    #[test]
    fn an_elbow_is_not_stretched_beyond_its_bound_on_either_side_and_always_bends() {
        let bending = JointVector::from([0.1, 0.0, 0.0, 0.4, 0.0, 0.0, 0.0]);
        for side in [-1.0, 1.0] {
            let mut position = JointVector::zeros();
            position[ELBOW] = 0.15 * side;
            let stretching = bending * -side;
            let limited = limit(&stretching, &position);
            assert_eq!(limited.limited_by, Some(Limitation::ElbowStretched));
            assert!((limited.velocity_rad_per_s - stretching * 0.25).norm() < 1e-12, "{limited:?}");
            assert_eq!(limit(&-stretching, &position).share, 1.0);
            position[ELBOW] = 0.05 * side;
            assert_eq!(limit(&stretching, &position).share, 0.0);
            assert_eq!(limit(&-stretching, &position).share, 1.0);
            let free = JointBounds { limits: &limits(), limit_approach_per_s: LIMIT_APPROACH_PER_S, elbow: None };
            assert_eq!(free.limit(&stretching, &position).share, 1.0);
        }
    }

    #[test]
    fn a_secondary_velocity_takes_nothing_from_the_primary_one() {
        let limits = limits();
        let bounds =
            JointBounds { limits: &limits, limit_approach_per_s: LIMIT_APPROACH_PER_S, elbow: Some((ELBOW, 0.1)) };
        let position = JointVector::from([0.0, 0.0, 0.0, -2.1, 0.0, 0.0, 0.0]);
        let share =
            |primary: [f64; 7], secondary: [f64; 7]| bounds.share_beside(&primary.into(), &secondary.into(), &position);
        let still = [0.0; 7];
        assert_eq!(share(still, [0.2, -0.1, 0.0, 0.1, 0.0, 0.0, 0.0]), 1.0);
        // The limit of joint 1 is 0.5 rad/s: 0.1 rad/s remain, half of the secondary velocity.
        assert!((share([0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.2, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]) - 0.5).abs() < 1e-12);
        assert_eq!(share([0.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]), 0.0);
        // In the direction opposite to the primary velocity the margin is larger.
        assert_eq!(share([0.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [-0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]), 1.0);
        // At 0.1 rad from the end of its range the limit of joint 4 is 0.2 rad/s outwards.
        assert!(
            (share([0.0, 0.0, 0.0, -0.1, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, -0.4, 0.0, 0.0, 0.0]) - 0.25).abs() < 1e-12
        );
    }
}
