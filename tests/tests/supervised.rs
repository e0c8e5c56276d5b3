//! The supervisor between the controller and the arms of a run: without permission nothing moves.
#![allow(clippy::unwrap_used, reason = "helpers of tests may fail the test")]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use pb3dp_cell::cell::SimulatedCell;
use pb3dp_cell::halves::Mover;
use pb3dp_cell::moving::{Moving, StepRecord};
use pb3dp_cell::parts::Parts;
use pb3dp_cell::percept::Percept;
use pb3dp_cell::{experiment, swing};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Hand, World};
use pb3dp_hal_api::{ArmError, ArmErrorKind, Clock, JointCommand};
use pb3dp_servo::identification::Excitation;
use pb3dp_servo::supervisor::{
    ArmCondition, Condition, Confidence, EstimateInput, FrameInput, Permission, Resume, State,
};
use pb3dp_servo::{Mode, SearchConfig, TargetObservation};
use pb3dp_setup::setup::{Carrier, Leader, Pace, Setup, read_setup};
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, StepExperimentConfig, Trajectory};
use pb3dp_wiring::{Wired, wire, wire_at_rest, wire_watched};
use system_tests::between::Between;
use system_tests::repository;

/// A joint slower than this is stationary, rad/s: one count of the resolver in one cycle is 0.8 mrad/s.
const AT_REST_RAD_PER_S: f64 = 1e-3;

/// Some replies of the arm with the cameras are lost, by the number of the exchange; the arm holds meanwhile.
fn with_losses(parts: Parts, is_lost: impl Fn(usize) -> bool + Send + 'static) -> Parts {
    let mut exchanges = 0;
    let vs = Between::boxed(parts.vs, move |arm, command| {
        exchanges += 1;
        if is_lost(exchanges) {
            arm.exchange(JointCommand::Hold)?;
            return Err(ArmError::new(ArmErrorKind::Timeout, "the test has taken the reply"));
        }
        arm.exchange(command)
    });
    Parts { vs, ..parts }
}

fn setup() -> Setup {
    let mut setup = read_setup(&repository().join("configs/sim.toml")).unwrap();
    setup.compared.clear();
    setup
}

/// The arms of a run, and cameras that can be covered.
struct Bench<'a> {
    moving: Moving<'a>,
    clock: Arc<dyn Clock>,
    cell: SimulatedCell,
    setup: &'a Setup,
    steps: u64,
    /// Observations of the cameras; none while they are covered.
    target: Option<u64>,
    confidence: Confidence,
    /// The fastest joint of the hand's arm since it was asked for.
    fastest_rad_per_s: f64,
}

impl<'a> Bench<'a> {
    /// A hand that tracks the target on its first path.
    fn following(setup: &'a Setup, parts: Parts, experiment: &'a dyn Trajectory) -> Self {
        let Parts { clock, vs, tc, cell, .. } = parts;
        let mut moving = Moving::new(setup, (vs, tc), experiment, clock.now()).unwrap();
        assert!(moving.enable().unwrap());
        let confidence = Confidence::Sure;
        let mut bench =
            Bench { moving, clock, cell, setup, steps: 0, target: Some(1), confidence, fastest_rad_per_s: 0.0 };
        let moved = bench.run(4.0);
        assert_eq!(moved.decision.state, State::Tracking, "{}", moved.decision.why);
        assert!(bench.fastest_rad_per_s > 0.05, "the target moves, and the hand with it");
        bench
    }

    fn step(&mut self) -> StepRecord {
        let now = self.clock.now() + self.setup.control_period;
        self.clock.sleep_until(now);
        self.steps += 1;
        if let Some(target) = self.target
            && self.steps.is_multiple_of(3)
        {
            let cam_left_from_target =
                self.cell.world_from_cam_left_at(now).inverse() * self.cell.world_from_target_at(now);
            let observation = TargetObservation {
                at: now,
                cam_left_from_model: cam_left_from_target.relabel(),
                trusted: true,
                covariance: None,
                observed: [true; 6],
            };
            let percept = Percept {
                frame: FrameInput { sequence: self.steps, at: now, skew_s: 0.0 },
                estimate: EstimateInput { at: now, confidence: self.confidence, covariance: None, target },
                observation: (self.confidence != Confidence::NoPose).then_some(observation),
                surface_from_model: None,
            };
            self.moving.observe(percept, now);
        }
        let moved = self.moving.step(now).unwrap();
        self.fastest_rad_per_s = self.fastest_rad_per_s.max(moved.vs_joints.velocity_rad_per_s.amax());
        moved
    }

    fn run(&mut self, seconds: f64) -> StepRecord {
        let steps = (seconds / self.setup.control_period.as_secs_f64()).round() as usize;
        (0..steps).map(|_| self.step()).last().unwrap()
    }

    /// Runs; the hand's arm must not move.
    fn rests_for(&mut self, seconds: f64) -> StepRecord {
        self.fastest_rad_per_s = 0.0;
        let moved = self.run(seconds);
        assert!(self.fastest_rad_per_s < AT_REST_RAD_PER_S, "{} rad/s: {}", self.fastest_rad_per_s, moved.decision.why);
        moved
    }
}

#[test]
fn a_hand_whose_eyes_are_shut_rests_and_goes_on_from_where_it_is() {
    let setup = setup();
    let parts = wire(&setup).unwrap();
    let experiment = parts.experiment.clone();
    let mut bench = Bench::following(&setup, parts, &*experiment);
    bench.target = None;
    // Stale after 0.25 s, stationary at most 0.3 s later: 0.6 rad/s at 2 rad/s^2.
    let moved = bench.run(0.6);
    assert_eq!(moved.decision.permission, Permission::Hold);
    let moved = bench.rests_for(1.0);
    assert_eq!(moved.decision.state, State::Lost);
    let line = moved.decision.why.to_string();
    assert!(line.starts_with("lost: the newest frame pair is 1.") && line.contains("0.250 s"), "{line}");
    let rested = moved.vs_joints;
    bench.target = Some(1);
    bench.rests_for(0.2);
    let mut first = None;
    for _ in 0..100 {
        let moved = bench.step();
        if moved.decision.state.is_moving() && first.is_none() {
            first = Some(moved);
        }
    }
    let first = first.unwrap();
    let moved_by = (first.vs_joints.position_rad - rested.position_rad).amax();
    assert!(moved_by < 0.01, "the first command is at the arm's position: {moved_by} rad");
    assert!(first.vs_joints.velocity_rad_per_s.amax() < AT_REST_RAD_PER_S, "it starts from standstill");
    assert_eq!(bench.run(2.0).decision.state, State::Tracking);
}

#[test]
fn a_target_that_the_estimator_took_anew_is_not_followed() {
    let setup = setup();
    let parts = wire(&setup).unwrap();
    let experiment = parts.experiment.clone();
    let mut bench = Bench::following(&setup, parts, &*experiment);
    bench.target = Some(2);
    let moved = bench.run(0.5);
    assert_eq!((moved.decision.state, moved.decision.permission), (State::Holding, Permission::Hold));
    let line = moved.decision.why.to_string();
    assert!(
        line.contains("target 2") && line.contains("target 1") && line.contains("use resume [PB3DP-SUP-"),
        "{line}"
    );
    bench.target = Some(1);
    let moved = bench.rests_for(3.0);
    assert_eq!(moved.decision.state, State::Holding, "no command to resume was given");
}

#[test]
fn a_loss_waits_for_the_operator_if_the_policy_says_so() {
    let mut setup = setup();
    setup.supervisor.policies.get_mut(Condition::TargetLost).resume = Resume::ByOperator;
    let parts = wire(&setup).unwrap();
    let experiment = parts.experiment.clone();
    let mut bench = Bench::following(&setup, parts, &*experiment);
    bench.confidence = Confidence::Doubtful;
    bench.run(1.5);
    bench.confidence = Confidence::Sure;
    let moved = bench.rests_for(3.0);
    assert_eq!(moved.decision.state, State::Lost);
    assert!(moved.decision.is_ready, "{}", moved.decision.why);
}

/// Back by 30 mm, a spiral of 20 mm, at 20 mm/s.
const SEARCH: SearchConfig =
    SearchConfig { back_m: 0.03, radius_m: 0.02, turns: 2.0, speed_m_per_s: 0.02, time_s: 30.0 };

/// A hand whose target is lost while images continue: its distance from the position of its hold, and its speed, for this time.
fn hand_after_loss(bench: &mut Bench<'_>, begin: Pose<World, Hand>, until_s: f64) -> (f64, f64, StepRecord) {
    let at = |bench: &Bench<'_>| bench.cell.world_from_hand_at(bench.clock.now());
    let (mut before, mut farthest_m, mut fastest_m_per_s, mut last) = (at(bench), 0.0f64, 0.0f64, None);
    for _ in 0..(until_s / bench.setup.control_period.as_secs_f64()) as usize {
        last = Some(bench.step());
        let now = at(bench);
        farthest_m = farthest_m.max((now.translation_m() - begin.translation_m()).norm());
        let way_m = (now.translation_m() - before.translation_m()).norm();
        fastest_m_per_s = fastest_m_per_s.max(way_m / bench.setup.control_period.as_secs_f64());
        before = now;
    }
    (farthest_m, fastest_m_per_s, last.unwrap())
}

/// Tracks, loses its target, and holds.
fn lost<'a>(setup: &'a Setup, parts: Parts, experiment: &'a dyn Trajectory) -> Bench<'a> {
    let mut bench = Bench::following(setup, parts, experiment);
    bench.confidence = Confidence::NoPose;
    let moved = bench.run(0.99);
    assert_eq!(moved.decision.permission, Permission::Hold, "{}", moved.decision.why);
    bench
}

#[test]
fn a_search_for_a_lost_target_is_off_unless_pattern_and_policy_ask_for_it() {
    for (pattern, search_max_s) in [(None, 0.0), (Some(SEARCH), 0.0), (None, 30.0)] {
        let mut setup = setup();
        (setup.controller.search, setup.supervisor.search_max_s) = (pattern, search_max_s);
        let parts = wire(&setup).unwrap();
        let experiment = parts.experiment.clone();
        let moved = lost(&setup, parts, &*experiment).rests_for(3.0);
        assert_eq!((moved.decision.state, moved.decision.permission), (State::Lost, Permission::Hold));
    }
}

#[test]
fn a_search_keeps_its_bounds_and_ends_where_it_began() {
    let mut setup = setup();
    (setup.controller.search, setup.supervisor.search_max_s) = (Some(SEARCH), 30.0);
    let parts = wire(&setup).unwrap();
    let experiment = parts.experiment.clone();
    let mut bench = lost(&setup, parts, &*experiment);
    let begin = bench.cell.world_from_hand_at(bench.clock.now());
    let (farthest_m, fastest_m_per_s, moved) = hand_after_loss(&mut bench, begin, 4.0);
    assert!(farthest_m > 0.02, "it searches: {farthest_m}");
    assert_eq!((moved.decision.state, moved.mode), (State::Lost, Mode::Searching));
    assert!(moved.decision.why.to_string().starts_with("lost: the hand searches for the target"));
    let (farthest_later_m, fastest_later_m_per_s, _) = hand_after_loss(&mut bench, begin, 16.0);
    // Plus the lag of the arm.
    assert!(farthest_m.max(farthest_later_m) < 1.1 * SEARCH.reach_m(), "{farthest_m} {farthest_later_m}");
    assert!(
        fastest_m_per_s.max(fastest_later_m_per_s) < 1.2 * SEARCH.speed_m_per_s,
        "{fastest_m_per_s} {fastest_later_m_per_s}"
    );
    let off = begin.inverse() * bench.cell.world_from_hand_at(bench.clock.now());
    assert!(off.translation_m().norm() < 0.002 && off.rotation().angle() < 0.002, "{off:?}");
    let moved = bench.rests_for(2.0);
    assert_eq!((moved.decision.state, moved.decision.permission), (State::Lost, Permission::Hold), "once per loss");
}

#[test]
fn a_search_ends_when_the_target_is_found_and_when_anything_else_is_wrong() {
    let mut setup = setup();
    (setup.controller.search, setup.supervisor.search_max_s) = (Some(SEARCH), 3.0);
    let parts = wire(&setup).unwrap();
    let experiment = parts.experiment.clone();
    let mut bench = lost(&setup, parts, &*experiment);
    assert_eq!(bench.run(1.0).mode, Mode::Searching);
    // Without images there is no search.
    let (cameras, confidence) = (bench.target.take(), bench.confidence);
    bench.run(0.6);
    assert_eq!(bench.rests_for(0.5).decision.permission, Permission::Hold);
    (bench.target, bench.confidence) = (cameras, confidence);
    assert_eq!(bench.rests_for(3.0).decision.state, State::Lost, "an aborted search does not start again");
    bench.confidence = Confidence::Sure;
    assert_eq!(bench.run(3.0).decision.state, State::Tracking, "found, and the policy resumes");
    bench.confidence = Confidence::NoPose;
    assert_eq!(bench.run(2.0).mode, Mode::Searching, "the next loss has a search of its own");
    bench.confidence = Confidence::Sure;
    let moved = bench.run(0.1);
    assert!(moved.mode != Mode::Searching && moved.decision.permission == Permission::Hold, "{}", moved.decision.why);
}

#[test]
fn nothing_moves_before_the_target_was_observed() {
    let setup = setup();
    let Parts { clock, vs, tc, cell, experiment, .. } = wire(&setup).unwrap();
    let mut moving = Moving::new(&setup, (vs, tc), &*experiment, clock.now()).unwrap();
    assert!(moving.enable().unwrap());
    let mut bench = Bench {
        moving,
        clock,
        cell,
        setup: &setup,
        steps: 0,
        target: Some(1),
        confidence: Confidence::Doubtful,
        fastest_rad_per_s: 0.0,
    };
    let moved = bench.rests_for(4.0);
    assert_eq!(moved.decision.state, State::Selecting);
    let line = moved.decision.why.to_string();
    assert!(line.contains("no confident pose yet") && line.contains("then use start [PB3DP-SUP-"), "{line}");
}

/// A stop of the supervisor ends the run with its reason; both arms hold afterwards.
#[test]
fn a_stop_by_a_policy_ends_the_run_with_its_reason() {
    let mut setup = setup();
    setup.supervisor.policies.get_mut(Condition::TargetLost).action = pb3dp_servo::supervisor::Action::Stop;
    let parts = wire(&setup).unwrap();
    let experiment = parts.experiment.clone();
    let mut bench = Bench::following(&setup, parts, &*experiment);
    bench.target = None;
    let mut refused = None;
    for _ in 0..200 {
        let now = bench.clock.now() + setup.control_period;
        bench.clock.sleep_until(now);
        if let Err(error) = bench.moving.step(now) {
            refused = Some(error.to_string());
            break;
        }
    }
    let line = refused.unwrap();
    assert!(line.starts_with("stopped: target lost") && line.contains("then start a new run [PB3DP-SUP-"), "{line}");
    bench.moving.stop().unwrap();
}

/// All arms wait for data that all arms need: here one arm does not answer for half a second.
#[test]
fn an_arm_that_does_not_answer_holds_the_other_one_too_and_its_way_waits() {
    let setup = setup();
    let parts = wire(&setup).unwrap();
    let experiment = parts.experiment.clone();
    let is_mute = Arc::new(AtomicBool::new(false));
    let is_silent = Arc::clone(&is_mute);
    let parts = with_losses(parts, move |_| is_silent.load(Ordering::SeqCst));
    let mut bench = Bench::following(&setup, parts, &*experiment);
    let tc = |bench: &Bench<'_>| bench.cell.tc.joints.simulated().unwrap().lock().unwrap().state();
    let before = tc(&bench);
    let fastest = before.velocity_rad_per_s.amax();
    assert!(fastest > 0.02, "the target moves: {fastest} rad/s");
    is_mute.store(true, Ordering::SeqCst);
    let moved = bench.run(0.5);
    assert!(moved.decision.no_arm_may_move && moved.decision.found.contains(Condition::JointsStale));
    let rested = tc(&bench);
    assert!(rested.velocity_rad_per_s.amax() < AT_REST_RAD_PER_S, "{rested:?}");
    is_mute.store(false, Ordering::SeqCst);
    assert!(bench.step().decision.no_arm_may_move, "the next step uses the new answer");
    let (mut before, mut fastest_again) = (rested, 0.0_f64);
    for _ in 0..150 {
        assert!(!bench.step().decision.no_arm_may_move);
        let now = tc(&bench);
        // As fast as before, minus the loss by the hold, which recovers at 2 per second; without a jump.
        assert!(now.velocity_rad_per_s.amax() < 1.3 * fastest.max(0.05), "{now:?}");
        assert!((now.velocity_rad_per_s - before.velocity_rad_per_s).amax() < 0.06, "{now:?} after {before:?}");
        before = now;
        fastest_again = fastest_again.max(now.velocity_rad_per_s.amax());
    }
    assert!(fastest_again > 0.5 * fastest, "it resumes: {fastest_again} rad/s after {fastest}");
}

/// A target that jumps is not tracked there before the operator's command.
#[test]
fn a_target_that_jumps_is_not_followed_by_itself() {
    for (channel, translation_m, rotation_rad) in
        [(Channel::X, 0.05, 0.1), (Channel::Y, -0.15, 0.1), (Channel::Z, 0.12, 0.1), (Channel::Rx, 0.1, 0.26)]
    {
        let mut setup = setup();
        setup.leader = Leader::Geometric(setup.geometric.unwrap());
        setup.experiment.carrier = Carrier::Nothing;
        setup.experiment.motion = MotionConfig::Steps(StepExperimentConfig {
            channels: vec![channel],
            translation_m,
            rotation_rad,
            move_s: 0.0,
            hold_s: 3.0,
            lead_in_s: 3.0,
            axes: ExperimentAxes::TargetAtStart,
        });
        for condition in [Condition::Outlier, Condition::PositionJump, Condition::OrientationJump] {
            setup.supervisor.policies.get_mut(condition).resume = Resume::ByOperator;
        }
        let log = experiment::run(&setup, wire(&setup).unwrap(), Some(5.9), None).unwrap().log;
        let place = |t_s: f64| log.control.iter().find(|sample| sample.t_s >= t_s).unwrap();
        assert_eq!(place(2.9).mode, "tracking");
        let way = place(2.9).world_from_hand.inverse() * place(5.8).world_from_hand;
        let (way_m, way_rad) = (way.translation_m().norm(), way.rotation().angle());
        assert!(way_m < 0.004 && way_rad < 0.01, "{channel:?}: the hand went {way_m} m, {way_rad} rad");
        let last = log.supervision.summary().transitions.pop().unwrap();
        assert_eq!((last.to, last.event), ("holding", "hold-found"), "{channel:?}: {last:?}");
        assert!(last.t_s < 3.3 && last.why.contains("then start a new run"), "{last:?}");
    }
}

/// An arm whose reply is lost holds, and its recorded motion shows that.
#[test]
fn a_swing_whose_replies_get_lost_knows_that_the_arm_held() {
    let mut setup = setup();
    setup.leader = Leader::Geometric(setup.geometric.unwrap());
    let motion = Excitation::new(0.003, 8.0).unwrap();
    let parts = wire_at_rest(&setup, swing::duration(&motion)).unwrap().parts;
    let swung = swing::run(&setup, with_losses(parts, |exchange| exchange.is_multiple_of(70)), motion).unwrap();
    let held = swung.given.iter().skip(110).take(700).filter(|given| given.velocity_rad_per_s.amax() == 0.0).count();
    assert_eq!(held, 700 / 70, "each lost reply is a held cycle");
}

/// Brakes take seconds to open, and those of one arm open before those of the other: a joint that runs away in that time is
/// detected within some hundredths of a second, and both arms stop.
#[test]
fn a_joint_that_runs_away_while_both_arms_are_switched_on_stops_both() {
    let mut setup = read_setup(&repository().join("configs/hil.toml")).unwrap();
    setup.pace = Pace::Fast;
    let Wired { parts, world, .. } = wire_watched(&setup).unwrap();
    let experiment = parts.experiment.clone();
    let Parts { clock, vs, tc, cell, .. } = parts;
    let mut moving = Moving::new(&setup, (vs, tc), &*experiment, clock.now()).unwrap();
    // Behind closed brakes it moves nothing.
    world.arms[0].end.command_line("runaway 2 1.2rad/s").unwrap();
    let failure = loop {
        clock.sleep_until(clock.now() + setup.control_period);
        match moving.enable() {
            Ok(are_on) => assert!(!are_on, "both arms are on, and a joint has run away"),
            Err(failure) => break format!("{failure:#}"),
        }
    };
    assert!(failure.contains("vs-robot") && failure.contains("axis 2"), "{failure}");
    let conditions = [moving.arms().vs.condition(), moving.arms().tc.condition()];
    assert_eq!(conditions, [ArmCondition::Fault, ArmCondition::StoppedByOther], "{failure}");
    moving.stop().unwrap();
    let went_rad =
        cell.vs.joints.simulated().unwrap().lock().unwrap().state().position_rad - setup.rig.arms.vs.start_rad;
    assert!((0.02..0.15).contains(&went_rad.amax()), "{went_rad}");
    assert!(world.arms.iter().all(|arm| arm.end.look(|far| far.controller.is_braked())));
}
