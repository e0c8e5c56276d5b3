//! Random inputs and commands: an independent oracle checks the permissions of the supervisor.

use std::cell::Cell;

use nalgebra::Matrix6;
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};

use pb3dp_servo::Mode;
use pb3dp_servo::supervisor::{
    ArmCondition, ArmInput, Confidence, Decision, EstimateInput, Event, FrameInput, Innovation, Inputs,
    OperatorCommand, OperatorInput, OperatorRequest, Permission, RangeEnd, State, Supervisor, SupervisorConfig,
};

use super::bench::{at, config};

/// Inputs of one step, with its faults.
#[derive(Clone, Debug)]
struct Step {
    dt_s: f64,
    command: Option<(OperatorCommand, f64)>,
    has_heartbeat: bool,
    arms: [ArmCondition; 2],
    measured_age_s: [Option<f64>; 2],
    has_frame: bool,
    skew_s: f64,
    confidence: Confidence,
    exposed_age_s: f64,
    target: u64,
    variance: f64,
    innovation: Innovation,
    mode: Mode,
    distance_rad: f64,
}

fn mostly<T: Clone + std::fmt::Debug + 'static>(
    good: T,
    bad: impl Strategy<Value = T> + 'static,
) -> impl Strategy<Value = T> {
    prop_oneof![200 => Just(good), 1 => bad]
}

fn arm_condition() -> impl Strategy<Value = ArmCondition> {
    let bad = prop_oneof![
        3 => Just(ArmCondition::Disabled),
        1 => Just(ArmCondition::Fault),
        1 => Just(ArmCondition::StoppedByOther),
        1 => Just(ArmCondition::EmergencyStop)
    ];
    mostly(ArmCondition::Enabled, bad)
}

fn command() -> impl Strategy<Value = Option<(OperatorCommand, f64)>> {
    let any_command = prop_oneof![
        4 => Just(OperatorCommand::Select),
        8 => Just(OperatorCommand::Start),
        1 => Just(OperatorCommand::Hold),
        1 => Just(OperatorCommand::HoldHand),
        3 => Just(OperatorCommand::Resume),
        1 => Just(OperatorCommand::Stop),
        6 => Just(OperatorCommand::Reset)
    ];
    let age_s = prop_oneof![8 => Just(0.0), 1 => -2.0..2.0_f64];
    prop_oneof![6 => Just(None), 1 => (any_command, age_s).prop_map(Some)]
}

fn step() -> impl Strategy<Value = Step> {
    let age = || mostly(Some(0.005), prop_oneof![Just(None), (-0.5..0.5_f64).prop_map(Some)]);
    let jump = (0.0..0.5_f64, 0.0..1.0_f64)
        .prop_map(|(position_m, orientation_rad)| Innovation::Jump { position_m, orientation_rad });
    let mode = prop_oneof![Just(Mode::Idle), Just(Mode::Locking), Just(Mode::Lost)];
    let moving = prop_oneof![1 => Just(Mode::Approaching), 3 => Just(Mode::Tracking)];
    (
        (mostly(0.01, -0.5..0.6_f64), command(), mostly(true, Just(false))),
        ([arm_condition(), arm_condition()], [age(), age()], mostly(true, Just(false))),
        (
            mostly(1e-4, prop_oneof![Just(f64::NAN), -0.02..0.02_f64]),
            mostly(Confidence::Sure, prop_oneof![Just(Confidence::Doubtful), Just(Confidence::NoPose)]),
            mostly(0.04, -0.5..1.5_f64),
            mostly(7, 0..9_u64),
        ),
        (
            mostly(1e-6, prop_oneof![Just(f64::NAN), -1e-3..1e-2_f64]),
            mostly(Innovation::Agrees, jump),
            prop_oneof![40 => moving, 1 => mode],
            mostly(0.5, -0.1..0.1_f64),
        ),
    )
        .prop_map(|((dt_s, command, has_heartbeat), (arms, measured_age_s, has_frame), exposed, more)| {
            let (skew_s, confidence, exposed_age_s, target) = exposed;
            let (variance, innovation, mode, distance_rad) = more;
            Step {
                dt_s,
                command,
                has_heartbeat,
                arms,
                measured_age_s,
                has_frame,
                skew_s,
                confidence,
                exposed_age_s,
                target,
                variance,
                innovation,
                mode,
                distance_rad,
            }
        })
}

/// Newest inputs, kept from step to step.
#[derive(Default)]
struct Timeline {
    now_s: f64,
    sequence: u64,
    heartbeat_s: f64,
    frame: Option<FrameInput>,
    estimate: Option<EstimateInput>,
}

impl Timeline {
    fn tell(&mut self, step: &Step) -> Inputs {
        self.now_s = (self.now_s + step.dt_s).max(1.0);
        let now_s = self.now_s;
        if step.has_heartbeat {
            self.heartbeat_s = now_s;
        }
        if step.has_frame {
            self.sequence += 1;
            let exposed_at = at(now_s - step.exposed_age_s);
            self.frame = Some(FrameInput { sequence: self.sequence, at: exposed_at, skew_s: step.skew_s });
            self.estimate = Some(EstimateInput {
                at: exposed_at,
                confidence: step.confidence,
                covariance: Some(Matrix6::from_diagonal_element(step.variance)),
                target: step.target,
            });
        }
        let arm = |i: usize| ArmInput {
            state: step.arms[i],
            measured_at: step.measured_age_s[i].map(|age_s| at(now_s - age_s)),
        };
        Inputs {
            operator: OperatorInput {
                request: step.command.map(|(command, age_s)| OperatorRequest { command, at: at(now_s - age_s) }),
                heartbeat_at: Some(at(self.heartbeat_s)),
                silent_after: None,
            },
            controller: step.mode,
            innovation: step.innovation,
            target_covariance: Some(Matrix6::from_diagonal_element(step.variance)),
            images_late_s: (step.variance > 1e-4).then_some(0.1),
            estimate: self.estimate,
            frame: self.frame,
            range_end: Some(RangeEnd { joint: 2, distance_rad: step.distance_rad }),
            smallest_singular_value: Some(0.1),
            arms: [arm(0), arm(1)],
        }
    }
}

/// A command is accepted only this long after the last jump of the target or hold of the controller, seconds.
const GO_AFTER_S: f64 = 0.05;

/// Oracle: checks each permission with the inputs and decisions only.
#[derive(Default)]
struct Judge {
    now_s: f64,
    /// Exposure of the newest confident estimate, seconds.
    sure_s: Option<f64>,
    /// Exposure of the newest pose, and its target; an estimate without a pose has no target.
    newest: Option<(f64, u64)>,
    selected_s: Option<f64>,
    started: bool,
    started_target: Option<u64>,
    must_hold_until_command: bool,
    /// The same for the arm with the target.
    both_must_rest: bool,
    /// Last time at which the controller output no velocity or the target jumped, seconds.
    doubted_s: f64,
    motions: u64,
}

impl Judge {
    /// Stores the estimate if its exposure is after the selection and not in the future.
    fn take(&mut self, estimate: &EstimateInput) {
        let exposed_s = estimate.at.as_secs_f64();
        let is_of_target = self.selected_s.is_some_and(|selected_s| exposed_s >= selected_s - 1e-9);
        if !is_of_target || exposed_s > self.now_s + 0.2 + 1e-9 {
            return;
        }
        if estimate.confidence == Confidence::Sure {
            self.sure_s = Some(self.sure_s.map_or(exposed_s, |before| before.max(exposed_s)));
        }
        let has_pose = estimate.confidence != Confidence::NoPose;
        if has_pose && self.newest.is_none_or(|(before_s, _)| exposed_s > before_s) {
            self.newest = Some((exposed_s, estimate.target));
        }
    }

    fn judge(&mut self, inputs: &Inputs, decision: &Decision, now_s: f64) {
        let command = inputs.operator.request.map(|request| request.command);
        let dangerous =
            inputs.arms.iter().any(|arm| !matches!(arm.state, ArmCondition::Enabled | ArmCondition::Disabled));
        if now_s < self.now_s {
            // Earlier timestamps are not comparable any more.
            (self.sure_s, self.newest) = (None, None);
            self.selected_s = self.selected_s.map(|selected_s| selected_s.min(now_s));
        }
        self.now_s = now_s;
        if command == Some(OperatorCommand::Select)
            && decision.state == State::Selecting
            && decision.transition.is_some()
        {
            (self.selected_s, self.started) = (Some(now_s), false);
            (self.sure_s, self.newest) = (None, None);
        }
        if let Some(estimate) = inputs.estimate {
            self.take(&estimate);
        }
        let jumps = matches!(inputs.innovation, Innovation::Jump { position_m, .. } if position_m > 0.1);
        if jumps || !matches!(inputs.controller, Mode::Approaching | Mode::Tracking) || now_s < self.doubted_s {
            self.doubted_s = now_s;
        }
        if decision.transition.is_some_and(|to| matches!(to.event, Event::Start | Event::Resume)) {
            assert!(now_s - self.doubted_s >= GO_AFTER_S - 1e-6, "jump or hold until {} s", self.doubted_s);
        }
        if command == Some(OperatorCommand::Start)
            && decision.state == State::Approaching
            && decision.transition.is_some()
        {
            self.started = true;
            self.started_target = self.newest.map(|(_, target)| target);
        }
        let says_hold = matches!(command, Some(OperatorCommand::Hold | OperatorCommand::HoldHand));
        self.must_hold_until_command |= says_hold;
        self.both_must_rest |= command == Some(OperatorCommand::Hold);
        let goes = decision.transition.is_some_and(|to| matches!(to.event, Event::Resume | Event::Start));
        if goes {
            (self.must_hold_until_command, self.both_must_rest) = (false, false);
        }
        assert!(!self.both_must_rest || decision.no_arm_may_move, "the operator commanded a hold of both arms");
        if dangerous || command == Some(OperatorCommand::Stop) || decision.permission == Permission::Stop {
            self.started = false;
        }
        if dangerous || command == Some(OperatorCommand::Stop) {
            assert_eq!(decision.permission, Permission::Stop);
            assert!(decision.state.is_latched());
        }
        if let Permission::Move { share } = decision.permission {
            self.motions += 1;
            assert!(share > 0.0 && share <= 1.0);
            assert!(self.started, "not started since the last latch");
            assert!(!self.must_hold_until_command, "the operator commanded a hold");
            assert!(inputs.arms.iter().all(|arm| arm.state == ArmCondition::Enabled));
            for arm in inputs.arms {
                let age_s = now_s - arm.measured_at.unwrap().as_secs_f64();
                assert!((-0.2 - 1e-6..=0.05 + 1e-6).contains(&age_s), "joints are {age_s} s old");
            }
            let sure_age_s = now_s - self.sure_s.unwrap();
            assert!((-0.2 - 1e-6..=0.3 + 1e-6).contains(&sure_age_s), "the estimate is {sure_age_s} s old");
            let frame_age_s = now_s - inputs.frame.unwrap().at.as_secs_f64();
            assert!(frame_age_s <= 0.25 + 1e-6, "the images are {frame_age_s} s old");
            assert!(now_s - inputs.operator.heartbeat_at.unwrap().as_secs_f64() <= 1.0 + 1e-6);
            assert!(matches!(inputs.controller, Mode::Approaching | Mode::Tracking));
        } else {
            assert!(decision.why.to_string().contains(": "), "{}", decision.why);
        }
    }
}

/// 1000 random histories of 300 steps: the oracle agrees with every permission.
#[test]
fn no_history_permits_motion_without_fresh_confident_data_enabled_arms_and_the_operators_start() {
    let motions = Cell::new(0_u64);
    let mut runner = TestRunner::new(Config { cases: 1000, failure_persistence: None, ..Config::default() });
    let histories = prop::collection::vec(step(), 300);
    let outcome = runner.run(&histories, |history| {
        // A short time: with this many faults, conditions are rarely gone for long.
        let mut supervisor = Supervisor::new(SupervisorConfig { go_after_s: GO_AFTER_S, ..config() }).unwrap();
        let (mut executed, mut judge) =
            (Timeline { now_s: 100.0, heartbeat_s: 100.0, ..Timeline::default() }, Judge::default());
        let mut before = State::Idle;
        for step in &history {
            let inputs = executed.tell(step);
            let decision = supervisor.step(&inputs, at(executed.now_s));
            judge.judge(&inputs, &decision, executed.now_s);
            let expected = decision.transition.map_or(before, |transition| transition.to);
            prop_assert_eq!(expected, decision.state);
            if before.is_latched() && !decision.state.is_latched() {
                prop_assert_eq!(decision.state, State::Idle);
                prop_assert_eq!(step.command.map(|(command, _)| command), Some(OperatorCommand::Reset));
            }
            let begins = !before.is_moving() && decision.state.is_moving();
            if let (true, Some((_, shown))) = (begins, judge.newest) {
                prop_assert_eq!(Some(shown), judge.started_target, "not the target that was started");
            }
            before = decision.state;
        }
        motions.set(motions.get() + judge.motions);
        Ok(())
    });
    outcome.unwrap();
    assert!(motions.get() > 20_000, "only {} of 300000 steps moved: too few for a test", motions.get());
}
