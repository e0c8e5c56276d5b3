//! Properties of all messages and all bytes.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmCommand, ArmReply, Axis, AxisCommand, AxisReply, AxisStatus, CommStatus, CommWord, ControlMessage,
    ControlPacket, ReplyMessage, ReplyPacket, ServoWord, SpeedCounts, Supervision, TorqueCounts, WireFormat,
};
use pb3dp_kinematics::JointVector;
use proptest::prelude::*;

fn formats() -> impl Strategy<Value = WireFormat> {
    proptest::sample::select(WireFormat::ALL.to_vec())
}

fn axis_commands() -> impl Strategy<Value = AxisCommand> {
    prop_oneof![
        Just(AxisCommand::Off),
        Just(AxisCommand::Braked),
        any::<i16>().prop_map(|counts| AxisCommand::Speed(SpeedCounts(counts))),
    ]
}

/// A message and a wire format that can encode it.
fn messages() -> impl Strategy<Value = (WireFormat, ControlMessage)> {
    let axis = proptest::sample::select(Axis::ALL.to_vec());
    let command = (prop::array::uniform7(axis_commands()), any::<bool>(), any::<bool>());
    let message = prop_oneof![
        Just(ControlMessage::Start),
        Just(ControlMessage::End),
        axis.clone().prop_map(ControlMessage::ClearAlarm),
        axis.prop_map(ControlMessage::ReadEeprom),
        command.prop_map(|(axes, other_axes, dead_man)| {
            ControlMessage::Cyclic(ArmCommand { axes, supervision: Supervision { other_axes, dead_man } })
        }),
    ];
    (formats(), message).prop_map(|(format, mut message)| {
        if let (WireFormat::LittleEndian5x8, ControlMessage::Cyclic(command)) = (format, &mut message) {
            command.supervision = Supervision::default();
        }
        (format, message)
    })
}

fn replies() -> impl Strategy<Value = (WireFormat, ArmReply)> {
    let axis = (any::<u16>(), any::<i32>(), any::<i16>(), any::<i16>());
    (formats(), prop::array::uniform7(axis), any::<u16>()).prop_map(|(format, axes, comm)| {
        let documented = format == WireFormat::BigEndian6x10;
        let axes = axes.map(|(status, angle, speed, torque)| AxisReply {
            status: if documented { AxisStatus::Servo(ServoWord(status)) } else { AxisStatus::Undocumented(status) },
            angle: AngleCounts(angle),
            speed: documented.then_some(SpeedCounts(speed)),
            torque: TorqueCounts(torque),
        });
        let comm = if documented { CommStatus::Comm(CommWord(comm)) } else { CommStatus::Undocumented(comm) };
        (format, ArmReply { axes, comm })
    })
}

fn cyclic() -> ControlMessage {
    ControlMessage::Cyclic(ArmCommand::uniform(AxisCommand::Off, Supervision::default()))
}

proptest! {
    #[test]
    fn every_message_comes_back((format, message) in messages(), sequence: u8) {
        let packet = ControlPacket { sequence, message };
        prop_assert_eq!(ControlPacket::decode(format, &packet.encode(format).unwrap()), Ok(packet));
    }

    #[test]
    fn every_reply_comes_back((format, arm) in replies(), sequence: u8) {
        let reply = ReplyPacket { sequence, message: ReplyMessage::Cyclic(arm) };
        let asked = ControlPacket { sequence, message: cyclic() };
        prop_assert_eq!(ReplyPacket::decode(format, &asked, &reply.encode(format).unwrap()), Ok(reply));
    }

    #[test]
    fn what_is_accepted_as_a_message_has_one_form(format in formats(), bytes in prop::collection::vec(any::<u8>(), 0..60)) {
        if let Ok(packet) = ControlPacket::decode(format, &bytes) {
            let again = packet.encode(format).unwrap();
            prop_assert_eq!(again.as_slice(), &bytes[..]);
        }
    }

    #[test]
    fn a_damaged_command_is_refused_or_another_command((format, message) in messages(), at in 0usize..46, flip in 1u8..) {
        let packet = ControlPacket { sequence: 5, message };
        let mut bytes = packet.encode(format).unwrap().as_slice().to_vec();
        let at = at % bytes.len();
        bytes[at] ^= flip;
        if let Ok(other) = ControlPacket::decode(format, &bytes) {
            prop_assert_ne!(other, packet);
            let again = other.encode(format).unwrap();
            prop_assert_eq!(again.as_slice(), &bytes[..]);
        }
    }

    #[test]
    fn every_reply_of_the_right_length_has_one_form(format in formats(), body in prop::collection::vec(any::<u8>(), 72)) {
        let mut bytes = vec![9, b'C'];
        bytes.extend(&body[..format.reply_length()]);
        let asked = ControlPacket { sequence: 9, message: cyclic() };
        let reply = ReplyPacket::decode(format, &asked, &bytes).unwrap();
        let again = reply.encode(format).unwrap();
        prop_assert_eq!(again.as_slice(), &bytes[..]);
    }

    #[test]
    fn any_bytes_are_an_answer_or_an_error(
        (format, message) in messages(), sequence: u8, bytes in prop::collection::vec(any::<u8>(), 0..300)
    ) {
        let asked = ControlPacket { sequence, message };
        if let Ok(reply) = ReplyPacket::decode(format, &asked, &bytes) {
            prop_assert_eq!(reply.sequence, sequence);
        }
    }

    #[test]
    fn speeds_are_off_by_half_a_count_at_most_and_never_clamped(speed in -20.0f64..20.0, joint in 0usize..7) {
        let mut velocity = JointVector::zeros();
        velocity[joint] = speed;
        match ArmCommand::velocities(&velocity, Supervision::default()) {
            Ok(command) => {
                let error = command.velocity_rad_per_s() - velocity;
                prop_assert!(error.amax() <= 0.5 * 2e-4 * (1.0 + 1e-9), "{error}");
            }
            Err(error) => {
                prop_assert!(speed.abs() > 6.5534, "{speed}: {error}");
                let named = format!("axis {} ", joint + 1);
                prop_assert!(error.to_string().starts_with(&named), "{}", error);
            }
        }
    }

    #[test]
    fn angles_are_off_by_half_a_count_at_most(counts: i32, fraction in -0.49f64..0.49) {
        let axis = Axis::ALL[6];
        let angle = AngleCounts(counts).to_rad() + fraction * AngleCounts(1).to_rad();
        if counts > i32::MIN && counts < i32::MAX {
            prop_assert_eq!(AngleCounts::from_rad(axis, angle), Ok(AngleCounts(counts)));
        }
    }
}
