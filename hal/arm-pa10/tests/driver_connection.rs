//! Checks of the driver before the arm may move, and its processing of measurements.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{
    Activity, BadReply, Driver, DriverConfig, DriverConfigError, DriverState, FaultCause, LimitsCheck, Reply, Request,
    Sample, Trip, WarmUpFailure,
};
use pb3dp_arm_pa10_protocol::codec::{CommWord, TorqueScale, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{RejectReason, State};
use pb3dp_arm_pa10_test_support::driver_bench::{Bench, CYCLE, Kind, arm_reply, kind};
use pb3dp_kinematics::JointVector;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn trip(bench: &Bench) -> Trip {
    bench.driver.latched().unwrap().trip
}

/// R19: the limits in the controller are compared before the arm counts as connected.
#[test]
fn an_arm_with_other_limits_is_not_connected() {
    let mut config = DriverConfig::with_cycle(CYCLE);
    let tolerance_rad = 0.5f64.to_radians();
    config.limits = LimitsCheck::Compare {
        lower_rad: JointVector::repeat(-3.0),
        upper_rad: JointVector::repeat(3.0),
        tolerance_rad,
    };
    let mut bench = Bench::with_config(config);
    bench.peer.limits_rad = [-3.0 + 0.9 * tolerance_rad, 3.0 - 0.9 * tolerance_rad];
    bench.lead_to(DriverState::Connected);
    assert_eq!(bench.only_kinds_since(0), [Kind::Limits, Kind::Start, Kind::Off, Kind::End]);
    assert!(bench.driver.limits().iter().all(|limits| limits.is_some_and(|limits| limits.lower_rad > -3.0)));

    for bad in [[-3.0, 3.0 + 1.1 * tolerance_rad], [f64::NAN, 3.0]] {
        let mut bench = Bench::with_config(config);
        bench.peer.limits_rad = bad;
        bench.request(Request::Connect);
        bench.settle();
        let Trip::Fault(FaultCause::LimitsDiffer { axis, .. }) = trip(&bench) else { panic!("{}", trip(&bench)) };
        assert_eq!(axis.index(), 0);
        bench.request(Request::Reset);
        bench.settle();
        assert!(matches!(trip(&bench), Trip::Fault(FaultCause::LimitsDiffer { .. })), "a reset does not get around it");
        bench.peer.limits_rad = [-3.0, 3.0];
        bench.request(Request::Reset);
        bench.settle();
        assert_eq!(bench.driver.state(), DriverState::Connected);
    }
}

/// R5: the brakes stay closed unless 100 exchanges show a good and fast link.
#[test]
fn a_bad_link_is_refused_before_the_brakes_open() {
    let mut bench = Bench::in_state(DriverState::Connected);
    bench.request(Request::Enable);
    bench.run(ms(500));
    bench.driver.handle_bad_reply(BadReply::Damaged);
    bench.settle();
    assert_eq!(bench.driver.state(), DriverState::Connected);
    assert_eq!(bench.driver.warm_up_failure(), Some(&WarmUpFailure::Damaged { bad: 1, exchanges: 100 }));
    assert_eq!(bench.kinds_since(0).last(), Some(&(Kind::End, 1)));

    bench.request(Request::Enable);
    assert_eq!(bench.driver.warm_up_failure(), None);
    bench.run(ms(500));
    bench.peer.drop_next = 1;
    bench.settle();
    assert_eq!(bench.driver.state(), DriverState::Enabled, "one lost reply in 100 is tolerated");

    bench.request(Request::Stop);
    bench.settle();
    bench.request(Request::Enable);
    for _ in 0..2 {
        bench.run(ms(300));
        bench.peer.drop_next = 1;
    }
    bench.settle();
    let failure = bench.driver.warm_up_failure().unwrap();
    assert!(matches!(failure, WarmUpFailure::Slow { slow: 2, exchanges: 100, .. }), "{failure}");

    bench.peer.comm = CommWord(0x0002);
    bench.request(Request::Enable);
    bench.settle();
    assert_eq!(bench.driver.warm_up_failure(), Some(&WarmUpFailure::PowerTooWarm));
}

#[test]
fn a_configuration_that_is_unsafe_is_refused() {
    let good = DriverConfig::with_cycle(CYCLE);
    let refused = |change: fn(&mut DriverConfig)| {
        let mut config = good;
        change(&mut config);
        Driver::new(config).map(|_| ()).unwrap_err()
    };
    assert!(matches!(refused(|c| c.cycle = ms(20)), DriverConfigError::Cycle { .. }));
    assert!(matches!(refused(|c| c.reply_timeout = ms(11)), DriverConfigError::ReplyTimeout { .. }));
    assert!(matches!(refused(|c| c.warm_up_exchanges = 99), DriverConfigError::TooFew { got: 99, .. }));
    assert!(matches!(refused(|c| c.rest_cycles = 4), DriverConfigError::TooFew { got: 4, .. }));
    assert!(matches!(
        refused(|c| c.deceleration_rad_per_s2[3] = 0.0),
        DriverConfigError::Deceleration { joint: 3, .. }
    ));
    for bad in [0.0, -1.0, 14.6, f64::NAN, f64::INFINITY] {
        let mut config = good;
        config.torque_max_n_m[6] = bad;
        let error = Driver::new(config).map(|_| ()).unwrap_err();
        assert!(matches!(error, DriverConfigError::Torque { joint: 6, .. }), "{error}");
    }
    assert!(matches!(refused(|c| c.torque_for = ms(201)), DriverConfigError::TorqueFor { .. }));
    assert!(matches!(refused(|c| c.owner_timeout = ms(50)), DriverConfigError::OwnerTimeout { .. }));
    assert!(matches!(refused(|c| c.owner_timeout = ms(10_001)), DriverConfigError::OwnerTimeout { .. }));
    let accepts = |change: fn(&mut DriverConfig)| {
        let mut config = good;
        change(&mut config);
        Driver::new(config).is_ok()
    };
    assert!(accepts(|c| c.torque_for = ms(200)) && accepts(|c| c.owner_timeout = ms(10_000)));
    // 2 rad/s at 0.2 rad/s^2 take as long as the time limit of an activity, without the brakes.
    assert!(matches!(refused(|c| c.deceleration_rad_per_s2[2] = 0.2), DriverConfigError::StopTimeout { joint: 2, .. }));
    let error = refused(|c| c.deceleration_rad_per_s2[6] = 1e-300);
    assert!(matches!(error, DriverConfigError::StopTimeout { joint: 6, .. }), "{error}");
    assert!(matches!(refused(|c| c.activity_timeout = ms(2000)), DriverConfigError::ActivityTimeout { .. }));
}

/// A driver that was not polled for a while skips the cycles that it missed, and neither catches up nor hurries.
#[test]
fn after_missed_cycles_the_next_message_comes_one_cycle_later() {
    let mut bench = Bench::in_state(DriverState::Holding);
    let overruns = bench.driver.counters().overruns;
    bench.now = bench.now + ms(35);
    let from = bench.sent.len();
    bench.run(ms(100));
    assert_eq!(bench.sent.len() - from, 10);
    for pair in bench.sent[from..].windows(2) {
        assert_eq!(pair[1].0.saturating_since(pair[0].0), CYCLE);
    }
    assert_eq!(bench.driver.counters().overruns, overruns + 1);
    let (last, _) = bench.sent[bench.sent.len() - 1];
    assert_eq!(bench.driver.transmit_due(), last + CYCLE);
}

#[test]
fn speeds_that_are_not_measured_are_differences_of_angles() {
    let mut bench = Bench::new();
    bench.peer.documented = false;
    bench.lead_to(DriverState::Holding);
    assert_eq!(bench.driver.joints().unwrap().velocity_rad_per_s, JointVector::zeros());
    for _ in 0..20 {
        bench.peer.position_rad[5] += 0.002;
        bench.run(CYCLE);
    }
    let joints = bench.driver.joints().unwrap();
    assert!((joints.velocity_rad_per_s[5] - 0.2).abs() < 1e-9, "{joints:?}");
}

#[test]
fn a_measurement_is_the_same_from_the_bus_and_from_a_gateway() {
    let scale = TorqueScale::of_format(WireFormat::BigEndian6x10);
    let state = State::from_reply(&arm_reply(), &scale, 1500).unwrap();
    let (bus, gateway) = (Sample::from_reply(&arm_reply(), &scale), Sample::from_state(&state));
    assert!(bus.torque_n_m[0] > 0.1 && (bus.torque_n_m - gateway.torque_n_m).amax() <= 0.5e-3, "{}", bus.torque_n_m);
    assert!((bus.position_rad - gateway.position_rad).amax() <= 0.5e-6);
    assert_eq!(bus.velocity_rad_per_s, gateway.velocity_rad_per_s);
    assert_eq!((bus.condition.axes, bus.condition.comm), (gateway.condition.axes, gateway.condition.comm));
    assert_eq!((bus.age, gateway.age), (Duration::ZERO, Duration::from_micros(1500)));
}

#[test]
fn replies_that_nobody_waits_for_are_counted_and_not_used() {
    let mut bench = Bench::new();
    let sample = bench.peer.sample();
    bench.driver.handle_reply(bench.now, &Reply::Sample(sample));
    assert_eq!((bench.driver.sample(), bench.driver.counters().mismatched), (None, 1));
    bench.request(Request::Connect);
    assert!(bench.driver.poll_transmit(bench.now).is_some());
    bench.driver.handle_reply(bench.now, &Reply::Sample(sample));
    assert_eq!((bench.driver.sample(), bench.driver.counters().mismatched), (None, 2));
}

#[test]
fn joints_never_go_back_in_time() {
    let mut bench = Bench::in_state(DriverState::Holding);
    let mut exchange = |age: Duration, position_rad: f64| {
        bench.now = bench.now + CYCLE;
        assert!(bench.driver.poll_transmit(bench.now).is_some());
        let mut sample = bench.peer.sample();
        (sample.age, sample.position_rad) = (age, JointVector::repeat(position_rad));
        bench.driver.handle_reply(bench.now, &Reply::Sample(sample));
        *bench.driver.joints().unwrap()
    };
    let newest = exchange(Duration::ZERO, 1.0);
    assert_eq!(exchange(ms(25), 0.9), newest, "an answer with an older measurement");
    let next = exchange(Duration::ZERO, 1.1);
    assert!(next.at > newest.at && next.position_rad[0] == 1.1);
}

#[test]
fn an_arm_whose_control_mode_is_off_is_sent_nothing_on_a_fault() {
    for leads_down in [false, true] {
        let mut bench = Bench::in_state(if leads_down { DriverState::Holding } else { DriverState::Connected });
        if leads_down {
            bench.request(Request::Stop);
            bench.settle();
        }
        let from = bench.sent.len();
        bench.driver.handle_unplugged(bench.now);
        bench.run(ms(500));
        assert_eq!((bench.driver.state(), bench.sent.len()), (DriverState::Fault, from));
    }
}

/// A gateway may have closed its brakes later than the driver assumes: it refuses E, and the driver sends E again.
#[test]
fn a_refused_end_is_repeated() {
    for refusals in 1..=5 {
        let mut bench = Bench::in_state(DriverState::Moving);
        bench.request(Request::Stop);
        let mut refused = 0;
        let ends = |bench: &Bench| bench.sent.iter().filter(|(_, message)| kind(message) == Kind::End).count();
        let before = ends(&bench);
        while bench.driver.activity() != Activity::None {
            let ends_sent = ends(&bench);
            bench.run(Duration::from_micros(500));
            if ends(&bench) > ends_sent && refused < refusals {
                bench.driver.handle_reply(bench.now, &Reply::Rejected(RejectReason::WrongState));
                refused += 1;
            }
        }
        assert_eq!(ends(&bench) - before, (refusals + 1).min(3), "{refusals}");
        assert_eq!(bench.driver.state(), DriverState::Connected);
    }
}
