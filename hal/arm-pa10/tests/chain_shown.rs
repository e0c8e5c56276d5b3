//! What a host reads from a gateway that has stopped its arm: the joint angles, and the switch or alarm.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{DriverState, Request};
use pb3dp_arm_pa10_protocol::codec::StatusSignals;
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_protocol::gateway_protocol::GatewayState;
use pb3dp_arm_pa10_test_support::chain::Chain;
use pb3dp_arm_pa10_test_support::injection::joints;
use pb3dp_kinematics::JointVector;

/// An arm that is stopped in motion, and a host that connects later.
fn found(line: &str) -> Chain {
    let mut chain = Chain::new(WireFormat::BigEndian6x10, None, joints());
    chain.prepare();
    chain.wanted = Some(JointVector::repeat(0.1));
    chain.next_host_cycle = chain.now;
    chain.run(Duration::from_millis(300));
    chain.inject(line);
    chain.run(Duration::from_millis(800));
    assert!(chain.driver.state().is_latched() && chain.controller.is_braked(), "{line}: {:?}", chain.driver.state());
    chain.wanted = None;
    // The host disconnects, and connects again later.
    chain.gateway.handle_host_gone(chain.now);
    chain.run(Duration::from_secs(5));
    chain.open();
    chain
}

#[test]
fn a_stopped_arm_is_shown_with_what_stopped_it() {
    for (line, state, words) in [
        (
            "e-stop press",
            GatewayState::EmergencyStop,
            "alarm 0x11 (emergency stop); release the emergency stop, then reset",
        ),
        (
            "limit-switch open",
            GatewayState::EmergencyStop,
            "alarm 0x13 (limit switch); move the arm away from the limit switch, then reset",
        ),
        (
            "alarm 3 0x12 reported",
            GatewayState::EmergencyStop,
            "dead-man switch: axis 3 (S3): alarm 0x12 (dead-man switch off); hold the dead-man switch, then reset",
        ),
        (
            "alarm 4 0x0e reported",
            GatewayState::Fault,
            "fault: axis 4 (E1): alarm 0x0e (over-current); remove the cause, then reset",
        ),
    ] {
        let chain = found(line);
        assert_eq!(chain.link.hello().unwrap().state, state, "{line}");
        let shown = chain.link.shown().unwrap();
        let position_rad = chain.plant.lock().unwrap().state().position_rad;
        assert!((shown.position_rad - position_rad).amax() < 0.02, "{line}: {:?}", shown.position_rad);
        assert!(shown.age >= Duration::from_secs(5), "{line}: {:?}", shown.age);
        let text = shown.condition.trip(&StatusSignals::ORCA).unwrap().to_string();
        assert!(text.ends_with(words), "{line}: {text}");
        assert_eq!(text.contains("emergency stop"), line == "e-stop press", "{line}: {text}");
    }
}

/// The controller receives no message, and a reset works as before.
#[test]
fn looking_at_a_stopped_arm_changes_nothing() {
    let mut chain = found("time-out");
    assert!(chain.link.shown().is_some());
    let frames = chain.controller.counters().frames;
    for _ in 0..5 {
        chain.open();
    }
    assert_eq!(chain.controller.counters().frames, frames, "nothing was said to the controller");
    assert_eq!(chain.gateway.status().state, GatewayState::Fault);
    chain.request(Request::Reset);
    chain.settle();
    assert_eq!(chain.driver.state(), DriverState::Connected, "{:?}", chain.driver.latched());
}
