//! Arms for their commissioning: one to look at, one to move slowly, alone or beside the other one.

use std::sync::Arc;

use anyhow::{Context, Result, bail};
use pb3dp_arm_pa10::arm::{ArmMonitor, Pa10Arm};
use pb3dp_arm_pa10::driver::{FaultCause, LimitsCheck, Trip};
use pb3dp_arm_pa10_emulation::line::mock_server::{MockFace, MockServer, SocketAddr};
use pb3dp_arm_pa10_protocol::gateway_protocol::StopCause;
use pb3dp_cell::parts::{ArmChoice, DrivenArm};
use pb3dp_hal_api::Clock;
use pb3dp_hal_middleware::{FlightLog, StartPose};
use pb3dp_hal_platform::tcp::TcpConfig;
use pb3dp_setup::setup::{ArmLink, GatewayWay, Setup};

use super::arm::{AloneArm, Wanted, WiredArms, alone, connect, emulate, line, wire_alone, wire_arms};

pub use super::arm::LIMITS_TOLERANCE_DEG;

/// Largest share of the joints' speeds in commissioning.
const SPEED_SCALE_MAX: f64 = 0.10;

/// An arm that is only looked at. Its limits are read, not compared.
pub struct SeenArm {
    /// The arm.
    pub arm: Pa10Arm,
    /// How it is reached.
    pub target: String,
    /// The emulated arm at the other end.
    pub emulated: Option<MockServer>,
}

fn wanted<'a>(setup: &'a Setup, choice: ArmChoice, clock: &'a Arc<dyn Clock>) -> Wanted<'a> {
    Wanted { name: choice.name(), arm: choice.of(setup), control_period: setup.control_period, clock, time: None }
}

/// Opens the link to an arm, whose brakes stay on.
///
/// # Errors
/// If it has no link, or does not answer as configured.
pub fn see(setup: &Setup, choice: ArmChoice, clock: &Arc<dyn Clock>) -> Result<SeenArm> {
    let wanted = wanted(setup, choice, clock);
    let Some((line, emulated)) = line(wanted)? else {
        bail!("{}.backend = \"mock\" has no line to an arm; set emulated, serial, tcp or arcnet", choice.of(setup).key)
    };
    let (target, emulated) = (line.target(), emulated.and_then(|(emulation, _)| emulation.into_server()));
    let arm = connect(line, (alone()?, LimitsCheck::Read), wanted)?;
    Ok(SeenArm { arm, target, emulated })
}

/// Whether the controller's answers have another length than the configured wire format has, which is how formats are told apart.
pub fn is_of_another_format(trip: &Trip) -> bool {
    matches!(trip, Trip::Fault(FaultCause::Gateway(StopCause::ReplyUnusable) | FaultCause::ReplyFormat { .. }))
}

/// An arm that may move slowly.
pub struct SlowArm {
    /// Through limiter and guard.
    pub driven: Box<dyn DrivenArm>,
    /// What its link is like, if it has one.
    pub monitor: Option<ArmMonitor>,
    /// Its flight recorder.
    pub flight: FlightLog,
    /// The other one, if it is connected, too. It only holds.
    pub other: Option<OtherArm>,
    /// Emulated arms at the other ends.
    pub emulated: Vec<MockServer>,
}

/// The other arm of a cell.
pub struct OtherArm {
    /// Through limiter, coupling and guard.
    pub driven: Box<dyn DrivenArm>,
    /// What its link is like, if it has one.
    pub monitor: Option<ArmMonitor>,
    /// Its flight recorder.
    pub flight: FlightLog,
}

/// By how much a joint may be faster than its speed in commissioning before the guard stops it, rad/s: geared drives do not turn evenly
/// when they are slow.
const RIPPLE_RAD_PER_S: f64 = 0.02;

/// The setup with the speeds of commissioning, for an arm that may stand anywhere; `joint_max_rad_per_s` is for each joint.
///
/// # Errors
/// If a speed is none.
pub fn slow_setup(setup: &Setup, choice: ArmChoice, joint_max_rad_per_s: f64) -> Result<Setup> {
    let mut slow = setup.clone();
    for arm in [&mut slow.rig.vs, &mut slow.rig.tc] {
        arm.limits = arm.limits.slowed(f64::MAX, SPEED_SCALE_MAX)?;
    }
    let arm = choice.of_mut(&mut slow);
    arm.limiter.start = StartPose::Anywhere;
    arm.limits = arm.limits.slowed(joint_max_rad_per_s, SPEED_SCALE_MAX)?;
    arm.guard.ripple_rad_per_s = RIPPLE_RAD_PER_S;
    Ok(slow)
}

/// Connects an arm of a [`slow_setup`], alone or beside the other one; brakes stay on.
///
/// # Errors
/// If an arm does not answer as configured.
pub fn wire_slow(setup: &Setup, choice: ArmChoice, beside_other: bool, clock: &Arc<dyn Clock>) -> Result<SlowArm> {
    if !beside_other {
        let AloneArm { driven, monitor, flight, emulated } = wire_alone(wanted(setup, choice, clock))?;
        return Ok(SlowArm { driven, monitor, flight, other: None, emulated: emulated.into_iter().collect() });
    }
    let WiredArms { driven: [vs, tc], flights: [(_, vs_flight), (_, tc_flight)], monitors, emulated, .. } =
        wire_arms(setup, clock, None).with_context(|| {
            format!("both arms are connected, so that the room between them is watched; where the {} is switched off, give --alone", choice.other().name())
        })?;
    let monitor_of = |choice: ArmChoice| {
        monitors.iter().find(|(name, _)| *name == choice.name()).map(|(_, monitor)| monitor.clone())
    };
    let ((driven, flight), (other, other_flight)) = match choice {
        ArmChoice::Vs => ((vs, vs_flight), (tc, tc_flight)),
        ArmChoice::Tc => ((tc, tc_flight), (vs, vs_flight)),
    };
    let monitor = monitor_of(choice);
    let monitor =
        Some(monitor.context("an arm with backend = \"mock\" has no line; set emulated, serial, tcp or arcnet")?);
    let other = OtherArm { driven: other, monitor: monitor_of(choice.other()), flight: other_flight };
    Ok(SlowArm { driven, monitor, flight, other: Some(other), emulated })
}

/// An arm whose backend is `emulated`, at an address of this machine that stays while its cable is pulled and plugged, and that another
/// program can reach. The setup is to be told by [`set_line`].
///
/// # Errors
/// If the backend is another one: a real arm is nobody's toy.
pub fn emulate_at_address(setup: &Setup, choice: ArmChoice, clock: &Arc<dyn Clock>) -> Result<MockServer> {
    let ArmLink::Gateway(link, GatewayWay::Emulated) = &choice.of(setup).link else {
        bail!(
            "{}.backend is not \"emulated\": the program has no hand at the switches and cables of this arm",
            choice.of(setup).key
        )
    };
    let address = "127.0.0.1:0".parse().context("an address of this machine")?;
    let face = |gateway| MockFace::Tcp(gateway, address);
    Ok(emulate(face, link, wanted(setup, choice, clock))?.0)
}

/// Has an arm reached by TCP at this address, whatever the file says.
pub fn set_line(setup: &mut Setup, choice: ArmChoice, address: SocketAddr) {
    if let ArmLink::Gateway(_, way) = &mut choice.of_mut(setup).link {
        *way = GatewayWay::Tcp(TcpConfig { address });
    }
}
