//! Progress of activities: by replies, by time, and by detected faults.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{Axis, Letter};
use pb3dp_arm_pa10_protocol::gateway_protocol::RejectReason;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::RecentFailures;
use pb3dp_kinematics::{JointState, JointVector};

use super::config::LimitsCheck;
use super::machine::{AxisLimits, Driver, Latched};
use super::motion::Motion;
use super::phase::{LookStep, Phase, StopStep};
use super::table::{Activity, DriverState, Event, Outcome, outcome};
use super::torque::TorqueMonitor;
use super::{FaultCause, Sample, Trip, WarmUpFailure};

/// Number of E messages without an answer.
const END_TRIES_MAX: u32 = 3;

/// Longest delay between the start of connecting and the start of closing the brakes.
const BRAKES_LATER_MAX: Duration = Duration::from_millis(500);

impl Driver {
    pub(super) fn handle_sample(&mut self, now: MonotonicTime, sample: &Sample) {
        self.keep(now, sample);
        let found = sample.condition.trip(&self.config.signals);
        let lost = || {
            let condition = &sample.condition;
            let opens = matches!(self.phase, Phase::Releasing { .. });
            let follows = self.phase == Phase::Steady && self.state.has_open_brakes();
            let cycles = self.phase == Phase::Steady || matches!(self.phase, Phase::Enabling { .. });
            let stopped = (cycles || opens).then(|| condition.gateway_stopped()).flatten();
            let signals = &self.config.signals;
            let lost = || (follows || opens).then(|| condition.uncontrollable(signals)).flatten().map(Trip::from);
            stopped.map(Trip::Fault).or_else(lost)
        };
        let measured = now - sample.age;
        let overloaded = match self.brakes_open {
            true => self.torques.judge(measured, &sample.torque_n_m, &self.config).map(Trip::Fault),
            // The drives are not responsible for a load that the brakes carry.
            false => {
                self.torques = TorqueMonitor::default();
                None
            }
        };
        let too_old = || sample.too_old().map(Trip::Fault);
        if let Some(trip) = found.or_else(lost).or(overloaded).or_else(too_old) {
            self.trip(now, trip);
            return;
        }
        match self.phase {
            Phase::Looking { step: LookStep::Look, activity } => {
                self.phase = Phase::Looking { step: LookStep::End, activity };
            }
            Phase::Enabling { started: true } => self.judge_warm_up(now, sample),
            // From the first answer on: a gateway counts from the received command, not from a lost one.
            Phase::Releasing { since: None } if self.brakes_open => {
                self.phase = Phase::Releasing { since: Some(now) };
            }
            Phase::Releasing { since: Some(since) } if now.saturating_since(since) >= self.config.brake_time => {
                self.complete(now, Event::Released);
            }
            _ => {}
        }
    }

    pub(super) fn handle_done(&mut self, now: MonotonicTime) {
        match self.phase {
            Phase::Looking { step, activity } => {
                let next = match step {
                    LookStep::Clear(index) if index + 1 < Axis::COUNT => LookStep::Clear(index + 1),
                    LookStep::Clear(_) => self.first_look(),
                    LookStep::Limits(index) if index + 1 < Axis::COUNT => LookStep::Limits(index + 1),
                    LookStep::Limits(_) => LookStep::Start,
                    LookStep::Start | LookStep::Look => LookStep::Look,
                    LookStep::End => {
                        self.control_started = false;
                        let done = if activity == Activity::Clearing { Event::Cleared } else { Event::Inspected };
                        self.complete(now, done);
                        return;
                    }
                };
                self.phase = Phase::Looking { step: next, activity };
            }
            Phase::Enabling { started: false } => {
                self.link.begin_warm_up(self.stops_after / 2);
                self.phase = Phase::Enabling { started: true };
            }
            Phase::Stopping(StopStep::End { .. }) => self.finish_stop(now),
            _ => {}
        }
    }

    /// Received limits: of the requested axis, and equal to the configuration.
    pub(super) fn handle_limits(&mut self, now: MonotonicTime, found: &AxisLimits) {
        self.limits[found.axis.index()] = Some(*found);
        if let LimitsCheck::Compare { lower_rad, upper_rad, tolerance_rad } = &self.config.limits {
            let joint = found.axis.index();
            for (found_rad, expected_rad) in [(found.lower_rad, lower_rad[joint]), (found.upper_rad, upper_rad[joint])]
            {
                let near = (found_rad - expected_rad).abs() <= *tolerance_rad;
                // NaN is not near.
                if !near {
                    let (found_deg, expected_deg) = (found_rad.to_degrees(), expected_rad.to_degrees());
                    self.trip(now, Trip::Fault(FaultCause::LimitsDiffer { axis: found.axis, found_deg, expected_deg }));
                    return;
                }
            }
        }
        self.handle_done(now);
    }

    /// First step of connecting.
    pub(super) fn first_look(&self) -> LookStep {
        if self.config.limits == LimitsCheck::Skip { LookStep::Start } else { LookStep::Limits(0) }
    }

    /// An exchange without a usable reply.
    pub(super) fn handle_miss(&mut self, now: MonotonicTime) {
        let too_many = self.link.handle_miss();
        if let Phase::Looking { step: LookStep::Clear(_), .. } = self.phase {
            // Not every controller knows this letter.
            self.link.forget_misses();
            self.handle_done(now);
            return;
        }
        if let (Some(misses), false) = (too_many, self.is_stopping_latched()) {
            self.trip(now, Trip::Fault(FaultCause::LinkLost { misses }));
        }
        self.check_recent(now);
        if let Phase::Stopping(StopStep::End { tries }) = self.phase
            && tries >= END_TRIES_MAX
        {
            self.finish_stop(now);
        }
    }

    /// Stops the arm if too many of the last exchanges failed, although never three in a row.
    pub(super) fn check_recent(&mut self, now: MonotonicTime) {
        let Some(bad) = self.link.too_many_bad() else { return };
        if !self.is_stopping_latched() {
            self.trip(now, Trip::Fault(FaultCause::LinkPoor { bad, exchanges: RecentFailures::WINDOW }));
            self.link.forget_misses();
        }
    }

    pub(super) fn handle_rejection(&mut self, now: MonotonicTime, reason: RejectReason, fault: FaultCause) {
        match self.phase {
            // The gateway may have stopped the arm by itself before, or its brakes may have started to close later than counted
            // here.
            Phase::Stopping(StopStep::End { tries }) if tries >= END_TRIES_MAX => self.finish_stop(now),
            Phase::Stopping(StopStep::End { .. }) => {}
            // The gateway may have stopped the arm by itself before: the order continues by count and time.
            Phase::Stopping(_) if self.state.is_latched() => {}
            Phase::Looking { step: LookStep::Clear(_), .. } => self.handle_done(now),
            // A gateway that has just received an answer of its controller waits for the brakes before it ends the control mode.
            Phase::Looking { step: LookStep::End, .. }
                if reason == RejectReason::WrongState
                    && now.saturating_since(self.phase_since) < self.config.brake_time + BRAKES_LATER_MAX => {}
            // A status of the arm says more than that the cause is still present.
            Phase::Looking { activity: Activity::Clearing, .. }
                if reason == RejectReason::CausePresent && self.is_stopped_by_arm() =>
            {
                self.begin_stop(now, true);
            }
            _ => self.trip(now, Trip::Fault(fault)),
        }
    }

    /// Stops the arm and latches, unless an equally strong cause has latched it before.
    pub(super) fn trip(&mut self, now: MonotonicTime, trip: Trip) {
        let event = match trip {
            Trip::Fault(_) => Event::FaultFound,
            Trip::EStop(_) => Event::EStopFound,
        };
        let clearing = self.activity() == Activity::Clearing;
        match outcome(self.state, event) {
            Outcome::To(next) => {
                // Connecting alone leaves no latch for the next program, which can connect too; and a gateway that its owner has
                // stopped knows the cause.
                let is_reported = matches!(trip, Trip::Fault(FaultCause::GatewayStopped { .. }));
                self.latch_in_gateway = match self.state.is_latched() {
                    true => self.latch_in_gateway,
                    false => self.activity() != Activity::Connecting && !is_reported,
                };
                self.latched = Some(Latched { trip, at: now, state_before: self.state });
                self.state = next;
            }
            // A reset with the cause still present, or with another one.
            _ if clearing => {
                if let Some(latched) = &mut self.latched {
                    latched.trip = trip;
                }
            }
            _ => return,
        }
        self.begin_stop(now, true);
    }

    /// Starts the stop order at the required step; repeating it is harmless.
    pub(super) fn begin_stop(&mut self, now: MonotonicTime, emergency: bool) {
        // After an emergency stop the arm is already stationary: there is no ramp.
        let first = match self.state {
            DriverState::EStop => StopStep::Rest { left: self.config.rest_cycles },
            _ => StopStep::Ramp,
        };
        if let Phase::Stopping(step) = self.phase {
            if emergency {
                // The rest of the order gets its full time: at most twice, because a fault and an emergency stop occur at most once
                // each.
                self.phase_since = now;
                if step == StopStep::Ramp {
                    self.motion = self.stopping_motion(now, emergency);
                    self.phase = Phase::Stopping(first);
                }
            }
            return;
        }
        self.cancel_waiting();
        self.phase_since = now;
        self.motion = self.stopping_motion(now, emergency);
        if self.brakes_open {
            self.phase = Phase::Stopping(first);
        } else if self.control_started {
            self.phase = Phase::Stopping(StopStep::Off);
        } else {
            self.finish_stop(now);
        }
    }

    /// Goes to the next step of the stop order when the present one has ended.
    pub(super) fn advance_stop(&mut self, now: MonotonicTime) {
        let Phase::Stopping(step) = self.phase else { return };
        let next = match step {
            StopStep::Ramp if self.motion.is_at_rest(now) => StopStep::Rest { left: self.config.rest_cycles },
            StopStep::Rest { left: 0 } => StopStep::Brake { until: None },
            StopStep::Brake { until: Some(until) } if now >= until => StopStep::Off,
            _ => return,
        };
        self.phase = Phase::Stopping(next);
    }

    /// Counts the messages of the stop order.
    pub(super) fn note_stop_sent(&mut self, now: MonotonicTime) {
        let Phase::Stopping(step) = self.phase else { return };
        let next = match step {
            StopStep::Ramp => return,
            StopStep::Rest { left } => StopStep::Rest { left: left.saturating_sub(1) },
            StopStep::Brake { until } => StopStep::Brake { until: Some(until.unwrap_or(now + self.config.brake_time)) },
            StopStep::Off => StopStep::End { tries: 0 },
            StopStep::End { tries } => StopStep::End { tries: tries + 1 },
        };
        self.phase = Phase::Stopping(next);
    }

    /// The stop order is complete, or given up: the gateway repeats what the controller does not answer.
    pub(super) fn finish_stop(&mut self, now: MonotonicTime) {
        self.control_started = false;
        self.brakes_open = false;
        self.motion = Motion::Rest;
        self.complete(now, Event::Stopped);
    }

    /// An activity is complete.
    fn complete(&mut self, now: MonotonicTime, event: Event) {
        self.phase = Phase::Steady;
        match outcome(self.state, event) {
            Outcome::To(next) => {
                if self.state.is_latched() {
                    self.latched = None;
                }
                self.state = next;
                // Its owner may have waited for this.
                self.last_request_at = now;
            }
            Outcome::Stay => {}
            Outcome::Begin(_) | Outcome::Refuse => {
                self.trip(now, Trip::Fault(FaultCause::Internal { event, state: self.state }));
            }
        }
    }

    fn judge_warm_up(&mut self, now: MonotonicTime, sample: &Sample) {
        let verdict = self.link.warm_up(self.config.warm_up_exchanges);
        let verdict = match verdict {
            Some(Ok(())) if sample.condition.is_power_too_warm() => Some(Err(WarmUpFailure::PowerTooWarm)),
            // The servos are on and the brakes are about to open: an axis that cannot hold would fall.
            Some(Ok(())) => {
                Some(sample.condition.uncontrollable(&self.config.signals).map_or(Ok(()), |lost| Err(lost.into())))
            }
            other => other,
        };
        match verdict {
            None => {}
            Some(Ok(())) => self.complete(now, Event::Warmed),
            Some(Err(failure)) => {
                self.warm_up_failure = Some(failure);
                self.begin_stop(now, false);
            }
        }
    }

    fn keep(&mut self, now: MonotonicTime, sample: &Sample) {
        let at = now - sample.age;
        let position_rad = sample.position_rad;
        let differences = || match &self.joints {
            Some(before) if at > before.at => (position_rad - before.position_rad) / at.seconds_since(before.at),
            _ => JointVector::zeros(),
        };
        let velocity_rad_per_s = sample.velocity_rad_per_s.unwrap_or_else(differences);
        // The times of samples never decrease.
        if self.joints.as_ref().is_none_or(|before| at > before.at) {
            self.joints = Some(JointState { at, position_rad, velocity_rad_per_s });
        }
        self.sample = Some(*sample);
    }

    fn stopping_motion(&self, now: MonotonicTime, emergency: bool) -> Motion {
        let from_rad_per_s = self.velocity_rad_per_s(now);
        if self.state == DriverState::EStop || from_rad_per_s == JointVector::zeros() {
            Motion::Rest
        } else if emergency {
            Motion::stop_within(from_rad_per_s, self.config.emergency_ramp, now)
        } else {
            Motion::decelerate(from_rad_per_s, &self.config.deceleration_rad_per_s2, now)
        }
    }

    /// A stop does not wait for the answer to a slow message; the link counts that answer as late.
    fn cancel_waiting(&mut self) {
        self.outstanding = self.outstanding.filter(|outstanding| outstanding.letter == Letter::Cyclic);
    }

    /// Latched by a report of the arm: an alarm or an emergency stop.
    fn is_stopped_by_arm(&self) -> bool {
        let by_arm = |latched: &Latched| matches!(latched.trip, Trip::EStop(_)) || latched.trip.code().is_some();
        self.latched.as_ref().is_some_and(by_arm)
    }

    pub(super) fn is_stopping_latched(&self) -> bool {
        self.state.is_latched() && self.activity() == Activity::Stopping
    }
}
