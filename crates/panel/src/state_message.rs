//! Builds the state that clients see.

use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use pb3dp_cell::moving::StepRecord;
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_kinematics::JointVector;
use pb3dp_servo::supervisor::{ArmCondition, Condition, Decision, Event, Outcome, State, Why, table};

use crate::control_link::ShownDecision;
use crate::hub::Hub;
use crate::messages::state::{
    ArmState, ControlState, HolderState, ImageCounts, Inhibit, OperatorState, Reason, StateMessage, SupervisorState,
    Truth,
};
use crate::messages::{time_ms, transform_of};
use crate::target_state::{HandPlace, target_state};

/// Time over which rates are measured.
const WINDOW: Duration = Duration::from_secs(1);

/// Builds states, one after the other.
pub struct StateBuilder {
    /// The newest decision.
    pub shown: Option<ShownDecision>,
    /// The newest control step.
    pub step: Option<StepRecord>,
    /// Problem that the operator must know.
    pub trouble: Option<String>,
    /// Since when each condition is active.
    since: BTreeMap<&'static str, MonotonicTime>,
    /// Joints at the state before, and their time.
    before: Option<(MonotonicTime, [JointVector; 2])>,
    speeds_rad_per_s: [JointVector; 2],
    /// Wall time, run time and number of pairs, over the last second.
    rates: VecDeque<(Instant, MonotonicTime, u64)>,
}

impl StateBuilder {
    /// Nothing is known yet.
    pub fn new(wall: Instant, now: MonotonicTime) -> Self {
        Self {
            shown: None,
            step: None,
            trouble: None,
            since: BTreeMap::new(),
            before: None,
            speeds_rad_per_s: [JointVector::zeros(); 2],
            rates: VecDeque::from([(wall, now, 0)]),
        }
    }

    /// The present state.
    pub fn build(&mut self, hub: &Hub, wall: Instant) -> StateMessage {
        let now = hub.now();
        let counts = hub.watched.pairs.counts();
        let (realtime_factor, fps) = self.measure_rates(wall, now, counts.count);
        self.measure_speeds();
        let newest = hub.watched.newest();
        let world_from_cam_left =
            self.step.as_ref().and_then(|step| hub.about.world_from_cam_left(&step.vs_joints.position_rad));
        let truth = newest.as_ref().and_then(|newest| newest.cam_left_from_target);
        let truth = truth.zip(world_from_cam_left).map(|(cam_left_from_target, world_from_cam_left)| Truth {
            world_from_target: transform_of(&(world_from_cam_left * cam_left_from_target)),
        });
        let jog = *hub.jog();
        let model_from_surface = self.step.as_ref().map_or_else(Pose::coincident, |step| step.model_from_surface);
        let hand = HandPlace { world_from_cam_left, model_from_surface, jog };
        let (target, error) = target_state(&hub.about, newest.as_deref(), &hand, now);
        let targets = hub.targets();
        let saved = targets.saved.iter().map(|(name, _)| name.clone()).collect();
        let target_name = targets.name.clone().filter(|_| target.id.is_some());
        drop(targets);
        StateMessage {
            kind: "state",
            time_ms: time_ms(now),
            realtime_factor,
            state: self.supervisor(hub),
            why: self.why(hub, now),
            operator: self.operator(hub, now),
            target: crate::messages::state::TargetState { name: target_name, ..target },
            saved,
            control: ControlState {
                error_mm: error.map(|(error_mm, _)| error_mm),
                error_deg: error.map(|(_, error_deg)| error_deg),
                speed_percent: hub.link.speed_share() * 100.0,
                jog,
            },
            arms: self.arms(hub),
            truth,
            images: ImageCounts { sequence: counts.sequence, fps, lost: counts.lost },
        }
    }

    /// Seconds of the run per wall second, and pairs per wall second.
    fn measure_rates(&mut self, wall: Instant, now: MonotonicTime, pairs: u64) -> (f64, f64) {
        self.rates.push_back((wall, now, pairs));
        while self.rates.len() > 2 && self.rates.get(1).is_some_and(|(at, ..)| wall.duration_since(*at) > WINDOW) {
            self.rates.pop_front();
        }
        let Some((wall_before, before, pairs_before)) = self.rates.front().copied() else { return (0.0, 0.0) };
        let seconds = wall.duration_since(wall_before).as_secs_f64();
        if seconds <= 0.0 {
            return (0.0, 0.0);
        }
        (now.seconds_since(before) / seconds, pairs.saturating_sub(pairs_before) as f64 / seconds)
    }

    fn measure_speeds(&mut self) {
        let Some(step) = &self.step else { return };
        let positions = [step.arms[0].position_rad, step.arms[1].position_rad];
        let Some((before, positions_before)) = self.before.replace((step.at, positions)) else { return };
        let seconds = step.at.seconds_since(before);
        if seconds > 0.0 {
            self.speeds_rad_per_s = [0, 1].map(|arm| (positions[arm] - positions_before[arm]) / seconds);
        }
    }

    fn supervisor(&self, hub: &Hub) -> SupervisorState {
        let number = hub.link.number.load(Ordering::SeqCst);
        let without = |name, may: &[&'static str]| SupervisorState {
            number,
            name,
            is_moving: false,
            is_latched: false,
            is_ready: false,
            may: may.to_vec(),
        };
        if !hub.about.has_arms() {
            return without("no-arms", if hub.about.is_calibrated { &["select"] } else { &[] });
        }
        if hub.link.is_over.load(Ordering::SeqCst) {
            return without("over", &[]);
        }
        let Some(ShownDecision { decision, number }) = &self.shown else { return without("starting", &["stop"]) };
        SupervisorState {
            number: *number,
            name: decision.state.name(),
            is_moving: hub.link.may_move.load(Ordering::SeqCst),
            is_latched: decision.state.is_latched(),
            is_ready: decision.is_ready,
            may: possible_commands(decision),
        }
    }

    fn why(&mut self, hub: &Hub, now: MonotonicTime) -> Reason {
        let Some(ShownDecision { decision, .. }) = &self.shown else {
            let line = match (hub.about.has_arms(), hub.watched.target()) {
                (true, _) => "both arms are being enabled; wait",
                (false, _) if !hub.about.is_calibrated => "images and controls only: the cameras are not calibrated",
                (false, None) => "no target selected: mark one in the left image",
                (false, Some(_)) => "the target is tracked; this panel moves no arms",
            };
            return Reason { line: line.to_owned(), code: None, inhibits: Vec::new() };
        };
        if hub.link.is_over.load(Ordering::SeqCst) {
            return Reason {
                line: "the run is over; both arms are stopped".to_owned(),
                code: None,
                inhibits: Vec::new(),
            };
        }
        let mut active: Vec<Condition> = decision.found.iter().collect();
        if let Some(condition) = condition_in(&decision.why)
            && !active.contains(&condition)
        {
            active.push(condition);
        }
        self.since.retain(|name, _| active.iter().any(|condition| condition.key() == *name));
        let inhibits = active.into_iter().map(|condition| {
            let since = *self.since.entry(condition.key()).or_insert(now);
            Inhibit {
                name: condition.key(),
                since_ms: now.seconds_since(since) * 1e3,
                clears_ms: None,
                action: hub.about.action_of(condition),
            }
        });
        let inhibits = inhibits.collect();
        Reason { line: decision.why.to_string(), code: decision.why.code().map(|code| code.code), inhibits }
    }

    fn operator(&self, hub: &Hub, now: MonotonicTime) -> OperatorState {
        let lease = hub.lease();
        let holder = lease.holder(now).map(|holder| HolderState { id: holder.id, name: holder.name.clone() });
        let heartbeat_ms_ago =
            lease.heartbeat_at().map(|heartbeat_at| now.saturating_since(heartbeat_at).as_secs_f64() * 1e3);
        OperatorState { holder, heartbeat_ms_ago, trouble: self.trouble.clone() }
    }

    fn arms(&self, hub: &Hub) -> Vec<ArmState> {
        let arms = hub.about.arms.iter().enumerate().take(2);
        let states = arms.map(|(index, about)| {
            let joints = about.chain.joints();
            let degrees = |vector: &JointVector| (0..joints).map(|joint| vector[joint].to_degrees()).collect();
            let Some(step) = &self.step else {
                let (position_deg, speed_deg_per_s, near) = (Vec::new(), Vec::new(), Vec::new());
                return ArmState {
                    name: about.name.clone(),
                    condition: "unknown",
                    position_deg,
                    speed_deg_per_s,
                    near,
                };
            };
            let position_rad = &step.arms[index].position_rad;
            let range = about.limits.operating();
            let near = |joint: usize| {
                let (min, max) = (range.position_min_rad()[joint], range.position_max_rad()[joint]);
                (2.0 * position_rad[joint] - min - max).abs() / (max - min)
            };
            ArmState {
                name: about.name.clone(),
                condition: condition_name(step.conditions[index]),
                position_deg: degrees(position_rad),
                speed_deg_per_s: degrees(&self.speeds_rad_per_s[index]),
                near: (0..joints).map(near).collect(),
            }
        });
        states.collect()
    }
}

/// Commands that the supervisor would accept now.
fn possible_commands(decision: &Decision) -> Vec<&'static str> {
    let leads = |event| matches!(table::outcome(decision.state, event), Outcome::To(..));
    let state = decision.state;
    let may_hold = state.is_moving() || (state.is_resting() && !decision.no_arm_may_move);
    [
        // While an arm moves, the panel holds first.
        ("select", leads(Event::Select) || state.is_moving()),
        ("start", leads(Event::Start) && decision.is_ready),
        ("hold", may_hold),
        ("hold-hand", state.is_moving()),
        ("resume", leads(Event::Resume) && decision.is_ready),
        ("re-align", leads(Event::Realign)),
        ("reset", leads(Event::Reset)),
        ("stop", !matches!(state, State::Stopped | State::Fault)),
    ]
    .into_iter()
    .filter_map(|(name, may)| may.then_some(name))
    .collect()
}

/// The condition that the reason names as active.
fn condition_in(why: &Why) -> Option<Condition> {
    match why {
        Why::Waiting { cause }
        | Why::Slowed { cause, .. }
        | Why::Resting { cause, .. }
        | Why::HeldByOperator { cause: Some(cause), .. }
        | Why::Latched { cause, is_gone: false, .. } => Some(cause.condition),
        _ => None,
    }
}

fn condition_name(condition: ArmCondition) -> &'static str {
    match condition {
        ArmCondition::Disabled => "disabled",
        ArmCondition::Enabled => "enabled",
        ArmCondition::Fault => "fault",
        ArmCondition::EmergencyStop => "emergency-stop",
        ArmCondition::StoppedByOther => "stopped-by-other",
    }
}
