//! A gateway at a controller without a time-out: unanswered messages are repeated until they are answered.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{Activity, Driver, DriverConfig, DriverState, FaultCause, Request, Trip};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, pa10_joints};
use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig};
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_protocol::gateway_protocol::{Firmware, GatewayState, MotionLimits, RejectReason, StopCause};
use pb3dp_arm_pa10_test_support::bus_bench::{self, START, assert_held};
use pb3dp_arm_pa10_test_support::chain::{ARM, Chain};
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::{JointMechanics, JointPlant};

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn connected(format: WireFormat) -> Chain {
    let start_rad = JointVector::from([0.1, 0.7, 0.2, 0.9, 0.1, 0.5, 0.1]);
    let plant = JointPlant::new(pa10_joints().unwrap(), start_rad, START).unwrap();
    Chain::new(format, None, plant.with_mechanics(JointMechanics::default()).unwrap())
}

fn moving(format: WireFormat) -> Chain {
    let mut chain = connected(format);
    chain.prepare();
    chain.wanted = Some(JointVector::from([0.1, -0.2, 0.1, 0.2, 0.3, 0.2, 0.3]));
    chain.next_host_cycle = chain.now;
    chain.run(ms(400));
    assert_eq!(chain.driver.state(), DriverState::Moving);
    chain
}

fn run_held(chain: &mut Chain, time: Duration, place: &str) {
    let end = chain.now + time;
    while chain.now < end {
        chain.run(ms(1));
        assert_held(&chain.controller, place);
    }
}

/// Stationary, brakes closed, control mode off, E answered.
fn assert_ended(chain: &Chain, place: &str) {
    let (_, speed) = chain.controller.true_joints();
    assert!(chain.is_at_rest() && chain.controller.is_braked(), "{place}: it moves with {}", speed.amax());
    assert_eq!(chain.controller.mode(), ControlMode::Adjustment, "{place}");
    assert!(
        chain.gateway.is_at_rest() && !chain.gateway.status().stop_unacknowledged,
        "{place}: {:?}",
        chain.gateway.status()
    );
}

fn latched(chain: &Chain) -> (GatewayState, StopCause) {
    (chain.gateway.status().state, chain.gateway.status().cause)
}

const SILENT: (GatewayState, StopCause) = (GatewayState::Fault, StopCause::ControllerSilent);

/// As an operator would: repeated if the gateway needs its time.
fn reset(chain: &mut Chain, place: &str) {
    chain.wanted = None;
    for _ in 0..3 {
        chain.request(Request::Reset);
        run_held(chain, ms(600), place);
        assert_eq!(chain.driver.activity(), Activity::None, "{place}");
        let refused = Trip::Fault(FaultCause::Rejected(RejectReason::WrongState));
        if chain.driver.latched().is_none_or(|latched| latched.trip != refused) {
            break;
        }
    }
    assert_eq!(chain.driver.state(), DriverState::Connected, "{place}: {:?}", chain.driver.latched());
    assert_eq!(latched(chain), (GatewayState::Idle, StopCause::None), "{place}");
    assert_ended(chain, place);
}

/// Gateway and host are killed, and both are started again.
fn restart(chain: &mut Chain, format: WireFormat) {
    chain.wanted = None;
    let config = GatewayConfig::new(ARM, format, Firmware::new("test gateway 2").unwrap(), MotionLimits::WIDEST);
    chain.gateway = Gateway::new(config, chain.now).unwrap();
    chain.driver = Driver::new(DriverConfig::with_cycle(bus_bench::HOST_CYCLE)).unwrap();
    chain.letters.clear();
}

#[test]
fn an_outage_that_ends_at_any_step_of_the_stop_order_leaves_no_arm_moving() {
    for format in WireFormat::ALL {
        for outage_ms in (12..340).step_by(4).chain([600, 1000, 11_000]) {
            let place = format!("{format}, {outage_ms} ms");
            let mut chain = moving(format);
            chain.inject("deaf 1000000");
            run_held(&mut chain, ms(outage_ms), &place);
            assert_eq!(latched(&chain), SILENT, "{place}");
            chain.inject("deaf 0");
            let before = chain.controller.true_joints().0;
            run_held(&mut chain, ms(320), &place);
            let moved = (chain.controller.true_joints().0 - before).amax();
            assert!(moved < 0.03, "{place}: {moved} rad after the bus was back");
            assert_ended(&chain, &place);
            assert_eq!(latched(&chain), SILENT, "{place}");
            reset(&mut chain, &place);
        }
    }
}

#[test]
fn an_outage_during_the_acknowledged_stop_order_does_not_end_it() {
    for format in WireFormat::ALL {
        for heartbeat_ms in (1..230).step_by(6) {
            let place = format!("{format}, heard for {heartbeat_ms} ms");
            let mut chain = moving(format);
            for (time, deaf) in [(0, "deaf 1000000"), (700, "deaf 0"), (heartbeat_ms, "deaf 1000000"), (900, "deaf 0")]
            {
                run_held(&mut chain, ms(time), &place);
                chain.inject(deaf);
            }
            run_held(&mut chain, ms(700), &place);
            assert_ended(&chain, &place);
            reset(&mut chain, &place);
        }
    }
}

/// The controller was powered off and on, ignores C until S, and answers E.
#[test]
fn a_controller_that_was_switched_off_and_on_is_reset() {
    for format in WireFormat::ALL {
        for only_in_control in [false, true] {
            let place = format!("{format}, {only_in_control}");
            let mut chain = moving(format);
            chain.inject("power off");
            chain.run(ms(1000));
            chain.only_in_control = only_in_control;
            chain.inject("power on");
            run_held(&mut chain, ms(1000), &place);
            assert_eq!(chain.gateway.status().stop_unacknowledged, only_in_control, "{place}");
            assert_eq!(latched(&chain), SILENT, "{place}");
            reset(&mut chain, &place);
        }
    }
}

/// A silent arm receives no message that opens a brake or disables a servo.
#[test]
fn a_silent_arm_is_not_reset() {
    for format in WireFormat::ALL {
        let mut chain = moving(format);
        chain.inject("deaf 1000000");
        chain.run(ms(1000));
        chain.wanted = None;
        chain.letters.clear();
        chain.request(Request::Reset);
        chain.settle();
        let lost = |trip| matches!(trip, Trip::Fault(FaultCause::LinkLost { .. }));
        assert!(chain.driver.latched().is_some_and(|latched| lost(latched.trip)), "{:?}", chain.driver.latched());
        assert!(!chain.letters.contains('S') && chain.letters.contains('E'), "{}", chain.letters);
        chain.letters.clear();
        chain.run(ms(100));
        assert!(chain.letters.len() >= 49 && !chain.letters.contains(|letter| letter != 'C'), "{}", chain.letters);
        chain.inject("deaf 0");
        run_held(&mut chain, ms(400), "it is heard");
        assert_ended(&chain, "it is heard");
        reset(&mut chain, "it is heard");
    }
}

/// The bus recovers at any time of a reset: any message may be the first to arrive.
#[test]
fn a_bus_that_comes_back_during_a_reset_lets_no_joint_go() {
    for format in WireFormat::ALL {
        for after_ms in 0..120 {
            let place = format!("{format}, back after {after_ms} ms");
            let mut chain = moving(format);
            chain.inject("deaf 1000000");
            run_held(&mut chain, ms(700), &place);
            chain.wanted = None;
            chain.request(Request::Reset);
            run_held(&mut chain, ms(after_ms), &place);
            chain.inject("deaf 0");
            run_held(&mut chain, ms(800), &place);
            assert_ended(&chain, &place);
            if chain.driver.state().is_latched() {
                reset(&mut chain, &place);
            }
        }
    }
}

/// A gateway that starts at a dead bus whose arm moves.
#[test]
fn an_arm_whose_answers_are_late_while_it_moves_is_stopped_and_latched() {
    for format in WireFormat::ALL {
        for after_ms in (0..330).step_by(4).chain([2000]) {
            let place = format!("{format}, back after {after_ms} ms");
            let mut chain = moving(format);
            chain.inject("deaf 1000000");
            restart(&mut chain, format);
            run_held(&mut chain, ms(after_ms), &place);
            if after_ms > 230 {
                assert_eq!(latched(&chain), (GatewayState::Idle, StopCause::None), "{place}: hosts may come");
            }
            chain.inject("deaf 0");
            run_held(&mut chain, ms(600), &place);
            assert_ended(&chain, &place);
            // E is sent once at a fixed time: if it arrives first, it stops the arm before the gateway detects motion.
            let acknowledged_end_first = (200..=222).contains(&after_ms);
            if !acknowledged_end_first {
                assert_eq!(latched(&chain), (GatewayState::Fault, StopCause::HostSilent), "{place}");
            }
        }
    }
}

/// A host requests the control mode when the bus of a moving arm recovers.
#[test]
fn a_start_at_a_silent_arm_releases_no_joint() {
    for format in WireFormat::ALL {
        for after_ms in 0..60 {
            let place = format!("{format}, back after {after_ms} ms");
            let mut chain = moving(format);
            chain.inject("deaf 1000000");
            restart(&mut chain, format);
            run_held(&mut chain, ms(400), &place);
            chain.open();
            chain.request(Request::Connect);
            run_held(&mut chain, ms(after_ms), &place);
            chain.inject("deaf 0");
            run_held(&mut chain, ms(900), &place);
            assert_ended(&chain, &place);
            if chain.driver.state().is_latched() {
                reset(&mut chain, &place);
            }
        }
    }
}

/// A controller that is powered on after its gateway, and ignores C until S.
#[test]
fn a_controller_that_is_switched_on_later_is_started_at_once() {
    for format in WireFormat::ALL {
        let mut chain = connected(format);
        chain.inject("power off");
        restart(&mut chain, format);
        chain.run(ms(1000));
        chain.only_in_control = true;
        chain.inject("power on");
        chain.run(ms(1000));
        assert!(chain.gateway.status().stop_unacknowledged);
        chain.open();
        chain.request(Request::Connect);
        chain.settle();
        assert_eq!(chain.driver.state(), DriverState::Connected, "{:?}", chain.driver.latched());
        chain.prepare();
    }
}

/// If C is answered only in the control mode, an arm that was left with open brakes is detected, too.
#[test]
fn an_arm_that_was_left_holding_is_latched_where_the_controller_shows_it() {
    for format in WireFormat::ALL {
        for only_in_control in [false, true] {
            let mut chain = connected(format);
            chain.only_in_control = only_in_control;
            chain.prepare();
            restart(&mut chain, format);
            run_held(&mut chain, ms(400), "holding");
            assert_ended(&chain, "holding");
            let found = if only_in_control { (GatewayState::Fault, StopCause::HostSilent) } else { latched(&chain) };
            assert_eq!(latched(&chain), found, "{format}");
            // An arm that was left in order is not latched.
            restart(&mut chain, format);
            run_held(&mut chain, ms(400), "left in order");
            assert_ended(&chain, "left in order");
            assert_eq!(latched(&chain), (GatewayState::Idle, StopCause::None), "{format}");
        }
    }
}

/// A host disconnects in `started`, while the bus is dead.
#[test]
fn a_lost_end_letter_is_requested_again() {
    for format in WireFormat::ALL {
        let mut chain = connected(format);
        chain.request(Request::Enable);
        chain.settle();
        chain.inject("deaf 4");
        chain.frozen = true;
        chain.gateway.handle_host_gone(chain.now);
        chain.letters.clear();
        run_held(&mut chain, ms(400), "started");
        assert!(chain.letters.starts_with("EEEC") && chain.letters.ends_with("CEC"), "{}", chain.letters);
        assert_eq!(latched(&chain), (GatewayState::Idle, StopCause::None));
        assert_ended(&chain, "started");
    }
}
