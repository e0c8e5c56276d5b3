//! Who may talk to a gateway on TCP or at a socket of this computer: connections become hosts only here, outside the cycle thread.
//!
//! A connection by TCP comes from an address on the list, proves the key and sends HELLO, in this order, within a limited time and without
//! another byte in between. At a socket the kernel shows the user of the other program, and HELLO is enough. All others are closed, and
//! the cycle thread never learns of them.

use std::fmt;
use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use pb3dp_arm_pa10::arm::KeyedLink;
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    Agreement, ArmId, FRAME_BYTES_MAX, FirstFrame, Frame, FrameBytes, GatewayMessage, HELLO, Handshake, Holder, Reject,
    RejectReason, SharedKey, Side, first_frame,
};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::key_file::random_bytes;
use pb3dp_hal_platform::local_socket::{LocalListener, LocalSocketError};
use pb3dp_hal_platform::tcp::TcpLink;
use pb3dp_hal_platform::transport::{ByteLink, Unplugged};

/// Time from the connection to HELLO: a host needs some milliseconds, and gives up after as long.
pub const OPENING_MAX: Duration = Duration::from_millis(500);

/// New connections per second that are examined; the others are closed at once. A host that has lost its connection opens two or
/// three per second.
const CONNECTIONS_PER_SECOND: u32 = 20;

/// Connections that are examined at the same time: more than the rate allows within [`OPENING_MAX`].
const WAITING_MAX: usize = 32;

/// Connections that are accepted or closed at once. Then the thread waits: a flood costs a bounded share of a processor.
const ACCEPTED_MAX: usize = 64;

/// Pause after a flood.
const PAUSE: Duration = Duration::from_millis(50);

/// Shortest time between two messages about refused connections.
const REPORTED_EVERY: Duration = Duration::from_secs(1);

/// Whom a gateway on TCP admits.
#[derive(Clone, Debug)]
pub struct Access {
    /// The key that host and gateway share.
    pub key: SharedKey,
    /// Addresses of the hosts.
    pub peers: Vec<IpAddr>,
}

impl Access {
    /// Access with this key from this computer only.
    pub fn from_this_computer(key: SharedKey) -> Self {
        Self { key, peers: vec![Ipv4Addr::LOCALHOST.into(), Ipv6Addr::LOCALHOST.into()] }
    }
}

/// A host that was admitted, with its HELLO as the first bytes to read.
pub struct Admitted {
    /// The connection.
    pub link: Box<dyn ByteLink>,
    /// Its other end.
    pub peer: Peer,
}

/// The other end of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// By TCP.
    Address(SocketAddr),
    /// A program of this computer.
    Local,
}

impl fmt::Display for Peer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(address) => write!(f, "{address}"),
            Self::Local => write!(f, "a program of this computer"),
        }
    }
}

/// Counts of connections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AdmissionCounters {
    /// Admitted.
    pub admitted: u64,
    /// Refused or closed.
    pub refused: u64,
}

/// Where hosts connect, and what they must show.
enum Listener {
    Tcp(TcpListener, Access),
    Local(LocalListener),
}

/// Admits hosts.
pub struct Admission {
    listener: Listener,
    arm: ArmId,
    waiting: Vec<Opening>,
    budget: Budget,
    accepts_again: MonotonicTime,
    counters: AdmissionCounters,
    log: RefusalLog,
}

/// Connections that may still be examined.
#[derive(Debug)]
struct Budget {
    left: u32,
    since: MonotonicTime,
}

/// Limits messages about refused connections: a flood must not fill the log.
#[derive(Debug)]
struct RefusalLog {
    again: MonotonicTime,
    untold: u64,
}

/// A connection before its first command.
struct Opening {
    peer: Peer,
    ends: MonotonicTime,
    stage: Stage,
    bytes: [u8; FRAME_BYTES_MAX],
    length: usize,
}

enum Stage {
    ClientNonce(TcpLink, SharedKey),
    Proof(TcpLink, Box<Agreement>),
    Hello(Box<dyn ByteLink>),
    Gone,
}

/// What a listener has.
enum Next {
    Nothing,
    /// The system gives no connection: the listener stays readable.
    Failed,
    Connection(Stage, Peer),
    Refused(Peer, &'static str),
}

/// A link after its first frame, which is read once more.
struct Replayed {
    first: FrameBytes,
    read: usize,
    link: Box<dyn ByteLink>,
}

/// What became of a connection.
enum Outcome {
    Waits,
    Hello(Frame),
    Refused(&'static str),
}

impl Admission {
    /// Admits hosts of an arm by TCP, at a listener that does not block.
    pub fn by_tcp(listener: TcpListener, arm: ArmId, access: Access) -> Self {
        Self::new(Listener::Tcp(listener, access), arm)
    }

    /// Admits programs of this computer.
    pub fn by_socket(listener: LocalListener, arm: ArmId) -> Self {
        Self::new(Listener::Local(listener), arm)
    }

    fn new(listener: Listener, arm: ArmId) -> Self {
        let start = MonotonicTime::ZERO;
        Self {
            listener,
            arm,
            waiting: Vec::with_capacity(WAITING_MAX),
            budget: Budget { left: CONNECTIONS_PER_SECOND, since: start },
            accepts_again: start,
            counters: AdmissionCounters::default(),
            log: RefusalLog { again: start, untold: 0 },
        }
    }

    /// Address of the listener, if it is TCP.
    pub fn address(&self) -> Option<SocketAddr> {
        match &self.listener {
            Listener::Tcp(listener, _) => listener.local_addr().ok(),
            Listener::Local(_) => None,
        }
    }

    /// Counts so far.
    pub fn counters(&self) -> AdmissionCounters {
        self.counters
    }

    /// The next host, if one has proven its key and sent HELLO. If another host holds the gateway, that one is refused by name.
    pub fn poll(&mut self, now: MonotonicTime, holder: Option<Peer>, tell: &mut dyn FnMut(String)) -> Option<Admitted> {
        self.accept(now, tell);
        let mut index = 0;
        while index < self.waiting.len() {
            let outcome = self.waiting[index].advance(now, self.arm);
            match outcome {
                Outcome::Waits => index += 1,
                Outcome::Refused(why) => {
                    let peer = self.waiting.swap_remove(index).peer;
                    self.refuse(now, peer, why, tell);
                }
                Outcome::Hello(hello) => {
                    let Opening { peer, stage: Stage::Hello(mut link), .. } = self.waiting.swap_remove(index) else {
                        continue;
                    };
                    if let Some(holder) = holder {
                        tell_holder(link.as_mut(), self.arm, &hello, holder);
                        self.refuse(now, peer, "another host is connected", tell);
                        continue;
                    }
                    self.counters.admitted += 1;
                    let link = Box::new(Replayed { first: hello.encode(), read: 0, link });
                    return Some(Admitted { link, peer });
                }
            }
        }
        None
    }

    /// What to wait for: new connections, unless there was a flood, and the next bytes of those that are examined.
    pub fn fds(&self, now: MonotonicTime) -> Vec<BorrowedFd<'_>> {
        let listener = (now >= self.accepts_again).then(|| self.listener.as_fd());
        listener.into_iter().chain(self.waiting.iter().filter_map(|opening| opening.stage.link()?.fd())).collect()
    }

    fn accept(&mut self, now: MonotonicTime, tell: &mut dyn FnMut(String)) {
        if now < self.accepts_again {
            return;
        }
        for _ in 0..ACCEPTED_MAX {
            let (mut stage, peer) = match self.listener.next() {
                Next::Connection(stage, peer) => (stage, peer),
                Next::Refused(peer, why) => {
                    self.refuse(now, peer, why, tell);
                    continue;
                }
                Next::Nothing => return,
                Next::Failed => break,
            };
            let (reason, why) = if !self.listener.is_listed(peer) {
                (RejectReason::PeerNotAllowed, "its address is not on the list")
            } else if self.waiting.len() >= WAITING_MAX || !self.budget.take(now) {
                self.accepts_again = now + PAUSE;
                (RejectReason::TooManyPeers, "too many new connections")
            } else {
                self.waiting.push(Opening::new(stage, peer, now + OPENING_MAX));
                continue;
            };
            stage.reject(self.arm, reason);
            self.refuse(now, peer, why, tell);
        }
        self.accepts_again = now + PAUSE;
    }

    fn refuse(&mut self, now: MonotonicTime, peer: Peer, why: &str, tell: &mut dyn FnMut(String)) {
        self.counters.refused += 1;
        if now < self.log.again {
            self.log.untold += 1;
            return;
        }
        let more = match std::mem::take(&mut self.log.untold) {
            0 => String::new(),
            count => format!(" (and {count} more since the last message)"),
        };
        self.log.again = now + REPORTED_EVERY;
        tell(format!("a connection from {peer} was turned away: {why}{more}"));
    }
}

impl Listener {
    fn next(&self) -> Next {
        let failed = |kind| if kind == ErrorKind::WouldBlock { Next::Nothing } else { Next::Failed };
        match self {
            Self::Tcp(listener, access) => match listener.accept() {
                Ok((stream, address)) => match TcpLink::from_stream(stream) {
                    Ok(link) => Next::Connection(Stage::ClientNonce(link, access.key), Peer::Address(address)),
                    Err(_) => Next::Refused(Peer::Address(address), "it closed the connection without a frame"),
                },
                Err(error) => failed(error.kind()),
            },
            Self::Local(listener) => match listener.accept() {
                Ok(Some(link)) => Next::Connection(Stage::Hello(Box::new(link)), Peer::Local),
                Ok(None) => Next::Nothing,
                Err(LocalSocketError::OtherUser { .. }) => Next::Refused(Peer::Local, "it belongs to another user"),
                Err(_) => Next::Failed,
            },
        }
    }

    fn is_listed(&self, peer: Peer) -> bool {
        match (self, peer) {
            (Self::Tcp(_, access), Peer::Address(address)) => access.peers.contains(&address.ip().to_canonical()),
            _ => true,
        }
    }

    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Tcp(listener, _) => listener.as_fd(),
            Self::Local(listener) => listener.as_fd(),
        }
    }
}

impl Stage {
    fn link(&self) -> Option<&dyn ByteLink> {
        match self {
            Self::ClientNonce(link, _) | Self::Proof(link, _) => Some(link),
            Self::Hello(link) => Some(link.as_ref()),
            Self::Gone => None,
        }
    }

    fn link_mut(&mut self) -> Option<&mut dyn ByteLink> {
        match self {
            Self::ClientNonce(link, _) | Self::Proof(link, _) => Some(link),
            Self::Hello(link) => Some(link.as_mut()),
            Self::Gone => None,
        }
    }

    fn reject(&mut self, arm: ArmId, reason: RejectReason) {
        if let Some(link) = self.link_mut() {
            // The connection ends in any case.
            let _ = link.try_write(&refusal(arm, reason));
        }
    }
}

impl Budget {
    fn take(&mut self, now: MonotonicTime) -> bool {
        if now.saturating_since(self.since) >= Duration::from_secs(1) {
            *self = Self { left: CONNECTIONS_PER_SECOND, since: now };
        }
        let left = self.left;
        self.left = left.saturating_sub(1);
        left > 0
    }
}

impl Opening {
    fn new(stage: Stage, peer: Peer, ends: MonotonicTime) -> Self {
        Self { peer, ends, stage, bytes: [0; FRAME_BYTES_MAX], length: 0 }
    }

    fn advance(&mut self, now: MonotonicTime, arm: ArmId) -> Outcome {
        loop {
            let frame = match self.read() {
                Ok(Some(frame)) => frame,
                Ok(None) if now >= self.ends => {
                    return Outcome::Refused(match self.peer {
                        Peer::Address(_) => "it did not prove the key in time",
                        Peer::Local => "it did not send HELLO in time",
                    });
                }
                Ok(None) => return Outcome::Waits,
                Err(why) => return Outcome::Refused(why),
            };
            if frame.arm != arm {
                self.stage.reject(arm, RejectReason::WrongArm);
                return Outcome::Refused("it wants another arm");
            }
            self.stage = match std::mem::replace(&mut self.stage, Stage::Gone) {
                Stage::ClientNonce(link, key) => match challenge(link, &frame, arm, key) {
                    Ok(next) => next,
                    Err(why) => return Outcome::Refused(why),
                },
                Stage::Proof(link, agreement) => match Handshake::decode(&frame) {
                    Ok(Handshake::Proof(proof)) if agreement.is_proof(Side::Host, &proof) => {
                        Stage::Hello(Box::new(KeyedLink::new(link, &agreement, Side::Gateway)))
                    }
                    _ => {
                        self.stage = Stage::Proof(link, agreement);
                        self.stage.reject(arm, RejectReason::KeyMismatch);
                        return Outcome::Refused("it has another key");
                    }
                },
                Stage::Hello(link) if frame.frame_type == HELLO => {
                    self.stage = Stage::Hello(link);
                    return Outcome::Hello(frame);
                }
                Stage::Hello(_) | Stage::Gone => return Outcome::Refused("it did not begin with HELLO"),
            };
        }
    }

    /// The next frame, and no byte more.
    fn read(&mut self) -> Result<Option<Frame>, &'static str> {
        loop {
            let needed = match first_frame(&self.bytes[..self.length]) {
                FirstFrame::Frame { frame, .. } => {
                    self.length = 0;
                    return Ok(Some(frame));
                }
                FirstFrame::None => return Err("it sent something else than a frame"),
                FirstFrame::Incomplete { needed } => needed,
            };
            let (mut bytes, length) = (self.bytes, self.length);
            let Some(link) = self.stage.link_mut() else { return Err("it is closed") };
            match link.try_read(&mut bytes[length..needed]) {
                Ok(0) => return Ok(None),
                Ok(count) => (self.bytes, self.length) = (bytes, length + count),
                Err(_) => return Err(self.why_closed()),
            }
        }
    }

    /// Why a host closes the connection: it does not say so, but only the host can compare the proof of the gateway.
    fn why_closed(&self) -> &'static str {
        match self.stage {
            Stage::Proof(..) => "it closed the connection instead of proving the key: most likely it has another key",
            Stage::Hello(_) if self.peer != Peer::Local => {
                "it closed the connection, or sent a record that is not authentic"
            }
            Stage::ClientNonce(..) | Stage::Hello(_) | Stage::Gone => "it closed the connection without a frame",
        }
    }
}

/// Answers the client's nonce with the nonce and the proof of the gateway.
fn challenge(mut link: TcpLink, frame: &Frame, arm: ArmId, key: SharedKey) -> Result<Stage, &'static str> {
    let Ok(Handshake::ClientNonce(host)) = Handshake::decode(frame) else {
        let _ = link.try_write(&refusal(arm, RejectReason::KeyMismatch));
        return Err("it does not prove a key");
    };
    let nonce = random_bytes().map_err(|_| "the system gives no random bytes")?;
    let agreement = Agreement::new(key, arm, host, nonce);
    let answer = Handshake::Challenge(nonce, agreement.proof(Side::Gateway)).frame(arm).encode();
    match link.try_write(&answer) {
        Ok(count) if count == answer.len() => Ok(Stage::Proof(link, Box::new(agreement))),
        _ => Err("it does not take the answer"),
    }
}

fn refusal(arm: ArmId, reason: RejectReason) -> FrameBytes {
    GatewayMessage::Reject(Reject { reason, frame_type: 0, detail: 0 }).frame(arm, 0, 0).encode()
}

fn tell_holder(link: &mut dyn ByteLink, arm: ArmId, hello: &Frame, holder: Peer) {
    let held = GatewayMessage::Held(match holder {
        Peer::Address(address) => Holder { address: address.ip().to_canonical(), port: address.port() },
        Peer::Local => Holder { address: Ipv4Addr::LOCALHOST.into(), port: 0 },
    });
    // The connection ends in any case.
    let _ = link.try_write(&held.frame(arm, hello.sequence, 0).encode());
}

impl ByteLink for Replayed {
    fn name(&self) -> &str {
        self.link.name()
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        let left = &self.first[self.read..];
        if left.is_empty() {
            return self.link.try_read(buffer);
        }
        let count = left.len().min(buffer.len());
        buffer[..count].copy_from_slice(&left[..count]);
        self.read += count;
        Ok(count)
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        self.link.try_write(bytes)
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        self.link.fd()
    }

    fn has_unread(&self) -> bool {
        self.read < self.first.len() || self.link.has_unread()
    }

    fn warning(&self) -> Option<String> {
        self.link.warning()
    }
}
