//! A stop order that the controller has not received: what the gateway does until it is received.
//!
//! The gateway repeats the step that closes the brakes. The brake time counts from the first answer; then servos off and E follow.
//! Only an answer to E ends the order. A controller that was powered off meanwhile may answer E only: a host request to a
//! silent controller therefore sends one E.

use pb3dp_arm_pa10_protocol::codec::ArmReply;
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, RejectReason, StopCause};
use pb3dp_geometry::MonotonicTime;

use super::host::Refused;
use super::machine::{END_TRIES, Job, Machine, StopStep, Work, wrong_state};

/// An axis with more speed than this is driven, in counts of 0.0002 rad/s: half of the slowest motion that an operator requests.
const SPEED_AT_REST_MAX: u16 = 50;

/// After E, so many unanswered C in a row show that the controller does not answer C: more than a bus or a delayed computer loses.
const CHECKS: u32 = 10;

/// An axis whose angles differ by more than this has moved, in counts of 7.67 µrad: 77 µrad.
const ANGLE_AT_REST_MAX: u32 = 10;

impl Machine {
    /// E was not answered: the order starts again with the brakes, and waits there for an answer.
    pub fn listen(&mut self, now: MonotonicTime) {
        if let Some(job) = self.queued.take() {
            self.host.refuse(now, &job.requester, Refused(RejectReason::NoAnswer, 0));
        }
        if self.state == GatewayState::Stopping {
            // Hosts may connect, and are informed that no controller answers.
            self.state = GatewayState::Idle;
        }
        self.is_unasked = self.state == GatewayState::Idle;
        self.detected_first = None;
        self.motion.doubt();
        self.stop_unacknowledged = true;
        self.work = Work::Stop(StopStep::Brake);
    }

    /// Whether the gateway only waits for an answer to the stop order.
    pub fn is_listening(&self) -> bool {
        self.stop_unacknowledged && matches!(self.work, Work::Stop(StopStep::Brake))
    }

    /// A request to a silent controller: sends E once, to test whether the controller answers.
    pub fn ask_for_end(&mut self, job: Job) -> Result<(), Refused> {
        self.queued = Some(job);
        self.work = Work::Close { tries: END_TRIES - 1 };
        Ok(())
    }

    /// Handles an answer to C.
    pub fn hear(&mut self, now: MonotonicTime) {
        let was_acknowledged = self.motion.is_acknowledged();
        self.motion.note_acknowledged(now);
        if was_acknowledged || !self.motion.is_acknowledged() {
            return;
        }
        self.stop_unacknowledged = false;
        match self.work {
            Work::Close { .. } => self.begin_acknowledged(now),
            Work::Stop(StopStep::Brake) if self.state == GatewayState::Idle => self.begin_acknowledged(now),
            _ => {}
        }
    }

    /// Continues the order from the brakes on, as the controller now receives it.
    fn begin_acknowledged(&mut self, now: MonotonicTime) {
        if self.state == GatewayState::Idle {
            self.state = GatewayState::Stopping;
            self.is_unasked = true;
            self.detected_first = None;
        }
        self.work = Work::Stop(StopStep::Brake);
        if let Some(job) = self.queued.take() {
            self.host.refuse(now, &job.requester, wrong_state(self.state));
        }
    }

    /// Handles an answer to the E that ends the control mode in the background.
    pub fn end_close(&mut self, now: MonotonicTime) {
        let was_acknowledged = self.motion.is_acknowledged();
        // This may be the first answer: then the brakes close from now on.
        self.motion.note_acknowledged(now);
        self.stop_unacknowledged = false;
        if was_acknowledged || self.state == GatewayState::Idle {
            self.is_unasked = false;
            self.work = self.queued.take().map_or(Work::Steady, Work::Job);
        } else {
            self.begin_acknowledged(now);
        }
    }

    /// Handles an answer to the E that ends the stop order.
    pub fn end_stop(&mut self, now: MonotonicTime) {
        if self.is_unasked && self.motion.is_acknowledged() {
            self.work = Work::Stop(StopStep::Check { left: CHECKS });
        } else {
            self.motion.note_acknowledged(now);
            self.finish_stop();
        }
    }

    /// Checks a measurement in an order that no host requested: an arm in motion was driven by a program that died.
    pub fn note_found(&mut self, now: MonotonicTime, reply: &ArmReply) {
        let is_ended = matches!(self.work, Work::Stop(StopStep::Check { .. }));
        if !self.is_unasked || self.state != GatewayState::Stopping {
            if is_ended {
                self.finish_stop();
            }
            return;
        }
        let angles = reply.axes.map(|axis| axis.angle);
        let first = *self.detected_first.get_or_insert(angles);
        let moved = angles.iter().zip(&first).any(|(angle, first)| angle.0.abs_diff(first.0) > ANGLE_AT_REST_MAX);
        let runs = |speed: pb3dp_arm_pa10_protocol::codec::SpeedCounts| speed.0.unsigned_abs() > SPEED_AT_REST_MAX;
        if moved || reply.axes.iter().any(|axis| axis.speed.is_some_and(runs)) {
            self.latch_found(now);
        } else if is_ended {
            self.finish_stop();
        }
    }

    /// A program that drove the arm has died: the arm was in motion, or its controller was in a control mode that no host requested.
    pub fn latch_found(&mut self, now: MonotonicTime) {
        self.is_unasked = false;
        self.trip(now, StopCause::HostSilent, None, 0);
        // If the arm moves, the order continues; after E it is over.
        if matches!(self.work, Work::Stop(StopStep::Check { .. })) {
            self.finish_stop();
        }
    }
}
