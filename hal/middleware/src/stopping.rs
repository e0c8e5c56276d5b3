//! Stopping distance of a joint, and the speed that it allows. Pure functions of one joint; rad, rad/s, rad/s^2, rad/s^3, s.

use pb3dp_kinematics::{EffectiveLimits, JointVector};

/// Limits on changes of velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DriveLimits {
    /// Largest acceleration of each joint, rad/s^2.
    pub acceleration: JointVector,
    /// Largest jerk of each joint, rad/s^3.
    pub jerk: JointVector,
}

/// The same for one joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct DriveLimit {
    pub acceleration: f64,
    pub jerk: f64,
}

impl DriveLimits {
    pub(crate) fn braking(limits: &EffectiveLimits) -> Self {
        Self { acceleration: *limits.acceleration_max_rad_per_s2(), jerk: *limits.jerk_max_rad_per_s3() }
    }

    pub(crate) fn of(&self, joint: usize) -> DriveLimit {
        DriveLimit { acceleration: self.acceleration[joint], jerk: self.jerk[joint] }
    }
}

impl DriveLimit {
    /// Additional time of a velocity ramp because of the jerk limit: half at its beginning, half at its end.
    pub(crate) fn rounding_s(&self) -> f64 {
        self.acceleration / (2.0 * self.jerk)
    }

    /// Acceleration for the next `dt` towards a velocity that is `difference` away. If the acceleration then returns to 0 with the
    /// allowed jerk, the velocity is reached without overshoot: a dt + a^2 / (2 j) = |difference|. Later steps may have any length:
    /// a sum over steps of a falling acceleration is less than its integral.
    pub(crate) fn towards(&self, difference: f64, dt: f64) -> f64 {
        let size = difference.abs();
        let acceleration = 2.0 * size / (dt + (dt * dt + 2.0 * size / self.jerk).sqrt());
        if size > 0.0 { acceleration.min(self.acceleration).copysign(difference) } else { 0.0 }
    }

    /// Farthest upward excursion (0 or more) of a joint with this velocity and acceleration that stops within the limits of
    /// acceleration and jerk. An upper bound, and exact if the acceleration does not change the sign of the velocity.
    pub(crate) fn way_to_rest(&self, velocity: f64, acceleration: f64) -> f64 {
        let (most, jerk) = (self.acceleration, self.jerk);
        if acceleration > 0.0 {
            // First the acceleration returns to 0: this takes a / j.
            let peak = velocity + acceleration * acceleration / (2.0 * jerk);
            let meanwhile = velocity.max(0.0) * acceleration / jerk + acceleration.powi(3) / (3.0 * jerk * jerk);
            return if peak > 0.0 { meanwhile + self.way_from_steady(peak) } else { 0.0 };
        }
        if velocity <= 0.0 {
            return 0.0;
        }
        let braking = (-acceleration).min(most);
        let taken_by_fading = braking * braking / (2.0 * jerk);
        if velocity < taken_by_fading {
            // Deceleration that is stronger than necessary: it fades so that the joint ends at standstill.
            return velocity * (2.0 * velocity / jerk).sqrt() / 3.0;
        }
        // Equals a deceleration that began braking / j earlier, minus the distance of that time.
        let began_with = velocity + taken_by_fading;
        let before = braking / jerk * (began_with - braking * braking / (6.0 * jerk));
        (self.way_from_steady(began_with) - before).max(0.0)
    }

    /// Stopping distance from a constant velocity: jerk, limited acceleration, jerk; or without the middle part.
    fn way_from_steady(&self, velocity: f64) -> f64 {
        let (most, jerk) = (self.acceleration, self.jerk);
        if velocity >= most * most / jerk {
            velocity * velocity / (2.0 * most) + velocity * self.rounding_s()
        } else {
            velocity * (velocity / jerk).sqrt()
        }
    }
}

/// Largest speed towards a limit from which a joint, after the reaction time, still stops within `distance`:
/// the solution v = a (-T + sqrt(T^2 + 2 d / a)) of v T + v^2 / (2 a) = d, in a form without cancellation.
pub(crate) fn braking_speed(distance: f64, acceleration: f64, reaction_s: f64) -> f64 {
    if distance <= 0.0 {
        return 0.0;
    }
    2.0 * distance / (reaction_s + (reaction_s * reaction_s + 2.0 * distance / acceleration).sqrt())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const LIMIT: DriveLimit = DriveLimit { acceleration: 2.0, jerk: 20.0 };

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

    /// By hand: from 0.6 rad/s with 2 rad/s^2 and 20 rad/s^3 it takes 0.1 s to build up full braking, 0.2 s at full braking, 0.1
    /// s to fade it out: 0.36/4 + 0.6 x 0.05 = 0.12 rad. From 0.1 rad/s full braking is not reached: 0.1 sqrt(0.1/20).
    #[test]
    fn ways_to_rest_by_hand() {
        assert!((LIMIT.way_to_rest(0.6, 0.0) - 0.12).abs() < 1e-15);
        assert!((LIMIT.way_to_rest(0.1, 0.0) - 0.1 * 0.005f64.sqrt()).abs() < 1e-15);
        // 0.05 s after the start of this braking: v = 0.6 - 20 x 0.05^2 / 2, a = -1, distance 0.6 x 0.05 - 20 x 0.05^3 / 6.
        let done = 0.6 * 0.05 - 20.0 * 0.05f64.powi(3) / 6.0;
        assert!((LIMIT.way_to_rest(0.575, -1.0) - (0.12 - done)).abs() < 1e-15);
        // Fading out full acceleration takes 0.1 s and adds 0.1 rad/s.
        let meanwhile = 0.5 * 0.1 + 2.0 * 0.01 / 2.0 - 20.0 * 0.001 / 6.0;
        assert!((LIMIT.way_to_rest(0.5, 2.0) - (meanwhile + 0.12)).abs() < 1e-15);
        // Braking that fades out in T ends at standstill if v = j T^2 / 2, after j T^3 / 6.
        let fading_s = (2.0f64 * 0.05 / 20.0).sqrt();
        assert!((LIMIT.way_to_rest(0.05, -2.0) - 20.0 * fading_s.powi(3) / 6.0).abs() < 1e-15);
        assert_eq!(LIMIT.way_to_rest(-0.6, 0.0), 0.0);
        assert_eq!(LIMIT.way_to_rest(-0.6, 2.0), 0.0, "it is at -0.5 when the acceleration is gone");
        assert!(LIMIT.way_to_rest(-0.05, 2.0) > 0.0, "it is at +0.05 when the acceleration is gone");
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

        /// Steps of any length towards standstill keep the limits of acceleration and jerk, never overshoot, and end within the
        /// distance.
        #[test]
        fn steps_to_rest_end_within_the_way(
            velocity in 0.0..6.0f64, part in -1.0..1.0f64, steps in prop::collection::vec(0.002..0.02f64, 3000),
        ) {
            let mut acceleration = part * LIMIT.acceleration;
            let mut velocity = if acceleration < 0.0 { velocity + part * part * 0.1 } else { velocity };
            let (way, longest) = (LIMIT.way_to_rest(velocity, acceleration), 0.02);
            let (mut gone, mut fastest) = (0.0, velocity);
            for dt in steps {
                let next = LIMIT
                    .towards(-velocity, dt)
                    .clamp(acceleration - LIMIT.jerk * dt, acceleration + LIMIT.jerk * dt);
                prop_assert!(next.abs() <= LIMIT.acceleration + 1e-12, "{next}");
                velocity += next * dt;
                acceleration = next;
                fastest = f64::max(fastest, velocity);
                gone += velocity * dt;
                prop_assert!(velocity > -1e-9, "{velocity}");
            }
            prop_assert!(velocity < 1e-3, "{velocity}");
            prop_assert!(gone <= way + fastest * longest + 1e-9, "{gone} {way}");
        }
    }
}
