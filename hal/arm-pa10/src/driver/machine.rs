//! The driver: what it knows, what it is asked, what it sends.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{ArmCommand, Axis, AxisCommand, CodecError, ControlMessage, Letter};
use pb3dp_arm_pa10_protocol::gateway_protocol::{RejectReason, StopCause};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::{JointState, JointVector};

use super::link::LinkMonitor;
use super::motion::Motion;
use super::phase::{LookStep, Phase, StopStep};
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
    /// Counts messages from 0: the link makes its sequence number of it.
    pub exchange: u64,
    /// The message.
    pub message: ControlMessage,
    /// It belongs to the stop order after a fault or an emergency stop of an arm that was driven: a link to a gateway sends its
    /// ABORT before, so that the next program, too, has to wait for a reset.
    pub latches: bool,
}

/// The reply to the last message. The link has checked that it answers that message and no earlier one.
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
    /// The gateway refused a reset, because this is still there.
    StillThere(StopCause),
}

/// Limits of an axis as the controller keeps them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisLimits {
    /// Which axis.
    pub axis: Axis,
    /// Lower limit, rad.
    pub lower_rad: f64,
    /// Upper limit, rad.
    pub upper_rad: f64,
}

/// Why and since when the driver is latched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latched {
    /// Why. After a reset that failed: why it failed.
    pub trip: Trip,
    /// Since when.
    pub at: MonotonicTime,
    /// The state before.
    pub state_before: DriverState,
}

/// The host's side of one arm.
#[derive(Clone, Debug)]
pub struct Driver {
    pub(super) config: DriverConfig,
    pub(super) state: DriverState,
    pub(super) phase: Phase,
    pub(super) phase_since: MonotonicTime,
    pub(super) latched: Option<Latched>,
    /// What latched it is for the gateway to keep, too.
    pub(super) outlasts: bool,
    pub(super) motion: Motion,
    pub(super) link: LinkMonitor,
    pub(super) warm_up_failure: Option<WarmUpFailure>,
    pub(super) sample: Option<Sample>,
    pub(super) joints: Option<JointState>,
    pub(super) torques: TorqueMonitor,
    pub(super) limits: [Option<AxisLimits>; Axis::COUNT],
    /// The shorter of this watchdog and the gateway's.
    pub(super) stops_after: Duration,
    /// When the owner asked for something, or the brakes were open at last.
    pub(super) heard: MonotonicTime,
    pub(super) outstanding: Option<Outstanding>,
    /// The message before, if its answer was waited for in vain.
    given_up: Option<Letter>,
    next_transmit: MonotonicTime,
    exchange: u64,
    /// S was sent, and no E was answered since.
    pub(super) control_started: bool,
    /// The last cyclic command opened the brakes.
    pub(super) brakes_open: bool,
    /// A gateway is between the driver and the controller, and does what nobody hears by itself.
    pub(super) has_gateway: bool,
    /// On a bus: the arm may be driven, and no E was answered that says otherwise.
    pub(super) doubt: bool,
    /// Where the arm was found when it was looked for.
    pub(super) found_rad: Option<JointVector>,
}

/// A message whose reply is waited for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Outstanding {
    pub letter: Letter,
    pub sent: MonotonicTime,
    pub deadline: MonotonicTime,
}

/// Whether a reply may be one to a message with this letter.
fn fits(letter: Letter, reply: &Reply) -> bool {
    match reply {
        Reply::Sample(_) => letter == Letter::Cyclic,
        Reply::Limits(_) => letter == Letter::ReadEeprom,
        Reply::Done => !matches!(letter, Letter::Cyclic | Letter::ReadEeprom),
        Reply::Rejected(_) | Reply::StillThere(_) => true,
    }
}

impl Driver {
    /// A disconnected driver.
    ///
    /// # Errors
    /// If the configuration contradicts itself or leaves less than the requirements allow.
    pub fn new(config: DriverConfig) -> Result<Self, DriverConfigError> {
        config.check()?;
        Ok(Self {
            config,
            state: DriverState::Disconnected,
            phase: Phase::Steady,
            phase_since: MonotonicTime::ZERO,
            latched: None,
            outlasts: false,
            motion: Motion::Rest,
            link: LinkMonitor::default(),
            warm_up_failure: None,
            sample: None,
            joints: None,
            torques: TorqueMonitor::default(),
            limits: [None; Axis::COUNT],
            stops_after: config.watchdog.stop_after(),
            heard: MonotonicTime::ZERO,
            outstanding: None,
            given_up: None,
            next_transmit: MonotonicTime::ZERO,
            exchange: 0,
            control_started: false,
            brakes_open: false,
            has_gateway: false,
            doubt: false,
            found_rad: None,
        })
    }

    /// Where the driver is.
    pub fn state(&self) -> DriverState {
        self.state
    }

    /// What is going on besides.
    pub fn activity(&self) -> Activity {
        self.phase.activity()
    }

    /// Why the driver is latched, if it is.
    pub fn latched(&self) -> Option<&Latched> {
        self.latched.as_ref()
    }

    /// Why the last enabling failed, until the next one.
    pub fn warm_up_failure(&self) -> Option<&WarmUpFailure> {
        self.warm_up_failure.as_ref()
    }

    /// The newest measurement since the arm was connected.
    pub fn sample(&self) -> Option<&Sample> {
        self.sample.as_ref()
    }

    /// The newest joints. Where the arm does not measure speeds they are differences of angles, 0 at first.
    pub fn joints(&self) -> Option<&JointState> {
        self.joints.as_ref()
    }

    /// The limits that were read from the controller since it was connected, if they were.
    pub fn limits(&self) -> &[Option<AxisLimits>; Axis::COUNT] {
        &self.limits
    }

    /// What happened on the link.
    pub fn counters(&self) -> &LinkCounters {
        &self.link.counters
    }

    /// What operator or control loop want.
    ///
    /// # Errors
    /// If it is not possible now: nothing is sent for it. After a refused velocity the arm holds.
    pub fn handle_request(&mut self, now: MonotonicTime, request: Request) -> Result<(), Refusal> {
        // What has run out runs out before a new velocity could hide it.
        self.handle_timeout(now);
        self.heard = now;
        let event = request.event();
        let activity = self.activity();
        let answer = outcome(self.state, event);
        if answer == Outcome::Refuse {
            return Err(Refusal::NotInState { request: event, state: self.state });
        }
        if activity != Activity::None && event != Event::Stop {
            // Coming to rest is what every activity does anyway.
            return if event == Event::Hold { Ok(()) } else { Err(Refusal::Busy { request: event, activity }) };
        }
        if let Request::Move(velocity_rad_per_s) = request {
            self.follow(now, velocity_rad_per_s)?;
        }
        match answer {
            Outcome::To(next) => self.go(now, next),
            Outcome::Begin(Activity::Stopping) => self.begin_stop(now, false),
            Outcome::Begin(activity) => self.begin(now, activity),
            Outcome::Stay if event == Event::Stop && activity != Activity::None => self.begin_stop(now, false),
            Outcome::Stay | Outcome::Refuse => {}
        }
        Ok(())
    }

    /// A reply to the last message.
    pub fn handle_reply(&mut self, now: MonotonicTime, reply: &Reply) {
        let Some(outstanding) = self.outstanding else {
            // A sound answer to what is not waited for any more says that the link is slow, not that it is damaged.
            let was_given_up = self.given_up.take().is_some_and(|letter| fits(letter, reply));
            self.link.handle_bad(if was_given_up { BadReply::Late } else { BadReply::Mismatched });
            return;
        };
        if !fits(outstanding.letter, reply) {
            self.link.handle_bad(BadReply::Mismatched);
            return;
        }
        if now > outstanding.deadline {
            // Nobody may have looked at the link for a while: what it tells is old all the same.
            self.link.handle_bad(BadReply::Late);
            self.handle_timeout(now);
            return;
        }
        self.end_waiting(now, outstanding);
        if let Reply::Rejected(RejectReason::Stale | RejectReason::NoAnswer) = reply {
            self.handle_miss(now);
            return;
        }
        self.link.handle_answer(now.saturating_since(outstanding.sent));
        match reply {
            Reply::Rejected(reason) => self.handle_rejection(now, *reason, FaultCause::Rejected(*reason)),
            Reply::StillThere(found) => {
                self.handle_rejection(now, RejectReason::CausePresent, FaultCause::StillThere(*found));
            }
            Reply::Sample(sample) => self.handle_sample(now, sample),
            Reply::Limits(limits) => self.handle_limits(now, limits),
            Reply::Done => self.handle_done(now),
        }
    }

    /// Bytes came that are no reply to the last message. It is still waited for.
    pub fn handle_bad_reply(&mut self, bad: BadReply) {
        self.link.handle_bad(bad);
    }

    /// The link is gone.
    pub fn handle_unplugged(&mut self, now: MonotonicTime) {
        self.trip(now, Trip::Fault(FaultCause::Unplugged));
    }

    /// A sound frame of another arm came.
    pub fn handle_wrong_arm(&mut self, now: MonotonicTime, got: u8) {
        self.trip(now, Trip::Fault(FaultCause::WrongArm { got }));
    }

    /// Something else found that the arm must stop: a limit, a monitor, the other arm.
    pub fn handle_trip(&mut self, now: MonotonicTime, trip: Trip) {
        self.trip(now, trip);
    }

    /// Time has passed: what waited for too long is lost. [`Self::poll_transmit`] does this by itself.
    pub fn handle_timeout(&mut self, now: MonotonicTime) {
        if let Some(outstanding) = self.outstanding.filter(|outstanding| now >= outstanding.deadline) {
            self.end_waiting(now, outstanding);
            self.given_up = Some(outstanding.letter);
            self.handle_miss(now);
        }
        if let (DriverState::Moving, Phase::Steady) = (self.state, self.phase)
            && let Some(age) = self.motion.expired(now, &self.config.watchdog)
        {
            let allowed = self.config.watchdog.stop_after();
            self.trip(now, Trip::Fault(FaultCause::CommandTimeout { age, allowed }));
        }
        let (age, allowed) = (now.saturating_since(self.heard), self.config.owner_timeout);
        if (self.state, self.phase) == (DriverState::Holding, Phase::Steady) && age > allowed {
            self.trip(now, Trip::Fault(FaultCause::OwnerSilent { age, allowed }));
        }
        let allowed = self.config.activity_timeout;
        if self.phase != Phase::Steady && now.saturating_since(self.phase_since) > allowed {
            // A stop is given up only once the emergency order, which a fault begins anew, had its time, too.
            let is_last = self.activity() == Activity::Stopping && self.state.is_latched();
            self.trip(now, Trip::Fault(FaultCause::ActivityTimeout { activity: self.activity(), allowed }));
            if is_last {
                self.finish_stop(now, false);
            }
        }
    }

    /// The message that is due at this time, if one is. It counts as sent.
    pub fn poll_transmit(&mut self, now: MonotonicTime) -> Option<Transmit> {
        self.handle_timeout(now);
        if self.outstanding.is_some() || now < self.next_transmit {
            return None;
        }
        self.advance_look(now);
        self.advance_stop(now);
        let message = self.due_message(now)?;
        self.note_sent(now, &message);
        let exchange = self.exchange;
        self.exchange += 1;
        let latches = self.outlasts && self.is_stopping_latched();
        Some(Transmit { exchange, message, latches })
    }

    /// When the driver wants to be asked again, if it waits for anything but a request.
    pub fn next_deadline(&self) -> Option<MonotonicTime> {
        let sends = self.phase != Phase::Steady || self.is_cycling() || self.is_listening();
        let transmit = (sends && self.outstanding.is_none()).then_some(self.next_transmit);
        let reply = self.outstanding.map(|outstanding| outstanding.deadline);
        let command = match self.motion {
            Motion::Follow { since, .. } => Some(since + self.config.watchdog.stop_after()),
            Motion::Rest | Motion::Ramp { .. } => None,
        };
        [transmit, reply, command].into_iter().flatten().min()
    }

    /// When the next message may be sent: cycles keep their times.
    pub fn transmit_due(&self) -> MonotonicTime {
        self.next_transmit
    }

    /// The gateway tells that brakes take so long to open: waits at least for that.
    pub fn raise_brake_time(&mut self, least: Duration) {
        self.config.activity_timeout += least.saturating_sub(self.config.brake_time);
        self.config.brake_time = self.config.brake_time.max(least);
    }

    /// How long brakes are waited for.
    pub fn brake_time(&self) -> Duration {
        self.config.brake_time
    }

    /// A gateway answers, and stops the arm so long after the last command: the warm-up shows a link that is quick enough for both
    /// sides. Without one the driver speaks to the controller itself.
    pub fn note_watchdog(&mut self, stop_after: Duration) {
        self.has_gateway = true;
        self.stops_after = stop_after.min(self.config.watchdog.stop_after());
    }

    /// No reply is waited for any more. Cycles that passed while a slow message was under way were not missed.
    fn end_waiting(&mut self, now: MonotonicTime, outstanding: Outstanding) {
        self.outstanding = None;
        if outstanding.letter != Letter::Cyclic {
            self.next_transmit = self.next_transmit.max(now);
        }
    }

    /// Takes a velocity, or holds if it cannot be sent.
    fn follow(&mut self, now: MonotonicTime, velocity_rad_per_s: JointVector) -> Result<(), CodecError> {
        match ArmCommand::velocities(&velocity_rad_per_s, self.config.supervision) {
            Ok(_) => {
                self.motion = Motion::Follow { velocity_rad_per_s, since: now };
                Ok(())
            }
            Err(error) => {
                if self.state == DriverState::Moving {
                    self.go(now, DriverState::Holding);
                }
                Err(error)
            }
        }
    }

    /// Changes the state on request.
    fn go(&mut self, now: MonotonicTime, next: DriverState) {
        match next {
            DriverState::Holding => {
                let velocity = self.velocity_rad_per_s(now);
                self.motion = Motion::decelerate(velocity, &self.config.deceleration_rad_per_s2, now);
            }
            DriverState::Disconnected => {
                self.sample = None;
                self.joints = None;
                self.limits = [None; Axis::COUNT];
            }
            _ => {}
        }
        self.state = next;
    }

    fn begin(&mut self, now: MonotonicTime, activity: Activity) {
        let phase = match activity {
            Activity::Connecting | Activity::Clearing => self.begin_look(activity),
            Activity::Enabling => {
                self.warm_up_failure = None;
                Phase::Enabling { started: false }
            }
            Activity::Releasing => {
                self.motion = Motion::Rest;
                Phase::Releasing { since: None }
            }
            Activity::None | Activity::Stopping => return,
        };
        self.phase = phase;
        self.phase_since = now;
        self.next_transmit = self.next_transmit.max(now);
        self.link.forget_misses();
    }

    pub(super) fn velocity_rad_per_s(&self, now: MonotonicTime) -> JointVector {
        self.motion.velocity_rad_per_s(now, &self.config.watchdog)
    }

    /// Whether the state alone demands cyclic commands.
    fn is_cycling(&self) -> bool {
        matches!(self.state, DriverState::Enabled | DriverState::Holding | DriverState::Moving)
    }

    fn uniform(&self, command: AxisCommand) -> ControlMessage {
        ControlMessage::Cyclic(ArmCommand::uniform(command, self.config.supervision))
    }

    fn due_message(&mut self, now: MonotonicTime) -> Option<ControlMessage> {
        Some(match self.phase {
            Phase::Steady => match self.state {
                DriverState::Enabled => self.uniform(AxisCommand::Braked),
                DriverState::Holding | DriverState::Moving => self.velocity_message(now),
                _ if self.is_listening() => self.closing(),
                DriverState::Disconnected | DriverState::Connected | DriverState::Fault | DriverState::EStop => {
                    return None;
                }
            },
            Phase::Looking { step, .. } => match step {
                LookStep::Close { .. } => self.closing(),
                LookStep::FirstEnd { .. } => ControlMessage::End,
                LookStep::Clear(index) => ControlMessage::ClearAlarm(Axis::ALL[index]),
                LookStep::Limits(index) => ControlMessage::ReadEeprom(Axis::ALL[index]),
                LookStep::Start => ControlMessage::Start,
                LookStep::Look | LookStep::Check { .. } => self.uniform(AxisCommand::Off),
                LookStep::End => ControlMessage::End,
            },
            Phase::Enabling { started: false } => ControlMessage::Start,
            Phase::Enabling { started: true } => self.uniform(AxisCommand::Braked),
            Phase::Releasing { .. } => self.velocity_message(now),
            Phase::Stopping(step) => match step {
                StopStep::Ramp | StopStep::Rest { .. } => self.velocity_message(now),
                StopStep::Brake { .. } => self.uniform(AxisCommand::Braked),
                StopStep::Off => self.uniform(AxisCommand::Off),
                StopStep::End { .. } => ControlMessage::End,
            },
        })
    }

    fn velocity_message(&self, now: MonotonicTime) -> ControlMessage {
        let velocity = self.velocity_rad_per_s(now);
        // Parts of a velocity that was checked when it came can be sent, too.
        let command = ArmCommand::velocities(&velocity, self.config.supervision);
        command.map_or_else(|_| self.uniform(AxisCommand::Braked), ControlMessage::Cyclic)
    }

    fn note_sent(&mut self, now: MonotonicTime, message: &ControlMessage) {
        let letter = message.letter();
        let timeout = if letter == Letter::Cyclic { self.config.reply_timeout } else { self.config.control_timeout };
        self.outstanding = Some(Outstanding { letter, sent: now, deadline: now + timeout });
        self.given_up = None;
        self.link.handle_sent();
        match message {
            ControlMessage::Start => self.control_started = true,
            ControlMessage::Cyclic(command) => {
                self.brakes_open = matches!(command.axes[0], AxisCommand::Speed(_));
            }
            _ => {}
        }
        self.note_look_sent(now);
        self.note_stop_sent(now);
        // Cycles keep their times; those that were missed are left out and counted.
        self.next_transmit = self.next_transmit + self.config.cycle;
        if self.next_transmit <= now {
            self.link.counters.overruns += u64::from(letter == Letter::Cyclic);
            self.next_transmit = now + self.config.cycle;
        }
    }
}
