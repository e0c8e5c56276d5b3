//! Messages of the driver and their times, with a scripted arm.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{
    Activity, DriverConfig, DriverState, EmergencyStopCause, FaultCause, Refusal, Reply, Request, Sample, Trip,
};
use pb3dp_arm_pa10_protocol::codec::Signal;
use pb3dp_arm_pa10_protocol::codec::{
    CommAlarm, CommWord, ControlMessage, ServoAlarm, ServoWord, TorqueScale, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, RejectReason, State, StopCause};
use pb3dp_arm_pa10_test_support::driver_bench::{Bench, CYCLE, Kind, arm_reply, kind, velocity};
use pb3dp_kinematics::JointVector;

const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

fn trip(bench: &Bench) -> Trip {
    bench.driver.latched().unwrap().trip
}

/// Commanded speeds from an index on, as a fraction of the requested velocity (largest joint).
fn parts_since(bench: &Bench, from: usize) -> Vec<f64> {
    parts_of_joint_since(bench, from, 6)
}

fn parts_of_joint_since(bench: &Bench, from: usize, joint: usize) -> Vec<f64> {
    let sent = bench.sent[from..].iter();
    sent.filter_map(|(_, message)| match message {
        ControlMessage::Cyclic(command) => Some(command.velocity_rad_per_s()[joint] / velocity()[joint]),
        _ => None,
    })
    .collect()
}

#[test]
fn the_way_up_sends_what_the_sources_ask_for() {
    let mut bench = Bench::new();
    bench.run(ms(100));
    assert!(bench.sent.is_empty());
    bench.request(Request::Connect);
    bench.settle();
    assert_eq!(bench.kinds_since(0), [(Kind::Start, 1), (Kind::Off, 1), (Kind::End, 1)]);
    assert_eq!(bench.driver.state(), DriverState::Connected);

    let from = bench.sent.len();
    bench.run(ms(100));
    assert_eq!(bench.sent.len(), from, "a connected arm is left alone");
    bench.request(Request::Enable);
    bench.settle();
    assert_eq!(bench.kinds_since(from), [(Kind::Start, 1), (Kind::Braked, 100)]);
    assert_eq!(bench.driver.state(), DriverState::Enabled);

    let from = bench.sent.len();
    bench.request(Request::ReleaseBrakes);
    bench.settle();
    assert_eq!(bench.kinds_since(from), [(Kind::Rest, 21)], "200 ms at speed 0");
    assert_eq!(bench.driver.state(), DriverState::Holding);

    let from = bench.sent.len();
    bench.request(Request::Move(velocity()));
    bench.run_moving(ms(100));
    assert_eq!(bench.only_kinds_since(from), [Kind::Motion]);
    assert!((parts_since(&bench, from)[0] - 1.0).abs() < 1e-9);
    assert_eq!(bench.driver.counters().lost, 0);
    assert_eq!(bench.driver.counters().overruns, 0);
}

/// A gateway counts the brake time from the first command that opens the brakes, which arrives later than the driver's request.
#[test]
fn brakes_have_their_time_from_the_first_answered_command_on() {
    for wait_us in [0, 500, 3_000, 3_500, 6_000, 9_500] {
        for drop_next in [0, 1, 2] {
            let mut bench = Bench::in_state(DriverState::Enabled);
            bench.run(Duration::from_micros(wait_us));
            let from = bench.sent.len();
            bench.request(Request::ReleaseBrakes);
            bench.peer.drop_next = drop_next;
            bench.settle();
            assert_eq!(bench.driver.state(), DriverState::Holding);
            let mut opening = bench.sent[from..].iter().filter(|(_, message)| kind(message) == Kind::Rest);
            let (answered, _) = *opening.nth(usize::try_from(drop_next).unwrap()).unwrap();
            let since = bench.now.saturating_since(answered + bench.peer.delay);
            assert!(since >= ms(200), "{wait_us} us, {drop_next} lost: {since:?}");
        }
    }
}

#[test]
fn cycles_keep_their_times() {
    let mut bench = Bench::in_state(DriverState::Holding);
    let from = bench.sent.len();
    bench.run(ms(500));
    for pair in bench.sent[from..].windows(2) {
        assert_eq!(pair[1].0.saturating_since(pair[0].0), CYCLE);
    }
    assert_eq!(bench.sent.len() - from, 50);
}

/// R8: down to speed 0, at least 5 cycles there, brakes on, servos off, end.
#[test]
fn a_stop_has_its_order() {
    for state in [DriverState::Moving, DriverState::Holding, DriverState::Enabled] {
        let mut bench = Bench::in_state(state);
        let from = bench.sent.len();
        bench.request(Request::Stop);
        bench.settle();
        assert_eq!(bench.driver.state(), DriverState::Connected);
        let runs = bench.kinds_since(from);
        match state {
            DriverState::Moving => {
                // The joint with the longest braking time: 0.4 rad/s at 2 rad/s^2 is 200 ms.
                assert_eq!(runs[0], (Kind::Motion, 20), "{runs:?}");
                assert_eq!(runs[1..], [(Kind::Rest, 5), (Kind::Braked, 20), (Kind::Off, 1), (Kind::End, 1)]);
                let parts = parts_since(&bench, from);
                assert!(parts.windows(2).all(|pair| pair[1] <= pair[0]), "{parts:?}");
            }
            DriverState::Holding => {
                assert_eq!(runs, [(Kind::Rest, 5), (Kind::Braked, 20), (Kind::Off, 1), (Kind::End, 1)]);
            }
            _ => assert_eq!(runs, [(Kind::Off, 1), (Kind::End, 1)]),
        }
        let from = bench.sent.len();
        bench.run(ms(100));
        assert_eq!(bench.sent.len(), from, "nothing is sent after the end");
    }
}

#[test]
fn a_second_stop_changes_nothing() {
    let mut once = Bench::in_state(DriverState::Moving);
    once.request(Request::Stop);
    let mut often = once.clone();
    once.settle();
    while often.driver.activity() != Activity::None {
        often.request(Request::Stop);
        often.run(ms(1));
    }
    assert_eq!(once.sent, often.sent);
    often.request(Request::Stop);
    assert_eq!(often.driver.state(), DriverState::Connected);
}

#[test]
fn stopping_ends_whatever_goes_on() {
    for (state, request) in [
        (DriverState::Disconnected, Request::Connect),
        (DriverState::Connected, Request::Enable),
        (DriverState::Enabled, Request::ReleaseBrakes),
        (DriverState::Fault, Request::Reset),
    ] {
        for wait in [0, 2, 15, 25] {
            let mut bench = Bench::in_state(state);
            bench.peer.delay = ms(9);
            bench.request(request);
            bench.run(ms(wait));
            let was_started = bench.sent.iter().rev().find_map(|(_, message)| match kind(message) {
                Kind::Start => Some(true),
                Kind::End => Some(false),
                _ => None,
            });
            let from = bench.sent.len();
            bench.request(Request::Stop);
            bench.settle();
            let after = if state == DriverState::Enabled { DriverState::Connected } else { state };
            assert_eq!(bench.driver.state(), after, "{request:?} for {wait} ms");
            if was_started == Some(true) {
                assert_eq!(bench.only_kinds_since(from).last(), Some(&Kind::End), "{request:?} for {wait} ms");
            }
        }
    }
}

/// R4: one or two lost replies in a row are tolerated, the third is a fault within 30 ms.
#[test]
fn the_third_lost_reply_in_a_row_is_a_fault() {
    for drop in 1..=2 {
        let mut bench = Bench::in_state(DriverState::Moving);
        for _ in 0..5 {
            bench.peer.drop_next = drop;
            bench.run_moving(ms(60));
            assert_eq!(bench.driver.state(), DriverState::Moving, "{drop} lost");
        }
        assert_eq!(bench.driver.counters().lost, 5 * u64::from(drop));
    }
    let mut bench = Bench::in_state(DriverState::Moving);
    bench.run_moving(ms(50));
    bench.peer.drop_next = 3;
    let from = bench.sent.len();
    bench.run_moving(ms(100));
    assert_eq!(trip(&bench), Trip::Fault(FaultCause::LinkLost { misses: 3 }));
    let after = bench.driver.latched().unwrap().at.saturating_since(bench.sent[from].0);
    assert!(after <= ms(30), "{after:?}");
}

#[test]
fn a_dead_link_is_stopped_in_bounded_time_in_the_same_order() {
    let mut bench = Bench::in_state(DriverState::Moving);
    bench.peer.answers = false;
    let (from, start) = (bench.sent.len(), bench.now);
    bench.run_moving(ms(100));
    bench.settle();
    assert_eq!(bench.driver.state(), DriverState::Fault);
    assert!(bench.now.saturating_since(start) < ms(800), "{:?}", bench.now.saturating_since(start));
    let runs = bench.kinds_since(from);
    assert_eq!(runs[1..], [(Kind::Rest, 5), (Kind::Braked, 20), (Kind::Off, 1), (Kind::End, 3)], "{runs:?}");
    let from = bench.sent.len();
    bench.run(ms(1000));
    assert_eq!(bench.sent.len(), from);
}

#[test]
fn an_arm_that_never_answers_is_no_endless_wait() {
    for state in [DriverState::Disconnected, DriverState::Connected, DriverState::Fault] {
        let mut bench = Bench::in_state(state);
        bench.peer.answers = false;
        bench.request(match state {
            DriverState::Disconnected => Request::Connect,
            DriverState::Connected => Request::Enable,
            _ => Request::Reset,
        });
        let start = bench.now;
        bench.settle();
        assert_eq!(bench.driver.state(), DriverState::Fault);
        assert_eq!(trip(&bench), Trip::Fault(FaultCause::LinkLost { misses: 3 }));
        assert!(bench.now.saturating_since(start) < ms(1800), "{state:?}: {:?}", bench.now.saturating_since(start));
    }
}

#[test]
fn an_activity_that_drags_on_is_a_fault() {
    let mut bench = Bench::new();
    bench.request(Request::Connect);
    bench.run(ms(1));
    // The driver was not polled for longer than the time limit of an activity.
    bench.now = bench.now + ms(10_001);
    bench.settle();
    let Trip::Fault(FaultCause::ActivityTimeout { activity, allowed }) = trip(&bench) else {
        panic!("{}", trip(&bench))
    };
    assert_eq!((activity, allowed), (Activity::Connecting, ms(10_000)));
    assert_eq!(bench.kinds_since(0).last().map(|(kind, _)| *kind), Some(Kind::End));
}

#[test]
fn every_alarm_stops_the_arm_by_its_name() {
    for &alarm in ServoAlarm::LISTED.iter().chain(&[ServoAlarm::Unlisted(0x42)]) {
        let mut bench = Bench::in_state(DriverState::Moving);
        bench.peer.servo[4] = ServoWord(0).with_alarm(alarm);
        bench.run_moving(ms(40));
        let is_stop = matches!(alarm, ServoAlarm::EmergencyStop | ServoAlarm::DeadManOff | ServoAlarm::LimitSwitch);
        match trip(&bench) {
            Trip::EStop(EmergencyStopCause::Axis { axis, alarm: found }) => {
                assert!(is_stop && axis.index() == 4 && found == alarm, "{alarm}");
                assert_eq!(bench.driver.state(), DriverState::EStop);
            }
            Trip::Fault(FaultCause::ServoAlarm { axis, alarm: found }) => {
                assert!(!is_stop && axis.index() == 4 && found == alarm, "{alarm}");
                assert_eq!(bench.driver.state(), DriverState::Fault);
                assert!(trip(&bench).to_string().contains("axis 5 (E2): alarm 0x"), "{}", trip(&bench));
            }
            other => panic!("{alarm}: {other}"),
        }
        assert_eq!(bench.driver.latched().unwrap().state_before, DriverState::Moving);
        let shown = (trip(&bench).axis().map(|axis| axis.index()), trip(&bench).code());
        assert_eq!(shown, (Some(4), Some(alarm.code())));
    }
    for &alarm in CommAlarm::LISTED {
        let mut bench = Bench::in_state(DriverState::Holding);
        bench.peer.comm = CommWord(1).with_alarm(alarm);
        bench.run(ms(40));
        let is_stop = matches!(alarm, CommAlarm::EmergencyStop | CommAlarm::DeadManOff | CommAlarm::LimitSwitch);
        let expected = if is_stop {
            Trip::EStop(EmergencyStopCause::Controller { alarm })
        } else {
            Trip::Fault(FaultCause::ControllerAlarm { alarm })
        };
        assert_eq!(trip(&bench), expected);
        assert_eq!((trip(&bench).axis(), trip(&bench).code()), (None, Some(alarm.code())));
    }
}

#[test]
fn a_switch_bit_stops_the_arm_where_the_configuration_says_so() {
    for (bits, state) in [("unknown", DriverState::Holding), ("controller 0x0008 set", DriverState::EStop)] {
        let mut config = DriverConfig::with_cycle(CYCLE);
        config.signals = config.signals.with(Signal::EmergencyStop, bits.parse().unwrap());
        let mut bench = Bench::with_config(config);
        bench.lead_to(DriverState::Holding);
        bench.peer.comm = CommWord(0x0009);
        bench.run(ms(30));
        assert_eq!(bench.driver.state(), state);
    }
}

#[test]
fn an_axis_without_power_is_a_fault_once_the_brakes_are_open() {
    let mut bench = Bench::new();
    bench.peer.servo = [ServoWord(0xC000); 7];
    bench.lead_to(DriverState::Connected);
    bench.peer.servo = [ServoWord(0); 7];
    bench.request(Request::Enable);
    bench.settle();
    bench.request(Request::ReleaseBrakes);
    bench.settle();
    bench.peer.servo[1] = ServoWord(0x8000);
    bench.run(ms(30));
    assert!(
        matches!(trip(&bench), Trip::Fault(FaultCause::AxisUncontrollable { axis, word: 0x8000 }) if axis.index() == 1)
    );
}

/// R15: more than 0.8 of the lower of two published torques (68 N m at E1, 14.5 N m at W2) for 50 ms, not for less.
#[test]
fn a_joint_that_carries_too_much_for_too_long_stops_the_arm() {
    for (axis, torque_n_m, lasts_ms, is_stopped) in [
        (3, 54.5, 70, true),
        (3, -54.5, 70, true),
        (3, 54.3, 500, false),
        (3, 200.0, 40, false),
        (6, -11.7, 70, true),
        (6, 11.5, 500, false),
        (0, f64::NAN, 70, true),
    ] {
        let mut bench = Bench::in_state(DriverState::Moving);
        bench.peer.torque_n_m[axis] = torque_n_m;
        let begin = bench.now;
        bench.run_moving(ms(lasts_ms));
        bench.peer.torque_n_m[axis] = 0.0;
        bench.run_moving(ms(100));
        let case = format!("{torque_n_m} N m at axis {axis} for {lasts_ms} ms");
        assert_eq!(bench.driver.state() == DriverState::Fault, is_stopped, "{case}");
        if let Some(latched) = bench.driver.latched() {
            assert!(latched.at.saturating_since(begin) <= ms(75), "{case}");
            let text = latched.trip.to_string();
            let names_it = matches!(latched.trip, Trip::Fault(FaultCause::TorqueTooHigh { axis: found, lasted, .. })
                if found.index() == axis && lasted >= ms(50));
            assert_eq!((latched.trip.axis().map(|found| found.index()), latched.trip.code()), (Some(axis), None));
            assert!(names_it && text.contains("N m at the joint, more than"), "{case}: {text}");
        }
    }
}

/// The brakes hold the load.
#[test]
fn what_the_brakes_carry_is_no_fault() {
    let mut bench = Bench::new();
    bench.peer.torque_n_m[1] = 200.0;
    bench.lead_to(DriverState::Enabled);
    bench.run(ms(200));
    assert_eq!(bench.driver.state(), DriverState::Enabled);
}

/// R7: latched until a reset finds the cause removed; the reset leads to connected and no further.
#[test]
fn a_reset_succeeds_only_when_the_cause_is_gone() {
    let mut bench = Bench::in_state(DriverState::Moving);
    bench.peer.servo[2] = ServoWord(0).with_alarm(ServoAlarm::OverCurrent);
    bench.run_moving(ms(40));
    bench.settle();
    let first = *bench.driver.latched().unwrap();
    bench.run(ms(5000));
    assert_eq!(bench.driver.latched(), Some(&first), "nothing clears by itself");

    bench.request(Request::Reset);
    bench.settle();
    assert_eq!(bench.driver.state(), DriverState::Fault);
    let from = bench.sent.len();
    bench.peer.servo[2] = ServoWord(0);
    bench.request(Request::Reset);
    bench.settle();
    let expected = [(Kind::Clear, 7), (Kind::Start, 1), (Kind::Off, 1), (Kind::End, 1)];
    assert_eq!(bench.kinds_since(from), expected);
    assert_eq!((bench.driver.state(), bench.driver.latched()), (DriverState::Connected, None));
    let from = bench.sent.len();
    bench.run(ms(1000));
    assert_eq!(bench.sent.len(), from, "nothing moves by itself");
}

#[test]
fn a_reset_does_not_need_a_controller_that_knows_how_to_clear_alarms() {
    let mut bench = Bench::in_state(DriverState::EStop);
    bench.peer.knows_clear_alarm = false;
    bench.request(Request::Reset);
    bench.settle();
    assert_eq!(bench.driver.state(), DriverState::Connected);
}

#[test]
fn an_emergency_stop_outranks_a_fault_and_not_the_other_way() {
    let over_current = ServoWord(0).with_alarm(ServoAlarm::OverCurrent);
    let pressed = ServoWord(0).with_alarm(ServoAlarm::EmergencyStop);
    let mut bench = Bench::in_state(DriverState::Moving);
    bench.peer.servo[0] = over_current;
    bench.run_moving(ms(30));
    assert_eq!(bench.driver.state(), DriverState::Fault);
    bench.peer.servo[6] = pressed;
    bench.run(ms(30));
    assert_eq!(bench.driver.state(), DriverState::EStop);

    let mut bench = Bench::in_state(DriverState::EStop);
    let first = *bench.driver.latched().unwrap();
    bench.driver.handle_unplugged(bench.now);
    assert_eq!(bench.driver.latched(), Some(&first));
}

#[test]
fn an_emergency_stop_ends_motion_without_a_ramp() {
    let mut bench = Bench::in_state(DriverState::Moving);
    bench.run_moving(ms(50));
    bench.peer.comm = CommWord(1).with_alarm(CommAlarm::EmergencyStop);
    let from = bench.sent.len();
    bench.run_moving(ms(50));
    bench.settle();
    let runs = bench.kinds_since(from);
    assert_eq!(runs[1..], [(Kind::Rest, 5), (Kind::Braked, 20), (Kind::Off, 1), (Kind::End, 1)], "{runs:?}");
}

/// R2: a velocity without a successor fades from 20 ms on and is zero at 50 ms.
#[test]
fn a_velocity_whose_successor_stays_away_fades_and_stops() {
    let mut bench = Bench::in_state(DriverState::Holding);
    let from = bench.sent.len();
    let asked = bench.now;
    bench.request(Request::Move(velocity()));
    bench.run(ms(200));
    assert_eq!(bench.driver.state(), DriverState::Fault);
    let Trip::Fault(FaultCause::CommandTimeout { age, allowed }) = trip(&bench) else { panic!("{}", trip(&bench)) };
    assert!(allowed == ms(50) && age >= ms(50) && age <= ms(51), "{age:?}");
    let sent = bench.sent[from..].iter().zip(parts_since(&bench, from));
    for ((at, _), part) in sent {
        let age_ms = at.saturating_since(asked).as_secs_f64() * 1e3;
        let expected = ((50.0 - age_ms) / 30.0).clamp(0.0, 1.0);
        assert!((part - expected).abs() < 1e-3, "{age_ms} ms: {part}");
    }
}

/// SIGSTOP and the like: a control loop that wakes up after its watchdog time does not simply continue.
#[test]
fn a_control_loop_that_stood_still_does_not_go_on() {
    let mut bench = Bench::in_state(DriverState::Moving);
    bench.run_moving(ms(50));
    bench.now = bench.now + ms(300);
    let refusal = bench.driver.handle_request(bench.now, Request::Move(velocity())).unwrap_err();
    assert!(matches!(refusal, Refusal::NotInState { state: DriverState::Fault, .. }), "{refusal}");
    assert!(matches!(trip(&bench), Trip::Fault(FaultCause::CommandTimeout { .. })));
}

#[test]
fn an_answer_to_what_was_given_up_is_late_and_not_damage() {
    let mut bench = Bench::in_state(DriverState::Enabled);
    bench.now = bench.now + CYCLE;
    assert!(bench.driver.poll_transmit(bench.now).is_some());
    let before = *bench.driver.counters();
    bench.now = bench.now + CYCLE;
    bench.driver.handle_timeout(bench.now);
    // Before the next message is sent, and only once.
    let sample = Reply::Sample(bench.peer.sample());
    for (late, mismatched) in [(1, 0), (1, 1)] {
        bench.driver.handle_reply(bench.now, &sample);
        let after = bench.driver.counters();
        let found = (after.lost - before.lost, after.late - before.late, after.mismatched - before.mismatched);
        assert_eq!(found, (1, late, mismatched));
    }
}

#[test]
fn a_reply_that_is_read_too_late_is_a_lost_one() {
    let mut bench = Bench::in_state(DriverState::Holding);
    bench.now = bench.now + CYCLE;
    assert!(bench.driver.poll_transmit(bench.now).is_some());
    let (before, joints) = (*bench.driver.counters(), *bench.driver.joints().unwrap());
    let sample = bench.peer.sample();
    bench.now = bench.now + CYCLE + ms(1);
    bench.driver.handle_reply(bench.now, &Reply::Sample(sample));
    let after = bench.driver.counters();
    assert_eq!((after.late - before.late, after.lost - before.lost), (1, 1));
    assert_eq!(bench.driver.joints(), Some(&joints));
}

/// E1 with its 0.4 rad/s and 2 rad/s^2 needs 200 ms, W2 with 0.7 rad/s and 5 rad/s^2 only 140 ms.
#[test]
fn holding_brings_each_joint_to_rest_with_its_own_deceleration() {
    let mut bench = Bench::in_state(DriverState::Moving);
    bench.run_moving(ms(50));
    let from = bench.sent.len();
    bench.request(Request::Hold);
    bench.run(ms(300));
    assert_eq!(bench.driver.state(), DriverState::Holding);
    let parts = |joint: usize| parts_of_joint_since(&bench, from, joint);
    let (elbow, wrist) = (parts(3), parts(6));
    assert!((elbow[10] - 0.5).abs() < 0.06 && elbow[18] > 0.0 && elbow[25] == 0.0, "{elbow:?}");
    assert!(
        (wrist[7] - 0.5).abs() < 0.08 && wrist[12] > 0.0 && wrist[15..].iter().all(|part| *part == 0.0),
        "{wrist:?}"
    );
    bench.run(ms(4500));
    assert_eq!(bench.driver.state(), DriverState::Holding, "a held arm may be left alone for a while");
}

#[test]
fn a_velocity_that_can_not_be_sent_makes_the_arm_hold() {
    let mut bad = velocity();
    bad[2] = f64::NAN;
    for bad in [bad, JointVector::repeat(7.0)] {
        let mut bench = Bench::in_state(DriverState::Moving);
        bench.run_moving(ms(50));
        let from = bench.sent.len();
        let refusal = bench.driver.handle_request(bench.now, Request::Move(bad)).unwrap_err();
        assert!(matches!(refusal, Refusal::Velocity(_)), "{refusal}");
        assert_eq!(bench.driver.state(), DriverState::Holding);
        bench.run(ms(300));
        let parts = parts_since(&bench, from);
        assert!(parts.iter().all(|part| (0.0..=1.0).contains(part)) && parts[25] == 0.0, "{parts:?}");
    }
}

#[test]
fn unplugging_and_swapped_links_stop_at_once() {
    let mut bench = Bench::in_state(DriverState::Moving);
    bench.driver.handle_unplugged(bench.now);
    assert_eq!(trip(&bench), Trip::Fault(FaultCause::Unplugged));
    let mut bench = Bench::in_state(DriverState::Moving);
    bench.driver.handle_wrong_arm(bench.now, 3);
    assert_eq!(trip(&bench), Trip::Fault(FaultCause::WrongArm { got: 3 }));
    assert!(trip(&bench).to_string().contains("a reply came from arm 3"), "{}", trip(&bench));
}

#[test]
fn a_gateway_that_refuses_is_a_fault_with_its_reason() {
    let mut bench = Bench::in_state(DriverState::Holding);
    bench.now = bench.now + CYCLE;
    assert!(bench.driver.poll_transmit(bench.now).is_some());
    bench.driver.handle_reply(bench.now, &Reply::Rejected(RejectReason::Stale));
    assert_eq!(bench.driver.state(), DriverState::Holding, "a frame that was late is one lost exchange");
    let mut waited = bench.clone();
    waited.now = waited.now + CYCLE;
    assert!(waited.driver.poll_transmit(waited.now).is_some());
    waited.driver.handle_reply(waited.now, &Reply::Rejected(RejectReason::WrongState));
    assert_eq!(trip(&waited), Trip::Fault(FaultCause::Rejected(RejectReason::WrongState)));
}

/// R8: after any fault, the brakes are commanded to close within 100 ms.
#[test]
fn after_a_fault_the_brakes_are_commanded_to_close_within_100_ms() {
    for word in [0x00E0, 0x0110] {
        let mut bench = Bench::in_state(DriverState::Moving);
        bench.run_moving(ms(50));
        bench.peer.servo[0] = ServoWord(word);
        bench.run_moving(ms(50));
        bench.settle();
        let at = bench.driver.latched().unwrap().at;
        let first = bench.sent.iter().find(|(when, message)| *when >= at && kind(message) == Kind::Braked).unwrap();
        assert!(first.0.saturating_since(at) <= ms(100), "{word:#06x}: {:?}", first.0.saturating_since(at));
    }
}

#[test]
fn a_gateway_that_stopped_the_arm_is_a_fault_with_its_cause() {
    for (state, cause, expected) in [
        (GatewayState::Stopping, StopCause::HostSilent, Trip::Fault(FaultCause::Gateway(StopCause::HostSilent))),
        (GatewayState::Fault, StopCause::CycleMissed, Trip::Fault(FaultCause::Gateway(StopCause::CycleMissed))),
        (GatewayState::EmergencyStop, StopCause::EmergencyStop, Trip::EStop(EmergencyStopCause::Gateway)),
    ] {
        let mut bench = Bench::in_state(DriverState::Holding);
        bench.now = bench.now + CYCLE;
        assert!(bench.driver.poll_transmit(bench.now).is_some());
        let scale = TorqueScale::of_format(WireFormat::BigEndian6x10);
        let mut shown = State::from_reply(&arm_reply(), &scale, 0).unwrap();
        (shown.gateway, shown.cause) = (state, cause);
        bench.driver.handle_reply(bench.now, &Reply::Sample(Sample::from_state(&shown)));
        assert_eq!(trip(&bench), expected);
    }
}
