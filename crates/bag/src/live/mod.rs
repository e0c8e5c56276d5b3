//! A run for viewers that speak the WebSocket protocol of Foxglove, while it goes on: the same messages as in a recording.
//!
//! Viewers only watch: nothing that a client sends has an effect on the run or on other clients. A thread of its own serves all of them. A
//! viewer that is too slow misses messages, images first; one that reads nothing for a minute, or sends what is not of the protocol, is
//! disconnected. A client gets the newest message that describes the run ([`crate::topics::describes_the_run`]) when it subscribes.

mod client;
mod protocol;
mod server;

use std::collections::BTreeSet;
use std::io::Write;
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread::JoinHandle;

use crate::BagError;
use crate::encoded::Encoded;
use crate::queue::{Sender, WhenFull, bounded};

/// An address of this computer with a port, where viewers connect.
pub type ViewerAddress = SocketAddr;

/// Where viewers look for a server by default, on this computer only.
pub const DEFAULT_ADDRESS: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 8765);

/// Messages on their way to the thread that serves.
const QUEUED_MAX: u64 = 1024;
/// Bytes on their way to the thread that serves.
const QUEUED_BYTES_MAX: u64 = 64 << 20;

/// What the run and the serving thread both see.
#[derive(Debug, Default)]
struct Shared {
    viewers: AtomicUsize,
    /// The thread has to be woken for a message.
    is_asleep: AtomicBool,
    is_over: AtomicBool,
}

/// Serves the messages of a run to viewers, until it is dropped.
#[derive(Debug)]
pub struct Live {
    address: SocketAddr,
    queue: Sender<Arc<Encoded>>,
    waking: UnixStream,
    shared: Arc<Shared>,
    /// Topics whose channel the thread knows.
    announced: BTreeSet<&'static str>,
    dropped: u64,
    thread: Option<JoinHandle<()>>,
}

impl Live {
    /// Serves viewers at an address; port 0 takes a free port. Viewers are not asked who they are: at an address that other computers
    /// reach, everybody on the network can watch.
    ///
    /// # Errors
    /// If the address is in use or not of this computer.
    pub fn serve(address: SocketAddr) -> Result<Self, BagError> {
        let failed = |source| BagError::Serve { address, source };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let bound = listener.local_addr().map_err(failed)?;
        let (waking, woken) = UnixStream::pair().map_err(failed)?;
        waking.set_nonblocking(true).map_err(failed)?;
        woken.set_nonblocking(true).map_err(failed)?;
        let (queue, messages) = bounded(QUEUED_MAX, QUEUED_BYTES_MAX);
        let shared = Arc::new(Shared::default());
        let server = server::Server {
            listener,
            waking: woken,
            queue: messages,
            shared: Arc::clone(&shared),
            offer: client::Offer::default(),
            clients: Vec::new(),
            rests_until: None,
        };
        let thread = std::thread::Builder::new().name("live".to_owned()).spawn(move || server.run()).map_err(failed)?;
        let announced = BTreeSet::new();
        Ok(Self { address: bound, queue, waking, shared, announced, dropped: 0, thread: Some(thread) })
    }

    /// The address with its port.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Number of connected viewers.
    pub fn viewers(&self) -> usize {
        self.shared.viewers.load(Ordering::SeqCst)
    }

    /// Messages that reached no viewer since the serving thread lagged behind.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// Whether a message of a topic is of use: without viewers, only the first one, which announces the topic, and those that describe the
    /// run.
    pub fn needs(&self, topic: &'static str) -> bool {
        self.viewers() > 0 || !self.announced.contains(topic) || crate::topics::describes_the_run(topic)
    }

    /// Hands a message to all viewers that have subscribed to its topic. Never waits.
    pub fn push(&mut self, message: &Arc<Encoded>) {
        if !self.needs(message.topic) {
            return;
        }
        let bytes = message.bytes();
        let is_sent = if message.describes_the_run() {
            self.queue.put(Arc::clone(message), bytes)
        } else {
            self.queue.send(Arc::clone(message), bytes, WhenFull::Drop)
        };
        if is_sent {
            self.announced.insert(message.topic);
        } else {
            self.dropped += 1;
        }
        self.wake();
    }

    fn wake(&self) {
        if self.shared.is_asleep.swap(false, Ordering::SeqCst) {
            // If it is full, the thread is awake.
            let _ = (&self.waking).write(&[0]);
        }
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::SeqCst);
        self.shared.is_asleep.store(true, Ordering::SeqCst);
        self.wake();
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
