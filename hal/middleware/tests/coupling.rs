//! Two mock arms within reach of each other.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_arm_pa10_emulation::mock::MockArm;
use pb3dp_geometry::frames::{Base, World};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{Arm, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_middleware::{Coupled, CoupledArmConfig, CoupledError, Guard, Limiter, couple};
use pb3dp_kinematics::{ArmPart, ArmShape, Capsule, Carrier, Chain, JointVector, PlacedArm, clearance};
use proptest::prelude::*;

use crate::common::{
    COMMAND_TIMEOUT, CYCLE, assert_contract, guard_config, limiter_config, limits, mock_arm, velocity,
};

const LEAST_M: f64 = 0.05;

fn chain() -> Chain {
    let urdf = include_str!("../../../configs/robots/pa10_gen2.urdf");
    Chain::from_urdf_str(urdf, "base_link", "flange").unwrap()
}

fn shape() -> ArmShape {
    let part = |name: &str, carrier, length_m: f64, radius_m: f64| ArmPart {
        name: name.to_owned(),
        carrier,
        capsule: Capsule { ends_m: [[0.0, 0.0, 0.0].into(), [0.0, 0.0, length_m].into()], radius_m },
    };
    let parts = vec![
        part("base", Carrier::Base, 0.317, 0.1),
        part("upper arm", Carrier::Joint(1), 0.45, 0.09),
        part("forearm", Carrier::Joint(3), 0.48, 0.08),
        part("tool", Carrier::Flange, 0.1, 0.07),
    ];
    ArmShape::new(parts).unwrap()
}

/// The first arm faces along x; the second one is at this distance and faces back.
fn places(distance_m: f64) -> [Pose<World, Base>; 2] {
    let back = UnitQuaternion::from_euler_angles(0.0, 0.0, std::f64::consts::PI);
    [
        Pose::from_parts(Vector3::new(0.0, 0.0, 0.7), UnitQuaternion::identity()),
        Pose::from_parts(Vector3::new(distance_m, 0.02, 0.7), back),
    ]
}

fn coupled_config(world_from_base: Pose<World, Base>) -> CoupledArmConfig {
    CoupledArmConfig {
        chain: chain(),
        shape: shape(),
        world_from_base,
        limits: limits(0.6),
        reaction_time: Duration::from_millis(65),
        command_timeout: COMMAND_TIMEOUT,
        fade: None,
    }
}

type Driven = Limiter<Coupled<Guard<MockArm>>>;

/// Two enabled arms in one workcell.
struct Bench {
    arms: [Driven; 2],
    clock: Arc<VirtualClock>,
    places: [Pose<World, Base>; 2],
}

impl Bench {
    fn new(distance_m: f64, starts: [JointVector; 2]) -> Self {
        let clock = Arc::new(VirtualClock::new());
        let shared = Arc::clone(&clock) as Arc<dyn Clock>;
        let places = places(distance_m);
        let [one, two] = starts.map(|start| Guard::new(mock_arm(&clock, start), limits(0.6), guard_config()).unwrap());
        let (one, two) =
            couple((one, coupled_config(places[0])), (two, coupled_config(places[1])), LEAST_M, &shared).unwrap();
        let mut arms =
            [one, two].map(|arm| Limiter::new(arm, limits(0.6), limiter_config(), Arc::clone(&shared)).unwrap());
        for arm in &mut arms {
            arm.enable().unwrap();
        }
        for arm in &mut arms {
            arm.exchange(JointCommand::Hold).unwrap();
        }
        Self { arms, clock, places }
    }

    fn mock(&self, i: usize) -> &MockArm {
        self.arms[i].arm().arm().arm()
    }

    /// One cycle; returns the kinds of the errors, if any.
    fn cycle(&mut self, commands: [JointCommand; 2]) -> [Option<(ArmErrorKind, String)>; 2] {
        self.clock.sleep_until(self.clock.now() + CYCLE);
        let mut answers = [None, None];
        for (i, command) in commands.into_iter().enumerate() {
            answers[i] = self.arms[i].exchange(command).err().map(|error| (error.kind(), error.to_string()));
        }
        answers
    }

    /// The smallest true clearance so far, metres.
    fn least_room_m(&self) -> f64 {
        let (chain, shape) = (chain(), shape());
        let (mut least_m, mut at) = (f64::INFINITY, MonotonicTime::ZERO);
        while at <= self.clock.now() {
            let frames = [0, 1].map(|i| {
                let plant = self.mock(i).plant();
                let plant = plant.lock().unwrap();
                chain.joint_frames(&plant.position_at(at).unwrap_or_else(|| plant.state().position_rad))
            });
            let [one, two] =
                [0, 1].map(|i| PlacedArm { shape: &shape, world_from_base: &self.places[i], frames: &frames[i] });
            least_m = least_m.min(clearance(&one, &two).distance_m);
            at = at + Duration::from_millis(4);
        }
        least_m
    }

    fn speed(&self, i: usize) -> f64 {
        self.mock(i).plant().lock().unwrap().state().velocity_rad_per_s.amax()
    }
}

/// Leans an arm towards the other one.
fn bowed(by_rad: f64) -> JointVector {
    JointVector::from([0.0, by_rad, 0.0, 0.6, 0.0, 0.3, 0.0])
}

#[test]
fn arms_that_move_towards_each_other_stop_before_they_are_too_near() {
    for speeds in [[0.6, 0.6], [0.6, 0.0], [0.0, 0.6], [0.1, 0.1]] {
        let mut bench = Bench::new(1.2, [bowed(-0.3), bowed(-0.3)]);
        let commands = speeds.map(|speed| velocity(1, speed));
        let mut refused = None;
        for _ in 0..3000 {
            let answers = bench.cycle(commands);
            refused = refused.or(answers.into_iter().flatten().next());
        }
        let (kind, text) = refused.unwrap_or_else(|| panic!("{speeds:?}: nothing was refused"));
        assert_eq!(kind, ArmErrorKind::Rejected);
        assert!(text.contains("could come within") && text.contains("the minimum clearance is 50 mm"), "{text}");
        assert!(bench.speed(0) < 0.1 && bench.speed(1) < 0.1, "{speeds:?}");
        let least_m = bench.least_room_m();
        assert!((LEAST_M..0.15).contains(&least_m), "{speeds:?}: {least_m} m");
        assert!(bench.arms[0].arm().statistics().refused > 0);
    }
}

#[test]
fn an_arm_that_stands_too_near_may_move_away() {
    let mut bench = Bench::new(1.2, [bowed(-0.3), bowed(-0.3)]);
    for _ in 0..1000 {
        bench.cycle([velocity(1, 0.2), velocity(1, 0.2)]);
    }
    let is_refused = |bench: &mut Bench| bench.cycle([velocity(1, 0.1), JointCommand::Hold])[0].is_some();
    assert!((0..50).any(|_| is_refused(&mut bench)), "still towards the other one");
    for _ in 0..50 {
        bench.cycle([JointCommand::Hold; 2]);
    }
    for _ in 0..300 {
        let answers = bench.cycle([velocity(1, -0.1), JointCommand::Hold]);
        assert!(answers[0].is_none(), "{answers:?}");
    }
    assert!(bench.speed(0) > 0.09);
    assert!(bench.least_room_m() >= LEAST_M);
}

/// A joint of an arm that holds creeps towards the other arm: before, nobody looked.
#[test]
fn arms_that_come_closer_while_they_hold_are_stopped() {
    let mut bench = Bench::new(1.2, [bowed(-0.3), bowed(-0.3)]);
    // Slowly at the end, so that no more is left than is allowed.
    for (speed, cycles) in [(0.2, 1500), (0.01, 1000), (0.001, 2000)] {
        for _ in 0..cycles {
            bench.cycle([velocity(1, speed), velocity(1, speed)]);
        }
    }
    for _ in 0..100 {
        assert_eq!(bench.cycle([JointCommand::Hold; 2]), [None, None]);
    }
    let plant = bench.mock(0).plant();
    let now = bench.clock.now();
    let mut modes = *plant.lock().unwrap().modes();
    modes[1] = pb3dp_sim::joint_dynamics::AxisMode::Driven { velocity_rad_per_s: 0.0019 };
    plant.lock().unwrap().set_modes(now, modes).unwrap();
    let stopped = (0..6000).find_map(|_| bench.cycle([JointCommand::Hold; 2]).into_iter().flatten().next());
    let (kind, text) = stopped.unwrap();
    assert_eq!(kind, ArmErrorKind::Fault);
    assert!(text.contains("apart although this arm holds"), "{text}");
    assert_eq!([0, 1].map(|i| bench.arms[i].state()), [ArmState::Fault; 2]);
    modes[1] = pb3dp_sim::joint_dynamics::AxisMode::Servo;
    plant.lock().unwrap().set_modes(bench.clock.now(), modes).unwrap();
    // The arm that noticed it comes first, as after every stop of both.
    let resets = [0, 1, 0].map(|i| bench.arms[i].reset().is_ok());
    assert!(resets.contains(&true));
    assert_eq!([0, 1].map(|i| bench.arms[i].state()), [ArmState::Disabled; 2]);
    assert!(bench.least_room_m() > 0.02);
}

#[test]
fn what_stops_one_arm_stops_the_other_within_a_cycle_until_both_are_reset() {
    type Raise = fn(&MockArm);
    let raises: [(Raise, ArmState); 3] = [
        (|arm| arm.faults().raise_fault("overcurrent in E1"), ArmState::Fault),
        (|arm| arm.faults().press_e_stop(), ArmState::EStop),
        (|arm| arm.faults().unplug(), ArmState::Fault),
    ];
    for (failing, (raise, state)) in [0, 1].into_iter().flat_map(|i| raises.map(|raise| (i, raise))) {
        let mut bench = Bench::new(3.0, [bowed(0.0), bowed(0.0)]);
        let other = 1 - failing;
        for _ in 0..100 {
            assert_eq!(bench.cycle([velocity(0, 0.2), velocity(0, -0.2)]), [None, None]);
        }
        raise(bench.mock(failing));
        // The arm that failed may exchange after the other one: then the stop takes effect one cycle later.
        let first = bench.cycle([velocity(0, 0.2), velocity(0, -0.2)]);
        let second = bench.cycle([velocity(0, 0.2), velocity(0, -0.2)]);
        assert!(first[failing].is_some(), "{first:?}");
        assert_eq!(first[other].is_some(), failing == 0, "{first:?}");
        let (kind, text) = second[other].clone().unwrap();
        assert_eq!((kind, bench.arms[other].state()), (ArmErrorKind::Fault, ArmState::Fault), "{text}");
        assert!(text.contains("vs-robot (pa10 mock) stopped: "), "{text}");
        assert_eq!(bench.arms[failing].state(), state);
        for _ in 0..60 {
            bench.cycle([JointCommand::Hold; 2]);
        }
        assert!(bench.speed(other) < 1e-3);
        assert!(bench.arms[other].enable().is_err());
        assert!(bench.arms[other].reset().is_err(), "the one that failed comes first");
        let faults = bench.mock(failing).faults();
        faults.remove_fault_cause();
        faults.release_e_stop();
        faults.plug();
        bench.arms[failing].reset().unwrap();
        bench.arms[other].reset().unwrap();
        assert_eq!(bench.arms.each_ref().map(|arm| arm.state()), [ArmState::Disabled; 2]);
        bench.arms.iter_mut().for_each(|arm| arm.enable().unwrap());
        assert_eq!(bench.cycle([JointCommand::Hold; 2]), [None, None]);
        assert_eq!(bench.cycle([velocity(0, 0.2), velocity(0, -0.2)]), [None, None]);
    }
}

#[test]
fn when_both_arms_failed_both_can_be_reset() {
    let mut bench = Bench::new(3.0, [bowed(0.0), bowed(0.0)]);
    (0..2).for_each(|i| bench.mock(i).faults().press_e_stop());
    bench.cycle([JointCommand::Hold; 2]);
    (0..2).for_each(|i| bench.mock(i).faults().release_e_stop());
    assert!(bench.arms[0].reset().is_err());
    bench.arms[1].reset().unwrap();
    assert_eq!(bench.arms[0].state(), ArmState::Fault);
    bench.arms[0].reset().unwrap();
    assert_eq!(bench.arms.each_ref().map(|arm| arm.state()), [ArmState::Disabled; 2]);
}

#[test]
fn an_arm_whose_place_is_not_known_holds_the_other_one() {
    let clock = Arc::new(VirtualClock::new());
    let shared = Arc::clone(&clock) as Arc<dyn Clock>;
    let arm = || (mock_arm(&clock, bowed(0.0)), coupled_config(places(3.0)[0]));
    let (mut one, mut two) =
        couple(arm(), (mock_arm(&clock, bowed(0.0)), coupled_config(places(3.0)[1])), LEAST_M, &shared).unwrap();
    one.enable().unwrap();
    one.exchange(JointCommand::Hold).unwrap();
    let error = one.exchange(velocity(0, 0.01)).unwrap_err();
    assert_eq!(error.kind(), ArmErrorKind::Rejected);
    assert!(error.to_string().contains("the pose of arm vs-robot (pa10 mock) is unknown"), "{error}");
    two.exchange(JointCommand::Hold).unwrap();
    one.exchange(velocity(0, 0.01)).unwrap();
    for least in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let refused = couple(arm(), arm(), least, &shared).map(drop).unwrap_err();
        assert!(matches!(refused, CoupledError::LeastRoom(_)));
    }
}

#[test]
fn coupled_mock_arm_keeps_the_contract() {
    let clock = Arc::new(VirtualClock::new());
    let shared = Arc::clone(&clock) as Arc<dyn Clock>;
    let make = || {
        let arm = |i: usize| (mock_arm(&clock, bowed(0.3)), coupled_config(places(5.0)[i]));
        let (one, mut two) = couple(arm(0), arm(1), LEAST_M, &shared).unwrap();
        two.exchange(JointCommand::Hold).unwrap();
        one
    };
    assert_contract(&clock, make, |arm| arm.arm());
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(60) })]

    /// Both arms keep their clearance, for any commands: tested with the true simulated joints.
    #[test]
    fn no_commands_bring_the_arms_too_near(
        desired in prop::collection::vec((prop::array::uniform14(-1.0..1.0f64), 5..120usize), 1..15),
        start in prop::array::uniform7(-0.3..0.3f64),
    ) {
        let start = bowed(-0.2) + JointVector::from(start);
        let mut bench = Bench::new(1.4, [start, -start]);
        prop_assume!(bench.least_room_m() > LEAST_M);
        for (speeds, cycles) in desired {
            let desired = |from: usize| JointCommand::Velocity(JointVector::from_fn(|i, _| 2.0 * speeds[from + i]));
            for _ in 0..cycles {
                for answer in bench.cycle([desired(0), desired(7)]).into_iter().flatten() {
                    prop_assert_eq!(answer.0, ArmErrorKind::Rejected, "{}", answer.1);
                }
            }
        }
        let least_m = bench.least_room_m();
        prop_assert!(least_m >= LEAST_M, "{least_m} m");
    }
}

/// A cable that was unplugged while both arms were stopped must not prevent their reset after it is plugged in again.
#[test]
fn an_arm_whose_link_was_gone_can_be_reset() {
    let mut bench = Bench::new(2.0, [JointVector::zeros(), JointVector::zeros()]);
    bench.mock(0).faults().raise_fault("an overcurrent");
    bench.cycle([JointCommand::Velocity(JointVector::repeat(0.01)); 2]);
    let answers = bench.cycle([JointCommand::Velocity(JointVector::repeat(0.01)); 2]);
    assert!(answers.iter().all(Option::is_some), "{answers:?}");
    bench.mock(1).faults().unplug();
    bench.mock(0).faults().remove_fault_cause();
    assert!(bench.arms[1].reset().is_err(), "the cable is still pulled");
    bench.mock(1).faults().plug();
    for arm in &mut bench.arms {
        arm.reset().unwrap();
    }
    for arm in &mut bench.arms {
        assert_eq!(arm.state(), ArmState::Disabled);
        arm.enable().unwrap();
    }
}
