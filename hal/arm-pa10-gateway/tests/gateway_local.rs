//! The local / remote switch of a gateway: on local no host moves, enables or resets the arm.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use pb3dp_arm_pa10_gateway::gateway::Gateway;
use pb3dp_arm_pa10_protocol::codec::{Axis, Letter, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmOperation, Control, DriveCommand, DriveMode, GatewayMessage, GatewayState, HostMessage, RejectReason, StopCause,
};
use pb3dp_arm_pa10_test_support::gateway_bench::{Bench, config, control, hello, ms, rejected};

fn set_local(bench: &mut Bench, is_local: bool) {
    bench.gateway.set_local(bench.now, is_local);
}

fn must_be_refused(bench: &mut Bench) {
    bench.sent.clear();
    let present = (RejectReason::CausePresent, u32::from(StopCause::LocalControl.code()));
    assert_eq!(rejected(bench.ask(control(ArmOperation::Reset))), present);
    assert_eq!(rejected(bench.ask(control(ArmOperation::Start))).0, RejectReason::WrongState);
    let mut follow = DriveCommand::at_rest(DriveMode::Follow);
    follow.speed_urad_per_s[6] = 100_000;
    for command in [follow, DriveCommand::at_rest(DriveMode::Braked)] {
        match bench.ask(HostMessage::Command(command)) {
            GatewayMessage::State(state) => assert_eq!(state.gateway, bench.state()),
            other => assert_eq!(rejected(other).0, RejectReason::NoAnswer),
        }
    }
    bench.run(ms(100));
    let moves = |letter: Letter| matches!(letter, Letter::Start | Letter::Cyclic);
    assert!(!bench.sent.iter().any(|sent| moves(sent.message.letter())), "{}", bench.letters());
}

#[test]
fn it_stops_and_latches_in_every_state_until_remote_and_reset() {
    use GatewayState::{EmergencyStop, Fault, Holding, Idle, Moving, Started, Stopping};
    for state in [Idle, Started, Holding, Moving, Stopping, Fault, EmergencyStop] {
        let mut bench = Bench::new();
        bench.lead_to(state);
        let before = bench.cause();
        set_local(&mut bench, true);
        let latched = matches!(state, Fault | EmergencyStop);
        let expected = if latched { (state, before) } else { (Fault, StopCause::LocalControl) };
        assert_eq!((bench.state(), bench.cause()), expected, "{state}");
        bench.run(ms(600));
        assert!(bench.gateway.is_at_rest(), "{state}");
        must_be_refused(&mut bench);
        assert_eq!((bench.state(), bench.cause()), expected, "{state}");
        // The host reads on.
        assert!(matches!(bench.ask(HostMessage::Heartbeat), GatewayMessage::Health(_)), "{state}");
        let read = bench.ask(HostMessage::Control(Control::ReadEeprom(Axis::ALL[0])));
        assert!(matches!(read, GatewayMessage::EepromLimits(_)), "{state}: {read:?}");
        set_local(&mut bench, false);
        bench.run(ms(100));
        assert_eq!((bench.state(), bench.cause()), expected, "{state}: it stays latched");
        assert!(matches!(bench.ask(control(ArmOperation::Reset)), GatewayMessage::ControlReply(_)), "{state}");
        assert_eq!((bench.state(), bench.cause()), (Idle, StopCause::None), "{state}");
    }
}

/// A gateway that starts on local closes the brakes first, as any other.
#[test]
fn a_gateway_may_start_on_local() {
    let mut bench = Bench::new();
    bench.gateway = Gateway::new(config(WireFormat::BigEndian6x10), bench.now).unwrap();
    set_local(&mut bench, true);
    assert_eq!(bench.state(), GatewayState::Stopping);
    bench.run(ms(600));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::LocalControl));
    let GatewayMessage::HelloReply(reply) = bench.ask(hello()) else { panic!("no answer to HELLO") };
    assert_eq!((reply.state, reply.cause), (GatewayState::Fault, StopCause::LocalControl));
    must_be_refused(&mut bench);
}
