//! Control of a recording that begins in the middle of a run: its state before is not known, so it is shown as recorded.

use anyhow::{Context, Result};
use pb3dp_bag::messages::LogLine;
use pb3dp_bag::run_messages::{ArmCall, ControlStep};
use pb3dp_cell::journal::RecordedStep;
use pb3dp_cell::log::ArmSample;
use pb3dp_cell::supervision::TransitionNote;
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;
use pb3dp_servo::supervisor::State;

use crate::exact::{change, joints};

/// The recorded control.
#[derive(Debug, Default)]
pub struct Past {
    /// Time of the first step since the begin of the run, seconds, if the recording lacks the begin.
    pub begins_s: Option<f64>,
    /// Changes of state.
    pub changes: Vec<TransitionNote>,
    /// Last measured joints of each arm.
    position_rad: [Option<JointVector>; 2],
}

impl Past {
    /// Keeps a line on `/pb3dp/events`, at this time since the begin of the run.
    pub fn event(&mut self, line: &LogLine, t_s: f64) {
        self.changes.extend(change(line, t_s));
    }

    /// The step for the report; none before both arms were measured, and if a failure has ended it.
    ///
    /// # Errors
    /// Names the damaged field.
    pub fn step(&mut self, step: &ControlStep) -> Result<Option<RecordedStep>> {
        let mut requested = [None; 2];
        for ArmCall { arm, call, command_rad_per_s, outcome, position_rad, .. } in &step.calls {
            let side = usize::from(*arm).min(1);
            if outcome == "measured" {
                self.position_rad[side] = Some(joints("calls.position_rad", position_rad)?);
            }
            if call == "move" {
                requested[side] = Some(joints("calls.command_rad_per_s", command_rad_per_s)?);
            }
        }
        let [Some(vs), Some(tc)] = self.position_rad else { return Ok(None) };
        if !step.finished {
            return Ok(None);
        }
        let state = State::ALL.into_iter().find(|state| state.name() == step.state);
        let arm = |position_rad, requested_rad_per_s| ArmSample { position_rad, requested_rad_per_s };
        Ok(Some(RecordedStep {
            at: MonotonicTime::from_nanos(step.at_nanos),
            mode: step.mode.clone(),
            state: state.with_context(|| format!("state: {:?} is no state of the supervisor", step.state))?,
            arms: [arm(vs, requested[0]), arm(tc, requested[1])],
        }))
    }
}
