//! Progress of activities: by replies, by time, and by detected faults.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{Axis, Letter};
use pb3dp_arm_pa10_protocol::gateway_protocol::RejectReason;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::RecentFailures;
use pb3dp_kinematics::{JointState, JointVector};

use super::config::LimitsCheck;
use super::link::WarmUp;
use super::machine::{AxisLimits, Driver};
use super::motion::Ramp;
use super::state::{EnableStep, EndStep, Ended, Latch, Latched, LookStep, ReleaseStep, State, StopStep, Stopped};
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
            let (condition, signals) = (&sample.condition, &self.config.signals);
            let stopped = || condition.gateway_stopped().map(Trip::Fault);
            match self.state {
                State::Enabling { .. } | State::Enabled => stopped(),
                State::Releasing { .. } | State::Holding { .. } | State::Moving(_) => {
                    stopped().or_else(|| condition.uncontrollable(signals).map(Trip::from))
                }
                _ => None,
            }
        };
        let measured = now - sample.age;
        let overloaded = match self.state.has_open_brakes() {
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
        match self.state {
            State::Looking { since, step: LookStep::Look, latch } => {
                self.state = State::Looking { since, step: LookStep::End, latch };
            }
            State::Enabling { step: EnableStep::WarmUp(warm_up), .. } => self.judge_warm_up(now, sample, warm_up),
            // From the first answer on: a gateway counts from the received command, not from a lost one.
            State::Releasing { since, step: ReleaseStep::Sent } => {
                self.state = State::Releasing { since, step: ReleaseStep::Answered(now) };
            }
            State::Releasing { step: ReleaseStep::Answered(at), .. }
                if now.saturating_since(at) >= self.config.brake_time =>
            {
                self.complete(now, Event::Released);
            }
            _ => {}
        }
    }

    pub(super) fn handle_done(&mut self, now: MonotonicTime) {
        let after = |axis: Axis| Axis::ALL.get(axis.index() + 1).copied();
        self.state = match self.state {
            State::Clearing { since, axis, latch } => match after(axis) {
                Some(axis) => State::Clearing { since, axis, latch },
                None => State::Looking { since, step: self.first_look(), latch: Some(latch) },
            },
            State::Looking { step: LookStep::End, latch, .. } => {
                return self.complete(now, if latch.is_some() { Event::Cleared } else { Event::Inspected });
            }
            State::Looking { since, step: LookStep::Limits(axis), latch } => {
                State::Looking { since, step: after(axis).map_or(LookStep::Start, LookStep::Limits), latch }
            }
            State::Looking { since, latch, .. } => State::Looking { since, step: LookStep::Look, latch },
            State::Enabling { since, step: EnableStep::Start | EnableStep::StartSent } => {
                State::Enabling { since, step: EnableStep::WarmUp(self.link.new_warm_up(self.stops_after / 2)) }
            }
            State::Ending { step: EndStep::End { .. }, .. } => return self.complete(now, Event::Stopped),
            other => other,
        };
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
        if self.config.limits == LimitsCheck::Skip { LookStep::Start } else { LookStep::Limits(Axis::ALL[0]) }
    }

    /// An exchange without a usable reply.
    pub(super) fn handle_miss(&mut self, now: MonotonicTime) {
        let too_many = self.link.handle_miss(self.state.warm_up());
        if let State::Clearing { .. } = self.state {
            // Not every controller knows this letter.
            self.link.forget_misses();
            self.handle_done(now);
            return;
        }
        if let (Some(misses), false) = (too_many, self.is_stopping_latched()) {
            self.trip(now, Trip::Fault(FaultCause::LinkLost { misses }));
        }
        self.check_recent(now);
        if let State::Ending { step: EndStep::End { tries: END_TRIES_MAX.. }, .. } = self.state {
            self.complete(now, Event::Stopped);
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
        match self.state {
            // The gateway may have stopped the arm by itself before, or its brakes may have started to close later than counted
            // here.
            State::Ending { step: EndStep::End { tries: END_TRIES_MAX.. }, .. } => self.complete(now, Event::Stopped),
            State::Ending { step: EndStep::End { .. }, .. } => {}
            // The gateway may have stopped the arm by itself before: the order continues by count and time.
            State::Braking { .. } | State::Ending { .. } if self.is_stopping_latched() => {}
            State::Clearing { .. } => self.handle_done(now),
            // A gateway that has just received an answer of its controller waits for the brakes before it ends the control mode.
            State::Looking { since, step: LookStep::End, .. }
                if reason == RejectReason::WrongState
                    && now.saturating_since(since) < self.config.brake_time + BRAKES_LATER_MAX => {}
            // A status of the arm says more than that the cause is still present.
            State::Looking { latch: Some(latch), .. }
                if reason == RejectReason::CausePresent && latch.cause.is_by_arm() =>
            {
                self.begin_stop(now, None);
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
        let (state, activity, before) = (self.state(), self.activity(), self.state.latch().copied());
        let latch = match (outcome(state, event), before) {
            (Outcome::To(next), _) => {
                // Connecting alone leaves no latch for the next program, which can connect too; and a gateway that its owner has
                // stopped knows the cause.
                let is_reported = matches!(trip, Trip::Fault(FaultCause::GatewayStopped { .. }));
                let is_new = activity != Activity::Connecting && !is_reported;
                Latch {
                    cause: Latched { trip, at: now, state_before: state },
                    is_emergency_stop: next == DriverState::EStop,
                    in_gateway: before.map_or(is_new, |latch| latch.in_gateway),
                }
            }
            // A reset with the cause still present, or with another one.
            (_, Some(latch)) if activity == Activity::Clearing => {
                Latch { cause: Latched { trip, ..latch.cause }, ..latch }
            }
            _ => return,
        };
        self.begin_stop(now, Some(latch));
    }

    /// Starts the stop order at the required step, with a cause that latches or without one; repeating it is harmless.
    pub(super) fn begin_stop(&mut self, now: MonotonicTime, cause: Option<Latch>) {
        let latch = cause.or(self.state.latch().copied());
        let braking = |step, of| State::Braking { since: now, step, of: latch.map_or(of, Stopped::Latched) };
        let ending = |step, of| {
            let of = latch.map_or(of, |latch| Ended::Stopped(Stopped::Latched(latch)));
            State::Ending { since: now, step, of }
        };
        let first = self.first_stop_step(now, cause);
        let next = match self.state {
            State::Braking { .. } | State::Ending { .. } if cause.is_none() => return,
            // The rest of the order gets its full time: at most twice, because a fault and an emergency stop occur at most once
            // each.
            State::Braking { step: StopStep::Ramp(_), of, .. } => braking(first, of),
            State::Braking { step, of, .. } => braking(step, of),
            State::Ending { step, of, .. } => ending(step, of),
            State::Releasing { step: ReleaseStep::Sent | ReleaseStep::Answered(_), .. } => {
                braking(first, Stopped::Enabled)
            }
            State::Holding { .. } => braking(first, Stopped::Holding),
            State::Moving(_) => braking(first, Stopped::Moving),
            // The control mode is off.
            State::Disconnected | State::Looking { step: LookStep::Limits(_) | LookStep::Start, .. } => {
                latch.map_or(State::Disconnected, State::Latched)
            }
            State::Connected | State::Enabling { step: EnableStep::Start, .. } => {
                latch.map_or(State::Connected, State::Latched)
            }
            State::Latched(before) | State::Clearing { latch: before, .. } => State::Latched(cause.unwrap_or(before)),
            // The brakes are closed.
            State::Looking { .. } => ending(EndStep::Off, Ended::Connecting),
            State::Enabling { .. } => ending(EndStep::Off, Ended::Enabling),
            State::Enabled | State::Releasing { .. } => ending(EndStep::Off, Ended::Stopped(Stopped::Enabled)),
        };
        if self.activity() != Activity::Stopping {
            self.cancel_waiting();
        }
        self.state = next;
    }

    /// The ramp, unless there was an emergency stop: after it the arm is already stationary.
    fn first_stop_step(&self, now: MonotonicTime, cause: Option<Latch>) -> StopStep {
        let from_rad_per_s = self.velocity_rad_per_s(now);
        StopStep::Ramp(match cause {
            Some(Latch { is_emergency_stop: true, .. }) => return StopStep::Rest { left: self.config.rest_cycles },
            Some(_) if from_rad_per_s != JointVector::zeros() => {
                Ramp::stop_within(from_rad_per_s, self.config.emergency_ramp, now)
            }
            _ => Ramp::decelerate(from_rad_per_s, &self.config.deceleration_rad_per_s2, now),
        })
    }

    /// Goes to the next step of the stop order when the present one has ended.
    pub(super) fn advance_stop(&mut self, now: MonotonicTime) {
        let State::Braking { since, step, of } = self.state else { return };
        let braking = |step| State::Braking { since, step, of };
        self.state = match step {
            StopStep::Ramp(ramp) if ramp.is_at_rest(now) => braking(StopStep::Rest { left: self.config.rest_cycles }),
            StopStep::Rest { left: 0 } => braking(StopStep::Brake { until: None }),
            StopStep::Brake { until: Some(until) } if now >= until => {
                State::Ending { since, step: EndStep::Off, of: Ended::Stopped(of) }
            }
            _ => return,
        };
    }

    /// An activity is complete, or a stop order is given up: the gateway repeats what the controller does not answer.
    pub(super) fn complete(&mut self, now: MonotonicTime, event: Event) {
        let state = self.state();
        match outcome(state, event) {
            Outcome::To(next) => self.enter(now, next),
            Outcome::Stay => self.enter(now, state),
            Outcome::Begin(_) | Outcome::Refuse => {
                self.trip(now, Trip::Fault(FaultCause::Internal { event, state }));
            }
        }
    }

    fn judge_warm_up(&mut self, now: MonotonicTime, sample: &Sample, warm_up: WarmUp) {
        let verdict = self.link.judge(warm_up, self.config.warm_up_exchanges);
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
                self.begin_stop(now, None);
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

    /// A stop does not wait for the answer to a slow message; the link counts that answer as late.
    fn cancel_waiting(&mut self) {
        self.outstanding = self.outstanding.filter(|outstanding| outstanding.letter == Letter::Cyclic);
    }

    pub(super) fn is_stopping_latched(&self) -> bool {
        self.state.latch().is_some() && self.activity() == Activity::Stopping
    }
}

impl Latched {
    /// Whether the arm reported the cause: an alarm or an emergency stop.
    fn is_by_arm(&self) -> bool {
        matches!(self.trip, Trip::EStop(_)) || self.trip.code().is_some()
    }
}
