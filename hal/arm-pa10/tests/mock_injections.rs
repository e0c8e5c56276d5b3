//! Every kind of fault, at random times of random motions: the arm stops in time and stays stopped, and only a reset after the
//! cause is removed leads on. Driver, bus link and emulated controller in virtual time; the true joints are checked.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::time::Duration;

use pb3dp_arm_pa10::driver::{DriverConfig, DriverState, Request};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, MockControllerConfig};
use pb3dp_arm_pa10_protocol::codec::{Supervision, WireFormat};
use pb3dp_arm_pa10_test_support::bus_bench::{BUS_CYCLE, BusBench};
use pb3dp_arm_pa10_test_support::injection::{
    Braking, Dice, Stop, braking_time, controller_alarm, joints, last_motion, servo_alarm, table_line,
};
use pb3dp_kinematics::JointVector;

/// A kind of fault.
struct Kind {
    name: &'static str,
    begin: fn(&mut Dice) -> String,
    end: &'static str,
    braking: Braking,
    /// Whether a reset is refused until the fault has ended.
    keeps_cause: bool,
    state: DriverState,
}

const DETECTION: Duration = Duration::from_millis(20);

fn kinds() -> Vec<Kind> {
    use DriverState::{EStop, Fault};
    let kind = |name, begin, end, braking, keeps_cause, state| Kind { name, begin, end, braking, keeps_cause, state };
    vec![
        kind("drop", |_| "drop 1000000".into(), "drop 0", Braking::Servos, true, Fault),
        kind(
            "delay",
            |dice| format!("delay 1000000 {}us", 3000 + dice.below(60_000)),
            "delay 0 0s",
            Braking::Servos,
            true,
            Fault,
        ),
        kind("truncate", |_| "truncate 1000000".into(), "truncate 0", Braking::Servos, true, Fault),
        kind("wrong-sequence", |_| "wrong-sequence 1000000".into(), "wrong-sequence 0", Braking::Servos, true, Fault),
        kind("wrong-letter", |_| "wrong-letter 1000000".into(), "wrong-letter 0", Braking::Servos, true, Fault),
        kind("wrong-node", |_| "wrong-node 1000000".into(), "wrong-node 0", Braking::Servos, true, Fault),
        kind("silence", |_| "silence on".into(), "silence off", Braking::Servos, true, Fault),
        kind("slow", |dice| format!("slow {}us", 2000 + dice.below(90_000)), "slow 0s", Braking::Servos, true, Fault),
        kind("deaf", |_| "deaf 1000000".into(), "deaf 0", Braking::Servos, true, Fault),
        kind("time-out", |_| "time-out".into(), "drop 0", Braking::Servos, false, Fault),
        kind("power", |_| "power off".into(), "power on", Braking::Brakes, true, Fault),
        kind("servo-power", |_| "servo-power off".into(), "servo-power on", Braking::Brakes, false, Fault),
        kind("e-stop", |_| "e-stop press".into(), "e-stop release", Braking::Brakes, true, EStop),
        kind("dead-man", |_| "dead-man release".into(), "dead-man hold", Braking::Servos, false, EStop),
        kind("limit-switch", |_| "limit-switch open".into(), "limit-switch close", Braking::Servos, true, EStop),
        kind("alarm", |dice| servo_alarm(dice, ""), "alarm 0 off", Braking::Brakes, true, Fault),
        kind("alarm reported", |dice| servo_alarm(dice, " reported"), "alarm 0 off", Braking::Servos, true, Fault),
        kind(
            "controller-alarm",
            |dice| controller_alarm(dice, ""),
            "controller-alarm off",
            Braking::Servos,
            true,
            Fault,
        ),
        kind(
            "controller-alarm reported",
            |dice| controller_alarm(dice, " reported"),
            "controller-alarm off",
            Braking::Servos,
            true,
            Fault,
        ),
    ]
}

fn bench(watchdog: Option<Duration>, seed: u64) -> BusBench {
    let supervision = Supervision { dead_man: true, other_axes: false };
    let driver = DriverConfig { supervision, ..DriverConfig::with_cycle(BUS_CYCLE) };
    let controller = MockControllerConfig { watchdog, ..MockControllerConfig::new(WireFormat::BigEndian6x10) };
    let bench = BusBench::with(driver, controller, seed);
    *bench.plant.lock().unwrap() = joints();
    bench
}

fn move_about(bench: &mut BusBench, dice: &mut Dice, time: Duration) {
    let end = bench.now + time;
    while bench.now < end {
        let position = bench.plant.lock().unwrap().state().position_rad;
        bench.wanted = Some(dice.velocity(&position));
        if bench.next_host_cycle < bench.now {
            bench.next_host_cycle = bench.now;
        }
        bench.run(Duration::from_millis(40 + dice.below(100) as u64).min(end.saturating_since(bench.now)));
    }
}

fn prepare(bench: &mut BusBench) {
    for request in [Request::Enable, Request::ReleaseBrakes] {
        bench.request(request);
        bench.settle();
    }
    assert_eq!(bench.driver.state(), DriverState::Holding, "{:?}", bench.driver.latched());
}

fn inject(bench: &mut BusBench, kind: &Kind, dice: &mut Dice) -> Stop {
    prepare(bench);
    let moving_for = Duration::from_micros(50_000 + dice.below(250_000) as u64);
    move_about(bench, dice, moving_for);
    assert_eq!(bench.driver.state(), DriverState::Moving, "{}: before it", kind.name);
    let (at, line) = (bench.now, (kind.begin)(dice));
    let velocity = bench.plant.lock().unwrap().state().velocity_rad_per_s.abs();
    // Velocities of the joints, of their current commands, and of their next commands.
    let fastest = velocity.sup(&bench.wanted.unwrap().abs()).sup(&bench.controller.commanded_rad_per_s().abs());
    bench.inject(&line);
    bench.run(Duration::from_millis(600));
    let place = format!("{}: `{line}` at {at:?}, seed {}", kind.name, dice.seed);
    let is_switch = line.contains("0x11") || line.contains("0x12") || line.contains("0x13");
    let expected = if is_switch { DriverState::EStop } else { kind.state };
    assert_eq!(bench.driver.state(), expected, "{place}: {:?}", bench.driver.latched());
    assert_eq!(bench.driver.latched().unwrap().state_before, DriverState::Moving, "{place}");
    let took = last_motion(&bench.plant, at).saturating_since(at);
    assert!(bench.controller.is_braked(), "{place}: brakes are open");
    // If no reply arrives, the brakes are closed and E waits for a reply.
    assert!(bench.controller.mode() == ControlMode::Adjustment || bench.driver.stop_unacknowledged(), "{place}");
    bench.wanted = None;
    if kind.keeps_cause {
        bench.request(Request::Reset);
        bench.settle();
        assert!(bench.driver.state().is_latched(), "{place}: reset although the cause is there");
    }
    let end = match line.split_whitespace().collect::<Vec<_>>()[..] {
        ["alarm", axis, ..] => format!("alarm {axis} off"),
        _ => kind.end.to_owned(),
    };
    bench.inject(&end);
    assert!(bench.driver.state().is_latched(), "{place}: it went by itself");
    bench.run(Duration::from_millis(350));
    assert_eq!(
        (bench.controller.mode(), bench.driver.stop_unacknowledged()),
        (ControlMode::Adjustment, false),
        "{place}"
    );
    bench.request(Request::Reset);
    bench.settle();
    assert_eq!(bench.driver.state(), DriverState::Connected, "{place}: {:?}", bench.driver.latched());
    assert!(bench.controller.is_braked());
    Stop { took, allowed: braking_time(kind.braking, &fastest) + DETECTION }
}

const INJECTIONS_PER_KIND: usize = 125;

#[test]
fn after_every_fault_the_arm_is_at_rest_in_time_and_stays_there() {
    let mut all = 0;
    for (index, kind) in kinds().iter().enumerate() {
        let mut dice = Dice { seed: 1000 + index as u32, count: 0 };
        // If messages do not arrive, only the controller can stop the arm; otherwise its watchdog is not needed.
        let watchdog = (kind.name == "deaf").then(|| Duration::from_millis(dice.pick(&[6, 10])));
        let mut bench = bench(watchdog, 5);
        bench.request(Request::Connect);
        bench.settle();
        let mut stops = Vec::new();
        for injection in 0..INJECTIONS_PER_KIND {
            let stop = inject(&mut bench, kind, &mut dice);
            assert!(
                stop.took <= stop.allowed,
                "{} {injection}: {:?} to rest, {:?} allowed",
                kind.name,
                stop.took,
                stop.allowed
            );
            stops.push(stop);
            all += 1;
        }
        println!("{}", table_line(kind.name, &stops));
    }
    assert!(all >= 2000, "{all}");
}

/// Tolerated: at most two lost replies in a row, late replies within the cycle, a few replies in the wrong order, and switches that are only shown.
#[test]
fn what_is_tolerated_leads_to_no_fault() {
    for line in [
        "drop 2",
        "delay 2 5ms",
        "delay 1000 1500us",
        "slow 1500us",
        "duplicate 1000",
        "reorder 8",
        "truncate 2",
        "wrong-sequence 2",
        "wrong-letter 2",
        "wrong-node 2",
        "teaching-switch on",
        "power-temperature high",
        "torque 3 -40Nm",
    ] {
        for injection in 0..10 {
            let mut dice = Dice { seed: 77, count: 100 * injection };
            let mut bench = bench(Some(Duration::from_millis(6)), 9);
            bench.request(Request::Connect);
            bench.settle();
            prepare(&mut bench);
            let moving_for = Duration::from_micros(50_000 + dice.below(50_000) as u64);
            move_about(&mut bench, &mut dice, moving_for);
            bench.inject(line);
            move_about(&mut bench, &mut dice, Duration::from_millis(500));
            let state = bench.driver.state();
            assert_eq!(state, DriverState::Moving, "{line}: {:?}", bench.driver.latched());
            assert_eq!(bench.controller.counters().watchdog_trips, 0, "{line}");
        }
    }
}

/// Without a watchdog of the controller the host stops a half-open link, but nothing stops the arm after a cut cable until it is
/// repaired: this is why a gateway is next to the arm. The mock must show the difference.
#[test]
fn a_cut_cable_is_what_only_the_controller_can_stop() {
    let end_after = |line: &str, watchdog| {
        let mut bench = bench(watchdog, 3);
        bench.request(Request::Connect);
        bench.settle();
        prepare(&mut bench);
        bench.wanted = Some(JointVector::repeat(0.1));
        bench.next_host_cycle = bench.now;
        bench.run(Duration::from_millis(300));
        let before = bench.plant.lock().unwrap().state().position_rad;
        bench.inject(line);
        bench.run(Duration::from_secs(1));
        assert_eq!(bench.driver.state(), DriverState::Fault);
        let travelled = (bench.plant.lock().unwrap().state().position_rad - before).amax();
        (bench.is_at_rest(), travelled)
    };
    let ms = Duration::from_millis;
    let (at_rest, travelled) = end_after("silence on", None);
    assert!(at_rest && travelled < 0.006, "half-open: {travelled}");
    for watchdog in [6, 10, 400] {
        let (at_rest, travelled) = end_after("deaf 1000000", Some(ms(watchdog)));
        assert!(at_rest && travelled < 0.1 * (watchdog as f64 * 1e-3 + 0.02), "{watchdog} ms: {travelled}");
    }
    let (at_rest, travelled) = end_after("deaf 1000000", None);
    assert!(!at_rest && travelled > 0.09, "nothing stops it: {travelled}");
    // Until the cable is repaired: unanswered messages are repeated.
    let (at_rest, travelled) = end_after("deaf 400", None);
    assert!(at_rest && (0.075..0.095).contains(&travelled), "mended after 0.8 s: {travelled}");
}

/// 1 % of the replies lost, never three in a row, over 10 simulated minutes: at the cycle of the bus and at that of a host.
#[test]
fn one_percent_of_lost_replies_is_no_fault() {
    for (cycle, watchdog) in [(2u64, 6u64), (10, 400)] {
        let controller = MockControllerConfig {
            watchdog: Some(Duration::from_millis(watchdog)),
            ..MockControllerConfig::new(WireFormat::LittleEndian5x8)
        };
        let driver = DriverConfig::with_cycle(Duration::from_millis(cycle));
        let mut bench = BusBench::with(driver, controller, 11).moving(JointVector::zeros());
        bench.inject("chance 1% at-most 2 drop 1");
        let mut dice = Dice { seed: 21, count: 0 };
        let end = bench.now + Duration::from_secs(600);
        while bench.now < end {
            move_about(&mut bench, &mut dice, Duration::from_secs(1));
            assert_eq!(bench.driver.state(), DriverState::Moving, "{:?}", bench.driver.latched());
        }
        let exchanges = 600_000 / cycle;
        let lost = bench.driver.counters().lost;
        assert!((exchanges * 8 / 1000..exchanges * 12 / 1000).contains(&lost), "{lost} of {exchanges}");
        assert_eq!(bench.controller.counters().watchdog_trips, 0);
    }
}

/// At 100 Hz, counted from the first message that gets no answer.
#[test]
fn three_lost_replies_in_a_row_are_a_fault_within_30_ms() {
    for injection in 0..200 {
        let mut dice = Dice { seed: 31, count: 10 * injection };
        let controller =
            MockControllerConfig { watchdog: None, ..MockControllerConfig::new(WireFormat::BigEndian6x10) };
        let driver = DriverConfig::with_cycle(Duration::from_millis(10));
        let mut bench = BusBench::with(driver, controller, 11).moving(JointVector::repeat(0.1));
        bench.run(Duration::from_micros(100_000 + dice.below(10_000) as u64));
        bench.inject("drop 3");
        let answered = bench.controller.counters().answered;
        let unanswered = |bench: &BusBench| bench.controller.counters().answered > answered;
        assert!(bench.run_until(bench.now + Duration::from_millis(20), unanswered));
        let first = bench.now;
        let latched = |bench: &BusBench| bench.driver.state().is_latched();
        assert!(bench.run_until(first + Duration::from_millis(100), latched), "no fault");
        let took = bench.now.saturating_since(first);
        assert!(took <= Duration::from_millis(30), "{took:?}");
        // Three without an answer, and the first of the stop order.
        assert_eq!(bench.controller.counters().answered, answered + 4);
    }
}
