//! Commands of the arms and decisions of the supervisor of two runs.

use std::collections::BTreeMap;
use std::sync::Arc;

use pb3dp_record::metrics::{max_abs, rms};

use super::estimates::{Matched, first};
use super::matching::Matching;
use super::recorded::{Recorded, Step};
use crate::exact::same_bits;

/// Velocities differ beyond this, rad/s; rounding is far below, every effect on the arm far above.
pub const BEYOND_RAD_PER_S: f64 = 1e-9;
/// Changes of state that are aligned; more are set side by side by their number. The table of the alignment then has 4 million entries.
const ALIGNED_MAX: usize = 2000;

/// The arms in the order of their numbers in messages.
pub const ARMS: [&str; 2] = ["vs, the arm with the cameras", "tc, the arm with the target"];

/// Commanded velocities of an arm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmComparison {
    /// Steps in which both runs command the arm.
    pub steps: usize,
    /// Rms over all joints and steps of the difference, rad/s.
    pub rms_rad_per_s: Option<f64>,
    /// Its largest magnitude, rad/s.
    pub max_rad_per_s: Option<f64>,
    /// Time in A of the first difference beyond [`BEYOND_RAD_PER_S`], seconds since the begin.
    pub first_beyond_s: Option<f64>,
}

/// Commands of two runs.
#[derive(Clone, Debug)]
pub struct CommandComparison {
    /// Control steps that belong together, and those with other calls.
    pub matched: Matched,
    /// The arm with the cameras, the arm with the target.
    pub arms: [ArmComparison; 2],
}

/// A change of state of the supervisor.
#[derive(Clone, Debug, PartialEq)]
pub struct StateChange {
    /// Time since the begin, seconds.
    pub t_s: f64,
    /// The state before; empty at the begin.
    pub from: Arc<str>,
    /// The new state.
    pub to: Arc<str>,
    /// Its reason.
    pub why: Arc<str>,
}

/// Decisions of two runs.
#[derive(Clone, Debug)]
pub struct DecisionComparison {
    /// Control steps that belong together, and those with another mode, state or reason.
    pub matched: Matched,
    /// Changes of state of A and of B, the same ones side by side.
    pub changes: Vec<[Option<StateChange>; 2]>,
    /// Time in each state in A and in B, seconds.
    pub seconds: BTreeMap<Arc<str>, [f64; 2]>,
}

/// Commanded velocity of each joint of an arm in a step, rad/s: zero for a hold, none if the arm is not commanded.
pub fn commanded(step: &Step, arm: u8) -> Option<[f64; 7]> {
    let last = step.calls.iter().rfind(|call| call.arm == arm && matches!(&*call.call, "move" | "hold"))?;
    if &*last.call == "hold" {
        return Some([0.0; 7]);
    }
    last.command_rad_per_s.as_slice().try_into().ok()
}

/// Compares the commands.
pub fn compare_commands(runs: [&Recorded; 2], steps: &Matching) -> CommandComparison {
    let is_equal = |[a, b]: [&Step; 2]| {
        let same = |k: usize| {
            let (a, b) = (&a.calls[k], &b.calls[k]);
            a.arm == b.arm && a.call == b.call && same_bits(&a.command_rad_per_s, &b.command_rad_per_s)
        };
        a.calls.len() == b.calls.len() && (0..a.calls.len()).all(same)
    };
    let matched = matched(runs, steps, is_equal);
    let arms = [0, 1].map(|arm| compare_arm(runs, &matched.matching, arm));
    CommandComparison { matched, arms }
}

fn compare_arm([a, b]: [&Recorded; 2], matching: &Matching, arm: u8) -> ArmComparison {
    let mut differences = Vec::new();
    let (mut steps, mut first_beyond_s) = (0, None);
    for &[in_a, in_b] in &matching.partners {
        let (a, b) = (&a.steps[in_a], &b.steps[in_b]);
        let (Some(in_a), Some(in_b)) = (commanded(a, arm), commanded(b, arm)) else { continue };
        steps += 1;
        let joints = in_a.iter().zip(&in_b).map(|(a, b)| b - a);
        if first_beyond_s.is_none() && joints.clone().any(|difference| difference.abs() > BEYOND_RAD_PER_S) {
            first_beyond_s = Some(a.stamp.t_s());
        }
        differences.extend(joints);
    }
    ArmComparison { steps, rms_rad_per_s: rms(&differences), max_rad_per_s: max_abs(&differences), first_beyond_s }
}

/// Compares the decisions.
pub fn compare_decisions(runs: [&Recorded; 2], steps: &Matching) -> DecisionComparison {
    let is_equal = |[a, b]: [&Step; 2]| a.mode == b.mode && a.state == b.state && a.why == b.why;
    let [changes_a, changes_b] = runs.map(|run| state_changes(&run.steps));
    let mut seconds: BTreeMap<Arc<str>, [f64; 2]> = BTreeMap::new();
    for (run, recorded) in runs.into_iter().enumerate() {
        for two in recorded.steps.windows(2).filter(|two| !two[0].state.is_empty()) {
            let lasted_s = (two[1].stamp.nanos - two[0].stamp.nanos) as f64 * 1e-9;
            seconds.entry(Arc::clone(&two[0].state)).or_default()[run] += lasted_s;
        }
    }
    let changes = side_by_side(&changes_a, &changes_b);
    DecisionComparison { matched: matched(runs, steps, is_equal), changes, seconds }
}

fn matched(runs: [&Recorded; 2], matching: &Matching, is_equal: impl Fn([&Step; 2]) -> bool) -> Matched {
    let steps = |at: &[usize; 2]| [&runs[0].steps[at[0]], &runs[1].steps[at[1]]];
    let differing: Vec<&[usize; 2]> = matching.partners.iter().filter(|at| !is_equal(steps(at))).collect();
    let first = differing.first().map(|at| first(steps(at).map(|step| step.stamp)));
    Matched { differing: differing.len(), first, matching: matching.clone() }
}

/// The first state and all changes.
fn state_changes(steps: &[Step]) -> Vec<StateChange> {
    let mut changes: Vec<StateChange> = Vec::new();
    for step in steps.iter().filter(|step| !step.state.is_empty()) {
        let from = changes.last().map(|change| Arc::clone(&change.to)).unwrap_or_default();
        if step.state != from {
            let (to, why) = (Arc::clone(&step.state), Arc::clone(&step.why));
            changes.push(StateChange { t_s: step.stamp.t_s(), from, to, why });
        }
    }
    changes
}

/// Sets the same changes side by side: a longest common subsequence, so that a change in one run only does not shift the others.
fn side_by_side(a: &[StateChange], b: &[StateChange]) -> Vec<[Option<StateChange>; 2]> {
    if a.len().max(b.len()) > ALIGNED_MAX {
        return (0..a.len().max(b.len())).map(|k| [a.get(k).cloned(), b.get(k).cloned()]).collect();
    }
    let is_same = |i: usize, j: usize| a[i].from == b[j].from && a[i].to == b[j].to;
    // Entry (i, j): the length of the subsequence from i of A and j of B on.
    let columns = b.len() + 1;
    let mut lengths = vec![0_u16; (a.len() + 1) * columns];
    for i in (0..a.len()).rev() {
        for j in (0..b.len()).rev() {
            let [below, right] = [lengths[(i + 1) * columns + j], lengths[i * columns + j + 1]];
            let diagonal = lengths[(i + 1) * columns + j + 1] + 1;
            lengths[i * columns + j] = if is_same(i, j) { diagonal } else { below.max(right) };
        }
    }
    let (mut i, mut j) = (0, 0);
    let mut rows = Vec::new();
    while i < a.len() || j < b.len() {
        let is_common = i < a.len() && j < b.len() && is_same(i, j);
        let takes_b = i == a.len() || (j < b.len() && lengths[i * columns + j + 1] > lengths[(i + 1) * columns + j]);
        rows.push([(is_common || !takes_b).then(|| a[i].clone()), (is_common || takes_b).then(|| b[j].clone())]);
        i += usize::from(is_common || !takes_b);
        j += usize::from(is_common || takes_b);
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    fn changes(states: &[(f64, &str)]) -> Vec<StateChange> {
        let mut from: Arc<str> = "".into();
        let change = |&(t_s, to): &(f64, &str)| {
            let change = StateChange { t_s, from: Arc::clone(&from), to: to.into(), why: "".into() };
            from = to.into();
            change
        };
        states.iter().map(change).collect()
    }

    fn check(a: &[(f64, &str)], b: &[(f64, &str)], expected: &[[Option<f64>; 2]]) {
        let rows = side_by_side(&changes(a), &changes(b));
        let times: Vec<[Option<f64>; 2]> =
            rows.iter().map(|row| row.each_ref().map(|change| change.as_ref().map(|change| change.t_s))).collect();
        assert_eq!(times, expected);
    }

    #[test]
    fn the_same_changes_of_state_are_side_by_side() {
        let a = [(0.0, "idle"), (1.0, "tracking"), (2.0, "holding"), (3.0, "tracking"), (4.0, "stopped")];
        let b = [(0.0, "idle"), (1.5, "tracking"), (4.5, "stopped")];
        let both = |a: f64, b: f64| [Some(a), Some(b)];
        check(&a, &b, &[both(0.0, 0.0), both(1.0, 1.5), [Some(2.0), None], [Some(3.0), None], both(4.0, 4.5)]);
        check(&b, &a, &[both(0.0, 0.0), both(1.5, 1.0), [None, Some(2.0)], [None, Some(3.0)], both(4.5, 4.0)]);
        check(&a[..1], &[], &[[Some(0.0), None]]);
    }
}
