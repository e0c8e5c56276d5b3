//! ABORT of a host that has detected a fault: the stop order and a latch, in every state of the gateway.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use pb3dp_arm_pa10_gateway::gateway::Gateway;
use pb3dp_arm_pa10_protocol::codec::{Axis, AxisCommand, ControlMessage, Letter, ServoWord, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmOperation, Control, ControlReply, GatewayMessage, GatewayState, HostMessage, RejectReason, StopCause,
};
use pb3dp_arm_pa10_test_support::gateway_bench::{Bench, config, control, hello, ms, rejected};

const STATES: [GatewayState; 7] = [
    GatewayState::Idle,
    GatewayState::Started,
    GatewayState::Holding,
    GatewayState::Moving,
    GatewayState::Stopping,
    GatewayState::Fault,
    GatewayState::EmergencyStop,
];

fn abort(bench: &mut Bench) {
    let answer = bench.ask(control(ArmOperation::Abort));
    let GatewayMessage::ControlReply(ControlReply { control, state }) = answer else { panic!("{answer:?}") };
    assert_eq!((control, state), (Control::Arm(ArmOperation::Abort), bench.state()));
}

#[test]
fn it_stops_and_latches_in_every_state_and_keeps_the_first_cause() {
    for state in STATES {
        let mut bench = Bench::new();
        bench.lead_to(state);
        let before = bench.cause();
        bench.sent.clear();
        bench.messages.clear();
        for _ in 0..2 {
            abort(&mut bench);
            let expected = match state {
                GatewayState::Fault | GatewayState::EmergencyStop => (state, before),
                _ => (GatewayState::Fault, StopCause::HostFault),
            };
            assert_eq!((bench.state(), bench.cause()), expected, "{state}");
            bench.run(ms(600));
            assert_eq!((bench.state(), bench.cause()), expected, "{state}");
        }
        assert!(bench.gateway.is_at_rest(), "{state}");
        let ends = bench.letters().matches('E').count();
        let latched = matches!(state, GatewayState::Fault | GatewayState::EmergencyStop);
        assert_eq!(ends, usize::from(!latched), "{state}: {}", bench.letters());
        // The sender of ABORT needs no report.
        let fault_reports = bench.messages.iter().filter(|(_, message)| matches!(message, GatewayMessage::Fault(_)));
        assert_eq!(fault_reports.count(), 0, "{state}");
        let started = bench.ask(control(ArmOperation::Start));
        assert_eq!(rejected(started), (RejectReason::WrongState, bench.state().code().into()), "{state}");
        let reset = bench.ask(control(ArmOperation::Reset));
        assert!(matches!(reset, GatewayMessage::ControlReply(_)), "{state}: {reset:?}");
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None), "{state}");
    }
}

#[test]
fn it_cuts_short_what_a_host_has_asked_for() {
    for task in
        [Control::Arm(ArmOperation::Start), Control::ClearAlarm(Axis::ALL[2]), Control::ReadEeprom(Axis::ALL[2])]
    {
        let mut bench = Bench::new();
        bench.controller.answers = false;
        let asked = bench.tell(HostMessage::Control(task));
        bench.run(ms(2));
        bench.controller.answers = true;
        abort(&mut bench);
        bench.run(ms(50));
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::HostFault), "{task:?}");
        let answers = bench.messages.iter().filter(|(frame, _)| frame.sequence == asked).map(|(_, answer)| *answer);
        let refused = answers.map(rejected).collect::<Vec<_>>();
        assert_eq!(refused, [(RejectReason::WrongState, GatewayState::Fault.code().into())], "{task:?}");
        assert!(bench.letters().ends_with('E'), "{task:?}: {}", bench.letters());
    }
}

/// A reset in progress does not release an arm that a host has aborted meanwhile.
#[test]
fn it_ends_a_reset_that_is_under_way() {
    for step in 0..6 {
        let mut bench = Bench::new();
        bench.lead_to(GatewayState::Fault);
        bench.sent.clear();
        bench.controller.delay = ms(1);
        let asked = bench.tell(control(ArmOperation::Reset));
        bench.run(ms(step));
        let was_under_way = bench.state() == GatewayState::Fault;
        abort(&mut bench);
        bench.run(ms(50));
        let cause = if was_under_way { StopCause::ServoAlarm } else { StopCause::HostFault };
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, cause), "after {step} ms");
        assert!(bench.gateway.is_at_rest());
        assert_eq!(bench.messages.iter().filter(|(frame, _)| frame.sequence == asked).count(), 1);
    }
}

/// A gateway that has just started has no information about its arm; its host may have some.
#[test]
fn it_latches_a_gateway_that_begins() {
    let mut bench = Bench::new();
    bench.gateway = Gateway::new(config(WireFormat::BigEndian6x10), bench.now).unwrap();
    bench.run(ms(20));
    bench.ask(hello());
    abort(&mut bench);
    bench.run(ms(400));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::HostFault));
    assert!(bench.gateway.is_at_rest());
}

/// A silent controller changes neither the cause nor the result.
#[test]
fn it_latches_without_a_controller() {
    for state in [GatewayState::Idle, GatewayState::Started, GatewayState::Moving] {
        let mut bench = Bench::new();
        bench.lead_to(state);
        bench.controller.answers = false;
        abort(&mut bench);
        bench.run(ms(600));
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::HostFault), "{state}");
        // The reset is still refused because of the controller.
        assert_eq!(rejected(bench.ask(control(ArmOperation::Reset))).0, RejectReason::NoAnswer, "{state}");
        let last_commands = || bench.sent.iter().rev().take(50);
        assert!(!last_commands().any(|sent| sent.message.letter() == Letter::Start), "{state}");
        let holds = |axis: &AxisCommand| *axis == AxisCommand::Braked;
        let is_held = |message| !matches!(message, ControlMessage::Cyclic(command) if !command.axes.iter().all(holds));
        assert!(last_commands().all(|sent| is_held(sent.message)), "{state}");
    }
}

/// A cause that is detected later does not replace the first one, but the reset checks it.
#[test]
fn what_the_arm_shows_afterwards_is_looked_at_by_the_reset() {
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Moving);
    abort(&mut bench);
    bench.controller.servo[3] = ServoWord(0x00E0);
    bench.run(ms(600));
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::HostFault));
    let present = (RejectReason::CausePresent, u32::from(StopCause::ServoAlarm.code()));
    assert_eq!(rejected(bench.ask(control(ArmOperation::Reset))), present);
    bench.controller.servo[3] = ServoWord(0);
    assert!(matches!(bench.ask(control(ArmOperation::Reset)), GatewayMessage::ControlReply(_)));
}

/// Its controller has acknowledged that the brakes are on.
#[test]
fn an_idle_gateway_only_ends_the_control_mode() {
    let mut bench = Bench::new();
    bench.sent.clear();
    abort(&mut bench);
    bench.run(ms(60));
    assert_eq!((bench.letters().as_str(), bench.state()), ("E", GatewayState::Fault));
}
