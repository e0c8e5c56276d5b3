//! `pb3dp gateway`: owns the bus of one PA-10 and its cycle, and serves a host.

pub mod file;

use std::os::fd::AsFd;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use clap::Args;
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_gateway::gateway::GatewayStatus;
use pb3dp_arm_pa10_gateway::service::{BusOpener, Ending, GatewayServer, GatewayServerConfig, Happened, HostSide};
use pb3dp_arm_pa10_protocol::gateway_protocol::{Dialect, GatewayState, StopCause};
use pb3dp_arm_pa10_protocol::places::BusTarget;
use pb3dp_hal_platform::signals::{StopSignal, StopSignals};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use self::file::{GatewaySetup, HostPlace, read_gateway};

/// Arguments of `pb3dp gateway`.
#[derive(Debug, Args)]
pub struct GatewayArgs {
    /// The arm, its bus and its host: one complete TOML file, for instance configs/gateway.toml.
    #[arg(long, value_name = "FILE")]
    pub config: PathBuf,
    /// Another bus than the configuration's: arcnet:INTERFACE or socket:PATH.
    #[arg(long, value_name = "BUS")]
    pub bus: Option<String>,
    /// Another line to the host than the configuration's: serial:DEVICE or tcp:ADDRESS:PORT.
    #[arg(long, value_name = "LINE")]
    pub host: Option<String>,
}

/// How often the log is written.
const LOOK: Duration = Duration::from_millis(50);

/// How often late cycles are told of at most.
const OVERRUNS_EVERY: Duration = Duration::from_secs(1);

/// The slowest host: what a serial line must carry at least.
const HOST_CYCLE_MAX: Duration = Duration::from_millis(10);

/// Runs the command until a signal ends it: then through the stop order.
///
/// # Errors
/// A configuration that is refused, a bus or port that cannot be had, or a thread that died.
pub fn run(args: &GatewayArgs) -> Result<ExitCode> {
    let setup = read_gateway(&args.config, args.bus.as_deref(), args.host.as_deref())?;
    // Before any thread is started, which would end the program without a stop order.
    let signals = StopSignals::take_over().context("the signals that end the program cannot be taken over")?;
    let host = host_side(&setup)?;
    let config = GatewayServerConfig { gateway: setup.gateway, realtime: setup.realtime };
    let arm = config.gateway.arm.0;
    let server = GatewayServer::start(config, bus_opener(&setup.bus), host)?;
    // A log that nobody reads holds up this thread, and must not hold up the stop.
    let ending = server.ending();
    let watcher =
        std::thread::Builder::new().name("gateway-signals".into()).spawn(move || watch_signals(signals, &ending))?;
    tell_start(&setup, &server);
    let mut log = Log::default();
    while server.is_running() {
        log.write(&server);
        std::thread::sleep(LOOK);
    }
    log.write(&server);
    server.ask_to_end();
    match watcher.join() {
        Ok(Ok(Some(signal))) => tracing::info!("{signal} has ended it, through the stop order"),
        Ok(Ok(None)) | Err(_) => {}
        Ok(Err(error)) => return Err(error).context("the signals that end the program cannot be read"),
    }
    log.tell_overruns();
    let dropped = server.events_dropped();
    let Some(status) = server.end() else {
        tracing::error!(
            "the thread of the cycle failed, a mistake of the program; it has sent the stop order as far as it could: look at the arm"
        );
        return Ok(ExitCode::FAILURE);
    };
    tell_end(arm, &status, dropped);
    Ok(ExitCode::SUCCESS)
}

/// Until a signal has come or the gateway was asked to end: then it ends. It writes nothing, as that may wait.
fn watch_signals(mut signals: StopSignals, ending: &Ending) -> std::io::Result<Option<StopSignal>> {
    let look = Timespec { tv_sec: 0, tv_nsec: i64::from(LOOK.subsec_nanos()) };
    let mut taken = Ok(None);
    while !ending.is_asked() && matches!(taken, Ok(None)) {
        let mut fds = [PollFd::from_borrowed_fd(signals.as_fd(), PollFlags::IN)];
        // A wait that fails is a short one.
        let _ = poll(&mut fds, Some(&look));
        taken = signals.try_take();
    }
    ending.ask();
    taken
}

fn bus_opener(target: &BusTarget) -> BusOpener {
    let target = target.clone();
    Box::new(move || pb3dp_arm_pa10::bus::open(&target))
}

fn host_side(setup: &GatewaySetup) -> Result<HostSide> {
    Ok(match &setup.host {
        HostPlace::Tcp(config) => HostSide::listen(config.address)?,
        HostPlace::Serial(path) => HostSide::Line(Box::new(SerialConfig {
            path: path.clone(),
            baud: setup.baud,
            // The longer one: hosts choose.
            dialect: Dialect::GatewayV1,
            format: setup.gateway.format,
            cycle: HOST_CYCLE_MAX,
        })),
    })
}

fn tell_start(setup: &GatewaySetup, server: &GatewayServer) {
    let gateway = &setup.gateway;
    let host = match &setup.host {
        HostPlace::Serial(path) => format!("serial port {path}"),
        HostPlace::Tcp(config) => format!("tcp {}", config.address),
    };
    tracing::info!(
        "gateway of arm {}: {}, {}, a cycle of {:?}, hosts come from {host}",
        gateway.arm.0,
        server.name_of_bus(),
        gateway.format,
        gateway.cycle
    );
    for shortfall in server.shortfalls() {
        tracing::warn!("{shortfall}");
    }
    if setup.realtime.priority.is_none() {
        tracing::warn!("the cycle runs among all other programs (realtime.priority = 0): not fit to drive an arm");
    }
    if gateway.lateness_allowed > gateway.cycle {
        tracing::warn!(
            "a cycle may begin {:?} late before the arm is stopped (bus.lateness_allowed_millis): not fit to drive an arm",
            gateway.lateness_allowed
        );
    }
}

fn tell_end(arm: u8, status: &GatewayStatus, dropped: u64) {
    let GatewayStatus { cycle, bus, bytes, .. } = status;
    let damaged = bytes.crc_errors + bytes.header_errors + bytes.truncated + bytes.other_version;
    tracing::info!(
        "ended {}: {} cycles, {} late, the longest {:?}; {} messages on the bus, {} not answered in time; {damaged} damaged frames \
         of hosts, {} missing, {} stale",
        status.state,
        cycle.cycles,
        cycle.overruns,
        cycle.worst,
        bus.exchanges,
        bus.lost,
        status.host_lost,
        status.host_stale
    );
    if status.is_unheard {
        tracing::error!(
            "EMERGENCY STOP: press it at arm {arm}. The gateway ends, the controller has not answered the stop order, and nobody \
             tells it to stop any more"
        );
    }
    if status.state != GatewayState::Idle {
        tracing::warn!(
            "the gateway was stopped by {}; a new one knows nothing of that: look at the arm first",
            status.found.map_or_else(|| status.cause.to_string(), |found| found.to_string())
        );
    }
    if dropped > 0 {
        tracing::warn!("{dropped} events are missing in this log: it could not be written quickly enough");
    }
}

/// What was not yet told.
#[derive(Debug, Default)]
struct Log {
    late: u64,
    worst: Duration,
    told: Option<Instant>,
}

impl Log {
    fn write(&mut self, server: &GatewayServer) {
        while let Some(text) = server.try_message() {
            tracing::info!("{text}");
        }
        while let Some(event) = server.try_event() {
            if let Happened::Overrun { late } = event.what {
                self.late += 1;
                self.worst = self.worst.max(late);
            } else {
                tell(&event.what);
            }
        }
        if self.told.is_none_or(|told| told.elapsed() >= OVERRUNS_EVERY) {
            self.tell_overruns();
        }
    }

    fn tell_overruns(&mut self) {
        if self.late > 0 {
            tracing::warn!("{} cycles began late by more than a tenth, the worst by {:?}", self.late, self.worst);
            *self = Self { told: Some(Instant::now()), ..Self::default() };
        }
    }
}

fn tell(what: &Happened) {
    match what {
        Happened::State { from, to, found: Some(found), .. } => tracing::error!("{from} -> {to}: {found}"),
        Happened::State { from, to, cause: StopCause::None, .. } => tracing::info!("{from} -> {to}"),
        Happened::State { from, to, cause, .. } => tracing::error!("{from} -> {to}: {cause}"),
        Happened::Unheard => tracing::error!(
            "the controller does not answer the stop order, and is told to stop again and again: an arm that moves has to be stopped \
             with its emergency stop"
        ),
        Happened::Heard => tracing::info!("the controller answers: it goes through the stop order"),
        Happened::HostConnected => tracing::info!("the line to the host is there"),
        Happened::HostGreeted(dialect) => tracing::info!("a host said HELLO and speaks {dialect}"),
        Happened::HostGone(symptom) => tracing::warn!("the line to the host is gone ({symptom})"),
        Happened::HostReplaced => tracing::warn!("a connection that had been silent gave way to another one"),
        Happened::BusDown(symptom) => tracing::error!("the bus is down ({symptom}); it is tried again and again"),
        Happened::BusUp => tracing::info!("the bus is there again"),
        // Told together.
        Happened::Overrun { .. } => {}
    }
}
