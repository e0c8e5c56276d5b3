//! The wire formats against bytes that were derived by hand from the layouts that the SDU and Orca drivers document.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmCommand, ArmReply, Axis, AxisCommand, AxisStatus, CodecError, CommAlarm, CommStatus, CommWord,
    ControlMessage, ControlPacket, EepromAxis, Letter, ReplyMessage, ReplyPacket, SequenceModulus, ServoAlarm,
    ServoWord, SpeedCounts, Supervision, TorqueCounts, TorqueScale, WireFormat, packet_pointer,
};
use pb3dp_kinematics::JointVector;

const A: WireFormat = WireFormat::LittleEndian5x8;
const B: WireFormat = WireFormat::BigEndian6x10;

fn hex(text: &str) -> Vec<u8> {
    text.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

fn velocities() -> ControlMessage {
    let velocity = JointVector::from([0.1, -0.1, 0.0, 0.0, 0.0, 0.0, 0.0]);
    ControlMessage::Cyclic(ArmCommand::velocities(&velocity, Supervision::default()).unwrap())
}

fn check_packet(format: WireFormat, message: ControlMessage, expected: &str) {
    let packet = ControlPacket { sequence: 0x5D, message };
    let bytes = packet.encode(format).unwrap();
    assert_eq!(bytes.as_slice(), hex(expected), "{message:?} in {format}");
    assert_eq!(ControlPacket::decode(format, &bytes).unwrap(), packet);
}

#[test]
fn a_cyclic_command_has_the_golden_bytes() {
    check_packet(
        A,
        velocities(),
        "5d 43 02 00 00 f4 01 02 00 00 0c fe 02 00 00 00 00 02 00 00 00 00 02 00 00 00 00 02 00 00 00 00 02 00 00 00 00",
    );
    check_packet(
        B,
        velocities(),
        "5d 43 00 02 00 00 01 f4 00 02 00 00 fe 0c 00 02 00 00 00 00 00 02 00 00 00 00 00 02 00 00 00 00 \
         00 02 00 00 00 00 00 02 00 00 00 00 00 00",
    );
}

#[test]
fn safe_commands_hold_the_brakes_and_carry_no_speed() {
    for (command, a, b) in [(AxisCommand::Off, 0x01, 0x01), (AxisCommand::Braked, 0x03, 0x03)] {
        let message = ControlMessage::Cyclic(ArmCommand::uniform(command, Supervision::default()));
        assert_eq!(message.encode_data(A).unwrap().as_slice(), [a, 0, 0, 0, 0].repeat(7));
        let mut expected = [0, b, 0, 0, 0, 0].repeat(7);
        expected.extend([0, 0]);
        assert_eq!(message.encode_data(B).unwrap().as_slice(), expected);
    }
}

#[test]
fn supervision_has_its_bits_in_format_b_and_none_in_format_a() {
    let all = Supervision { other_axes: true, dead_man: true };
    let message = ControlMessage::Cyclic(ArmCommand::uniform(AxisCommand::Off, all));
    let mut expected = [0x00, 0x11, 0, 0, 0, 0].repeat(7);
    expected.extend([0x00, 0x08]);
    assert_eq!(message.encode_data(B).unwrap().as_slice(), expected);
    assert_eq!(ControlMessage::decode_data(B, Letter::Cyclic, &expected).unwrap(), message);
    let error = message.encode_data(A).unwrap_err();
    assert_eq!(error, CodecError::NotInFormat { what: "supervision by the controller", format: A });
    expected[6 * 3 + 1] = 0x01;
    let error = ControlMessage::decode_data(B, Letter::Cyclic, &expected).unwrap_err();
    assert_eq!(error, CodecError::MixedSupervision { axis: Axis::ALL[3] });
}

#[test]
fn short_messages_have_the_golden_bytes_in_both_formats() {
    for format in WireFormat::ALL {
        check_packet(format, ControlMessage::Start, "5d 53");
        check_packet(format, ControlMessage::End, "5d 45");
        check_packet(format, ControlMessage::ClearAlarm(Axis::ALL[0]), "5d 41 00 01");
        check_packet(format, ControlMessage::ClearAlarm(Axis::ALL[6]), "5d 41 00 07");
        check_packet(format, ControlMessage::ReadEeprom(Axis::ALL[0]), "5d 52 01 00");
        check_packet(format, ControlMessage::ReadEeprom(Axis::ALL[1]), "5d 52 01 20");
        check_packet(format, ControlMessage::ReadEeprom(Axis::ALL[6]), "5d 52 04 00");
    }
}

#[test]
fn packets_start_where_the_chip_expects_them() {
    for (data_length, pointer) in [(0, 254), (2, 252), (35, 219), (44, 210), (252, 2)] {
        assert_eq!(packet_pointer(data_length), Ok(pointer));
    }
    assert_eq!(packet_pointer(253), Err(CodecError::PacketLength { got: 255 }));
    for (format, pointer) in [(A, 219), (B, 210)] {
        let data = velocities().encode_data(format).unwrap();
        assert_eq!(data.len(), format.command_length());
        assert_eq!(packet_pointer(data.len()), Ok(pointer));
    }
}

/// Angle of S1 +90, S2 -90, S3 +177, E1 -135, E2 +255, W1 0, W2 -255 degrees.
const ANGLES_COUNTS: [i32; 7] = [204_800, -204_800, 402_773, -307_200, 580_267, 0, -580_267];

#[test]
fn a_reply_of_format_a_has_the_golden_bytes() {
    let bytes = hex("5d 43 \
         00 00 00 20 03 00 9c ff \
         34 12 00 e0 fc ff 64 00 \
         00 00 55 25 06 00 00 80 \
         00 00 00 50 fb ff 00 00 \
         00 00 ab da 08 00 00 00 \
         00 00 00 00 00 00 00 00 \
         00 00 55 25 f7 ff ff 7f \
         cd ab");
    let asked = ControlPacket { sequence: 0x5D, message: velocities() };
    let reply = ReplyPacket::decode(A, &asked, &bytes).unwrap();
    let ReplyMessage::Cyclic(arm) = reply.message else { panic!("{reply:?}") };
    assert_eq!(arm.axes.map(|axis| axis.angle.0), ANGLES_COUNTS);
    assert_eq!(arm.axes.map(|axis| axis.torque.0), [-100, 100, i16::MIN, 0, 0, 0, i16::MAX]);
    assert_eq!(arm.axes[1].status, AxisStatus::Undocumented(0x1234));
    assert_eq!(arm.comm, CommStatus::Undocumented(0xABCD));
    assert_eq!(arm.velocity_rad_per_s(), None);
    assert_eq!(reply.encode(A).unwrap().as_slice(), bytes);
}

#[test]
fn a_reply_of_format_b_has_the_golden_bytes() {
    let bytes = hex("5d 43 \
         00 00 00 03 20 00 01 f4 ff 9c \
         00 60 ff fc e0 00 fe 0c 00 64 \
         00 01 00 06 25 55 00 00 80 00 \
         80 00 ff fb 50 00 00 00 00 00 \
         0f f0 00 08 da ab 00 00 00 00 \
         00 00 00 00 00 00 7a b8 00 00 \
         40 02 ff f7 25 55 85 48 7f ff \
         00 5a");
    let asked = ControlPacket { sequence: 0x5D, message: velocities() };
    let reply = ReplyPacket::decode(B, &asked, &bytes).unwrap();
    let ReplyMessage::Cyclic(arm) = reply.message else { panic!("{reply:?}") };
    assert_eq!(arm.axes.map(|axis| axis.angle.0), ANGLES_COUNTS);
    assert_eq!(arm.axes.map(|axis| axis.speed.unwrap().0), [500, -500, 0, 0, 0, 31416, -31416]);
    let alarms = arm.axes.map(|axis| match axis.status {
        AxisStatus::Servo(word) => word.alarm(),
        AxisStatus::Undocumented(_) => panic!("format B documents its status"),
    });
    let timeout = Some(ServoAlarm::CommunicationTimeout);
    assert_eq!(alarms, [None, Some(ServoAlarm::VelocityDeviation), None, None, timeout, None, None]);
    let CommStatus::Comm(comm) = arm.comm else { panic!("{:?}", arm.comm) };
    assert_eq!(comm.alarm(), Some(CommAlarm::HostTimeout));
    assert!(comm.is_power_too_warm() && comm.is_e_stop_switch_open() && !comm.is_dead_man_on());
    assert_eq!(reply.encode(B).unwrap().as_slice(), bytes);
}

#[test]
fn angles_and_speeds_have_their_golden_counts() {
    let axis = Axis::ALL[4];
    for (degrees, counts) in
        [(90.0f64, 204_800), (-90.0, -204_800), (177.0, 402_773), (255.0, 580_267), (-360.0, -819_200)]
    {
        assert_eq!(AngleCounts::from_rad(axis, degrees.to_radians()), Ok(AngleCounts(counts)));
        assert!((AngleCounts(counts).to_rad().to_degrees() - degrees).abs() <= 0.5 * 0.000_439_453_125);
    }
    assert!((AngleCounts(1).to_rad() - 7.669_903_939e-6).abs() < 1e-15);
    for (rad_per_s, counts) in
        [(0.1, 500), (-0.1, -500), (std::f64::consts::TAU, 31416), (6.5534, 32767), (-6.5536, -32768)]
    {
        assert_eq!(SpeedCounts::from_rad_per_s(axis, rad_per_s), Ok(SpeedCounts(counts)));
    }
}

#[test]
fn torques_have_the_scale_of_their_format() {
    let rated = [232.0, 232.0, 100.0, 100.0, 14.5, 14.5, 14.5];
    let (a, b) = (TorqueScale::of_format(A), TorqueScale::of_format(B));
    for axis in Axis::ALL {
        assert!((b.to_joint_n_m(axis, TorqueCounts(-4096)) + rated[axis.index()]).abs() < 1e-9, "{axis}");
        assert_eq!(b.from_joint_n_m(axis, rated[axis.index()]), Ok(TorqueCounts(4096)), "{axis}");
        assert!((a.to_joint_n_m(axis, TorqueCounts(-1000)) + 50.0).abs() < 1e-9, "{axis}");
    }
    assert!(
        b.from_joint_n_m(Axis::ALL[6], 200.0).unwrap_err().to_string().contains("axis 7 (W2): a torque of 200 N m")
    );
}

#[test]
fn the_eeprom_table_gives_the_limits() {
    let mut table = vec![0u8; 2 + 64];
    table[..2].copy_from_slice(&[2, 0x20]);
    // E1: words 19 to 24 and 28, low byte first within each word: +137 and -137 degrees, an offset, 2 poles.
    table[2 + 2 * 19..2 + 2 * 25].copy_from_slice(&hex("04 00 c7 c1 fb ff 39 3e 78 56 34 12"));
    table[2 + 2 * 28] = 2;
    let asked = ControlPacket { sequence: 9, message: ControlMessage::ReadEeprom(Axis::ALL[3]) };
    let mut bytes = vec![9, b'R'];
    bytes.extend(&table);
    let reply = ReplyPacket::decode(A, &asked, &bytes).unwrap();
    let ReplyMessage::Eeprom(read) = reply.message else { panic!("{reply:?}") };
    assert_eq!((read.positive_limit.0, read.negative_limit.0), (311_751, -311_751));
    assert!((read.positive_limit.to_rad().to_degrees() - 137.0).abs() < 0.001, "{read:?}");
    assert_eq!((read.zero_offset_raw, read.poles), (0x1234_5678, 2));
    assert_eq!(reply.encode(A).unwrap().as_slice(), bytes);

    bytes[2] = 3;
    let error = ReplyPacket::decode(A, &asked, &bytes).unwrap_err();
    assert_eq!(error, CodecError::EepromOfOtherAxis { axis: Axis::ALL[3], board: 3, start: 0x20 });
    bytes[2] = 2;
    bytes[4 + 2 * 21] = 0;
    let error = ReplyPacket::decode(A, &asked, &bytes).unwrap_err();
    assert!(matches!(error, CodecError::EepromLimits { axis, .. } if axis == Axis::ALL[3]), "{error}");
    let error = ReplyPacket::decode(A, &asked, &bytes[..40]).unwrap_err();
    assert_eq!(error, CodecError::Length { letter: 'R', got: 38, expected: 60 });
}

#[test]
fn a_reply_to_something_else_is_refused_by_name() {
    let asked = ControlPacket { sequence: 7, message: velocities() };
    let decode = |bytes: &[u8]| ReplyPacket::decode(B, &asked, bytes).unwrap_err();
    let mut reply = vec![7, b'C'];
    reply.resize(2 + 72, 0);

    assert_eq!(decode(&reply[..73]), CodecError::Length { letter: 'C', got: 71, expected: 72 });
    assert_eq!(decode(&reply[..60]), CodecError::OtherFormat { got: A, configured: B });
    assert_eq!(decode(&[7]), CodecError::PacketLength { got: 1 });
    assert_eq!(decode(&[7; 255]), CodecError::PacketLength { got: 255 });
    reply[1] = b'S';
    assert_eq!(decode(&reply), CodecError::ReplyLetter { got: b'S', expected: 'C' });
    reply[..2].copy_from_slice(&[6, b'C']);
    assert_eq!(decode(&reply), CodecError::Sequence { got: 6, expected: 7 });
    assert!(decode(&reply).to_string().contains("sequence number 6 to message 7: stale"));
}

#[test]
fn answers_to_short_messages_are_accepted_with_any_data() {
    for (message, letter) in
        [(ControlMessage::Start, Letter::Start), (ControlMessage::ClearAlarm(Axis::ALL[2]), Letter::ClearAlarm)]
    {
        let asked = ControlPacket { sequence: 3, message };
        for data in [&[][..], &[0, 3]] {
            let mut bytes = vec![3, letter.byte()];
            bytes.extend(data);
            let expected = ReplyPacket { sequence: 3, message: ReplyMessage::Done(letter) };
            assert_eq!(ReplyPacket::decode(A, &asked, &bytes), Ok(expected));
        }
    }
}

#[test]
fn sequence_numbers_run_through_their_modulus() {
    for (modulus, size) in [(SequenceModulus::Modulo128, 128u64), (SequenceModulus::Modulo256, 256)] {
        for count in (0..600).chain([70_000, u64::MAX]) {
            assert_eq!(u64::from(modulus.reduce(count)), count % size, "{modulus:?}");
        }
    }
}

#[test]
fn the_format_shows_in_the_length_of_a_reply() {
    assert_eq!(WireFormat::of_reply_length(58), Some(A));
    assert_eq!(WireFormat::of_reply_length(72), Some(B));
    assert_eq!(WireFormat::of_reply_length(0), None);
}

#[test]
fn a_reply_is_encoded_only_in_the_format_that_has_its_fields() {
    let with_speed = pb3dp_arm_pa10_protocol::codec::AxisReply {
        status: AxisStatus::Servo(ServoWord(0)),
        angle: AngleCounts(5),
        speed: Some(SpeedCounts(1)),
        torque: TorqueCounts(0),
    };
    let arm = ArmReply { axes: [with_speed; 7], comm: CommStatus::Comm(CommWord(0)) };
    let packet = ReplyPacket { sequence: 0, message: ReplyMessage::Cyclic(arm) };
    assert!(packet.encode(B).is_ok());
    assert!(matches!(packet.encode(A), Err(CodecError::NotInFormat { format: WireFormat::LittleEndian5x8, .. })));
    let table = EepromAxis {
        axis: Axis::ALL[6],
        positive_limit: AngleCounts(580_267),
        negative_limit: AngleCounts(-580_267),
        zero_offset_raw: -3,
        poles: 2,
    };
    let packet = ReplyPacket { sequence: 1, message: ReplyMessage::Eeprom(table) };
    let asked = ControlPacket { sequence: 1, message: ControlMessage::ReadEeprom(Axis::ALL[6]) };
    assert_eq!(ReplyPacket::decode(B, &asked, &packet.encode(B).unwrap()), Ok(packet));
}
