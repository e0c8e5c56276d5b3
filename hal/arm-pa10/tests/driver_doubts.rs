//! The driver with too little information from the arm or the gateway: a stop that takes too long, an axis that its servo would
//! not hold, a gateway that stopped without a cause.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{
    Activity, DriverConfig, DriverState, FaultCause, Reply, Request, Sample, Trip, WarmUpFailure,
};
use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmReply, Axis, AxisReply, AxisStatus, CommStatus, CommWord, ServoWord, SpeedCounts, TorqueCounts,
    TorqueScale, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, RejectReason, State, StopCause};
use pb3dp_arm_pa10_protocol::watchdog::CommandWatchdog;
use pb3dp_arm_pa10_test_support::driver_bench::{Bench, CYCLE, Kind};
use pb3dp_kinematics::JointVector;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn trip(bench: &Bench) -> Trip {
    bench.driver.latched().unwrap().trip
}

/// A stop that exceeds its time limit is not abandoned while the arm moves: it becomes an emergency stop order, which is
/// completed.
#[test]
fn a_stop_that_drags_on_is_ended_as_after_a_fault() {
    let config = DriverConfig { activity_timeout: ms(4000), ..DriverConfig::with_cycle(CYCLE) };
    let mut bench = Bench::with_config(config);
    bench.lead_to(DriverState::Moving);
    bench.driver.handle_request(bench.now, Request::Move(JointVector::repeat(6.5))).unwrap();
    let from = bench.sent.len();
    bench.request(Request::Stop);
    bench.run(ms(3000));
    // Late in the stop, when little of its time is left.
    bench.now = bench.now + ms(100);
    bench.driver.handle_trip(bench.now, Trip::Fault(FaultCause::Supervisor));
    bench.now = bench.now + ms(950);
    bench.settle();
    let kinds = bench.only_kinds_since(from);
    assert_eq!(kinds, [Kind::Motion, Kind::Rest, Kind::Braked, Kind::Off, Kind::End]);
    // A stop whose driver was not polled for too long.
    let mut bench = Bench::with_config(config);
    bench.lead_to(DriverState::Moving);
    let from = bench.sent.len();
    bench.request(Request::Stop);
    bench.run(ms(50));
    bench.now = bench.now + ms(4001);
    bench.settle();
    let Trip::Fault(FaultCause::ActivityTimeout { activity: Activity::Stopping, .. }) = trip(&bench) else {
        panic!("{}", trip(&bench))
    };
    let kinds = bench.only_kinds_since(from);
    assert_eq!(kinds, [Kind::Motion, Kind::Rest, Kind::Braked, Kind::Off, Kind::End]);
}

/// The status of an arm says more than a gateway that refuses a reset because the cause is still present. Any other refusal is
/// reported.
#[test]
fn a_refused_reset_is_reported_unless_the_arm_says_more() {
    let by_arm = FaultCause::ServoAlarm { axis: Axis::ALL[3], alarm: ServoWord(0x00E0).alarm().unwrap() };
    let silent = StopCause::HostSilent;
    for (by_alarm, answer, expected) in [
        (true, Reply::Rejected(RejectReason::CausePresent), by_arm),
        (true, Reply::CauseNotCleared(silent), by_arm),
        (true, Reply::Rejected(RejectReason::WrongState), FaultCause::Rejected(RejectReason::WrongState)),
        (false, Reply::CauseNotCleared(silent), FaultCause::CauseNotCleared(silent)),
        (false, Reply::Rejected(RejectReason::CausePresent), FaultCause::Rejected(RejectReason::CausePresent)),
    ] {
        let mut bench = Bench::in_state(if by_alarm { DriverState::Fault } else { DriverState::Holding });
        if !by_alarm {
            bench.driver.handle_trip(bench.now, Trip::Fault(FaultCause::Supervisor));
            bench.settle();
        }
        let from = bench.sent.len();
        bench.request(Request::Reset);
        while bench.only_kinds_since(from).last() != Some(&Kind::Start) {
            bench.run(Duration::from_micros(500));
        }
        bench.driver.handle_reply(bench.now, &answer);
        bench.settle();
        assert_eq!((bench.driver.state(), trip(&bench)), (DriverState::Fault, Trip::Fault(expected)), "{answer:?}");
    }
}

/// An arm that reports this itself would fall as soon as its brakes open.
#[test]
fn brakes_do_not_open_on_an_arm_that_says_that_it_does_not_follow() {
    let one = FaultCause::AxisUncontrollable { axis: Axis::ALL[3], word: 0x8000 };
    let all = FaultCause::ArmUncontrollable { word: 0x4001 };
    for (servo, comm, cause, failure) in [
        (0x8000, 1, one, WarmUpFailure::AxisUncontrollable { axis: Axis::ALL[3], word: 0x8000 }),
        (0, 0x4001, all, WarmUpFailure::ArmUncontrollable { word: 0x4001 }),
    ] {
        let spoil = |bench: &mut Bench| {
            bench.peer.servo[3] = ServoWord(servo);
            bench.peer.comm = CommWord(comm);
        };
        // At the end of the warm-up.
        let mut bench = Bench::in_state(DriverState::Connected);
        spoil(&mut bench);
        bench.request(Request::Enable);
        bench.settle();
        assert_eq!((bench.driver.state(), bench.driver.warm_up_failure()), (DriverState::Connected, Some(&failure)));
        assert_eq!(bench.only_kinds_since(0).iter().filter(|kind| **kind == Kind::Rest).count(), 0);
        // During the opening of the brakes, and while the arm holds.
        for (state, request) in [(DriverState::Enabled, Some(Request::ReleaseBrakes)), (DriverState::Holding, None)] {
            let mut bench = Bench::in_state(state);
            request.into_iter().for_each(|request| bench.request(request));
            bench.run(CYCLE * 3);
            spoil(&mut bench);
            bench.settle();
            bench.run(CYCLE * 3);
            assert_eq!(trip(&bench), Trip::Fault(cause), "{state}");
        }
    }
}

/// R5: replies take less than half of the shorter watchdog time, which may be that of the gateway.
#[test]
fn the_warm_up_counts_with_the_watchdog_of_the_gateway() {
    let config =
        DriverConfig { watchdog: CommandWatchdog::new(ms(20), ms(50)).unwrap(), ..DriverConfig::with_cycle(CYCLE) };
    for (stop_after, is_refused) in [(ms(50), false), (ms(200), false), (ms(10), true)] {
        let mut bench = Bench::with_config(config);
        bench.peer.delay = ms(7);
        bench.lead_to(DriverState::Connected);
        bench.driver.note_watchdog(stop_after);
        bench.request(Request::Enable);
        bench.settle();
        let failure = bench.driver.warm_up_failure();
        assert_eq!(matches!(failure, Some(WarmUpFailure::Slow { .. })), is_refused, "{stop_after:?}: {failure:?}");
    }
}

/// R2, R4: a gateway that another program has stopped does not move the arm, and shows this only in its state.
#[test]
fn a_gateway_that_stopped_by_itself_is_a_fault_whatever_the_cause() {
    let axis = AxisReply {
        status: AxisStatus::Servo(ServoWord(0)),
        angle: AngleCounts(580_267),
        speed: Some(SpeedCounts(-500)),
        torque: TorqueCounts(7),
    };
    let reply = ArmReply { axes: [axis; 7], comm: CommStatus::Comm(CommWord(0x0001)) };
    let report_state = |bench: &mut Bench, gateway| {
        bench.now = bench.now + CYCLE;
        assert!(bench.driver.poll_transmit(bench.now).is_some());
        let mut report_state =
            State::from_reply(&reply, &TorqueScale::of_format(WireFormat::BigEndian6x10), 0).unwrap();
        (report_state.gateway, report_state.cause) = (gateway, StopCause::None);
        bench.driver.handle_reply(bench.now, &Reply::Sample(Sample::from_state(&report_state)));
    };
    for state in [DriverState::Enabled, DriverState::Holding, DriverState::Moving] {
        for gateway in [GatewayState::Started, GatewayState::Holding, GatewayState::Moving] {
            let mut bench = Bench::in_state(state);
            report_state(&mut bench, gateway);
            assert_eq!(bench.driver.state(), state, "{gateway}");
        }
        for gateway in [GatewayState::Idle, GatewayState::Stopping] {
            let mut bench = Bench::in_state(state);
            report_state(&mut bench, gateway);
            assert_eq!(trip(&bench), Trip::Fault(FaultCause::GatewayStopped { gateway }), "{state}");
        }
        // A stop that the host itself requested is not a fault.
        let mut bench = Bench::in_state(state);
        bench.request(Request::Stop);
        report_state(&mut bench, GatewayState::Stopping);
        assert_eq!(bench.driver.latched(), None);
    }
}
