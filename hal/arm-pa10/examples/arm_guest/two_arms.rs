//! Two arms, each behind its own gateway: from the host through a socket to the gateway, and through an ARCNET interface of the kernel to
//! the emulated controller at its far end.

use std::error::Error;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::time::Duration;

use pb3dp_arm_pa10::arm::trip_line;
use pb3dp_arm_pa10::driver::Trip;
use pb3dp_arm_pa10_emulation::line::mock_server::MockFace;
use pb3dp_arm_pa10_gateway::bus::{ArcnetError, ArcnetSocket, BusPort};
use pb3dp_arm_pa10_gateway::service::HostSide;
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, StopCause};
use pb3dp_arm_pa10_test_support::tunnel::Tunnel;
use pb3dp_hal_api::ArmPower;
use pb3dp_hal_platform::local_socket::LocalConfig;
use pb3dp_hal_platform::realtime::{Realtime, enter, now};

use crate::cell::{Cell, Lines};
use crate::report::{Outcome, Report, ensure};
use crate::system::wait_for;

/// As a rig has it twice: two cards.
const INTERFACES: [&str; 2] = ["arc1", "arc2"];

/// Two gateways and two controllers share one emulated processor.
const BUS_CYCLE: Duration = Duration::from_millis(8);
const LATENESS_ALLOWED: Duration = Duration::from_millis(20);

/// Priority of the control loop: below the threads of the arms, above everything else.
const LOOP: Realtime = Realtime { priority: Some(45), locks_memory: false, cpu: None };

/// Cycles of motion.
const CYCLES: u32 = 60;

/// A joint that turns this far has moved.
const MOVED_RAD: f64 = 0.01;

/// Both arms are stationary after this time, whichever was stopped.
const AT_REST_IN: Duration = Duration::from_millis(400);

pub fn check(report: &mut Report) {
    enter(&LOOP);
    let mut cells = None;
    report.check("two arms move, each behind a gateway at its own interface", || {
        let started = cells.insert(start()?);
        move_both(started)?;
        let trips = started.iter().map(|cell| format!("{:?}", cell.arm.monitor().round_trips().p50));
        Ok(format!("answers after {} (half of them)", trips.collect::<Vec<_>>().join(" and ")))
    });
    let Some(mut cells) = cells else { return };
    report.check("an interface has one gateway", || {
        let in_use = ArcnetError::InUse { name: INTERFACES[0].into() };
        match ArcnetSocket::open(INTERFACES[0]) {
            Err(error) if error == in_use => Ok(error.to_string()),
            other => Err(format!("{:?}", other.map(|_| "it was opened")).into()),
        }
    });
    report.check("an emergency stop at one arm stops both", || {
        cells[1].mock.command_line("e-stop press")?;
        let rest = stops_both(&mut cells, 1, |trip| matches!(trip, Trip::EStop(_)))?;
        cells[1].mock.command_line("e-stop release")?;
        Ok(format!("{rest}; {}", move_again(&mut cells)?))
    });
    report.check("replies of one controller that are lost stop both arms", || {
        cells[0].gateway_stops();
        cells[0].mock.command_line("drop 20")?;
        let rest = stops_both(&mut cells, 0, |_| true)?;
        let stops = cells[0].gateway_stops();
        ensure(stops.iter().any(|(_, cause)| *cause == StopCause::ControllerSilent), || format!("{stops:?}"))?;
        Ok(format!("{rest}; {}", move_again(&mut cells)?))
    });
}

/// The socket of a gateway, in a folder as the service makes it.
fn socket(number: usize) -> Result<PathBuf, Box<dyn Error>> {
    let folder = std::env::temp_dir().join("run");
    fs::create_dir_all(&folder)?;
    fs::set_permissions(&folder, Permissions::from_mode(0o755))?;
    Ok(folder.join(format!("arm{number}.sock")))
}

fn start() -> Result<[Cell; 2], Box<dyn Error>> {
    let mut seats = trip_line(INTERFACES.len())?.into_iter();
    let mut cells = Vec::new();
    for (interface, number) in INTERFACES.into_iter().zip(1..) {
        let far = Tunnel::open(interface)?;
        far.switch(true)?;
        let (arm, path) = (ArmId(number), socket(usize::from(number))?);
        let lines = Lines {
            arm,
            of_host: HostSide::listen_at_socket(&path, arm)?,
            host: Box::new(LocalConfig { path }),
            bus: Box::new(move || Ok(Box::new(ArcnetSocket::open(interface)?) as Box<dyn BusPort>)),
            controller: MockFace::Bus(Box::new(far)),
            bus_cycle: BUS_CYCLE,
            lateness_allowed: LATENESS_ALLOWED,
        };
        cells.push(Cell::start(lines, seats.next().ok_or("no place in the cell")?)?);
    }
    cells.try_into().map_err(|_| "not two arms".into())
}

/// Enables both arms and moves them at the same time; each must have moved by its own controller.
fn move_both(cells: &mut [Cell; 2]) -> Result<(), Box<dyn Error>> {
    let before = cells.each_ref().map(Cell::position_rad);
    // The stop of one arm stops the other one: both are reset before one is enabled.
    for cell in cells.iter_mut() {
        cell.arm.reset()?;
    }
    for cell in cells.iter_mut() {
        cell.arm.begin_enable()?;
    }
    let mut are_on = [false; 2];
    while are_on != [true; 2] {
        for (cell, is_on) in cells.iter_mut().zip(&mut are_on) {
            *is_on = *is_on || cell.arm.poll_enable()?;
            cell.hold()?;
        }
    }
    for _ in 0..CYCLES {
        for cell in cells.iter_mut() {
            cell.exchange()?;
        }
    }
    for ((cell, before), interface) in cells.iter().zip(before).zip(INTERFACES) {
        let moved_rad = (cell.position_rad() - before).amax();
        ensure(moved_rad > MOVED_RAD, || format!("{interface}: its joints have moved by {moved_rad} rad"))?;
    }
    Ok(())
}

/// Commands both arms until both refuse, and waits until they are stationary; the first cause is that of this arm.
fn stops_both(cells: &mut [Cell; 2], first: usize, is_cause: fn(&Trip) -> bool) -> Result<String, Box<dyn Error>> {
    let since = now();
    let mut refused = [false; 2];
    while refused != [true; 2] {
        for (cell, refused) in cells.iter_mut().zip(&mut refused) {
            *refused = *refused || cell.exchange().is_err();
        }
        ensure(now().saturating_since(since) < AT_REST_IN, || format!("refused: {refused:?}"))?;
    }
    wait_for("both arms are stationary with closed brakes", || cells.iter().all(Cell::is_at_rest).then_some(()))?;
    let rest = cells.each_ref().map(|cell| cell.last_motion().saturating_since(since));
    ensure(rest.iter().all(|rest| *rest < AT_REST_IN), || format!("at rest after {rest:?}"))?;
    let trips = cells.each_ref().map(|cell| cell.arm.monitor().snapshot().latched.map(|latched| latched.trip));
    let (own, other) = (trips[first], trips[1 - first]);
    let is_right = own.is_some_and(|trip| is_cause(&trip) && !trip.is_by_other_arm());
    ensure(is_right && other.is_some_and(|trip| trip.is_by_other_arm()), || format!("{trips:?}"))?;
    Ok(format!("at rest after {:?} and {:?}", rest[0], rest[1]))
}

fn move_again(cells: &mut [Cell; 2]) -> Outcome {
    let since = now();
    move_both(cells)?;
    Ok(format!("move again {:?} after the reset", now().saturating_since(since)))
}
