//! A gateway that runs: its core on a thread that keeps the cycle, a door through which hosts come in, and what it tells its owner.
//!
//! The thread of the cycle opens nothing, closes nothing, formats nothing and waits for no lock: the door opens and closes lines for
//! it, and what happened goes to the owner through a queue of fixed size.

mod cycle;
mod door;
mod events;

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

use cycle::Cycle;
use door::{Door, Lines};
use events::EventQueue;
use pb3dp_arm_pa10::bus::BusPort;
use pb3dp_hal_platform::realtime::{self, Realtime, Shortfall};
use pb3dp_hal_platform::transport::{ConnectError, Connector};
use rustix::event::{EventfdFlags, eventfd};
use rustix::fd::OwnedFd;

use crate::gateway::{Gateway, GatewayConfig, GatewayConfigError, GatewayStatus};

pub use events::{GatewayEvent, Happened};

/// Opens the bus, and opens it again when it was down.
pub type BusOpener = Box<dyn FnMut() -> Result<Box<dyn BusPort>, ConnectError> + Send>;

/// Where hosts come from.
pub enum HostSide {
    /// From the network: one connection at a time.
    Tcp(TcpListener),
    /// Through a line that is opened again when it was unplugged.
    Line(Box<dyn Connector>),
}

/// Settings of a server.
pub struct GatewayServerConfig {
    /// Of the core.
    pub gateway: GatewayConfig,
    /// What the thread of the cycle asks for.
    pub realtime: Realtime,
}

/// Why there is no server.
#[derive(Debug, thiserror::Error)]
pub enum GatewayServerError {
    /// The configuration contradicts itself.
    #[error("gateway")]
    Config(#[from] GatewayConfigError),
    /// The operating system gives no thread or file descriptor.
    #[error("the gateway cannot be started")]
    System(#[from] std::io::Error),
    /// The bus cannot be opened.
    #[error("the bus cannot be opened")]
    Bus(#[source] ConnectError),
    /// The port cannot be listened at.
    #[error("nobody can be listened for at {address}; is another program using that port?")]
    Listen {
        /// Where.
        address: SocketAddr,
        /// What the system says.
        #[source]
        source: std::io::Error,
    },
}

/// What the threads share.
#[derive(Debug)]
struct Shared {
    /// The stop order, then the end.
    end: AtomicBool,
    /// A host is connected.
    has_host: AtomicBool,
    /// The bus has to be opened again.
    wants_bus: AtomicBool,
    /// When bytes of the host came last, ns.
    heard: AtomicU64,
    /// Wakes the thread of the cycle.
    waker: OwnedFd,
}

/// A gateway that runs.
#[derive(Debug)]
pub struct GatewayServer {
    shared: Arc<Shared>,
    cycle: Option<JoinHandle<Option<GatewayStatus>>>,
    door: Option<JoinHandle<()>>,
    events: Receiver<GatewayEvent>,
    door_messages: Receiver<String>,
    dropped: Arc<AtomicU64>,
    shortfalls: Vec<Shortfall>,
    name_of_bus: String,
}

/// Asks a gateway to end, from any thread.
#[derive(Clone, Debug)]
pub struct Ending(Arc<Shared>);

impl Ending {
    /// Asks for the stop order and the end; harmless when repeated.
    pub fn ask(&self) {
        self.0.end.store(true, Ordering::SeqCst);
        self.0.wake();
    }

    /// Whether it was asked for.
    pub fn is_asked(&self) -> bool {
        self.0.end.load(Ordering::SeqCst)
    }
}

impl Shared {
    fn wake(&self) {
        // It is full only if it was not taken since, and then it wakes all the same.
        let _ = rustix::io::write(&self.waker, &1u64.to_ne_bytes());
    }
}

impl HostSide {
    /// Listens at an address of this machine.
    ///
    /// # Errors
    /// If another program does.
    pub fn listen(address: SocketAddr) -> Result<Self, GatewayServerError> {
        let listen = |source| GatewayServerError::Listen { address, source };
        let listener = TcpListener::bind(address).map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        Ok(Self::Tcp(listener))
    }
}

impl GatewayServer {
    /// Starts a gateway: E is sent, and hosts may come.
    ///
    /// # Errors
    /// If the configuration contradicts itself, the bus cannot be opened or the system gives no thread.
    pub fn start(config: GatewayServerConfig, mut bus: BusOpener, host: HostSide) -> Result<Self, GatewayServerError> {
        let core = Gateway::new(config.gateway, realtime::now())?;
        let port = bus().map_err(GatewayServerError::Bus)?;
        let name_of_bus = port.name().to_owned();
        let shared = Arc::new(Shared {
            end: AtomicBool::new(false),
            has_host: AtomicBool::new(false),
            wants_bus: AtomicBool::new(false),
            heard: AtomicU64::new(0),
            waker: eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC).map_err(std::io::Error::from)?,
        });
        let (queue, events) = EventQueue::new();
        let dropped = queue.dropped();
        let (lines, ends) = Lines::pairs();
        let (tell, door_messages) = sync_channel(64);
        let door = Door { shared: Arc::clone(&shared), lines: ends, tell, bus, host };
        let (ready, is_ready) = sync_channel(1);
        let (for_cycle, wanted) = (Arc::clone(&shared), config.realtime);
        let cycle = std::thread::Builder::new().name("gateway-cycle".into()).spawn(move || {
            let shortfalls = realtime::enter(&wanted);
            let _ = ready.send(shortfalls);
            Cycle::new(core, port, for_cycle, lines, queue).run()
        })?;
        let door = std::thread::Builder::new().name("gateway-door".into()).spawn(move || door.run())?;
        // It ends early only if the thread does, which `end` will tell.
        let shortfalls = is_ready.recv_timeout(Duration::from_secs(5)).unwrap_or_default();
        let (cycle, door) = (Some(cycle), Some(door));
        Ok(Self { shared, cycle, door, events, door_messages, dropped, shortfalls, name_of_bus })
    }

    /// What the thread of the cycle asked for and did not get.
    pub fn shortfalls(&self) -> &[Shortfall] {
        &self.shortfalls
    }

    /// The bus, for messages.
    pub fn name_of_bus(&self) -> &str {
        &self.name_of_bus
    }

    /// What happened since the last call, if something did.
    pub fn try_event(&self) -> Option<GatewayEvent> {
        self.events.try_recv().ok()
    }

    /// What the door has to say: lines that cannot be opened, hosts that were turned away.
    pub fn try_message(&self) -> Option<String> {
        self.door_messages.try_recv().ok()
    }

    /// Events that found no place, as nobody took the ones before.
    pub fn events_dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// Whether it still runs.
    pub fn is_running(&self) -> bool {
        self.cycle.as_ref().is_some_and(|cycle| !cycle.is_finished())
    }

    /// Asks for the stop order and the end; harmless when repeated.
    pub fn ask_to_end(&self) {
        self.ending().ask();
    }

    /// What another thread than the owner's asks with: one that nothing holds up.
    pub fn ending(&self) -> Ending {
        Ending(Arc::clone(&self.shared))
    }

    /// The stop order, the end, and how the gateway was then; `None` if its thread had failed, which
    /// stops the arm if it still can. Waits for as long as the stop order
    /// takes: brakes have their time to close, and half a second is added.
    pub fn end(mut self) -> Option<GatewayStatus> {
        self.finish()
    }

    fn finish(&mut self) -> Option<GatewayStatus> {
        self.ask_to_end();
        let status = self.cycle.take()?.join().ok().flatten();
        if let Some(door) = self.door.take() {
            let _ = door.join();
        }
        status
    }
}

impl Drop for GatewayServer {
    fn drop(&mut self) {
        self.finish();
    }
}
