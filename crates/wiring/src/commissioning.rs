//! Arms for commissioning: one to probe, one to move slowly, alone or together with the other arm.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use pb3dp_arm_pa10::arm::{ArmMonitor, Pa10Arm, RequestError, read_shared_key};
use pb3dp_arm_pa10::driver::{FaultCause, LimitsCheck, Trip};
use pb3dp_arm_pa10::serial::SerialError;
use pb3dp_arm_pa10_emulation::line::mock_server::{MockFace, MockServer, SocketAddr};
use pb3dp_arm_pa10_gateway::service::Access;
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, StopCause};
use pb3dp_cell::parts::{ArmChoice, ArmControl};
use pb3dp_hal_api::Clock;
use pb3dp_hal_middleware::{FlightLog, StartPose};
use pb3dp_hal_platform::tcp::{TcpConfig, TcpError};
use pb3dp_setup::setup::{ArmLink, GatewayWay, Setup};

use super::arm::{SingleArm, Wanted, WiredArms, alone, connect, emulate, line, wire_alone, wire_arms};

pub use super::arm::LIMITS_TOLERANCE_DEG;

/// Largest share of the joint speeds in commissioning.
const SPEED_SCALE_MAX: f64 = 0.10;

/// An arm that is only probed. Its limits are read but not compared.
pub struct ObservedArm {
    /// The arm.
    pub arm: Pa10Arm,
    /// Address or port of its link, for messages.
    pub target: String,
    /// The emulated arm at the other end, if there is one.
    pub emulated: Option<MockServer>,
}

fn wanted<'a>(setup: &'a Setup, choice: ArmChoice, clock: &'a Arc<dyn Clock>) -> Wanted<'a> {
    let (name, arm, control_period) = (choice.name(), choice.of(setup), setup.control_period);
    Wanted { name, arm, control_period, clock, time: None, standing: None }
}

/// Opens the link to an arm; its brakes stay closed.
///
/// # Errors
/// If it has no link, or does not answer as configured.
pub fn see(setup: &Setup, choice: ArmChoice, clock: &Arc<dyn Clock>) -> Result<ObservedArm> {
    let wanted = wanted(setup, choice, clock);
    let Some((line, emulated)) = line(wanted)? else {
        bail!("{}.backend = \"mock\" has no link to an arm; set emulated, serial, tcp or local", choice.of(setup).key)
    };
    let (target, emulated) = (line.target(), emulated.and_then(|(emulation, _)| emulation.into_server()));
    let arm = connect(line, (alone()?, LimitsCheck::Read), wanted)?;
    Ok(ObservedArm { arm, target, emulated })
}

/// Checks with `--alone` that the other arm is disabled or disconnected: nobody else monitors it then.
///
/// # Errors
/// If its drives are enabled, or if its link does not show whether they are.
pub fn check_other_is_off(setup: &Setup, choice: ArmChoice, clock: &Arc<dyn Clock>) -> Result<()> {
    let other = choice.other();
    if other.of(setup).link.is_toy() {
        return Ok(());
    }
    let observed = match see(setup, other, clock) {
        Ok(observed) => observed.arm.monitor().snapshot(),
        Err(error) if is_absent(&error, &other.of(setup).link) => {
            tracing::info!("--alone: {} is disconnected: {error:#}", other.name());
            return Ok(());
        }
        Err(error) => {
            return Err(error.context(format!(
                "--alone: it is unknown whether {} is disabled; disconnect it, end the program that uses it, or leave --alone out",
                other.name()
            )));
        }
    };
    let is_on =
        |state: GatewayState| !matches!(state, GatewayState::Idle | GatewayState::Fault | GatewayState::EmergencyStop);
    if let Some(found) = observed.gateway_found.filter(|found| is_on(found.state)) {
        bail!(
            "--alone: the gateway of {} is in the state {}: its drives may be enabled; stop it, or leave --alone out",
            other.name(),
            found.state
        );
    }
    tracing::info!("--alone: {} is connected and disabled", other.name());
    Ok(())
}

/// An error of the other arm says why this arm is connected, too; an error of the wanted arm stays as it is.
fn about_other(error: anyhow::Error, setup: &Setup, other: ArmChoice) -> anyhow::Error {
    if !format!("{error:#}").contains(other.name()) {
        return error;
    }
    let why = "both arms are connected to monitor the distance between them";
    if is_absent(&error, &other.of(setup).link) {
        return error.context(format!("{why}; if the {} is powered off, use --alone", other.name()));
    }
    error.context(why)
}

/// Whether the link has nobody at its other end: no adapter, no listener, or no answer on a serial line that no other program uses.
fn is_absent(error: &anyhow::Error, link: &ArmLink) -> bool {
    let is_serial = matches!(link, ArmLink::Gateway(_, GatewayWay::Serial { .. }));
    error.chain().any(|cause| {
        matches!(cause.downcast_ref(), Some(SerialError::Missing { .. }))
            || (is_serial && matches!(cause.downcast_ref(), Some(RequestError::NoGateway)))
            || cause.is::<TcpError>()
    })
}

/// Whether the controller's answers have another length than the configured wire format; the length identifies the format.
pub fn is_of_another_format(trip: &Trip) -> bool {
    matches!(trip, Trip::Fault(FaultCause::Gateway(StopCause::ReplyUnusable)))
}

/// An arm that may move slowly.
pub struct SlowArm {
    /// Behind limiter and guard.
    pub driven: Box<dyn ArmControl>,
    /// Monitor of its link, if it has one.
    pub monitor: Option<ArmMonitor>,
    /// Its flight recorder.
    pub flight: FlightLog,
    /// The other arm, if it is connected. It only holds.
    pub other: Option<OtherArm>,
    /// Emulated arms at the other ends of the links.
    pub emulated: Vec<MockServer>,
}

/// The other arm of a workcell.
pub struct OtherArm {
    /// Behind limiter, coupling and guard.
    pub driven: Box<dyn ArmControl>,
    /// Monitor of its link, if it has one.
    pub monitor: Option<ArmMonitor>,
    /// Its flight recorder.
    pub flight: FlightLog,
}

/// Excess over the commissioning speed at which the guard stops a joint, rad/s: geared drives run unevenly at low speed.
const RIPPLE_RAD_PER_S: f64 = 0.02;

/// The setup with commissioning speeds, for an arm at any pose; `joint_max_rad_per_s` holds for each joint.
///
/// # Errors
/// If the speed is not valid.
pub fn slow_setup(setup: &Setup, choice: ArmChoice, joint_max_rad_per_s: f64) -> Result<Setup> {
    let mut slow = setup.clone();
    for arm in [&mut slow.rig.arms.vs, &mut slow.rig.arms.tc] {
        arm.limits = arm.limits.slowed(f64::MAX, SPEED_SCALE_MAX)?;
        // A gateway keeps these speeds, too.
        arm.link = arm.link.clone().limited(&arm.limits)?;
    }
    let arm = choice.of_mut(&mut slow);
    arm.limiter.start = StartPose::Anywhere;
    arm.limits = arm.limits.slowed(joint_max_rad_per_s, SPEED_SCALE_MAX)?;
    arm.link = arm.link.clone().limited(&arm.limits)?;
    arm.guard.ripple_rad_per_s = RIPPLE_RAD_PER_S;
    Ok(slow)
}

/// Connects an arm of a [`slow_setup`], alone or with the other arm; brakes stay closed.
///
/// # Errors
/// If an arm does not answer as configured.
pub fn wire_slow(setup: &Setup, choice: ArmChoice, beside_other: bool, clock: &Arc<dyn Clock>) -> Result<SlowArm> {
    if !beside_other {
        let SingleArm { driven, monitor, flight, emulated } = wire_alone(wanted(setup, choice, clock))?;
        return Ok(SlowArm { driven, monitor, flight, other: None, emulated: emulated.into_iter().collect() });
    }
    let WiredArms { driven: [vs, tc], flights: [(_, vs_flight), (_, tc_flight)], monitors, emulated, .. } =
        wire_arms(setup, clock, None).map_err(|error| about_other(error, setup, choice.other()))?;
    let monitor_of = |choice: ArmChoice| {
        monitors.iter().find(|(name, _)| *name == choice.name()).map(|(_, monitor)| monitor.clone())
    };
    let ((driven, flight), (other, other_flight)) = match choice {
        ArmChoice::Vs => ((vs, vs_flight), (tc, tc_flight)),
        ArmChoice::Tc => ((tc, tc_flight), (vs, vs_flight)),
    };
    let monitor = monitor_of(choice);
    let monitor =
        Some(monitor.context("an arm with backend = \"mock\" has no link; set emulated, serial, tcp or local")?);
    let other = OtherArm { driven: other, monitor: monitor_of(choice.other()), flight: other_flight };
    Ok(SlowArm { driven, monitor, flight, other: Some(other), emulated })
}

/// An arm with the backend `emulated`, at a local address that stays the same while its cable is pulled and plugged in, and that another
/// process can reach with the key in this file. Pass both to [`set_line`].
///
/// # Errors
/// If the backend is another one: fault injection is for emulated arms only.
pub fn emulate_at_address(
    setup: &Setup,
    choice: ArmChoice,
    key_file: &Path,
    clock: &Arc<dyn Clock>,
) -> Result<MockServer> {
    let ArmLink::Gateway(link, GatewayWay::Emulated) = &choice.of(setup).link else {
        bail!(
            "{}.backend is not \"emulated\": the program cannot operate switches and cables of this arm",
            choice.of(setup).key
        )
    };
    let address = "127.0.0.1:0".parse().context("a local address")?;
    let access = Access::from_this_computer(read_shared_key(key_file)?);
    let face = |gateway| MockFace::Tcp(gateway, address, access);
    Ok(emulate(face, link, wanted(setup, choice, clock))?.0)
}

/// Makes a setup reach an arm by TCP at this address with the key in this file, overriding its file.
pub fn set_line(setup: &mut Setup, choice: ArmChoice, address: SocketAddr, key_file: PathBuf) {
    if let ArmLink::Gateway(_, way) = &mut choice.of_mut(setup).link {
        *way = GatewayWay::Tcp { tcp: TcpConfig { address }, key_file };
    }
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;

    use pb3dp_hal_clock::SystemClock;
    use pb3dp_hal_platform::key_file::write_new_key;
    use pb3dp_setup::setup::read_setup;

    use super::*;

    /// Checks with the arm with the target at this address.
    fn check_at(address: SocketAddr, key_file: &Path) -> Result<()> {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/hil.toml");
        let mut setup = read_setup(&file).unwrap();
        set_line(&mut setup, ArmChoice::Tc, address, key_file.to_owned());
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        check_other_is_off(&setup, ArmChoice::Vs, &clock)
    }

    #[test]
    fn only_an_absent_other_arm_is_advised_to_be_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("arm.key");
        write_new_key(&key).unwrap();
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/hil.toml");
        let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let refusal_of = |absent: ArmChoice| {
            let mut setup = read_setup(&file).unwrap();
            set_line(&mut setup, absent, free, key.clone());
            let refused = wire_slow(&setup, ArmChoice::Vs, true, &clock).err().unwrap();
            format!("{refused:#}")
        };
        let (own, other) = (refusal_of(ArmChoice::Vs), refusal_of(ArmChoice::Tc));
        assert!(own.contains("vs-robot") && !own.contains("both arms") && !own.contains("--alone"), "{own}");
        assert!(other.contains("tc-robot") && other.contains("if the tc-robot is powered off, use --alone"), "{other}");
    }

    #[test]
    fn an_arm_that_nobody_serves_is_off_and_one_that_another_host_holds_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let key = folder.path().join("arm.key");
        write_new_key(&key).unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        // A gateway turns away the second host: it closes the connection.
        let turning_away = std::thread::spawn(move || drop(listener.accept()));
        let refusal = format!("{:#}", check_at(address, &key).unwrap_err());
        assert!(refusal.starts_with("--alone: it is unknown whether tc-robot is disabled"), "{refusal}");
        turning_away.join().unwrap();
        check_at(address, &key).unwrap();
    }
}
