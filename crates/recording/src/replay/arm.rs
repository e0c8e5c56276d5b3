//! Arms and operator of a replay: they answer as in the recording, and compare what they receive.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_bag::run_messages::{ArmCall, ArmChange, ControlStep};
use pb3dp_cell::operator::{MotionRequest, Operator};
use pb3dp_cell::parts::ArmControl;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, JointCommand, JointState, PowerOrder};
use pb3dp_hal_middleware::LimiterStatistics;
use pb3dp_kinematics::JointVector;
use pb3dp_servo::supervisor::{Decision, OperatorInput};

use super::differences::{Differences, Kind};
use crate::exact::{ARM_NAMES, failure, joints, motion, operator_input, same_bits};
use crate::steps::call_name;
use crate::tap::{Call, RunInputs};

/// What happened to an arm in the present step, in order.
enum Entry {
    Changed { query: u32, state: String },
    Called(ArmCall),
}

/// One arm of the recording.
#[derive(Default)]
struct ArmScript {
    entries: VecDeque<Entry>,
    /// Queries since the last call.
    queries: u32,
    state: Option<ArmState>,
    is_stopped_by_other: bool,
    measured: Option<JointState>,
    has_begun: bool,
}

/// Both arms and the operator of the recording.
#[derive(Default)]
pub struct Script {
    arms: [ArmScript; 2],
    inputs: OperatorInput,
    motion: MotionRequest,
    carries_before_start: bool,
    /// Time of the step since the begin of the run, seconds.
    t_s: f64,
    differences: Differences,
}

/// The script that arms, operator and replay share.
#[derive(Clone, Default)]
pub struct SharedScript(Arc<Mutex<Script>>);

impl SharedScript {
    fn lock(&self) -> MutexGuard<'_, Script> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Both arms and the operator.
    pub fn parts(&self, cycle: Duration, (is_person, can_fall_silent): (bool, bool)) -> RunInputs {
        let arm = |side: usize| {
            let info = ArmInfo { name: ARM_NAMES[side].to_owned(), cycle };
            Box::new(ReplayedArm { info, script: self.clone(), side })
        };
        let operator = ReplayedOperator { script: self.clone(), is_person, can_fall_silent };
        RunInputs { vs: arm(0), tc: arm(1), operator: Box::new(operator) }
    }

    /// Sets both arms as they were before the first step.
    ///
    /// # Errors
    /// If the recording does not tell.
    pub fn begin(&self, first: &mut ControlStep) -> Result<()> {
        let mut script = self.lock();
        for (side, arm) in script.arms.iter_mut().enumerate() {
            let is_ours = |of: u8| usize::from(of) == side;
            let call = before_first(first, side).with_context(|| {
                format!(
                    "the recording begins in the middle of a run, as the newest seconds at a fault do: it lacks the begin of {}, so the \
                     state of the control is not known; name a recording of the whole run (--record), or the folder of one that \
                     is divided; `pb3dp report` shows what it has, and `pb3dp track --sequence` estimates from the images again",
                    ARM_NAMES[side]
                )
            })?;
            arm.measured = Some(measured(call)?);
            for change in first.changes.iter().filter(|change| is_ours(change.arm) && change.after == 0) {
                arm.tell(&change.state)?;
            }
        }
        first.changes.retain(|change| change.after > 0);
        first.changes.iter_mut().for_each(|change| change.after -= 1);
        first.calls.retain(|call| call.call != "enabled");
        Ok(())
    }

    /// Sets what happened in the next step, `t_s` seconds after the begin.
    ///
    /// # Errors
    /// Names the damaged field.
    pub fn load(&self, step: &ControlStep, t_s: f64) -> Result<()> {
        let mut script = self.lock();
        script.t_s = t_s;
        script.inputs = operator_input(&step.said, &step.heard_at_nanos, &step.silent_after_nanos)?;
        script.motion = motion(step.speed_share, step.hand_from_hand_shifted);
        script.carries_before_start = step.carries_before_start;
        for (side, arm) in script.arms.iter_mut().enumerate() {
            arm.has_begun = true;
            arm.entries = entries(step, side);
        }
        Ok(())
    }

    /// Ends the step: what the arms were not asked is a difference, except after a failure that `ends_run`, since then the run stops the
    /// arms.
    ///
    /// # Errors
    /// Names the damaged field.
    pub fn end_step(&self, ends_run: bool) -> Result<()> {
        let mut script = self.lock();
        let Script { arms, differences, t_s, .. } = &mut *script;
        for (arm, name) in arms.iter_mut().zip(ARM_NAMES) {
            for entry in std::mem::take(&mut arm.entries) {
                match entry {
                    Entry::Changed { state, .. } => arm.tell(&state)?,
                    Entry::Called(call) if ends_run && call.call != "move" => {}
                    Entry::Called(call) => {
                        let recorded = format!("{name}: {}", call.call);
                        differences.differ(Kind::Commands, *t_s, recorded, format!("{name}: nothing"));
                        arm.measured = measured_if_any(&call)?.or(arm.measured);
                    }
                }
            }
        }
        Ok(())
    }

    /// Takes what was found so far.
    pub fn differences(&self) -> Differences {
        std::mem::take(&mut self.lock().differences)
    }
}

/// Whether the step tells how both arms were before it: it is the first of a run.
pub fn has_begin(first: &ControlStep) -> bool {
    (0..ARM_NAMES.len()).all(|side| before_first(first, side).is_some())
}

fn before_first(first: &ControlStep, side: usize) -> Option<&ArmCall> {
    first.calls.iter().find(|call| usize::from(call.arm) == side && call.call == "enabled")
}

/// Changes and calls of one arm in the order in which they happened.
fn entries(step: &ControlStep, side: usize) -> VecDeque<Entry> {
    let is_ours = |arm: u8| usize::from(arm) == side;
    let calls: Vec<&ArmCall> = step.calls.iter().filter(|call| is_ours(call.arm)).collect();
    let changes = |after: usize| {
        let then = move |change: &&ArmChange| is_ours(change.arm) && change.after as usize == after;
        let entry = |change: &ArmChange| Entry::Changed { query: change.query, state: change.state.clone() };
        step.changes.iter().filter(then).map(entry)
    };
    let mut entries = VecDeque::new();
    for (index, call) in calls.iter().enumerate() {
        entries.extend(changes(index));
        entries.push_back(Entry::Called((*call).clone()));
    }
    entries.extend(changes(calls.len()));
    entries
}

fn measured(call: &ArmCall) -> Result<JointState> {
    Ok(JointState {
        at: MonotonicTime::from_nanos(call.measured_at_nanos),
        position_rad: joints("calls.position_rad", &call.position_rad)?,
        velocity_rad_per_s: joints("calls.velocity_rad_per_s", &call.velocity_rad_per_s)?,
    })
}

fn measured_if_any(call: &ArmCall) -> Result<Option<JointState>> {
    if call.outcome == "measured" { measured(call).map(Some) } else { Ok(None) }
}

impl ArmScript {
    fn tell(&mut self, state: &str) -> Result<()> {
        match state {
            "disabled" => self.state = Some(ArmState::Disabled),
            "enabled" => self.state = Some(ArmState::Enabled),
            "fault" => self.state = Some(ArmState::Fault),
            "emergency stop" => self.state = Some(ArmState::EStop),
            "stopped by other" => self.is_stopped_by_other = true,
            "not stopped by other" => self.is_stopped_by_other = false,
            other => bail!("changes.state: {other:?} is no state of an arm"),
        }
        Ok(())
    }

    /// A query: changes up to it take effect.
    fn query(&mut self) {
        while let Some(Entry::Changed { query, .. }) = self.entries.front() {
            if *query > self.queries {
                break;
            }
            if let Some(Entry::Changed { state, .. }) = self.entries.pop_front() {
                // Damaged words are found when the step ends.
                let _ = self.tell(&state);
            }
        }
        self.queries += 1;
    }

    /// The next call of the recording with this meaning; calls before it, which nobody makes, are left out.
    fn next_call(&mut self, fits: impl Fn(&str) -> bool) -> Option<ArmCall> {
        self.queries = 0;
        let is_it = |entry: &Entry| matches!(entry, Entry::Called(call) if fits(&call.call));
        let index = self.entries.iter().position(is_it)?;
        for entry in self.entries.drain(..index).collect::<Vec<_>>() {
            match entry {
                Entry::Changed { state, .. } => drop(self.tell(&state)),
                Entry::Called(call) => self.measured = measured_if_any(&call).ok().flatten().or(self.measured),
            }
        }
        match self.entries.pop_front() {
            Some(Entry::Called(call)) => Some(call),
            _ => None,
        }
    }
}

/// An arm that answers as in the recording.
struct ReplayedArm {
    info: ArmInfo,
    script: SharedScript,
    side: usize,
}

fn is_exchange(word: &str) -> bool {
    matches!(word, "move" | "hold")
}

impl ReplayedArm {
    /// The recorded answer to a call; `done` if there is none.
    fn asked(&self, call: Call) -> Result<ArmCall, ArmError> {
        let mut script = self.script.lock();
        let Script { arms, differences, t_s, .. } = &mut *script;
        let arm = &mut arms[self.side];
        let word = call_name(&call);
        let blank =
            ArmCall { arm: self.side as u8, call: word.to_owned(), outcome: "done".to_owned(), ..ArmCall::default() };
        if !arm.has_begun {
            arm.queries = 0;
            return Ok(blank);
        }
        let found = arm.next_call(|other| other == word || is_exchange(word) && is_exchange(other));
        let call_text = |call: &ArmCall| format!("{}: {}{}", self.info.name, call.call, velocities(call));
        let now = match call {
            Call::Exchange(JointCommand::Velocity(velocity)) => {
                ArmCall { command_rad_per_s: velocity.as_slice().to_vec(), ..blank }
            }
            _ => blank,
        };
        let Some(recorded) = found else {
            differences.differ(Kind::Commands, *t_s, format!("{}: nothing", self.info.name), call_text(&now));
            return Ok(now);
        };
        let same = recorded.call == now.call && same_bits(&recorded.command_rad_per_s, &now.command_rad_per_s);
        differences.compare(Kind::Commands, *t_s, same, || (call_text(&recorded), call_text(&now)));
        match failure(&recorded.outcome) {
            Some(kind) => Err(self.failed(kind)),
            None => Ok(recorded),
        }
    }

    fn failed(&self, kind: ArmErrorKind) -> ArmError {
        ArmError::new(kind, format!("arm {}: failed in the recording ({kind:?})", self.info.name))
    }
}

fn velocities(call: &ArmCall) -> String {
    if call.command_rad_per_s.is_empty() { String::new() } else { format!(" {:?} rad/s", call.command_rad_per_s) }
}

impl Arm for ReplayedArm {
    fn info(&self) -> &ArmInfo {
        &self.info
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let answer = self.asked(Call::Exchange(command))?;
        let arm = &mut self.script.lock().arms[self.side];
        let measured = measured_if_any(&answer).map_err(|damage| {
            ArmError::new(ArmErrorKind::Disconnected, format!("arm {}: {damage:#}", self.info.name))
        })?;
        let still = JointState {
            at: MonotonicTime::ZERO,
            position_rad: JointVector::zeros(),
            velocity_rad_per_s: JointVector::zeros(),
        };
        let joints = measured.or(arm.measured).unwrap_or(still);
        arm.measured = Some(joints);
        Ok(joints)
    }
}

impl ArmPower for ReplayedArm {
    fn state(&self) -> ArmState {
        let arm = &mut self.script.lock().arms[self.side];
        arm.query();
        arm.state.unwrap_or(ArmState::Disabled)
    }

    fn is_stopped_by_other(&self) -> bool {
        let arm = &mut self.script.lock().arms[self.side];
        arm.query();
        arm.is_stopped_by_other
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        let answer = self.asked(Call::Power(order))?;
        let is_pending = order == PowerOrder::PollEnable && answer.outcome != "done";
        Ok(if is_pending { Poll::Pending } else { Poll::Ready(()) })
    }
}

impl ArmControl for ReplayedArm {
    fn statistics(&self) -> LimiterStatistics {
        LimiterStatistics::default()
    }
}

/// The operator of the recording.
struct ReplayedOperator {
    script: SharedScript,
    is_person: bool,
    can_fall_silent: bool,
}

impl Operator for ReplayedOperator {
    fn listen(&mut self, _last: Option<&Decision>, _now: MonotonicTime) -> OperatorInput {
        self.script.lock().inputs
    }

    fn show(&mut self, _decision: &Decision) {}

    fn tell(&mut self, _trouble: Option<String>) {}

    fn motion(&self) -> MotionRequest {
        self.script.lock().motion
    }

    fn is_person(&self) -> bool {
        self.is_person
    }

    fn carries_before_start(&self) -> bool {
        self.script.lock().carries_before_start
    }

    fn can_fall_silent(&self) -> bool {
        self.can_fall_silent
    }
}

#[cfg(test)]
mod tests {
    use super::super::differences::Compared;
    use super::*;

    fn call(arm: u8, word: &str, outcome: &str) -> ArmCall {
        let of = |value: f64| if outcome == "measured" { vec![value; 7] } else { Vec::new() };
        ArmCall {
            arm,
            call: word.to_owned(),
            command_rad_per_s: if word == "move" { vec![0.125; 7] } else { Vec::new() },
            outcome: outcome.to_owned(),
            measured_at_nanos: 10,
            position_rad: of(0.5),
            velocity_rad_per_s: of(0.0),
        }
    }

    fn change(arm: u8, after: u32, query: u32, state: &str) -> ArmChange {
        ArmChange { arm, after, query, state: state.to_owned() }
    }

    fn step(calls: Vec<ArmCall>, changes: Vec<ArmChange>) -> ControlStep {
        ControlStep {
            hand_from_hand_shifted: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            changes,
            calls,
            ..ControlStep::default()
        }
    }

    /// Both arms are enabled; the first one takes part in `first`.
    fn begun(first: ControlStep) -> (SharedScript, RunInputs) {
        let script = SharedScript::default();
        let inputs = script.parts(Duration::from_millis(10), (false, false));
        let mut before = first;
        let reported = |arm| [change(arm, 0, 0, "enabled"), change(arm, 0, 0, "not stopped by other")];
        before.calls.splice(0..0, [0, 1].map(|arm| call(arm, "enabled", "measured")));
        before.changes.iter_mut().for_each(|change| change.after += 1);
        before.changes.splice(0..0, [0, 1].into_iter().flat_map(reported));
        script.begin(&mut before).unwrap();
        script.load(&before, 1.5).unwrap();
        (script, inputs)
    }

    fn commands(script: &SharedScript) -> Compared {
        script.end_step(false).unwrap();
        script.differences().of(Kind::Commands)
    }

    #[test]
    fn answers_and_states_come_in_the_recorded_order() {
        let calls = vec![call(0, "hold", "timeout"), call(0, "hold", "measured"), call(1, "hold", "measured")];
        // After the first call, at the second query.
        let (script, mut inputs) =
            begun(step(calls, vec![change(0, 1, 1, "fault"), change(0, 1, 2, "stopped by other")]));
        assert_eq!(inputs.vs.state(), ArmState::Enabled);
        let failure = inputs.vs.exchange(JointCommand::Hold).unwrap_err();
        assert_eq!(failure.kind(), ArmErrorKind::Timeout);
        assert_eq!(inputs.vs.state(), ArmState::Enabled);
        assert_eq!(inputs.vs.state(), ArmState::Fault);
        assert!(inputs.vs.is_stopped_by_other() && !inputs.tc.is_stopped_by_other());
        assert_eq!(inputs.vs.exchange(JointCommand::Hold).unwrap().position_rad, JointVector::repeat(0.5));
        inputs.tc.exchange(JointCommand::Hold).unwrap();
        assert_eq!(commands(&script), Compared { compared: 3, differing: 0, first: None });
    }

    #[test]
    fn another_velocity_differs_by_its_last_bit() {
        let mut reported = JointVector::repeat(0.125);
        let (script, mut inputs) =
            begun(step(vec![call(0, "move", "measured"), call(1, "move", "measured")], Vec::new()));
        inputs.vs.exchange(JointCommand::Velocity(reported)).unwrap();
        reported[3] = f64::from_bits(reported[3].to_bits() + 1);
        inputs.tc.exchange(JointCommand::Velocity(reported)).unwrap();
        let Compared { compared, differing, first } = commands(&script);
        let first = first.unwrap();
        assert_eq!((compared, differing, first.t_s), (2, 1, 1.5));
        assert!(first.recorded.starts_with("tc-robot: move [0.125"), "{first:?}");
    }

    #[test]
    fn a_call_too_many_and_one_too_few_are_differences() {
        let (script, mut inputs) = begun(step(vec![call(0, "stop", "done"), call(1, "hold", "measured")], Vec::new()));
        inputs.vs.exchange(JointCommand::Hold).unwrap();
        inputs.tc.exchange(JointCommand::Hold).unwrap();
        let Compared { compared, differing, .. } = commands(&script);
        assert_eq!((compared, differing), (3, 2));
    }

    #[test]
    fn damaged_words_and_a_missing_begin_are_refused() {
        let script = SharedScript::default();
        let refusal = script.begin(&mut step(vec![call(0, "enabled", "measured")], Vec::new())).unwrap_err();
        assert!(refusal.to_string().contains("the begin of tc-robot"), "{refusal}");
        let (script, _) = begun(step(Vec::new(), vec![change(1, 0, 0, "asleep")]));
        assert!(script.end_step(false).unwrap_err().to_string().contains("\"asleep\""));
    }
}
