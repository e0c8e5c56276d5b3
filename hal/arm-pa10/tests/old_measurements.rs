//! A gateway that answers in time with older and older measurements, in virtual time.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{Activity, DriverState, FaultCause, MEASUREMENT_AGE_MAX, Request, Trip};
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    Frame, FrameParser, GatewayMessage, GatewayState, Received, State, StopCause,
};
use pb3dp_arm_pa10_test_support::bus_bench::plant;
use pb3dp_arm_pa10_test_support::chain::{ARM, Chain, Way};
use pb3dp_kinematics::JointVector;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn moving() -> Chain {
    let mut chain = Chain::new(WireFormat::BigEndian6x10, None, plant());
    chain.prepare();
    chain.wanted = Some(JointVector::from([0.1, -0.2, 0.1, 0.2, 0.3, 0.2, 0.3]));
    chain.run(ms(300));
    assert_eq!(chain.driver.state(), DriverState::Moving);
    chain
}

/// Changes each STATE for the host; the time is that of the gateway, µs.
fn spoil_states(chain: &mut Chain, mut change: impl FnMut(State, u64) -> State + 'static) {
    chain.spoil = Some(Box::new(move |way, bytes| {
        let mut last_frame = None;
        if way == Way::ToHost {
            FrameParser::new(ARM).feed(&bytes, |received| {
                if let Received::Frame(frame) = received {
                    last_frame = Some(frame);
                }
            });
        }
        let state = last_frame.and_then(|frame| match GatewayMessage::decode(&frame) {
            Ok(GatewayMessage::State(state)) => Some((frame, state)),
            _ => None,
        });
        let Some((Frame { sequence, timestamp_us, .. }, state)) = state else { return vec![(Duration::ZERO, bytes)] };
        let sent = GatewayMessage::State(change(state, timestamp_us)).frame(ARM, sequence, timestamp_us);
        vec![(Duration::ZERO, sent.encode().as_slice().to_vec())]
    }));
}

/// R4: old measurements are as bad as no answer.
#[test]
fn a_measurement_that_gets_no_newer_stops_the_arm() {
    let mut chain = moving();
    let mut kept: Option<(State, u64)> = None;
    spoil_states(&mut chain, move |state, now_us| {
        let (old, since_us) = *kept.get_or_insert((state, now_us));
        let passed_us = u32::try_from(now_us - since_us).unwrap();
        State { sample_age_us: old.sample_age_us + passed_us, gateway: state.gateway, cause: state.cause, ..old }
    });
    let begin = chain.now;
    while chain.driver.latched().is_none() && chain.now < begin + ms(500) {
        chain.run(ms(1));
    }
    let latched = *chain.driver.latched().unwrap();
    // The limit, the next answer, and its delay.
    assert!(latched.at <= begin + ms(45), "{:?}", latched.at.saturating_since(begin));
    let Trip::Fault(FaultCause::MeasurementTooOld { age, allowed }) = latched.trip else { panic!("{}", latched.trip) };
    assert!(allowed == MEASUREMENT_AGE_MAX && age > allowed && age <= ms(45), "{age:?}");
    for part in ["the newest measurement is", "the limit is 30ms", "check the gateway's log"] {
        assert!(latched.trip.to_string().contains(part), "{}", latched.trip);
    }
    chain.run(ms(500));
    assert!(chain.is_at_rest() && chain.controller.is_braked());
    assert_eq!(chain.driver.activity(), Activity::None);
    // While this persists, a reset is refused; with new measurements it succeeds.
    chain.request(Request::Reset);
    chain.settle();
    assert!(matches!(chain.driver.latched().unwrap().trip, Trip::Fault(FaultCause::MeasurementTooOld { .. })));
    chain.spoil = None;
    chain.request(Request::Reset);
    chain.settle();
    assert_eq!(chain.driver.state(), DriverState::Connected);
}

/// Lost replies on the bus only make a measurement slightly older.
#[test]
fn a_measurement_within_the_bound_is_followed() {
    let mut chain = moving();
    spoil_states(&mut chain, |state, _| State { sample_age_us: 25_000, ..state });
    chain.run(ms(1000));
    assert_eq!(chain.driver.state(), DriverState::Moving, "{:?}", chain.driver.latched());
}

/// The cause of the gateway's stop is more specific than the age of its measurement.
#[test]
fn a_gateway_that_stopped_is_named_before_the_age() {
    let mut chain = moving();
    spoil_states(&mut chain, |state, _| State {
        sample_age_us: 900_000,
        gateway: GatewayState::Fault,
        cause: StopCause::ControllerSilent,
        ..state
    });
    chain.run(ms(50));
    let trip = chain.driver.latched().unwrap().trip;
    assert_eq!(trip, Trip::Fault(FaultCause::Gateway(StopCause::ControllerSilent)));
}
