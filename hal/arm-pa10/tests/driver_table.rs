//! The table of the state machine, all states by all events, written again from the requirements.

use std::time::Duration;

use pb3dp_arm_pa10::driver::table::outcome;
use pb3dp_arm_pa10::driver::{Activity, DriverState, Event, Outcome, Refusal, Request};
use pb3dp_arm_pa10_test_support::driver_bench::{Bench, velocity};

/// The permitted transitions; all others are refused.
fn expected(state: DriverState, event: Event) -> Outcome {
    use DriverState as S;
    use Event as E;
    use Outcome::{Begin, Refuse, Stay, To};
    match (state, event) {
        // The start sequence, one step at a time: connected, enabled, brakes open, moving.
        (S::Disconnected, E::Connect) => Begin(Activity::Connecting),
        (S::Disconnected, E::Inspected) => To(S::Connected),
        (S::Connected, E::Enable) => Begin(Activity::Enabling),
        (S::Connected, E::Warmed) => To(S::Enabled),
        (S::Enabled, E::ReleaseBrakes) => Begin(Activity::Releasing),
        (S::Enabled, E::Released) => To(S::Holding),
        (S::Holding, E::Move) => To(S::Moving),
        (S::Moving, E::Move) => Stay,
        // Holding is permitted in every state with a connected arm without fault.
        (S::Moving, E::Hold) => To(S::Holding),
        (S::Connected | S::Enabled | S::Holding, E::Hold) => Stay,
        // Stopping is one step from every state, and ends with closed brakes.
        (S::Enabled | S::Holding | S::Moving, E::Stop) => Begin(Activity::Stopping),
        (S::Enabled | S::Holding | S::Moving, E::Stopped) => To(S::Connected),
        (S::Disconnected | S::Connected | S::Fault | S::EStop, E::Stop | E::Stopped) => Stay,
        (S::Connected, E::Disconnect) => To(S::Disconnected),
        (S::Disconnected, E::Disconnect) => Stay,
        // Faults and emergency stops may occur in every state; a fault does not replace an emergency stop.
        (S::Fault | S::EStop, E::FaultFound) => Stay,
        (_, E::FaultFound) => To(S::Fault),
        (S::EStop, E::EStopFound) => Stay,
        (_, E::EStopFound) => To(S::EStop),
        // Only a reset leaves these states, and it leads to connected.
        (S::Fault | S::EStop, E::Reset) => Begin(Activity::Clearing),
        (S::Fault | S::EStop, E::Cleared) => To(S::Connected),
        _ => Refuse,
    }
}

#[test]
fn every_state_and_event_has_its_outcome() {
    for state in DriverState::ALL {
        for event in Event::ALL {
            assert_eq!(outcome(state, event), expected(state, event), "{state:?}, {event:?}");
        }
    }
}

#[test]
fn nothing_leads_out_of_a_latched_state_but_a_reset_that_succeeds() {
    for state in [DriverState::Fault, DriverState::EStop] {
        for event in Event::ALL {
            if let Outcome::To(next) = outcome(state, event) {
                let cleared = event == Event::Cleared && next == DriverState::Connected;
                let worse = event == Event::EStopFound && next == DriverState::EStop;
                assert!(cleared || worse, "{state:?}, {event:?} leads to {next:?}");
            }
        }
    }
}

const REQUESTS: [fn() -> Request; 8] = [
    || Request::Connect,
    || Request::Enable,
    || Request::ReleaseBrakes,
    || Request::Move(velocity()),
    || Request::Hold,
    || Request::Stop,
    || Request::Reset,
    || Request::Disconnect,
];

#[test]
fn a_refused_request_is_named_and_sends_nothing() {
    let mut refused = 0;
    for state in DriverState::ALL {
        for request in REQUESTS {
            let (mut asked, request) = (Bench::in_state(state), request());
            let mut untouched = asked.clone();
            let Err(refusal) = asked.driver.handle_request(asked.now, request) else { continue };
            refused += 1;
            assert!(matches!(refusal, Refusal::NotInState { state: named, .. } if named == state), "{refusal}");
            assert!(refusal.to_string().contains(&state.to_string()), "{refusal}");
            asked.run(Duration::from_millis(45));
            untouched.run(Duration::from_millis(45));
            assert_eq!(asked.sent, untouched.sent, "{state:?}, {request:?}");
            assert_eq!(asked.driver.state(), untouched.driver.state(), "{state:?}, {request:?}");
        }
    }
    // 7 states by 8 requests, of which the table allows 20.
    assert_eq!(refused, 56 - 20);
}

#[test]
fn while_something_goes_on_only_stopping_and_holding_are_possible() {
    let begin = [
        (DriverState::Disconnected, Request::Connect, Activity::Connecting),
        (DriverState::Connected, Request::Enable, Activity::Enabling),
        (DriverState::Enabled, Request::ReleaseBrakes, Activity::Releasing),
        (DriverState::Moving, Request::Stop, Activity::Stopping),
        (DriverState::Fault, Request::Reset, Activity::Clearing),
    ];
    for (state, request, activity) in begin {
        let mut bench = Bench::in_state(state);
        bench.request(request);
        bench.run(Duration::from_millis(15));
        assert_eq!(bench.driver.activity(), activity);
        for request in REQUESTS {
            let (mut bench, request) = (bench.clone(), request());
            let answer = bench.driver.handle_request(bench.now, request);
            match request {
                Request::Stop => assert_eq!(answer, Ok(()), "{activity:?}"),
                Request::Hold if !matches!(state, DriverState::Disconnected | DriverState::Fault) => {
                    assert_eq!(answer, Ok(()), "{activity:?}");
                }
                _ => assert!(answer.is_err(), "{activity:?}, {request:?}"),
            }
        }
    }
}
