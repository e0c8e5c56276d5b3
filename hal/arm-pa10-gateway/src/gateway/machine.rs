//! The state machine between host and bus: state, work on the bus, watchdogs and stop order.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::arcnet::Frame;
use pb3dp_arm_pa10_protocol::codec::{AngleCounts, ArmCommand, ArmReply, Axis, ControlMessage, Letter};
use pb3dp_arm_pa10_protocol::gateway_protocol::{FaultReport, GatewayState, RejectReason, StopCause};
use pb3dp_geometry::MonotonicTime;

use super::bus::{Bus, Requester, count};
use super::config::GatewayConfig;
use super::host::{Host, Refused};
use super::limits::{Exceeded, LimitMonitor};
use super::motion::{self, Kind, Motion};

/// So many messages in a row without a usable reply stop the arm; a message outside the cycle has as many cycles for its reply.
pub(super) const SILENT_CYCLES: u32 = 3;

/// A host that is silent for this long ends the control mode.
pub(super) const STARTED_SILENCE: Duration = Duration::from_secs(1);

/// Time in which the stop order brings speeds to 0.
const RAMP: Duration = Duration::from_millis(30);

/// Cycles at speed 0 before the brakes close.
const REST_CYCLES: u32 = 5;

/// How often E is sent without an answer.
pub(super) const END_TRIES: u32 = 3;

/// Use of the bus besides the cycle.
#[derive(Clone, Copy, Debug)]
pub(super) enum Work {
    /// None: the state alone determines what is sent.
    Steady,
    /// A request of a host.
    Job(Job),
    /// The stop order.
    Stop(StopStep),
    /// E, until it is answered or was sent three times.
    Close { tries: u32 },
}

/// A request of a host that waits for its answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Job {
    pub requester: Requester,
    pub task: Task,
}

/// Messages outside the cycle.
#[derive(Clone, Copy, Debug)]
pub(super) enum Task {
    Start,
    End,
    Clear(Axis),
    Read(Axis),
    Reset(ResetStep),
}

/// Steps of a reset.
#[derive(Clone, Copy, Debug)]
pub(super) enum ResetStep {
    Start,
    Look,
    End { found: StopCause },
}

/// Steps of the stop order.
#[derive(Clone, Copy, Debug)]
pub(super) enum StopStep {
    Ramp {
        from: ArmCommand,
        since: MonotonicTime,
        until: MonotonicTime,
    },
    Rest {
        left: u32,
    },
    Brake,
    Off,
    End {
        tries: u32,
    },
    /// After E, in a stop order that no host requested: tests whether the controller answers C outside its control mode, too.
    Check {
        left: u32,
    },
}

/// Purpose of a message: determines how a missing answer is handled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Purpose {
    Cycle,
    Work,
}

/// A measurement.
#[derive(Clone, Copy, Debug)]
pub(super) struct Measured {
    pub reply: ArmReply,
    pub at: MonotonicTime,
}

/// Counters of the cycle since the gateway started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CycleCounters {
    /// Cycles.
    pub cycles: u64,
    /// Cycles that began late by more than a tenth of a cycle.
    pub overruns: u64,
    /// Longest time between the starts of two cycles.
    pub worst: Duration,
}

/// Everything but the parser, so that frames can be handled while the parser runs.
#[derive(Clone, Debug)]
pub(super) struct Machine {
    pub config: GatewayConfig,
    pub state: GatewayState,
    pub cause: StopCause,
    /// Axis and status word of the cause, while it is latched.
    pub found: Option<FaultReport>,
    pub host: Host,
    pub bus: Bus,
    pub motion: Motion,
    pub limits: LimitMonitor,
    pub work: Work,
    /// No host requested the stop order: the gateway has just started, or a silent controller has answered again.
    pub is_unasked: bool,
    /// The brakes had their time to close in a stop order that the controller has not answered.
    pub stop_unacknowledged: bool,
    /// The first measured angles in a stop order that no host requested.
    pub detected_first: Option<[AngleCounts; Axis::COUNT]>,
    /// Waits until E is answered.
    pub queued: Option<Job>,
    /// A `start` that waits for the first measurement.
    pub opening: Option<Requester>,
    pub measured: Option<Measured>,
    /// Whether the watchdog slowed down the last cycle.
    pub slowed: bool,
    pub cycles: CycleCounters,
    /// The longest cycle since the last HEALTH.
    pub worst_lately: Duration,
    /// Damaged frames of the host.
    pub damaged: u64,
    pub next_cycle: MonotonicTime,
    /// The switch stands on local: no host moves or enables the arm.
    pub is_local: bool,
    last_cycle: Option<MonotonicTime>,
    purpose: Purpose,
}

impl Machine {
    pub fn new(config: GatewayConfig, now: MonotonicTime) -> Self {
        Self {
            config,
            // The state is unknown: an arm whose gateway died may still be driven, with open brakes.
            state: GatewayState::Stopping,
            cause: StopCause::None,
            found: None,
            host: Host::new(),
            bus: Bus::default(),
            motion: Motion::new(config.brake_time, now),
            limits: LimitMonitor::new(config.limits, config.watchdog.ramp_after(), config.cycle),
            work: Work::Stop(StopStep::Brake),
            is_unasked: true,
            stop_unacknowledged: false,
            detected_first: None,
            queued: None,
            opening: None,
            measured: None,
            slowed: false,
            cycles: CycleCounters::default(),
            worst_lately: Duration::ZERO,
            damaged: 0,
            next_cycle: now,
            is_local: false,
            last_cycle: None,
            purpose: Purpose::Work,
        }
    }

    /// Begins a cycle if it is due, and returns the frame to send.
    pub fn tick(&mut self, now: MonotonicTime) -> Option<Frame> {
        if now < self.next_cycle {
            return None;
        }
        self.note_cycle(now);
        self.check_reply(now);
        self.check_host(now);
        self.check_switch(now);
        // The outstanding reply belongs to a message outside the cycle: only one at a time.
        if self.bus.outstanding.is_some() {
            return None;
        }
        let (message, purpose) = self.due(now)?;
        self.send(now, message, purpose)
    }

    /// Stops the arm and latches, unless a cause is latched already.
    pub fn trip(&mut self, now: MonotonicTime, cause: StopCause, axis: Option<Axis>, word: u16) {
        let state_before = self.state;
        let is_about_controller =
            !matches!(cause, StopCause::Internal | StopCause::HostFault | StopCause::LocalControl);
        match state_before {
            GatewayState::Fault | GatewayState::EmergencyStop => return,
            GatewayState::Idle if is_about_controller => return,
            // At start the controller may be powered off or may not accept commands. Hosts are informed when they connect.
            GatewayState::Stopping if self.is_unasked && is_about_controller => return,
            _ => {}
        }
        let is_emergency_stop = cause == StopCause::EmergencyStop;
        self.state = if is_emergency_stop { GatewayState::EmergencyStop } else { GatewayState::Fault };
        self.is_unasked = false;
        self.cause = cause;
        let report = FaultReport { cause, state_before, axis, word };
        self.found = Some(report);
        // A fault of the host was reported by the host itself.
        if cause != StopCause::HostFault {
            self.host.report(now, report);
        }
        let silent = cause == StopCause::ControllerSilent;
        let reason = if silent { Refused(RejectReason::NoAnswer, 0) } else { wrong_state(self.state) };
        self.cancel(now, reason);
        if !matches!(self.work, Work::Stop(_)) {
            self.begin_stop(now, state_before);
        }
    }

    /// Stops the arm because of a motion limit.
    pub fn trip_limit(&mut self, now: MonotonicTime, (axis, quantity): Exceeded) {
        self.trip(now, StopCause::LimitExceeded, Some(axis), u16::from(quantity.code()));
    }

    /// Refuses all requests that wait for an answer.
    pub fn cancel(&mut self, now: MonotonicTime, reason: Refused) {
        let job = if let Work::Job(job) = self.work { Some(job) } else { None };
        let jobs = [job, self.queued.take()].into_iter().flatten().map(|job| job.requester);
        for requester in jobs.chain(self.opening.take()) {
            self.host.refuse(now, &requester, reason);
        }
        if job.is_some() {
            // Its reply, if it still comes, is late.
            self.bus.outstanding = None;
            self.work = Work::Steady;
        }
    }

    /// Begins the stop order with the step that fits the last command.
    pub fn begin_stop(&mut self, now: MonotonicTime, state_before: GatewayState) {
        let from = *self.motion.sent();
        // No speed lasts longer than the command that it belongs to.
        let expires = self.motion.since() + self.config.watchdog.stop_after();
        let first = match motion::kind(&from) {
            _ if state_before == GatewayState::Idle && self.motion.is_acknowledged() => StopStep::End { tries: 0 },
            Kind::Motion => StopStep::Ramp { from, since: now, until: expires.min(now + RAMP) },
            Kind::Rest => StopStep::Rest { left: REST_CYCLES },
            Kind::BrakesOn => StopStep::Brake,
        };
        self.work = Work::Stop(first);
    }

    /// Whether a request of a host is in progress.
    pub fn is_busy(&self) -> bool {
        matches!(self.work, Work::Job(_)) || self.queued.is_some() || self.opening.is_some()
    }

    /// Ends the control mode in the background.
    pub fn close(&mut self) {
        self.bus.outstanding = None;
        self.work = Work::Close { tries: 0 };
    }

    /// The host has disconnected in `started`: E at once if all brakes are closed, otherwise the stop order first.
    pub fn end_started(&mut self, now: MonotonicTime) {
        if self.motion.brakes_closed(now) {
            self.state = GatewayState::Idle;
            self.close();
        } else {
            self.state = GatewayState::Stopping;
            self.begin_stop(now, GatewayState::Started);
        }
    }

    pub fn is_cycling(&self) -> bool {
        matches!(self.state, GatewayState::Started | GatewayState::Holding | GatewayState::Moving)
    }

    /// Handles the time-outs of a silent host.
    pub fn check_host(&mut self, now: MonotonicTime) {
        match self.state {
            GatewayState::Started if now.saturating_since(self.host.last_received) >= STARTED_SILENCE => {
                self.cancel(now, wrong_state(GatewayState::Idle));
                self.host.forget();
                self.end_started(now);
            }
            GatewayState::Holding | GatewayState::Moving
                if self.motion.age(now) >= self.config.watchdog.stop_after() =>
            {
                self.trip(now, StopCause::HostSilent, None, 0);
            }
            _ => {}
        }
    }

    /// Stops the arm and latches while the switch stands on local. The stop order of a gateway that starts is completed first:
    /// it finds out whether the arm was abandoned.
    pub fn check_switch(&mut self, now: MonotonicTime) {
        let is_starting = self.state == GatewayState::Stopping && self.is_unasked;
        if self.is_local && !is_starting {
            self.trip(now, StopCause::LocalControl, None, 0);
        }
    }

    pub fn finish_stop(&mut self) {
        self.work = Work::Steady;
        self.is_unasked = false;
        if self.state == GatewayState::Stopping {
            self.state = GatewayState::Idle;
        }
    }

    fn note_cycle(&mut self, now: MonotonicTime) {
        let late = now.saturating_since(self.next_cycle);
        if let Some(last) = self.last_cycle {
            let length = now.saturating_since(last);
            self.worst_lately = self.worst_lately.max(length);
            self.cycles.worst = self.cycles.worst.max(length);
        }
        count(&mut self.cycles.cycles);
        if late > self.config.cycle / 10 {
            count(&mut self.cycles.overruns);
        }
        self.last_cycle = Some(now);
        // Cycles keep their phase; missed cycles are skipped.
        self.next_cycle = self.next_cycle + self.config.cycle;
        if self.next_cycle <= now {
            self.next_cycle = now + self.config.cycle;
        }
        if late >= self.config.lateness_allowed && (self.is_cycling() || self.state == GatewayState::Stopping) {
            self.trip(now, StopCause::CycleMissed, None, 0);
        }
    }

    /// Gives up a message that was not answered in time.
    fn check_reply(&mut self, now: MonotonicTime) {
        let Some(outstanding) = &mut self.bus.outstanding else { return };
        outstanding.cycles += 1;
        let patience = if self.purpose == Purpose::Cycle { 1 } else { SILENT_CYCLES };
        if outstanding.cycles < patience {
            return;
        }
        self.bus.give_up();
        match (self.purpose, self.work) {
            (Purpose::Cycle, Work::Stop(StopStep::Check { left: 0 })) => self.latch_found(now),
            (Purpose::Cycle, _) if self.bus.misses >= SILENT_CYCLES => {
                self.trip(now, StopCause::ControllerSilent, None, 0);
            }
            (Purpose::Cycle, _) | (Purpose::Work, Work::Steady) => {}
            (Purpose::Work, Work::Job(job)) => self.fail(now, &job),
            (Purpose::Work, Work::Close { tries }) => {
                if tries >= END_TRIES {
                    self.listen(now);
                }
            }
            (Purpose::Work, Work::Stop(step)) => {
                self.trip(now, StopCause::ControllerSilent, None, 0);
                if matches!(step, StopStep::End { tries } if tries >= END_TRIES) {
                    self.listen(now);
                }
            }
        }
    }

    /// The controller did not answer a request of the host.
    fn fail(&mut self, now: MonotonicTime, job: &Job) {
        self.work = Work::Steady;
        match job.task {
            // The controller may have executed the message without an answer.
            Task::Start | Task::Reset(_) => self.close(),
            Task::End => self.trip(now, StopCause::ControllerSilent, None, 0),
            Task::Clear(_) | Task::Read(_) => {}
        }
        self.host.refuse(now, &job.requester, Refused(RejectReason::NoAnswer, 0));
    }

    /// The message that is due in this cycle.
    fn due(&mut self, now: MonotonicTime) -> Option<(ControlMessage, Purpose)> {
        match self.work {
            Work::Steady if self.is_cycling() => {
                let (command, slowed) = self.motion.command(now, &self.config.watchdog, &self.limits);
                // Speeds fade only while brakes are open.
                self.slowed = slowed && self.state == GatewayState::Moving;
                Some((ControlMessage::Cyclic(command), Purpose::Cycle))
            }
            Work::Steady => None,
            Work::Job(job) => Some((self.job_message(&job), Purpose::Work)),
            Work::Stop(step) => Some(self.stop_message(now, step)),
            Work::Close { tries } => {
                self.work = Work::Close { tries: tries + 1 };
                Some((ControlMessage::End, Purpose::Work))
            }
        }
    }

    fn job_message(&self, job: &Job) -> ControlMessage {
        match job.task {
            Task::Start | Task::Reset(ResetStep::Start) => ControlMessage::Start,
            Task::End | Task::Reset(ResetStep::End { .. }) => ControlMessage::End,
            Task::Clear(axis) => ControlMessage::ClearAlarm(axis),
            Task::Read(axis) => ControlMessage::ReadEeprom(axis),
            Task::Reset(ResetStep::Look) => ControlMessage::Cyclic(self.motion.off()),
        }
    }

    /// The next message of the stop order. It advances by count and time, with or without answers, until the brakes are commanded on:
    /// a controller that has not received that command could go on moving, or let its axes fall.
    fn stop_message(&mut self, now: MonotonicTime, step: StopStep) -> (ControlMessage, Purpose) {
        self.slowed = false;
        let step = match step {
            StopStep::Ramp { until, .. } if now >= until => StopStep::Rest { left: REST_CYCLES },
            other => other,
        };
        let step = match step {
            StopStep::Rest { left: 0 } => StopStep::Brake,
            other => other,
        };
        let step = match step {
            StopStep::Brake if self.motion.brakes_closed(now) => match self.state {
                _ if self.motion.is_acknowledged() => StopStep::Off,
                // A controller outside its control mode may not answer C, but answers E.
                GatewayState::Stopping if self.is_unasked => StopStep::End { tries: 0 },
                _ => {
                    self.stop_unacknowledged = true;
                    StopStep::Brake
                }
            },
            other => other,
        };
        let (next, message) = match step {
            StopStep::Ramp { from, since, until } => {
                let left = until.seconds_since(now) / until.seconds_since(since);
                (step, ControlMessage::Cyclic(motion::fading(&from, left)))
            }
            StopStep::Rest { left } => {
                let rest = motion::fading(self.motion.sent(), 0.0);
                (StopStep::Rest { left: left - 1 }, ControlMessage::Cyclic(rest))
            }
            StopStep::Brake => (step, ControlMessage::Cyclic(self.motion.braked())),
            StopStep::Off => (StopStep::End { tries: 0 }, ControlMessage::Cyclic(self.motion.off())),
            StopStep::End { tries } => (StopStep::End { tries: tries + 1 }, ControlMessage::End),
            StopStep::Check { left } => {
                let braked = ControlMessage::Cyclic(self.motion.braked());
                (StopStep::Check { left: left.saturating_sub(1) }, braked)
            }
        };
        self.work = Work::Stop(next);
        let purpose = if message.letter() == Letter::Cyclic { Purpose::Cycle } else { Purpose::Work };
        (message, purpose)
    }

    fn send(&mut self, now: MonotonicTime, message: ControlMessage, purpose: Purpose) -> Option<Frame> {
        match self.bus.send(&self.config, message) {
            Ok(frame) => {
                if let ControlMessage::Cyclic(command) = &message {
                    self.motion.note_sent(now, command);
                }
                self.purpose = purpose;
                Some(frame)
            }
            Err(_) => {
                self.trip(now, StopCause::Internal, None, 0);
                None
            }
        }
    }
}

/// Refusal: not allowed in this state.
pub(super) fn wrong_state(state: GatewayState) -> Refused {
    Refused(RejectReason::WrongState, u32::from(state.code()))
}
