//! Where joints should be after the commands that they got.

use std::time::Duration;

use pb3dp_kinematics::{DOF, JointVector};

/// Differences fade with this time constant, seconds: what counts is whether a joint follows now, and drives that are a
/// hundredth too slow or too fast must not add up over minutes.
const MEMORY_S: f64 = 2.0;

/// The model is advanced in steps of at most this, seconds.
const STEP_S: f64 = 1e-3;

/// No more steps than this at once: after a longer silence the model is at rest with its command anyhow.
const STEPS_MAX: usize = 1000;

/// Drives that follow a velocity with a lag of first order and a limited acceleration, and how far the measured joints have
/// moved away from what these would have done.
pub(crate) struct Expectation {
    acceleration_max_rad_per_s2: JointVector,
    lag_s: f64,
    commanded_rad_per_s: JointVector,
    velocity_rad_per_s: JointVector,
    error_rad: JointVector,
}

impl Expectation {
    pub(crate) fn new(acceleration_max_rad_per_s2: JointVector, lag: Duration) -> Self {
        let zeros = JointVector::zeros();
        Self {
            acceleration_max_rad_per_s2,
            lag_s: lag.as_secs_f64().max(STEP_S),
            commanded_rad_per_s: zeros,
            velocity_rad_per_s: zeros,
            error_rad: zeros,
        }
    }

    /// From now on the joints are told to move like this, rad/s.
    pub(crate) fn command(&mut self, velocity_rad_per_s: &JointVector) {
        self.commanded_rad_per_s = *velocity_rad_per_s;
    }

    /// At rest, and where it should be.
    pub(crate) fn forget(&mut self) {
        *self = Self::new(self.acceleration_max_rad_per_s2, Duration::from_secs_f64(self.lag_s));
    }

    /// How far the joints are from where their commands lead, rad, after they have moved by `moved_rad` within `dt`.
    pub(crate) fn error_after(&mut self, moved_rad: &JointVector, dt: Duration) -> JointVector {
        let dt_s = dt.as_secs_f64();
        let steps = ((dt_s / STEP_S).ceil() as usize).clamp(1, STEPS_MAX);
        let step_s = (dt_s / steps as f64).min(STEP_S);
        let mut expected_rad = JointVector::zeros();
        for _ in 0..steps {
            for joint in 0..DOF {
                let most = self.acceleration_max_rad_per_s2[joint];
                let wanted = (self.commanded_rad_per_s[joint] - self.velocity_rad_per_s[joint]) / self.lag_s;
                let before = self.velocity_rad_per_s[joint];
                self.velocity_rad_per_s[joint] += wanted.clamp(-most, most) * step_s;
                expected_rad[joint] += 0.5 * (before + self.velocity_rad_per_s[joint]) * step_s;
            }
        }
        // What is left of a silence that is longer than the steps.
        expected_rad += self.velocity_rad_per_s * (dt_s - step_s * steps as f64).max(0.0);
        self.error_rad = self.error_rad * (-dt_s / MEMORY_S).exp() + (moved_rad - expected_rad);
        self.error_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expectation() -> Expectation {
        Expectation::new(JointVector::repeat(2.0), Duration::from_millis(30))
    }

    /// By hand: told to move at 1 rad/s, a joint that stays where it is falls behind by what fades with 2 s; after 10 s that is
    /// 2 rad, less the ramp at the beginning, which has faded as well.
    #[test]
    fn a_joint_that_does_not_move_falls_behind() {
        let mut expectation = expectation();
        let mut command = JointVector::zeros();
        command[3] = 1.0;
        expectation.command(&command);
        let mut error = JointVector::zeros();
        for _ in 0..1000 {
            error = expectation.error_after(&JointVector::zeros(), Duration::from_millis(10));
        }
        assert!((error[3] + 2.0).abs() < 0.02 && error[0] == 0.0, "{error}");
    }

    #[test]
    fn drives_that_follow_leave_no_error_and_steps_do_not_matter() {
        for step_ms in [2, 10, 40] {
            let mut expectation = expectation();
            let command = JointVector::repeat(0.3);
            expectation.command(&command);
            let (mut velocity, mut largest) = (0.0_f64, 0.0_f64);
            for _ in 0..(2000 / step_ms) {
                // The same drives, in steps of 0.1 ms.
                let mut moved = 0.0;
                for _ in 0..(10 * step_ms) {
                    velocity += ((0.3 - velocity) / 0.03).clamp(-2.0, 2.0) * 1e-4;
                    moved += velocity * 1e-4;
                }
                let error = expectation.error_after(&JointVector::repeat(moved), Duration::from_millis(step_ms));
                largest = largest.max(error.amax());
            }
            assert!(largest < 5e-4, "steps of {step_ms} ms: {largest} rad");
        }
    }

    #[test]
    fn a_hundredth_too_slow_never_adds_up() {
        let mut expectation = expectation();
        expectation.command(&JointVector::repeat(1.0));
        let mut error = JointVector::zeros();
        for _ in 0..6000 {
            error = expectation.error_after(&JointVector::repeat(0.0099), Duration::from_millis(10));
        }
        assert!(error.amax() < 0.025, "{error}");
    }
}
