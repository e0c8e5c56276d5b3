//! Ways to start or resume wrongly, with the whole program in virtual time: docs/start-and-resume.md lists them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests may fail the test")]

mod enabling;
mod flight_records;

use std::sync::{Arc, Mutex};
use std::task::Poll;

use pb3dp_cell::experiment::{Ended, conduct};
use pb3dp_cell::operator::Operator;
use pb3dp_cell::parts::{ArmControl, Parts};
use pb3dp_cell::report::{self, Made};
use pb3dp_cell::supervision::TransitionNote;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{
    Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, EnablePosition, JointCommand, JointState,
    PowerOrder,
};
use pb3dp_hal_middleware::{FlightLog, LimiterStatistics, RecordedRequest};
use pb3dp_kinematics::JointVector;
use pb3dp_servo::supervisor::{Decision, OperatorCommand, OperatorInput, OperatorRequest};
use pb3dp_setup::setup::{Leader, Setup, read_setup};
use pb3dp_wiring::wire;
use system_tests::repository;

/// Both arms move at least this fast when they are stopped, rad/s.
const MOVING_RAD_PER_S: f64 = 0.02;

/// A joint slower than this is stationary, rad/s.
const AT_REST_RAD_PER_S: f64 = 1e-3;

/// A setup without images; its arm carries the target along its first path from 2.1 s to 4.1 s if it is started at 0.6 s.
fn setup() -> Setup {
    let mut setup = read_setup(&repository().join("configs/sim.toml")).unwrap();
    setup.compared.clear();
    setup.leader = Leader::Geometric(setup.geometric.unwrap());
    setup.experiment.steps_mut().unwrap().lead_in_s = 1.5;
    setup
}

/// An operator who gives these commands at these times (seconds), with a heartbeat until he falls silent.
struct Person {
    commands: Vec<(f64, OperatorCommand)>,
    silent: (f64, f64),
    resets_late_s: f64,
    troubles: Arc<Mutex<Vec<String>>>,
}

impl Operator for Person {
    fn listen(&mut self, _last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let now_s = now.seconds_since(MonotonicTime::ZERO);
        let is_due = self.commands.first().is_some_and(|(at_s, _)| *at_s <= now_s);
        let request = is_due.then(|| self.commands.remove(0).1).map(|command| match command {
            OperatorCommand::Reset => {
                OperatorRequest { command, at: MonotonicTime::from_secs_f64(now_s - self.resets_late_s) }
            }
            _ => OperatorRequest { command, at: now },
        });
        let (from_s, until_s) = self.silent;
        let heartbeat_s = if (from_s..until_s).contains(&now_s) { from_s } else { now_s };
        OperatorInput { request, heartbeat_at: Some(MonotonicTime::from_secs_f64(heartbeat_s)), silent_after: None }
    }

    fn show(&mut self, decision: &Decision) {
        self.troubles.lock().unwrap().extend(decision.refused.map(|refused| refused.to_string()));
    }

    fn tell(&mut self, trouble: Option<String>) {
        self.troubles.lock().unwrap().extend(trouble);
    }

    fn answer(&mut self, result: String) {
        self.troubles.lock().unwrap().push(result);
    }

    fn is_person(&self) -> bool {
        true
    }

    fn can_fall_silent(&self) -> bool {
        true
    }
}

/// Commands of an arm with its positions at that time; times of its resets and stops.
#[derive(Default)]
struct Noted {
    troubles: Vec<(f64, JointCommand, Option<JointState>)>,
    resets_s: Vec<f64>,
    stops_s: Vec<f64>,
}

/// An arm with an emergency stop, which is pressed during a period, and latches even if that is short.
struct Stoppable {
    inner: Box<dyn ArmControl>,
    clock: Arc<dyn Clock>,
    pressed: Vec<(f64, f64)>,
    /// Time up to which a reset clears the pressed stops.
    cleared_s: f64,
    /// This many stops do not reach the arm.
    stops_failing: usize,
    /// Period in which velocities are refused.
    refuses: (f64, f64),
    /// Before this time, seconds, the drives are not enabled again after a stop.
    enables_again_s: f64,
    noted: Arc<Mutex<Noted>>,
}

impl Stoppable {
    fn new(inner: Box<dyn ArmControl>, clock: &Arc<dyn Clock>, pressed: &[(f64, f64)]) -> Self {
        let (clock, pressed) = (Arc::clone(clock), pressed.to_vec());
        Self {
            inner,
            clock,
            pressed,
            cleared_s: 0.0,
            stops_failing: 0,
            refuses: (0.0, 0.0),
            enables_again_s: 0.0,
            noted: Arc::default(),
        }
    }

    fn now_s(&self) -> f64 {
        self.clock.now().seconds_since(MonotonicTime::ZERO)
    }

    fn is_pressed(&self) -> bool {
        self.pressed.iter().any(|(from_s, until_s)| (*from_s..*until_s).contains(&self.now_s()))
    }

    fn is_latched(&self) -> bool {
        self.pressed.iter().any(|(from_s, until_s)| *from_s <= self.now_s() && self.cleared_s < *until_s)
    }

    fn refusal(&self) -> ArmError {
        ArmError::new(ArmErrorKind::Fault, "the emergency stop of the test")
    }
}

impl Arm for Stoppable {
    fn info(&self) -> &ArmInfo {
        self.inner.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let is_latched = self.is_latched();
        let is_refused = (self.refuses.0..self.refuses.1).contains(&self.now_s()) && command != JointCommand::Hold;
        let measured = self.inner.exchange(if is_latched || is_refused { JointCommand::Hold } else { command });
        self.noted.lock().unwrap().troubles.push((self.now_s(), command, measured.as_ref().ok().copied()));
        if is_refused {
            return Err(ArmError::new(ArmErrorKind::Rejected, "too little room, says the test"));
        }
        if is_latched && command != JointCommand::Hold { Err(self.refusal()) } else { measured }
    }
}

impl ArmPower for Stoppable {
    fn state(&self) -> ArmState {
        if self.is_latched() { ArmState::EStop } else { self.inner.state() }
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        match order {
            PowerOrder::Enable(EnablePosition::Here) | PowerOrder::BeginEnable(EnablePosition::Here)
                if self.now_s() < self.enables_again_s =>
            {
                return Err(ArmError::new(ArmErrorKind::Timeout, "the drives do not answer, says the test"));
            }
            PowerOrder::Enable(_) | PowerOrder::BeginEnable(_) if self.is_latched() => return Err(self.refusal()),
            PowerOrder::Stop => {
                self.noted.lock().unwrap().stops_s.push(self.now_s());
                if self.stops_failing > 0 {
                    self.stops_failing -= 1;
                    return Err(ArmError::new(ArmErrorKind::Timeout, "the stop was not heard"));
                }
            }
            PowerOrder::Reset if self.is_pressed() => return Err(self.refusal()),
            PowerOrder::Reset => {
                self.cleared_s = self.now_s();
                self.noted.lock().unwrap().resets_s.push(self.now_s());
            }
            _ => {}
        }
        self.inner.power(order)
    }

    fn is_stopped_by_other(&self) -> bool {
        self.inner.is_stopped_by_other()
    }
}

impl ArmControl for Stoppable {
    fn statistics(&self) -> LimiterStatistics {
        self.inner.statistics()
    }
}

/// The plan of a run.
#[derive(Clone, Default)]
struct Scene {
    /// Commands at these times, seconds.
    commands: Vec<(f64, OperatorCommand)>,
    /// The emergency stop of the hand's arm, seconds.
    pressed: Vec<(f64, f64)>,
    /// When the operator's heartbeat ends, seconds.
    silent: (f64, f64),
    /// Delay from a reset to its arrival.
    resets_late_s: f64,
    /// This many stops do not reach the arm with the target.
    tc_stops_failing: usize,
    /// Periods in which the hand's arm, and the one with the target, refuse velocities, seconds.
    refuse: [(f64, f64); 2],
    /// When the arm with the target can be enabled again, seconds.
    tc_enables_again_s: f64,
}

/// A finished run, with its records: by arm, the one with the cameras first.
struct RunResult {
    setup: Setup,
    ended: Ended,
    noted: [Arc<Mutex<Noted>>; 2],
    /// Contents of the innermost recorders: the last 5 s.
    flights: [FlightLog; 2],
    trouble: Vec<String>,
}

const NAMES: [&str; 2] = ["vs-robot", "tc-robot"];

impl Scene {
    fn run(self, until_s: f64) -> RunResult {
        let setup = setup();
        let parts = wire(&setup).unwrap();
        let trouble = Arc::<Mutex<Vec<String>>>::default();
        let Self { commands, pressed, silent, resets_late_s, tc_stops_failing, refuse, tc_enables_again_s } = self;
        let operator = Box::new(Person { commands, silent, resets_late_s, troubles: Arc::clone(&trouble) });
        let flights = parts.flights.clone().map(|(_, flight)| flight);
        let vs = Stoppable { refuses: refuse[0], ..Stoppable::new(parts.vs, &parts.clock, &pressed) };
        let tc = Stoppable::new(parts.tc, &parts.clock, &[]);
        let tc = Stoppable {
            stops_failing: tc_stops_failing,
            refuses: refuse[1],
            enables_again_s: tc_enables_again_s,
            ..tc
        };
        let noted = [Arc::clone(&vs.noted), Arc::clone(&tc.noted)];
        let parts = Parts { vs: Box::new(vs), tc: Box::new(tc), operator, ..parts };
        let ended = conduct(&setup, parts, Some(until_s), None).unwrap();
        let trouble = trouble.lock().unwrap().clone();
        RunResult { setup, ended, noted, flights, trouble }
    }
}

impl RunResult {
    fn transitions(&self) -> Vec<TransitionNote> {
        self.ended.outcome.log.supervision.summary().transitions
    }

    /// Times of this event, seconds.
    fn times_of(&self, event: &str) -> Vec<f64> {
        self.transitions().iter().filter(|note| note.event == event).map(|note| note.t_s).collect()
    }

    /// Neither arm gets a motion command in this time, nor moves.
    fn rests(&self, from_s: f64, until_s: f64) {
        for (noted, name) in self.noted.iter().zip(NAMES) {
            let noted = noted.lock().unwrap();
            let inside: Vec<_> = noted.troubles.iter().filter(|(at_s, ..)| (from_s..until_s).contains(at_s)).collect();
            assert!(!inside.is_empty(), "{name} has samples");
            for (at_s, command, measured) in inside {
                let is_rest = match command {
                    JointCommand::Hold => true,
                    // A latched arm gets such a command so that it reports why it is latched.
                    JointCommand::Velocity(velocity) => velocity.amax() == 0.0,
                };
                assert!(is_rest, "{name} gets a motion command at {at_s} s: {command:?}");
                let speed = measured.map_or(0.0, |joints| joints.velocity_rad_per_s.amax());
                assert!(speed < AT_REST_RAD_PER_S, "{name} moves at {at_s} s: {speed} rad/s");
            }
        }
    }

    /// These arms (0: with the cameras, 1: with the target) move until then, and are stationary this many seconds later.
    fn braking_s(&self, stopped_s: f64, arms: &[usize]) -> f64 {
        let braking_s = arms.iter().map(|&arm| {
            let noted = self.noted[arm].lock().unwrap();
            let before = noted.troubles.iter().rev().filter(|(at_s, ..)| *at_s < stopped_s - 1e-6);
            let joints = before.filter_map(|(.., measured)| *measured).next().unwrap();
            let speed = joints.velocity_rad_per_s.amax();
            assert!(speed > MOVING_RAD_PER_S, "{} has {speed} rad/s at {stopped_s} s", NAMES[arm]);
            let setup = [&self.setup.rig.arms.vs, &self.setup.rig.arms.tc][arm];
            let lag_s = setup.plant.velocity_time_constant.as_secs_f64();
            // Constant deceleration, then the lag of the drive.
            let most = setup.limits.acceleration_max_rad_per_s2();
            let of_joint = joints.velocity_rad_per_s.zip_map(most, |velocity, most| {
                velocity.abs() / most + lag_s * (most * lag_s / AT_REST_RAD_PER_S).ln().max(0.0)
            });
            of_joint.amax() + setup.plant.command_delay.as_secs_f64()
        });
        braking_s.fold(0.0, f64::max) + self.setup.control_period.as_secs_f64()
    }

    /// Both arms move until they are stopped, stop within their braking time and one cycle, and do not move until then.
    fn stops(&self, stopped_s: f64, until_s: f64) {
        self.rests(stopped_s + self.braking_s(stopped_s, &[0, 1]), until_s);
    }

    /// From this time on the commands of these arms start at their position and from standstill, and change in no cycle by
    /// more than one cycle of acceleration.
    fn begins_where_it_is(&self, from_s: f64, arms: &[usize]) {
        for &arm in arms {
            let name = NAMES[arm];
            let exchanges: Vec<_> = self.flights[arm]
                .entries()
                .into_iter()
                .filter_map(|entry| match (entry.asked, entry.answer) {
                    (RecordedRequest::Exchange(command), Ok(Some(joints))) => {
                        Some((entry.at.seconds_since(MonotonicTime::ZERO), command, joints))
                    }
                    _ => None,
                })
                .collect();
            assert!(exchanges[0].0 < from_s, "{name}: the recorder still holds {from_s} s");
            let sent = |command: JointCommand| match command {
                JointCommand::Velocity(velocity) => velocity,
                JointCommand::Hold => JointVector::zeros(),
            };
            let is_first =
                |(at_s, command, _): &(f64, JointCommand, JointState)| *at_s >= from_s && sent(*command).amax() > 0.0;
            let first = exchanges.iter().position(is_first);
            let first = first.unwrap_or_else(|| panic!("{name} stays: {:?} {:?}", self.transitions(), self.trouble));
            let (before, begun) = (exchanges[first - 1].2, exchanges[first].2);
            let speed = begun.velocity_rad_per_s.amax();
            assert!(speed < AT_REST_RAD_PER_S, "{name} starts from standstill: {speed} rad/s");
            let jump_rad = (begun.position_rad - before.position_rad).amax();
            assert!(jump_rad < AT_REST_RAD_PER_S, "{name} has not moved: {jump_rad} rad");
            let most = [&self.setup.rig.arms.vs, &self.setup.rig.arms.tc][arm].limits.acceleration_max_rad_per_s2()
                * (self.setup.control_period.as_secs_f64() * 1.001);
            for pair in exchanges[first - 1..].windows(2).take(50) {
                let change = (sent(pair[1].1) - sent(pair[0].1)).abs();
                assert!(change.zip_map(&most, |change, most| change - most).max() <= 0.0, "{name}: {pair:?}");
            }
        }
    }

    fn ends_following(&self) {
        assert!(self.ended.how.is_ok(), "{:?}", self.ended.how);
        let last = self.transitions().pop().unwrap();
        assert!(["approaching", "tracking"].contains(&last.to), "{last:?}");
    }

    fn ends_in(&self, state: &str) {
        let transitions = self.transitions();
        assert_eq!(transitions.last().unwrap().to, state, "{transitions:?} {:?}", self.trouble);
    }
}

const BEGIN: [(f64, OperatorCommand); 2] = [(0.1, OperatorCommand::Select), (0.6, OperatorCommand::Start)];

/// Starts a run and gives these commands; the emergency stop of the hand's arm is pressed in these periods.
fn scene(more: &[(f64, OperatorCommand)], pressed: &[(f64, f64)]) -> Scene {
    let commands = BEGIN.iter().chain(more).copied().collect();
    Scene { commands, pressed: pressed.to_vec(), ..Scene::default() }
}

#[test]
fn where_a_person_leads_nothing_moves_before_the_command() {
    for commands in [
        vec![],
        vec![(0.1, OperatorCommand::Select)],
        vec![(0.1, OperatorCommand::Start), (0.2, OperatorCommand::Resume), (0.3, OperatorCommand::Reset)],
    ] {
        let is_selected = commands.contains(&(0.1, OperatorCommand::Select));
        let run = Scene { commands, ..Scene::default() }.run(4.0);
        run.rests(0.0, 4.0);
        assert_eq!(run.transitions().len(), usize::from(is_selected), "{:?}", run.transitions());
    }
}

#[test]
fn a_person_selects_starts_holds_and_resumes() {
    let run = scene(&[], &[]).run(4.0);
    run.begins_where_it_is(0.5, &[0, 1]);
    let run = scene(&[(3.0, OperatorCommand::Hold), (5.0, OperatorCommand::Resume)], &[]).run(8.0);
    let transitions = run.transitions();
    let names: Vec<&str> = transitions.iter().map(|note| note.event).filter(|event| *event != "left").collect();
    assert_eq!(names[..2], ["select", "start"]);
    assert!(names.contains(&"hold") && names.contains(&"resume"), "{names:?}");
    run.stops(3.0, 5.0);
    run.begins_where_it_is(4.9, &[0, 1]);
    run.ends_following();
}

#[test]
fn hold_hand_lets_the_arm_with_the_target_move_on() {
    let run = scene(&[(3.0, OperatorCommand::HoldHand)], &[]).run(4.0);
    let rested_s = 3.0 + run.braking_s(3.0, &[0]);
    let [vs, tc] = [0, 1].map(|arm| run.noted[arm].lock().unwrap());
    assert!(
        vs.troubles.iter().filter(|(at_s, ..)| *at_s > rested_s).all(|(_, command, _)| *command == JointCommand::Hold)
    );
    let mut moving = tc.troubles.iter().filter(|(at_s, ..)| (2.2..3.9).contains(at_s));
    assert!(moving.all(|(_, command, _)| matches!(command, JointCommand::Velocity(_))));
    drop((vs, tc));
    run.ends_in("holding");
}

#[test]
fn a_reset_is_refused_while_the_emergency_stop_is_pressed_and_leads_on_behind_it() {
    let more = [
        (3.5, OperatorCommand::Reset),
        (4.5, OperatorCommand::Reset),
        (5.0, OperatorCommand::Select),
        (6.0, OperatorCommand::Start),
    ];
    let run = scene(&more, &[(3.0, 4.0)]).run(9.0);
    assert!((run.times_of("fault-found")[0] - 3.0).abs() < 0.03, "{:?}", run.transitions());
    let [reset_s] = run.times_of("reset")[..] else { panic!("one reset is obeyed: {:?}", run.transitions()) };
    assert!((reset_s - 4.5).abs() < 0.03, "{reset_s}");
    assert!(run.trouble.iter().any(|trouble| trouble.contains("vs-robot: reset")), "{:?}", run.trouble);
    run.stops(3.0, 6.0);
    run.begins_where_it_is(5.9, &[0, 1]);
    run.ends_following();
}

#[test]
fn a_released_emergency_stop_starts_nothing_by_itself() {
    let run = scene(&[], &[(3.0, 4.0)]).run(8.0);
    run.stops(3.0, 8.0);
    run.ends_in("fault");
    assert!(run.ended.how.is_ok(), "with an operator a fault does not end the run");
}

#[test]
fn a_start_behind_an_emergency_stop_without_a_selection_is_refused() {
    let run = scene(
        &[(4.5, OperatorCommand::Reset), (5.0, OperatorCommand::Start), (5.5, OperatorCommand::Resume)],
        &[(3.0, 4.0)],
    )
    .run(8.0);
    run.stops(3.0, 8.0);
    run.ends_in("idle");
}

#[test]
fn a_selection_in_a_fault_is_refused() {
    let run = scene(&[(4.5, OperatorCommand::Select), (5.0, OperatorCommand::Start)], &[(3.0, 4.0)]).run(7.0);
    run.stops(3.0, 7.0);
    run.ends_in("fault");
}

#[test]
fn a_commanded_stop_lasts_until_reset_selection_and_start() {
    let more = [
        (3.0, OperatorCommand::Stop),
        (4.0, OperatorCommand::Start),
        (4.5, OperatorCommand::Reset),
        (5.0, OperatorCommand::Select),
        (6.0, OperatorCommand::Start),
    ];
    let run = scene(&more, &[]).run(9.0);
    run.stops(3.0, 6.0);
    run.begins_where_it_is(5.9, &[0, 1]);
    run.ends_following();
}

#[test]
fn a_person_who_falls_silent_and_speaks_again_has_to_reset() {
    let silent = Scene { silent: (2.0, 4.0), ..scene(&[], &[]) };
    let run = silent.clone().run(8.0);
    run.ends_in("stopped");
    let [stopped_s] = run.times_of("stop-found")[..] else { panic!("{:?}", run.transitions()) };
    assert!(stopped_s > 2.9 && stopped_s < 3.2, "{stopped_s}");
    run.stops(stopped_s, 8.0);
    let again = [(6.0, OperatorCommand::Reset), (6.5, OperatorCommand::Select), (7.5, OperatorCommand::Start)];
    let commands = silent.commands.iter().chain(&again).copied().collect();
    let run = Scene { commands, ..silent }.run(10.0);
    run.stops(stopped_s, 7.5);
    run.begins_where_it_is(7.4, &[0, 1]);
    run.ends_following();
}

#[test]
fn a_second_emergency_stop_behind_the_reset_stops_again() {
    let more = [(4.5, OperatorCommand::Reset), (5.0, OperatorCommand::Select), (6.0, OperatorCommand::Start)];
    // The stop is pressed again while both arms wait for the start.
    let run = scene(&more, &[(3.0, 4.0), (5.5, 7.0)]).run(9.0);
    run.stops(3.0, 9.0);
    assert_eq!(run.times_of("fault-found").len(), 2, "{:?}", run.transitions());
    run.ends_in("fault");
    // And while they move.
    let more = [(3.5, OperatorCommand::Reset), (4.0, OperatorCommand::Select), (4.5, OperatorCommand::Start)];
    let run = scene(&more, &[(2.8, 3.0), (5.2, 6.0)]).run(8.0);
    run.stops(2.8, 4.5);
    let [_, again_s] = run.times_of("fault-found")[..] else { panic!("{:?}", run.transitions()) };
    run.stops(again_s, 8.0);
    run.ends_in("fault");
}

#[test]
fn a_reset_that_was_given_too_early_clears_no_arm() {
    // Given too long ago, and given before the emergency stop.
    for (reset_s, resets_late_s, pressed, why) in [
        (4.5, 1.0, (3.0, 3.2), "the request is 1.000 s old"),
        (3.2, 0.4, (3.0, 3.05), "before the state changed to fault"),
    ] {
        let run = Scene { resets_late_s, ..scene(&[(reset_s, OperatorCommand::Reset)], &[pressed]) }.run(6.0);
        for noted in &run.noted {
            assert!(noted.lock().unwrap().resets_s.is_empty(), "{why}: an arm was reset");
        }
        assert!(run.trouble.iter().any(|troubles| troubles.contains(why)), "{:?}", run.trouble);
        run.stops(3.0, 6.0);
        run.ends_in("fault");
    }
}

/// An emergency stop so short that it is over when the step comes in which the second reset arrives.
#[test]
fn a_reset_clears_nothing_that_the_supervisor_has_not_observed() {
    let more = [(4.5, OperatorCommand::Reset), (5.003, OperatorCommand::Reset)];
    let run = scene(&more, &[(3.0, 4.0), (5.002, 5.006)]).run(7.0);
    assert_eq!(run.noted[0].lock().unwrap().resets_s.len(), 1, "the second one clears nothing");
    assert_eq!(run.times_of("fault-found").len(), 2, "{:?}", run.transitions());
    run.ends_in("fault");
    // The same while both arms are stopped by a command.
    let run = scene(&[(3.0, OperatorCommand::Stop), (5.003, OperatorCommand::Reset)], &[(5.002, 5.006)]).run(7.0);
    assert!(run.noted[0].lock().unwrap().resets_s.is_empty());
    run.ends_in("fault");
    let run = scene(
        &[(3.0, OperatorCommand::Stop), (5.003, OperatorCommand::Reset), (6.0, OperatorCommand::Reset)],
        &[(5.002, 5.006)],
    )
    .run(7.0);
    run.ends_in("idle");
}

#[test]
fn a_stop_that_fails_is_tried_again_and_nothing_is_reset_before() {
    let more = [(3.2, OperatorCommand::Reset), (4.5, OperatorCommand::Reset)];
    let run = Scene { tc_stops_failing: 4, ..scene(&more, &[(3.0, 3.1)]) }.run(6.0);
    run.stops(3.0, 6.0);
    let [vs, tc] = [0, 1].map(|arm| run.noted[arm].lock().unwrap());
    // The last one is that of the run.
    assert_eq!(tc.stops_s.len(), 6, "{:?}", tc.stops_s);
    let pauses: Vec<f64> = tc.stops_s.windows(2).map(|pair| pair[1] - pair[0]).take(4).collect();
    assert!(pauses.iter().all(|pause_s| (0.09..0.35).contains(pause_s)), "{pauses:?}");
    assert!(vs.resets_s.len() == 1 && vs.resets_s[0] > 4.4, "{:?}", vs.resets_s);
    assert!(run.trouble[0].contains("the emergency stop of the test"), "the first trouble: {:?}", run.trouble);
    assert!(!run.trouble.iter().any(|troubles| troubles.contains("the stop was not heard")), "{:?}", run.trouble);
    let refused = "reset refused: the drives of tc-robot are still enabled";
    assert!(run.trouble.iter().any(|troubles| troubles.contains(refused)), "{:?}", run.trouble);
    drop((vs, tc));
    run.ends_in("idle");
}

/// With either arm, both hold until the operator resumes, and both exchange data in each step.
#[test]
fn a_command_that_an_arm_refuses_is_a_hold_until_resume() {
    for refuse in [[(3.0, 3.02), (0.0, 0.0)], [(0.0, 0.0), (3.0, 3.02)]] {
        let run = Scene { refuse, ..scene(&[(5.0, OperatorCommand::Resume)], &[]) }.run(7.0);
        assert!(run.ended.how.is_ok(), "{:?}", run.ended.how);
        assert!(
            run.trouble.iter().any(|troubles| troubles.contains("too little room, says the test")),
            "{:?}",
            run.trouble
        );
        let (held, resumed) = (run.times_of("hold"), run.times_of("resume"));
        assert!(held.len() == 1 && (3.0..3.03).contains(&held[0]), "{:?}", run.transitions());
        assert!(resumed.len() == 1 && (4.99..5.02).contains(&resumed[0]), "{:?}", run.transitions());
        let [vs, tc] = [0, 1].map(|arm| run.noted[arm].lock().unwrap());
        assert_eq!(vs.troubles.len(), tc.troubles.len(), "both arms get a command in each step");
        let held = vs.troubles.iter().chain(&tc.troubles).filter(|(at_s, ..)| (3.03..4.99).contains(at_s));
        assert!(held.clone().count() > 300 && held.clone().all(|(_, command, _)| *command == JointCommand::Hold));
        drop((vs, tc));
        run.ends_in("tracking");
    }
}

/// Without an operator a fault is not reset: the run ends, and its report gives the reason.
#[test]
fn a_fault_that_ends_a_run_is_on_top_of_its_report() {
    let setup = setup();
    let parts = wire(&setup).unwrap();
    let vs = Stoppable::new(parts.vs, &parts.clock, &[(3.0, 9.0)]);
    let Ended { outcome, how, .. } = conduct(&setup, Parts { vs: Box::new(vs), ..parts }, None, None).unwrap();
    let failure = how.unwrap_err();
    let text = format!("{failure:#}");
    assert!(text.contains("vs-robot") && text.contains("the emergency stop of the test"), "{text}");
    assert!(outcome.log.control.len() > 290, "{} steps", outcome.log.control.len());
    let folder = tempfile::tempdir().unwrap();
    let failed = report::write_report(folder.path(), &setup, &Made::default(), &outcome, Err(failure), |_| Ok(()));
    assert_eq!(format!("{:#}", failed.unwrap_err()), text);
    let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    let place = |text: &str| page.find(text).unwrap_or_else(|| panic!("{text} is not in the report"));
    assert!(place("The run ended early") < place("Target and hand"));
    assert!(place("the emergency stop of the test") < place("Target and hand"));
    let figures = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    assert!(figures.contains("\"ended_by\": \"") && figures.contains("the emergency stop of the test"));
}
