//! The gateway protocol against its specification: example frames and numbers are read from docs/arm-protocol.md.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::collections::BTreeMap;

use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmReply, Axis, AxisReply, AxisStatus, CommStatus, CommWord, ServoWord, Signal, SpeedCounts,
    TorqueCounts, TorqueScale, WireFormat, WiredSignals,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    Agreement, ArmId, ArmOperation, AxisMotion, AxisState, Control, ControlOperation, ControlReply, DriveCommand,
    DriveMode, EXCHANGE_BYTES, EepromLimits, FRAME_BYTES_MAX, FaultReport, Firmware, Frame, FrameParser,
    GatewayMessage, GatewayState, Geometry, Handshake, Health, Hello, HelloReply, Holder, HostMessage, MessageError,
    MotionLimits, MotionQuantity, Payload, Received, Reject, RejectReason, SharedKey, Side, State, StopCause,
    check_line, exchange_time,
};
use pb3dp_arm_pa10_protocol::watchdog::CommandWatchdog;
use pb3dp_kinematics::JointVector;

const SPECIFICATION: &str = include_str!("../../../docs/arm-protocol.md");
const ARM: ArmId = ArmId(2);

/// The blocks ```` ```hex name ```` of the specification.
fn example_frames() -> BTreeMap<String, Vec<u8>> {
    let mut frames = BTreeMap::new();
    for block in SPECIFICATION.split("```hex ").skip(1) {
        let (name, rest) = block.split_once('\n').unwrap();
        let (hex, _) = rest.split_once("```").unwrap();
        let bytes = hex.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
        assert!(frames.insert(name.trim().to_owned(), bytes).is_none(), "two examples {name}");
    }
    frames
}

fn control(control: Control) -> HostMessage {
    HostMessage::Control(control)
}

fn hello_reply() -> HelloReply {
    let watchdog = CommandWatchdog::default();
    let us = |duration: std::time::Duration| u32::try_from(duration.as_micros()).unwrap();
    HelloReply {
        wired: WiredSignals::default(),
        wire_format: Some(WireFormat::BigEndian6x10),
        geometry: Geometry::SecondGeneration,
        state: GatewayState::Idle,
        cause: StopCause::None,
        cycle_us: 2000,
        ramp_after_us: us(watchdog.ramp_after()),
        stop_after_us: us(watchdog.stop_after()),
        controller_watchdog_us: 6000,
        brake_release_us: 200_000,
        firmware: Firmware::new("pa10-gateway 1.0.0").unwrap(),
        limits: limits(),
    }
}

/// A quarter of the drives' speeds, and the servo range of a PA-10.
fn limits() -> MotionLimits {
    #[expect(clippy::approx_constant, reason = "the decimal number of configs/gateway.toml")]
    let speeds = [0.25, 0.25, 0.5, 0.5, 0.5, 1.5708, 1.5708];
    let ends_deg = [177.0f64, 91.0, 174.0, 137.0, 255.0, 165.0, 255.0];
    let motions = std::array::from_fn(|axis| AxisMotion {
        speed_max_rad_per_s: speeds[axis],
        acceleration_max_rad_per_s2: if axis < 4 { 2.0 } else { 5.0 },
        jerk_max_rad_per_s3: if axis < 4 { 80.0 } else { 200.0 },
        range_rad: [-ends_deg[axis].to_radians(), ends_deg[axis].to_radians()],
    });
    MotionLimits::new(&motions).unwrap()
}

fn state() -> State {
    let angles_deg = [90.0f64, -90.0, 177.0, -135.0, 255.0, 0.0, -255.0];
    let speeds = [500, -500, 0, 0, 0, 0, 31416];
    let torques_mn_m = [-5664, 5664, 0, 0, -1, 0, 14500];
    let mut axes = [AxisState::default(); 7];
    for axis in 0..7 {
        axes[axis] = AxisState {
            status: if axis == 2 { 0x0001 } else { 0 },
            angle_urad: (angles_deg[axis].to_radians() * 1e6).round() as i32,
            speed_urad_per_s: speeds[axis] * 200,
            torque_mn_m: torques_mn_m[axis],
        };
    }
    State {
        gateway: GatewayState::Moving,
        cause: StopCause::None,
        has_speeds: true,
        has_documented_status: true,
        is_ramping: false,
        sample_age_us: 850,
        comm: 0x0001,
        axes,
    }
}

fn health() -> Health {
    Health {
        state: GatewayState::Started,
        cause: StopCause::None,
        exchanges: 1000,
        replies_lost: 1,
        replies_late: 0,
        replies_mismatched: 1,
        overruns: 2,
        worst_cycle_us: 2310,
        host_damaged: 0,
        host_lost: 0,
        host_stale: 0,
    }
}

fn host_examples() -> Vec<(&'static str, HostMessage, u16, u64)> {
    let velocity = JointVector::from([0.1, -0.1, 0.0, 0.0, 0.0, 0.0, std::f64::consts::TAU]);
    vec![
        ("hello", HostMessage::Hello(Hello { cycle_us: 10_000, limits: limits() }), 0, 1_500_000),
        ("start", control(Control::Arm(ArmOperation::Start)), 1, 1_510_000),
        ("command", HostMessage::Command(DriveCommand::follow(&velocity).unwrap()), 65535, 2_000_000),
        ("abort", control(Control::Arm(ArmOperation::Abort)), 6, 2_400_000),
        ("clear-alarm", control(Control::ClearAlarm(Axis::ALL[6])), 7, 2_500_000),
        ("read-eeprom", control(Control::ReadEeprom(Axis::ALL[0])), 8, 2_510_000),
        ("heartbeat", HostMessage::Heartbeat, 9, 2_750_000),
    ]
}

fn gateway_examples() -> Vec<(&'static str, GatewayMessage, u16, u64)> {
    let started = ControlReply { control: Control::Arm(ArmOperation::Start), state: GatewayState::Started };
    let aborted = ControlReply { control: Control::Arm(ArmOperation::Abort), state: GatewayState::Fault };
    let limits = EepromLimits { axis: Axis::ALL[0], positive_limit_urad: 3_089_233, negative_limit_urad: -3_089_233 };
    let reject = Reject { reason: RejectReason::WrongState, frame_type: 2, detail: 0 };
    let fault = FaultReport {
        cause: StopCause::ServoAlarm,
        state_before: GatewayState::Moving,
        axis: Some(Axis::ALL[3]),
        word: 0x00E0,
    };
    vec![
        ("hello-reply", GatewayMessage::HelloReply(hello_reply()), 0, 1 << 32),
        ("start-done", GatewayMessage::ControlReply(started), 1, 4_294_970_000),
        ("state", GatewayMessage::State(state()), 65535, 4_295_459_296),
        ("abort-done", GatewayMessage::ControlReply(aborted), 6, 4_295_860_000),
        ("eeprom-limits", GatewayMessage::EepromLimits(limits), 8, 4_295_970_000),
        ("health", GatewayMessage::Health(health()), 9, 4_296_210_000),
        ("reject", GatewayMessage::Reject(reject), 10, 4_296_300_000),
        ("fault", GatewayMessage::Fault(fault), 0, 4_296_400_000),
        ("held", GatewayMessage::Held(Holder { address: [192, 168, 0, 20].into(), port: 50_000 }), 0, 4_297_100_000),
    ]
}

fn parse_one(bytes: &[u8]) -> Frame {
    let mut found = Vec::new();
    let mut parser = FrameParser::new(ARM);
    parser.feed(bytes, |received| found.push(received));
    assert!(!parser.is_within_frame());
    let [Received::Frame(frame)] = found[..] else { panic!("{found:?}") };
    frame
}

#[test]
fn a_hello_reply_names_exactly_the_wired_signals_of_the_gateway() {
    for bits in 0..16 {
        let wired = WiredSignals::from_bits(bits);
        assert_eq!(Signal::ALL.map(|signal| wired.has(signal)), [1, 2, 4, 8].map(|bit| bits & bit != 0), "{bits}");
        let sent_message = GatewayMessage::HelloReply(HelloReply { wired, ..hello_reply() });
        let frame = sent_message.frame(ARM, 7, 1);
        assert_eq!(GatewayMessage::decode(&frame), Ok(sent_message));
        // Gateways of earlier versions have one more set of messages.
        let mut payload = frame.payload.to_vec();
        payload[0] |= 1;
        let earlier = Frame { payload: Payload::from_slice(&payload).unwrap(), ..frame };
        assert_eq!(GatewayMessage::decode(&earlier), Ok(sent_message));
    }
    assert_eq!(WiredSignals::from_bits(0xF5), WiredSignals::from_bits(0x05), "four signals are known");
}

#[test]
fn the_example_frames_of_the_specification_are_ours_byte_for_byte() {
    let mut examples = example_frames();
    for (name, message, sequence, timestamp_us) in host_examples() {
        let bytes = examples.remove(name).unwrap_or_else(|| panic!("no example {name}"));
        let frame = message.frame(ARM, sequence, timestamp_us);
        assert_eq!(frame.encode().as_slice(), bytes, "{name}");
        assert_eq!(parse_one(&bytes), frame, "{name}");
        assert_eq!(HostMessage::decode(&frame), Ok(message), "{name}");
        assert_eq!(GatewayMessage::decode(&frame), Err(MessageError::Type { got: frame.frame_type }), "{name}");
    }
    for (name, message, sequence, timestamp_us) in gateway_examples() {
        let bytes = examples.remove(name).unwrap_or_else(|| panic!("no example {name}"));
        let frame = message.frame(ARM, sequence, timestamp_us);
        assert_eq!(frame.encode().as_slice(), bytes, "{name}");
        assert_eq!(parse_one(&bytes), frame, "{name}");
        assert_eq!(GatewayMessage::decode(&frame), Ok(message), "{name}");
        assert_eq!(HostMessage::decode(&frame), Err(MessageError::Type { got: frame.frame_type }), "{name}");
    }
    for name in ["client-nonce", "challenge", "proof", "host-record", "gateway-record"] {
        assert!(examples.remove(name).is_some(), "no example {name}");
    }
    assert!(examples.is_empty(), "examples without a test: {:?}", examples.keys());
}

/// The bytes of the page come from Python's `hmac` and `hashlib`.
#[test]
fn the_handshake_and_the_records_of_the_specification_are_ours() {
    let examples = example_frames();
    let secret: Vec<u8> = (0..0x20).collect();
    let nonce = |from: u8| std::array::from_fn(|index| from + index as u8);
    let agreement = Agreement::new(SharedKey::new(&secret).unwrap(), ARM, nonce(0x20), nonce(0x40));
    let messages = [
        ("client-nonce", Handshake::ClientNonce(nonce(0x20))),
        ("challenge", Handshake::Challenge(nonce(0x40), agreement.proof(Side::Gateway))),
        ("proof", Handshake::Proof(agreement.proof(Side::Host))),
    ];
    for (name, message) in messages {
        assert_eq!(message.frame(ARM).encode().as_slice(), examples[name], "{name}");
        assert_eq!(Handshake::decode(&parse_one(&examples[name])), Ok(message), "{name}");
    }
    for (side, name, frame) in [(Side::Host, "host-record", "start"), (Side::Gateway, "gateway-record", "start-done")] {
        let (mut sealer, _) = agreement.records(side);
        sealer.seal(&examples["hello"]);
        assert_eq!(sealer.seal(&examples[frame]).as_slice(), examples[name], "{name}");
    }
}

#[test]
fn the_numbers_of_the_specification_are_ours() {
    let mut numbers: Vec<(u8, String)> = Vec::new();
    numbers.extend(DriveMode::LISTED.iter().map(|code| (code.code(), code.to_string())));
    numbers.extend(ControlOperation::LISTED.iter().map(|code| (code.code(), code.to_string())));
    numbers.extend(GatewayState::LISTED.iter().map(|code| (code.code(), code.to_string())));
    numbers.extend(StopCause::LISTED.iter().map(|code| (code.code(), code.to_string())));
    numbers.extend(MotionQuantity::LISTED.iter().map(|code| (code.code(), code.to_string())));
    numbers.extend(RejectReason::LISTED.iter().map(|code| (code.code(), code.to_string())));
    numbers.extend(Geometry::LISTED.iter().map(|code| (code.code(), code.to_string())));
    let (_, section) = SPECIFICATION.split_once("\n## Numbers\n").unwrap();
    let (section, _) = section.split_once("\n## ").unwrap();
    let mut specified = Vec::new();
    for row in section.lines() {
        let mut cells = row.split('|').skip(1).map(str::trim);
        if let (Some(Ok(number)), Some(name)) = (cells.next().map(str::parse::<u8>), cells.next()) {
            specified.push((number, name.to_owned()));
        }
    }
    assert_eq!(specified, numbers);
}

#[test]
fn the_lengths_of_the_specification_are_ours() {
    let of_host = host_examples().into_iter().map(|(_, message, ..)| message.frame(ARM, 0, 0));
    let of_gateway = gateway_examples().into_iter().map(|(_, message, ..)| message.frame(ARM, 0, 0));
    for frame in of_host.chain(of_gateway) {
        let (number, length) = (format!("| `{:02X}` |", frame.frame_type), format!("| {} |", frame.payload.len()));
        let found = SPECIFICATION.lines().any(|line| line.starts_with(&number) && line.contains(&length));
        assert!(found, "{number} {length}");
    }
    assert!(SPECIFICATION.contains(&format!("The buffer needs {FRAME_BYTES_MAX} bytes.")));
}

#[test]
fn the_times_of_the_specification_are_ours() {
    let command = HostMessage::Command(DriveCommand::at_rest(DriveMode::Off)).frame(ARM, 0, 0).encode().len();
    let answer = GatewayMessage::State(state()).frame(ARM, 0, 0).encode().len();
    assert_eq!(EXCHANGE_BYTES, command + answer);
    let sentence = format!("A command and its answer take {EXCHANGE_BYTES} bytes");
    assert!(SPECIFICATION.contains(&sentence), "{sentence}");
    for (baud, shortest_ms) in [(115_200, None), (460_800, Some(8)), (921_600, Some(4)), (3_000_000, Some(2))] {
        let check = |cycle_ms| check_line(baud, std::time::Duration::from_millis(cycle_ms));
        let time_ms = exchange_time(baud).as_secs_f64() * 1e3;
        let shortest = shortest_ms.map_or("none: too slow".to_owned(), |shortest| format!("{shortest} ms"));
        let row = format!("| {baud} | {time_ms:.1} ms | {shortest} |");
        assert!(SPECIFICATION.contains(&row), "{row}");
        assert_eq!(check(shortest_ms.unwrap_or(10)).is_ok(), shortest_ms.is_some(), "{baud}");
    }
    let refused = check_line(115_200, std::time::Duration::from_millis(10)).unwrap_err();
    assert!(refused.to_string().starts_with("115200 baud take 15.19"), "{refused}");
    assert!(
        refused
            .to_string()
            .contains("(175 bytes), more than half of a cycle of 10ms, which needs at least 350000 baud"),
        "{refused}"
    );
    assert!(check_line(350_000, std::time::Duration::from_millis(10)).is_ok());
    assert!(check_line(349_999, std::time::Duration::from_millis(10)).is_err());
    assert!(check_line(0, std::time::Duration::from_millis(10)).is_err());
}

#[test]
fn frames_that_mean_nothing_are_refused_by_name() {
    let frame = |frame_type: u8, payload: &[u8]| Frame {
        arm: ARM,
        frame_type,
        sequence: 0,
        timestamp_us: 0,
        payload: Payload::from_slice(payload).unwrap(),
    };
    let host = |frame_type, payload: &[u8]| HostMessage::decode(&frame(frame_type, payload)).unwrap_err();
    let gateway = |frame_type, payload: &[u8]| GatewayMessage::decode(&frame(frame_type, payload)).unwrap_err();
    let value = |frame_type, field, got| MessageError::Value { frame_type, field, got };
    assert_eq!(host(0x06, &[]), MessageError::Type { got: 6 });
    assert_eq!(host(4, &[0]), MessageError::Length { frame_type: 4, got: 1, expected: 0 });
    assert_eq!(host(5, b"S"), MessageError::Type { got: 5 });
    let hello = HostMessage::Hello(Hello { cycle_us: 10_000, limits: limits() });
    let hello = |at: usize, bytes: &[u8]| {
        let mut payload = hello.frame(ARM, 0, 0).payload.to_vec();
        payload[at..at + bytes.len()].copy_from_slice(bytes);
        host(1, &payload)
    };
    assert_eq!(hello(0, &[1]), value(1, "set of messages", 1));
    assert_eq!(hello(1, &[0x20, 0x4E]), value(1, "time between two commands", 20_000));
    assert_eq!(hello(5, &[2]), value(1, "version of the limits", 2));
    assert_eq!(hello(6, &[0, 0]), value(1, "speed limit", 0));
    assert_eq!(hello(6, &[1, 0x80]), value(1, "speed limit", 32_769));
    assert_eq!(hello(18, &[0, 0]), value(1, "acceleration limit", 0));
    assert_eq!(hello(30, &[0, 0]), value(1, "jerk limit", 0));
    assert_eq!(hello(12, &[0x56, 0x3C]), value(1, "lower end of the range", 15_446));
    assert_eq!(hello(12, &[0, 0x80]), value(1, "lower end of the range", -32_768));
    assert_eq!(host(1, &[2, 0x10, 0x27, 0, 0]), MessageError::Length { frame_type: 1, got: 5, expected: 76 });
    assert_eq!(host(3, &[1, 1]), value(3, "axis", 1));
    assert_eq!(host(3, &[3, 0]), value(3, "axis", 0));
    assert_eq!(host(3, &[4, 8]), value(3, "axis", 8));
    assert_eq!(host(3, &[9, 0]), value(3, "operation", 9));
    let mut command = [0u8; 29];
    command[28] = 1;
    assert_eq!(host(2, &command), value(2, "speed", 1 << 24));
    command[0] = 2;
    assert_eq!(host(2, &command), value(2, "speed", 1 << 24));
    command[28] = 0;
    assert!(HostMessage::decode(&frame(2, &command)).is_ok());
    assert_eq!(gateway(0x82, &[0; 107]), MessageError::Length { frame_type: 0x82, got: 107, expected: 108 });
    let mut state = [0u8; 108];
    state[2] = 8;
    assert_eq!(gateway(0x82, &state), value(0x82, "flags", 8));
    state[2] = 2;
    state[16] = 1;
    assert_eq!(gateway(0x82, &state), value(0x82, "speed that is not measured", 1));
    assert_eq!(gateway(0x8F, &[1, 3, 8, 0, 0]), value(0x8F, "axis", 8));
    assert!(host(3, &[9, 0]).to_string().contains("frame type 0x03: operation is 9"), "{}", host(3, &[9, 0]));
}

#[test]
fn nothing_of_the_controllers_resolution_is_lost() {
    let scale = TorqueScale::of_format(WireFormat::BigEndian6x10);
    for counts in (-700_000..700_000).step_by(37).chain([i16::MIN.into(), -1, 0, 1]) {
        let speed = SpeedCounts((counts % 32768) as i16);
        let torque = TorqueCounts((counts % 32768) as i16);
        let axis = AxisReply {
            status: AxisStatus::Servo(ServoWord(0x1234)),
            angle: AngleCounts(counts),
            speed: Some(speed),
            torque,
        };
        let reply = ArmReply { axes: [axis; 7], comm: CommStatus::Comm(CommWord(0x4321)) };
        let state = State::from_reply(&reply, &scale, 5).unwrap();
        let (angles, speeds, torques) = (state.position_rad(), state.velocity_rad_per_s().unwrap(), state.torque_n_m());
        for axis in Axis::ALL {
            let joint = axis.index();
            assert_eq!(AngleCounts::from_rad(axis, angles[joint]), Ok(AngleCounts(counts)));
            assert_eq!(SpeedCounts::from_rad_per_s(axis, speeds[joint]), Ok(speed));
            assert_eq!(scale.from_joint_n_m(axis, torques[joint]), Ok(torque));
            assert_eq!(state.axis_status(axis), AxisStatus::Servo(ServoWord(0x1234)));
        }
        assert_eq!(state.comm_status(), CommStatus::Comm(CommWord(0x4321)));
    }
}

#[test]
fn a_state_of_format_a_claims_neither_speeds_nor_meanings() {
    let axis = AxisReply {
        status: AxisStatus::Undocumented(0x0110),
        angle: AngleCounts(-204_800),
        speed: None,
        torque: TorqueCounts(-3),
    };
    let reply = ArmReply { axes: [axis; 7], comm: CommStatus::Undocumented(0x0050) };
    let scale = TorqueScale::of_format(WireFormat::LittleEndian5x8);
    let state = State::from_reply(&reply, &scale, 0).unwrap();
    assert_eq!(state.velocity_rad_per_s(), None);
    assert_eq!(state.axis_status(Axis::ALL[4]), AxisStatus::Undocumented(0x0110));
    assert_eq!(state.comm_status(), CommStatus::Undocumented(0x0050));
    assert!((state.torque_n_m()[6] + 0.15).abs() < 1e-9);
    let far = AxisReply { angle: AngleCounts(i32::MAX), ..axis };
    assert!(State::from_reply(&ArmReply { axes: [far; 7], ..reply }, &scale, 0).is_err());
}

#[test]
fn impossible_speeds_never_become_a_command() {
    for bad in [f64::NAN, f64::INFINITY, 6.5536, -6.5538] {
        let mut velocity = JointVector::zeros();
        velocity[3] = bad;
        let error = DriveCommand::follow(&velocity).unwrap_err();
        assert!(error.to_string().starts_with("axis 4 (E1): "), "{error}");
    }
}

#[test]
fn firmware_names_are_short_and_printable() {
    assert_eq!(
        Firmware::new("pa10-gateway 1.0.0").map(|name| name.as_str().to_owned()),
        Some("pa10-gateway 1.0.0".to_owned())
    );
    assert_eq!(Firmware::new("123456789012345678901234").map(|name| name.as_str().len()), Some(24));
    assert_eq!(Firmware::new("1234567890123456789012345"), None);
    assert_eq!(Firmware::new("gäteway"), None);
    assert_eq!(Firmware::new("a\0b"), None);
}
