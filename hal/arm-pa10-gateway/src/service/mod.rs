//! The running gateway: the core on a thread that keeps the cycle, a connection thread for hosts, and a queue of events for the owner.
//!
//! The cycle thread opens nothing, closes nothing, formats nothing and takes no lock: the connection thread opens and closes its
//! lines, and events go to the owner through a queue of fixed size. It allocates nothing per cycle.

mod admission;
mod cycle;
mod events;
mod listener;

use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::bus::BusPort;
use cycle::Cycle;
use events::EventQueue;
use listener::{Lines, Listener};
use pb3dp_arm_pa10_protocol::gateway_protocol::ArmId;
use pb3dp_hal_platform::local_socket::{LocalListener, LocalSocketError};
use pb3dp_hal_platform::realtime::{self, Realtime, Shortfall};
use pb3dp_hal_platform::transport::{ConnectError, Connector};
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::OwnedFd;

use crate::gateway::{Gateway, GatewayConfig, GatewayConfigError, GatewayStatus};

pub use admission::{Access, Admission, AdmissionCounters, Admitted, OPENING_MAX, Peer};
pub use events::{GatewayEvent, Happened};

/// Opens the bus, and opens it again after it was down.
pub type BusOpener = Box<dyn FnMut() -> Result<Box<dyn BusPort>, ConnectError> + Send>;

/// Transport to the hosts.
pub enum HostSide {
    /// TCP, or a socket of this computer: one host at a time, of those that are admitted.
    Admission(Admission),
    /// A line that is opened again after it was unplugged.
    Line(Box<dyn Connector>),
}

/// Settings of a server.
pub struct GatewayServerConfig {
    /// Settings of the core.
    pub gateway: GatewayConfig,
    /// Requested real-time scheduling of the cycle thread.
    pub realtime: Realtime,
}

/// Why a server cannot start.
#[derive(Debug, thiserror::Error)]
pub enum GatewayServerError {
    /// The configuration contradicts itself.
    #[error("gateway")]
    Config(#[from] GatewayConfigError),
    /// The operating system provides no thread or file descriptor.
    #[error("the gateway cannot be started")]
    System(#[from] std::io::Error),
    /// The bus cannot be opened.
    #[error("the bus cannot be opened")]
    Bus(#[source] ConnectError),
    /// The gateway cannot listen at the address.
    #[error("cannot listen at {address}: check whether another program uses this port")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The error of the system.
        #[source]
        source: std::io::Error,
    },
    /// The gateway cannot listen at the socket.
    #[error(transparent)]
    Socket(#[from] LocalSocketError),
}

/// State shared between the threads.
#[derive(Debug)]
struct Shared {
    /// Requests the stop order and then the end.
    end: AtomicBool,
    /// A host is connected.
    has_host: AtomicBool,
    /// The switch stands on local.
    is_local: AtomicBool,
    /// The bus has to be opened again.
    wants_bus: AtomicBool,
    /// Time of the last sound frame from the host, ns.
    last_received_nanos: AtomicU64,
    /// Wakes the cycle thread.
    waker: OwnedFd,
}

/// A running gateway.
#[derive(Debug)]
pub struct GatewayServer {
    shared: Arc<Shared>,
    cycle: Option<JoinHandle<Option<GatewayStatus>>>,
    listener: Option<JoinHandle<()>>,
    events: Receiver<GatewayEvent>,
    door_messages: Receiver<String>,
    dropped: Arc<AtomicU64>,
    shortfalls: Vec<Shortfall>,
    name_of_bus: String,
}

/// Requests the end of a gateway, from any thread.
#[derive(Clone, Debug)]
pub struct Ending(Arc<Shared>);

impl Ending {
    /// Requests the stop order and the end; repeating it is harmless.
    pub fn ask(&self) {
        self.0.end.store(true, Ordering::SeqCst);
        self.0.wake();
    }

    /// Whether the end was requested.
    pub fn is_asked(&self) -> bool {
        self.0.end.load(Ordering::SeqCst)
    }
}

impl Shared {
    fn wake(&self) {
        // The write fails only if the counter is full, and then the thread wakes all the same.
        let _ = rustix::io::write(&self.waker, &1u64.to_ne_bytes());
    }
}

impl HostSide {
    /// Listens at an address of this machine for hosts of this arm.
    ///
    /// # Errors
    /// If the address is in use or not available.
    pub fn listen(address: SocketAddr, arm: ArmId, access: Access) -> Result<Self, GatewayServerError> {
        let listen = |source| GatewayServerError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        Ok(Self::Admission(Admission::by_tcp(listener, arm, access)))
    }

    /// Listens at a socket of this computer for hosts of this arm.
    ///
    /// # Errors
    /// If another program listens there, or other users may write into its folder.
    pub fn listen_at_socket(path: &Path, arm: ArmId) -> Result<Self, GatewayServerError> {
        Ok(Self::Admission(Admission::by_socket(LocalListener::bind(path)?, arm)))
    }

    /// Address of the listener, if it is TCP.
    pub fn address(&self) -> Option<SocketAddr> {
        match self {
            Self::Admission(admission) => admission.address(),
            Self::Line(_) => None,
        }
    }
}

impl GatewayServer {
    /// Starts a gateway: E is sent, and hosts may connect.
    ///
    /// # Errors
    /// If the configuration contradicts itself, the bus cannot be opened or the system provides no thread.
    pub fn start(config: GatewayServerConfig, mut bus: BusOpener, host: HostSide) -> Result<Self, GatewayServerError> {
        let core = Gateway::new(config.gateway, realtime::now())?;
        let port = bus().map_err(GatewayServerError::Bus)?;
        let name_of_bus = port.name().to_owned();
        let shared = Arc::new(Shared {
            end: AtomicBool::new(false),
            has_host: AtomicBool::new(false),
            is_local: AtomicBool::new(false),
            wants_bus: AtomicBool::new(false),
            last_received_nanos: AtomicU64::new(0),
            waker: eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC).map_err(std::io::Error::from)?,
        });
        let (queue, events) = EventQueue::new();
        let dropped = queue.dropped();
        let (lines, ends) = Lines::pairs();
        let (tell, door_messages) = sync_channel(64);
        let listener = Listener { shared: Arc::clone(&shared), lines: ends, tell, bus, host };
        let (ready, is_ready) = sync_channel(1);
        let (for_cycle, wanted) = (Arc::clone(&shared), config.realtime);
        let cycle = std::thread::Builder::new().name("gateway-cycle".into()).spawn(move || {
            let shortfalls = realtime::enter(&wanted);
            let _ = ready.send(shortfalls);
            // The first cycle is due now: opening the bus and locking the memory took time that is no lateness.
            let core = Gateway::new(config.gateway, realtime::now()).unwrap_or(core);
            Cycle::new(core, port, for_cycle, lines, queue).run()
        })?;
        let listener = std::thread::Builder::new().name("gateway-door".into()).spawn(move || listener.run())?;
        // No answer comes only if the thread has ended, which `end` reports.
        let shortfalls = is_ready.recv_timeout(Duration::from_secs(5)).unwrap_or_default();
        let (cycle, listener) = (Some(cycle), Some(listener));
        Ok(Self { shared, cycle, listener, events, door_messages, dropped, shortfalls, name_of_bus })
    }

    /// Requested resources that the cycle thread did not get.
    pub fn shortfalls(&self) -> &[Shortfall] {
        &self.shortfalls
    }

    /// Name of the bus, for messages.
    pub fn name_of_bus(&self) -> &str {
        &self.name_of_bus
    }

    /// The next event, if any.
    pub fn try_event(&self) -> Option<GatewayEvent> {
        self.events.try_recv().ok()
    }

    /// The next message of the connection thread: lines that cannot be opened, hosts that were turned away.
    pub fn try_message(&self) -> Option<String> {
        self.door_messages.try_recv().ok()
    }

    /// Events that were dropped because the queue was full.
    pub fn events_dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Whether the cycle thread still runs.
    pub fn is_running(&self) -> bool {
        self.cycle.as_ref().is_some_and(|cycle| !cycle.is_finished())
    }

    /// Sets the switch: on local no host moves or enables the arm.
    pub fn switch(&self, is_local: bool) {
        self.shared.is_local.store(is_local, Ordering::SeqCst);
        self.shared.wake();
    }

    /// Whether the switch stands on local.
    pub fn is_local(&self) -> bool {
        self.shared.is_local.load(Ordering::SeqCst)
    }

    /// Requests the stop order and the end; repeating it is harmless.
    pub fn ask_to_end(&self) {
        self.ending().ask();
    }

    /// A handle with which another thread can request the end, without a lock.
    pub fn ending(&self) -> Ending {
        Ending(Arc::clone(&self.shared))
    }

    /// Executes the stop order, ends the gateway and returns its final status; `None` if its thread had panicked, in which case the
    /// thread stops the arm if it still can. Takes as long as the stop order: the brake time and up to half a second.
    pub fn end(mut self) -> Option<GatewayStatus> {
        self.finish()
    }

    fn finish(&mut self) -> Option<GatewayStatus> {
        self.ask_to_end();
        let status = self.cycle.take()?.join().ok().flatten();
        if let Some(listener) = self.listener.take() {
            let _ = listener.join();
        }
        status
    }
}

impl Drop for GatewayServer {
    fn drop(&mut self) {
        self.finish();
    }
}
