//! What an operator reads about an arm that was stopped by a switch or by a lost link.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use pb3dp_arm_pa10::driver::{EmergencyStopCause, Trip};
use pb3dp_arm_pa10_protocol::codec::{Axis, Signal};

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
