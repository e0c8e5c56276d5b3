//! The gateway, all states by all messages: the expectations are read from the tables of docs/arm-protocol.md.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use pb3dp_arm_pa10_gateway::gateway::table::{GatewayAction, HostRequest, action};
use pb3dp_arm_pa10_protocol::codec::{Axis, ControlMessage, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, ArmOperation, Control, ControlReply, Dialect, DriveMode, Frame, GatewayMessage, GatewayState, HostMessage,
    Payload, RejectReason, State, StopCause,
};
use pb3dp_arm_pa10_test_support::gateway_bench::{ARM, Bench, config, control, hello, ms, raw, rejected, velocity};
use pb3dp_kinematics::JointVector;

const SPECIFICATION: &str = include_str!("../../../docs/arm-protocol.md");

const STATES: [GatewayState; 7] = [
    GatewayState::Idle,
    GatewayState::Started,
    GatewayState::Holding,
    GatewayState::Moving,
    GatewayState::Stopping,
    GatewayState::Fault,
    GatewayState::EmergencyStop,
];

/// The meaning of a table cell.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Expected {
    /// Refused as `wrong-state`, and nothing is sent.
    WrongState,
    /// Answered as done, in this state; these letters are sent on the bus in addition to those of the cycle.
    Done(GatewayState, &'static str),
    /// A command is followed, in this state.
    Follow(GatewayState),
    /// STATE without a change.
    Show,
}

/// The cells of the row of a state: COMMAND, start, end, clear-alarm and read-eeprom, stop, reset, abort.
fn row(state: GatewayState) -> Vec<String> {
    let table = SPECIFICATION.split("## What the gateway does in each state").nth(1).unwrap();
    let row = table.lines().filter(|line| line.starts_with("| ")).find(|line| {
        let first = line.split('|').nth(1).unwrap();
        first.split(',').any(|name| name.trim() == state.to_string())
    });
    let cells = row.unwrap().split('|').map(|cell| cell.trim().to_owned()).collect::<Vec<_>>();
    assert_eq!(cells.len(), 10, "{cells:?}");
    cells[2..9].to_vec()
}

/// The expectation in the cell of an operation, for a gateway whose brakes and stop order had their time.
fn of_operation(cell: &str, state: GatewayState, letter: &'static str) -> Expected {
    use GatewayState::{Fault, Idle, Started, Stopping};
    match cell {
        "wrong-state" => Expected::WrongState,
        "done, nothing sent" | "done, goes on" => Expected::Done(state, ""),
        "S, to started" => Expected::Done(Started, "S"),
        "E, to idle, if the brakes had their time to close, else wrong-state" => Expected::Done(Idle, "E"),
        "A or R" | "A or R, once the stop order is done, else wrong-state" => Expected::Done(state, letter),
        "stop order" => Expected::Done(Stopping, ""),
        "E, to fault" | "stop order, to fault" | "goes on, to fault" => Expected::Done(Fault, ""),
        "once the stop order is done: to idle if the cause is gone, else cause-present; before: wrong-state" => {
            Expected::Done(Idle, "SCE")
        }
        other => panic!("the document has a new cell: {other}"),
    }
}

/// The expectations in the cell of COMMAND for four commands: off, braked, follow with speeds 0, follow with a speed.
fn of_commands(cell: &str) -> [Expected; 4] {
    use Expected::{Follow, Show, WrongState};
    use GatewayState::{Holding, Moving, Started};
    match cell {
        "wrong-state" => [WrongState; 4],
        "not done, STATE" => [Show; 4],
        "off, braked: as told; follow with speeds 0: to holding; follow with a speed: wrong-state" => {
            [Follow(Started), Follow(Started), Follow(Holding), WrongState]
        }
        "follow with speeds 0: as told; follow with a speed: to moving if the brakes had their time to open, else wrong-state; \
         off, braked: to started if the speeds sent are 0, else wrong-state" => {
            [Follow(Started), Follow(Started), Follow(Holding), Follow(Moving)]
        }
        "follow: as told, with speeds 0 to holding; off, braked: wrong-state" => {
            [WrongState, WrongState, Follow(Holding), Follow(Moving)]
        }
        other => panic!("the document has a new cell: {other}"),
    }
}

fn commands() -> [(DriveMode, JointVector); 4] {
    let rest = JointVector::zeros();
    [(DriveMode::Off, rest), (DriveMode::Braked, rest), (DriveMode::Follow, rest), (DriveMode::Follow, velocity())]
}

fn bench(dialect: Dialect, format: WireFormat, state: GatewayState) -> Bench {
    let mut bench = Bench::greeted(config(format), dialect);
    if format == WireFormat::LittleEndian5x8 && matches!(state, GatewayState::Fault | GatewayState::EmergencyStop) {
        // Format A has no alarms.
        bench.lead_to(GatewayState::Moving);
        bench.run(ms(400));
    } else {
        bench.lead_to(state);
    }
    bench.sent.clear();
    bench
}

/// Both dialects, and both formats in the dialect that shows them.
const KINDS: [(Dialect, WireFormat); 3] = [
    (Dialect::GatewayV1, WireFormat::BigEndian6x10),
    (Dialect::Transparent, WireFormat::BigEndian6x10),
    (Dialect::Transparent, WireFormat::LittleEndian5x8),
];

#[test]
fn every_command_in_every_state_is_answered_as_the_document_says() {
    for (dialect, format) in KINDS {
        for state in STATES {
            let expected = of_commands(&row(state)[0]);
            for ((mode, speeds), expected) in commands().into_iter().zip(expected) {
                let mut bench = bench(dialect, format, state);
                let before = bench.state();
                let asked = bench.command(mode, speeds);
                let answer = bench.ask(asked);
                let what = format!("{dialect}, {format}, {state}, {mode} {}: {answer:?}", speeds[0]);
                let transparent = dialect == Dialect::Transparent;
                match expected {
                    // In RAW a message that is only shown is refused.
                    Expected::Show if transparent => {
                        assert_eq!(rejected(answer), (RejectReason::WrongState, before.code().into()), "{what}");
                    }
                    Expected::Show => {
                        let GatewayMessage::State(shown) = answer else { panic!("{what}") };
                        assert_eq!((shown.gateway, bench.state()), (before, before), "{what}");
                    }
                    Expected::Follow(next) => {
                        assert_eq!(bench.state(), next, "{what}");
                        match answer {
                            GatewayMessage::State(State { gateway, .. }) => assert_eq!(gateway, next, "{what}"),
                            GatewayMessage::RawReply(raw) => assert_eq!(raw.letter, b'C', "{what}"),
                            _ => panic!("{what}"),
                        }
                    }
                    _ => {
                        assert_eq!(rejected(answer), (RejectReason::WrongState, before.code().into()), "{what}");
                        assert_eq!(bench.state(), before, "{what}");
                    }
                }
            }
        }
    }
}

#[test]
fn every_operation_in_every_state_is_answered_as_the_document_says() {
    let axis = Axis::ALL[4];
    let arm = Control::Arm;
    let operations = [
        (1, arm(ArmOperation::Start), ""),
        (2, arm(ArmOperation::End), ""),
        (3, Control::ClearAlarm(axis), "A"),
        (3, Control::ReadEeprom(axis), "R"),
        (4, arm(ArmOperation::Stop), ""),
        (5, arm(ArmOperation::Reset), ""),
        (6, arm(ArmOperation::Abort), ""),
    ];
    for state in STATES {
        for (column, operation, letter) in operations {
            let mut bench = bench(Dialect::GatewayV1, WireFormat::BigEndian6x10, state);
            let answer = bench.ask(HostMessage::Control(operation));
            let what = format!("{state}, {operation:?}: {answer:?}");
            let letters = bench.letters();
            match of_operation(&row(state)[column], state, letter) {
                Expected::WrongState => {
                    assert_eq!(rejected(answer), (RejectReason::WrongState, state.code().into()), "{what}");
                    assert_eq!(bench.state(), state, "{what}");
                }
                Expected::Done(next, expected) => {
                    assert_eq!(bench.state(), next, "{what}");
                    match answer {
                        GatewayMessage::ControlReply(ControlReply { control, state }) => {
                            assert_eq!((control, state), (operation, next), "{what}");
                        }
                        GatewayMessage::EepromLimits(limits) => {
                            assert_eq!(operation, Control::ReadEeprom(limits.axis), "{what}");
                            assert_eq!(limits.positive_limit_urad, 2_999_999, "{what}");
                        }
                        _ => panic!("{what}"),
                    }
                    let cycle = matches!(state, GatewayState::Started | GatewayState::Stopping) || expected == "S";
                    let besides = letters.trim_matches(|letter| cycle && letter == 'C');
                    assert_eq!(besides, expected, "{what}");
                }
                other => panic!("{other:?}"),
            }
        }
    }
}

/// The same with the letters of the dialect `transparent`.
#[test]
fn every_letter_in_every_state_is_answered_as_the_document_says() {
    let axis = Axis::ALL[4];
    for format in WireFormat::ALL {
        let data = |message: ControlMessage| message.encode_data(format).unwrap();
        let letters = [
            (1, ControlMessage::Start, ""),
            (2, ControlMessage::End, ""),
            (3, ControlMessage::ClearAlarm(axis), "A"),
            (3, ControlMessage::ReadEeprom(axis), "R"),
        ];
        for state in STATES {
            for (column, message, letter) in letters {
                let mut bench = bench(Dialect::Transparent, format, state);
                let before = bench.state();
                let byte = message.letter().byte();
                let answer = bench.ask(raw(byte, &data(message)));
                let what = format!("{format}, {state}, {}: {answer:?}", char::from(byte));
                match of_operation(&row(state)[column], state, letter) {
                    Expected::WrongState => {
                        assert_eq!(rejected(answer), (RejectReason::WrongState, before.code().into()), "{what}");
                        assert_eq!(bench.state(), before, "{what}");
                    }
                    Expected::Done(next, expected) => {
                        let next = if state == next { before } else { next };
                        assert_eq!(bench.state(), next, "{what}");
                        let GatewayMessage::RawReply(reply) = answer else { panic!("{what}") };
                        assert_eq!(reply.letter, byte, "{what}");
                        let is_table = byte == b'R';
                        assert_eq!(reply.data.len(), if is_table { 66 } else { 0 }, "{what}");
                        let besides = bench.letters().replace('C', "");
                        assert_eq!(besides, expected, "{what}");
                    }
                    other => panic!("{other:?}"),
                }
            }
        }
    }
}

#[test]
fn stop_reset_and_abort_exist_in_both_dialects_and_the_rest_in_its_own() {
    for state in STATES {
        for (column, operation) in [(4, ArmOperation::Stop), (5, ArmOperation::Reset), (6, ArmOperation::Abort)] {
            let mut bench = bench(Dialect::Transparent, WireFormat::BigEndian6x10, state);
            let answer = bench.ask(control(operation));
            match of_operation(&row(state)[column], state, "") {
                Expected::WrongState => assert_eq!(rejected(answer).0, RejectReason::WrongState),
                _ => assert!(matches!(answer, GatewayMessage::ControlReply(_)), "{state}, {operation:?}: {answer:?}"),
            }
        }
        for operation in [
            Control::Arm(ArmOperation::Start),
            Control::Arm(ArmOperation::End),
            Control::ClearAlarm(Axis::ALL[0]),
            Control::ReadEeprom(Axis::ALL[0]),
        ] {
            let mut bench = bench(Dialect::Transparent, WireFormat::BigEndian6x10, state);
            let answer = bench.ask(HostMessage::Control(operation));
            assert_eq!(rejected(answer), (RejectReason::WrongDialect, 1), "{state}, {operation:?}");
        }
        let mut bench = bench(Dialect::GatewayV1, WireFormat::BigEndian6x10, state);
        assert_eq!(rejected(bench.ask(raw(b'S', &[]))), (RejectReason::WrongDialect, 2), "{state}");
        let mut bench = self::bench(Dialect::Transparent, WireFormat::BigEndian6x10, state);
        let command =
            HostMessage::Command(pb3dp_arm_pa10_protocol::gateway_protocol::DriveCommand::at_rest(DriveMode::Off));
        assert_eq!(rejected(bench.ask(command)), (RejectReason::WrongDialect, 1), "{state}");
    }
}

/// The rows of the document again, against the table in the code.
#[test]
fn the_table_of_the_code_is_that_of_the_document() {
    for state in STATES {
        let row = row(state);
        let commands = of_commands(&row[0]);
        assert_eq!(commands[0], commands[1]);
        for (request, expected) in HostRequest::ALL.into_iter().zip([
            commands[0],
            commands[2],
            commands[3],
            of_operation(&row[1], state, ""),
            of_operation(&row[2], state, ""),
            of_operation(&row[3], state, "AR"),
            of_operation(&row[4], state, ""),
            of_operation(&row[5], state, ""),
            of_operation(&row[6], state, ""),
        ]) {
            let expected = match expected {
                Expected::WrongState => GatewayAction::Refuse,
                Expected::Follow(next) => GatewayAction::Follow(next),
                Expected::Show => GatewayAction::Show,
                Expected::Done(GatewayState::Stopping, _) if state != GatewayState::Stopping => {
                    GatewayAction::BeginStop
                }
                Expected::Done(GatewayState::Fault, "") if state != GatewayState::Fault => GatewayAction::Latch,
                Expected::Done(_, "") => GatewayAction::Nothing,
                Expected::Done(..) => GatewayAction::Speak,
            };
            assert_eq!(action(state, request), expected, "{state}, {request:?}");
        }
    }
}

#[test]
fn hello_and_heartbeat_are_answered_in_every_state_and_change_none() {
    for state in STATES {
        let mut bench = bench(Dialect::GatewayV1, WireFormat::BigEndian6x10, state);
        let GatewayMessage::Health(health) = bench.ask(HostMessage::Heartbeat) else { panic!("{state}") };
        assert_eq!((health.state, health.cause), (state, bench.cause()));
        let GatewayMessage::HelloReply(reply) = bench.ask(hello(Dialect::GatewayV1)) else { panic!("{state}") };
        assert_eq!((reply.state, reply.cause, reply.dialect), (state, bench.cause(), Dialect::GatewayV1));
        // Detected from the replies to the stop order at the start.
        assert_eq!(reply.wire_format, Some(WireFormat::BigEndian6x10), "{state}");
        assert_eq!(bench.state(), state);
        let answer = bench.ask(hello(Dialect::Transparent));
        if matches!(state, GatewayState::Holding | GatewayState::Moving | GatewayState::Stopping) {
            assert_eq!(rejected(answer), (RejectReason::WrongState, state.code().into()));
            assert_eq!(bench.gateway.status().host, Some(Dialect::GatewayV1));
        } else {
            assert!(matches!(answer, GatewayMessage::HelloReply(reply) if reply.dialect == Dialect::Transparent));
        }
        assert_eq!(bench.state(), state);
    }
}

#[test]
fn before_the_first_hello_everything_else_is_refused() {
    let mut bench = Bench::silent(config(WireFormat::BigEndian6x10));
    let follow = bench.command(DriveMode::Off, JointVector::zeros());
    for message in [HostMessage::Heartbeat, control(ArmOperation::Start), raw(b'S', &[]), follow] {
        assert_eq!(rejected(bench.ask(message)), (RejectReason::NotConnected, 0), "{message:?}");
    }
    bench.run(ms(20));
    assert_eq!(bench.letters(), "");
}

/// Each row of the table of errors whose answer is REJECT.
#[test]
fn every_kind_of_bad_frame_is_refused_with_its_reason_and_detail_and_changes_nothing() {
    for state in STATES {
        let mut bench = bench(Dialect::GatewayV1, WireFormat::BigEndian6x10, state);
        let good = bench.frame_of(&HostMessage::Heartbeat);
        let payload = |bytes: &[u8]| Payload::from_slice(bytes).unwrap();
        let with = |frame_type: u8, bytes: &[u8]| Frame { frame_type, payload: payload(bytes), ..good };
        let mut command = [0; 29];
        (command[0], command[1]) = (1, 1);
        let mut fast = [0; 29];
        fast[0] = 2;
        fast[1..5].copy_from_slice(&6_553_700i32.to_le_bytes());
        for (frame, expected) in [
            (Frame { arm: ArmId(9), ..good }, (RejectReason::WrongArm, 9)),
            (with(0x06, &[]), (RejectReason::UnknownType, 0)),
            (with(0x84, &[]), (RejectReason::UnknownType, 0)),
            (with(0x04, &[0]), (RejectReason::WrongLength, 0)),
            (with(0x02, &[0; 28]), (RejectReason::WrongLength, 29)),
            (with(0x03, &[1]), (RejectReason::WrongLength, 2)),
            (with(0x03, &[8, 0]), (RejectReason::BadValue, 0)),
            (with(0x03, &[7, 1]), (RejectReason::BadValue, 0)),
            (with(0x03, &[1, 1]), (RejectReason::BadValue, 0)),
            (with(0x03, &[3, 0]), (RejectReason::BadValue, 0)),
            (with(0x02, &[3; 29]), (RejectReason::BadValue, 0)),
            // A speed with closed brakes, and one out of the range of the controller.
            (with(0x02, &command), (RejectReason::BadValue, 0)),
            (with(0x02, &fast), (RejectReason::BadValue, 0)),
            (with(0x01, &[2, 0x10, 0x27, 0, 0]), (RejectReason::WrongLength, 76)),
            (with(0x01, &[3; 76]), (RejectReason::BadValue, 0)),
            (with(0x01, &[2; 76]), (RejectReason::BadValue, 0)),
        ] {
            let sequence = bench.sequence.wrapping_add(1);
            if frame.arm == ARM && frame.frame_type != 0x01 {
                bench.sequence = sequence;
            }
            let answer = bench.ask_frame(&Frame { sequence, ..frame });
            assert_eq!(rejected(answer), expected, "{state}, {frame:?}");
            assert_eq!(bench.state(), state);
        }
        let repeated = Frame { sequence: bench.sequence, ..good };
        assert_eq!(rejected(bench.ask_frame(&repeated)), (RejectReason::Stale, 0), "{state}");
        assert_eq!(bench.state(), state);
    }
}

#[test]
fn forbidden_letters_and_bad_data_are_refused_in_transparent() {
    let mut bench = bench(Dialect::Transparent, WireFormat::LittleEndian5x8, GatewayState::Holding);
    bench.sent.clear();
    let mut neither = [0u8; 35];
    neither.chunks_exact_mut(5).for_each(|axis| axis[0] = 1);
    neither[0] = 0;
    let mut torque = neither;
    (torque[0], torque[1]) = (2, 1);
    for letter in *b"MWPTXcs\0" {
        assert_eq!(rejected(bench.ask(raw(letter, &[0, 0]))), (RejectReason::ForbiddenLetter, letter.into()));
    }
    for (letter, data, expected) in [
        (b'C', &[1u8; 34][..], (RejectReason::WrongLength, 36)),
        (b'C', &neither, (RejectReason::BadValue, 0)),
        (b'C', &torque, (RejectReason::BadValue, 0)),
        (b'S', &[1], (RejectReason::WrongLength, 1)),
        (b'A', &[0, 8], (RejectReason::BadValue, 0)),
        (b'R', &[5, 0], (RejectReason::BadValue, 0)),
        (b'R', &[1], (RejectReason::WrongLength, 3)),
    ] {
        assert_eq!(rejected(bench.ask(raw(letter, data))), expected, "{letter} {data:?}");
    }
    assert_eq!(bench.state(), GatewayState::Holding);
    assert!(bench.letters().chars().all(|letter| letter == 'C'), "{}", bench.letters());
    assert_eq!(bench.cause(), StopCause::None);
}
