//! A program that sends no requests while its arm holds with open brakes.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{DriverState, FaultCause, Request, Trip};
use pb3dp_arm_pa10_test_support::driver_bench::{Bench, Kind};

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// A control loop that hangs does not leave the brakes open for ever; one that sends a request now and then does.
#[test]
fn an_arm_that_holds_for_nobody_stops() {
    let mut bench = Bench::in_state(DriverState::Holding);
    for _ in 0..4 {
        bench.run(ms(4900));
        bench.request(Request::Hold);
    }
    let from = bench.sent.len();
    bench.run(ms(4990));
    assert_eq!(bench.driver.state(), DriverState::Holding);
    assert_eq!(bench.only_kinds_since(from), [Kind::Rest]);
    let from = bench.sent.len();
    bench.run(ms(500));
    let latched = bench.driver.latched().unwrap();
    let Trip::Fault(FaultCause::OwnerSilent { age, allowed }) = latched.trip else { panic!("{}", latched.trip) };
    assert!(allowed == ms(5000) && age > allowed && age <= allowed + ms(20), "{age:?} of {allowed:?}");
    assert_eq!(latched.state_before, DriverState::Holding);
    let runs = bench.kinds_since(from);
    assert_eq!(runs[runs.len() - 3..], [(Kind::Braked, 20), (Kind::Off, 1), (Kind::End, 1)], "{runs:?}");
    // A host that returns cannot continue.
    assert!(bench.driver.handle_request(bench.now, Request::Hold).is_err());
}

/// The time starts with the hold after a velocity, or when the brakes are open.
#[test]
fn the_time_of_an_owner_begins_with_its_last_request() {
    for (before, last) in [(DriverState::Moving, Request::Hold), (DriverState::Enabled, Request::ReleaseBrakes)] {
        let mut bench = Bench::in_state(before);
        bench.request(last);
        bench.settle();
        bench.run(ms(4980));
        assert_eq!(bench.driver.state(), DriverState::Holding, "{last:?}");
        bench.run(ms(40));
        assert_eq!(bench.driver.state(), DriverState::Fault, "{last:?}");
    }
}

/// With closed brakes no requests are necessary.
#[test]
fn behind_closed_brakes_an_owner_may_stay_away() {
    for state in [DriverState::Connected, DriverState::Enabled] {
        let mut bench = Bench::in_state(state);
        bench.run(ms(20_000));
        assert_eq!(bench.driver.state(), state);
    }
}
