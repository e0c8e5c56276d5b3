//! Bugs of public PA-10 drivers, each with a test that would detect it here. Named after the failure.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{DriverState, FaultCause, Request, Trip};
use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmCommand, Axis, AxisCommand, CodecError, ControlMessage, ControlPacket, Letter, ReplyMessage,
    ReplyPacket, SequenceModulus, ServoAlarm, ServoWord, SpeedCounts, Supervision, WireFormat,
};
use pb3dp_arm_pa10_test_support::driver_bench::{Bench, CYCLE, Kind, velocity};
use pb3dp_kinematics::JointVector;

fn moving(velocity_rad_per_s: [f64; 7]) -> ControlMessage {
    let velocity = JointVector::from(velocity_rad_per_s);
    ControlMessage::Cyclic(ArmCommand::velocities(&velocity, Supervision::default()).unwrap())
}

fn cyclic_reply(format: WireFormat, sequence: u8, axis_bytes: &[u8]) -> Vec<u8> {
    let mut bytes = vec![sequence, b'C'];
    bytes.extend(axis_bytes.repeat(7));
    bytes.extend([0, 0]);
    assert_eq!(bytes.len(), 2 + format.reply_length());
    bytes
}

/// SDU: the packet that ends the control mode was malformed, so the arm was not stopped.
#[test]
fn the_end_message_is_well_formed() {
    for format in WireFormat::ALL {
        let packet = ControlPacket { sequence: 0x21, message: ControlMessage::End }.encode(format).unwrap();
        assert_eq!(packet.as_slice(), [0x21, b'E']);
    }
}

/// RobWork: the torque of the second axis was not initialised, and arbitrary memory was sent.
#[test]
fn no_axis_carries_a_left_over_torque() {
    let message = moving([1.0, -1.0, 2.0, -2.0, 6.0, -6.0, 0.5]);
    let a = message.encode_data(WireFormat::LittleEndian5x8).unwrap();
    let b = message.encode_data(WireFormat::BigEndian6x10).unwrap();
    for axis in 0..7 {
        assert_eq!(a[5 * axis + 1..5 * axis + 3], [0, 0], "axis {axis}");
        assert_eq!(b[6 * axis + 2..6 * axis + 4], [0, 0], "axis {axis}");
    }
}

/// RobWork: a negative speed was cast to an unsigned number, which is undefined.
#[test]
fn negative_speeds_keep_their_sign() {
    for joint in 0..7 {
        let mut velocity = [0.0; 7];
        velocity[joint] = -0.7;
        for format in WireFormat::ALL {
            let packet = ControlPacket { sequence: 0, message: moving(velocity) };
            let back = ControlPacket::decode(format, &packet.encode(format).unwrap()).unwrap();
            let ControlMessage::Cyclic(command) = back.message else { panic!("{back:?}") };
            assert_eq!(command.axes[joint], AxisCommand::Speed(SpeedCounts(-3500)), "{format}");
        }
    }
}

/// RobWork: every message had sequence number 0, so an old reply could not be distinguished from a new one.
#[test]
fn a_stale_reply_is_noticed() {
    for modulus in [SequenceModulus::Modulo128, SequenceModulus::Modulo256] {
        let format = WireFormat::LittleEndian5x8;
        for count in 0..300 {
            let packet = |count| ControlPacket { sequence: modulus.reduce(count), message: moving([0.0; 7]) };
            let (old, new) = (packet(count), packet(count + 1));
            let late = cyclic_reply(format, old.sequence, &[0; 8]);
            let expected = CodecError::Sequence { got: old.sequence, expected: new.sequence };
            assert_eq!(ReplyPacket::decode(format, &new, &late), Err(expected));
        }
    }
}

/// Orca: alarm codes were tested as bit masks, which confuses alarms.
#[test]
fn alarms_are_codes_and_not_masks() {
    for &raised in ServoAlarm::LISTED {
        let word = ServoWord(0xC003).with_alarm(raised);
        assert_eq!(word.alarm(), Some(raised));
        assert!(
            word.at_positive_limit() && word.at_negative_limit() && word.is_uncontrollable() && word.is_power_off()
        );
    }
    // Over-current contains all bits of velocity deviation, a communication time-out those of every alarm.
    assert_eq!(ServoWord(0x00E0).alarm(), Some(ServoAlarm::OverCurrent));
    assert_eq!(ServoWord(0x0060).alarm(), Some(ServoAlarm::VelocityDeviation));
    assert_eq!(ServoWord(0x0FF0).alarm(), Some(ServoAlarm::CommunicationTimeout));
    assert_eq!(ServoWord(0xF00F).alarm(), None);
    // An unlisted code is an alarm as well.
    assert_eq!(ServoWord(0x0420).alarm(), Some(ServoAlarm::Unlisted(0x42)));
}

/// Orca: the test program cleared the alarms of axes 0 to 6; the controller counts 1 to 7.
#[test]
fn alarms_are_cleared_on_axes_one_to_seven() {
    let numbers =
        Axis::ALL.map(|axis| ControlMessage::ClearAlarm(axis).encode_data(WireFormat::BigEndian6x10).unwrap());
    let expected: [[u8; 2]; 7] = [[0, 1], [0, 2], [0, 3], [0, 4], [0, 5], [0, 6], [0, 7]];
    assert_eq!(numbers.map(|data| [data[0], data[1]]), expected);
    assert_eq!(Axis::from_number(0), Err(CodecError::AxisNumber { got: 0 }));
    assert_eq!(Axis::from_number(8), Err(CodecError::AxisNumber { got: 8 }));
    let decoded = ControlMessage::decode_data(WireFormat::BigEndian6x10, Letter::ClearAlarm, &[0, 0]);
    assert_eq!(decoded, Err(CodecError::AxisNumber { got: 0 }));
}

/// SDU: measured torques were decoded as unsigned numbers and never were negative.
#[test]
fn torques_are_signed() {
    let a = WireFormat::LittleEndian5x8;
    let b = WireFormat::BigEndian6x10;
    for (format, axis_bytes) in
        [(a, &[0, 0, 0, 0, 0, 0, 0x18, 0xFC][..]), (b, &[0, 0, 0, 0, 0, 0, 0, 0, 0xFC, 0x18][..])]
    {
        let asked = ControlPacket { sequence: 1, message: moving([0.0; 7]) };
        let reply = ReplyPacket::decode(format, &asked, &cyclic_reply(format, 1, axis_bytes)).unwrap();
        let ReplyMessage::Cyclic(arm) = reply.message else { panic!("{reply:?}") };
        assert_eq!(arm.axes.map(|axis| axis.torque.0), [-1000; 7], "{format}");
    }
}

/// NTUA: angle differences were wrapped to half a turn, although E2 and W2 turn by 255 degrees in both directions.
#[test]
fn angles_beyond_half_a_turn_are_not_wrapped() {
    for degrees in [181.0f64, 254.9, -254.9, 539.0] {
        let counts = AngleCounts::from_rad(Axis::ALL[4], degrees.to_radians()).unwrap();
        assert!((counts.to_rad().to_degrees() - degrees).abs() < 0.001, "{degrees}");
    }
}

/// Orca wrote the same number into the torque and the speed field.
#[test]
fn a_command_with_an_unused_field_in_use_is_refused() {
    let format = WireFormat::BigEndian6x10;
    let mut data = moving([0.1; 7]).encode_data(format).unwrap().as_slice().to_vec();
    data[6 * 4 + 2..6 * 4 + 4].copy_from_slice(&500i16.to_be_bytes());
    let error = ControlMessage::decode_data(format, Letter::Cyclic, &data).unwrap_err();
    assert_eq!(error, CodecError::NotZero { axis: Axis::ALL[4], field: "torque", value: 500 });
}

/// A speed out of the range of its field was clamped, wrapped or undefined in other drivers: here it is refused by name.
#[test]
fn impossible_speeds_are_refused() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 6.5536, -6.5538, 1e300] {
        let mut velocity = JointVector::repeat(0.1);
        velocity[5] = bad;
        let error = ArmCommand::velocities(&velocity, Supervision::default()).unwrap_err();
        assert!(matches!(error, CodecError::SpeedRange { axis, .. } if axis == Axis::ALL[5]), "{bad}: {error}");
        assert!(error.to_string().starts_with("axis 6 (W1): "), "{error}");
    }
}

/// An axis with neither brake nor servo falls; torque control and bits with a disputed meaning are not used.
#[test]
fn modes_that_let_an_axis_fall_are_refused() {
    let a = WireFormat::LittleEndian5x8;
    for mode in [0x00, 0x04, 0x06, 0x08, 0x0A, 0xFF] {
        let mut data = moving([0.0; 7]).encode_data(a).unwrap().as_slice().to_vec();
        data[5 * 2] = mode;
        let error = ControlMessage::decode_data(a, Letter::Cyclic, &data).unwrap_err();
        assert_eq!(error, CodecError::Mode { axis: Axis::ALL[2], mode: u16::from(mode) });
    }
    let mut data = moving([0.0; 7]).encode_data(a).unwrap().as_slice().to_vec();
    data[0] = 0x01;
    data[3] = 1;
    let error = ControlMessage::decode_data(a, Letter::Cyclic, &data).unwrap_err();
    assert_eq!(error, CodecError::NotZero { axis: Axis::ALL[0], field: "speed against the brake", value: 1 });
}

/// Letters that change the controller's memory (M, W, P) do not exist, and T only in a build with its feature.
#[test]
fn dangerous_letters_do_not_exist() {
    let allowed: &[u8] = if cfg!(feature = "brake-release") { b"SCEART" } else { b"SCEAR" };
    for byte in 0..=u8::MAX {
        assert_eq!(Letter::from_byte(byte).is_ok(), allowed.contains(&byte), "{byte:#04x}");
        if let Ok(letter) = Letter::from_byte(byte) {
            assert_eq!(letter.byte(), byte);
        }
    }
    let error = ControlPacket::decode(WireFormat::BigEndian6x10, &[0, b'M', 0, 0]).unwrap_err();
    assert_eq!(error, CodecError::Letter { got: b'M' });
}

/// RobWork: waited for a reply for ever.
#[test]
fn a_reply_that_never_comes_is_not_waited_for_for_ever() {
    let mut bench = Bench::new();
    bench.peer.answers = false;
    bench.request(Request::Connect);
    bench.run(Duration::from_secs(2));
    assert_eq!(bench.driver.state(), DriverState::Fault);
    assert_eq!(
        bench.driver.latched().map(|latched| latched.trip),
        Some(Trip::Fault(FaultCause::LinkLost { misses: 3 }))
    );
}

/// Orca: the predicate for warnings was tested twice and that for faults never, so servo faults went unnoticed.
#[test]
fn a_servo_fault_stops_the_arm() {
    for axis in 0..7 {
        for &alarm in ServoAlarm::LISTED {
            let mut bench = Bench::in_state(DriverState::Holding);
            bench.peer.servo[axis] = ServoWord(0).with_alarm(alarm);
            bench.run(CYCLE * 3);
            assert!(bench.driver.state().is_latched(), "axis {axis}: {alarm}");
        }
    }
}

/// Orca: the destructor sent the stop only when motion was not enabled.
#[test]
fn a_stop_is_sent_while_the_arm_moves() {
    let mut bench = Bench::in_state(DriverState::Moving);
    let from = bench.sent.len();
    bench.request(Request::Stop);
    bench.settle();
    let kinds = bench.only_kinds_since(from);
    assert_eq!(kinds, [Kind::Motion, Kind::Rest, Kind::Braked, Kind::Off, Kind::End]);
}

/// PA10ros: sent E and S before every command, which closes and opens the brakes each time.
#[test]
fn commands_follow_each_other_without_leaving_the_control_mode() {
    let mut bench = Bench::in_state(DriverState::Moving);
    let from = bench.sent.len();
    bench.run_moving(Duration::from_secs(1));
    bench.request(Request::Hold);
    bench.run(Duration::from_secs(1));
    bench.request(Request::Move(velocity()));
    bench.run_moving(Duration::from_secs(1));
    assert_eq!(bench.only_kinds_since(from), [Kind::Motion, Kind::Rest, Kind::Motion]);
}

/// NTUA: an error of the link ended the program without a stop.
#[test]
fn a_broken_link_does_not_end_without_a_stop() {
    let mut bench = Bench::in_state(DriverState::Moving);
    let from = bench.sent.len();
    bench.driver.handle_unplugged(bench.now);
    bench.settle();
    assert_eq!(bench.only_kinds_since(from).last(), Some(&Kind::End));
}
