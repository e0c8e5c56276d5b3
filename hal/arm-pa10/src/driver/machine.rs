//! The driver: its state, its requests, its messages.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{
    ArmCommand, Axis, AxisCommand, CodecError, ControlMessage, Letter, StatusSignals,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{RejectReason, StopCause};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::{JointState, JointVector};

use super::link::LinkMonitor;
use super::motion::{Ramp, VelocityCommand};
use super::state::{EnableStep, EndStep, Latched, LookStep, ReleaseStep, State, StopStep};
use super::table::{Activity, DriverState, Event, Outcome, outcome};
use super::torque::TorqueMonitor;
use super::{
    BadReply, DriverConfig, DriverConfigError, FaultCause, LinkCounters, Refusal, Request, Sample, Trip, WarmUpFailure,
};

/// A message that is due.
///
/// A link to a gateway sends its RESET before a START while the driver is clearing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transmit {
    /// Number of the message from 0: the link derives its sequence number from it.
    pub exchange: u64,
    /// The message.
    pub message: ControlMessage,
    /// It belongs to the stop order after a fault or an emergency stop of a driven arm: a link to a gateway sends its ABORT before,
    /// so that the next program needs a reset too.
    pub latches: bool,
}

/// Reply to the last message. The link has checked that it answers this message and no earlier one.
#[derive(Clone, Copy, Debug, PartialEq)]
#[allow(clippy::large_enum_variant, reason = "used at once and never stored; a box would allocate in each cycle")]
pub enum Reply {
    /// To a cyclic command.
    Sample(Sample),
    /// To a request for the limits of an axis.
    Limits(AxisLimits),
    /// To any other message.
    Done,
    /// The gateway refused the message.
    Rejected(RejectReason),
    /// The gateway refused a reset, because this cause is still present.
    CauseNotCleared(StopCause),
}

/// Limits of an axis in the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisLimits {
    /// Which axis.
    pub axis: Axis,
    /// Lower limit, rad.
    pub lower_rad: f64,
    /// Upper limit, rad.
    pub upper_rad: f64,
}

/// The host's side of one arm.
#[derive(Clone, Debug)]
pub struct Driver {
    pub(super) config: DriverConfig,
    pub(super) state: State,
    pub(super) link: LinkMonitor,
    pub(super) warm_up_failure: Option<WarmUpFailure>,
    pub(super) sample: Option<Sample>,
    pub(super) joints: Option<JointState>,
    pub(super) torques: TorqueMonitor,
    pub(super) limits: [Option<AxisLimits>; Axis::COUNT],
    /// The shorter time-out of this watchdog and the gateway's.
    pub(super) stops_after: Duration,
    pub(super) outstanding: Option<Outstanding>,
    /// The previous message, if its answer did not come.
    given_up: Option<Letter>,
    next_transmit: MonotonicTime,
    exchange: u64,
}

/// An outstanding message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Outstanding {
    pub letter: Letter,
    pub sent: MonotonicTime,
    pub deadline: MonotonicTime,
}

/// Whether a reply may answer a message with this letter.
fn fits(letter: Letter, reply: &Reply) -> bool {
    match reply {
        Reply::Sample(_) => letter == Letter::Cyclic,
        Reply::Limits(_) => letter == Letter::ReadEeprom,
        Reply::Done => !matches!(letter, Letter::Cyclic | Letter::ReadEeprom),
        Reply::Rejected(_) | Reply::CauseNotCleared(_) => true,
    }
}

impl Driver {
    /// A disconnected driver.
    ///
    /// # Errors
    /// If the configuration contradicts itself or violates the requirements.
    pub fn new(config: DriverConfig) -> Result<Self, DriverConfigError> {
        config.check()?;
        Ok(Self {
            config,
            state: State::Disconnected,
            link: LinkMonitor::default(),
            warm_up_failure: None,
            sample: None,
            joints: None,
            torques: TorqueMonitor::default(),
            limits: [None; Axis::COUNT],
            stops_after: config.watchdog.stop_after(),
            outstanding: None,
            given_up: None,
            next_transmit: MonotonicTime::ZERO,
            exchange: 0,
        })
    }

    /// State of the driver.
    pub fn state(&self) -> DriverState {
        self.state.driver_state()
    }

    /// Current activity.
    pub fn activity(&self) -> Activity {
        self.state.activity().map_or(Activity::None, |(activity, _)| activity)
    }

    /// Cause of the latch, if there is one.
    pub fn latched(&self) -> Option<&Latched> {
        self.state.latch().map(|latch| &latch.cause)
    }

    /// Why the last enabling failed, until the next one.
    pub fn warm_up_failure(&self) -> Option<&WarmUpFailure> {
        self.warm_up_failure.as_ref()
    }

    /// The newest measurement since the arm was connected.
    pub fn sample(&self) -> Option<&Sample> {
        self.sample.as_ref()
    }

    /// The newest joints. If the arm does not measure speeds, they are differences of angles, 0 at first.
    pub fn joints(&self) -> Option<&JointState> {
        self.joints.as_ref()
    }

    /// The limits that were read from the controller since the connection, if any.
    pub fn limits(&self) -> &[Option<AxisLimits>; Axis::COUNT] {
        &self.limits
    }

    /// How the signals of the arm are noticed.
    pub fn signals(&self) -> &StatusSignals {
        &self.config.signals
    }

    /// Counters of the link.
    pub fn counters(&self) -> &LinkCounters {
        &self.link.counters
    }

    /// Executes a request of the operator or the control loop.
    ///
    /// # Errors
    /// If it is not possible now: nothing is sent. After a refused velocity the arm holds.
    pub fn handle_request(&mut self, now: MonotonicTime, request: Request) -> Result<(), Refusal> {
        // Expired commands expire before a new velocity could hide it.
        self.handle_timeout(now);
        if let State::Holding { last_request, .. } = &mut self.state {
            *last_request = now;
        }
        let (event, state, activity) = (request.event(), self.state(), self.activity());
        let answer = outcome(state, event);
        if answer == Outcome::Refuse {
            return Err(Refusal::NotInState { request: event, state });
        }
        if activity != Activity::None && event != Event::Stop {
            // Every activity includes a stop.
            return if event == Event::Hold { Ok(()) } else { Err(Refusal::Busy { request: event, activity }) };
        }
        if let Request::Move(velocity_rad_per_s) = request {
            return Ok(self.follow(now, velocity_rad_per_s)?);
        }
        match answer {
            Outcome::To(next) => {
                if next == DriverState::Disconnected {
                    (self.sample, self.joints, self.limits) = (None, None, [None; Axis::COUNT]);
                }
                self.enter(now, next);
            }
            Outcome::Begin(Activity::Stopping) => self.begin_stop(now, None),
            Outcome::Begin(activity) => self.begin(now, activity),
            Outcome::Stay if event == Event::Stop && activity != Activity::None => self.begin_stop(now, None),
            Outcome::Stay | Outcome::Refuse => {}
        }
        Ok(())
    }

    /// A reply to the last message.
    pub fn handle_reply(&mut self, now: MonotonicTime, reply: &Reply) {
        let Some(outstanding) = self.outstanding else {
            // A valid answer to a message that is no longer outstanding means a slow link, not a damaged one.
            let was_given_up = self.given_up.take().is_some_and(|letter| fits(letter, reply));
            self.link.handle_bad(if was_given_up { BadReply::Late } else { BadReply::Mismatched });
            return;
        };
        if !fits(outstanding.letter, reply) {
            self.link.handle_bad(BadReply::Mismatched);
            return;
        }
        if now > outstanding.deadline {
            // The link may not have been polled for a while: its data is old then.
            self.link.handle_bad(BadReply::Late);
            self.handle_timeout(now);
            return;
        }
        self.end_waiting(now, outstanding);
        if let Reply::Rejected(RejectReason::Stale | RejectReason::NoAnswer) = reply {
            self.handle_miss(now);
            return;
        }
        self.link.handle_answer(now.saturating_since(outstanding.sent), self.state.warm_up());
        self.check_recent(now);
        match reply {
            Reply::Rejected(reason) => self.handle_rejection(now, *reason, FaultCause::Rejected(*reason)),
            Reply::CauseNotCleared(found) => {
                self.handle_rejection(now, RejectReason::CausePresent, FaultCause::CauseNotCleared(*found));
            }
            Reply::Sample(sample) => self.handle_sample(now, sample),
            Reply::Limits(limits) => self.handle_limits(now, limits),
            Reply::Done => self.handle_done(now),
        }
    }

    /// The received bytes are no reply to the last message, which is still outstanding.
    pub fn handle_bad_reply(&mut self, bad: BadReply) {
        self.link.handle_bad(bad);
    }

    /// The link is lost.
    pub fn handle_unplugged(&mut self, now: MonotonicTime) {
        self.trip(now, Trip::Fault(FaultCause::Unplugged));
    }

    /// A valid frame of another arm came.
    pub fn handle_wrong_arm(&mut self, now: MonotonicTime, got: u8) {
        self.trip(now, Trip::Fault(FaultCause::WrongArm { got }));
    }

    /// Another part has a reason to stop the arm: a limit, a monitor, the other arm.
    pub fn handle_trip(&mut self, now: MonotonicTime, trip: Trip) {
        self.trip(now, trip);
    }

    /// Handles time-outs. [`Self::poll_transmit`] calls this by itself.
    pub fn handle_timeout(&mut self, now: MonotonicTime) {
        if let Some(outstanding) = self.outstanding.filter(|outstanding| now >= outstanding.deadline) {
            self.end_waiting(now, outstanding);
            self.given_up = Some(outstanding.letter);
            self.handle_miss(now);
        }
        if let State::Moving(command) = &self.state
            && let Some(age) = command.expired(now, &self.config.watchdog)
        {
            let allowed = self.config.watchdog.stop_after();
            self.trip(now, Trip::Fault(FaultCause::CommandTimeout { age, allowed }));
        }
        if let State::Holding { last_request, .. } = self.state {
            let (age, allowed) = (now.saturating_since(last_request), self.config.owner_timeout);
            if age > allowed {
                self.trip(now, Trip::Fault(FaultCause::OwnerSilent { age, allowed }));
            }
        }
        let allowed = self.config.activity_timeout;
        if let Some((activity, since)) = self.state.activity()
            && now.saturating_since(since) > allowed
        {
            // A stop is given up only after the time of the emergency order, which a fault starts again.
            let is_last = self.is_stopping_latched();
            self.trip(now, Trip::Fault(FaultCause::ActivityTimeout { activity, allowed }));
            if is_last {
                self.complete(now, Event::Stopped);
            }
        }
    }

    /// The message that is due now, if any. It counts as sent.
    pub fn poll_transmit(&mut self, now: MonotonicTime) -> Option<Transmit> {
        self.handle_timeout(now);
        if self.outstanding.is_some() || now < self.next_transmit {
            return None;
        }
        self.advance_stop(now);
        let message = self.due_message(now)?;
        self.note_sent(now, message.letter());
        let exchange = self.exchange;
        self.exchange += 1;
        let latches = self.is_stopping_latched() && self.state.latch().is_some_and(|latch| latch.in_gateway);
        Some(Transmit { exchange, message, latches })
    }

    /// Time of the next required poll, if the driver waits for anything but a request.
    pub fn next_deadline(&self) -> Option<MonotonicTime> {
        let sends = !matches!(self.state, State::Disconnected | State::Connected | State::Latched(_));
        let transmit = (sends && self.outstanding.is_none()).then_some(self.next_transmit);
        let reply = self.outstanding.map(|outstanding| outstanding.deadline);
        let command = match &self.state {
            State::Moving(command) => Some(command.since + self.config.watchdog.stop_after()),
            _ => None,
        };
        [transmit, reply, command].into_iter().flatten().min()
    }

    /// Time of the next message: cycles keep their grid.
    pub fn transmit_due(&self) -> MonotonicTime {
        self.next_transmit
    }

    /// Brake time reported by the gateway: the driver waits at least for it.
    pub fn raise_brake_time(&mut self, least: Duration) {
        self.config.activity_timeout += least.saturating_sub(self.config.brake_time);
        self.config.brake_time = self.config.brake_time.max(least);
    }

    /// Brake time.
    pub fn brake_time(&self) -> Duration {
        self.config.brake_time
    }

    /// The gateway's command time-out: the warm-up must show a link that is fast enough for both sides.
    pub fn note_watchdog(&mut self, stop_after: Duration) {
        self.stops_after = stop_after.min(self.config.watchdog.stop_after());
    }

    /// No reply is expected any more. Cycles that passed during a slow message do not count as missed.
    fn end_waiting(&mut self, now: MonotonicTime, outstanding: Outstanding) {
        self.outstanding = None;
        if outstanding.letter != Letter::Cyclic {
            self.next_transmit = self.next_transmit.max(now);
        }
    }

    /// Accepts a velocity, or holds if it cannot be sent.
    fn follow(&mut self, now: MonotonicTime, velocity_rad_per_s: JointVector) -> Result<(), CodecError> {
        let command = ArmCommand::velocities(&velocity_rad_per_s, self.config.supervision);
        if command.is_ok() {
            self.state = State::Moving(VelocityCommand { velocity_rad_per_s, since: now });
        } else if let State::Moving(_) = self.state {
            self.enter(now, DriverState::Holding);
        }
        command.map(drop)
    }

    /// Enters a state without an activity. Moving needs a velocity, and a latch a cause.
    pub(super) fn enter(&mut self, now: MonotonicTime, next: DriverState) {
        self.state = match (next, self.state.latch()) {
            (DriverState::Disconnected, _) => State::Disconnected,
            (DriverState::Connected, _) => State::Connected,
            (DriverState::Enabled, _) => State::Enabled,
            (DriverState::Holding, _) => {
                let velocity = self.velocity_rad_per_s(now);
                let ramp = Ramp::decelerate(velocity, &self.config.deceleration_rad_per_s2, now);
                State::Holding { ramp, last_request: now }
            }
            (DriverState::Fault | DriverState::EStop, Some(latch)) => State::Latched(*latch),
            (DriverState::Moving | DriverState::Fault | DriverState::EStop, _) => return,
        };
    }

    fn begin(&mut self, now: MonotonicTime, activity: Activity) {
        let since = now;
        self.state = match (activity, self.state.latch()) {
            (Activity::Clearing, Some(latch)) => State::Clearing { since, axis: Axis::ALL[0], latch: *latch },
            (Activity::Connecting, _) => State::Looking { since, step: self.first_look(), latch: None },
            (Activity::Enabling, _) => {
                self.warm_up_failure = None;
                State::Enabling { since, step: EnableStep::Start }
            }
            (Activity::Releasing, _) => State::Releasing { since, step: ReleaseStep::Due },
            (Activity::None | Activity::Stopping | Activity::Clearing, _) => return,
        };
        self.next_transmit = self.next_transmit.max(now);
        self.link.forget_misses();
    }

    pub(super) fn velocity_rad_per_s(&self, now: MonotonicTime) -> JointVector {
        match &self.state {
            State::Moving(command) => command.velocity_rad_per_s(now, &self.config.watchdog),
            State::Holding { ramp, .. } | State::Braking { step: StopStep::Ramp(ramp), .. } => {
                ramp.velocity_rad_per_s(now)
            }
            _ => JointVector::zeros(),
        }
    }

    fn uniform(&self, command: AxisCommand) -> ControlMessage {
        ControlMessage::Cyclic(ArmCommand::uniform(command, self.config.supervision))
    }

    fn due_message(&self, now: MonotonicTime) -> Option<ControlMessage> {
        Some(match self.state {
            State::Disconnected | State::Connected | State::Latched(_) => return None,
            State::Clearing { axis, .. } => ControlMessage::ClearAlarm(axis),
            State::Looking { step, .. } => match step {
                LookStep::Limits(axis) => ControlMessage::ReadEeprom(axis),
                LookStep::Start | LookStep::StartSent => ControlMessage::Start,
                LookStep::Look => self.uniform(AxisCommand::Off),
                LookStep::End => ControlMessage::End,
            },
            State::Enabling { step: EnableStep::Start | EnableStep::StartSent, .. } => ControlMessage::Start,
            State::Enabling { step: EnableStep::WarmUp(_), .. } | State::Enabled => self.uniform(AxisCommand::Braked),
            State::Braking { step: StopStep::Brake { .. }, .. } => self.uniform(AxisCommand::Braked),
            State::Releasing { .. } | State::Holding { .. } | State::Moving(_) | State::Braking { .. } => {
                self.velocity_message(now)
            }
            State::Ending { step: EndStep::Off, .. } => self.uniform(AxisCommand::Off),
            State::Ending { step: EndStep::End { .. }, .. } => ControlMessage::End,
        })
    }

    fn velocity_message(&self, now: MonotonicTime) -> ControlMessage {
        let velocity = self.velocity_rad_per_s(now);
        // A scaled velocity is valid if the velocity was valid.
        let command = ArmCommand::velocities(&velocity, self.config.supervision);
        command.map_or_else(|_| self.uniform(AxisCommand::Braked), ControlMessage::Cyclic)
    }

    fn note_sent(&mut self, now: MonotonicTime, letter: Letter) {
        let timeout = if letter == Letter::Cyclic { self.config.reply_timeout } else { self.config.control_timeout };
        self.outstanding = Some(Outstanding { letter, sent: now, deadline: now + timeout });
        self.given_up = None;
        self.link.handle_sent();
        self.state.note_sent(now, self.config.brake_time);
        // Cycles keep their grid; missed ones are skipped and counted.
        self.next_transmit = self.next_transmit + self.config.cycle;
        if self.next_transmit <= now {
            self.link.counters.overruns += u64::from(letter == Letter::Cyclic);
            self.next_transmit = now + self.config.cycle;
        }
    }
}
