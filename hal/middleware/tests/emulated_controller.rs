//! Limiter and guard with the emulated controller of a PA-10, the driver of a real arm, the bus and the joints, in virtual time:
//! faults that only the joint angles reveal, and the effect of the driver's own ramp on the joints.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::sync::{Arc, Mutex, MutexGuard};
use std::task::Poll;
use std::time::Duration;

use pb3dp_arm_pa10::driver::{DriverConfig, DriverState, FaultCause, Request, Trip};
use pb3dp_arm_pa10_emulation::mock_controller::MockControllerConfig;
use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_test_support::bus_bench::{self, AT_REST_RAD_PER_S, BUS_CYCLE, BusBench, HOST_CYCLE, plant_config};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{
    Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, JointCommand, JointState, PowerOrder,
};
use pb3dp_hal_middleware::{CommandFade, Guard, GuardConfig, Limiter, LimiterConfig};
use pb3dp_kinematics::{EffectiveLimits, JointLimits, JointVector, StatedLimits};
use pb3dp_sim::joint_dynamics::{JointPlant, JointPlantConfig};
use proptest::prelude::*;

use crate::common;

const SPEED_SCALE: f64 = 0.3;

/// The arm traits on a driver in virtual time: each exchange takes one cycle of the host.
struct VirtualArm {
    bench: Arc<Mutex<BusBench>>,
    info: ArmInfo,
}

impl VirtualArm {
    fn bench(&self) -> MutexGuard<'_, BusBench> {
        self.bench.lock().unwrap()
    }

    fn error(&self, kind: ArmErrorKind) -> ArmError {
        let driver = &self.bench().driver;
        ArmError::new(kind, format!("{:?}: {:?}", driver.state(), driver.latched()))
    }

    fn request(&self, requests: &[Request]) {
        for request in requests {
            self.bench().request(*request);
            self.bench().settle();
        }
    }
}

impl Arm for VirtualArm {
    fn info(&self) -> &ArmInfo {
        &self.info
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let mut bench = self.bench();
        let now = bench.now;
        let commanded = match command {
            JointCommand::Velocity(velocity) => bench.driver.handle_request(now, Request::Move(velocity)),
            JointCommand::Hold if bench.driver.state() == DriverState::Moving => {
                bench.driver.handle_request(now, Request::Hold)
            }
            JointCommand::Hold => Ok(()),
        };
        bench.run(HOST_CYCLE);
        let (is_latched, joints) = (bench.driver.state().is_latched(), *bench.driver.joints().unwrap());
        drop(bench);
        if is_latched {
            return Err(self.error(ArmErrorKind::Fault));
        }
        commanded.map_err(|_| self.error(ArmErrorKind::Rejected))?;
        Ok(joints)
    }
}

impl ArmPower for VirtualArm {
    fn state(&self) -> ArmState {
        match self.bench().driver.state() {
            DriverState::Disconnected | DriverState::Connected | DriverState::Enabled => ArmState::Disabled,
            DriverState::Holding | DriverState::Moving => ArmState::Enabled,
            DriverState::Fault => ArmState::Fault,
            DriverState::EStop => ArmState::EStop,
        }
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        match order {
            PowerOrder::Enable(_) | PowerOrder::BeginEnable(_) => {
                self.request(&[Request::Enable, Request::ReleaseBrakes]);
            }
            PowerOrder::PollEnable | PowerOrder::BeginStop => {}
            PowerOrder::Stop => self.request(&[Request::Stop]),
            PowerOrder::Reset => {
                if self.bench().driver.state().is_latched() {
                    self.request(&[Request::Reset]);
                }
                if self.bench().driver.state().is_latched() {
                    return Err(self.error(ArmErrorKind::Fault));
                }
            }
        }
        Ok(Poll::Ready(()))
    }
}

/// An enabled arm at these joint angles, monitored by a guard.
fn guarded(
    format: WireFormat,
    start_rad: JointVector,
    (limits, config): (EffectiveLimits, GuardConfig),
) -> (Guard<VirtualArm>, Arc<Mutex<BusBench>>) {
    let mut bench = BusBench::with(DriverConfig::with_cycle(BUS_CYCLE), MockControllerConfig::new(format), 1);
    let speeds = *limits.servo().velocity_max_rad_per_s();
    let stops = JointLimits::new(config.mechanical_min_rad, config.mechanical_max_rad, speeds).unwrap();
    let joints = JointPlantConfig { limits: stops, history: Duration::from_secs(30), ..plant_config() };
    *bench.plant.lock().unwrap() = JointPlant::new(joints, start_rad, bench.now).unwrap();
    bench.request(Request::Connect);
    bench.settle();
    let bench = Arc::new(Mutex::new(bench));
    let info = ArmInfo { name: "virtual".to_owned(), cycle: HOST_CYCLE };
    let tripped = Arc::clone(&bench);
    let trip = move || {
        let mut bench = tripped.lock().unwrap();
        let now = bench.now;
        bench.driver.handle_trip(now, Trip::Fault(FaultCause::Supervisor));
    };
    let mut guard = Guard::new(VirtualArm { bench: Arc::clone(&bench), info }, limits, config).unwrap().on_stop(trip);
    guard.enable().unwrap();
    (guard, bench)
}

/// For drives with far higher decelerations than any command demands.
fn wide_guard_config() -> (EffectiveLimits, GuardConfig) {
    let joints = plant_config();
    let mechanical_max_rad = common::mechanical_range_rad();
    let stated = StatedLimits {
        servo: joints.limits,
        operating_min_rad: *joints.limits.position_min_rad(),
        operating_max_rad: *joints.limits.position_max_rad(),
        acceleration_max_rad_per_s2: joints.acceleration_max_rad_per_s2,
        ..common::stated(SPEED_SCALE)
    };
    let config = GuardConfig {
        mechanical_min_rad: -mechanical_max_rad,
        mechanical_max_rad,
        ripple_rad_per_s: 0.0,
        delay: BUS_CYCLE,
        lag: joints.velocity_time_constant,
        tracking_error_max_rad: GuardConfig::TRACKING_ERROR_MAX_RAD,
        tracking_error_for: GuardConfig::TRACKING_ERROR_FOR,
    };
    (stated.effective().unwrap(), config)
}

/// Alternating motion with up to 0.8 of the speed limit.
fn velocity(at: MonotonicTime) -> JointCommand {
    let part = 0.8 * SPEED_SCALE * (std::f64::consts::TAU * at.as_secs_f64() / 2.0).sin();
    JointCommand::Velocity(plant_config().limits.velocity_max_rad_per_s() * part)
}

/// Result of one fault.
struct Outcome {
    found_after: Duration,
    at_rest_after: Duration,
    reason: String,
}

/// Moves the arm and injects a fault, until the guard or the driver detects it.
fn outcome(format: WireFormat, phase: u32, line: &str) -> Option<Outcome> {
    let (mut guard, bench) = guarded(format, bus_bench::home(), wide_guard_config());
    let step = |guard: &mut Guard<VirtualArm>| {
        let command = velocity(bench.lock().unwrap().now);
        guard.exchange(command)
    };
    for _ in 0..40 + phase {
        step(&mut guard).unwrap();
    }
    let begin = bench.lock().unwrap().now;
    bench.lock().unwrap().inject(line);
    let reason = (0..150).find_map(|_| step(&mut guard).err().filter(|error| error.kind() == ArmErrorKind::Fault))?;
    let mut bench = bench.lock().unwrap();
    let found_after = bench.driver.latched().unwrap().at.saturating_since(begin);
    assert_eq!(guard.latched().is_some(), bench.driver.latched().unwrap().trip == Trip::Fault(FaultCause::Supervisor));
    bench.settle();
    bench.run(Duration::from_millis(100));
    drop(guard);
    assert!(bench.controller.is_braked() && bench.is_at_rest(), "{line}");
    let plant = bench.plant.lock().unwrap();
    let (mut at, mut last) = (begin, begin);
    while at <= plant.now() {
        if plant.velocity_at(at).unwrap().amax() > AT_REST_RAD_PER_S {
            last = at;
        }
        at = at + Duration::from_micros(500);
    }
    Some(Outcome { found_after, at_rest_after: last.saturating_since(begin), reason: reason.to_string() })
}

/// How a joint is stopped.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Braking {
    /// Its servo: the ramp of the driver, and the lag of the drive.
    Servo,
    /// Its brake, because its servo does not obey: after the ramp and the cycles at speed 0 of the other joints, and the closing
    /// time.
    Brake,
}

impl Braking {
    fn time(self) -> Duration {
        let driver = DriverConfig::with_cycle(BUS_CYCLE);
        let lag = plant_config().velocity_time_constant * 6;
        match self {
            Self::Servo => driver.emergency_ramp + lag,
            Self::Brake => {
                let closing = MockControllerConfig::new(WireFormat::BigEndian6x10).brake_close;
                // From 4 rad/s at 50 rad/s^2.
                driver.emergency_ramp + BUS_CYCLE * driver.rest_cycles + closing + Duration::from_millis(80)
            }
        }
    }
}

/// Faults, the maximum detection time for their size, the expected message, and how the arm stops.
///
/// In format B status words report the last four. In format A the words are undocumented, and only the joint angles reveal them.
const FAULTS: [(&str, u64, &str, Braking); 11] = [
    ("runaway 2 0.9rad/s", 50, "axis 2 moves at +", Braking::Brake),
    ("runaway 6 -4rad/s", 130, "axis 6 moves at -", Braking::Brake),
    ("runaway 2 0.25rad/s", 1300, "axis 2 is", Braking::Brake),
    ("stuck 4 on", 800, "axis 4 is", Braking::Servo),
    ("jump 3 0.3rad", 50, "axis 3 seems to have moved by +1", Braking::Servo),
    ("stale 1000000", 800, "from its commanded position", Braking::Servo),
    ("corrupt 1000000", 700, "", Braking::Servo),
    ("e-stop press", 900, "", Braking::Brake),
    ("time-out", 900, "", Braking::Servo),
    ("limit-switch open", 900, "", Braking::Servo),
    ("alarm 4 0x0e", 900, "", Braking::Brake),
];

/// The detection time depends on the smallest detectable error of a joint. Required: the fault is detected, and the arm stops
/// within its braking time plus 20 ms from then on.
#[test]
fn what_only_the_joints_show_stops_the_arm() {
    for format in WireFormat::ALL {
        for (line, within_ms, expected, braking) in FAULTS {
            let (mut found, mut slowest) = (Duration::ZERO, Duration::ZERO);
            for phase in (0..200).step_by(13) {
                let place = format!("{line} in {format}, phase {phase}");
                let outcome = outcome(format, phase, line).unwrap_or_else(|| panic!("{place}: not found"));
                assert!(outcome.reason.contains(expected), "{place}: {}", outcome.reason);
                found = found.max(outcome.found_after);
                slowest = slowest.max(outcome.at_rest_after.saturating_sub(outcome.found_after));
            }
            println!("{line:20} in {format}: found within {found:?}, at rest within {slowest:?} from then on");
            assert!(found <= Duration::from_millis(within_ms), "{line}: {found:?}");
            assert!(slowest <= braking.time() + Duration::from_millis(20), "{line}: {slowest:?}");
        }
    }
}

/// The clock of a bench.
struct BenchClock(Arc<Mutex<BusBench>>);

impl Clock for BenchClock {
    fn now(&self) -> MonotonicTime {
        self.0.lock().unwrap().now
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        self.0.lock().unwrap().run_until(deadline, |_| false);
    }
}

/// All layers between a controller of the hand and a real arm, with the decelerations of the driver.
struct Chained {
    limiter: Limiter<Guard<VirtualArm>>,
    bench: Arc<Mutex<BusBench>>,
    begin: MonotonicTime,
}

impl Chained {
    fn new(start_rad: JointVector, speed_scale: f64) -> Self {
        let driver = DriverConfig::with_cycle(BUS_CYCLE);
        let lag = plant_config().velocity_time_constant;
        let stated = StatedLimits {
            acceleration_max_rad_per_s2: driver.deceleration_rad_per_s2,
            jerk_max_rad_per_s3: driver.deceleration_rad_per_s2 * 40.0,
            ..common::stated(speed_scale)
        };
        let limits = stated.effective().unwrap();
        let guard = GuardConfig {
            // A sample is measured at the end of the cycle in which its command is recorded.
            delay: Duration::ZERO,
            lag,
            ..common::guard_config()
        };
        let (guard, bench) = guarded(WireFormat::BigEndian6x10, start_rad, (limits, guard));
        let config = LimiterConfig {
            reaction_time: HOST_CYCLE + BUS_CYCLE * 2 + lag,
            command_timeout: driver.watchdog.stop_after(),
            fade: Some(CommandFade {
                begins_after: driver.watchdog.ramp_after(),
                ends_after: driver.watchdog.stop_after(),
            }),
            ..common::limiter_config()
        };
        let mut limiter = Limiter::new(guard, limits, config, Arc::new(BenchClock(Arc::clone(&bench)))).unwrap();
        limiter.exchange(JointCommand::Hold).unwrap();
        let begin = bench.lock().unwrap().now;
        Self { limiter, bench, begin }
    }

    /// Largest excess of a joint beyond its operating range, rad; negative if none was outside.
    fn farthest_beyond_rad(&self) -> f64 {
        let operating_rad = common::operating_range_rad();
        let bench = self.bench.lock().unwrap();
        let plant = bench.plant.lock().unwrap();
        let (mut at, mut farthest_rad) = (self.begin, f64::NEG_INFINITY);
        while at <= plant.now() {
            farthest_rad = farthest_rad.max((plant.position_at(at).unwrap().abs() - operating_rad).max());
            at = at + Duration::from_millis(3);
        }
        farthest_rad
    }
}

/// S2 approaches its limit slowly while S3 is fast and needs a second to brake: S2 must not move for as long as S3.
#[test]
fn a_hold_leads_no_joint_out_while_another_one_needs_longer_to_brake() {
    let end_rad = common::operating_range_rad()[1];
    let mut arm = Chained::new(JointVector::from([0.0, end_rad - 0.35, -2.5, 0.5, 0.0, 0.0, 0.0]), 1.0);
    let mut desired = JointVector::zeros();
    (desired[1], desired[2]) = (0.3, 1.9);
    let mut at_rad = 0.0;
    for _ in 0..300 {
        if end_rad - at_rad < 0.05 {
            break;
        }
        at_rad = arm.limiter.exchange(JointCommand::Velocity(desired)).unwrap().position_rad[1];
    }
    assert!(end_rad - at_rad < 0.05, "S2 is at {at_rad}");
    for _ in 0..150 {
        arm.limiter.exchange(JointCommand::Hold).unwrap();
    }
    assert!(arm.bench.lock().unwrap().is_at_rest());
    let beyond_rad = arm.farthest_beyond_rad();
    assert!(beyond_rad < 1e-5, "beyond the operating range by {beyond_rad} rad");
}

/// A control loop that stalls for 15 to 35 ms more than its cycle: the driver has faded the velocity, and continues from the
/// faded one.
#[test]
fn after_a_stall_the_velocity_goes_on_from_what_the_driver_left_of_it() {
    let most = DriverConfig::with_cycle(BUS_CYCLE).deceleration_rad_per_s2[2] * HOST_CYCLE.as_secs_f64();
    for stall_ms in [15, 20, 25, 30, 35] {
        let mut arm = Chained::new(JointVector::zeros(), 1.0);
        let mut desired = JointVector::zeros();
        desired[2] = 1.5;
        for _ in 0..100 {
            arm.limiter.exchange(JointCommand::Velocity(desired)).unwrap();
        }
        let commanded = |arm: &Chained| arm.bench.lock().unwrap().plant.lock().unwrap().commanded_rad_per_s()[2];
        arm.bench.lock().unwrap().run(Duration::from_millis(stall_ms));
        let before = commanded(&arm);
        assert!(before < 1.4, "{stall_ms} ms: {before}");
        arm.limiter.exchange(JointCommand::Velocity(desired)).unwrap();
        let after = commanded(&arm);
        // The last cycle of the driver is up to one bus cycle old.
        assert!(after <= before + most + 1e-9 && after > 0.0, "{stall_ms} ms: from {before} to {after} rad/s");
    }
}

/// A control step that overruns by 28 ms, at any speed: the watchdog takes speed from the joint by more than the limit of acceleration
/// allows, but by no more than it takes from the command, and the speed comes back within the limit (tests/src/safety).
#[test]
fn a_late_command_costs_no_more_speed_than_the_watchdog_takes() {
    const WINDOW: Duration = Duration::from_millis(20);
    const STEP: Duration = Duration::from_millis(2);
    let driver = DriverConfig::with_cycle(BUS_CYCLE);
    let (most, watchdog) = (driver.deceleration_rad_per_s2[0], driver.watchdog);
    let fade_s = watchdog.stop_after().saturating_sub(watchdog.ramp_after()).as_secs_f64();
    let (window_s, cycle_s) = (WINDOW.as_secs_f64(), HOST_CYCLE.as_secs_f64());
    for speed in [0.1, 0.2, 0.3, 0.6] {
        let mut arm = Chained::new(JointVector::zeros(), 1.0);
        let mut desired = JointVector::zeros();
        desired[0] = speed;
        for step in 0..100 {
            if step == 80 {
                arm.bench.lock().unwrap().run(Duration::from_millis(28));
            }
            arm.limiter.exchange(JointCommand::Velocity(desired)).unwrap();
        }
        let bench = arm.bench.lock().unwrap();
        let plant = bench.plant.lock().unwrap();
        let (mut lost, mut gained, mut at) = (0.0f64, 0.0f64, plant.now() - Duration::from_millis(400));
        while at + WINDOW <= plant.now() {
            let [before, after] = [at, at + WINDOW].map(|at| plant.motion_at(at).unwrap().1[0]);
            (lost, gained) = (lost.max(before - after), gained.max(after - before));
            at = at + STEP;
        }
        println!("{speed} rad/s: lost {lost:.3}, gained {gained:.3} rad/s within 20 ms");
        assert!(lost <= speed * window_s / fade_s + 1e-6, "{speed}: lost {lost} rad/s");
        assert!(lost > most * window_s || speed < 0.2, "{speed}: lost {lost} rad/s, less than the limit allows");
        assert!(gained <= most * (window_s + cycle_s), "{speed}: gained {gained} rad/s");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(60) })]

    /// For any command, and any time of a hold: no joint leaves its operating range, and the guard, which expects each joint to
    /// brake separately, detects no fault.
    #[test]
    fn the_drivers_own_ramp_leaves_no_range(
        start in prop::array::uniform7(-0.98..0.98f64),
        drive in prop::collection::vec((prop::array::uniform7(-1.0..1.0f64), 10..90usize, 0..30usize), 1..8),
    ) {
        let range_rad = common::operating_range_rad();
        let speeds = common::servo_limits().velocity_max_rad_per_s().to_owned();
        let mut arm = Chained::new(range_rad.component_mul(&JointVector::from(start)), SPEED_SCALE);
        for (parts, cycles, holds) in drive {
            let desired = JointCommand::Velocity(JointVector::from_fn(|i, _| 1.2 * SPEED_SCALE * speeds[i] * parts[i]));
            for i in 0..cycles + holds {
                let command = if i < cycles { desired } else { JointCommand::Hold };
                let answer = arm.limiter.exchange(command);
                prop_assert!(answer.is_ok(), "{answer:?}");
            }
        }
        for _ in 0..150 {
            arm.limiter.exchange(JointCommand::Hold).unwrap();
        }
        let beyond_rad = arm.farthest_beyond_rad();
        prop_assert!(beyond_rad < 1e-5, "beyond the operating range by {beyond_rad} rad");
    }
}
