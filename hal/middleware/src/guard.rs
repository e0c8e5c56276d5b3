//! The guard: compares the motion of an arm with its commands and with the abilities of the arm.

use std::task::Poll;
use std::time::Duration;

use pb3dp_hal_api::{
    Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, JointCommand, JointState, PowerOrder, RecentFailures,
};
use pb3dp_kinematics::{DOF, EffectiveLimits, JointLimits, JointLimitsError, JointVector};

use crate::expectation::Expectation;
use crate::power::close_brakes;

/// Mechanical range of a PA-10 to both sides, degrees, base to tip (INRIA's model of the PA10-7CE).
pub const PA10_MECHANICAL_RANGE_DEG: [f64; DOF] = [180.0, 97.0, 180.0, 143.0, 270.0, 180.0, 270.0];

/// Expected properties of the arm besides its limits.
#[derive(Clone, Debug, PartialEq)]
pub struct GuardConfig {
    /// Mechanical stops, rad: an angle beyond them is a wrong encoder or zero.
    pub mechanical_min_rad: JointVector,
    /// Upper ends of that range, rad.
    pub mechanical_max_rad: JointVector,
    /// By how much a measured speed may exceed the limit, rad/s: geared drives have speed ripple.
    pub ripple_rad_per_s: f64,
    /// Dead time from a command to the response of the drives.
    pub delay: Duration,
    /// First-order lag of the drives.
    pub lag: Duration,
    /// Largest tracking error of a joint, rad ...
    pub tracking_error_max_rad: f64,
    /// ... for this long.
    pub tracking_error_for: Duration,
}

impl GuardConfig {
    /// The largest tolerances of tracking for a PA-10: 0.05 rad for 100 ms.
    pub const TRACKING_ERROR_MAX_RAD: f64 = 0.05;
    /// See [`Self::TRACKING_ERROR_MAX_RAD`].
    pub const TRACKING_ERROR_FOR: Duration = Duration::from_millis(100);
}

/// Why a configuration of a guard is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum GuardError {
    /// The servo limits are not inside the mechanical range.
    #[error("the servo limits do not lie within the mechanical range")]
    MechanicalRange(#[source] JointLimitsError),
    /// The speed ripple is invalid.
    #[error("ripple of the speed {0} rad/s is not a finite number of 0 or more")]
    Ripple(f64),
    /// The tracking tolerance is invalid.
    #[error("maximum tracking error {0} rad is not a positive, finite number")]
    TrackingError(f64),
}

/// A joint that exceeds its speed limit by this factor ...
const OVER_SPEED: f64 = 1.1;
/// ... in this many consecutive samples is out of control.
const OVER_SPEED_SAMPLES: u32 = 2;
/// Between two samples a joint moves at most by this multiple of its speed limit ...
const JUMP_FACTOR: f64 = 1.5;
/// ... plus this, rad; a larger step is a wrong sample.
const JUMP_MARGIN_RAD: f64 = 0.002;
/// Samples further apart, in cycles, are not consecutive while an arm is being enabled: with closed brakes it is not measured,
/// and three lost samples stop it.
const OLD_CYCLES: u32 = 5;
/// This number of consecutive wrong samples is a fault and not a disturbance of the link.
const JUMPS_TO_FAULT: u32 = 2;
/// This number of wrong samples among the last 100 is a fault, although never two in a row. A checksum guards the link, so a wrong sample
/// is rare: chosen so that a few single ones are forgiven. Half of it would stop an arm for two disturbances within a second; with twice
/// as many, every second sample is wrong for 0.2 s at 100 Hz instead of 0.1 s.
const JUMPS_TO_FAULT_OF_100: u32 = 5;
/// Creep of a joint while the arm is commanded to hold, rad: with the time in which it is forgotten, 60 s, a creep of 0.001 rad/s is found
/// after 26 s, one of 0.0015 rad/s after 17 s, and one below 0.0003 rad/s never. Half of it would stop an arm whose joints settle by half a
/// degree after a stop; with twice as much, 0.001 rad/s takes 66 s.
const DRIFT_MAX_RAD: f64 = 0.02;
/// A joint that is pushed and springs back within this time has not crept; a faster motion is a tracking error before.
const DRIFT_FOR: Duration = Duration::from_secs(1);
/// Tolerance of a hard limit: rounding of the description and of the encoder, rad.
pub(crate) const LIMIT_ROUNDING_RAD: f64 = 1e-4;
/// Allowed oscillation of a joint on its way back from beyond a limit, rad.
const RETURN_SWING_RAD: f64 = 2e-3;

/// Monitors the answers of an arm. The arm is stopped and latched if a joint has an impossible position, exceeds its speed limit,
/// or does not follow its command. Only [`ArmPower::reset`], called by an operator's action, ends the latch.
///
/// A joint that is beyond its servo limits when the guard first sees it after power-up, enabling or a reset may come back. It is
/// stopped if it moves further out.
///
/// A single sample that jumps is discarded and the arm holds; two in a row are a fault. Use it inside the
/// [`Limiter`](crate::Limiter), so that it sees the commands that are really sent.
pub struct Guard<A> {
    arm: A,
    limits: EffectiveLimits,
    config: GuardConfig,
    mechanical: JointLimits,
    newest: Option<JointState>,
    /// Initial excess of joints beyond their servo limits, rad: they may come back.
    found_beyond_rad: JointVector,
    expectation: Expectation,
    too_fast: [u32; DOF],
    off_track_for: [Duration; DOF],
    drifted_for: [Duration; DOF],
    jumps: u32,
    recent_jumps: RecentFailures,
    /// The arm is being enabled: the first comparison may be with an old measurement.
    is_enabling: bool,
    /// Cause of the stop.
    latched: Option<String>,
    on_stop: Option<Box<dyn FnMut() + Send>>,
}

impl<A: Arm> Guard<A> {
    /// Monitors an arm with these limits: a joint beyond its servo limits or its speed limit is stopped. The drives accelerate and
    /// decelerate with the accelerations of the limits.
    ///
    /// # Errors
    /// If a number of the configuration is out of range; the error names it.
    pub fn new(arm: A, limits: EffectiveLimits, config: GuardConfig) -> Result<Self, GuardError> {
        let mechanical = check(&limits, &config)?;
        let expectation = Expectation::new(*limits.acceleration_max_rad_per_s2(), config.delay, config.lag);
        Ok(Self {
            arm,
            limits,
            config,
            mechanical,
            newest: None,
            found_beyond_rad: JointVector::zeros(),
            expectation,
            too_fast: [0; DOF],
            off_track_for: [Duration::ZERO; DOF],
            drifted_for: [Duration::ZERO; DOF],
            jumps: 0,
            recent_jumps: RecentFailures::default(),
            is_enabling: false,
            latched: None,
            on_stop: None,
        })
    }

    /// The wrapped arm, read-only.
    pub fn arm(&self) -> &A {
        &self.arm
    }

    /// Cause for which the guard has stopped the arm, if any.
    pub fn latched(&self) -> Option<&str> {
        self.latched.as_deref()
    }

    /// Additional action, once and at once, when the guard stops the arm. A joint that does not follow its drive may move although
    /// the arm holds, until its brake closes: for a backend with brakes this action closes them (`TripHandle::trip` of a PA-10).
    #[must_use]
    pub fn on_stop(mut self, stop: impl FnMut() + Send + 'static) -> Self {
        self.on_stop = Some(Box::new(stop));
        self
    }

    /// Stops at once; the answer of the arm no longer matters.
    fn stop_for(&mut self, (joint, reason): (usize, String)) -> ArmError {
        if let Some(stop) = &mut self.on_stop {
            stop();
        }
        let answer = self.arm.exchange(JointCommand::Hold);
        self.expectation.command(&JointVector::zeros());
        let link = answer.err().map_or(String::new(), |error| format!(" (and the hold command failed: {error})"));
        let error = self.error(ArmErrorKind::Fault, &format!("{reason}; the arm holds{link}")).of_joint(joint);
        self.latched = Some(reason);
        error
    }

    /// Discards a sample that jumps: the arm holds, and the next sample is compared with the last good one.
    fn refuse_jump(&mut self, joint: usize, moved_rad: f64, dt: Duration) -> ArmError {
        self.jumps += 1;
        let recent = self.recent_jumps.push(true);
        let moved_deg = moved_rad.to_degrees();
        let text = format!(
            "axis {} seems to have moved by {moved_deg:+.2} degrees within {dt:?}, an impossible speed",
            joint + 1
        );
        if self.jumps >= JUMPS_TO_FAULT {
            let reason = format!("{text}, {} times in a row: check its encoder and the link", self.jumps);
            return self.stop_for((joint, reason));
        }
        if recent >= JUMPS_TO_FAULT_OF_100 {
            let reason = format!("{text}, and {recent} of the last 100 samples jump: check its encoder and the link");
            return self.stop_for((joint, reason));
        }
        match self.arm.exchange(JointCommand::Hold) {
            Ok(_) => {
                self.expectation.command(&JointVector::zeros());
                self.error(ArmErrorKind::Timeout, &format!("{text}; the sample is discarded and the arm holds"))
            }
            Err(error) => error,
        }
    }

    fn jump(&self, sample: &JointState, last: &JointState, dt: Duration) -> Option<(usize, f64)> {
        let speeds = self.limits.servo().velocity_max_rad_per_s();
        (0..DOF).find_map(|joint| {
            let moved_rad = sample.position_rad[joint] - last.position_rad[joint];
            let possible_rad = JUMP_FACTOR * speeds[joint] * dt.as_secs_f64() + JUMP_MARGIN_RAD;
            let is_possible = moved_rad.abs() <= possible_rad;
            (!is_possible).then_some((joint, moved_rad))
        })
    }

    fn beyond_limit(&mut self, sample: &JointState) -> Option<(usize, String)> {
        if let Some(wrong) = self.mechanical.violation(&sample.position_rad) {
            let (joint, angle) = (wrong.joint, wrong.position_rad);
            let reason = format!(
                "axis {} is at {:.2} degrees, beyond its mechanical stops at {:.2} and {:.2} degrees: check its encoder and \
                 its zero point",
                joint + 1,
                angle.to_degrees(),
                wrong.min_rad.to_degrees(),
                wrong.max_rad.to_degrees()
            );
            return Some((joint, reason));
        }
        let limits = self.limits.servo();
        let beyond_rad = limits.margin_rad(&sample.position_rad).map(|margin| (-margin).max(0.0));
        if self.newest.is_none() {
            self.found_beyond_rad = beyond_rad;
        }
        for joint in 0..DOF {
            let first_position_rad = &mut self.found_beyond_rad[joint];
            let allowed_rad =
                if *first_position_rad > 0.0 { *first_position_rad + RETURN_SWING_RAD } else { LIMIT_ROUNDING_RAD };
            if beyond_rad[joint] > allowed_rad {
                let [angle, min, max] = [&sample.position_rad, limits.position_min_rad(), limits.position_max_rad()]
                    .map(|of| of[joint].to_degrees());
                let reason = format!(
                    "axis {} is at {angle:.2} degrees, beyond its limits {min:.2} to {max:.2} degrees",
                    joint + 1
                );
                return Some((joint, reason));
            }
            *first_position_rad = first_position_rad.min(beyond_rad[joint]);
        }
        None
    }

    fn over_speed(&mut self, sample: &JointState) -> Option<(usize, String)> {
        let speeds = self.limits.velocity_max_rad_per_s();
        let mut reason = None;
        for joint in 0..DOF {
            let (speed, allowed) = (sample.velocity_rad_per_s[joint], speeds[joint] + self.config.ripple_rad_per_s);
            let is_slow = speed.abs() <= OVER_SPEED * allowed;
            self.too_fast[joint] = if is_slow { 0 } else { self.too_fast[joint] + 1 };
            if self.too_fast[joint] >= OVER_SPEED_SAMPLES && reason.is_none() {
                let text = format!("axis {} moves at {speed:+.3} rad/s, the limit is {allowed:.3} rad/s", joint + 1);
                reason = Some((joint, text));
            }
        }
        reason
    }

    /// A joint that creeps although the arm is commanded to hold.
    fn drifted(&mut self, moved_rad: &JointVector, dt: Duration) -> Option<(usize, String)> {
        let drift_rad = self.expectation.drift_after(moved_rad, dt);
        for joint in 0..DOF {
            let is_still = drift_rad[joint].abs() <= DRIFT_MAX_RAD;
            self.drifted_for[joint] = if is_still { Duration::ZERO } else { self.drifted_for[joint] + dt };
        }
        let joint = (0..DOF).find(|&joint| self.drifted_for[joint] >= DRIFT_FOR)?;
        let (drift_deg, held) = (drift_rad[joint].to_degrees(), self.expectation.held_for());
        let axis = joint + 1;
        let text = format!(
            "axis {axis} has crept by {drift_deg:+.2} degrees although the arm is commanded to hold, for {held:.0?}: its drive drifts, or the \
             joint is pushed"
        );
        Some((joint, text))
    }

    fn off_track(&mut self, moved_rad: &JointVector, dt: Duration) -> Option<(usize, String)> {
        let error_rad = self.expectation.error_after(moved_rad, dt);
        let mut reason = None;
        for joint in 0..DOF {
            let is_on_track = error_rad[joint].abs() <= self.config.tracking_error_max_rad;
            self.off_track_for[joint] = if is_on_track { Duration::ZERO } else { self.off_track_for[joint] + dt };
            if self.off_track_for[joint] >= self.config.tracking_error_for && reason.is_none() {
                let text = format!(
                    "axis {} is {:+.2} degrees from its commanded position, for {:?}: it is blocked, pushed or not driven",
                    joint + 1,
                    error_rad[joint].to_degrees(),
                    self.off_track_for[joint]
                );
                reason = Some((joint, text));
            }
        }
        reason
    }

    /// Checks a sample; it becomes the newest unless it jumps.
    fn judge(&mut self, sample: JointState) -> Result<JointState, ArmError> {
        let old = self.arm.info().cycle * OLD_CYCLES;
        if self.is_enabling && self.newest.is_some_and(|last| sample.at.saturating_since(last.at) > old) {
            self.forget();
        }
        if let Some(reason) = self.beyond_limit(&sample) {
            // A wrong sample may exceed any limit.
            if self.newest.is_none_or(|last| self.jump(&sample, &last, sample.at.saturating_since(last.at)).is_none()) {
                return Err(self.stop_for(reason));
            }
        }
        if let Some(last) = self.newest {
            let dt = sample.at.saturating_since(last.at);
            if let Some((joint, moved_rad)) = self.jump(&sample, &last, dt) {
                return Err(self.refuse_jump(joint, moved_rad, dt));
            }
            if !dt.is_zero() {
                let moved_rad = sample.position_rad - last.position_rad;
                let (over_speed, off_track) = (self.over_speed(&sample), self.off_track(&moved_rad, dt));
                let off_track = off_track.or(self.drifted(&moved_rad, dt));
                if let Some(reason) = over_speed.or(off_track) {
                    return Err(self.stop_for(reason));
                }
            }
        }
        self.jumps = 0;
        self.recent_jumps.push(false);
        self.newest = Some(sample);
        Ok(sample)
    }

    /// Forgets all earlier samples.
    fn forget(&mut self) {
        self.newest = None;
        self.found_beyond_rad = JointVector::zeros();
        self.expectation.forget();
        self.too_fast = [0; DOF];
        self.off_track_for = [Duration::ZERO; DOF];
        self.drifted_for = [Duration::ZERO; DOF];
        self.jumps = 0;
        self.recent_jumps.clear();
    }

    fn check_latched(&self) -> Result<(), ArmError> {
        self.latched.as_ref().map_or(Ok(()), |reason| Err(self.stopped_error(reason)))
    }

    fn stopped_error(&self, reason: &str) -> ArmError {
        self.error(ArmErrorKind::Fault, &format!("stopped: {reason}; remove the cause, then reset"))
    }

    fn error(&self, kind: ArmErrorKind, text: &str) -> ArmError {
        ArmError::new(kind, format!("guard of arm {}: {text}", self.arm.info().name))
    }
}

impl<A: Arm> Arm for Guard<A> {
    fn info(&self) -> &ArmInfo {
        self.arm.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        if let Some(reason) = self.latched.clone() {
            let sample = self.arm.exchange(JointCommand::Hold)?;
            return match command {
                JointCommand::Hold => Ok(sample),
                JointCommand::Velocity(_) => Err(self.stopped_error(&reason)),
            };
        }
        let sample = self.arm.exchange(command);
        // The present measurement results from the command before this one.
        let judged = sample.and_then(|sample| self.judge(sample));
        self.expectation.command(&match (&judged, command) {
            (Ok(_), JointCommand::Velocity(velocity)) => velocity,
            _ => JointVector::zeros(),
        });
        judged
    }
}

impl<A: Arm + ArmPower> ArmPower for Guard<A> {
    fn state(&self) -> ArmState {
        match self.arm.state() {
            ArmState::EStop => ArmState::EStop,
            _ if self.latched.is_some() => ArmState::Fault,
            state => state,
        }
    }

    fn is_stopped_by_other(&self) -> bool {
        self.latched.is_none() && self.arm.is_stopped_by_other()
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        match order {
            PowerOrder::Enable(_) | PowerOrder::BeginEnable(_) => {
                self.check_latched()?;
                self.forget();
                self.is_enabling = matches!(order, PowerOrder::BeginEnable(_));
            }
            PowerOrder::PollEnable => self.check_latched()?,
            PowerOrder::Stop => {
                self.is_enabling = false;
                self.forget();
            }
            PowerOrder::Reset if self.latched.is_some() => close_brakes(&mut self.arm)?,
            PowerOrder::BeginStop | PowerOrder::Reset => {}
        }
        let progress = self.arm.power(order)?;
        match order {
            PowerOrder::PollEnable => self.is_enabling = progress.is_pending(),
            PowerOrder::Reset => {
                self.forget();
                self.latched = None;
            }
            _ => {}
        }
        Ok(progress)
    }
}

/// The mechanical range.
fn check(limits: &EffectiveLimits, config: &GuardConfig) -> Result<JointLimits, GuardError> {
    let servo = limits.servo();
    let mechanical =
        JointLimits::new(config.mechanical_min_rad, config.mechanical_max_rad, *servo.velocity_max_rad_per_s())
            .and_then(|range| {
                range.with_position_range(*servo.position_min_rad(), *servo.position_max_rad()).map(|_| range)
            })
            .map_err(GuardError::MechanicalRange)?;
    let ripple = config.ripple_rad_per_s;
    if !(ripple.is_finite() && ripple >= 0.0) {
        return Err(GuardError::Ripple(ripple));
    }
    let error_max = config.tracking_error_max_rad;
    if !(error_max.is_finite() && error_max > 0.0) {
        return Err(GuardError::TrackingError(error_max));
    }
    Ok(mechanical)
}
