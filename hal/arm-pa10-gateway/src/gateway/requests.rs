//! Requests of the host and their handling.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{ArmCommand, AxisCommand, WiredSignals};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmOperation, Control, DriveCommand, DriveMode, Frame, GatewayMessage, GatewayState, HELLO, Health, Hello,
    HelloReply, HostMessage, RejectReason, State, StopCause,
};
use pb3dp_geometry::MonotonicTime;

use super::bus::Requester;
use super::host::{Refused, refusal_of};
use super::machine::{Job, Machine, ResetStep, StopStep, Task, Work, wrong_state};
use super::motion::{self, Kind};
use super::table::{GatewayAction, HostRequest, action};

impl Machine {
    /// Handles a valid frame of another arm.
    pub fn handle_other_arm(&mut self, now: MonotonicTime, frame: &Frame) {
        let refused = Refused(RejectReason::WrongArm, u32::from(frame.arm.0));
        self.host.refuse(now, &requester(frame), refused);
    }

    /// Handles a valid frame of this arm: it gets exactly one answer, now or later.
    pub fn handle_frame(&mut self, now: MonotonicTime, frame: &Frame) {
        // Time-outs are handled first: a new command must not hide them.
        self.check_host(now);
        self.check_switch(now);
        let requester = requester(frame);
        let refused = if frame.frame_type == HELLO {
            self.handle_hello(now, frame, &requester).err()
        } else if !self.host.is_greeted {
            Some(Refused(RejectReason::NotConnected, 0))
        } else {
            let message = self.host.judge(now, frame, self.config.watchdog.ramp_after());
            message.and_then(|message| self.handle_message(now, &message, &requester)).err()
        };
        if let Some(refused) = refused {
            self.host.refuse(now, &requester, refused);
        }
    }

    /// The host is disconnected: unplugged or closed.
    pub fn handle_host_gone(&mut self, now: MonotonicTime) {
        let may_have_started = matches!(self.work, Work::Job(Job { task: Task::Start | Task::Reset(_), .. }));
        self.cancel(now, wrong_state(self.state));
        self.host.forget();
        match self.state {
            GatewayState::Holding | GatewayState::Moving => {
                self.trip(now, StopCause::HostSilent, None, 0);
            }
            GatewayState::Started => self.end_started(now),
            _ if may_have_started => self.close(),
            _ => {}
        }
    }

    /// Begins the stop order, for any caller.
    pub fn stop(&mut self, now: MonotonicTime) {
        let state = self.state;
        let starting = matches!(self.work, Work::Job(Job { task: Task::Start, .. }));
        let resetting = matches!(self.work, Work::Job(Job { task: Task::Reset(_), .. }));
        match action(state, HostRequest::Stop) {
            GatewayAction::BeginStop => {
                self.state = GatewayState::Stopping;
                self.cancel(now, wrong_state(self.state));
                self.begin_stop(now, state);
            }
            // The controller may have started although the request was aborted: end its control mode.
            _ if starting => {
                self.state = GatewayState::Stopping;
                self.cancel(now, wrong_state(self.state));
                self.work = Work::Stop(StopStep::End { tries: 0 });
            }
            _ if resetting => {
                self.cancel(now, wrong_state(state));
                self.close();
            }
            _ => {
                if let Some(job) = self.queued.take() {
                    self.host.refuse(now, &job.requester, wrong_state(state));
                }
            }
        }
    }

    /// The stop order for a host that has found a fault: only a reset leaves the latched state.
    fn abort(&mut self, now: MonotonicTime) {
        match action(self.state, HostRequest::Abort) {
            GatewayAction::Latch => self.trip(now, StopCause::HostFault, None, 0),
            // The state is latched and keeps its cause; a release in progress ends.
            _ => self.stop(now),
        }
    }

    fn handle_hello(&mut self, now: MonotonicTime, frame: &Frame, requester: &Requester) -> Result<(), Refused> {
        let message = HostMessage::decode(frame).map_err(|error| refusal_of(&error))?;
        let HostMessage::Hello(Hello { cycle_us, limits }) = message else {
            return Err(Refused(RejectReason::UnknownType, 0));
        };
        if let Some(wider) = limits.wider_than(&self.config.limits) {
            return Err(Refused(RejectReason::LimitsTooWide, wider.detail()));
        }
        let is_open = motion::opens(self.motion.sent());
        if is_open && self.host.is_greeted && self.limits.asked != Some(limits) {
            return Err(wrong_state(self.state));
        }
        self.limits.tighten(&self.config.limits, &limits);
        self.host.greet(now, frame, Duration::from_micros(u64::from(cycle_us)));
        let reply = self.hello_reply();
        self.host.answer(now, requester, GatewayMessage::HelloReply(reply));
        Ok(())
    }

    fn handle_message(
        &mut self,
        now: MonotonicTime,
        message: &HostMessage,
        requester: &Requester,
    ) -> Result<(), Refused> {
        match message {
            // Was handled before.
            HostMessage::Hello(_) => Err(Refused(RejectReason::UnknownType, 0)),
            HostMessage::Heartbeat => {
                let health = self.health();
                self.host.answer(now, requester, GatewayMessage::Health(health));
                Ok(())
            }
            HostMessage::Command(command) => self.handle_command(now, command, requester),
            HostMessage::Control(control) => self.handle_control(now, *control, requester),
        }
    }

    fn handle_command(
        &mut self,
        now: MonotonicTime,
        command: &DriveCommand,
        requester: &Requester,
    ) -> Result<(), Refused> {
        let supervision = self.config.supervision;
        let asked = match command.mode {
            DriveMode::Off => ArmCommand::uniform(AxisCommand::Off, supervision),
            DriveMode::Braked => ArmCommand::uniform(AxisCommand::Braked, supervision),
            DriveMode::Follow => ArmCommand::velocities(&command.velocity_rad_per_s(), supervision)
                .map_err(|_| Refused(RejectReason::BadValue, 0))?,
        };
        let next = self.judge_command(now, &asked)?.filter(|_| self.keeps_limits(now, &asked));
        let state = self.arm_state(now).ok_or(Refused(RejectReason::NoAnswer, 0))?;
        if let Some(next) = next {
            let over = if self.config.interpolates { self.host.cycle } else { Duration::ZERO };
            if self.slowed {
                self.motion.follow_anew(now, asked, over);
            } else {
                self.motion.follow(now, asked, over);
            }
            self.state = next;
        }
        self.host.answer(now, requester, GatewayMessage::State(State { gateway: self.state, ..state }));
        Ok(())
    }

    /// The state to which a command leads; `None` if the host only gets the current state.
    fn judge_command(&self, now: MonotonicTime, asked: &ArmCommand) -> Result<Option<GatewayState>, Refused> {
        let request = match motion::kind(asked) {
            Kind::BrakesOn => HostRequest::BrakesOn,
            Kind::Rest => HostRequest::Rest,
            Kind::Motion => HostRequest::Motion,
        };
        match action(self.state, request) {
            GatewayAction::Show => Ok(None),
            GatewayAction::Follow(next) => {
                let possible = !self.is_busy() && !self.motion.brakes_motion(asked) && self.motion.may_move(now, asked);
                let opens = self.state == GatewayState::Started && next == GatewayState::Holding;
                if possible && opens && self.is_uncontrollable() {
                    let cause = u32::from(StopCause::AxisUncontrollable.code());
                    return Err(Refused(RejectReason::CausePresent, cause));
                }
                if possible { Ok(Some(next)) } else { Err(wrong_state(self.state)) }
            }
            _ => Err(wrong_state(self.state)),
        }
    }

    /// Whether a command that would be followed is within the motion limits; otherwise it stops the arm.
    fn keeps_limits(&mut self, now: MonotonicTime, asked: &ArmCommand) -> bool {
        let measured = self.measured.as_ref().map(|measured| measured.reply);
        let Some(exceeded) = self.limits.judge_command(now, asked, measured.as_ref()) else { return true };
        self.trip_limit(now, exceeded);
        false
    }

    fn handle_control(&mut self, now: MonotonicTime, control: Control, requester: &Requester) -> Result<(), Refused> {
        match control {
            Control::Arm(ArmOperation::Stop) => {
                self.stop(now);
                self.answer_control(now, requester, control);
                Ok(())
            }
            Control::Arm(ArmOperation::Abort) => {
                self.abort(now);
                self.answer_control(now, requester, control);
                Ok(())
            }
            Control::Arm(ArmOperation::Start) => self.request(now, HostRequest::Start, Task::Start, requester, control),
            Control::Arm(ArmOperation::End) => self.request(now, HostRequest::End, Task::End, requester, control),
            Control::Arm(ArmOperation::Reset) if self.is_local => {
                Err(Refused(RejectReason::CausePresent, u32::from(StopCause::LocalControl.code())))
            }
            Control::Arm(ArmOperation::Reset) => {
                self.request(now, HostRequest::Reset, Task::Reset(ResetStep::Start), requester, control)
            }
            Control::ClearAlarm(axis) => self.request(now, HostRequest::Service, Task::Clear(axis), requester, control),
            Control::ReadEeprom(axis) => self.request(now, HostRequest::Service, Task::Read(axis), requester, control),
        }
    }

    /// Starts a request that needs a message to the controller, unless it is done already.
    fn request(
        &mut self,
        now: MonotonicTime,
        request: HostRequest,
        task: Task,
        requester: &Requester,
        control: Control,
    ) -> Result<(), Refused> {
        match action(self.state, request) {
            _ if self.is_busy() => Err(wrong_state(self.state)),
            GatewayAction::Nothing => {
                self.answer_control(now, requester, control);
                Ok(())
            }
            GatewayAction::Speak => self.begin(now, Job { requester: *requester, task }),
            _ => Err(wrong_state(self.state)),
        }
    }

    fn begin(&mut self, now: MonotonicTime, job: Job) -> Result<(), Refused> {
        if self.is_listening() {
            return self.ask_for_end(job);
        }
        let is_stopping = matches!(self.work, Work::Stop(_));
        let falls = matches!(job.task, Task::End) && !self.motion.brakes_closed(now);
        if is_stopping || falls {
            return Err(wrong_state(self.state));
        }
        if matches!(self.work, Work::Close { .. }) {
            self.queued = Some(job);
        } else {
            self.work = Work::Job(job);
        }
        Ok(())
    }

    /// The newest measurement; `None` if there is none since the control mode began.
    fn arm_state(&self, now: MonotonicTime) -> Option<State> {
        let measured = self.measured.as_ref()?;
        let state =
            State::from_reply(&measured.reply, &self.config.torque_scale, us(now.saturating_since(measured.at)));
        let (gateway, cause, is_ramping) = (self.state, self.cause, self.slowed);
        Some(State { gateway, cause, is_ramping, ..state.ok()? })
    }

    fn hello_reply(&self) -> HelloReply {
        let config = &self.config;
        HelloReply {
            // It has no inputs.
            wired: WiredSignals::default(),
            wire_format: self.bus.detected_format,
            geometry: config.geometry,
            state: self.state,
            cause: self.cause,
            cycle_us: us(config.cycle),
            ramp_after_us: us(config.watchdog.ramp_after()),
            stop_after_us: us(config.watchdog.stop_after()),
            controller_watchdog_us: config.controller_watchdog.map_or(0, us),
            brake_release_us: us(config.brake_time),
            firmware: config.firmware,
            limits: config.limits,
        }
    }

    fn health(&mut self) -> Health {
        let number = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
        let bus = &self.bus.counters;
        Health {
            state: self.state,
            cause: self.cause,
            exchanges: number(bus.exchanges),
            replies_lost: number(bus.lost),
            replies_late: number(bus.late),
            replies_mismatched: number(bus.mismatched),
            overruns: number(self.cycles.overruns),
            worst_cycle_us: us(std::mem::take(&mut self.worst_lately)),
            host_damaged: number(self.damaged),
            host_lost: number(self.host.sequence.lost()),
            host_stale: number(self.host.sequence.stale().saturating_add(self.host.waited)),
        }
    }
}

fn requester(frame: &Frame) -> Requester {
    Requester { sequence: frame.sequence, frame_type: frame.frame_type }
}

/// Whole microseconds, saturating.
fn us(duration: Duration) -> u32 {
    u32::try_from(duration.as_micros()).unwrap_or(u32::MAX)
}
