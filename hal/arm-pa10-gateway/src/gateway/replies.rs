//! Replies from the bus and their handling.

use pb3dp_arm_pa10::driver::{ArmCondition, EmergencyStopCause, FaultCause, Sample, Trip};
use pb3dp_arm_pa10_protocol::codec::{ArmReply, Axis, EepromAxis};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmOperation, Control, ControlReply, EepromLimits, GatewayMessage, GatewayState, RejectReason, StopCause,
};
use pb3dp_geometry::MonotonicTime;

use super::bus::{Arrived, Requester};
use super::host::Refused;
use super::machine::{Job, Machine, Measured, ResetStep, Task, Work};

/// Micro-units per unit.
const MICRO: f64 = 1e6;

/// Why the arm has to stop, as reported in FAULT.
#[derive(Clone, Copy, Debug)]
struct Found {
    cause: StopCause,
    axis: Option<Axis>,
    word: u16,
}

impl Machine {
    /// Handles a frame of the bus.
    pub fn handle_bus_frame(&mut self, now: MonotonicTime, frame: &[u8]) {
        match self.bus.handle_frame(&self.config, frame) {
            Arrived::Nothing => {}
            Arrived::Unusable => self.handle_unusable(now),
            Arrived::Sample(reply) => self.handle_sample(now, &reply),
            Arrived::Eeprom(table) => self.handle_eeprom(now, table.as_ref()),
            Arrived::Done => self.handle_done(now),
        }
    }

    fn handle_unusable(&mut self, now: MonotonicTime) {
        if let Work::Job(Job { requester, task: Task::Reset(_) }) = self.work {
            self.bus.outstanding = None;
            self.go_on(requester, ResetStep::End { found: StopCause::ReplyUnusable });
        }
        self.trip(now, StopCause::ReplyUnusable, None, 0);
    }

    fn handle_sample(&mut self, now: MonotonicTime, reply: &ArmReply) {
        self.measured = Some(Measured { reply: *reply, at: now });
        self.hear(now);
        self.note_found(now, reply);
        let condition = Sample::from_reply(reply, &self.config.torque_scale).condition;
        let found = self.judge(&condition);
        if let Work::Job(Job { requester, task: Task::Reset(ResetStep::Look) }) = self.work {
            let found = found.map_or(StopCause::None, |found| found.cause);
            self.go_on(requester, ResetStep::End { found });
            return;
        }
        if let Some(requester) = self.opening.take() {
            self.answer_control(now, &requester, Control::Arm(ArmOperation::Start));
        }
        if let Some(Found { cause, axis, word }) = found {
            self.trip(now, cause, axis, word);
        }
        if self.state == GatewayState::Moving
            && let Some(exceeded) = self.limits.judge_range(self.motion.sent(), reply)
        {
            self.trip_limit(now, exceeded);
        }
    }

    fn handle_eeprom(&mut self, now: MonotonicTime, table: Option<&EepromAxis>) {
        let Work::Job(Job { requester, task: Task::Read(_) }) = self.work else { return };
        self.work = Work::Steady;
        if let Some(table) = table {
            let urad = |rad: f64| (rad * MICRO).round() as i32;
            let limits = EepromLimits {
                axis: table.axis,
                // Within two turns: the table was checked.
                positive_limit_urad: urad(table.positive_limit.to_rad()),
                negative_limit_urad: urad(table.negative_limit.to_rad()),
            };
            self.host.answer(now, &requester, GatewayMessage::EepromLimits(limits));
        } else {
            self.host.refuse(now, &requester, Refused(RejectReason::NoAnswer, 0));
        }
    }

    fn handle_done(&mut self, now: MonotonicTime) {
        match self.work {
            Work::Job(job) => self.advance(now, &job),
            Work::Close { .. } => self.end_close(now),
            // The reply to E, which ends the order.
            Work::Stop(_) => self.end_stop(now),
            Work::Steady => {}
        }
    }

    fn advance(&mut self, now: MonotonicTime, job: &Job) {
        let requester = job.requester;
        let control = match job.task {
            Task::Start => {
                self.state = GatewayState::Started;
                self.work = Work::Steady;
                self.measured = None;
                self.motion.restart(now, self.config.supervision);
                self.limits.restart(now);
                self.opening = Some(requester);
                return;
            }
            Task::End => {
                self.state = GatewayState::Idle;
                Control::Arm(ArmOperation::End)
            }
            Task::Clear(axis) => Control::ClearAlarm(axis),
            // The reply to R is not a bare letter.
            Task::Read(_) => return,
            Task::Reset(ResetStep::Start | ResetStep::Look) => return self.go_on(requester, ResetStep::Look),
            Task::Reset(ResetStep::End { found: StopCause::None }) => {
                (self.state, self.cause, self.found) = (GatewayState::Idle, StopCause::None, None);
                Control::Arm(ArmOperation::Reset)
            }
            Task::Reset(ResetStep::End { found }) => {
                self.work = Work::Steady;
                let present = Refused(RejectReason::CausePresent, u32::from(found.code()));
                return self.host.refuse(now, &requester, present);
            }
        };
        self.work = Work::Steady;
        self.answer_control(now, &requester, control);
    }

    fn go_on(&mut self, requester: Requester, step: ResetStep) {
        self.work = Work::Job(Job { requester, task: Task::Reset(step) });
    }

    pub fn answer_control(&mut self, now: MonotonicTime, requester: &Requester, control: Control) {
        let reply = ControlReply { control, state: self.state };
        self.host.answer(now, requester, GatewayMessage::ControlReply(reply));
    }

    /// Whether the arm may not hold its pose with open brakes: the newest measurement shows it, would not show it, or does not exist.
    pub fn is_uncontrollable(&self) -> bool {
        let signals = &self.config.signals;
        if signals.unknown().next().is_some() {
            return true;
        }
        let condition = |measured: &Measured| Sample::from_reply(&measured.reply, &self.config.torque_scale).condition;
        self.measured.as_ref().is_none_or(|measured| condition(measured).uncontrollable(signals).is_some())
    }

    /// The cause of a stop in the reported condition, if any.
    fn judge(&self, condition: &ArmCondition) -> Option<Found> {
        let of_axis = |cause, axis: Axis| Found { cause, axis: Some(axis), word: condition.axes[axis.index()].word() };
        let of_arm = |cause| Found { cause, axis: None, word: condition.comm.word() };
        let open = matches!(self.state, GatewayState::Holding | GatewayState::Moving);
        let signals = &self.config.signals;
        let trip = condition.trip(signals);
        let trip = trip.or_else(|| condition.uncontrollable(signals).filter(|_| open).map(Trip::from));
        Some(match trip? {
            Trip::EStop(
                EmergencyStopCause::Axis { axis, .. } | EmergencyStopCause::Switch { axis: Some(axis), .. },
            ) => of_axis(StopCause::EmergencyStop, axis),
            Trip::EStop(_) => of_arm(StopCause::EmergencyStop),
            Trip::Fault(FaultCause::ServoAlarm { axis, .. }) => of_axis(StopCause::ServoAlarm, axis),
            Trip::Fault(FaultCause::AxisUncontrollable { axis, .. }) => of_axis(StopCause::AxisUncontrollable, axis),
            Trip::Fault(FaultCause::ArmUncontrollable { .. }) => of_arm(StopCause::AxisUncontrollable),
            Trip::Fault(_) => of_arm(StopCause::ControllerAlarm),
        })
    }
}
