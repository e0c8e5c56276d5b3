//! Arms in virtual time: the contract of the arm traits, arms that stop each other, an unplugged cable, a line with a key, a program that
//! dies, and reproducible bytes.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_arm_pa10::arm::{Pa10Arm, Pa10ArmConfig, RawBytes, TripSeat, VirtualTime, virtual_trip_line};
use pb3dp_arm_pa10::driver::{DriverConfig, FaultCause, LimitsCheck, Trip};
use pb3dp_arm_pa10_emulation::far_end::FarEnd;
use pb3dp_arm_pa10_emulation::line::virtual_end::{Tampering, Towards, VirtualEnd};
use pb3dp_arm_pa10_emulation::mock_controller::{MockController, MockControllerConfig};
use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig};
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, Firmware, Geometry, HostLimits, MotionLimits, SharedKey, StopCause,
};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_arm_pa10_test_support::plant_config::plant_config;
use pb3dp_hal_api::{Arm, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_conformance::{ArmExpectations, ArmHooks, arm_suite};
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::JointPlant;

const CYCLE: Duration = Duration::from_millis(10);
const BAUD: u32 = 460_800;
const FORMAT: WireFormat = WireFormat::BigEndian6x10;

fn time() -> Arc<VirtualTime> {
    Arc::new(VirtualTime::over(Arc::new(VirtualClock::new())))
}

fn open(arm: u8, time: &Arc<VirtualTime>, seat: TripSeat) -> (Pa10Arm, VirtualEnd) {
    let end = far_end(arm, time);
    (connect(arm, &end, time, seat), end)
}

fn far_end(arm: u8, time: &Arc<VirtualTime>) -> VirtualEnd {
    // E2 soon exceeds half a turn, so that wrapped angles would be detected.
    let home = JointVector::from([0.2, -0.5, 0.3, 1.1, std::f64::consts::PI - 0.02, 0.9, 0.1]);
    let now = time.now();
    let plant = Arc::new(Mutex::new(JointPlant::new(plant_config(), home, now).unwrap()));
    let controller = MockController::new(MockControllerConfig::new(FORMAT), plant, 7, now).unwrap();
    let gateway = GatewayConfig::new(ArmId(arm), FORMAT, Firmware::new("test 1").unwrap(), MotionLimits::WIDEST);
    VirtualEnd::new(FarEnd::new(controller, Some(Gateway::new(gateway, now).unwrap()), now), BAUD)
}

fn connect(arm: u8, end: &VirtualEnd, time: &Arc<VirtualTime>, seat: TripSeat) -> Pa10Arm {
    let driver = DriverConfig { limits: LimitsCheck::Read, ..DriverConfig::with_cycle(CYCLE) };
    let geometry = Geometry::SecondGeneration;
    let link = GatewayLinkConfig {
        arm: ArmId(arm),
        format: FORMAT,
        geometry,
        cycle: CYCLE,
        limits: HostLimits::WIDEST,
        signals: StatusSignals::ORCA,
    };
    let config = Pa10ArmConfig::new(&format!("arm-{arm}"), driver, link);
    Pa10Arm::open_virtual(config, Box::new(end.clone()), time, seat).unwrap()
}

fn seat() -> TripSeat {
    virtual_trip_line(1).remove(0)
}

fn pass(time: &VirtualTime, millis: u64) {
    time.sleep_until(time.now() + Duration::from_millis(millis));
}

/// Injects the fault at the current far end of the arm, and waits for its effect.
fn with(
    end: &Rc<RefCell<Option<VirtualEnd>>>,
    time: &Arc<VirtualTime>,
    (line, millis): (&'static str, u64),
) -> Box<dyn Fn(&mut Pa10Arm)> {
    let (end, time) = (Rc::clone(end), Arc::clone(time));
    Box::new(move |_| {
        end.borrow().as_ref().unwrap().command_line(line).unwrap();
        pass(&time, millis);
    })
}

#[test]
fn an_arm_in_virtual_time_keeps_the_contract() {
    let time = time();
    let end: Rc<RefCell<Option<VirtualEnd>>> = Rc::default();
    let make = || {
        let (arm, far) = open(1, &time, seat());
        *end.borrow_mut() = Some(far);
        arm
    };
    let hooks = ArmHooks {
        lose_reply: Some(with(&end, &time, ("line drop 2", 16))),
        raise_fault: Some(with(&end, &time, ("alarm 4 0x0e", 50))),
        remove_fault_cause: Some(with(&end, &time, ("alarm 4 off", 50))),
        press_e_stop: Some(with(&end, &time, ("e-stop press", 50))),
        release_e_stop: Some(with(&end, &time, ("e-stop release", 50))),
    };
    let expectations = ArmExpectations { speed_rad_per_s: 0.1, settles_within: Duration::from_millis(250) };
    arm_suite(make, time.as_ref(), &expectations, &hooks).assert_passed();
    assert!(time.is_empty(), "released arms live on");
}

fn velocity() -> JointCommand {
    JointCommand::Velocity(JointVector::from([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]))
}

fn speed(end: &VirtualEnd) -> f64 {
    end.look(|far| far.controller.true_joints().1.amax())
}

struct Cell {
    time: Arc<VirtualTime>,
    arms: [Pa10Arm; 2],
    ends: [VirtualEnd; 2],
}

/// Two arms of one cell in motion.
fn moving() -> Cell {
    moving_at(|_, end| end)
}

/// The same with lines that have a key.
fn moving_with_key() -> Cell {
    moving_at(|arm, end| end.with_key(SharedKey::new(&[5; 32]).unwrap(), ArmId(arm)))
}

fn moving_at(line: impl Fn(u8, VirtualEnd) -> VirtualEnd) -> Cell {
    let time = time();
    let mut seats = virtual_trip_line(2).into_iter();
    let ends = [1, 2].map(|arm| line(arm, far_end(arm, &time)));
    let arms = [1, 2].map(|arm| connect(arm, &ends[usize::from(arm) - 1], &time, seats.next().unwrap()));
    let mut cell = Cell { time, arms, ends };
    cell.arms.iter_mut().for_each(|arm| arm.enable().unwrap());
    cell.move_for(300);
    assert!(cell.ends.iter().all(|end| speed(end) > 0.5));
    cell
}

impl Cell {
    fn move_for(&mut self, millis: u64) {
        let until = self.time.now() + Duration::from_millis(millis);
        while self.time.now() < until {
            self.arms.iter_mut().for_each(|arm| drop(arm.exchange(velocity())));
            pass(&self.time, 10);
        }
    }

    fn trip(&self, arm: usize) -> Trip {
        self.arms[arm].monitor().snapshot().latched.unwrap().trip
    }
}

/// Why the gateway has stopped its arm.
fn stopped_by_gateway(end: &VirtualEnd) -> StopCause {
    end.look(|far| far.gateway.as_ref().unwrap().status().cause)
}

#[test]
fn arms_of_a_cell_stop_each_other_within_a_cycle() {
    let mut cell = moving();
    cell.ends[0].command_line("e-stop press").unwrap();
    let at = cell.time.now();
    while !cell.arms.iter().all(|arm| matches!(arm.state(), ArmState::Fault | ArmState::EStop)) {
        cell.move_for(1);
    }
    assert!(cell.time.now().saturating_since(at) <= Duration::from_millis(40), "{at:?} {:?}", cell.time.now());
    assert_eq!(cell.arms[0].state(), ArmState::EStop);
    assert_eq!(cell.trip(1), Trip::Fault(FaultCause::OtherArm { arm: 1 }));
    pass(&cell.time, 500);
    assert!(cell.ends.iter().all(|end| speed(end) == 0.0 && end.look(|far| far.controller.is_braked())));
    // Each is reset by itself, and the one whose emergency stop is pressed only after its release.
    cell.arms[1].reset().unwrap();
    cell.arms[0].reset().unwrap_err();
    cell.ends[0].command_line("e-stop release").unwrap();
    cell.arms[0].reset().unwrap();
    cell.arms.iter_mut().for_each(|arm| arm.enable().unwrap());
    cell.move_for(300);
    assert!(cell.ends.iter().all(|end| speed(end) > 0.5));
}

/// An error with its sources, as the program prints it.
fn whole(error: &dyn std::error::Error) -> String {
    let sources = std::iter::successors(error.source(), |source| source.source());
    sources.fold(error.to_string(), |text, source| format!("{text}: {source}"))
}

#[test]
fn a_refused_reset_gives_its_reason_once() {
    let mut cell = moving();
    cell.ends[0].command_line("e-stop press").unwrap();
    cell.move_for(500);
    let refused = whole(&cell.arms[0].reset().unwrap_err());
    assert_eq!(refused.matches("release the emergency stop, then reset").count(), 1, "{refused}");
}

#[test]
fn a_cable_that_was_pulled_stops_the_arm_and_comes_back_by_a_reset() {
    let mut cell = moving();
    cell.ends[1].unplug();
    cell.move_for(100);
    let error = cell.arms[1].exchange(velocity()).unwrap_err();
    assert_eq!(error.kind(), ArmErrorKind::Disconnected, "{error}");
    assert_eq!(cell.trip(1), Trip::Fault(FaultCause::Unplugged));
    // Nobody hears the order, and its owner has another arm to stop.
    let before = cell.time.now();
    assert_eq!(cell.arms[1].stop().unwrap_err().kind(), ArmErrorKind::Disconnected);
    assert!(cell.time.now().saturating_since(before) < CYCLE, "{:?}", cell.time.now().saturating_since(before));
    pass(&cell.time, 500);
    assert_eq!(stopped_by_gateway(&cell.ends[1]), StopCause::HostSilent);
    assert!(cell.ends.iter().all(|end| speed(end) == 0.0));
    let refused = whole(&cell.arms[1].reset().unwrap_err());
    assert_eq!(refused.matches("cannot be opened").count(), 1, "{refused}");
    cell.ends[1].plug();
    pass(&cell.time, 500);
    assert_eq!(cell.arms[1].state(), ArmState::Fault, "it came back by itself");
    cell.arms.iter_mut().rev().for_each(|arm| arm.reset().unwrap());
    cell.arms.iter_mut().for_each(|arm| arm.enable().unwrap());
    cell.move_for(300);
    assert!(cell.ends.iter().all(|end| speed(end) > 0.5));
}

#[test]
fn a_record_that_somebody_changes_repeats_or_removes_stops_both_arms() {
    for towards in [Towards::Host, Towards::Gateway] {
        for how in [Tampering::Changed, Tampering::Repeated, Tampering::Removed] {
            let mut cell = moving_with_key();
            cell.ends[0].tamper(towards, how);
            cell.move_for(60);
            let trip = cell.trip(0);
            assert!(matches!(trip, Trip::Fault(FaultCause::Unplugged)), "{towards:?} {how:?}: {trip:?}");
            assert_eq!(cell.trip(1), Trip::Fault(FaultCause::OtherArm { arm: 1 }));
            pass(&cell.time, 500);
            assert!(cell.ends.iter().all(|end| speed(end) == 0.0));
            cell.arms.iter_mut().for_each(|arm| arm.reset().unwrap());
            cell.arms.iter_mut().for_each(|arm| arm.enable().unwrap());
            cell.move_for(300);
            assert!(cell.ends.iter().all(|end| speed(end) > 0.5), "{towards:?} {how:?}: no new connection");
        }
    }
}

#[test]
fn a_new_program_finds_the_arms_of_a_dead_one_latched_and_the_dead_one_never_comes_back() {
    for (is_closed, mut cell) in [(false, moving()), (true, moving_with_key()), (false, moving_with_key())] {
        cell.ends.iter().for_each(|end| end.lose_program(is_closed));
        cell.move_for(600);
        assert!(cell.ends.iter().all(|end| speed(end) == 0.0));
        let refused = whole(&cell.arms[0].reset().unwrap_err());
        assert!(refused.contains("cannot be opened"), "the dead program reset its arm: {refused}");
        let mut next = [1, 2].map(|arm| connect(arm, &cell.ends[usize::from(arm) - 1], &cell.time, seat()));
        for arm in &mut next {
            assert_eq!(arm.state(), ArmState::Fault);
            arm.enable().unwrap_err();
            arm.reset().unwrap();
            arm.enable().unwrap();
        }
        assert!(cell.ends.iter().all(|end| speed(end) == 0.0));
        drop(cell.arms);
        assert!(next.iter().all(|arm| arm.state() == ArmState::Enabled), "the dead program stopped it");
    }
}

#[test]
fn a_host_that_commands_nothing_more_is_noticed() {
    let cell = moving();
    pass(&cell.time, 60);
    assert!(matches!(cell.trip(0), Trip::Fault(FaultCause::CommandTimeout { .. })), "{:?}", cell.trip(0));
    assert!(cell.arms.iter().all(|arm| arm.state() == ArmState::Fault));
    pass(&cell.time, 500);
    assert!(cell.ends.iter().all(|end| speed(end) == 0.0));
    // The gateway keeps the report for the next host.
    assert!(cell.ends.iter().all(|end| stopped_by_gateway(end) == StopCause::HostFault));
}

#[test]
fn who_lets_go_of_a_moving_arm_has_it_stopped() {
    let cell = moving();
    let Cell { time, arms, ends } = cell;
    drop(arms);
    assert!(time.is_empty());
    for end in &ends {
        assert_eq!(stopped_by_gateway(end), StopCause::HostFault);
        assert!(speed(end) < 1e-3 && end.look(|far| far.controller.is_braked()));
    }
}

/// Bytes on the lines of two arms in two seconds with random faults.
fn bytes_sent() -> Vec<RawBytes> {
    let mut cell = moving();
    for end in &cell.ends {
        end.command_line("chance 2% at-most 2 drop 1").unwrap();
        end.command_line("chance 0.1% line corrupt 1").unwrap();
    }
    cell.move_for(2000);
    cell.arms.iter().flat_map(|arm| arm.monitor().raw_bytes()).collect()
}

#[test]
fn the_same_commands_give_the_same_bytes() {
    let (one, other) = (bytes_sent(), bytes_sent());
    assert!(one.len() > 800, "{}", one.len());
    assert!(one == other, "the same run went another way");
}
