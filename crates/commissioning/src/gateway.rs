//! `pb3dp gateway`: owns the bus of one PA-10, keeps its control cycle, and serves one host.

pub mod file;

use std::os::fd::AsFd;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use pb3dp_arm_pa10::arm::read_shared_key;
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_gateway::gateway::GatewayStatus;
use pb3dp_arm_pa10_gateway::service::{
    Access, BusOpener, Ending, GatewayServer, GatewayServerConfig, Happened, HostSide,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{GatewayState, StopCause};
use pb3dp_arm_pa10_protocol::places::BusTarget;
use pb3dp_cell::terminal::{has_term, typed_lines};
use pb3dp_hal_platform::key_file::write_new_key;
use pb3dp_hal_platform::signals::{StopSignal, StopSignals};
use pb3dp_hal_platform::transport::Symptom;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;

use self::file::{AccessPlace, GatewaySetup, HostPlace, read_gateway};

/// Arguments of `pb3dp gateway`.
#[derive(Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct GatewayArgs {
    /// Another task than to run the gateway.
    #[command(subcommand)]
    pub task: Option<GatewayTask>,
    /// Configuration of arm, bus and host: one complete TOML file, for instance configs/gateway.toml.
    #[arg(long, value_name = "FILE", required = true)]
    pub config: Option<PathBuf>,
    /// Bus to use instead of the configured one: arcnet:INTERFACE or socket:PATH.
    #[arg(long, value_name = "BUS")]
    pub bus: Option<String>,
    /// Host line to use instead of the configured one: serial:DEVICE, local:PATH or tcp:ADDRESS:PORT.
    #[arg(long, value_name = "LINE")]
    pub host: Option<String>,
    /// Start with the switch on local: no host moves the arm until `remote` is typed here.
    #[arg(long)]
    pub local: bool,
}

/// Tasks besides running the gateway.
#[derive(Debug, Subcommand)]
pub enum GatewayTask {
    /// Make the key that a gateway on TCP shares with its hosts.
    Key {
        /// New file, readable by its owner only; an existing one is not changed.
        file: PathBuf,
    },
}

/// Interval at which the log is written.
const LOOK: Duration = Duration::from_millis(50);

/// Shortest interval between reports of late cycles.
const OVERRUNS_EVERY: Duration = Duration::from_secs(1);

/// Cycle of the slowest host: a serial line must carry at least this rate.
const HOST_CYCLE_MAX: Duration = Duration::from_millis(10);

/// Runs the gateway until a signal ends it with the stop order.
///
/// # Errors
/// A refused configuration, an unavailable bus or port, or a failed thread.
pub fn run(args: &GatewayArgs) -> Result<ExitCode> {
    let config = match (&args.task, &args.config) {
        (Some(GatewayTask::Key { file }), _) => {
            write_new_key(file)?;
            tracing::info!(
                "new key in {}: for an arm, copy it to the computers of the hosts, as their `key_file`; for a panel, name it in --panel-token",
                file.display()
            );
            return Ok(ExitCode::SUCCESS);
        }
        (None, Some(config)) => config,
        (None, None) => bail!("--config is missing"),
    };
    let setup = read_gateway(config, args.bus.as_deref(), args.host.as_deref())?;
    // Before any thread starts: a signal would otherwise end the program without a stop order.
    let signals = StopSignals::take_over().context("cannot take over the signals that end the program")?;
    let host = host_side(&setup)?;
    let config = GatewayServerConfig { gateway: setup.gateway, realtime: setup.realtime };
    let arm = config.gateway.arm.0;
    let server = GatewayServer::start(config, bus_opener(&setup.bus), host)?;
    // A log that is not read blocks this thread; it must not block the stop.
    let ending = server.ending();
    let watcher =
        std::thread::Builder::new().name("gateway-signals".into()).spawn(move || watch_signals(signals, &ending))?;
    // The stop order of the start still runs: no host can have moved the arm.
    server.switch(args.local);
    tell_start(&setup, &server);
    if let Some(signal) = setup.gateway.signals.unknown().next() {
        tracing::warn!("arm.signals.{} is unknown: no brake opens; `pb3dp arm signals` finds its bits", signal.key());
    }
    let (mut log, typed) = (Log::default(), typed_lines()?);
    while server.is_running() {
        log.write(&server);
        for line in typed.try_iter() {
            match line {
                Ok(line) => obey(&server, &line),
                Err(error) => tracing::warn!(
                    "the terminal cannot be read ({error}): `local` and `remote` are not obeyed; a gateway in the background reads no \
                     terminal"
                ),
            }
        }
        std::thread::sleep(LOOK);
    }
    log.write(&server);
    server.ask_to_end();
    match watcher.join() {
        Ok(Ok(Some(signal))) => tracing::info!("{signal}: ended with the stop order"),
        Ok(Ok(None)) | Err(_) => {}
        Ok(Err(error)) => return Err(error).context("cannot read the signals that end the program"),
    }
    log.tell_overruns();
    let dropped = server.events_dropped();
    let Some(status) = server.end() else {
        tracing::error!(
            "the cycle thread panicked (a bug, please report it) and tried to send the stop order: check that the arm has stopped"
        );
        return Ok(ExitCode::FAILURE);
    };
    tell_end(arm, &status, dropped);
    Ok(ExitCode::SUCCESS)
}

/// Executes a typed line.
fn obey(server: &GatewayServer, line: &str) {
    let word = |is_local| if is_local { "local" } else { "remote" };
    match switch_of(line) {
        Some(is_local) => {
            server.switch(is_local);
            tracing::warn!("switch on {}", word(is_local));
        }
        None if line.trim().is_empty() => {}
        None => tracing::warn!(
            "{:?} is no command: type `local` (no host moves the arm) or `remote`; the switch stands on {}",
            line.trim(),
            word(server.is_local())
        ),
    }
}

/// Position of the switch in a typed line, true for local. `local` in any case, with other words and keys around, because it stops the
/// arm; `remote` only alone, because it lets a host move the arm.
fn switch_of(line: &str) -> Option<bool> {
    if has_term(line, "local") {
        return Some(true);
    }
    line.trim().eq_ignore_ascii_case("remote").then_some(false)
}

/// Waits for a signal or the end of the gateway, then ends the gateway. It writes no log, because that may block.
fn watch_signals(mut signals: StopSignals, ending: &Ending) -> std::io::Result<Option<StopSignal>> {
    let look = Timespec { tv_sec: 0, tv_nsec: i64::from(LOOK.subsec_nanos()) };
    let mut taken = Ok(None);
    while !ending.is_asked() && matches!(taken, Ok(None)) {
        let mut fds = [PollFd::from_borrowed_fd(signals.as_fd(), PollFlags::IN)];
        // A failed poll only shortens the wait.
        let _ = poll(&mut fds, Some(&look));
        taken = signals.try_take();
    }
    ending.ask();
    taken
}

fn bus_opener(target: &BusTarget) -> BusOpener {
    let target = target.clone();
    Box::new(move || pb3dp_arm_pa10_gateway::bus::open(&target))
}

fn host_side(setup: &GatewaySetup) -> Result<HostSide> {
    Ok(match &setup.host {
        HostPlace::Tcp(config) => HostSide::listen(config.address, setup.gateway.arm, read_access(&setup.access)?)?,
        HostPlace::Local(socket) => HostSide::listen_at_socket(&socket.path, setup.gateway.arm)?,
        HostPlace::Serial(path) => {
            HostSide::Line(Box::new(SerialConfig { path: path.clone(), baud: setup.baud, cycle: HOST_CYCLE_MAX }))
        }
    })
}

/// Reads the key of a gateway on TCP.
///
/// # Errors
/// If the file cannot be read, others can read it, or it holds no key.
pub fn read_access(place: &AccessPlace) -> Result<Access> {
    let key = read_shared_key(&place.key_file).context(
        "access.key_file: a gateway on TCP needs a key, because every program on the network could drive the arm without one; \
         `pb3dp gateway key FILE` makes it",
    )?;
    Ok(Access { key, peers: place.peers.clone() })
}

fn tell_start(setup: &GatewaySetup, server: &GatewayServer) {
    let gateway = &setup.gateway;
    let host = match &setup.host {
        HostPlace::Serial(path) => format!("serial port {path}"),
        HostPlace::Tcp(config) => format!("tcp {}", config.address),
        HostPlace::Local(socket) => format!("socket {}", socket.path.display()),
    };
    tracing::info!(
        "gateway of arm {}: {}, {}, a cycle of {:?}, host line {host}",
        gateway.arm.0,
        server.name_of_bus(),
        gateway.format,
        gateway.cycle
    );
    for shortfall in server.shortfalls() {
        tracing::warn!("{shortfall}");
    }
    if setup.realtime.priority.is_none() {
        tracing::warn!("the cycle has no real-time priority (realtime.priority = 0): do not drive an arm");
    }
    if gateway.lateness_allowed > gateway.cycle {
        tracing::warn!(
            "a cycle may begin up to {:?} late (bus.lateness_allowed_millis): do not drive an arm",
            gateway.lateness_allowed
        );
    }
}

fn tell_end(arm: u8, status: &GatewayStatus, dropped: u64) {
    let GatewayStatus { cycle, bus, bytes, .. } = status;
    let damaged = bytes.crc_errors + bytes.header_errors + bytes.truncated + bytes.other_version;
    tracing::info!(
        "ended {}: {} cycles, {} late, the longest cycle {:?}; {} messages on the bus, {} not answered in time; {damaged} damaged frames \
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
    if status.stop_unacknowledged {
        tracing::error!(
            "EMERGENCY STOP: press it at arm {arm}. The controller has not answered the stop order, and the gateway ends without \
             repeating it"
        );
    }
    if status.state != GatewayState::Idle {
        tracing::warn!(
            "the gateway was stopped by {}; a new gateway does not keep this state: check the arm first",
            status.found.map_or_else(|| status.cause.to_string(), |found| found.to_string())
        );
    }
    if dropped > 0 {
        tracing::warn!("{dropped} log events were dropped because the log was not written fast enough");
    }
}

/// Events that are not logged yet.
#[derive(Debug, Default)]
struct Log {
    late: u64,
    worst: Duration,
    reported_at: Option<Instant>,
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
        if self.reported_at.is_none_or(|reported_at| reported_at.elapsed() >= OVERRUNS_EVERY) {
            self.tell_overruns();
        }
    }

    fn tell_overruns(&mut self) {
        if self.late > 0 {
            tracing::warn!("{}", overruns(self.late, self.worst));
            *self = Self { reported_at: Some(Instant::now()), ..Self::default() };
        }
    }
}

/// Whether a change of state is not logged: a probe alone makes dozens of them.
fn is_routine(from: GatewayState, to: GatewayState) -> bool {
    use GatewayState::{Idle, Started};
    matches!((from, to), (Idle, Started) | (Started, Idle))
}

/// Whether the other side closed the connection, as each program does at its end.
fn is_normal_end(symptom: Symptom) -> bool {
    matches!(symptom, Symptom::EndOfStream | Symptom::Os(Errno::CONNRESET))
}

/// The message about late cycles.
fn overruns(late: u64, worst: Duration) -> String {
    let began = if late == 1 { "1 cycle began".to_owned() } else { format!("{late} cycles began") };
    format!("{began} late by more than a tenth of a cycle, at most {worst:?}")
}

fn tell(what: &Happened) {
    match what {
        Happened::State { from, to, found: Some(found), .. } => tracing::error!("{from} -> {to}: {found}"),
        Happened::State { from, to, cause: StopCause::None, .. } if is_routine(*from, *to) => {
            tracing::debug!("{from} -> {to}");
        }
        Happened::State { from, to, cause: StopCause::None, .. } => tracing::info!("{from} -> {to}"),
        Happened::State { from, to, cause, .. } => tracing::error!("{from} -> {to}: {cause}"),
        Happened::StopUnacknowledged => tracing::error!(
            "the controller does not answer the stop order, which is being repeated: if the arm moves, press its emergency stop"
        ),
        Happened::StopAcknowledged => tracing::info!("the controller answers and executes the stop order"),
        Happened::HostConnected => tracing::info!("host line connected"),
        Happened::HostGreeted => tracing::info!("host sent HELLO"),
        Happened::HostGone(symptom) if is_normal_end(*symptom) => tracing::info!("the host has closed its line"),
        Happened::HostGone(symptom) => tracing::warn!("host line lost ({symptom})"),
        Happened::HostReplaced => tracing::warn!("a silent connection was replaced by a new one"),
        Happened::BusDown(symptom) => tracing::error!(
            "the bus is down ({symptom}); reconnecting; check cable and power of the controller, and that no other gateway uses this bus"
        ),
        Happened::BusUp => tracing::info!("the bus is up again"),
        // Logged together.
        Happened::Overrun { .. } => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_probe_makes_no_news() {
        use GatewayState::{Fault, Holding, Idle, Started, Stopping};
        assert!(is_routine(Idle, Started) && is_routine(Started, Idle));
        for (from, to) in [(Started, Holding), (Stopping, Idle), (Started, Fault), (Fault, Idle)] {
            assert!(!is_routine(from, to), "{from} -> {to}");
        }
    }

    #[test]
    fn local_is_found_in_any_line_and_remote_must_stand_alone() {
        for line in ["local", "Local", "LOCAL!", "  local", "\x1b[Alocal", "please: local", "local, not remote"] {
            assert_eq!(switch_of(line), Some(true), "{line:?}");
        }
        assert_eq!(["remote", " Remote\t", "REMOTE"].map(switch_of), [Some(false); 3]);
        for line in ["remote!", "remote now", "\x1b[Aremote", "localhost", "remotely", ""] {
            assert_eq!(switch_of(line), None, "{line:?}");
        }
    }

    #[test]
    fn a_host_that_closes_its_line_is_no_warning() {
        assert!([Symptom::EndOfStream, Symptom::Os(Errno::CONNRESET)].into_iter().all(is_normal_end));
        assert!(![Symptom::Os(Errno::IO), Symptom::NotAuthentic, Symptom::Flood].into_iter().any(is_normal_end));
    }

    #[test]
    fn one_late_cycle_is_no_plural() {
        let text = |late| overruns(late, Duration::from_micros(300));
        assert_eq!(text(1), "1 cycle began late by more than a tenth of a cycle, at most 300µs");
        assert!(text(2).starts_with("2 cycles began late"));
    }
}
