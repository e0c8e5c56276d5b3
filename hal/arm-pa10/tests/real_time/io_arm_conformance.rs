//! A real arm fulfils the contract of the arm traits: over a pseudo-terminal, in real time, with the project's gateway and an
//! emulated servo controller.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::{Pa10Arm, Pa10ArmConfig, trip_line};
use pb3dp_arm_pa10::driver::{DriverConfig, LimitsCheck};
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Geometry, HostLimits};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_arm_pa10_test_support::cell_end::{Cell, CellEnd};
use pb3dp_hal_api::{ArmPower, ArmState};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_conformance::{ArmExpectations, ArmHooks, ArmPart, Report, arm_suite_of};
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::realtime::{Realtime, enter};
use pb3dp_hal_platform::transport::ByteLink;
use pb3dp_kinematics::JointVector;
use pb3dp_test_support::{beside_each_other, in_real_time_beside_others};

const CYCLE: Duration = Duration::from_millis(10);
const FORMAT: WireFormat = WireFormat::BigEndian6x10;

/// Limits of the emulated EEPROM.
fn limits() -> JointVector {
    JointVector::from([177.0f64, 91.0, 174.0, 137.0, 255.0, 165.0, 255.0].map(f64::to_radians))
}

fn open(clock: &Arc<SystemClock>) -> (Pa10Arm, CellEnd) {
    let pty = Pty::open().unwrap();
    let serial = SerialConfig { path: pty.name().to_owned(), baud: 460_800, cycle: CYCLE };
    // E2 soon exceeds half a turn, so that wrapped angles would be detected.
    let home = JointVector::from([0.2, -0.5, 0.3, 1.1, std::f64::consts::PI - 0.02, 0.9, 0.1]);
    let cell = CellEnd::serve(Box::new(pty), Cell::new(ArmId(1), FORMAT, home));
    let limits = LimitsCheck::Compare { lower_rad: -limits(), upper_rad: limits(), tolerance_rad: 0.5f64.to_radians() };
    let driver = DriverConfig { limits, ..DriverConfig::with_cycle(CYCLE) };
    let geometry = Geometry::SecondGeneration;
    let config = Pa10ArmConfig::new(
        "vs-robot",
        driver,
        GatewayLinkConfig {
            arm: ArmId(1),
            format: FORMAT,
            geometry,
            cycle: CYCLE,
            limits: HostLimits::WIDEST,
            signals: StatusSignals::ORCA,
        },
    );
    let seat = trip_line(1).unwrap().remove(0);
    let arm = Pa10Arm::open(config, Box::new(serial), Arc::clone(clock) as Arc<_>, seat);
    let arm = arm.unwrap_or_else(|error| panic!("{error}: {:?}", std::error::Error::source(&error)));
    (arm, cell)
}

fn wait_for_state(arm: &Pa10Arm, state: ArmState) {
    let begin = Instant::now();
    while arm.state() != state && begin.elapsed() < Duration::from_secs(2) {
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Injects the fault into the current cell of the arm.
fn with(
    cell: &Rc<RefCell<Option<CellEnd>>>,
    line: &'static str,
    leads_to: Option<ArmState>,
) -> Box<dyn Fn(&mut Pa10Arm)> {
    let cell = Rc::clone(cell);
    Box::new(move |arm| {
        cell.borrow().as_ref().unwrap().inject(line);
        if let Some(state) = leads_to {
            wait_for_state(arm, state);
        }
    })
}

fn suite(part: ArmPart) -> Report {
    let clock = Arc::new(SystemClock::new());
    let cell: Rc<RefCell<Option<CellEnd>>> = Rc::default();
    let make = || {
        let (arm, end) = open(&clock);
        *cell.borrow_mut() = Some(end);
        arm
    };
    let lose_reply = {
        let cell = Rc::clone(&cell);
        move |arm: &mut Pa10Arm| {
            // Directly after a measurement: as many of the next ones are lost as the arm tolerates.
            let monitor = arm.monitor();
            let before = monitor.snapshot().samples;
            let begin = Instant::now();
            while monitor.snapshot().samples == before && begin.elapsed() < Duration::from_secs(2) {
                std::thread::sleep(Duration::from_micros(200));
            }
            cell.borrow().as_ref().unwrap().cell().answers_lost = 2;
            // Until the last measurement is old.
            std::thread::sleep(CYCLE.mul_f64(1.6));
        }
    };
    let hooks = ArmHooks {
        lose_reply: Some(Box::new(lose_reply)),
        raise_fault: Some(with(&cell, "alarm 4 0x0e", Some(ArmState::Fault))),
        remove_fault_cause: Some(with(&cell, "alarm 4 off", None)),
        press_e_stop: Some(with(&cell, "e-stop press", Some(ArmState::EStop))),
        release_e_stop: Some(with(&cell, "e-stop release", None)),
    };
    let expectations = ArmExpectations { speed_rad_per_s: 0.1, settles_within: Duration::from_millis(250) };
    arm_suite_of(&[part], make, clock.as_ref(), &expectations, &hooks)
}

#[test]
fn an_arm_behind_a_gateway_keeps_the_contract() {
    beside_each_other(ArmPart::ALL, |part| {
        // Real-time where permitted; the arm's own thread requests it by itself.
        enter(&Realtime { priority: Some(30), locks_memory: false, cpu: None });
        // The behaviour on a machine that delays threads is tested in virtual time.
        in_real_time_beside_others(|| suite(part).assert_passed());
    });
}
