//! Bugs of public PA-10 drivers, reproduced in bytes: the emulated controller must show each. The tests that our driver does not
//! have them are in `known_driver_bugs.rs`.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{EmergencyStopCause, FaultCause, Request, Trip};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, MockControllerConfig};
use pb3dp_arm_pa10_protocol::codec::{Axis, CommAlarm, ServoAlarm, WireFormat};
use pb3dp_arm_pa10_test_support::bus_bench::{BusBench, START, home, plant, plant_config};
use pb3dp_arm_pa10_test_support::byte_bus::Bus;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::JointPlant;

const A: WireFormat = WireFormat::LittleEndian5x8;
const B: WireFormat = WireFormat::BigEndian6x10;

/// In control mode, without a watchdog, brakes open, every axis at 0.1 rad/s.
fn moving(format: WireFormat) -> Bus {
    let mut bus = Bus::new(MockControllerConfig { watchdog: None, ..MockControllerConfig::new(format) }, plant());
    bus.exchange(&[1, b'S']).unwrap();
    command(&mut bus, format, 0);
    bus.wait(Duration::from_millis(200));
    command(&mut bus, format, 500);
    bus.wait(Duration::from_millis(100));
    bus
}

fn command(bus: &mut Bus, format: WireFormat, counts: i16) -> Vec<u8> {
    let ([l0, l1], [b0, b1]) = (counts.to_le_bytes(), counts.to_be_bytes());
    match format {
        WireFormat::LittleEndian5x8 => bus.cyclic(9, &[2, 0, 0, l0, l1], &[]),
        WireFormat::BigEndian6x10 => bus.cyclic(9, &[0, 2, 0, 0, b0, b1], &[0, 0]),
    }
}

fn travel(bus: &mut Bus, time: Duration) -> JointVector {
    let before = bus.position();
    bus.wait(time);
    bus.position() - before
}

/// SDU: the pointer of E was never set, so the controller received no E, and the arm continued.
#[test]
fn an_end_that_is_malformed_does_not_stop_the_arm() {
    for (frame, refused) in [(&[0xFF, 0xFE, 0, 254, 5, b'E'][..], true), (&[0xFF, 0xFE, 254, 0, 5, b'E'], false)] {
        let mut bus = moving(A);
        let before = bus.controller.counters().malformed;
        bus.controller.handle_frame(bus.now, frame);
        assert_eq!(bus.controller.counters().malformed - before, u64::from(refused));
        assert_eq!(bus.controller.mode() == ControlMode::Control, refused);
        bus.wait(Duration::from_millis(100));
        let travelled = travel(&mut bus, Duration::from_secs(1));
        assert_eq!(travelled.amax() > 0.09, refused, "{travelled}");
    }
}

/// RobWork left a torque uninitialised, Orca wrote the same number into the torque and the speed field.
#[test]
fn a_left_over_torque_is_counted() {
    let mut bus = moving(B);
    assert_eq!(bus.controller.counters().odd, 0);
    bus.cyclic(3, &[0, 2, 0x01, 0xF4, 0x01, 0xF4], &[0, 0]);
    assert_eq!(bus.controller.counters().odd, 1);
    let mut bus = moving(A);
    bus.cyclic(3, &[2, 0, 0x80, 0, 0], &[]);
    assert_eq!(bus.controller.counters().odd, 1);
}

/// RobWork cast negative speeds to an unsigned number; SDU decoded measured torques as unsigned numbers.
#[test]
fn signs_are_those_of_the_joints() {
    for format in WireFormat::ALL {
        let mut bus = moving(format);
        command(&mut bus, format, -500);
        bus.wait(Duration::from_millis(100));
        let travelled = travel(&mut bus, Duration::from_secs(1));
        assert!((travelled + JointVector::repeat(0.1)).amax() < 1e-3, "{format}: {travelled}");
        bus.fault("torque 1 -10Nm");
        let reply = command(&mut bus, format, 0);
        // 10 N m are 200 counts of 0.001 N m at the motor in A, 177 counts of 4.64 / 4096 N m in B.
        let expected: &[u8] = if format == A { &(-200i16).to_le_bytes() } else { &(-177i16).to_be_bytes() };
        let at = 2 + if format == A { 6 } else { 8 };
        assert_eq!(&reply[at..at + 2], expected, "{format}");
    }
}

/// RobWork: with sequence number 0 in every message, a late reply looks like the newest.
#[test]
fn a_late_reply_is_recognised_only_by_its_number() {
    for (numbers, can_be_reported) in [([0u8, 0], false), ([6, 7], true)] {
        let mut bus = moving(A);
        bus.fault("delay 1 5ms");
        let frame = |sequence: u8| {
            let mut frame = vec![0xFF, 0xFE, 219, 0, sequence, b'C'];
            frame.extend([2, 0, 0, 0xF4, 1].repeat(7));
            frame
        };
        bus.controller.handle_frame(bus.now, &frame(numbers[0]));
        bus.wait(Duration::from_millis(5));
        bus.controller.handle_frame(bus.now, &frame(numbers[1]));
        bus.wait(Duration::from_micros(400));
        let first = bus.controller.poll_frame(bus.now).unwrap();
        assert_eq!(first[4] != numbers[1], can_be_reported, "the old reply comes before the new one");
    }
}

/// Orca tested alarm codes as bit masks, and warnings twice but faults never.
#[test]
fn every_alarm_stops_the_driver_by_its_own_name() {
    for &alarm in ServoAlarm::LISTED {
        for axis in Axis::ALL {
            let mut bench = BusBench::new(B).moving(JointVector::repeat(0.1));
            bench.inject(&format!("alarm {} {} reported", axis.number(), alarm.code()));
            bench.run(Duration::from_millis(20));
            let trip = bench.driver.latched().map(|latched| latched.trip);
            let expected = match alarm {
                ServoAlarm::EmergencyStop | ServoAlarm::DeadManOff | ServoAlarm::LimitSwitch => {
                    Trip::EStop(EmergencyStopCause::Axis { axis, alarm })
                }
                _ => Trip::Fault(FaultCause::ServoAlarm { axis, alarm }),
            };
            assert_eq!(trip, Some(expected));
        }
    }
    for &alarm in CommAlarm::LISTED {
        let mut bench = BusBench::new(B).moving(JointVector::repeat(0.1));
        bench.inject(&format!("controller-alarm {} reported", alarm.code()));
        bench.run(Duration::from_millis(20));
        let expected = match alarm {
            CommAlarm::EmergencyStop | CommAlarm::DeadManOff | CommAlarm::LimitSwitch => {
                Trip::EStop(EmergencyStopCause::Controller { alarm })
            }
            _ => Trip::Fault(FaultCause::ControllerAlarm { alarm }),
        };
        assert_eq!(bench.driver.latched().map(|latched| latched.trip), Some(expected));
    }
}

/// Orca: its test program cleared axes 0 to 6. Axis 0 does not exist, and axis 7 keeps its alarm.
#[test]
fn clearing_axes_from_zero_leaves_the_last_one_out() {
    let mut bus = moving(B);
    bus.fault("alarm 7 0x06");
    bus.fault("alarm 7 off");
    assert_eq!(bus.exchange(&[2, b'A', 0, 0]), None);
    (1..7).for_each(|axis| drop(bus.exchange(&[2, b'A', 0, axis])));
    let word = |reply: &[u8]| [reply[2 + 60], reply[2 + 61]];
    assert_eq!(word(&command(&mut bus, B, 0)), [0x40, 0x60]);
    bus.exchange(&[2, b'A', 0, 7]).unwrap();
    assert_eq!(word(&command(&mut bus, B, 0)), [0, 0]);
}

/// Orca's destructor and NTUA's bridge end without a stop: the arm continues until the watchdog acts, if there is one.
#[test]
fn an_end_without_a_stop_leaves_the_arm_moving() {
    let mut bus = moving(B);
    let travelled = travel(&mut bus, Duration::from_secs(1));
    assert!((travelled - JointVector::repeat(0.1)).amax() < 1e-3, "{travelled}");
}

/// PA10ros sent E and S before every command: the brakes never have enough time to open.
#[test]
fn a_control_mode_that_starts_anew_with_each_command_moves_nothing() {
    let mut bus = Bus::new(MockControllerConfig::new(A), plant());
    for sequence in 0..200 {
        bus.exchange(&[sequence, b'E']).unwrap();
        bus.exchange(&[sequence, b'S']).unwrap();
        command(&mut bus, A, 500);
        bus.wait(Duration::from_millis(1));
    }
    assert_eq!(bus.position(), home());
}

/// NTUA wrapped angle differences to half a turn: E2 and W2 turn further, and so do their counts.
#[test]
fn counts_go_on_beyond_half_a_turn() {
    let mut at = home();
    at[4] = 200f64.to_radians();
    at[6] = -250f64.to_radians();
    let joints = JointPlant::new(plant_config(), at, START).unwrap();
    let mut bus = Bus::new(MockControllerConfig::new(A), joints);
    let reply = bus.cyclic(1, &[1, 0, 0, 0, 0], &[]);
    let counts = |axis: usize| i32::from_le_bytes(reply[2 + 8 * axis + 2..][..4].try_into().unwrap());
    assert_eq!([counts(4), counts(6)], [455_111, -568_889]);
}

/// RobWork's virtual arm moved by 10 ms per command, whatever the time.
#[test]
fn the_arm_moves_by_time_and_not_by_commands() {
    let mut bus = moving(A);
    let before = bus.position();
    for _ in 0..20 {
        command(&mut bus, A, 500);
        bus.wait(Duration::from_millis(49));
    }
    let travelled = bus.position() - before;
    assert!((travelled - JointVector::repeat(0.1)).amax() < 1e-3, "1 s at 0.1 rad/s: {travelled}");
}

/// Our stop sequence, seen from the arm: the servos stop it, then the brakes close, and no axis falls.
#[test]
fn a_sound_stop_does_not_let_the_arm_fall() {
    for format in WireFormat::ALL {
        let mut bench = BusBench::new(format).moving(JointVector::repeat(0.3));
        bench.run(Duration::from_millis(300));
        bench.wanted = None;
        bench.request(Request::Stop);
        let mut worst = 0.0f64;
        let end = bench.now + Duration::from_secs(1);
        bench.run_until(end, |bench| {
            worst = worst.max(bench.speed());
            false
        });
        assert!(worst < 0.31 && bench.is_at_rest() && bench.controller.is_braked(), "{format}: {worst}");
        assert_eq!(bench.controller.counters().released, 0);
    }
}
