//! Who may talk to a gateway on TCP: connections become hosts only here, outside the cycle thread.
//!
//! A connection comes from an address on the list, proves the key and sends HELLO, in this order, within a limited time and without
//! another byte in between. All others are closed, and the cycle thread never
//! learns of them.

use std::io::{ErrorKind, Write as _};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use pb3dp_arm_pa10::arm::KeyedLink;
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    Agreement, ArmId, FRAME_BYTES_MAX, FirstFrame, Frame, GatewayMessage, HELLO, Handshake, Holder, Reject,
    RejectReason, SharedKey, Side, first_frame,
};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::key_file::random_bytes;
use pb3dp_hal_platform::tcp::TcpLink;
use pb3dp_hal_platform::transport::ByteLink;

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
    pub peer: SocketAddr,
}

/// Counts of connections.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AdmissionCounters {
    /// Admitted.
    pub admitted: u64,
    /// Refused or closed.
    pub refused: u64,
}

/// Admits hosts at a TCP port.
pub struct Admission {
    listener: TcpListener,
    arm: ArmId,
    access: Access,
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
    peer: SocketAddr,
    ends: MonotonicTime,
    stage: Stage,
    bytes: [u8; FRAME_BYTES_MAX],
    length: usize,
}

enum Stage {
    ClientNonce(TcpLink),
    Proof(TcpLink, Box<Agreement>),
    Hello(Box<KeyedLink<TcpLink>>),
    Gone,
}

/// What became of a connection.
enum Outcome {
    Waits,
    Hello(Frame),
    Refused(&'static str),
}

impl Admission {
    /// Admits hosts of an arm at this listener, which must not block.
    pub fn new(listener: TcpListener, arm: ArmId, access: Access) -> Self {
        let start = MonotonicTime::ZERO;
        Self {
            listener,
            arm,
            access,
            waiting: Vec::with_capacity(WAITING_MAX),
            budget: Budget { left: CONNECTIONS_PER_SECOND, since: start },
            accepts_again: start,
            counters: AdmissionCounters::default(),
            log: RefusalLog { again: start, untold: 0 },
        }
    }

    /// Address of the listener.
    pub fn address(&self) -> Option<SocketAddr> {
        self.listener.local_addr().ok()
    }

    /// Counts so far.
    pub fn counters(&self) -> AdmissionCounters {
        self.counters
    }

    /// The next host, if one has proven its key and sent HELLO. If another host holds the gateway, that one is refused by name.
    pub fn poll(
        &mut self,
        now: MonotonicTime,
        holder: Option<SocketAddr>,
        tell: &mut dyn FnMut(String),
    ) -> Option<Admitted> {
        self.accept(now, tell);
        let mut index = 0;
        while index < self.waiting.len() {
            let outcome = self.waiting[index].advance(now, self.arm, &self.access.key);
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
                        tell_holder(&mut link, self.arm, &hello, holder);
                        self.refuse(now, peer, "another host is connected", tell);
                        continue;
                    }
                    link.put_back(&hello.encode());
                    self.counters.admitted += 1;
                    return Some(Admitted { link, peer });
                }
            }
        }
        None
    }

    /// What to wait for: new connections, unless there was a flood, and the next bytes of those that are examined.
    pub fn fds(&self, now: MonotonicTime) -> Vec<BorrowedFd<'_>> {
        let listener = (now >= self.accepts_again).then(|| self.listener.as_fd());
        listener.into_iter().chain(self.waiting.iter().filter_map(Opening::fd)).collect()
    }

    fn accept(&mut self, now: MonotonicTime, tell: &mut dyn FnMut(String)) {
        if now < self.accepts_again {
            return;
        }
        for _ in 0..ACCEPTED_MAX {
            let (stream, peer) = match self.listener.accept() {
                Ok(accepted) => accepted,
                Err(error) => {
                    // Without file descriptors the listener stays readable.
                    if error.kind() != ErrorKind::WouldBlock {
                        self.accepts_again = now + PAUSE;
                    }
                    return;
                }
            };
            let (reason, why) = if !self.access.peers.contains(&peer.ip().to_canonical()) {
                (RejectReason::PeerNotAllowed, "its address is not on the list")
            } else if self.waiting.len() >= WAITING_MAX || !self.budget.take(now) {
                self.accepts_again = now + PAUSE;
                (RejectReason::TooManyPeers, "too many new connections")
            } else if let Ok(link) = TcpLink::from_stream(stream) {
                self.waiting.push(Opening::new(link, peer, now + OPENING_MAX));
                continue;
            } else {
                continue;
            };
            reject(stream, self.arm, reason);
            self.refuse(now, peer, why, tell);
        }
        self.accepts_again = now + PAUSE;
    }

    fn refuse(&mut self, now: MonotonicTime, peer: SocketAddr, why: &str, tell: &mut dyn FnMut(String)) {
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
    fn new(link: TcpLink, peer: SocketAddr, ends: MonotonicTime) -> Self {
        Self { peer, ends, stage: Stage::ClientNonce(link), bytes: [0; FRAME_BYTES_MAX], length: 0 }
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        match &self.stage {
            Stage::ClientNonce(link) | Stage::Proof(link, _) => link.fd(),
            Stage::Hello(link) => link.fd(),
            Stage::Gone => None,
        }
    }

    fn link(&mut self) -> Option<&mut dyn ByteLink> {
        match &mut self.stage {
            Stage::ClientNonce(link) | Stage::Proof(link, _) => Some(link),
            Stage::Hello(link) => Some(link.as_mut()),
            Stage::Gone => None,
        }
    }

    fn advance(&mut self, now: MonotonicTime, arm: ArmId, key: &SharedKey) -> Outcome {
        loop {
            let frame = match self.read() {
                Ok(Some(frame)) => frame,
                Ok(None) if now >= self.ends => return Outcome::Refused("it did not prove the key in time"),
                Ok(None) => return Outcome::Waits,
                Err(why) => return Outcome::Refused(why),
            };
            if frame.arm != arm {
                self.reject(arm, RejectReason::WrongArm);
                return Outcome::Refused("it wants another arm");
            }
            self.stage = match std::mem::replace(&mut self.stage, Stage::Gone) {
                Stage::ClientNonce(link) => match challenge(link, &frame, arm, key) {
                    Ok(next) => next,
                    Err(why) => return Outcome::Refused(why),
                },
                Stage::Proof(link, agreement) => match Handshake::decode(&frame) {
                    Ok(Handshake::Proof(proof)) if agreement.is_proof(Side::Host, &proof) => {
                        Stage::Hello(Box::new(KeyedLink::new(link, &agreement, Side::Gateway)))
                    }
                    _ => {
                        self.stage = Stage::Proof(link, agreement);
                        self.reject(arm, RejectReason::KeyMismatch);
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
            let Some(link) = self.link() else { return Err("it is closed") };
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
            Stage::Hello(_) => "it closed the connection, or sent a record that is not authentic",
            Stage::ClientNonce(_) | Stage::Gone => "it closed the connection without a frame",
        }
    }

    fn reject(&mut self, arm: ArmId, reason: RejectReason) {
        if let Some(link) = self.link() {
            // The connection ends in any case.
            let _ = link.try_write(&refusal(arm, reason));
        }
    }
}

/// Answers the client's nonce with the nonce and the proof of the gateway.
fn challenge(mut link: TcpLink, frame: &Frame, arm: ArmId, key: &SharedKey) -> Result<Stage, &'static str> {
    let Ok(Handshake::ClientNonce(host)) = Handshake::decode(frame) else {
        let _ = link.try_write(&refusal(arm, RejectReason::KeyMismatch));
        return Err("it does not prove a key");
    };
    let nonce = random_bytes().map_err(|_| "the system gives no random bytes")?;
    let agreement = Agreement::new(*key, arm, host, nonce);
    let answer = Handshake::Challenge(nonce, agreement.proof(Side::Gateway)).frame(arm).encode();
    match link.try_write(&answer) {
        Ok(count) if count == answer.len() => Ok(Stage::Proof(link, Box::new(agreement))),
        _ => Err("it does not take the answer"),
    }
}

fn refusal(arm: ArmId, reason: RejectReason) -> pb3dp_arm_pa10_protocol::gateway_protocol::FrameBytes {
    GatewayMessage::Reject(Reject { reason, frame_type: 0, detail: 0 }).frame(arm, 0, 0).encode()
}

/// A refusal on a connection that is closed at once.
fn reject(mut stream: TcpStream, arm: ArmId, reason: RejectReason) {
    if stream.set_nonblocking(true).is_ok() {
        let _ = stream.write(&refusal(arm, reason));
    }
}

fn tell_holder(link: &mut KeyedLink<TcpLink>, arm: ArmId, hello: &Frame, holder: SocketAddr) {
    let held = GatewayMessage::Held(Holder { address: holder.ip().to_canonical(), port: holder.port() });
    // The connection ends in any case.
    let _ = link.try_write(&held.frame(arm, hello.sequence, 0).encode());
}
