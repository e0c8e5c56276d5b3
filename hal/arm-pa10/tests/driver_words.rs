//! What an operator reads about an arm that was stopped by a switch or by a lost link.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{DriverConfig, EmergencyStopCause, FaultCause, Request, Trip};
use pb3dp_arm_pa10_protocol::codec::{Axis, Signal};
use pb3dp_arm_pa10_test_support::driver_bench::{Bench, CYCLE};

#[test]
fn a_switch_bit_is_reported_with_its_place_and_its_remedy() {
    for (signal, axis, name, place, remedy) in [
        (Signal::EmergencyStop, None, "emergency stop", "controller", "release the emergency stop"),
        (Signal::DeadMan, None, "dead-man switch", "controller", "hold the dead-man switch"),
        (Signal::LimitSwitch, Some(3), "limit switch", "axis 4 (E1)", "move the arm away from the limit switch"),
    ] {
        let axis = axis.map(|index: usize| Axis::ALL[index]);
        let trip = Trip::EStop(EmergencyStopCause::Switch { signal, axis, word: 0x2008 });
        let expected = format!(
            "{name}: {place}: status word 0x2008 shows the {name} by the bits of the configuration; {remedy}, then reset"
        );
        assert_eq!(trip.to_string(), expected);
    }
}

/// The brake time ends before the third lost reply, which would be a fault by itself.
#[test]
fn a_stop_that_nobody_answered_names_the_number_of_lost_replies() {
    let brake_time = Duration::from_millis(5);
    let mut bench = Bench::on_bus(DriverConfig { brake_time, ..DriverConfig::with_cycle(CYCLE) });
    bench.peer.answers = false;
    bench.request(Request::Connect);
    bench.run(CYCLE / 2);
    bench.request(Request::Stop);
    bench.settle();
    assert_eq!(bench.driver.latched().unwrap().trip, Trip::Fault(FaultCause::LinkLost { misses: 2 }));
    assert!(bench.driver.stop_unacknowledged());
}
