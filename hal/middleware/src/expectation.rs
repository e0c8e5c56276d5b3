//! Expected joint positions after the commands.

use std::collections::VecDeque;
use std::time::Duration;

use pb3dp_kinematics::{DOF, JointVector};

/// Differences decay while a joint moves by this distance, rad: drives with a speed error of one per cent must not accumulate over
/// minutes. A joint that does not move keeps its difference, however slow its command is.
const MEMORY_RAD: f64 = 1.0;

/// Speed differences below this are ignored, rad/s: commands are rounded to 2e-4 rad/s, and drives drift and stick slightly.
const DRIFT_RAD_PER_S: f64 = 0.002;

/// While the arm is commanded to hold, the creep of a joint is forgotten with this time constant, seconds: a joint that settles after a
/// stop, or moves with the temperature, must not accumulate over hours.
const DRIFT_MEMORY_S: f64 = 60.0;

/// A model that is slower than this is stationary, rad/s: below any command, which is rounded to 2e-4 rad/s.
const STATIONARY_RAD_PER_S: f64 = 1e-4;

/// The joints have settled after this time of a stationary model, seconds: ten time constants of slow drives.
const SETTLES_S: f64 = 0.5;

/// The model is advanced in steps of at most this, seconds.
const STEP_S: f64 = 1e-3;

/// Maximum number of steps at once: after a longer silence the model is stationary with its command anyway.
const STEPS_MAX: usize = 1000;

/// Maximum number of commands in the dead time; more would need shorter cycles than any arm has.
const PENDING_MAX: usize = 256;

/// Model of drives that follow a velocity after a dead time, with a first-order lag and an acceleration limit; and the difference
/// between the measured joints and this model.
pub(crate) struct Expectation {
    acceleration_max_rad_per_s2: JointVector,
    delay_s: f64,
    lag_s: f64,
    /// Since the first sample, seconds.
    now_s: f64,
    /// Commands within the dead time, and when they take effect.
    pending: VecDeque<(f64, JointVector)>,
    commanded_rad_per_s: JointVector,
    velocity_rad_per_s: JointVector,
    error_rad: JointVector,
    /// Time for which the model has been stationary, seconds.
    stationary_s: f64,
    /// Creep of the joints since they settled.
    drift_rad: JointVector,
}

impl Expectation {
    pub(crate) fn new(acceleration_max_rad_per_s2: JointVector, delay: Duration, lag: Duration) -> Self {
        let zeros = JointVector::zeros();
        Self {
            acceleration_max_rad_per_s2,
            delay_s: delay.as_secs_f64(),
            lag_s: lag.as_secs_f64().max(STEP_S),
            now_s: 0.0,
            pending: VecDeque::with_capacity(PENDING_MAX),
            commanded_rad_per_s: zeros,
            velocity_rad_per_s: zeros,
            error_rad: zeros,
            stationary_s: 0.0,
            drift_rad: zeros,
        }
    }

    /// From the time of the last sample on, the joints are commanded these velocities, rad/s.
    pub(crate) fn command(&mut self, velocity_rad_per_s: &JointVector) {
        if self.pending.len() == PENDING_MAX {
            self.arrive();
        }
        self.pending.push_back((self.now_s + self.delay_s, *velocity_rad_per_s));
    }

    fn arrive(&mut self) {
        if let Some((_, velocity_rad_per_s)) = self.pending.pop_front() {
            self.commanded_rad_per_s = velocity_rad_per_s;
        }
    }

    /// Stationary at the expected position.
    pub(crate) fn forget(&mut self) {
        let zeros = JointVector::zeros();
        self.pending.clear();
        (self.commanded_rad_per_s, self.velocity_rad_per_s, self.error_rad) = (zeros, zeros, zeros);
        (self.stationary_s, self.drift_rad) = (0.0, zeros);
    }

    /// Creep of the joints while they are commanded to hold, rad, after a motion by `moved_rad` within `dt`; zero in motion. It is forgotten
    /// slowly. Call it after [`Self::error_after`].
    pub(crate) fn drift_after(&mut self, moved_rad: &JointVector, dt: Duration) -> JointVector {
        let dt_s = dt.as_secs_f64();
        let commands = self.pending.iter().map(|(_, command)| command).chain([&self.commanded_rad_per_s]);
        let is_held = commands.map(JointVector::amax).all(|speed| speed == 0.0);
        let is_stationary = is_held && self.velocity_rad_per_s.amax() <= STATIONARY_RAD_PER_S;
        self.stationary_s = if is_stationary { self.stationary_s + dt_s } else { 0.0 };
        self.drift_rad = if self.stationary_s > SETTLES_S {
            self.drift_rad * (-dt_s / DRIFT_MEMORY_S).exp() + moved_rad
        } else {
            JointVector::zeros()
        };
        self.drift_rad
    }

    /// How long the joints have been commanded to hold.
    pub(crate) fn held_for(&self) -> Duration {
        Duration::from_secs_f64(self.stationary_s)
    }

    /// Difference between the joints and their model, rad, after a motion by `moved_rad` within `dt`.
    pub(crate) fn error_after(&mut self, moved_rad: &JointVector, dt: Duration) -> JointVector {
        let dt_s = dt.as_secs_f64();
        let steps = ((dt_s / STEP_S).ceil() as usize).clamp(1, STEPS_MAX);
        let step_s = (dt_s / steps as f64).min(STEP_S);
        let mut expected_rad = JointVector::zeros();
        for step in 0..steps {
            let at_s = self.now_s + step_s * step as f64;
            while self.pending.front().is_some_and(|(arrives_s, _)| *arrives_s <= at_s) {
                self.arrive();
            }
            for joint in 0..DOF {
                let most = self.acceleration_max_rad_per_s2[joint];
                let wanted = (self.commanded_rad_per_s[joint] - self.velocity_rad_per_s[joint]) / self.lag_s;
                let before = self.velocity_rad_per_s[joint];
                self.velocity_rad_per_s[joint] += wanted.clamp(-most, most) * step_s;
                expected_rad[joint] += 0.5 * (before + self.velocity_rad_per_s[joint]) * step_s;
            }
        }
        self.now_s += dt_s;
        // Remainder of a silence that is longer than the steps.
        expected_rad += self.velocity_rad_per_s * (dt_s - step_s * steps as f64).max(0.0);
        for joint in 0..DOF {
            let kept = self.error_rad[joint] * (-moved_rad[joint].abs() / MEMORY_RAD).exp();
            let error = kept + moved_rad[joint] - expected_rad[joint];
            self.error_rad[joint] = error.signum() * (error.abs() - DRIFT_RAD_PER_S * dt_s).max(0.0);
        }
        self.error_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn expectation() -> Expectation {
        Expectation::new(JointVector::repeat(2.0), Duration::ZERO, Duration::from_millis(30))
    }

    /// By hand: at a command of 1 rad/s, a stationary joint falls behind by 10 rad in 10 s, less 0.25 rad of the ramp, 0.015 rad
    /// of the lag and 0.02 rad of permitted drift.
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
        assert!((error[3] + 9.715).abs() < 0.02 && error[0] == 0.0, "{error}");
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

    /// Ramps take seconds: a delay that is modelled as a lag makes drives appear to be ahead for the whole ramp.
    #[test]
    fn a_delay_is_not_a_lag() {
        let drives = |delay_ms: u64, lag_ms: u64| {
            Expectation::new(JointVector::repeat(5.0), Duration::from_millis(delay_ms), Duration::from_millis(lag_ms))
        };
        for (delay_ms, lag_ms, is_right) in [(15, 30, true), (0, 45, false)] {
            let mut expectation = drives(delay_ms, lag_ms);
            let (mut velocity, mut largest) = (0.0_f64, 0.0_f64);
            for k in 0..600 {
                // Full speed in both directions; the drives receive commands 15 ms late.
                let command_at = |ms: i64| if (ms.max(0) / 2000) % 2 == 0 { 6.0 } else { -6.0 };
                expectation.command(&JointVector::repeat(command_at(10 * k)));
                let mut moved = 0.0;
                for tenth in 0..100 {
                    let executed = if 10 * k + tenth / 10 < 15 { 0.0 } else { command_at((100 * k + tenth) / 10 - 15) };
                    velocity += ((executed - velocity) / 0.03).clamp(-5.0, 5.0) * 1e-4;
                    moved += velocity * 1e-4;
                }
                let error = expectation.error_after(&JointVector::repeat(moved), Duration::from_millis(10));
                largest = largest.max(error.amax());
            }
            assert_eq!(largest < 0.02, is_right, "delay {delay_ms} ms, lag {lag_ms} ms: {largest} rad");
            assert_eq!(largest > 0.05, !is_right, "delay {delay_ms} ms, lag {lag_ms} ms: {largest} rad");
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
    /// At the speed of a jog, 0.02 rad/s: a blocked joint is 0.05 rad behind after 3 s, with any step.
    #[test]
    fn a_joint_that_is_blocked_at_the_speed_of_a_jog_falls_behind() {
        for step_ms in [2, 10, 40] {
            let mut expectation = expectation();
            expectation.command(&JointVector::repeat(0.02));
            let mut error = JointVector::zeros();
            for _ in 0..(3000 / step_ms) {
                error = expectation.error_after(&JointVector::zeros(), Duration::from_millis(step_ms));
            }
            assert!((error[6] + 3.0 * 0.018 - 0.02 * 0.03).abs() < 5e-4, "steps of {step_ms} ms: {error}");
        }
    }

    /// In motion a drift is no error, because the controller that commands the motion corrects it.
    #[test]
    fn a_drive_that_drifts_for_hours_in_motion_is_none_that_runs_away() {
        for (drift_rad_per_s, is_error) in [(0.0019, false), (0.004, true)] {
            let mut expectation = expectation();
            expectation.command(&JointVector::repeat(1e-3));
            let mut error = JointVector::zeros();
            for _ in 0..360_000 {
                let moved_rad = JointVector::repeat((1e-3 + drift_rad_per_s) / 100.0);
                error = expectation.error_after(&moved_rad, Duration::from_millis(10));
                assert_eq!(expectation.drift_after(&moved_rad, Duration::from_millis(10)), JointVector::zeros());
            }
            assert_eq!(error.amax() > 0.05, is_error, "{drift_rad_per_s} rad/s: {error}");
        }
    }

    /// By hand: a creep r is forgotten with 60 s, so it reaches 0.02 rad after -60 s ln(1 - 0.02 / (60 s r)) and half a second.
    #[test]
    fn a_drive_that_creeps_while_it_holds_is_found() {
        for (creep_rad_per_s, expected_s) in
            [(0.001, Some(24.8)), (0.0015, Some(15.6)), (0.002, Some(11.4)), (0.0003, None)]
        {
            let mut expectation = expectation();
            expectation.command(&JointVector::zeros());
            let (moved_rad, cycle) = (JointVector::repeat(creep_rad_per_s / 100.0), Duration::from_millis(10));
            let found = (1..360_000).find(|_| {
                expectation.error_after(&moved_rad, cycle);
                expectation.drift_after(&moved_rad, cycle).amax() > 0.02
            });
            let found_s = found.map(|steps| f64::from(steps) / 100.0);
            let is_expected = match (found_s, expected_s) {
                (Some(found_s), Some(expected_s)) => (found_s - expected_s).abs() < 0.5,
                (found_s, expected_s) => found_s.is_none() && expected_s.is_none(),
            };
            assert!(is_expected, "{creep_rad_per_s} rad/s: after {found_s:?} s instead of {expected_s:?}");
        }
    }
}
