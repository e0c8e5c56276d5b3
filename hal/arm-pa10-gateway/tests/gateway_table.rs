//! The gateway, all states by all messages: the expectations are read from the tables of docs/arm-protocol.md.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use pb3dp_arm_pa10_gateway::gateway::table::{GatewayAction, HostRequest, action};
use pb3dp_arm_pa10_protocol::codec::{Axis, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, ArmOperation, Control, ControlReply, DriveMode, Frame, GatewayMessage, GatewayState, Hello, HostMessage,
    MotionLimits, Payload, RejectReason,
};
use pb3dp_arm_pa10_test_support::gateway_bench::{ARM, Bench, config, control, hello, ms, rejected, velocity};
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

fn bench(format: WireFormat, state: GatewayState) -> Bench {
    let mut bench = Bench::greeted(config(format));
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

#[test]
fn every_command_in_every_state_is_answered_as_the_document_says() {
    for format in WireFormat::ALL {
        for state in STATES {
            let expected = of_commands(&row(state)[0]);
            for ((mode, speeds), expected) in commands().into_iter().zip(expected) {
                let mut bench = bench(format, state);
                let before = bench.state();
                let asked = bench.command(mode, speeds);
                let answer = bench.ask(asked);
                let what = format!("{format}, {state}, {mode} {}: {answer:?}", speeds[0]);
                match expected {
                    Expected::Show => {
                        let GatewayMessage::State(shown) = answer else { panic!("{what}") };
                        assert_eq!((shown.gateway, bench.state()), (before, before), "{what}");
                    }
                    Expected::Follow(next) => {
                        assert_eq!(bench.state(), next, "{what}");
                        let GatewayMessage::State(shown) = answer else { panic!("{what}") };
                        assert_eq!(shown.gateway, next, "{what}");
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
            let mut bench = bench(WireFormat::BigEndian6x10, state);
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
        let mut bench = bench(WireFormat::BigEndian6x10, state);
        let GatewayMessage::Health(health) = bench.ask(HostMessage::Heartbeat) else { panic!("{state}") };
        assert_eq!((health.state, health.cause), (state, bench.cause()));
        let GatewayMessage::HelloReply(reply) = bench.ask(hello()) else { panic!("{state}") };
        assert_eq!((reply.state, reply.cause), (state, bench.cause()));
        // Detected from the replies to the stop order at the start.
        assert_eq!(reply.wire_format, Some(WireFormat::BigEndian6x10), "{state}");
        assert_eq!(bench.state(), state);
        // With open brakes a host keeps its limits.
        let mut limits = MotionLimits::WIDEST;
        limits.axes[3].speed -= 1;
        let answer = bench.ask(HostMessage::Hello(Hello { cycle_us: 10_000, limits }));
        if matches!(state, GatewayState::Holding | GatewayState::Moving | GatewayState::Stopping) {
            assert_eq!(rejected(answer), (RejectReason::WrongState, state.code().into()));
        } else {
            assert!(matches!(answer, GatewayMessage::HelloReply(_)), "{answer:?}");
        }
        assert_eq!(bench.state(), state);
    }
}

#[test]
fn before_the_first_hello_everything_else_is_refused() {
    let mut bench = Bench::silent(config(WireFormat::BigEndian6x10));
    let follow = bench.command(DriveMode::Off, JointVector::zeros());
    for message in [HostMessage::Heartbeat, control(ArmOperation::Start), follow] {
        assert_eq!(rejected(bench.ask(message)), (RejectReason::NotConnected, 0), "{message:?}");
    }
    bench.run(ms(20));
    assert_eq!(bench.letters(), "");
}

/// Each row of the table of errors whose answer is REJECT.
#[test]
fn every_kind_of_bad_frame_is_refused_with_its_reason_and_detail_and_changes_nothing() {
    for state in STATES {
        let mut bench = bench(WireFormat::BigEndian6x10, state);
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
            (with(0x05, b"S"), (RejectReason::UnknownType, 0)),
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
            (with(0x01, &[1; 76]), (RejectReason::BadValue, 0)),
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
