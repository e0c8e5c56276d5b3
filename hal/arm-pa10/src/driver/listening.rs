//! On a bus, what nobody has heard is not done.
//!
//! A gateway does this by itself, beside the arm. A driver that speaks to the controller does it here: an order to stop that was not
//! answered goes on with the step that closes the brakes, for as long as the program lives; and as nobody knows who drove the arm
//! before, looking at it begins with that step, too. Whatever is heard, the time of the brakes counts from there.

use pb3dp_arm_pa10_protocol::codec::{ArmCommand, AxisCommand, ControlMessage, Supervision};
use pb3dp_geometry::MonotonicTime;

use super::machine::Driver;
use super::phase::{FirstAnswer, LookStep, Phase, StopStep};
use super::table::Activity;
use super::{FaultCause, Sample, Trip};

/// Messages in a row without an answer that say that there is none: more than a bus loses, or a held-up computer.
const CHECKS: u32 = 10;

/// An axis that shows more than this is driven, rad/s: half of the slowest motion that an operator asks for.
const SPEED_AT_REST_MAX_RAD_PER_S: f64 = 0.01;

/// An axis that shows angles farther apart than this has moved, rad: ten counts.
const ANGLE_AT_REST_MAX_RAD: f64 = 77e-6;

impl Driver {
    /// Whether the controller has not answered the stop order: the driver goes on with it for as long as it is asked what to send. The
    /// arm may move. Never behind a gateway, which does the same by itself.
    pub fn is_unheard(&self) -> bool {
        self.doubt
    }

    /// Whether nothing is going on but that.
    pub(super) fn is_listening(&self) -> bool {
        self.doubt && self.state.is_latched() && self.phase == Phase::Steady
    }

    /// Brakes on, servos on: it opens no brake, and an arm at rest does that anyway.
    pub(super) fn closing(&self) -> ControlMessage {
        ControlMessage::Cyclic(ArmCommand::uniform(AxisCommand::Braked, Supervision::default()))
    }

    /// Looking at the arm, from its first step on.
    pub(super) fn begin_look(&mut self, activity: Activity) -> Phase {
        self.doubt |= activity == Activity::Connecting && !self.has_gateway;
        let step = match activity {
            _ if self.doubt => {
                self.found_rad = None;
                LookStep::Close { until: None, heard: FirstAnswer::Nothing }
            }
            Activity::Clearing => LookStep::Clear(0),
            _ => self.first_look(),
        };
        Phase::Looking { step, activity }
    }

    /// Goes on with the look where time has passed.
    pub(super) fn advance_look(&mut self, now: MonotonicTime) {
        if let Phase::Looking { step: LookStep::Close { until: Some(until), heard }, activity } = self.phase
            && now >= until
        {
            self.phase = Phase::Looking { step: LookStep::FirstEnd { tries: 0, heard }, activity };
        }
    }

    /// Counts what the look has sent.
    pub(super) fn note_look_sent(&mut self, now: MonotonicTime) {
        let Phase::Looking { step, .. } = &mut self.phase else { return };
        match step {
            LookStep::Close { until, .. } => *until = until.or(Some(now + self.config.brake_time)),
            LookStep::FirstEnd { tries, .. } => *tries += 1,
            LookStep::Check { left } => *left = left.saturating_sub(1),
            _ => {}
        }
    }

    /// E was answered before anything else was asked.
    pub(super) fn after_first_end(&mut self, now: MonotonicTime, heard: FirstAnswer, activity: Activity) -> LookStep {
        if heard == FirstAnswer::Nothing {
            // The first that was heard: the brakes close since now, and all else has its time from now on.
            self.phase_since = now;
            return LookStep::Close { until: Some(now + self.config.brake_time), heard: FirstAnswer::End };
        }
        self.doubt = false;
        match activity {
            Activity::Clearing => LookStep::Clear(0),
            _ if heard == FirstAnswer::Cyclic => LookStep::Check { left: CHECKS },
            _ => self.first_look(),
        }
    }

    /// A cyclic command was answered: what it says of brakes was heard. Whether that is all that the answer is good for.
    pub(super) fn note_heard(&mut self, now: MonotonicTime, sample: &Sample) -> bool {
        let closed = now + self.config.brake_time;
        match self.phase {
            Phase::Stopping(StopStep::Brake { until: Some(_), heard: false }) if !self.has_gateway => {
                self.phase = Phase::Stopping(StopStep::Brake { until: Some(closed), heard: true });
                false
            }
            Phase::Steady if self.is_listening() => {
                self.phase = Phase::Stopping(StopStep::Brake { until: Some(closed), heard: true });
                self.phase_since = now;
                false
            }
            Phase::Looking { step: LookStep::Close { until: Some(_), heard: FirstAnswer::Nothing }, activity } => {
                let step = LookStep::Close { until: Some(closed), heard: FirstAnswer::Cyclic };
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

    /// A message was not answered. Whether that is nothing to worry about.
    pub(super) fn note_unheard(&mut self, now: MonotonicTime) -> bool {
        match self.phase {
            Phase::Looking { step: LookStep::Close { .. }, .. } => {
                self.link.forget_misses();
                true
            }
            Phase::Looking { step: LookStep::Check { left }, .. } => {
                self.link.forget_misses();
                if left == 0 {
                    // It answers C in its control mode only, and has answered it before E: somebody had begun that.
                    self.trip(now, Trip::Fault(FaultCause::FoundDriven));
                }
                true
            }
            _ => false,
        }
    }

    /// The brakes had their time, and nobody has heard of it: servos that let go now could let the arm fall.
    pub(super) fn give_up_stop(&mut self, now: MonotonicTime) {
        if !self.state.is_latched() {
            self.trip(now, Trip::Fault(FaultCause::LinkLost { misses: self.link.misses() }));
        }
        self.finish_stop(now, false);
    }

    /// An arm that moves before anybody has asked it to was driven by somebody who died.
    fn judge_found(&mut self, now: MonotonicTime, sample: &Sample, activity: Activity) {
        let first = *self.found_rad.get_or_insert(sample.position_rad);
        let moved = (sample.position_rad - first).amax() > ANGLE_AT_REST_MAX_RAD;
        let runs = sample.velocity_rad_per_s.is_some_and(|velocity| velocity.amax() > SPEED_AT_REST_MAX_RAD_PER_S);
        if (moved || runs) && activity == Activity::Connecting {
            self.trip(now, Trip::Fault(FaultCause::FoundDriven));
        }
    }
}
