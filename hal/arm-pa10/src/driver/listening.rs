//! On a bus: an order that the controller has not received is repeated.
//!
//! A gateway does this by itself, beside the arm. A driver without a gateway does it here: an unanswered stop order is repeated
//! from the step that closes the brakes, for as long as the program runs. Because the previous user of the arm is unknown,
//! connecting begins with this step too. The brake time counts from the first answer.

use pb3dp_arm_pa10_protocol::codec::{ArmCommand, AxisCommand, ControlMessage, Supervision};
use pb3dp_geometry::MonotonicTime;

use super::machine::Driver;
use super::phase::{FirstAnswer, LookStep, Phase, StopStep};
use super::table::Activity;
use super::{FaultCause, Sample, Trip};

/// This number of unanswered messages in a row means that there is no answer: more than a bus or a delayed computer loses.
const CHECKS: u32 = 10;

/// An axis with more speed than this is driven, rad/s: half of the slowest motion that an operator requests.
const SPEED_AT_REST_MAX_RAD_PER_S: f64 = 0.01;

/// An axis whose angles differ by more than this has moved, rad: ten counts.
const ANGLE_AT_REST_MAX_RAD: f64 = 77e-6;

impl Driver {
    /// Whether the controller has not answered the stop order: the driver repeats it in every poll. The arm may move. Never with a
    /// gateway, which does the same by itself.
    pub fn stop_unacknowledged(&self) -> bool {
        self.stop_unconfirmed
    }

    /// Whether the driver only repeats the stop order.
    pub(super) fn is_listening(&self) -> bool {
        self.stop_unconfirmed && self.state.is_latched() && self.phase == Phase::Steady
    }

    /// Brakes on, servos on: opens no brake, and matches an arm at rest.
    pub(super) fn closing(&self) -> ControlMessage {
        ControlMessage::Cyclic(ArmCommand::uniform(AxisCommand::Braked, Supervision::default()))
    }

    /// Connecting, from its first step on.
    pub(super) fn begin_look(&mut self, activity: Activity) -> Phase {
        self.stop_unconfirmed |= activity == Activity::Connecting && !self.has_gateway;
        let step = match activity {
            _ if self.stop_unconfirmed => {
                self.first_position_rad = None;
                LookStep::Close { until: None, acknowledged: FirstAnswer::Nothing }
            }
            Activity::Clearing => LookStep::Clear(0),
            _ => self.first_look(),
        };
        Phase::Looking { step, activity }
    }

    /// Continues the connecting steps when time has passed.
    pub(super) fn advance_look(&mut self, now: MonotonicTime) {
        if let Phase::Looking { step: LookStep::Close { until: Some(until), acknowledged }, activity } = self.phase
            && now >= until
        {
            self.phase = Phase::Looking { step: LookStep::FirstEnd { tries: 0, acknowledged }, activity };
        }
    }

    /// Counts the messages of connecting.
    pub(super) fn note_look_sent(&mut self, now: MonotonicTime) {
        let Phase::Looking { step, .. } = &mut self.phase else { return };
        match step {
            LookStep::Close { until, .. } => *until = until.or(Some(now + self.config.brake_time)),
            LookStep::FirstEnd { tries, .. } => *tries += 1,
            LookStep::Check { left } => *left = left.saturating_sub(1),
            _ => {}
        }
    }

    /// E was answered before any other request.
    pub(super) fn after_first_end(
        &mut self,
        now: MonotonicTime,
        acknowledged: FirstAnswer,
        activity: Activity,
    ) -> LookStep {
        if acknowledged == FirstAnswer::Nothing {
            // The first answer: the brakes close from now on, and all time limits start now.
            self.phase_since = now;
            return LookStep::Close { until: Some(now + self.config.brake_time), acknowledged: FirstAnswer::End };
        }
        self.stop_unconfirmed = false;
        match activity {
            Activity::Clearing => LookStep::Clear(0),
            _ if acknowledged == FirstAnswer::Cyclic => LookStep::Check { left: CHECKS },
            _ => self.first_look(),
        }
    }

    /// A cyclic command was answered, so the controller has received its brake order. Returns whether the answer has no other use.
    pub(super) fn note_acknowledged(&mut self, now: MonotonicTime, sample: &Sample) -> bool {
        let closed = now + self.config.brake_time;
        match self.phase {
            Phase::Stopping(StopStep::Brake { until: Some(_), acknowledged: false }) if !self.has_gateway => {
                self.phase = Phase::Stopping(StopStep::Brake { until: Some(closed), acknowledged: true });
                false
            }
            Phase::Steady if self.is_listening() => {
                self.phase = Phase::Stopping(StopStep::Brake { until: Some(closed), acknowledged: true });
                self.phase_since = now;
                false
            }
            Phase::Looking {
                step: LookStep::Close { until: Some(_), acknowledged: FirstAnswer::Nothing },
                activity,
            } => {
                let step = LookStep::Close { until: Some(closed), acknowledged: FirstAnswer::Cyclic };
                self.phase = Phase::Looking { step, activity };
                self.judge_found(now, sample, activity);
                true
            }
            Phase::Looking { step: LookStep::Close { .. }, activity } => {
                self.judge_found(now, sample, activity);
                true
            }
            Phase::Looking { step: LookStep::Check { .. }, activity } => {
                self.phase = Phase::Looking { step: self.first_look(), activity };
                true
            }
            _ => false,
        }
    }

    /// A message was not answered. Returns whether that is normal.
    pub(super) fn note_unacknowledged(&mut self, now: MonotonicTime) -> bool {
        match self.phase {
            Phase::Looking { step: LookStep::Close { .. }, .. } => {
                self.link.forget_misses();
                true
            }
            Phase::Looking { step: LookStep::Check { left }, .. } => {
                self.link.forget_misses();
                if left == 0 {
                    // It answers C in its control mode only, and has answered it before E: another program had started the control
                    // mode.
                    self.trip(now, Trip::Fault(FaultCause::FoundDriven));
                }
                true
            }
            _ => false,
        }
    }

    /// The brake time has passed without an answer: servos disabled now could let the arm fall.
    pub(super) fn give_up_stop(&mut self, now: MonotonicTime) {
        if !self.state.is_latched() {
            self.trip(now, Trip::Fault(FaultCause::LinkLost { misses: self.link.misses() }));
        }
        self.finish_stop(now, false);
    }

    /// An arm that moves before any request was driven by a program that died.
    fn judge_found(&mut self, now: MonotonicTime, sample: &Sample, activity: Activity) {
        let first = *self.first_position_rad.get_or_insert(sample.position_rad);
        let moved = (sample.position_rad - first).amax() > ANGLE_AT_REST_MAX_RAD;
        let runs = sample.velocity_rad_per_s.is_some_and(|velocity| velocity.amax() > SPEED_AT_REST_MAX_RAD_PER_S);
        if (moved || runs) && activity == Activity::Connecting {
            self.trip(now, Trip::Fault(FaultCause::FoundDriven));
        }
    }
}
