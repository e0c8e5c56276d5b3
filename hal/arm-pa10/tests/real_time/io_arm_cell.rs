//! Motion of the joints: a real arm over a pseudo-terminal, with the project's gateway and an emulated servo controller.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

use std::sync::Arc;
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::{ArmOpenError, Pa10Arm, Pa10ArmConfig, TripSeat, trip_line};
use pb3dp_arm_pa10::driver::{DriverConfig, LimitsCheck};
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, GatewayState, Geometry, HostLimits, StopCause};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_arm_pa10_test_support::cell_end::{Cell, CellEnd};
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::ByteLink;
use pb3dp_kinematics::JointVector;
use pb3dp_test_support::in_real_time_beside_others;

const CYCLE: Duration = Duration::from_millis(10);
const LONG: Duration = Duration::from_secs(5);
const B: WireFormat = WireFormat::BigEndian6x10;

fn velocity() -> JointVector {
    JointVector::from([0.1, -0.2, 0.3, -0.15, 0.25, -0.1, 0.2])
}

fn limits() -> JointVector {
    JointVector::from([177.0f64, 91.0, 174.0, 137.0, 255.0, 165.0, 255.0].map(f64::to_radians))
}

fn home() -> JointVector {
    JointVector::from([0.2, -0.5, 0.3, 1.1, 3.1, 0.9, 0.1])
}

fn config(arm: u8, format: WireFormat) -> Pa10ArmConfig {
    let tolerance_rad = 0.5f64.to_radians();
    let limits = LimitsCheck::Compare { lower_rad: -limits(), upper_rad: limits(), tolerance_rad };
    let driver = DriverConfig { limits, ..DriverConfig::with_cycle(CYCLE) };
    let link = GatewayLinkConfig {
        arm: ArmId(arm),
        format,
        geometry: Geometry::Unknown,
        cycle: CYCLE,
        limits: HostLimits::WIDEST,
        signals: StatusSignals::ORCA,
    };
    Pa10ArmConfig::new(&format!("arm-{arm}"), driver, link)
}

/// Opens an arm with this cell at the far end.
fn open(
    config: Pa10ArmConfig,
    cell: Cell,
    seat: TripSeat,
    clock: &Arc<SystemClock>,
) -> (Result<Pa10Arm, ArmOpenError>, CellEnd) {
    let pty = Pty::open().unwrap();
    let serial = SerialConfig::of_link(pty.name().to_owned(), 921_600, &config.link);
    let end = CellEnd::serve(Box::new(pty), cell);
    (Pa10Arm::open(config, Box::new(serial), Arc::clone(clock) as Arc<_>, seat), end)
}

/// Opens an arm that is refused, or opened and stopped.
fn open_one(config: Pa10ArmConfig, cell: Cell) -> (Result<Pa10Arm, ArmOpenError>, CellEnd) {
    open(config, cell, trip_line(1).unwrap().remove(0), &Arc::new(SystemClock::new()))
}

struct Rig {
    arm: Pa10Arm,
    end: CellEnd,
    clock: Arc<SystemClock>,
}

impl Rig {
    fn new(arm: u8, format: WireFormat, seat: TripSeat, clock: &Arc<SystemClock>) -> Self {
        let (arm, end) = open(config(arm, format), Cell::new(ArmId(arm), format, home()), seat, clock);
        let arm = arm.unwrap_or_else(|error| panic!("{error}: {:?}", std::error::Error::source(&error)));
        Self { arm, end, clock: Arc::clone(clock) }
    }

    fn one() -> Self {
        let seat = trip_line(1).unwrap().remove(0);
        Self::new(2, B, seat, &Arc::new(SystemClock::new()))
    }

    /// On a loaded machine the link may pass the warm-up only after several tries.
    fn enable(&mut self) {
        let mut reset = Ok(());
        for _ in 0..20 {
            match self.arm.enable() {
                Ok(()) => return,
                Err(error) if error.to_string().contains("the brakes stay closed") => {}
                // The reset may be late as well; the next one is not.
                Err(error) if error.to_string().contains("in a row without a usable reply") => reset = self.arm.reset(),
                Err(error) => panic!("{error}"),
            }
        }
        panic!("the machine is too loaded to enable an arm; the last reset: {reset:?}");
    }

    /// On a loaded machine answers may be late.
    fn exchange(&mut self, command: JointCommand, cycles: u32) {
        for _ in 0..cycles {
            std::thread::sleep(CYCLE);
            match self.arm.exchange(command) {
                Err(error) if error.kind() != ArmErrorKind::Timeout => panic!("{error}"),
                _ => {}
            }
        }
    }

    fn enable_and_move(&mut self) {
        self.enable();
        self.exchange(JointCommand::Velocity(velocity()), 30);
        assert_eq!(self.end.state(), GatewayState::Moving);
    }

    fn wait_until(&self, what: &str, happened: impl Fn(&Self) -> bool) {
        let begin = Instant::now();
        while !happened(self) {
            assert!(begin.elapsed() < LONG, "{what}: {:?}, {:?}", self.arm.monitor().snapshot(), self.end.status());
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Commands motion until the arm is latched.
    fn exchange_until_stopped(&mut self) -> ArmError {
        let begin = Instant::now();
        loop {
            std::thread::sleep(CYCLE);
            match self.arm.exchange(JointCommand::Velocity(velocity())) {
                Err(error) if error.kind() != ArmErrorKind::Timeout => return error,
                _ => assert!(begin.elapsed() < LONG, "{:?}", self.arm.monitor().snapshot()),
            }
        }
    }
}

/// The brakes are closed, and the true joints are stationary.
fn is_at_rest(end: &CellEnd) -> bool {
    let (before, braked) = {
        let cell = end.cell();
        (cell.position(), cell.controller.is_braked())
    };
    std::thread::sleep(Duration::from_millis(20));
    braked && (end.cell().position() - before).amax() < 1e-6
}

#[test]
fn joints_follow_their_commands_in_every_format() {
    in_real_time_beside_others(|| {
        for format in WireFormat::ALL {
            let seat = trip_line(1).unwrap().remove(0);
            let mut rig = Rig::new(3, format, seat, &Arc::new(SystemClock::new()));
            let read = rig.arm.monitor().snapshot().limits[1].unwrap();
            assert!((read.upper_rad - 91f64.to_radians()).abs() < 1e-4, "{read:?}");
            rig.enable_and_move();
            let (from, begin) = (rig.end.cell().position(), rig.clock.now());
            rig.exchange(JointCommand::Velocity(velocity()), 50);
            let (to, end) = (rig.end.cell().position(), rig.clock.now());
            let moved = (to - from) / end.seconds_since(begin);
            // Time that a loaded machine loses affects all joints equally.
            let part = moved.dot(&velocity()) / velocity().norm_squared();
            assert!((moved - velocity() * part).amax() < 0.01, "{format}: {moved}");
            assert!((0.3..1.1).contains(&part), "{format}: {part}");
            let measured = rig.arm.exchange(JointCommand::Hold).map(|joints| joints.position_rad);
            if let Ok(measured) = measured {
                assert!((measured - to).amax() < 0.05, "{measured}");
            }
            rig.arm.stop().unwrap();
            assert!(is_at_rest(&rig.end), "{format}");
            assert_eq!(rig.end.state(), GatewayState::Idle);
            let status = rig.end.status();
            println!("{format}: {part:.3} of the way, {:?}, {:?}", rig.arm.monitor().jitter(), status.cycle);
        }
    });
}

#[test]
fn a_fault_of_the_arm_is_reported_with_axis_and_alarm_and_reset_when_it_is_gone() {
    in_real_time_beside_others(|| {
        let mut rig = Rig::one();
        rig.enable_and_move();
        rig.end.inject("alarm 4 0x0e");
        let error = rig.exchange_until_stopped();
        assert_eq!(error.kind(), ArmErrorKind::Fault);
        for part in ["arm arm-2", "E1", "over-current", "remove the cause, then reset"] {
            assert!(error.to_string().contains(part), "{part}: {error}");
        }
        assert_eq!((error.joint(), error.code()), (Some(3), Some(0x0e)));
        let error = rig.arm.reset().unwrap_err();
        assert_eq!((error.kind(), rig.arm.state()), (ArmErrorKind::Fault, ArmState::Fault), "{error}");
        assert_eq!((error.joint(), error.code()), (Some(3), Some(0x0e)));
        rig.end.inject("alarm 4 off");
        rig.arm.reset().unwrap();
        assert_eq!(rig.arm.state(), ArmState::Disabled);
        rig.enable_and_move();
    });
}

#[test]
fn a_line_that_takes_no_more_bytes_has_the_joints_stopped_by_both_sides() {
    in_real_time_beside_others(|| {
        let mut rig = Rig::one();
        rig.enable_and_move();
        rig.end.cell().stalled = true;
        let error = rig.exchange_until_stopped();
        assert!(error.to_string().contains("3 exchanges in a row without a usable reply"), "{error}");
        rig.wait_until("at rest", |rig| is_at_rest(&rig.end));
        assert_eq!(rig.end.status().cause, StopCause::HostSilent);
        rig.end.cell().stalled = false;
        // Bytes that waited in the line are old, and move nothing.
        std::thread::sleep(Duration::from_millis(100));
        assert!(is_at_rest(&rig.end));
        rig.arm.reset().unwrap();
        rig.enable_and_move();
    });
}

#[test]
fn the_link_of_the_other_arm_is_refused_by_its_number() {
    in_real_time_beside_others(|| {
        let (refused, _end) = open_one(config(1, B), Cell::new(ArmId(2), B, home()));
        let error = refused.err().unwrap();
        let source = std::error::Error::source(&error).unwrap().to_string();
        assert!(source.contains("a reply came from arm 2: the configuration has another arm number"), "{source}");
    });
}

#[test]
fn a_gateway_before_an_arm_of_another_format_does_not_move_it() {
    in_real_time_beside_others(|| {
        let config = config(2, WireFormat::LittleEndian5x8);
        let (opened, _end) = open_one(config, Cell::new(ArmId(2), B, home()));
        // From the replies to the stop order at its start the gateway knows the format of the controller.
        let error = opened.err().unwrap();
        let source = std::error::Error::source(&error).unwrap().to_string();
        assert!(
            source.contains("answers in format B") && source.contains("the configuration says format A"),
            "{source}"
        );
    });
}

#[test]
fn an_arm_with_other_limits_is_opened_stopped_and_says_which() {
    in_real_time_beside_others(|| {
        let mut other = config(2, B);
        let (mut lower_rad, upper_rad) = (-limits(), limits());
        lower_rad[5] += 1f64.to_radians();
        other.driver.limits = LimitsCheck::Compare { lower_rad, upper_rad, tolerance_rad: 0.5f64.to_radians() };
        let (opened, _end) = open_one(other, Cell::new(ArmId(2), B, home()));
        let mut arm = opened.map_err(|error| error.to_string()).unwrap();
        assert_eq!(arm.state(), ArmState::Fault);
        for result in [arm.enable(), arm.reset()] {
            let error = result.unwrap_err();
            assert!(error.to_string().contains("(W1): the controller keeps a limit of -165.000 degrees"), "{error}");
        }
    });
}

#[test]
fn an_arm_whose_emergency_stop_is_pressed_is_opened_and_reset_when_it_is_released() {
    in_real_time_beside_others(|| {
        let mut cell = Cell::new(ArmId(2), B, home());
        let now = cell.now;
        cell.controller.command_line(now, "e-stop press").unwrap();
        let (opened, end) = open_one(config(2, B), cell);
        let mut arm = opened.map_err(|error| error.to_string()).unwrap();
        assert_eq!(arm.state(), ArmState::EStop, "{:?}", arm.monitor().snapshot().latched);
        assert!(arm.reset().is_err());
        assert_eq!(arm.state(), ArmState::EStop);
        end.inject("e-stop release");
        arm.reset().unwrap();
        let clock = Arc::new(SystemClock::new());
        Rig { arm, end, clock }.enable_and_move();
    });
}
