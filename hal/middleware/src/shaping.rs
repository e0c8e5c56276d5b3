//! From a desired joint velocity to one that keeps every limit. Pure functions; rad, rad/s, rad/s^2, s.

use pb3dp_kinematics::{DOF, JointLimits, JointVector};

/// The velocities that are allowed at a place, and why.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Caps {
    pub lower: JointVector,
    pub upper: JointVector,
    /// Whether the way to a limit, and not the joint's speed, is what limits: downwards and upwards.
    pub by_position: [[bool; 2]; DOF],
}

/// What became of a desired velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shaped {
    pub velocity: JointVector,
    pub speed_limited: bool,
    pub position_limited: bool,
    pub acceleration_limited: bool,
}

/// Largest speed towards a limit from which a joint, after going on for the reaction time, still stops within `distance`:
/// the solution v = a (-T + sqrt(T^2 + 2 d / a)) of v T + v^2 / (2 a) = d, in a form without cancellation.
pub(crate) fn braking_speed(distance: f64, acceleration: f64, reaction_s: f64) -> f64 {
    if distance <= 0.0 {
        return 0.0;
    }
    2.0 * distance / (reaction_s + (reaction_s * reaction_s + 2.0 * distance / acceleration).sqrt())
}

/// Allowed velocities for joints at `position` with these limits (speeds already scaled).
pub(crate) fn caps(
    position: &JointVector,
    limits: &JointLimits,
    speed_scale: f64,
    acceleration: &JointVector,
    reaction_s: f64,
) -> Caps {
    let mut caps = Caps { lower: JointVector::zeros(), upper: JointVector::zeros(), by_position: [[false; 2]; DOF] };
    for i in 0..DOF {
        let speed = speed_scale * limits.velocity_max_rad_per_s()[i];
        let towards_min = braking_speed(position[i] - limits.position_min_rad()[i], acceleration[i], reaction_s);
        let towards_max = braking_speed(limits.position_max_rad()[i] - position[i], acceleration[i], reaction_s);
        caps.lower[i] = -towards_min.min(speed);
        caps.upper[i] = towards_max.min(speed);
        caps.by_position[i] = [towards_min < speed, towards_max < speed];
    }
    caps
}

/// The velocity nearest to `desired` that keeps the caps and, where the caps permit, changes by no more than `change_max`.
///
/// Too fast: the whole vector is scaled, so that the hand keeps its direction. Too sudden: the whole vector is scaled as far as
/// that helps; where no multiple of `desired` can be reached at once (the direction changes), each joint goes as far as it may.
/// A cap that has become narrower than the acceleration allows is kept nevertheless.
pub(crate) fn shape(desired: &JointVector, previous: &JointVector, caps: &Caps, change_max: &JointVector) -> Shaped {
    let mut shaped =
        Shaped { velocity: *desired, speed_limited: false, position_limited: false, acceleration_limited: false };
    let mut scale = 1.0f64;
    for i in 0..DOF {
        let upwards = desired[i] > 0.0;
        let cap = if upwards { caps.upper[i] } else { -caps.lower[i] };
        if desired[i].abs() > cap {
            scale = scale.min(cap / desired[i].abs());
            let by_position = caps.by_position[i][usize::from(upwards)];
            shaped.position_limited |= by_position;
            shaped.speed_limited |= !by_position;
        }
    }
    let target = desired * scale;
    let reachable = |i: usize| {
        let (lower, upper) = (caps.lower[i], caps.upper[i]);
        ((previous[i] - change_max[i]).clamp(lower, upper), (previous[i] + change_max[i]).clamp(lower, upper))
    };
    let multiple = largest_multiple(&target, reachable).unwrap_or(1.0);
    for i in 0..DOF {
        let (lower, upper) = reachable(i);
        shaped.velocity[i] = (multiple * target[i]).clamp(lower, upper);
    }
    shaped.acceleration_limited = (shaped.velocity - target).amax() > 1e-12;
    shaped
}

/// The largest number from 0 to 1 by which `target` must be multiplied to come into all intervals, if there is one.
fn largest_multiple(target: &JointVector, interval: impl Fn(usize) -> (f64, f64)) -> Option<f64> {
    let (mut least, mut most) = (0.0f64, 1.0f64);
    for i in 0..DOF {
        let (lower, upper) = interval(i);
        if target[i] == 0.0 {
            if lower > 0.0 || upper < 0.0 {
                return None;
            }
            continue;
        }
        let (a, b) = (lower / target[i], upper / target[i]);
        least = least.max(a.min(b));
        most = most.min(a.max(b));
    }
    (least <= most).then_some(most)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn limits() -> JointLimits {
        let max = JointVector::from([2.9, 1.5, 2.8, 2.2, 4.3, 2.7, 4.2]);
        JointLimits::new(-max, max * 0.9, JointVector::from([1.0, 1.1, 2.0, 2.1, 6.0, 6.1, 6.2])).unwrap()
    }

    fn acceleration() -> JointVector {
        JointVector::from([2.0, 2.0, 2.5, 2.5, 5.0, 5.0, 5.0])
    }

    /// By hand: a = 2, T = 0.1, d = 0.15 gives 2 (-0.1 + sqrt(0.01 + 0.15)) = 0.6; then 0.06 + 0.36/4 = 0.15.
    #[test]
    fn braking_speed_by_hand() {
        assert!((braking_speed(0.15, 2.0, 0.1) - 0.6).abs() < 1e-15);
        assert!((braking_speed(0.25, 2.0, 0.0) - 1.0).abs() < 1e-15, "v^2 = 2 a d without reaction time");
        assert_eq!(braking_speed(0.0, 2.0, 0.1), 0.0);
        assert_eq!(braking_speed(-0.1, 2.0, 0.0), 0.0);
        let close = braking_speed(1e-9, 2.0, 0.1);
        assert!((close / 1e-8 - 1.0).abs() < 1e-6, "d/T close to the limit: {close}");
    }

    #[test]
    fn outside_its_range_a_joint_may_only_return() {
        let mut position = JointVector::zeros();
        position[1] = 1.4;
        position[3] = -2.3;
        let caps = caps(&position, &limits(), 0.5, &acceleration(), 0.05);
        assert_eq!((caps.lower[1], caps.upper[1]), (-0.55, 0.0));
        assert_eq!((caps.lower[3], caps.upper[3]), (0.0, 1.05));
        assert_eq!((caps.lower[0], caps.upper[0]), (-0.5, 0.5));
        assert_eq!(caps.by_position[1], [false, true]);
    }

    #[test]
    fn too_fast_scales_the_whole_vector() {
        let caps = caps(&JointVector::zeros(), &limits(), 0.5, &acceleration(), 0.05);
        let desired = JointVector::from([0.2, -1.1, 0.3, 0.0, 0.1, 0.0, -0.4]);
        let shaped = shape(&desired, &(desired * 0.5), &caps, &JointVector::repeat(1.0));
        assert!((shaped.velocity - desired * 0.5).amax() < 1e-15, "{shaped:?}");
        assert!(shaped.speed_limited && !shaped.position_limited && !shaped.acceleration_limited, "{shaped:?}");
    }

    #[test]
    fn a_joint_at_its_limit_holds_the_whole_arm() {
        let mut position = JointVector::zeros();
        position[5] = limits().position_max_rad()[5];
        let caps = caps(&position, &limits(), 0.5, &acceleration(), 0.05);
        let shaped = shape(&JointVector::repeat(0.1), &JointVector::zeros(), &caps, &JointVector::repeat(1.0));
        assert_eq!(shaped.velocity, JointVector::zeros());
        assert!(shaped.position_limited && !shaped.speed_limited);
        let away = shape(&JointVector::repeat(-0.1), &JointVector::zeros(), &caps, &JointVector::repeat(1.0));
        assert_eq!(away.velocity, JointVector::repeat(-0.1), "away from the limit all is free");
    }

    #[test]
    fn a_start_keeps_its_direction() {
        let caps = caps(&JointVector::zeros(), &limits(), 1.0, &acceleration(), 0.05);
        let desired = JointVector::from([0.5, -0.25, 0.0, 0.1, 0.2, 0.0, 1.0]);
        let shaped = shape(&desired, &JointVector::zeros(), &caps, &(acceleration() * 0.01));
        assert!((shaped.velocity - desired * 0.04).amax() < 1e-15, "S1 needs most: 0.02 of 0.5; {shaped:?}");
        assert!(shaped.acceleration_limited);
    }

    #[test]
    fn a_change_of_direction_moves_each_joint_as_far_as_it_may() {
        let caps = caps(&JointVector::zeros(), &limits(), 1.0, &acceleration(), 0.05);
        let mut previous = JointVector::zeros();
        previous[0] = 0.5;
        let mut desired = JointVector::zeros();
        desired[1] = 0.01;
        let shaped = shape(&desired, &previous, &caps, &JointVector::repeat(0.02));
        assert!((shaped.velocity[0] - 0.48).abs() < 1e-15 && (shaped.velocity[1] - 0.01).abs() < 1e-15, "{shaped:?}");
    }

    fn any_vector(size: f64) -> impl Strategy<Value = JointVector> {
        prop::array::uniform7(-size..size).prop_map(JointVector::from)
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2000) })]

        #[test]
        fn caps_always_hold(
            position in any_vector(5.0), desired in any_vector(20.0), previous in any_vector(7.0),
            scale in 0.05..1.0f64, reaction in 0.0..0.3f64, step in 0.0..0.05f64,
        ) {
            let caps = caps(&position, &limits(), scale, &acceleration(), reaction);
            let change_max = acceleration() * step;
            let shaped = shape(&desired, &previous, &caps, &change_max);
            for i in 0..DOF {
                let v = shaped.velocity[i];
                prop_assert!(caps.lower[i] <= v && v <= caps.upper[i], "joint {i}: {v} {caps:?}");
                prop_assert!(v.abs() <= scale * limits().velocity_max_rad_per_s()[i]);
                let kept_cap = v == caps.lower[i] || v == caps.upper[i];
                prop_assert!(kept_cap || (v - previous[i]).abs() <= change_max[i] + 1e-12, "joint {i}: {v}");
            }
        }

        #[test]
        fn from_rest_the_direction_is_kept(position in any_vector(2.0), desired in any_vector(20.0), step in 0.001..0.05f64) {
            let caps = caps(&position, &limits(), 0.6, &acceleration(), 0.05);
            let shaped = shape(&desired, &JointVector::zeros(), &caps, &(acceleration() * step));
            let along = shaped.velocity.dot(&desired) / desired.norm_squared();
            prop_assert!((0.0..=1.0).contains(&along));
            prop_assert!((shaped.velocity - desired * along).amax() < 1e-12, "{shaped:?}");
        }
    }
}
