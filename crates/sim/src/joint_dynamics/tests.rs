//! Joint dynamics: response, stops, counts, history, and commands that expire.

use proptest::prelude::*;

use super::*;

fn millis(ms: u64) -> MonotonicTime {
    MonotonicTime::ZERO + Duration::from_millis(ms)
}

fn config() -> JointPlantConfig {
    let max = JointVector::from([3.1, 1.6, 3.0, 2.4, 4.5, 2.9, 4.4]);
    let speed = JointVector::from([1.0, 1.1, 2.0, 2.1, 6.0, 6.1, 6.2]);
    JointPlantConfig {
        limits: JointLimits::new(-max * 0.9, max, speed).unwrap(),
        acceleration_max_rad_per_s2: JointVector::from([2.0, 2.5, 3.0, 3.5, 5.0, 5.5, 6.0]),
        velocity_time_constant: Duration::from_millis(40),
        command_delay: Duration::from_millis(12),
        angle_quantum_rad: 0.0,
        history: Duration::from_secs(2),
    }
}

fn start() -> JointVector {
    JointVector::from([0.2, -0.5, 0.3, 1.1, -0.7, 0.9, 0.1])
}

fn plant(config: JointPlantConfig) -> JointPlant {
    JointPlant::new(config, start(), millis(100)).unwrap()
}

/// A small command stays below the acceleration limit: the step response of a first-order lag, v = u (1 - exp(-t/tau)).
#[test]
fn small_step_is_a_first_order_response() {
    let mut plant = plant(config());
    let command = JointVector::from([0.05, -0.06, 0.07, -0.08, 0.09, -0.1, 0.11]);
    plant.command(millis(100), command).unwrap();
    for ms in [120, 152, 300, 1000] {
        plant.advance_to(millis(ms));
        let t = (ms as f64 - 112.0) * 1e-3;
        let settled = 1.0 - (-t / 0.04f64).exp();
        let state = plant.state();
        assert!((state.velocity_rad_per_s - command * settled).amax() < 1e-14, "{ms} ms: {state:?}");
        let position = start() + command * (t - 0.04 * settled);
        assert!((state.position_rad - position).amax() < 1e-14, "{ms} ms: {state:?}");
    }
}

/// A large command is first followed at the largest acceleration, and never faster than the joint limit.
#[test]
fn large_step_saturates_acceleration_and_speed() {
    let mut plant = plant(config());
    let limits = config().limits;
    plant.command(millis(100), JointVector::repeat(50.0)).unwrap();
    plant.advance_to(millis(212));
    let state = plant.state();
    assert!((state.velocity_rad_per_s - config().acceleration_max_rad_per_s2 * 0.1).amax() < 1e-14, "{state:?}");
    plant.advance_to(millis(900));
    let speed = plant.state().velocity_rad_per_s;
    assert!((speed[0] - limits.velocity_max_rad_per_s()[0]).abs() < 1e-4 && speed[0] < 1.0, "{speed}");
}

/// Full speed towards a stop that is nearer than the turning distance: the joint reaches the stop and leaves it again.
#[test]
fn bounces_off_nothing_but_leaves_a_stop_on_command() {
    let mut plant = plant(JointPlantConfig { velocity_time_constant: Duration::ZERO, ..config() });
    plant.command(millis(100), JointVector::from([0.0, 1.1, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap();
    // S2 reaches 1.6 rad; reverse 0.05 rad before it (the turning distance is v^2/2a = 0.24 rad).
    plant.advance_to(millis(2200));
    let before = plant.state();
    assert!((1.45..1.6).contains(&before.position_rad[1]), "{before:?}");
    plant.command(millis(2200), JointVector::from([0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0])).unwrap();
    plant.advance_to(millis(4000));
    let on_the_way: Vec<_> = (2200..4000).map(|ms| plant.position_at(millis(ms)).unwrap()[1]).collect();
    let highest = on_the_way.iter().copied().fold(f64::MIN, f64::max);
    assert!((1.599..=1.6).contains(&highest), "the stop is reached: {highest}");
    assert!(plant.state().position_rad[1] < 1.0, "and left: {}", plant.state().position_rad[1]);
}

/// A gentle reversal while the lag settles: without a stop S1 would reverse 55 ms later and 1.3 mrad farther; the stop is 0.5
/// mrad away.
#[test]
fn a_stop_in_the_way_of_a_gentle_turn_is_met() {
    let mut begin = start();
    begin[0] = 3.1 - 0.06 * (1.0 - 0.04) - 0.0005;
    let mut plant = JointPlant::new(config(), begin, millis(100)).unwrap();
    let s1 = |value| JointVector::from([value, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    plant.command(millis(100), s1(0.06)).unwrap();
    plant.command(millis(1100), s1(-0.02)).unwrap();
    plant.advance_to(millis(1400));
    let before = 3.1 - plant.position_at(millis(1112)).unwrap()[0];
    assert!((before - 0.0005).abs() < 1e-9, "{before}");
    let after_50_ms = plant.velocity_at(millis(1162)).unwrap()[0];
    assert!(after_50_ms < -0.001, "it has reached the stop and is moving back: {after_50_ms}");
}

#[test]
fn measured_angles_are_whole_counts() {
    let mut plant = plant(JointPlantConfig { angle_quantum_rad: PA10_ANGLE_QUANTUM_RAD, ..config() });
    assert!((PA10_ANGLE_QUANTUM_RAD - 7.669903939e-6).abs() < 1e-15);
    plant.command(millis(100), JointVector::repeat(0.123)).unwrap();
    plant.advance_to(millis(777));
    let (measured, exact) = (plant.state().position_rad, plant.position_at(millis(777)).unwrap());
    assert!(measured != exact);
    assert!((measured - exact).amax() <= 0.5 * PA10_ANGLE_QUANTUM_RAD * (1.0 + 1e-9));
    for angle in measured.iter() {
        let counts = angle / PA10_ANGLE_QUANTUM_RAD;
        assert!((counts - counts.round()).abs() < 1e-6, "{counts}");
    }
}

#[test]
fn the_past_stays_what_it_was_and_ends_with_the_history() {
    let mut plant = plant(config());
    plant.command(millis(100), JointVector::repeat(0.4)).unwrap();
    plant.advance_to(millis(333));
    let then = plant.state();
    plant.command(millis(333), JointVector::repeat(-0.4)).unwrap();
    for ms in (340..2300).step_by(10) {
        plant.advance_to(millis(ms));
        plant.command(millis(ms), JointVector::repeat(0.001 * ms as f64 - 1.0)).unwrap();
    }
    assert_eq!(plant.position_at(millis(333)), Some(then.position_rad));
    assert_eq!(plant.velocity_at(millis(333)), Some(then.velocity_rad_per_s));
    assert_eq!(plant.position_at(millis(2291)), None, "the future is not known");
    plant.advance_to(millis(4000));
    assert_eq!(plant.position_at(millis(1900)), None, "older than the history");
    assert!(plant.position_at(millis(2000)).is_some());
    assert_eq!(JointPlant::new(config(), start(), millis(100)).unwrap().position_at(millis(99)), None);
}

#[test]
fn halt_forgets_commands_on_their_way() {
    let mut plant = plant(config());
    plant.command(millis(100), JointVector::repeat(0.5)).unwrap();
    plant.advance_to(millis(400));
    plant.command(millis(400), JointVector::repeat(0.9)).unwrap();
    plant.halt(millis(405));
    plant.advance_to(millis(406));
    assert!(plant.state().velocity_rad_per_s.max() < 0.5, "it brakes at once, without the command delay");
    plant.advance_to(millis(2000));
    assert!(plant.state().velocity_rad_per_s.amax() < 1e-12);
    let travelled = plant.state().position_rad - plant.position_at(millis(405)).unwrap();
    assert!((0.0..0.1).contains(&travelled.max()), "{travelled}");
}

/// A drive with a watchdog of 50 ms: three commands 30 ms apart keep it moving, then silence from 160 ms on stops the arm.
#[test]
fn a_command_expires_without_a_successor() {
    let (mut advanced, mut plant) = (plant(config()), plant(config()));
    for ms in [100, 130, 160, 300] {
        advanced.advance_to(millis(ms));
        for plant in [&mut advanced, &mut plant] {
            plant.command_for(millis(ms), JointVector::repeat(0.1), Duration::from_millis(50)).unwrap();
        }
    }
    plant.advance_to(millis(600));
    advanced.advance_to(millis(600));
    assert_eq!(plant.state(), advanced.state(), "the expiry happens even if no state was read");
    let speed = |ms| plant.velocity_at(millis(ms)).unwrap()[0];
    // The last command before the silence takes effect at 172 ms and holds until 222 ms; the next one comes at 312 ms.
    assert!(speed(222) > speed(221) && speed(221) > speed(200), "{} {}", speed(221), speed(222));
    assert!(speed(223) < speed(222) && speed(311) < 0.02, "{} {}", speed(223), speed(311));
    assert!(speed(362) > 0.06 && speed(599) < 1e-3, "{} {}", speed(362), speed(599));
}

#[test]
fn refuses_what_it_can_not_simulate() {
    let bad = |change: fn(&mut JointPlantConfig)| {
        let mut config = config();
        change(&mut config);
        JointPlant::new(config, start(), millis(0)).unwrap_err().to_string()
    };
    assert!(bad(|c| c.acceleration_max_rad_per_s2[3] = 0.0).contains("acceleration_max_rad_per_s2 of axis 4 is 0"));
    assert!(bad(|c| c.acceleration_max_rad_per_s2[0] = f64::NAN).contains("of axis 1"));
    assert!(bad(|c| c.angle_quantum_rad = -1.0).contains("angle_quantum_rad is -1"));
    let outside = JointPlant::new(config(), start() * 4.0, millis(0)).unwrap_err();
    assert!(outside.to_string().contains("axis 2 starts at -114.59 degrees"), "{outside}");

    let mut plant = plant(config());
    let mut command = JointVector::repeat(0.1);
    command[5] = f64::NAN;
    assert!(matches!(plant.command(millis(100), command), Err(JointPlantError::Command { joint: 5, .. })));
    plant.advance_to(millis(1000));
    assert_eq!(plant.state().position_rad, start(), "nothing of it took effect");
}

/// One command every few milliseconds, sometimes with speeds beyond every limit, so that all stops are reached.
fn any_commands() -> impl Strategy<Value = Vec<(u64, [f64; DOF])>> {
    prop::collection::vec((0..900_000_000u64, prop::array::uniform7(-8.0..8.0f64)), 1..25)
}

fn drive(plant: &mut JointPlant, commands: &[(u64, [f64; DOF])], stops: &[u64]) {
    let mut stops = stops.iter().copied().collect::<VecDeque<_>>();
    let mut at = plant.now();
    for &(after, velocity) in commands {
        let next = at + Duration::from_nanos(after);
        while let Some(stop) = stops.front().filter(|&&stop| MonotonicTime::from_nanos(stop) < next) {
            plant.advance_to(MonotonicTime::from_nanos(*stop));
            stops.pop_front();
        }
        let velocity = JointVector::from(velocity);
        if after % 2 == 0 {
            plant.command(next, velocity).unwrap();
        } else {
            plant.command_for(next, velocity, Duration::from_millis(50)).unwrap();
        }
        at = next;
    }
    for stop in stops {
        plant.advance_to(MonotonicTime::from_nanos(stop));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(150) })]

    #[test]
    fn any_partition_of_time_gives_the_same_bits(
        commands in any_commands(),
        mut stops in prop::collection::vec(0..20_000_000_000u64, 0..200),
    ) {
        stops.sort_unstable();
        let end = MonotonicTime::from_nanos(30_000_000_000);
        let (mut in_one, mut in_many) = (plant(config()), plant(config()));
        drive(&mut in_one, &commands, &[]);
        drive(&mut in_many, &commands, &stops);
        in_one.advance_to(end);
        in_many.advance_to(end);
        prop_assert_eq!(in_one.state(), in_many.state());
    }

    #[test]
    fn limits_hold_at_every_moment(commands in any_commands()) {
        let config = JointPlantConfig { history: Duration::from_secs(60), ..config() };
        let limits = config.limits;
        let acceleration_max = config.acceleration_max_rad_per_s2;
        let mut plant = plant(config);
        drive(&mut plant, &commands, &[]);
        plant.advance_to(millis(30_000));
        let mut before = JointVector::zeros();
        for ms in (100..30_000).step_by(7) {
            let position = plant.position_at(millis(ms)).unwrap();
            let velocity = plant.velocity_at(millis(ms)).unwrap();
            prop_assert!(limits.violation(&position).is_none(), "{ms} ms: {position}");
            for i in 0..DOF {
                prop_assert!(velocity[i].abs() <= limits.velocity_max_rad_per_s()[i], "{ms} ms: {velocity}");
                // Speed increases no faster than the drive allows; it may drop to zero at once at a stop.
                let gain = velocity[i].abs() - before[i].abs();
                prop_assert!(gain <= acceleration_max[i] * 0.007 + 1e-12, "{ms} ms, joint {i}: {gain}");
            }
            before = velocity;
        }
    }

    #[test]
    fn velocity_is_the_derivative_of_position(commands in any_commands(), at in 200_000_000..20_000_000_000u64) {
        let config = JointPlantConfig { history: Duration::from_secs(60), ..config() };
        let mut plant = plant(config);
        drive(&mut plant, &commands, &[]);
        plant.advance_to(millis(30_000));
        let step = 1000;
        let position = |nanos| plant.position_at(MonotonicTime::from_nanos(nanos)).unwrap();
        let difference = (position(at + step) - position(at - step)) / (2e-9 * step as f64);
        let velocity = plant.velocity_at(MonotonicTime::from_nanos(at)).unwrap();
        for i in 0..DOF {
            let at_stop = plant.config().limits.margin_rad(&position(at))[i] < 1e-4;
            prop_assert!(at_stop || (difference[i] - velocity[i]).abs() < 1e-4, "joint {i}: {difference} {velocity}");
        }
    }
}
