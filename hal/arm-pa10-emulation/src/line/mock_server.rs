//! An emulated arm in real time: on a pseudo-terminal or a TCP port behind a gateway, or as frames on a socket in place of a bus.
//!
//! [`MockServer`] runs [`MockController`] and, if the host needs one, [`Gateway`] in a separate thread. Both are executed at their
//! requested times, or as soon as the thread runs: on a busy computer the arm answers late, without a fault of the arm. The
//! lateness of the thread is counted ([`MockReport`]).

pub use std::net::SocketAddr;
use std::net::TcpListener;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_gateway::bus::{BusPort, FRAME_ROOM, FrameListener, FrameSocketError};
use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig, GatewayConfigError};
use pb3dp_arm_pa10_gateway::service::{Access, Admission, Admitted};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_hal_platform::jitter::JitterMeter;
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::realtime::{self, Realtime, Shortfall, enter};
use pb3dp_hal_platform::transport::{ByteLink, ConnectError, Connector, wait};
use pb3dp_sim::joint_dynamics::JointPlant;

use crate::far_end::FarEnd;
use crate::mock_controller::{LineError, MockController, MockControllerConfig, MockControllerError, Script};

mod report;
pub use report::MockReport;

/// Longest time between two checks for the end and for new connections.
const WAIT_MAX: Duration = Duration::from_millis(5);

/// A wake-up later than this counts as late.
const LATE: Duration = Duration::from_millis(1);

/// Capacity for unread answers, bytes; later answers are dropped.
const UNREAD_MAX: usize = 4096;

/// Where hosts connect.
pub enum MockFace {
    /// Behind a gateway on a new pseudo-terminal.
    Pty(GatewayConfig),
    /// Behind a gateway on a TCP port of this address, for hosts with its key; port 0 takes a free one.
    Tcp(GatewayConfig, SocketAddr, Access),
    /// Behind a gateway on an existing link.
    Link(GatewayConfig, Box<dyn ByteLink>),
    /// The controller alone, as frames on a socket at this path.
    BusSocket(PathBuf),
    /// The controller alone, on an existing bus.
    Bus(Box<dyn BusPort>),
}

/// Settings of an emulated arm.
#[derive(Clone, Debug)]
pub struct MockServerConfig {
    /// The controller.
    pub controller: MockControllerConfig,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Spontaneous faults.
    pub script: Script,
    /// Requested real-time scheduling of the thread. Without it other programs make the arm answer late.
    pub realtime: Realtime,
}

/// Why an emulated arm cannot be started.
#[derive(Debug, thiserror::Error)]
pub enum MockServerError {
    /// The controller.
    #[error("cannot create the emulated controller")]
    Controller(#[from] MockControllerError),
    /// The gateway.
    #[error("cannot create the gateway of the emulated controller")]
    Gateway(#[from] GatewayConfigError),
    /// No pseudo-terminal.
    #[error(
        "no pseudo-terminal is available; check that /dev/pts is mounted, and the limit in /proc/sys/kernel/pty/max"
    )]
    Pty(#[source] std::io::Error),
    /// The TCP port cannot be opened.
    #[error(
        "cannot listen at {address}; check that no other program uses the port, and that this machine has the address"
    )]
    Tcp {
        /// Address.
        address: SocketAddr,
        /// Error of the system.
        #[source]
        source: std::io::Error,
    },
    /// The socket in the place of a bus.
    #[error(transparent)]
    Socket(#[from] FrameSocketError),
    /// No thread.
    #[error("cannot start the thread of the emulated arm")]
    Thread(#[source] std::io::Error),
}

/// An emulated arm in real time. Dropping it ends the emulation.
#[derive(Debug)]
pub struct MockServer {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    core: Mutex<Core>,
    address: Mutex<String>,
    lateness: JitterMeter,
    is_running: AtomicBool,
    is_plugged: AtomicBool,
}

/// The arm with its gateway, and the time that they have reached.
#[derive(Debug)]
struct Core {
    far: FarEnd,
    clock: SharedClock,
    unread: u64,
    shortfalls: Vec<Shortfall>,
}

#[derive(Clone)]
struct SharedClock(Arc<dyn Clock>);

impl std::fmt::Debug for SharedClock {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("clock")
    }
}

impl MockServer {
    /// Starts an emulated arm with these joints, which may be shared; `clock` is that of the joints.
    ///
    /// # Errors
    /// If a configuration is invalid, or the address is not available.
    pub fn start(
        config: MockServerConfig,
        face: MockFace,
        joints: Arc<Mutex<JointPlant>>,
        clock: Arc<dyn Clock>,
    ) -> Result<Self, MockServerError> {
        let now = clock.now();
        let mut controller = MockController::new(config.controller, joints, config.seed, now)?;
        controller.play(now, &config.script);
        let gateway = face.gateway().map(|config| Gateway::new(*config, now)).transpose()?;
        let line = Line::open(face)?;
        let clock = SharedClock(clock);
        let core = Core { far: FarEnd::new(controller, gateway, now), clock, unread: 0, shortfalls: Vec::new() };
        let shared = Arc::new(Shared {
            core: Mutex::new(core),
            address: Mutex::new(line.address()),
            lateness: JitterMeter::default(),
            is_running: AtomicBool::new(true),
            is_plugged: AtomicBool::new(true),
        });
        let worker = Worker { shared: Arc::clone(&shared), line, output: Vec::new() };
        let realtime = config.realtime;
        let thread = std::thread::Builder::new().name("mock-arm".to_owned()).spawn(move || worker.run(&realtime));
        Ok(Self { shared, thread: Some(thread.map_err(MockServerError::Thread)?) })
    }

    /// Address for hosts: the path of a terminal or socket, or address and port. It changes with [`Self::plug`].
    pub fn address(&self) -> String {
        lock(&self.shared.address).clone()
    }

    /// Opens the terminal of this arm, also after [`Self::plug`]; the path of `config` is ignored.
    pub fn port(&self, config: SerialConfig) -> MockPort {
        MockPort { shared: Arc::clone(&self.shared), config: SerialConfig { path: self.address(), ..config } }
    }

    /// Starts or ends a fault, by a line as in a script.
    ///
    /// # Errors
    /// Names the wrong word and the allowed ones; nothing happens then.
    pub fn command_line(&self, line: &str) -> Result<(), LineError> {
        let mut core = lock(&self.shared.core);
        // Not before the gateway has reached this time: the controller would miss pending messages.
        let now = core.far.now();
        core.far.controller.command_line(now, line)
    }

    /// Unplugs the cable: a terminal vanishes, a connection ends, and nobody can connect.
    pub fn unplug(&self) {
        self.shared.is_plugged.store(false, Ordering::SeqCst);
    }

    /// Plugs the cable in again. A terminal is a new one, with another [`Self::address`], within some milliseconds.
    pub fn plug(&self) {
        self.shared.is_plugged.store(true, Ordering::SeqCst);
    }

    /// Number of wake-ups later than this (accurate to an eighth): the answers are late then, without a fault of the arm.
    pub fn wakes_later_than(&self, limit: Duration) -> u64 {
        self.shared.lateness.later_than(limit)
    }

    /// State of the arm.
    pub fn report(&self) -> MockReport {
        let core = lock(&self.shared.core);
        let (position_rad, velocity_rad_per_s) = core.far.controller.true_joints();
        MockReport {
            mode: core.far.controller.mode(),
            is_powered: core.far.controller.is_powered(),
            is_braked: core.far.controller.is_braked(),
            axes: core.far.controller.axis_modes(),
            position_rad,
            velocity_rad_per_s,
            counters: core.far.controller.counters().clone(),
            gateway: core.far.gateway.as_ref().map(Gateway::status),
            late: self.wakes_later_than(LATE),
            latest: self.shared.lateness.summary().max,
            unread: core.unread,
            shortfalls: core.shortfalls.clone(),
        }
    }
}

/// Opens the terminal of an emulated arm, as a persistent name opens a real adapter.
#[derive(Debug)]
pub struct MockPort {
    shared: Arc<Shared>,
    config: SerialConfig,
}

impl Connector for MockPort {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        self.config.path.clone_from(&lock(&self.shared.address));
        self.config.connect()
    }

    fn target(&self) -> String {
        format!("emulated {}", self.config.target())
    }
}

impl Drop for MockServer {
    fn drop(&mut self) {
        self.shared.is_running.store(false, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            // The thread checks every few milliseconds.
            thread.join().ok();
        }
    }
}

impl MockFace {
    fn gateway(&self) -> Option<&GatewayConfig> {
        match self {
            Self::Pty(config) | Self::Tcp(config, ..) | Self::Link(config, _) => Some(config),
            Self::BusSocket(_) | Self::Bus(_) => None,
        }
    }
}

impl Core {
    /// Writes answers to the host, as many as the line accepts.
    fn collect(&mut self, now: MonotonicTime, output: &mut Vec<u8>) {
        let unread = &mut self.unread;
        self.far.answer(now, |bytes| {
            if output.len() + bytes.len() > UNREAD_MAX {
                *unread += 1;
            } else {
                output.extend_from_slice(bytes);
            }
        });
    }
}

/// Connection to the host.
enum Line {
    /// A terminal, until it is unplugged.
    Pty(Option<Pty>),
    Tcp(Box<Admission>, Option<Admitted>),
    Link(Option<Box<dyn ByteLink>>),
    BusSocket(FrameListener, PathBuf, Option<Box<dyn BusPort>>),
    Bus(Option<Box<dyn BusPort>>),
}

impl Line {
    fn open(face: MockFace) -> Result<Self, MockServerError> {
        Ok(match face {
            MockFace::Pty(_) => Self::Pty(Some(Pty::open().map_err(MockServerError::Pty)?)),
            MockFace::Tcp(gateway, address, access) => {
                let listener = TcpListener::bind(address)
                    .and_then(|listener| listener.set_nonblocking(true).map(|()| listener))
                    .map_err(|source| MockServerError::Tcp { address, source })?;
                Self::Tcp(Box::new(Admission::by_tcp(listener, gateway.arm, access)), None)
            }
            MockFace::Link(_, link) => Self::Link(Some(link)),
            MockFace::BusSocket(path) => Self::BusSocket(FrameListener::bind(&path)?, path, None),
            MockFace::Bus(bus) => Self::Bus(Some(bus)),
        })
    }

    fn address(&self) -> String {
        match self {
            Self::Pty(pty) => pty.as_ref().map_or_else(String::new, |pty| pty.path().display().to_string()),
            Self::Tcp(admission, _) => admission.address().map_or_else(String::new, |at| at.to_string()),
            Self::Link(link) => link.as_ref().map_or_else(String::new, |link| link.name().to_owned()),
            Self::BusSocket(_, path, _) => path.display().to_string(),
            Self::Bus(bus) => bus.as_ref().map_or_else(String::new, |bus| bus.name().to_owned()),
        }
    }

    fn byte_link(&mut self) -> Option<&mut dyn ByteLink> {
        match self {
            Self::Pty(pty) => pty.as_mut().map(|pty| pty as &mut dyn ByteLink),
            Self::Tcp(_, host) => host.as_mut().map(|host| host.link.as_mut() as &mut dyn ByteLink),
            Self::Link(link) => link.as_deref_mut().map(|link| link as &mut dyn ByteLink),
            Self::BusSocket(..) | Self::Bus(_) => None,
        }
    }

    fn bus_port(&mut self) -> Option<&mut Box<dyn BusPort>> {
        match self {
            Self::BusSocket(_, _, bus) | Self::Bus(bus) => bus.as_mut(),
            Self::Pty(_) | Self::Tcp(..) | Self::Link(_) => None,
        }
    }

    fn is_connected(&mut self) -> bool {
        self.byte_link().is_some() || self.bus_port().is_some()
    }

    /// Refuses other hosts while one is connected.
    fn refuse_others(&mut self) {
        match self {
            Self::Tcp(admission, Some(host)) => {
                drop(admission.poll(realtime::now(), Some(host.peer), &mut |_| {}));
            }
            // A bus has one gateway: the end of its connection tells a second one.
            Self::BusSocket(listener, _, Some(_)) => drop(listener.try_accept()),
            _ => {}
        }
    }

    /// The other end is gone.
    fn hang_up(&mut self) {
        match self {
            Self::Pty(pty) => *pty = None,
            Self::Tcp(_, host) => *host = None,
            Self::Link(link) => *link = None,
            Self::BusSocket(_, _, bus) | Self::Bus(bus) => *bus = None,
        }
    }

    /// Accepts a connection, if there is one.
    fn accept(&mut self) {
        match self {
            Self::Pty(pty) => *pty = Pty::open().ok(),
            Self::Tcp(admission, host) => *host = admission.poll(realtime::now(), None, &mut |_| {}),
            Self::BusSocket(listener, _, bus) => {
                *bus = listener.try_accept().ok().flatten().map(|socket| Box::new(socket) as Box<dyn BusPort>);
            }
            Self::Link(_) | Self::Bus(_) => {}
        }
    }
}

/// State of the thread.
struct Worker {
    shared: Arc<Shared>,
    line: Line,
    /// Bytes that the line did not accept yet.
    output: Vec<u8>,
}

impl Worker {
    fn run(mut self, realtime: &Realtime) {
        lock(&self.shared.core).shortfalls = enter(realtime);
        while self.shared.is_running.load(Ordering::SeqCst) {
            self.keep_plugged();
            let next = self.work();
            self.wait_until(next);
        }
    }

    /// Plugs or unplugs the line as requested.
    fn keep_plugged(&mut self) {
        match (self.shared.is_plugged.load(Ordering::SeqCst), self.line.is_connected()) {
            (false, true) => self.hang_up(),
            (true, false) => {
                self.line.accept();
                if self.line.is_connected() {
                    *lock(&self.shared.address) = self.line.address();
                }
            }
            (true, true) => self.line.refuse_others(),
            (false, false) => {}
        }
    }

    fn hang_up(&mut self) {
        self.line.hang_up();
        self.output.clear();
        let mut core = lock(&self.shared.core);
        core.far.hang_up();
    }

    /// Handles everything that is due; returns the time of the next event.
    fn work(&mut self) -> MonotonicTime {
        let shared = Arc::clone(&self.shared);
        let mut core = lock(&shared.core);
        let now = core.clock.0.now().max(core.far.now());
        let is_gone = match self.line.bus_port() {
            Some(bus) => work_bus(&mut core, now, bus.as_mut()).is_err(),
            None => self.work_line(&mut core, now).is_err(),
        };
        let next = core.far.next_deadline().unwrap_or(now + WAIT_MAX);
        drop(core);
        if is_gone {
            self.hang_up();
        }
        next
    }

    /// Bytes of the host, and answers.
    fn work_line(&mut self, core: &mut Core, now: MonotonicTime) -> Result<(), Gone> {
        core.far.advance(now, |_| {});
        let Some(link) = self.line.byte_link() else { return Ok(()) };
        let mut buffer = [0; 512];
        loop {
            let room = core.far.controller.readable_on_line(now).min(buffer.len());
            if room == 0 {
                break;
            }
            let count = link.try_read(&mut buffer[..room]).map_err(|_| Gone)?;
            if count == 0 {
                break;
            }
            core.far.hear(now, &buffer[..count]);
            core.collect(now, &mut self.output);
        }
        core.far.exchange(&mut |_| {});
        core.collect(now, &mut self.output);
        if !self.output.is_empty() {
            let written = link.try_write(&self.output).map_err(|_| Gone)?;
            self.output.drain(..written);
        }
        Ok(())
    }

    fn wait_until(&mut self, next: MonotonicTime) {
        let core = lock(&self.shared.core);
        let clock = core.clock.clone();
        let now = clock.0.now();
        // Unread input must not wake the thread.
        let reads = core.far.controller.readable_on_line(now) > 0;
        let again = core.far.controller.reads_line_again().filter(|_| !reads);
        drop(core);
        let planned = next.min(now + WAIT_MAX).min(again.unwrap_or(next));
        let timeout = planned.saturating_since(now);
        let for_room = !self.output.is_empty();
        if let Some(link) = self.line.byte_link().filter(|_| reads) {
            wait(Some(link), for_room, None, timeout);
        } else if let Some(bus) = self.line.bus_port() {
            pb3dp_arm_pa10_gateway::bus::wait(bus.as_ref(), timeout);
        } else {
            clock.0.sleep_until(planned);
        }
        let late = clock.0.now().saturating_since(planned);
        // Input wakes it before its time.
        if late > Duration::ZERO {
            self.shared.lateness.record(late);
        }
    }
}

/// The other side has gone.
struct Gone;

/// Frames of the host, and replies.
fn work_bus(core: &mut Core, now: MonotonicTime, bus: &mut dyn BusPort) -> Result<(), Gone> {
    let mut sent = Ok(true);
    let mut send = |frame: &[u8]| {
        if sent.is_ok() {
            sent = bus.try_send(frame);
        }
    };
    core.far.advance(now, &mut send);
    let mut buffer = [0; FRAME_ROOM];
    sent.map_err(|_| Gone)?;
    while let Some(count) = bus.try_receive(&mut buffer).map_err(|_| Gone)? {
        core.far.controller.handle_frame(now, &buffer[..count]);
    }
    Ok(())
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
