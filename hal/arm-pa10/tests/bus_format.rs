//! A controller of the other wire format on the bus, in virtual time.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use pb3dp_arm_pa10::driver::{DriverState, FaultCause, Request, Trip};
use pb3dp_arm_pa10::link::BusLink;
use pb3dp_arm_pa10_emulation::mock_controller::ControlMode;
use pb3dp_arm_pa10_protocol::codec::{SequenceModulus, WireFormat};
use pb3dp_arm_pa10_test_support::bus_bench::BusBench;

/// R17, R19: the message names the format at once, and the brakes stay closed.
#[test]
fn a_controller_of_the_other_format_is_named() {
    let [a, b] = WireFormat::ALL;
    for (got, configured) in [(a, b), (b, a)] {
        let mut bench = BusBench::new(got);
        bench.link = BusLink::new(configured, SequenceModulus::Modulo128);
        bench.request(Request::Connect);
        bench.settle();
        let latched = bench.driver.latched().unwrap();
        assert_eq!(latched.trip, Trip::Fault(FaultCause::ReplyFormat { got, configured }));
        assert_eq!(latched.state_before, DriverState::Disconnected);
        let text = latched.trip.to_string();
        assert!(text.contains(&format!("answers in {got}")) && text.contains("correct wire_format"), "{text}");
        assert!(bench.driver.counters().mismatched > 0);
        assert!(bench.controller.is_braked());
        assert_eq!(bench.controller.mode(), ControlMode::Adjustment);
        // The same after a reset.
        bench.request(Request::Reset);
        bench.settle();
        let again = bench.driver.latched().unwrap().trip;
        assert_eq!(again, Trip::Fault(FaultCause::ReplyFormat { got, configured }));
    }
}
