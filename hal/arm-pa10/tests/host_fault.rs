//! A fault that the host has detected outlives its program: the gateway latches, and the next program needs a reset.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{Driver, DriverConfig, DriverState, EmergencyStopCause, FaultCause, Request, Trip};
use pb3dp_arm_pa10_emulation::mock_controller::pa10_joints;
use pb3dp_arm_pa10_protocol::codec::Signal;
use pb3dp_arm_pa10_protocol::codec::{Axis, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmOperation, Control, FrameParser, GatewayState, HostMessage, Received, RejectReason, StopCause,
};
use pb3dp_arm_pa10_test_support::bus_bench::{self, HOST_CYCLE};
use pb3dp_arm_pa10_test_support::chain::{ARM, Chain, Way};
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::{JointMechanics, JointPlant};

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// Faults that a host detects by itself, without the gateway.
fn trips() -> Vec<Trip> {
    let torque =
        FaultCause::TorqueTooHigh { axis: Axis::ALL[1], torque_n_m: 150.0, allowed_n_m: 126.4, lasted: ms(50) };
    let causes = [
        torque,
        FaultCause::Supervisor,
        FaultCause::OtherArm { arm: 9 },
        FaultCause::Released,
        FaultCause::Program,
        FaultCause::LinkLost { misses: 3 },
        FaultCause::WrongArm { got: 9 },
        FaultCause::CommandTimeout { age: ms(60), allowed: ms(50) },
    ];
    let pressed = Trip::EStop(EmergencyStopCause::Switch { signal: Signal::EmergencyStop, axis: None, word: 0x0008 });
    causes.into_iter().map(Trip::Fault).chain([pressed]).collect()
}

fn chain(format: WireFormat) -> Chain {
    let start_rad = JointVector::from([0.1, 0.7, 0.2, 0.9, 0.1, 0.5, 0.1]);
    let plant = JointPlant::new(pa10_joints().unwrap(), start_rad, bus_bench::START).unwrap();
    Chain::new(format, Some(ms(6)), plant.with_mechanics(JointMechanics::default()).unwrap())
}

fn moving(format: WireFormat) -> Chain {
    let mut chain = chain(format);
    chain.prepare();
    chain.wanted = Some(JointVector::from([0.1, -0.2, 0.1, 0.2, 0.3, 0.2, 0.3]));
    chain.run(ms(300));
    assert_eq!((chain.driver.state(), chain.gateway.status().state), (DriverState::Moving, GatewayState::Moving));
    chain
}

fn found(chain: &Chain) -> (GatewayState, StopCause) {
    let status = chain.gateway.status();
    (status.state, status.cause)
}

/// Another program that wants to move the arm.
fn next_program(chain: &mut Chain) {
    chain.wanted = None;
    chain.driver = Driver::new(DriverConfig::with_cycle(HOST_CYCLE)).unwrap();
    chain.open();
    chain.request(Request::Connect);
    chain.settle();
}

/// The next program cannot move the arm until an operator resets it.
fn wants_a_reset(chain: &mut Chain, what: &str) {
    next_program(chain);
    let refused = Some(Trip::Fault(FaultCause::Rejected(RejectReason::WrongState)));
    assert_eq!(chain.driver.latched().map(|latched| latched.trip), refused, "{what}");
    assert!(chain.driver.handle_request(chain.now, Request::Enable).is_err(), "{what}");
    chain.request(Request::Reset);
    chain.settle();
    assert_eq!(chain.driver.state(), DriverState::Connected, "{what}: {:?}", chain.driver.latched());
    assert_eq!(found(chain), (GatewayState::Idle, StopCause::None), "{what}");
    chain.prepare();
}

/// Number of ABORT messages in these bytes.
fn aborts(bytes: &[u8]) -> usize {
    let mut count = 0;
    FrameParser::new(ARM).feed(bytes, |received| {
        let Received::Frame(frame) = received else { return };
        let abort = HostMessage::Control(Control::Arm(ArmOperation::Abort));
        count += usize::from(HostMessage::decode(&frame) == Ok(abort));
    });
    count
}

#[test]
fn the_next_program_waits_for_a_reset_whatever_this_one_has_found() {
    for format in WireFormat::ALL {
        for trip in trips() {
            let what = format!("{format}, {trip}");
            let mut chain = moving(format);
            chain.driver.handle_trip(chain.now, trip);
            chain.wanted = None;
            // 30 ms of ramp, the lag of the drives, and the delay of the message.
            chain.run(ms(150));
            assert!(chain.is_at_rest(), "{what}");
            chain.settle();
            // The host's own fault is more specific than the gateway's report of it.
            assert_eq!(chain.driver.latched().map(|latched| latched.trip), Some(trip), "{what}");
            assert_eq!(found(&chain), (GatewayState::Fault, StopCause::HostFault), "{what}");
            assert!(chain.controller.is_braked(), "{what}");
            wants_a_reset(&mut chain, &what);
        }
    }
}

#[test]
fn the_program_that_has_found_it_resets_both() {
    for format in WireFormat::ALL {
        let mut chain = moving(format);
        chain.driver.handle_trip(chain.now, Trip::Fault(FaultCause::Supervisor));
        chain.settle();
        assert_eq!(found(&chain), (GatewayState::Fault, StopCause::HostFault));
        chain.request(Request::Reset);
        chain.settle();
        assert_eq!((chain.driver.state(), found(&chain).0), (DriverState::Connected, GatewayState::Idle));
        chain.prepare();
        // Again, because an earlier report does not count for a later fault.
        chain.driver.handle_trip(chain.now, Trip::Fault(FaultCause::Released));
        chain.settle();
        assert_eq!(found(&chain), (GatewayState::Fault, StopCause::HostFault));
    }
}

#[test]
fn what_ends_in_order_latches_nothing() {
    for format in WireFormat::ALL {
        for moves in [true, false] {
            let mut chain = moving(format);
            if !moves {
                chain.request(Request::Hold);
                chain.wanted = None;
                chain.run(ms(500));
            }
            chain.request(Request::Stop);
            chain.wanted = None;
            chain.settle();
            assert_eq!((chain.driver.state(), found(&chain).0), (DriverState::Connected, GatewayState::Idle));
            chain.request(Request::Disconnect);
            chain.run(ms(100));
            next_program(&mut chain);
            chain.prepare();
        }
    }
}

/// A program that only inspects an arm reports its faults, and leaves the gateway unchanged.
#[test]
fn what_is_found_while_looking_latches_nothing() {
    for format in WireFormat::ALL {
        let mut chain = chain(format);
        chain.request(Request::Disconnect);
        chain.request(Request::Connect);
        for _ in 0..50 {
            if chain.gateway.status().state != GatewayState::Started {
                chain.run(ms(1));
            }
        }
        assert_eq!(chain.gateway.status().state, GatewayState::Started, "{format}");
        chain.driver.handle_trip(chain.now, Trip::Fault(FaultCause::OtherArm { arm: 9 }));
        chain.settle();
        chain.run(ms(1500));
        assert_eq!(found(&chain), (GatewayState::Idle, StopCause::None), "{format}");
        next_program(&mut chain);
        chain.prepare();
    }
}

/// The owner of the gateway has stopped it: the arm has no fault, and the program that drove it stops as well.
#[test]
fn a_gateway_that_its_owner_stops_latches_nothing() {
    let mut chain = moving(WireFormat::BigEndian6x10);
    chain.gateway.stop(chain.now);
    chain.settle();
    chain.run(ms(500));
    let stopped = FaultCause::GatewayStopped { gateway: GatewayState::Stopping };
    assert_eq!(chain.driver.latched().map(|latched| latched.trip), Some(Trip::Fault(stopped)));
    assert_eq!(found(&chain), (GatewayState::Idle, StopCause::None));
}

/// Also with closed brakes: the program wanted to move.
#[test]
fn what_is_found_before_the_brakes_open_latches_too() {
    for format in WireFormat::ALL {
        let mut chain = chain(format);
        chain.request(Request::Enable);
        chain.run(ms(300));
        assert_eq!(chain.gateway.status().state, GatewayState::Started, "{format}");
        chain.driver.handle_trip(chain.now, Trip::Fault(FaultCause::Supervisor));
        chain.settle();
        assert_eq!(found(&chain), (GatewayState::Fault, StopCause::HostFault), "{format}");
        wants_a_reset(&mut chain, "enabling");
    }
}

/// A fault during a requested stop counts as well.
#[test]
fn what_is_found_while_an_ordered_stop_is_under_way_latches() {
    for format in WireFormat::ALL {
        for after in [0, 20, 60, 200] {
            let mut chain = moving(format);
            chain.request(Request::Stop);
            chain.wanted = None;
            chain.run(ms(after));
            chain.driver.handle_trip(chain.now, Trip::Fault(FaultCause::Supervisor));
            chain.settle();
            assert_eq!(found(&chain), (GatewayState::Fault, StopCause::HostFault), "{format}, {after}");
            wants_a_reset(&mut chain, "stopping");
        }
    }
}

#[test]
fn a_lost_message_is_repeated_and_a_dead_line_latches() {
    for format in WireFormat::ALL {
        for (way, lost, expected) in [
            (Way::ToGateway, 1, StopCause::HostFault),
            (Way::ToGateway, 2, StopCause::HostFault),
            (Way::ToHost, 1, StopCause::HostFault),
            (Way::ToHost, 3, StopCause::HostFault),
            (Way::ToGateway, 1000, StopCause::HostSilent),
        ] {
            let what = format!("{format}, {way:?} {lost}");
            let mut chain = moving(format);
            // Messages in transit arrive first, so that the next frame is the first of the stop.
            chain.wanted = None;
            chain.run(ms(7));
            let mut left = lost;
            chain.spoil = Some(Box::new(move |bytes_way, bytes| {
                if bytes_way == way && left > 0 {
                    left -= 1;
                    return Vec::new();
                }
                vec![(Duration::ZERO, bytes)]
            }));
            chain.driver.handle_trip(chain.now, Trip::Fault(FaultCause::Supervisor));
            chain.run(ms(200));
            assert!(chain.is_at_rest(), "{what}");
            assert_eq!(found(&chain), (GatewayState::Fault, expected), "{what}");
            chain.settle();
            chain.spoil = None;
            chain.run(ms(100));
            wants_a_reset(&mut chain, &what);
        }
    }
}

/// The report is sent once, not in each cycle.
#[test]
fn a_gateway_that_knows_the_fault_receives_no_second_report() {
    use std::sync::atomic::{AtomicUsize, Ordering};
    let count = std::sync::Arc::new(AtomicUsize::new(0));
    let mut chain = moving(WireFormat::BigEndian6x10);
    let counted = std::sync::Arc::clone(&count);
    chain.spoil = Some(Box::new(move |way, bytes| {
        if way == Way::ToGateway {
            counted.fetch_add(aborts(&bytes), Ordering::SeqCst);
        }
        vec![(Duration::ZERO, bytes)]
    }));
    chain.driver.handle_trip(chain.now, Trip::Fault(FaultCause::Supervisor));
    chain.settle();
    chain.run(ms(500));
    assert_eq!(count.load(Ordering::SeqCst), 1);
}

/// The gateway has detected the button as well: the host's report must not replace it.
#[test]
fn an_emergency_stop_stays_one() {
    let mut chain = moving(WireFormat::BigEndian6x10);
    chain.inject("e-stop press");
    chain.run(ms(5));
    assert_eq!(found(&chain), (GatewayState::EmergencyStop, StopCause::EmergencyStop));
    // For example the other arm of the cell.
    chain.driver.handle_trip(chain.now, Trip::Fault(FaultCause::OtherArm { arm: 9 }));
    chain.settle();
    assert_eq!(found(&chain), (GatewayState::EmergencyStop, StopCause::EmergencyStop));
    assert_eq!(chain.driver.state(), DriverState::EStop);
    // The reverse: the host keeps the emergency stop that it detected.
    let mut chain = moving(WireFormat::BigEndian6x10);
    let pressed = Trip::EStop(EmergencyStopCause::Switch { signal: Signal::EmergencyStop, axis: None, word: 0x0008 });
    chain.driver.handle_trip(chain.now, pressed);
    chain.settle();
    assert_eq!(chain.driver.state(), DriverState::EStop);
    assert_eq!(chain.driver.latched().map(|latched| latched.trip), Some(pressed));
}
