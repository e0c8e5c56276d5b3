//! `pb3dp mock-arm`: an emulated PA-10 in real time that fails on request.

use std::io::Write;
use std::process::ExitCode;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use anyhow::Context;
use clap::{ArgGroup, Args};
use pb3dp_arm_pa10::arm::read_shared_key;
use pb3dp_arm_pa10_emulation::line::mock_server::{MockFace, MockServer, MockServerConfig, SocketAddr};
use pb3dp_arm_pa10_emulation::mock_controller::{MockControllerConfig, Script, ScriptLine, pa10_joints};
use pb3dp_arm_pa10_gateway::gateway::GatewayConfig;
use pb3dp_arm_pa10_gateway::service::Access;
use pb3dp_arm_pa10_protocol::codec::StatusSignals;
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Firmware};
use pb3dp_cell::terminal::typed_lines;
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::realtime::Realtime;
use pb3dp_kinematics::{DOF, JointVector};
use pb3dp_record::text_file::read_text;
use pb3dp_setup::names::{FormatName, GeometryName};
use pb3dp_sim::joint_dynamics::JointPlant;
use pb3dp_wiring::MOCK_ARM;

use crate::gateway::file::read_gateway;

/// Help for fault scripts, `--fault` and standard input.
const LINES: &str =
    "Faults, one per line, in a script, in --fault or typed while the arm runs (docs/mock-arm.md has all of them):
  at 2s e-stop press            two seconds after the start
  in 500ms alarm 4 0x0e         over-current of axis 4, half a second from now
  chance 1% at-most 2 drop 1    one reply in a hundred lost, never three in a row
  power off                     at once
Typed lines may also be:
  state                         print the state of the arm
  unplug, plug                  pull or plug the cable (a pseudo-terminal gets a new path)
  quit                          exit";

/// Longest wait for input before the time is checked again.
const LOOK: Duration = Duration::from_millis(100);

/// Arguments of `pb3dp mock-arm`.
#[derive(Debug, Args)]
#[command(after_long_help = LINES, group = ArgGroup::new("face").args(["tcp", "bus"]))]
pub struct MockArmArgs {
    /// TCP address for a host, instead of a new pseudo-terminal; port 0 selects a free one. Needs --key.
    #[arg(long, value_name = "ADDRESS:PORT", requires = "key")]
    pub tcp: Option<SocketAddr>,
    /// Key file that the host uses as well; `pb3dp gateway key FILE` makes one.
    #[arg(long, value_name = "FILE", requires = "tcp")]
    pub key: Option<std::path::PathBuf>,
    /// Emulate the controller alone, without a gateway: ARCNET frames on a socket at this path.
    #[arg(long, value_name = "PATH")]
    pub bus: Option<std::path::PathBuf>,
    /// Wire format of the controller: a (little-endian, 5 and 8 bytes per axis) or b (big-endian, 6 and 10).
    #[arg(long, value_enum, default_value = "b")]
    pub format: FormatName,
    /// Arm geometry that the gateway reports.
    #[arg(long, value_enum, default_value = "second")]
    pub geometry: GeometryName,
    /// Number of the arm in every gateway frame.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub arm: u8,
    /// Time-out of the controller, for instance 6ms, 10ms or 400ms; none: continue with the last speeds.
    #[arg(long, value_name = "TIME", default_value = "6ms", value_parser = parse_watchdog)]
    pub watchdog: Watchdog,
    /// Start pose of the joints, degrees, from the base.
    #[arg(long, value_name = "Q1,..,Q7", default_value = "0,30,0,60,0,45,0", value_parser = parse_pose, allow_hyphen_values = true)]
    pub pose_deg: [f64; DOF],
    /// Symmetric joint limits in the EEPROM, degrees, from the base; those of a PA10-7C unless given.
    #[arg(long, value_name = "L1,..,L7", value_parser = parse_pose, allow_hyphen_values = true)]
    pub limits_deg: Option<[f64; DOF]>,
    /// File of `pb3dp gateway` whose motion limits the emulated gateway uses; those of the built-in setups unless given.
    #[arg(long, value_name = "FILE")]
    pub gateway_limits: Option<std::path::PathBuf>,
    /// The emulated gateway does not know the bits of the status words, as a gateway before `pb3dp arm signals`: it opens no brake.
    #[arg(long)]
    pub unknown_signals: bool,
    /// A script of faults.
    #[arg(long, value_name = "FILE")]
    pub script: Option<std::path::PathBuf>,
    /// One line of a script; may be given more than once.
    #[arg(long, value_name = "LINE", value_parser = parse_fault)]
    pub fault: Vec<ScriptLine>,
    /// Seed of all random numbers.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Thread priority (SCHED_FIFO, 1 to 99), if available; without it other processes can delay the replies.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=99))]
    pub priority: Option<u8>,
    /// Exit after this many seconds; without it on `quit` or a signal.
    #[arg(long, value_name = "SECONDS", value_parser = pb3dp_cell::terminal::parse_seconds, allow_hyphen_values = true)]
    pub stop_after: Option<f64>,
}

/// Time-out of the controller, if it has one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Watchdog(pub Option<Duration>);

/// Runs the emulated arm until `quit`, a signal or the end of its time.
///
/// # Errors
/// An unusable input, or an unavailable address.
pub fn run(args: &MockArmArgs) -> anyhow::Result<ExitCode> {
    let server = start(args)?;
    let address = server.address();
    say(&address)?;
    tracing::info!("emulated arm at {address}; type `state`, a fault or `quit`");
    serve(&server, &typed_lines()?, args.stop_after.map(Duration::from_secs_f64))?;
    Ok(ExitCode::SUCCESS)
}

fn start(args: &MockArmArgs) -> anyhow::Result<MockServer> {
    let mut script = Script::default();
    if let Some(path) = &args.script {
        let text = read_text(path).with_context(|| format!("script {} cannot be read", path.display()))?;
        script = Script::parse(&text).with_context(|| format!("script {}", path.display()))?;
    }
    script.lines.extend(&args.fault);
    let format = args.format.into();
    let mut controller = MockControllerConfig { watchdog: args.watchdog.0, ..MockControllerConfig::new(format) };
    if let Some(limits) = args.limits_deg {
        controller.upper_limit_rad = JointVector::from(limits.map(f64::to_radians));
        controller.lower_limit_rad = -controller.upper_limit_rad;
    }
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let pose = JointVector::from(args.pose_deg.map(f64::to_radians));
    let joints = JointPlant::new(pa10_joints()?, pose, clock.now()).context("--pose-deg")?;
    let joints = Arc::new(Mutex::new(joints));
    let face = face(args, &controller)?;
    let realtime = Realtime { priority: args.priority, locks_memory: false, cpu: None };
    let config = MockServerConfig { controller, seed: args.seed, script, realtime };
    Ok(MockServer::start(config, face, joints, clock)?)
}

fn face(args: &MockArmArgs, controller: &MockControllerConfig) -> anyhow::Result<MockFace> {
    let firmware = Firmware::new(&format!("{MOCK_ARM} {}", env!("CARGO_PKG_VERSION"))).context("the firmware name")?;
    let limits = match &args.gateway_limits {
        Some(file) => read_gateway(file, None, None)?.gateway.limits,
        None => controller.motion_limits().context("--limits-deg")?,
    };
    let gateway = GatewayConfig {
        geometry: args.geometry.into(),
        controller_watchdog: controller.watchdog,
        signals: if args.unknown_signals { StatusSignals::UNKNOWN } else { StatusSignals::ORCA },
        ..GatewayConfig::new(ArmId(args.arm), controller.format, firmware, limits)
    };
    Ok(match (&args.bus, args.tcp, &args.key) {
        (Some(path), ..) => MockFace::BusSocket(path.clone()),
        (None, Some(address), Some(key)) => {
            let access = Access::from_this_computer(read_shared_key(key).context("--key")?);
            MockFace::Tcp(gateway, address, access)
        }
        (None, ..) => MockFace::Pty(gateway),
    })
}

/// Serves until `quit` or the end of its time; the end of standard input does not end it.
fn serve(
    server: &MockServer,
    lines: &Receiver<std::io::Result<String>>,
    stop_after: Option<Duration>,
) -> anyhow::Result<()> {
    let (begin, mut address) = (Instant::now(), server.address());
    loop {
        let is_over = stop_after.is_some_and(|time| begin.elapsed() >= time);
        if is_over {
            return Ok(());
        }
        match lines.recv_timeout(LOOK) {
            Ok(Ok(line)) if line.trim() == "quit" => return Ok(()),
            Ok(Ok(line)) => obey(server, line.trim())?,
            Ok(Err(_)) | Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => std::thread::sleep(LOOK),
        }
        if server.address() != address {
            address = server.address();
            say(&address)?;
        }
    }
}

fn obey(server: &MockServer, line: &str) -> anyhow::Result<()> {
    match line {
        "state" => say(&server.report().to_string())?,
        "unplug" => server.unplug(),
        "plug" => server.plug(),
        line => {
            if let Err(error) = server.command_line(line) {
                tracing::error!("{line:?}: {error}; or type state, unplug, plug or quit");
            }
        }
    }
    Ok(())
}

fn say(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{text}").and_then(|()| out.flush()).context("standard output is closed")
}

fn parse_watchdog(text: &str) -> Result<Watchdog, String> {
    if text == "none" {
        return Ok(Watchdog(None));
    }
    let time = pb3dp_arm_pa10_emulation::mock_controller::parse_time(text).filter(|time| !time.is_zero());
    time.map(|time| Watchdog(Some(time))).ok_or_else(|| format!("{text:?} is neither a time such as 6ms nor none"))
}

fn parse_pose(text: &str) -> Result<[f64; DOF], String> {
    let angles: Option<Vec<f64>> = text.split(',').map(|angle| angle.trim().parse().ok()).collect();
    let angles = angles.and_then(|angles| <[f64; DOF]>::try_from(angles).ok());
    let finite = angles.filter(|angles| angles.iter().all(|angle| angle.is_finite()));
    finite.ok_or_else(|| format!("{text:?} is not seven angles in degrees, for instance 0,30,0,60,0,45,0"))
}

fn parse_fault(text: &str) -> Result<ScriptLine, String> {
    let line = ScriptLine::parse(text).map_err(|error| error.to_string())?;
    line.ok_or_else(|| "the line is empty; write a fault such as `at 2s e-stop press`".to_owned())
}
