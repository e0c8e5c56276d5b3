//! A stop order that nobody has heard is not done: what the gateway does until somebody has.
//!
//! It goes on with the step that closes the brakes. Whatever it hears, the time of the brakes counts from there, and then servos off
//! and E; only an answer to E ends it. A controller that was powered off meanwhile may answer E only: who asks for something of a
//! silent one has one E sent.

use pb3dp_arm_pa10_protocol::codec::ArmReply;
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, RejectReason, StopCause};
use pb3dp_geometry::MonotonicTime;

use super::host::Refused;
use super::machine::{END_TRIES, Job, Machine, StopStep, Work, wrong_state};

/// An axis that shows more than this is driven, in counts of 0.0002 rad/s: half of the slowest motion that an operator asks for.
const SPEED_AT_REST_MAX: u16 = 50;

/// C so often in a row without an answer, after E, says that there is none: more than a bus loses, or a held-up computer.
const CHECKS: u32 = 10;

/// An axis that shows angles farther apart than this has moved, in counts of 7.67 µrad: 77 µrad.
const ANGLE_AT_REST_MAX: u32 = 10;

impl Machine {
    /// E was not answered: the order begins again with the brakes, and waits there until something is heard.
    pub fn listen(&mut self, now: MonotonicTime) {
        if let Some(job) = self.queued.take() {
            self.host.refuse(now, &job.asker, Refused(RejectReason::NoAnswer, 0));
        }
        if self.state == GatewayState::Stopping {
            // Hosts may connect, and are informed that no controller answers.
            self.state = GatewayState::Idle;
        }
        self.is_unasked = self.state == GatewayState::Idle;
        self.seen_first = None;
        self.motion.doubt();
        self.is_unheard = true;
        self.work = Work::Stop(StopStep::Brake);
    }

    /// Whether nothing is going on but that.
    pub fn is_listening(&self) -> bool {
        self.is_unheard && matches!(self.work, Work::Stop(StopStep::Brake))
    }

    /// Somebody wants something of a controller that is silent: does it answer E at least?
    pub fn ask_for_end(&mut self, job: Job) -> Result<(), Refused> {
        self.queued = Some(job);
        self.work = Work::Close { tries: END_TRIES - 1 };
        Ok(())
    }

    /// C was answered.
    pub fn hear(&mut self, now: MonotonicTime) {
        let was_heard = self.motion.is_heard();
        self.motion.note_heard(now);
        if was_heard || !self.motion.is_heard() {
            return;
        }
        self.is_unheard = false;
        match self.work {
            Work::Close { .. } => self.begin_heard(now),
            Work::Stop(StopStep::Brake) if self.state == GatewayState::Idle => self.begin_heard(now),
            _ => {}
        }
    }

    /// The order from the brakes on, as it is heard now.
    fn begin_heard(&mut self, now: MonotonicTime) {
        if self.state == GatewayState::Idle {
            self.state = GatewayState::Stopping;
            self.is_unasked = true;
            self.seen_first = None;
        }
        self.work = Work::Stop(StopStep::Brake);
        if let Some(job) = self.queued.take() {
            self.host.refuse(now, &job.asker, wrong_state(self.state));
        }
    }

    /// E was answered that ends the control mode in the background.
    pub fn end_close(&mut self, now: MonotonicTime) {
        let was_heard = self.motion.is_heard();
        // It may have been the first that was heard: then the brakes close since now.
        self.motion.note_heard(now);
        self.is_unheard = false;
        if was_heard || self.state == GatewayState::Idle {
            self.is_unasked = false;
            self.work = self.queued.take().map_or(Work::Steady, Work::Job);
        } else {
            self.begin_heard(now);
        }
    }

    /// E was answered, with which the stop order ends.
    pub fn end_stop(&mut self, now: MonotonicTime) {
        if self.is_unasked && self.motion.is_heard() {
            self.work = Work::Stop(StopStep::Check { left: CHECKS });
        } else {
            self.motion.note_heard(now);
            self.finish_stop();
        }
    }

    /// What is found in an order that nobody asked for: an arm that moves was driven by somebody who died.
    pub fn note_found(&mut self, now: MonotonicTime, reply: &ArmReply) {
        let is_ended = matches!(self.work, Work::Stop(StopStep::Check { .. }));
        if !self.is_unasked || self.state != GatewayState::Stopping {
            if is_ended {
                self.finish_stop();
            }
            return;
        }
        let angles = reply.axes.map(|axis| axis.angle);
        let first = *self.seen_first.get_or_insert(angles);
        let moved = angles.iter().zip(&first).any(|(angle, first)| angle.0.abs_diff(first.0) > ANGLE_AT_REST_MAX);
        let runs = |speed: pb3dp_arm_pa10_protocol::codec::SpeedCounts| speed.0.unsigned_abs() > SPEED_AT_REST_MAX;
        if moved || reply.axes.iter().any(|axis| axis.speed.is_some_and(runs)) {
            self.latch_found(now);
        } else if is_ended {
            self.finish_stop();
        }
    }

    /// Somebody drove the arm and died: it was in motion, or its controller in a control mode that nobody had asked for here.
    pub fn latch_found(&mut self, now: MonotonicTime) {
        self.is_unasked = false;
        self.trip(now, StopCause::HostSilent, None, 0);
        // Of what moves the order goes on; after E it is over.
        if matches!(self.work, Work::Stop(StopStep::Check { .. })) {
            self.finish_stop();
        }
    }
}
