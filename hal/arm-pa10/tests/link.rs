//! The driver over its link to a gateway.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{
    Driver, DriverConfig, DriverState, EmergencyStopCause, FaultCause, Request, Trip, WarmUpFailure,
};
use pb3dp_arm_pa10::link::{GatewayLink, HelloError, LinkError};
use pb3dp_arm_pa10_protocol::codec::{AngleCounts, ServoAlarm, ServoWord, WireFormat};
use pb3dp_arm_pa10_protocol::codec::{Signal, SignalSource};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, ArmOperation, Control, FaultReport, Frame, FrameParser, GatewayMessage, GatewayState, Geometry, HostMessage,
    MessageError, MotionQuantity, Payload, Received, RejectReason, StopCause,
};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_arm_pa10_test_support::link_rig::{ARM, CYCLE, FakeGateway, Rig, driver_config, link_config, ms, velocity};
use pb3dp_geometry::MonotonicTime;

fn rigs() -> [Rig; 2] {
    WireFormat::ALL.map(Rig::new)
}

#[test]
fn an_arm_goes_up_and_down_over_a_gateway_in_every_format() {
    for mut rig in rigs() {
        rig.lead_to_moving();
        assert_eq!(rig.gateway.state, GatewayState::Moving);
        assert!((rig.gateway.speeds - velocity()).amax() < 1e-9, "{}", rig.gateway.speeds);
        let joints = rig.driver.joints().unwrap();
        assert!((joints.position_rad[6] - AngleCounts(7000).to_rad()).abs() < 1e-6);
        assert!(rig.now.saturating_since(joints.at) <= ms(12), "{:?}", rig.now.saturating_since(joints.at));
        rig.request(Request::Stop);
        rig.settle();
        assert_eq!((rig.driver.state(), rig.gateway.state), (DriverState::Connected, GatewayState::Idle));
        assert!(rig.gateway.rejected.is_empty(), "{:?}", rig.gateway.rejected);
        let counters = rig.driver.counters();
        assert_eq!((counters.lost, counters.damaged, counters.mismatched, counters.late), (0, 0, 0, 0));
    }
}

#[test]
fn a_link_that_nobody_answered_sends_nothing() {
    let mut link = GatewayLink::new(link_config(WireFormat::BigEndian6x10));
    let mut driver = Driver::new(DriverConfig::with_cycle(CYCLE)).unwrap();
    let now = MonotonicTime::from_nanos(1_000_000_000);
    driver.handle_request(now, Request::Connect).unwrap();
    let transmit = driver.poll_transmit(now).unwrap();
    assert_eq!(link.send(now, &transmit, driver.activity()), Err(LinkError::NotOpen));
    assert_eq!(link.poll_output(now), None);
}

#[test]
fn a_gateway_of_another_arm_or_format_is_refused_by_name() {
    let greet = |config| {
        let mut link = GatewayLink::new(config);
        let mut driver = Driver::new(driver_config()).unwrap();
        let mut gateway = FakeGateway::new(ARM, WireFormat::BigEndian6x10);
        let now = MonotonicTime::from_nanos(1_000_000_000);
        link.open(now);
        let answer = gateway.answer(&link.poll_output(now).unwrap());
        link.handle_bytes(now, &answer, &mut driver);
        assert_eq!(link.hello(), None);
        assert_eq!(link.poll_output(now), None);
        *link.hello_error().unwrap()
    };
    let good = link_config(WireFormat::BigEndian6x10);
    let (a, b) = (WireFormat::LittleEndian5x8, WireFormat::BigEndian6x10);
    assert_eq!(greet(GatewayLinkConfig { format: a, ..good }), HelloError::Format { got: b, configured: a });
    let geometry = Geometry::FirstGeneration;
    let expected = HelloError::Geometry { got: Geometry::SecondGeneration, configured: geometry };
    assert_eq!(greet(GatewayLinkConfig { geometry, ..good }), expected);
    let signal = Signal::EmergencyStop;
    let signals = good.signals.with(signal, SignalSource::Wired);
    assert_eq!(greet(GatewayLinkConfig { signals, ..good }), HelloError::NotWired { signal });
    assert!(expected.to_string().contains("set to a second-generation arm"), "{expected}");
}

/// A program of another version, whose frame is sound.
#[test]
fn a_gateway_with_another_set_of_messages_is_refused_by_name() {
    let mut link = GatewayLink::new(link_config(WireFormat::BigEndian6x10));
    let mut driver = Driver::new(driver_config()).unwrap();
    let mut gateway = FakeGateway::new(ARM, WireFormat::BigEndian6x10);
    let now = MonotonicTime::from_nanos(1_000_000_000);
    link.open(now);
    let mut parser = FrameParser::new(ARM);
    let mut answer = None;
    parser.feed(&gateway.answer(&link.poll_output(now).unwrap()), |received| answer = Some(received));
    let Some(Received::Frame(frame)) = answer else { panic!("{answer:?}") };
    let mut payload = frame.payload.to_vec();
    payload[1] = 3;
    let other = Frame { payload: Payload::from_slice(&payload).unwrap(), ..frame };
    link.handle_bytes(now, &other.encode(), &mut driver);
    let error = *link.hello_error().unwrap();
    assert_eq!(
        error,
        HelloError::Unreadable(MessageError::Value { frame_type: 0x81, field: "set of messages", got: 3 })
    );
    assert_eq!(link.hello(), None);
}

/// A gateway without a watchdog, or with one longer than the specification allows, does not stop the arm in time.
#[test]
fn a_gateway_without_a_watchdog_is_refused() {
    for (watchdog_us, is_refused) in [
        ([20_000, 50_000], false),
        ([100_000, 200_000], false),
        ([20_000, 200_001], true),
        ([0, 0], true),
        ([50_000, 20_000], true),
    ] {
        let mut link = GatewayLink::new(link_config(WireFormat::BigEndian6x10));
        let mut driver = Driver::new(driver_config()).unwrap();
        let mut gateway = FakeGateway::new(ARM, WireFormat::BigEndian6x10);
        gateway.watchdog_us = watchdog_us;
        let now = MonotonicTime::from_nanos(1_000_000_000);
        link.open(now);
        let answer = gateway.answer(&link.poll_output(now).unwrap());
        link.handle_bytes(now, &answer, &mut driver);
        assert_eq!(link.hello().is_none(), is_refused, "{watchdog_us:?}");
        let refused = matches!(link.hello_error(), Some(HelloError::Watchdog(_)));
        assert_eq!(refused, is_refused, "{:?}", link.hello_error());
    }
}

/// Otherwise a host would wait an hour for the brakes, with each stop.
#[test]
fn a_gateway_with_brakes_that_nobody_has_is_refused() {
    for (brake_us, is_refused) in [(0, false), (5_000_000, false), (5_000_001, true), (4_000_000_000, true)] {
        let mut link = GatewayLink::new(link_config(WireFormat::BigEndian6x10));
        let mut driver = Driver::new(driver_config()).unwrap();
        let mut gateway = FakeGateway::new(ARM, WireFormat::BigEndian6x10);
        gateway.brake_us = brake_us;
        let now = MonotonicTime::from_nanos(1_000_000_000);
        link.open(now);
        let answer = gateway.answer(&link.poll_output(now).unwrap());
        link.handle_bytes(now, &answer, &mut driver);
        assert_eq!(link.hello().is_none(), is_refused, "{brake_us}");
        let text = link.hello_error().map(ToString::to_string);
        let got = format!("{:?}", Duration::from_micros(brake_us.into()));
        assert_eq!(text.is_some_and(|text| text.contains(&got) && text.contains("at most 5s")), is_refused);
    }
}

#[test]
fn an_idle_link_shows_that_the_host_is_there() {
    let mut rig = Rig::new(WireFormat::BigEndian6x10);
    rig.request(Request::Connect);
    rig.settle();
    rig.gateway.messages.clear();
    rig.run(ms(1100));
    assert_eq!(rig.gateway.messages, [HostMessage::Heartbeat; 4]);
    assert_eq!(rig.driver.counters().mismatched + rig.driver.counters().late, 0);
}

/// After kill -9 of the host the gateway is latched: a new host must not move before an operator resets.
#[test]
fn a_gateway_that_stopped_the_arm_before_wants_a_reset() {
    for mut rig in rigs() {
        rig.gateway.latch(StopCause::HostSilent);
        rig.request(Request::Connect);
        rig.settle();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Rejected(RejectReason::WrongState)));
        rig.gateway.cause_present = true;
        rig.request(Request::Reset);
        rig.settle();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::Rejected(RejectReason::CausePresent)));
        rig.gateway.found = Some(StopCause::ServoAlarm);
        rig.request(Request::Reset);
        rig.settle();
        assert_eq!(rig.trip(), Trip::Fault(FaultCause::CauseNotCleared(StopCause::ServoAlarm)));
        assert!(rig.trip().to_string().contains("an alarm of an axis is still present"));
        rig.gateway.found = Some(StopCause::LocalControl);
        rig.request(Request::Reset);
        rig.settle();
        let switched = "fault: the gateway cannot reset the arm: the switch of the gateway stands on local: type `remote` at the \
                        gateway, then reset";
        assert_eq!(rig.trip().to_string(), switched);
        rig.gateway.cause_present = false;
        rig.gateway.messages.clear();
        rig.request(Request::Reset);
        rig.settle();
        assert_eq!((rig.driver.state(), rig.gateway.state), (DriverState::Connected, GatewayState::Idle));
        let reset = HostMessage::Control(Control::Arm(ArmOperation::Reset));
        assert_eq!(rig.gateway.messages.iter().filter(|message| **message == reset).count(), 1);
    }
}

#[test]
fn a_gateway_that_latches_during_motion_stops_the_driver_with_its_cause() {
    let mut rig = Rig::new(WireFormat::BigEndian6x10);
    rig.lead_to_moving();
    rig.gateway.latch(StopCause::CycleMissed);
    rig.run(ms(30));
    assert_eq!(rig.trip(), Trip::Fault(FaultCause::Gateway(StopCause::CycleMissed)));
    rig.settle();
}

/// The other arm stopped, or a monitor detected a fault: the gateway gets one report, latches, and refuses only the E of a stop
/// order that it has completed by itself.
#[test]
fn a_fault_that_the_host_found_latches_the_gateway() {
    for mut rig in rigs() {
        for trip in [
            Trip::Fault(FaultCause::CommandTimeout { age: ms(60), allowed: ms(50) }),
            Trip::EStop(EmergencyStopCause::Gateway),
        ] {
            if rig.driver.state().is_latched() {
                rig.request(Request::Reset);
                rig.settle();
            }
            if rig.driver.state() == DriverState::Disconnected {
                rig.lead_to_moving();
            } else {
                rig.lead_on_to_moving();
            }
            rig.driver.handle_trip(rig.now, trip);
            rig.settle();
            assert_eq!(rig.trip(), trip);
            assert_eq!((rig.gateway.state, rig.gateway.cause), (GatewayState::Fault, StopCause::HostFault));
            let messages = std::mem::take(&mut rig.gateway.messages);
            let count = |operation| {
                let wanted = HostMessage::Control(Control::Arm(operation));
                messages.iter().filter(|message| **message == wanted).count()
            };
            assert_eq!(count(ArmOperation::Abort), 1, "{trip}");
            let refused = std::mem::take(&mut rig.gateway.rejected);
            assert!(refused.len() >= 3 && refused.iter().all(|reason| *reason == RejectReason::WrongState), "{trip}");
        }
    }
}

/// A third-party gateway without ABORT still stops the arm by the stop order.
#[test]
fn a_gateway_that_does_not_know_abort_gets_the_stop_order() {
    for mut rig in rigs() {
        rig.gateway.knows_abort = false;
        rig.lead_to_moving();
        rig.driver.handle_trip(rig.now, Trip::Fault(FaultCause::Supervisor));
        rig.settle();
        assert_eq!(rig.gateway.rejected, [RejectReason::BadValue]);
        assert_eq!((rig.driver.state(), rig.gateway.state), (DriverState::Fault, GatewayState::Idle));
    }
}

#[test]
fn a_gateway_whose_brakes_need_a_little_longer_is_asked_again_to_end() {
    for mut rig in rigs() {
        rig.lead_to_moving();
        rig.gateway.refuse_end = 2;
        rig.request(Request::Stop);
        rig.settle();
        assert_eq!((rig.driver.state(), rig.gateway.state), (DriverState::Connected, GatewayState::Idle));
    }
}

#[test]
fn a_restarted_gateway_is_greeted_anew_before_a_reset_can_succeed() {
    let mut rig = Rig::new(WireFormat::BigEndian6x10);
    rig.lead_to_moving();
    rig.gateway.restart();
    rig.run(ms(30));
    assert_eq!(rig.trip(), Trip::Fault(FaultCause::Rejected(RejectReason::NotConnected)));
    rig.settle();
    assert_eq!(rig.link.hello(), None);
    rig.open();
    rig.request(Request::Reset);
    rig.settle();
    assert_eq!(rig.driver.state(), DriverState::Connected);
}

#[test]
fn a_restarted_gateway_counts_time_anew_and_its_measurements_are_not_taken_for_old() {
    let mut rig = Rig::new(WireFormat::BigEndian6x10);
    rig.lead_to_moving();
    rig.gateway.restart();
    rig.gateway_behind = rig.now.saturating_since(MonotonicTime::ZERO);
    rig.run(ms(20));
    assert_eq!(rig.driver.state(), DriverState::Fault);
    rig.settle();
    rig.open();
    rig.request(Request::Reset);
    rig.settle();
    rig.lead_on_to_moving();
    let age = rig.now.saturating_since(rig.driver.joints().unwrap().at);
    assert!(age <= ms(12), "{age:?}");
}

#[test]
fn a_fault_report_names_axis_and_alarm() {
    let over_current = ServoWord(0).with_alarm(ServoAlarm::OverCurrent).0;
    let axis = pb3dp_arm_pa10_protocol::codec::Axis::ALL[3];
    let report = |cause, axis, word| FaultReport { cause, state_before: GatewayState::Moving, axis, word };
    for (report, expected) in [
        (
            report(StopCause::ServoAlarm, Some(axis), over_current),
            Trip::Fault(FaultCause::ServoAlarm { axis, alarm: ServoAlarm::OverCurrent }),
        ),
        (
            report(StopCause::EmergencyStop, Some(axis), 0x0120),
            Trip::EStop(EmergencyStopCause::Axis { axis, alarm: ServoAlarm::DeadManOff }),
        ),
        (
            report(StopCause::EmergencyStop, None, 0x0009),
            Trip::EStop(EmergencyStopCause::Switch { signal: Signal::EmergencyStop, axis: None, word: 0x0009 }),
        ),
        (report(StopCause::EmergencyStop, None, 0), Trip::EStop(EmergencyStopCause::Gateway)),
        (
            report(StopCause::LimitExceeded, Some(axis), 1),
            Trip::Fault(FaultCause::GatewayLimit { axis, quantity: MotionQuantity::Speed }),
        ),
        (report(StopCause::LimitExceeded, Some(axis), 9), Trip::Fault(FaultCause::Gateway(StopCause::LimitExceeded))),
        (report(StopCause::Internal, None, 0), Trip::Fault(FaultCause::Gateway(StopCause::Internal))),
    ] {
        let mut rig = Rig::new(WireFormat::BigEndian6x10);
        rig.lead_to_moving();
        let bytes = rig.gateway.frame(&GatewayMessage::Fault(report), 0).encode();
        rig.link.handle_bytes(rig.now, &bytes, &mut rig.driver);
        assert_eq!(rig.trip(), expected);
    }
}

#[test]
fn a_frame_of_the_other_arm_stops_this_one() {
    let mut rig = Rig::new(WireFormat::BigEndian6x10);
    rig.lead_to_moving();
    let other = FakeGateway::new(ArmId(1), WireFormat::BigEndian6x10);
    let report = FaultReport { cause: StopCause::None, state_before: GatewayState::Idle, axis: None, word: 0 };
    let bytes = other.frame(&GatewayMessage::Fault(report), 0).encode();
    rig.link.handle_bytes(rig.now, &bytes, &mut rig.driver);
    assert_eq!(rig.trip(), Trip::Fault(FaultCause::WrongArm { got: 1 }));
}

#[test]
fn noise_on_the_line_is_survived_and_counted_and_keeps_the_brakes_on() {
    let damaged = {
        let gateway = FakeGateway::new(ARM, WireFormat::BigEndian6x10);
        let report = FaultReport { cause: StopCause::None, state_before: GatewayState::Idle, axis: None, word: 0 };
        let mut bytes = gateway.frame(&GatewayMessage::Fault(report), 9).encode().as_slice().to_vec();
        bytes[18] ^= 0xFF;
        bytes
    };
    let mut rig = Rig::new(WireFormat::BigEndian6x10);
    rig.lead_to_moving();
    rig.noise = damaged.clone();
    rig.request(Request::Hold);
    rig.run(ms(100));
    assert_eq!((rig.driver.state(), rig.driver.counters().damaged), (DriverState::Holding, 1));
    assert_eq!(rig.driver.counters().lost, 0);

    let mut rig = Rig::new(WireFormat::BigEndian6x10);
    rig.request(Request::Connect);
    rig.settle();
    rig.request(Request::Enable);
    rig.run(ms(300));
    rig.noise = damaged;
    rig.settle();
    assert!(matches!(rig.driver.warm_up_failure(), Some(WarmUpFailure::Damaged { bad: 1, .. })));
}
