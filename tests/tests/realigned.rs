//! The hand takes the pose relative to the visible surface where the operator says so, and nowhere else.
#![allow(clippy::unwrap_used, reason = "helpers of tests may fail the test")]

use std::sync::{Arc, Mutex};

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_cell::halves::Mover;
use pb3dp_cell::moving::{Moving, StepRecord};
use pb3dp_cell::operator::{ByCommand, Operator};
use pb3dp_cell::parts::Parts;
use pb3dp_cell::percept::Percept;
use pb3dp_geometry::frames::{Hand, Model, Surface};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_servo::TargetObservation;
use pb3dp_servo::supervisor::{
    Confidence, Decision, EstimateInput, Event, FrameInput, OperatorCommand, OperatorInput, OperatorRequest, State,
};
use pb3dp_setup::setup::{Carrier, Setup, read_setup};
use pb3dp_wiring::wire;
use system_tests::repository;

/// Selects and starts by itself, then gives the commands of the test.
struct Says {
    by_itself: ByCommand,
    command: Arc<Mutex<Option<OperatorCommand>>>,
}

impl Operator for Says {
    fn listen(&mut self, last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let input = self.by_itself.listen(last, now);
        let command = self.command.lock().unwrap().take();
        OperatorInput {
            request: command.map(|command| OperatorRequest { command, at: now }).or(input.request),
            ..input
        }
    }

    fn show(&mut self, _decision: &Decision) {}

    fn tell(&mut self, _trouble: Option<String>) {}

    fn is_person(&self) -> bool {
        false
    }

    fn can_fall_silent(&self) -> bool {
        false
    }
}

/// 6 mm and 3 degrees.
fn surface_from_model() -> Pose<Surface, Model> {
    Pose::from_parts(Vector3::new(0.001, -0.002, 0.0055), UnitQuaternion::from_euler_angles(0.03, -0.04, 0.0))
}

const RUN_S: f64 = 12.0;

/// A run: its steps, the largest speeds of the hand after five seconds (m/s, rad/s), and its pose at the end.
struct Ran {
    all: Vec<StepRecord>,
    fastest: [f64; 2],
    model_from_hand: Pose<Model, Hand>,
    model_from_hand_desired: Pose<Model, Hand>,
}

/// A hand that follows a resting target; with the surface from the third second on, and commands at these times.
fn run(sees: Option<Pose<Surface, Model>>, says: &[(f64, OperatorCommand)]) -> Ran {
    let mut setup: Setup = read_setup(&repository().join("configs/sim.toml")).unwrap();
    setup.compared.clear();
    setup.experiment.carrier = Carrier::Person;
    let parts = wire(&setup).unwrap();
    let experiment = parts.experiment.clone();
    let Parts { clock, vs, tc, cell, .. } = parts;
    let command = Arc::new(Mutex::new(None));
    let operator = Says { by_itself: ByCommand, command: Arc::clone(&command) };
    let mut moving =
        Moving::new(&setup, (vs, tc), &*experiment, clock.now()).unwrap().with_operator(Box::new(operator));
    assert!(moving.enable().unwrap());
    let period_s = setup.control_period.as_secs_f64();
    let (mut all, mut hand, mut fastest) = (Vec::new(), None, [0.0; 2]);
    for step in 0..(RUN_S / period_s) as u64 {
        let now = clock.now() + setup.control_period;
        clock.sleep_until(now);
        let t_s = step as f64 * period_s;
        if step.is_multiple_of(3) {
            let cam_left_from_target = cell.world_from_cam_left_at(now).inverse() * cell.world_from_target_at(now);
            let observation = TargetObservation {
                at: now,
                cam_left_from_model: cam_left_from_target.relabel(),
                trusted: true,
                covariance: None,
                observed: [true; 6],
            };
            let estimate = EstimateInput { at: now, confidence: Confidence::Sure, covariance: None, target: 1 };
            moving.observe(
                Percept {
                    frame: FrameInput { sequence: step, at: now, skew_s: 0.0 },
                    estimate,
                    observation: Some(observation),
                    surface_from_model: sees.filter(|_| t_s >= 3.0),
                },
                now,
            );
        }
        if let Some((_, request)) = says.iter().find(|(at_s, _)| step == (at_s / period_s) as u64) {
            *command.lock().unwrap() = Some(*request);
        }
        all.push(moving.step(now).unwrap());
        let is_at = cell.world_from_hand_at(now);
        if let Some(before) = hand.replace(is_at).filter(|_| t_s > 5.0) {
            let way = before.inverse() * is_at;
            fastest[0] = f64::max(fastest[0], way.translation_m().norm() / period_s);
            fastest[1] = f64::max(fastest[1], way.rotation_angle_rad() / period_s);
        }
    }
    let end = clock.now();
    let target_from_hand = cell.world_from_target_at(end).inverse() * cell.world_from_hand_at(end);
    let model_from_hand_desired = setup.controller.model_from_hand_desired;
    Ran { all, fastest, model_from_hand: target_from_hand.relabel(), model_from_hand_desired }
}

fn joints(all: &[StepRecord]) -> Vec<[u64; 7]> {
    all.iter().map(|moved| std::array::from_fn(|joint| moved.vs_joints.position_rad[joint].to_bits())).collect()
}

fn step_of(all: &[StepRecord], event: Event) -> usize {
    all.iter().position(|moved| moved.decision.transition.is_some_and(|done| done.event == event)).unwrap()
}

/// Distance, metres, and angle of two poses of the hand.
fn apart(one: &Pose<Model, Hand>, other: &Pose<Model, Hand>) -> [f64; 2] {
    let between = one.inverse() * *other;
    [between.translation_m().norm(), between.rotation_angle_rad()]
}

#[test]
fn the_hand_takes_the_surface_at_re_align_by_an_approach_and_nothing_changes_without_it() {
    let (without, with_surface) = (run(None, &[]), run(Some(surface_from_model()), &[]));
    assert_eq!(joints(&without.all), joints(&with_surface.all), "what is known of the surface moves nothing");
    let [off_m, off_rad] = apart(&with_surface.model_from_hand, &with_surface.model_from_hand_desired);
    assert!(off_m < 2e-4 && off_rad < 1e-3, "{off_m} m, {off_rad} rad");

    let aligned = run(Some(surface_from_model()), &[(5.0, OperatorCommand::Realign)]);
    let at = step_of(&aligned.all, Event::Realign);
    assert_eq!(joints(&without.all[..=at]), joints(&aligned.all[..=at]), "until the command, everything is as before");
    let state = |step: usize| aligned.all[step].decision.state;
    assert_eq!((state(at), state(aligned.all.len() - 1)), (State::Approaching, State::Tracking));
    // The hand is near, so that the approach ends at once, and its speed limit of 0.1 m/s only begins to rise.
    let [linear, angular] = aligned.fastest;
    assert!(linear > 1e-3 && linear < 0.12 && angular < 17.5_f64.to_radians(), "{linear} m/s, {angular} rad/s");
    // Relative to the surface, the hand is where the setup says.
    let surface_from_hand = surface_from_model() * aligned.model_from_hand;
    let [off_m, off_rad] = apart(&surface_from_hand.relabel(), &aligned.model_from_hand_desired);
    assert!(off_m < 2e-4 && off_rad < 1e-3, "{off_m} m, {off_rad} rad");
}

#[test]
fn a_resumed_hand_takes_the_surface_too() {
    let says = [(5.0, OperatorCommand::Hold), (6.5, OperatorCommand::Resume)];
    let Ran { all, .. } = run(Some(surface_from_model()), &says);
    let (start, resume) = (step_of(&all, Event::Start), step_of(&all, Event::Resume));
    assert!(all[start..resume].iter().all(|moved| moved.model_from_surface == Pose::coincident()));
    let last = all.last().unwrap();
    assert_eq!((last.model_from_surface, last.decision.state), (surface_from_model().inverse(), State::Tracking));
}
