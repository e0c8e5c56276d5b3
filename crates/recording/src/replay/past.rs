//! Control of a recording that begins in the middle of a run: its state before is not known, so it is shown as recorded.

use anyhow::{Context, Result};
use pb3dp_bag::messages::LogLine;
use pb3dp_bag::run_messages::{ArmCall, ControlStep};
use pb3dp_cell::journal::RecordedStep;
use pb3dp_cell::log::ArmSample;
use pb3dp_cell::supervision::TransitionNote;
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;
use pb3dp_servo::supervisor::{Event, State};

use crate::exact::joints;

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

/// The change of state that a line tells; none if it is not of this program.
fn change(line: &LogLine, t_s: f64) -> Option<TransitionNote> {
    let (from, rest) = line.msg.split_once(" -> ")?;
    let (to, rest) = rest.split_once(" (")?;
    let (event, why) = rest.split_once("): ")?;
    let state = |name: &str| State::ALL.into_iter().map(State::name).find(|known| *known == name);
    Some(TransitionNote {
        t_s,
        from: state(from)?,
        to: state(to)?,
        event: Event::ALL.into_iter().map(Event::name).find(|known| *known == event)?,
        why: why.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use pb3dp_bag::messages::Time;

    use super::*;

    #[test]
    fn a_line_of_the_supervisor_is_read_back() {
        let line = |msg: &str| LogLine {
            stamp: Time { sec: 0, nanosec: 0 },
            level: 20,
            name: String::new(),
            msg: msg.to_owned(),
            file: String::new(),
            function: String::new(),
            line: 0,
        };
        let read =
            change(&line("tracking -> stopped (stop-found): stopped: (so) it is): late; use reset"), 2.5).unwrap();
        assert_eq!((read.t_s, read.from, read.to, read.event), (2.5, "tracking", "stopped", "stop-found"));
        assert_eq!(read.why, "stopped: (so) it is): late; use reset");
        for other in ["", "tracking -> asleep (stop-found): x", "tracking -> stopped (nap): x", "tracking -> stopped"] {
            assert_eq!(change(&line(other), 2.5), None, "{other}");
        }
    }
}
