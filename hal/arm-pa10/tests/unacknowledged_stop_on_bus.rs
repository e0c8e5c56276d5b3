//! A driver on the bus of a controller without a time-out: unanswered messages are repeated until they are answered.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{Activity, Driver, DriverConfig, DriverState, FaultCause, Request, Trip};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, MockControllerConfig, pa10_joints};
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_test_support::bus_bench::{BUS_CYCLE, BusBench, START, assert_held};
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::{JointMechanics, JointPlant};

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn bench(format: WireFormat) -> BusBench {
    let config = MockControllerConfig { watchdog: None, ..MockControllerConfig::new(format) };
    let bench = BusBench::with(DriverConfig::with_cycle(BUS_CYCLE), config, 1);
    let start_rad = JointVector::from([0.1, 0.7, 0.2, 0.9, 0.1, 0.5, 0.1]);
    let plant = JointPlant::new(pa10_joints().unwrap(), start_rad, START).unwrap();
    *bench.plant.lock().unwrap() = plant.with_mechanics(JointMechanics::default()).unwrap();
    bench
}

fn moving(format: WireFormat) -> BusBench {
    let mut bench = bench(format).moving(JointVector::from([0.1, -0.2, 0.1, 0.2, 0.3, 0.2, 0.3]));
    bench.run(ms(400));
    assert_eq!(bench.driver.state(), DriverState::Moving);
    bench
}

fn run_held(bench: &mut BusBench, time: Duration, place: &str) {
    let end = bench.now + time;
    while bench.now < end {
        bench.run(ms(1));
        assert_held(&bench.controller, place);
    }
}

fn trip(bench: &BusBench) -> Option<Trip> {
    bench.driver.latched().map(|latched| latched.trip)
}

fn is_link_lost(bench: &BusBench) -> bool {
    matches!(trip(bench), Some(Trip::Fault(FaultCause::LinkLost { .. })))
}

/// Stationary, brakes closed, control mode off, E answered.
fn assert_ended(bench: &BusBench, place: &str) {
    assert!(bench.is_at_rest() && bench.controller.is_braked(), "{place}: it moves with {} rad/s", bench.speed());
    assert_eq!(bench.controller.mode(), ControlMode::Adjustment, "{place}");
    assert!(!bench.driver.stop_unacknowledged() && bench.driver.activity() == Activity::None, "{place}");
}

fn reset(bench: &mut BusBench, place: &str) {
    bench.wanted = None;
    bench.request(Request::Reset);
    run_held(bench, ms(700), place);
    assert_eq!(bench.driver.state(), DriverState::Connected, "{place}: {:?}", bench.driver.latched());
    assert_ended(bench, place);
}

/// A program is killed and sends nothing more, and another one starts.
fn killed(bench: &mut BusBench) {
    bench.wanted = None;
    bench.driver = Driver::new(DriverConfig::with_cycle(BUS_CYCLE)).unwrap();
    bench.letters.clear();
}

#[test]
fn an_outage_that_ends_at_any_step_of_the_stop_order_leaves_no_arm_moving() {
    for format in WireFormat::ALL {
        for outage_ms in (12..340).step_by(4).chain([600, 1000, 11_000]) {
            let place = format!("{format}, {outage_ms} ms");
            let mut bench = moving(format);
            bench.inject("deaf 1000000");
            run_held(&mut bench, ms(outage_ms), &place);
            assert!(is_link_lost(&bench), "{place}: {:?}", bench.driver.latched());
            bench.inject("deaf 0");
            let before = bench.controller.true_joints().0;
            run_held(&mut bench, ms(320), &place);
            let moved = (bench.controller.true_joints().0 - before).amax();
            assert!(moved < 0.03, "{place}: {moved} rad after the bus was back");
            assert_ended(&bench, &place);
            assert!(is_link_lost(&bench), "{place}");
            reset(&mut bench, &place);
        }
    }
}

#[test]
fn an_outage_during_the_acknowledged_stop_order_does_not_end_it() {
    for format in WireFormat::ALL {
        for heartbeat_ms in (1..230).step_by(6) {
            let place = format!("{format}, heard for {heartbeat_ms} ms");
            let mut bench = moving(format);
            for (time, deaf) in [(0, "deaf 1000000"), (700, "deaf 0"), (heartbeat_ms, "deaf 1000000"), (900, "deaf 0")]
            {
                run_held(&mut bench, ms(time), &place);
                bench.inject(deaf);
            }
            run_held(&mut bench, ms(700), &place);
            assert_ended(&bench, &place);
            reset(&mut bench, &place);
        }
    }
}

/// The controller was powered off and on, ignores C until S, and answers E.
#[test]
fn a_controller_that_was_switched_off_and_on_is_reset() {
    for format in WireFormat::ALL {
        for only_in_control in [false, true] {
            let place = format!("{format}, {only_in_control}");
            let mut bench = moving(format);
            // The brakes of an arm without power close by themselves; until then nothing holds the arm.
            bench.inject("power off");
            bench.run(ms(1000));
            bench.only_in_control = only_in_control;
            bench.inject("power on");
            run_held(&mut bench, ms(1000), &place);
            assert_eq!(bench.driver.stop_unacknowledged(), only_in_control, "{place}");
            assert!(is_link_lost(&bench), "{place}");
            reset(&mut bench, &place);
        }
    }
}

/// A silent arm receives no message that opens a brake or disables a servo.
#[test]
fn a_silent_arm_is_neither_reset_nor_connected() {
    for format in WireFormat::ALL {
        let mut bench = moving(format);
        bench.inject("deaf 1000000");
        bench.run(ms(1000));
        bench.letters.clear();
        bench.wanted = None;
        bench.request(Request::Reset);
        bench.settle();
        assert!(is_link_lost(&bench) && bench.driver.stop_unacknowledged());
        assert!(bench.letters.starts_with('C') && bench.letters.contains("EEE"), "{}", bench.letters);
        assert!(!bench.letters.contains(['S', 'A']), "{}", bench.letters);
        let letters_before = bench.letters.len();
        bench.run(ms(100));
        assert_eq!(bench.letters[letters_before..], "C".repeat(bench.letters.len() - letters_before), "it goes on");
        assert!(bench.letters.len() - letters_before >= 49);
        killed(&mut bench);
        bench.request(Request::Connect);
        bench.settle();
        assert!(is_link_lost(&bench) && bench.driver.stop_unacknowledged());
        assert!(!bench.letters.contains('S'), "{}", bench.letters);
        bench.inject("deaf 0");
        run_held(&mut bench, ms(400), "it is heard");
        assert_ended(&bench, "it is heard");
        reset(&mut bench, "it is heard");
    }
}

/// The bus recovers at any time of a reset, or of the check of a moving arm: any message may be the first to arrive.
#[test]
fn no_first_answer_releases_a_joint() {
    for format in WireFormat::ALL {
        for request in [Request::Reset, Request::Connect] {
            for after_ms in (0..760).step_by(10) {
                let place = format!("{format}, {request:?}, back after {after_ms} ms");
                let mut bench = moving(format);
                bench.inject("deaf 1000000");
                run_held(&mut bench, ms(700), &place);
                bench.wanted = None;
                if request == Request::Connect {
                    killed(&mut bench);
                }
                bench.request(request);
                run_held(&mut bench, ms(after_ms), &place);
                bench.inject("deaf 0");
                run_held(&mut bench, ms(1200), &place);
                assert_ended(&bench, &place);
                if request == Request::Connect {
                    assert!(bench.driver.state().is_latched(), "{place}: an arm that was found in motion");
                }
                if bench.driver.state().is_latched() {
                    reset(&mut bench, &place);
                }
            }
        }
    }
}

#[test]
fn an_arm_whose_program_was_killed_in_motion_is_stopped_and_latched_by_the_next_one() {
    for format in WireFormat::ALL {
        // The slowest motion that an operator would command, and a fast one.
        for velocity in [JointVector::repeat(0.02), JointVector::from([0.1, -0.2, 0.1, 0.2, 0.3, 0.2, 0.3])] {
            let mut bench = bench(format).moving(velocity);
            bench.run(ms(400));
            killed(&mut bench);
            bench.request(Request::Connect);
            let before = bench.controller.true_joints().0;
            run_held(&mut bench, ms(600), "killed");
            let moved_deg = (bench.controller.true_joints().0 - before).amax().to_degrees();
            assert!(moved_deg < 1.0, "{format}: {moved_deg} degrees");
            assert_eq!(trip(&bench), Some(Trip::Fault(FaultCause::FoundDriven)), "{format}, {velocity}");
            assert_ended(&bench, "killed");
            assert!(bench.driver.handle_request(bench.now, Request::Enable).is_err());
            reset(&mut bench, "killed");
            bench.request(Request::Enable);
            bench.settle();
            assert_eq!(bench.driver.state(), DriverState::Enabled);
        }
    }
}

/// If C is answered only in the control mode, an arm that was left with open brakes is detected, too.
#[test]
fn an_arm_that_was_left_holding_is_latched_where_the_controller_shows_it() {
    for format in WireFormat::ALL {
        for only_in_control in [false, true] {
            let mut bench = bench(format).moving(JointVector::zeros());
            bench.only_in_control = only_in_control;
            killed(&mut bench);
            bench.request(Request::Connect);
            run_held(&mut bench, ms(800), "holding");
            assert_ended(&bench, "holding");
            let found = Some(Trip::Fault(FaultCause::FoundDriven));
            assert_eq!(trip(&bench), found.filter(|_| only_in_control), "{format}");
            // An arm that was left in order is not latched.
            if only_in_control {
                reset(&mut bench, "holding");
            }
            killed(&mut bench);
            bench.request(Request::Connect);
            run_held(&mut bench, ms(800), "left in order");
            assert_eq!(bench.driver.state(), DriverState::Connected, "{format}: {:?}", bench.driver.latched());
            assert_ended(&bench, "left in order");
        }
    }
}

/// Two lost replies in a row are tolerated at any time of connecting and stopping, and cause no long delay.
#[test]
fn lost_replies_are_borne_while_an_arm_is_looked_for() {
    for format in WireFormat::ALL {
        for after_ms in 0..220 {
            let mut bench = bench(format);
            bench.request(Request::Connect);
            bench.run(ms(after_ms));
            bench.inject("drop 2");
            bench.settle();
            assert_eq!(bench.driver.state(), DriverState::Connected, "{after_ms}: {:?}", bench.driver.latched());
            assert!(bench.now.saturating_since(START) < ms(520));
        }
    }
}
