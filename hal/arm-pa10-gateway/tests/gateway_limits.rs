//! The motion limits of a gateway: no command outside them reaches the arm, and a host that keeps them never trips.

use std::time::Duration;

use pb3dp_arm_pa10::driver::{Driver, DriverConfig};
use pb3dp_arm_pa10::link::{GatewayLink, HelloError};
use pb3dp_arm_pa10_gateway::gateway::GatewayConfig;
use pb3dp_arm_pa10_protocol::codec::{AngleCounts, Axis, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmOperation, AxisMotion, DriveCommand, DriveMode, FaultReport, GatewayMessage, GatewayState, Hello, HostLimits,
    HostMessage, MotionLimits, MotionQuantity, RejectReason, StopCause, WiderLimit,
};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_arm_pa10_test_support::gateway_bench::{Bench, CYCLE, HOST_CYCLE, Sent, config, control, ms, rejected};
use pb3dp_arm_pa10_test_support::link_rig::link_config;
use pb3dp_geometry::MonotonicTime;
use proptest::prelude::*;

/// A command may be this late, and its set-point this old.
const TOLERANCE: Duration = ms(40);
const S2: usize = 1;

/// Limits of axes with these accelerations and jerks, by which no edge of a test falls on a whole count.
fn motion() -> AxisMotion {
    AxisMotion {
        speed_max_rad_per_s: 0.4,
        acceleration_max_rad_per_s2: 2.01,
        jerk_max_rad_per_s3: 77.0,
        range_rad: [-1.5, 1.5],
    }
}

fn limits_of(motion: &AxisMotion) -> MotionLimits {
    MotionLimits::new(&[*motion; 7]).unwrap()
}

fn limited(format: WireFormat, motion: &AxisMotion) -> GatewayConfig {
    GatewayConfig { limits: limits_of(motion), ..config(format) }
}

fn hello(limits: MotionLimits) -> HostMessage {
    HostMessage::Hello(Hello { cycle_us: 10_000, limits })
}

/// Holding with open brakes, its host asks for the limits of the gateway.
fn holding(config: GatewayConfig) -> Bench {
    let mut bench = Bench::silent(config);
    assert!(matches!(bench.ask(hello(config.limits)), GatewayMessage::HelloReply(_)));
    bench.lead_to(GatewayState::Holding);
    bench.sent.clear();
    bench.messages.clear();
    bench
}

/// A command in counts; the next one is due 10 ms later.
fn follow(bench: &mut Bench, counts: [i16; 7]) {
    follow_for(bench, counts, HOST_CYCLE);
}

fn follow_for(bench: &mut Bench, counts: [i16; 7], time: Duration) {
    bench.tell(message(counts));
    bench.run(time);
}

fn message(counts: [i16; 7]) -> HostMessage {
    let speed_urad_per_s = counts.map(|counts| i32::from(counts) * 200);
    HostMessage::Command(DriveCommand { mode: DriveMode::Follow, speed_urad_per_s })
}

fn on_s2(counts: i16) -> [i16; 7] {
    let mut all = [0; 7];
    all[S2] = counts;
    all
}

fn assert_tripped(bench: &Bench, axis: usize, quantity: MotionQuantity) {
    let found = bench.gateway.status().found.unwrap();
    assert_eq!((bench.state(), bench.cause()), (GatewayState::Fault, StopCause::LimitExceeded));
    assert_eq!(found.limit(), Some((Axis::ALL[axis], quantity)), "{found}");
    let is_report = |message: &GatewayMessage| matches!(message, GatewayMessage::Fault(report) if *report == found);
    assert_eq!(bench.messages.iter().filter(|(_, message)| is_report(message)).count(), 1, "FAULT once");
}

fn assert_moving(bench: &Bench) {
    assert_eq!((bench.state(), bench.gateway.status().found), (GatewayState::Moving, None));
}

fn fastest(bench: &Bench) -> u16 {
    let speeds = bench.sent.iter().flat_map(speeds);
    speeds.map(i16::unsigned_abs).max().unwrap_or(0)
}

fn speeds(sent: &Sent) -> [i16; 7] {
    match sent.message {
        pb3dp_arm_pa10_protocol::codec::ControlMessage::Cyclic(command) => command.axes.map(|axis| axis.speed().0),
        _ => [0; 7],
    }
}

/// Finding 1 of the review: a host below the limiter sent 6.28 rad/s, and the gateway passed it on, to S2 too.
#[test]
fn a_speed_that_no_limiter_has_passed_stops_the_arm() {
    for format in WireFormat::ALL {
        let mut bench = holding(limited(format, &motion()));
        follow(&mut bench, on_s2(31_400));
        assert_tripped(&bench, S2, MotionQuantity::Speed);
        assert_eq!(fastest(&bench), 0, "{format}");
        bench.run(ms(600));
        assert_eq!(bench.letters().chars().last(), Some('E'), "the stop order is complete");
        let start = bench.ask(control(ArmOperation::Stop));
        assert!(matches!(start, GatewayMessage::ControlReply(_)));
        assert_eq!(bench.state(), GatewayState::Fault, "latched");
        bench.ask(control(ArmOperation::Reset));
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None));
    }
}

/// Rises by 5 counts per command (0.1 rad/s^2) up to these counts.
fn rise_to(bench: &mut Bench, counts: i16) {
    for step in 0..=counts / 5 {
        follow(bench, on_s2(step * 5));
    }
    follow(bench, on_s2(counts));
    assert_moving(bench);
}

#[test]
fn the_speed_limit_passes_and_one_count_more_stops_the_arm() {
    for format in WireFormat::ALL {
        for sign in [-1, 1] {
            let slow = AxisMotion { speed_max_rad_per_s: 0.01, ..motion() };
            let mut bench = holding(limited(format, &slow));
            for step in 0..=50 {
                follow(&mut bench, on_s2(sign * step));
            }
            assert_moving(&bench);
            follow(&mut bench, on_s2(sign * 51));
            assert_tripped(&bench, S2, MotionQuantity::Speed);
            assert_eq!(fastest(&bench), 50);
        }
    }
}

#[test]
fn a_host_that_asks_for_less_is_held_to_that() {
    let mut bench = Bench::silent(limited(WireFormat::BigEndian6x10, &motion()));
    let slow = AxisMotion { speed_max_rad_per_s: 0.01, ..motion() };
    bench.ask(hello(limits_of(&slow)));
    bench.lead_to(GatewayState::Holding);
    follow(&mut bench, on_s2(50));
    assert_moving(&bench);
    follow(&mut bench, on_s2(51));
    assert_tripped(&bench, S2, MotionQuantity::Speed);
    // The next host is not held to what this one asked for.
    bench.run(ms(600));
    bench.ask(control(ArmOperation::Reset));
    bench.gateway.handle_host_gone(bench.now);
    bench.ask(hello(limits_of(&motion())));
    bench.lead_to(GatewayState::Holding);
    follow(&mut bench, on_s2(51));
    assert_moving(&bench);
}

/// By hand, with commands 10 ms apart: 2.01 rad/s^2 x (10 + 40) ms = 0.1005 rad/s, and one count for rounding: 503.5 counts.
#[test]
fn a_rise_at_the_limit_of_acceleration_passes_and_one_count_more_stops_the_arm() {
    let stiff = AxisMotion { jerk_max_rad_per_s3: 10_000.0, ..motion() };
    for format in WireFormat::ALL {
        for (counts, passes) in [(503, true), (-503, true), (504, false), (-504, false)] {
            let mut bench = holding(limited(format, &stiff));
            (0..6).for_each(|_| follow(&mut bench, [0; 7]));
            follow(&mut bench, on_s2(counts));
            if passes {
                assert_moving(&bench);
                // 0.0201 rad/s more are left for the next one, 604 counts in all: no tolerance is given twice.
                follow(&mut bench, on_s2(counts + 102 * counts.signum()));
                assert_tripped(&bench, S2, MotionQuantity::Acceleration);
            } else {
                assert_tripped(&bench, S2, MotionQuantity::Acceleration);
                assert_eq!(fastest(&bench), 0);
            }
        }
    }
}

/// By hand: the rise may have begun with the command before the last one, so it lasts 20 + 40 ms. The acceleration is full after
/// 2.01 / 77 = 26.10 ms: 2.01 x (60 - 13.05) ms = 0.09437 rad/s, and one count for rounding: 472.8 counts.
#[test]
fn a_rise_at_the_limit_of_jerk_passes_and_one_count_more_stops_the_arm() {
    for format in WireFormat::ALL {
        for (counts, passes) in [(472, true), (-472, true), (473, false), (-473, false)] {
            let mut bench = holding(limited(format, &motion()));
            (0..6).for_each(|_| follow(&mut bench, [0; 7]));
            follow(&mut bench, on_s2(counts));
            if passes { assert_moving(&bench) } else { assert_tripped(&bench, S2, MotionQuantity::Jerk) }
        }
    }
}

/// Jerk alone: 6.2 rad/s^3 x (60 ms)^2 / 2 = 0.01116 rad/s, and one count for rounding: 56.8 counts.
#[test]
fn a_slow_jerk_limit_decides_before_the_acceleration() {
    let soft = AxisMotion { jerk_max_rad_per_s3: 6.2, ..motion() };
    for (counts, passes) in [(56, true), (57, false)] {
        let mut bench = holding(limited(WireFormat::BigEndian6x10, &soft));
        (0..6).for_each(|_| follow(&mut bench, [0; 7]));
        follow(&mut bench, on_s2(counts));
        if passes { assert_moving(&bench) } else { assert_tripped(&bench, S2, MotionQuantity::Jerk) }
    }
}

#[test]
fn every_stop_is_allowed_to_be_sudden() {
    for format in WireFormat::ALL {
        let mut bench = holding(limited(format, &motion()));
        rise_to(&mut bench, 1000);
        follow(&mut bench, on_s2(300));
        assert_moving(&bench);
        follow(&mut bench, [0; 7]);
        assert_eq!(bench.state(), GatewayState::Holding);
        rise_to(&mut bench, 1000);
        bench.ask(control(ArmOperation::Stop));
        bench.run(ms(600));
        assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None));
        // Beyond 0, the other direction begins from 0.
        bench.lead_to(GatewayState::Holding);
        rise_to(&mut bench, 1000);
        follow(&mut bench, on_s2(-500));
        assert_eq!(bench.cause(), StopCause::LimitExceeded);
    }
}

/// By hand: at 0.2 rad/s the joint needs 0.2 x 6 ms + 0.2^2 / (2 x 2.01) = 0.01115 rad to stop, which leaves 1.48885 rad:
/// 194115.8 counts of the angle.
#[test]
fn an_axis_that_could_not_stop_in_its_range_is_stopped() {
    for format in WireFormat::ALL {
        for sign in [-1, 1] {
            let mut bench = holding(limited(format, &motion()));
            rise_to(&mut bench, 1000);
            let mut backwards = bench.clone();
            // The angle of axis 2 is twice this one.
            let at = |counts: i32| AngleCounts(counts / 2);
            if sign > 0 {
                bench.controller.angle = at(194_114);
                bench.run(ms(4));
                assert_moving(&bench);
                bench.controller.angle = at(194_116);
                bench.run(ms(4));
                assert_tripped(&bench, S2, MotionQuantity::UpperEnd);
            } else {
                // Away from the end, and beyond it, the same speed is allowed; another axis is beyond its end, and stationary.
                backwards.controller.angle = at(-210_000);
                backwards.run(ms(4));
                assert_moving(&backwards);
                follow(&mut backwards, [0; 7]);
                follow(&mut backwards, on_s2(-1));
                assert_tripped(&backwards, S2, MotionQuantity::LowerEnd);
            }
        }
    }
}

#[test]
fn a_command_towards_an_end_without_room_is_not_followed() {
    for format in WireFormat::ALL {
        let mut bench = holding(limited(format, &motion()));
        bench.controller.angle = AngleCounts(-195_200 / 2);
        bench.run(ms(4));
        // 1.49716 rad: 0.08 rad/s needs 0.00207 rad to stop, 0.12 rad/s 0.0043 rad.
        (0..6).for_each(|_| follow(&mut bench, [0; 7]));
        follow(&mut bench, on_s2(-400));
        bench.run(ms(2));
        assert_moving(&bench);
        follow(&mut bench, on_s2(-600));
        assert_tripped(&bench, S2, MotionQuantity::LowerEnd);
        assert!(fastest(&bench) <= 400);
    }
}

#[test]
fn a_host_that_asks_for_more_is_refused() {
    let mut bench = Bench::silent(limited(WireFormat::BigEndian6x10, &motion()));
    let own = limits_of(&motion());
    let mut asked = own;
    asked.axes[4].jerk += 1;
    let (reason, detail) = rejected(bench.ask(hello(asked)));
    assert_eq!(reason, RejectReason::LimitsTooWide);
    let expected = WiderLimit { axis: Axis::ALL[4], quantity: MotionQuantity::Jerk, wider: 386, limit: 385 };
    assert_eq!(WiderLimit::from_detail(detail, &asked), Some(expected));
    assert!(!bench.gateway.status().has_host);
    let GatewayMessage::HelloReply(reply) = bench.ask(hello(own)) else { panic!("it is refused") };
    assert_eq!(reply.limits, own);
}

/// A host that connects to a gateway: why it refuses the gateway, or the gateway refuses it.
fn greet(gateway: MotionLimits, limits: HostLimits) -> Option<HelloError> {
    let format = WireFormat::BigEndian6x10;
    let mut bench = Bench::silent(GatewayConfig { limits: gateway, ..config(format) });
    let mut link = GatewayLink::new(GatewayLinkConfig { limits, ..link_config(format) });
    let mut driver = Driver::new(DriverConfig::with_cycle(HOST_CYCLE)).unwrap();
    link.open(bench.now);
    bench.gateway.handle_host_bytes(bench.now, &link.poll_output(bench.now).unwrap());
    while let Some(answer) = bench.gateway.poll_host_output(bench.now) {
        link.handle_bytes(bench.now, &answer, &mut driver);
    }
    assert_eq!(link.hello().is_some(), link.hello_error().is_none());
    link.hello_error().copied()
}

#[test]
fn host_and_gateway_refuse_each_other_with_both_numbers() {
    let faster = AxisMotion { speed_max_rad_per_s: 0.5, ..motion() };
    let [slow, fast] = [motion(), faster].map(|motion| limits_of(&motion));
    let host = |asked, allowed| HostLimits { asked, allowed };
    assert_eq!(greet(slow, host(slow, slow)), None);
    assert_eq!(greet(fast, host(slow, fast)), None);
    let text = greet(fast, host(slow, slow)).unwrap().to_string();
    let expected = "the gateway allows axis 1 (S1) 0.5 rad/s as its speed, the setup at most 0.4 rad/s: correct \
                    speed_max_rad_per_s of this axis under [limits] in the gateway's file";
    assert!(text.contains(expected), "{text}");
    let text = greet(slow, host(fast, fast)).unwrap().to_string();
    let expected = "the setup asks for 0.5 rad/s as speed of axis 1 (S1), the gateway allows 0.4 rad/s: correct the limits of the arm \
                    in the setup, or speed_max_rad_per_s of this axis under [limits] in the gateway's file";
    assert!(text.contains(expected), "{text}");
    let wide = limits_of(&AxisMotion { range_rad: [-1.6, 1.5], ..motion() });
    let text = greet(wide, host(slow, slow)).unwrap().to_string();
    assert!(text.contains("-91.67 degrees as its lower end of the range, the setup at most -85.94 degrees"), "{text}");
}

#[test]
fn open_brakes_keep_the_limits_of_the_host() {
    let mut bench = holding(limited(WireFormat::BigEndian6x10, &motion()));
    let slow = limits_of(&AxisMotion { speed_max_rad_per_s: 0.1, ..motion() });
    assert_eq!(rejected(bench.ask(hello(slow))).0, RejectReason::WrongState);
    assert!(matches!(bench.ask(hello(limits_of(&motion()))), GatewayMessage::HelloReply(_)));
    rise_to(&mut bench, 1000);
}

#[test]
fn a_report_of_a_limit_names_axis_and_quantity() {
    let report = FaultReport {
        cause: StopCause::LimitExceeded,
        state_before: GatewayState::Moving,
        axis: Some(Axis::ALL[S2]),
        word: 3,
    };
    assert_eq!(report.to_string(), "limit-exceeded: axis 2 (S2), jerk");
    assert_eq!(FaultReport { cause: StopCause::ServoAlarm, ..report }.limit(), None);
}

/// A host with a limiter: it goes to random speeds with limited acceleration and jerk, at times that are not quite regular.
struct Curve {
    speed: f64,
    acceleration: f64,
    motion: AxisMotion,
}

impl Curve {
    /// The speed after a time, on the way to `target`.
    fn step(&mut self, target: f64, dt: f64) -> f64 {
        let AxisMotion { acceleration_max_rad_per_s2: most, jerk_max_rad_per_s3: jerk, .. } = self.motion;
        // The way that remains while the acceleration fades to 0.
        let left = target - self.speed - self.acceleration * self.acceleration.abs() / (2.0 * jerk);
        let change = (left * 1e6).clamp(-jerk * dt, jerk * dt);
        let next = (self.acceleration + change).clamp(-most, most);
        let wanted = self.speed + next * dt;
        let allowed = self.motion.speed_max_rad_per_s;
        let clamped = wanted.clamp(-allowed, allowed);
        self.acceleration = if clamped == wanted { next } else { 0.0 };
        self.speed = clamped;
        clamped
    }
}

/// What happens to one command: its set-point is this old, ms; the frame is this late, ms, or lost.
#[derive(Clone, Debug)]
struct Fate {
    age_ms: u64,
    late_ms: u64,
    is_lost: bool,
    target: i8,
}

fn fate() -> impl Strategy<Value = Fate> {
    (0u64..10, 0u64..10, prop::bool::weighted(0.1), prop_oneof![3 => Just(0i8), 1 => -100i8..100])
        .prop_map(|(age_ms, late_ms, is_lost, target)| Fate { age_ms, late_ms, is_lost, target })
}

/// A command of a host that its limits do not bind.
#[derive(Clone, Debug)]
struct Wild {
    wait_ms: u64,
    /// Per axis: thousandths of the speed limit, or beyond it.
    part: i32,
    axis: usize,
    is_rise: bool,
}

fn wild() -> impl Strategy<Value = Wild> {
    (0u64..30, -1100i32..1100, 0usize..7, any::<bool>()).prop_map(|(wait_ms, part, axis, is_rise)| Wild {
        wait_ms,
        part,
        axis,
        is_rise,
    })
}

fn soft_or_stiff() -> impl Strategy<Value = AxisMotion> {
    prop_oneof![Just(5.0), Just(20.0), Just(77.0), Just(500.0)]
        .prop_map(|jerk_max_rad_per_s3| AxisMotion { jerk_max_rad_per_s3, ..motion() })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    /// Late, lost and aged commands of a host that keeps the limits never trip. Frames stay in order, as on any line.
    #[test]
    fn a_host_within_the_limits_never_trips(
        fates in prop::collection::vec(fate(), 20..120),
        motion in soft_or_stiff(),
        format in prop::sample::select(WireFormat::ALL.to_vec()),
    ) {
        let mut bench = holding(limited(format, &motion));
        let mut curve = Curve { speed: 0.0, acceleration: 0.0, motion };
        // The host's steps of 1 ms, from which its driver takes one that is `age_ms` old.
        let mut curve_speeds = vec![0.0; 20];
        let mut target = 0.0;
        let mut due: Vec<(MonotonicTime, HostMessage)> = Vec::new();
        let mut line_free = bench.now;
        let mut lost_in_a_row = 0;
        for fate in &fates {
            if fate.target != 0 {
                target = f64::from(fate.target) * 0.01 * motion.speed_max_rad_per_s;
            }
            let taken = curve_speeds[curve_speeds.len() - 1 - usize::try_from(fate.age_ms).unwrap()];
            let counts = (taken * 5000.0f64).round() as i16;
            lost_in_a_row = if fate.is_lost && lost_in_a_row < 1 { lost_in_a_row + 1 } else { 0 };
            if lost_in_a_row == 0 {
                line_free = line_free.max(bench.now + ms(fate.late_ms));
                due.push((line_free, message(on_s2(counts))));
            }
            for _ in 0..10 {
                curve_speeds.push(curve.step(target, 1e-3));
                let now = bench.now;
                for (_, command) in due.extract_if(.., |(at, _)| *at <= now).collect::<Vec<_>>() {
                    bench.tell(command);
                }
                bench.run(ms(1));
            }
            prop_assert_eq!(bench.gateway.status().found, None, "{} {:?}", format, fate);
        }
    }

    /// Whatever a host sends, the speeds on the bus keep the limits: with the tolerance for the time of a command, 30 ms for which a
    /// command may have been in force, and with interpolation the time that it takes.
    #[test]
    fn any_host_moves_the_arm_within_the_limits(
        commands in prop::collection::vec(wild(), 1..60),
        format in prop::sample::select(WireFormat::ALL.to_vec()),
        interpolates in any::<bool>(),
    ) {
        let motion = motion();
        let mut bench = holding(GatewayConfig { interpolates, ..limited(format, &motion) });
        let most = i32::from(limits_of(&motion).axes[0].speed);
        let mut counts = [0i16; 7];
        for Wild { wait_ms, part, axis, is_rise } in commands {
            let wanted = part * most / 1000;
            // Half of the commands rise slowly enough to be followed.
            let near = wanted.clamp(i32::from(counts[axis]) - 250, i32::from(counts[axis]) + 250);
            counts[axis] = if is_rise { near as i16 } else { wanted as i16 };
            follow_for(&mut bench, counts, ms(wait_ms));
        }
        bench.run(ms(100));
        prop_assert!(i32::from(fastest(&bench)) <= most);
        let interpolation = if interpolates { HOST_CYCLE * 3 } else { Duration::ZERO };
        let slack_s = (TOLERANCE + ms(30) + CYCLE * 2 + interpolation).as_secs_f64();
        let sent: Vec<_> = bench.sent.iter().map(|sent| (sent.at, speeds(sent))).collect();
        for (index, (at, speeds)) in sent.iter().enumerate() {
            for (before, earlier) in sent[..index].iter().rev().take(40) {
                let most = motion.acceleration_max_rad_per_s2 * (at.seconds_since(*before) + slack_s) * 5000.0 + 2.0;
                for (speed, earlier) in speeds.iter().zip(earlier) {
                    for sign in [-1, 1] {
                        let rise = i32::from(sign * *speed) - i32::from(sign * *earlier).max(0);
                        prop_assert!(f64::from(rise) <= most, "{rise} counts in {:?}", at.saturating_since(*before));
                    }
                }
            }
        }
    }
}

/// After lost commands the watchdog has slowed the arm down; the speed then rises with the allowed acceleration.
#[test]
fn an_arm_that_was_slowed_down_speeds_up_within_the_limits() {
    for format in WireFormat::ALL {
        let mut bench = holding(limited(format, &motion()));
        rise_to(&mut bench, 2000);
        bench.run(ms(20));
        let slowed = speeds(bench.sent.last().unwrap())[S2];
        assert!((1000..1600).contains(&slowed), "{slowed}");
        let (begin, mut last) = (bench.now, slowed);
        for _ in 0..40 {
            follow(&mut bench, on_s2(2000));
            let speed = speeds(bench.sent.last().unwrap())[S2];
            let most = f64::from(slowed) + 2.01 * 5000.0 * bench.now.seconds_since(begin) + 2.0;
            assert!(f64::from(speed) <= most && speed >= last, "{speed} of at most {most}, {format}");
            last = speed;
        }
        assert_eq!(last, 2000);
        assert_moving(&bench);
    }
}
