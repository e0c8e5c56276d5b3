//! The emulated controller, byte by byte. The bytes are those of the published formats, written by hand.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_arm_pa10::driver::{DriverState, Request};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, MockController, MockControllerConfig};
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_test_support::bus_bench::{BusBench, START, home, plant};
use pb3dp_arm_pa10_test_support::byte_bus::Bus;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::AxisMode;

const A: WireFormat = WireFormat::LittleEndian5x8;
const B: WireFormat = WireFormat::BigEndian6x10;

fn bus(config: MockControllerConfig) -> Bus {
    Bus::new(config, plant())
}

#[test]
fn control_messages_are_answered_with_their_number_and_letter() {
    for format in WireFormat::ALL {
        let mut bus = bus(MockControllerConfig::new(format));
        assert_eq!(bus.exchange(&[0x11, b'A', 0, 7]), Some(vec![0x11, b'A']));
        assert_eq!(bus.controller.mode(), ControlMode::Adjustment);
        assert_eq!(bus.exchange(&[0x12, b'S']), Some(vec![0x12, b'S']));
        assert_eq!(bus.controller.mode(), ControlMode::Control);
        assert_eq!(bus.exchange(&[0x7F, b'E']), Some(vec![0x7F, b'E']));
        assert_eq!(bus.controller.mode(), ControlMode::Adjustment);
        assert!(bus.controller.is_braked());
    }
}

/// +90 degrees is 204800 counts, -90 degrees -204800 (golden bytes of both formats).
#[test]
fn cyclic_replies_have_the_bytes_of_their_format() {
    for (format, mode, golden) in [
        (A, vec![1u8, 0, 0, 0, 0], [[0x00, 0x20, 0x03, 0x00], [0x00, 0xe0, 0xfc, 0xff]]),
        (B, vec![0u8, 1, 0, 0, 0, 0], [[0x00, 0x03, 0x20, 0x00], [0xff, 0xfc, 0xe0, 0x00]]),
    ] {
        let mut bus = bus(MockControllerConfig::new(format));
        let quarter = std::f64::consts::FRAC_PI_2;
        for (axis, angle) in [(1, quarter), (2, -quarter)] {
            let by = angle - home()[axis - 1];
            bus.fault(&format!("jump {axis} {by}rad"));
        }
        let tail: &[u8] = if format == A { &[] } else { &[0, 0] };
        let reply = bus.cyclic(0x2A, &mode, tail);
        assert_eq!(reply.len(), 2 + if format == A { 58 } else { 72 });
        assert_eq!(reply[..2], [0x2A, b'C']);
        let size = if format == A { 8 } else { 10 };
        for (axis, bytes) in golden.into_iter().enumerate() {
            assert_eq!(reply[2 + axis * size + 2..][..4], bytes, "{format}");
        }
        // Dead-man switch pressed, 100 V on.
        assert_eq!(reply[reply.len() - 2..], if format == A { [5, 0] } else { [0, 5] });
    }
}

/// Limits as the words 19 to 22 of the table, high word first; +177 degrees is 402773 counts = 0x00062555.
#[test]
fn the_eeprom_has_the_limits_of_each_axis() {
    let mut bus = bus(MockControllerConfig::new(A));
    let reply = bus.exchange(&[3, b'R', 1, 0]).unwrap();
    assert_eq!(reply[..4], [3, b'R', 1, 0]);
    assert_eq!(reply[4 + 2 * 19..][..8], [0x06, 0x00, 0x55, 0x25, 0xF9, 0xFF, 0xAB, 0xDA]);
    // E1 is axis 4: board 2, second half; 137 degrees are 311751 counts = 0x0004C1C7.
    let reply = bus.exchange(&[4, b'R', 2, 32]).unwrap();
    assert_eq!(reply[..4], [4, b'R', 2, 32]);
    assert_eq!(reply[4 + 2 * 19..][..4], [0x04, 0x00, 0xC7, 0xC1]);
    for nowhere in [[4, 32], [0, 0], [5, 0], [1, 16]] {
        assert_eq!(bus.exchange(&[5, b'R', nowhere[0], nowhere[1]]), None, "{nowhere:?}");
    }
}

#[test]
fn what_must_never_come_is_refused_and_counted() {
    let mut bus = bus(MockControllerConfig::new(B));
    bus.exchange(&[1, b'S']).unwrap();
    for (letter, data) in [(b'M', vec![0, 0]), (b'W', vec![]), (b'P', vec![1, 2, 3])] {
        let mut packet = vec![2, letter];
        packet.extend(data);
        assert_eq!(bus.exchange(&packet), None);
    }
    assert_eq!(bus.controller.counters().forbidden, 3);
    for malformed in [&[3, b'X'][..], &[3, b'A', 0, 0], &[3, b'A', 0, 8], &[3, b'S', 0], &[3, b'C', 0], &[3]] {
        assert_eq!(bus.exchange(malformed), None, "{malformed:?}");
    }
    assert_eq!(bus.controller.counters().malformed, 6);
    let release = bus.exchange(&[4, b'T']);
    assert_eq!(release.is_some(), cfg!(feature = "brake-release"));
    assert_eq!(bus.controller.is_braked(), !cfg!(feature = "brake-release"));
}

/// Brakes hold until their opening time has passed, and do not hold until their closing time has passed.
#[test]
fn an_axis_without_brake_and_servo_falls() {
    let mut bus = bus(MockControllerConfig { watchdog: None, ..MockControllerConfig::new(A) });
    bus.exchange(&[1, b'S']).unwrap();
    bus.cyclic(2, &[0x02, 0, 0, 0, 0], &[]);
    bus.wait(Duration::from_millis(140));
    assert_eq!(bus.controller.axis_modes(), [AxisMode::Brake; 7]);
    bus.wait(Duration::from_millis(20));
    assert_eq!(bus.controller.axis_modes(), [AxisMode::Servo; 7]);
    assert_eq!(bus.position(), home());
    bus.cyclic(3, &[0x00, 0, 0, 0, 0], &[]);
    assert_eq!(bus.controller.counters().released, 7);
    bus.wait(Duration::from_millis(100));
    let fallen = bus.position() - home();
    // The pitch joints fall outwards, the others stay.
    assert!(fallen[1] > 0.002 && fallen[3] > 0.02 && fallen[5] > 0.02, "{fallen}");
    assert_eq!([fallen[0], fallen[2], fallen[4], fallen[6]], [0.0; 4]);
    bus.cyclic(4, &[0x01, 0, 0, 0, 0], &[]);
    bus.wait(Duration::from_millis(40));
    assert_eq!(bus.controller.axis_modes(), [AxisMode::Free; 7]);
    bus.wait(Duration::from_millis(60));
    let held = bus.position();
    bus.wait(Duration::from_millis(500));
    assert_eq!(bus.position(), held);
}

/// Commands before S move nothing; the watchdog ends the control mode, and its alarms stay until they are cleared.
#[test]
fn silence_ends_the_control_mode_where_there_is_a_watchdog() {
    for watchdog in [Some(6), Some(10), Some(400), None] {
        let watchdog = watchdog.map(Duration::from_millis);
        let mut bus = bus(MockControllerConfig { watchdog, ..MockControllerConfig::new(B) });
        let speed = [0x00, 0x02, 0, 0, 0x01, 0xF4];
        bus.cyclic(1, &speed, &[0, 0]);
        bus.wait(Duration::from_millis(500));
        assert_eq!(bus.position(), home());
        bus.exchange(&[2, b'S']).unwrap();
        for sequence in 0..100 {
            bus.cyclic(sequence, &speed, &[0, 0]);
            bus.wait(Duration::from_millis(1));
        }
        let before = bus.position();
        assert!((before - home()).min() > 0.003, "0.1 rad/s since the brakes are open: {before}");
        bus.wait(Duration::from_secs(1));
        let travelled = (bus.position() - before)[0];
        let word = bus.cyclic(101, &[0, 1, 0, 0, 0, 0], &[0, 0])[2..4].to_vec();
        match watchdog {
            Some(time) => {
                assert!((travelled - 0.1 * time.as_secs_f64()).abs() < 0.001, "{time:?}: {travelled}");
                assert_eq!((bus.controller.mode(), word), (ControlMode::Adjustment, vec![0x4F, 0xF0]));
                assert_eq!(bus.controller.counters().watchdog_trips, 1);
            }
            None => {
                assert!((travelled - 0.1).abs() < 0.001, "{travelled}");
                assert_eq!((bus.controller.mode(), word), (ControlMode::Control, vec![0, 0]));
            }
        }
    }
}

/// An alarm keeps its axis from moving until it is cleared, which is impossible while the cause is present.
#[test]
fn alarms_stay_until_their_cause_is_gone_and_they_are_cleared() {
    let mut bus = bus(MockControllerConfig { watchdog: None, ..MockControllerConfig::new(B) });
    let word = |bus: &mut Bus| bus.cyclic(9, &[0, 1, 0, 0, 0, 0], &[0, 0])[2 + 30..][..2].to_vec();
    bus.fault("alarm 4 0x0e");
    assert_eq!(word(&mut bus), [0x40, 0xE0]);
    bus.exchange(&[1, b'A', 0, 4]).unwrap();
    assert_eq!(word(&mut bus), [0x40, 0xE0]);
    bus.fault("alarm 4 off");
    assert_eq!(word(&mut bus), [0x40, 0xE0]);
    bus.exchange(&[2, b'S']).unwrap();
    bus.cyclic(3, &[0, 2, 0, 0, 0, 0], &[0, 0]);
    bus.wait(Duration::from_millis(300));
    assert_eq!(bus.controller.axis_modes()[3], AxisMode::Brake);
    assert_eq!(bus.controller.axis_modes()[2], AxisMode::Servo);
    bus.exchange(&[4, b'A', 0, 3]).unwrap();
    assert_eq!(word(&mut bus), [0x40, 0xE0], "another axis was cleared");
    bus.exchange(&[5, b'A', 0, 4]).unwrap();
    assert_eq!(word(&mut bus), [0x00, 0x00]);
}

#[test]
fn a_driver_moves_the_emulated_arm() {
    for format in WireFormat::ALL {
        let velocity = JointVector::from([0.1, -0.05, 0.2, -0.1, 0.3, -0.2, 0.4]);
        let mut bench = BusBench::new(format).moving(velocity);
        let before = bench.plant.lock().unwrap().state().position_rad;
        bench.run(Duration::from_secs(1));
        assert_eq!(bench.driver.state(), DriverState::Moving);
        let travelled = bench.plant.lock().unwrap().state().position_rad - before;
        assert!((travelled - velocity).amax() < 0.01, "{travelled}");
        let measured = bench.driver.joints().unwrap().position_rad;
        let position = bench.plant.lock().unwrap().state().position_rad;
        assert!((measured - position).amax() < 0.002, "{measured} {position}");
        bench.wanted = None;
        bench.request(Request::Stop);
        bench.settle();
        assert_eq!((bench.driver.state(), bench.controller.mode()), (DriverState::Connected, ControlMode::Adjustment));
        bench.run(Duration::from_millis(100));
        assert!(bench.controller.is_braked() && bench.is_at_rest());
        let counters = bench.controller.counters();
        assert_eq!(
            [counters.forbidden, counters.malformed, counters.odd, counters.released, counters.watchdog_trips],
            [0; 5]
        );
    }
}

#[test]
fn a_configuration_that_is_none_is_refused() {
    let refused = |change: fn(&mut MockControllerConfig)| {
        let mut config = MockControllerConfig::new(A);
        change(&mut config);
        MockController::new(config, Arc::new(Mutex::new(plant())), 0, START).unwrap_err().to_string()
    };
    assert!(refused(|config| config.watchdog = Some(Duration::ZERO)).contains("watchdog of 0 s"));
    let error = refused(|config| config.lower_limit_rad[3] = 0.1);
    assert!(error.contains("axis 4 (E1): limits of 0.1 to 2.39"), "{error}");
    assert!(refused(|config| config.upper_limit_rad[6] = f64::NAN).contains("axis 7"));
}
