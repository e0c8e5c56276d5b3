//! The line between a host and an emulated arm in simulated time: transmission delays, a cable that can be unplugged, and a key.

use std::collections::VecDeque;
use std::os::fd::BorrowedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use pb3dp_arm_pa10::arm::KeyedLink;
use pb3dp_arm_pa10_protocol::gateway_protocol::{Agreement, ArmId, Opener, Sealer, SharedKey, Side};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_hal_platform::transport::{ByteLink, ConnectError, Connector, Symptom, Unplugged};

/// Bits of a byte on a serial line: start, eight of data, stop.
const BITS_PER_BYTE: u64 = 10;

/// A line with a bit rate, in both directions.
#[derive(Debug)]
pub(super) struct VirtualLine {
    nanos_per_byte: u64,
    is_plugged: bool,
    /// Number of the connection: a link of an earlier one is lost.
    connection: u64,
    /// Number of the program at the host's end: an earlier one has died, and cannot connect again.
    program: u64,
    /// The program at the host's end has died, and no other one has connected: nobody reads.
    is_deserted: bool,
    key: Option<(SharedKey, ArmId)>,
    /// The gateway's side of the connection, if the line has a key.
    session: Option<Session>,
    /// The host has closed the connection, and the gateway does not know yet.
    is_left: bool,
    pub to_gateway: OneWay,
    pub to_host: OneWay,
}

/// The gateway's side of a connection with a key.
#[derive(Debug)]
struct Session {
    sealer: Sealer,
    opener: Opener,
}

/// A direction of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Towards {
    /// From the gateway to the host.
    Host,
    /// From the host to the gateway.
    Gateway,
}

/// Something that somebody on the line does to the next bytes that are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tampering {
    /// One bit of them is changed.
    Changed,
    /// They arrive twice.
    Repeated,
    /// They do not arrive.
    Removed,
}

/// Bytes in one direction, in the order in which they were sent.
#[derive(Debug, Default)]
pub(super) struct OneWay {
    bytes: VecDeque<u8>,
    /// Arrival time of this number of bytes.
    pieces: VecDeque<(MonotonicTime, usize)>,
    tampering: Option<Tampering>,
}

/// State shared by both ends.
pub(super) type SharedLine = Arc<Mutex<VirtualLine>>;

/// The line cannot be opened.
#[derive(Debug, thiserror::Error)]
#[error("the cable of the emulated arm is unplugged; plug it in again")]
struct NotPlugged;

impl VirtualLine {
    /// A line with this bit rate.
    pub fn new(baud: u32) -> Self {
        Self {
            nanos_per_byte: 1_000_000_000 * BITS_PER_BYTE / u64::from(baud.max(1)),
            is_plugged: true,
            connection: 0,
            program: 0,
            is_deserted: false,
            key: None,
            session: None,
            is_left: false,
            to_gateway: OneWay::default(),
            to_host: OneWay::default(),
        }
    }

    pub fn set_key(&mut self, key: SharedKey, arm: ArmId) {
        self.key = Some((key, arm));
    }

    /// Transmission time of bytes.
    pub fn time_of(&self, count: usize) -> Duration {
        Duration::from_nanos(self.nanos_per_byte * count as u64)
    }

    pub fn is_plugged(&self) -> bool {
        self.is_plugged
    }

    pub fn has_key(&self) -> bool {
        self.key.is_some()
    }

    /// Number of the program at the host's end.
    pub fn program(&self) -> u64 {
        self.program
    }

    /// Unplugs the cable, or plugs it in again; the content of the line is lost.
    pub fn set_plugged(&mut self, is_plugged: bool) {
        self.connection += u64::from(is_plugged && !self.is_plugged);
        self.is_plugged = is_plugged;
        (self.to_gateway, self.to_host, self.session) = (OneWay::default(), OneWay::default(), None);
    }

    /// The connection ends at both sides; the content of the line is lost.
    pub fn cut(&mut self) {
        self.connection += 1;
        (self.to_gateway, self.to_host, self.session) = (OneWay::default(), OneWay::default(), None);
    }

    /// The program at the host's end dies. What it has sent arrives, if nobody closes the connection.
    pub fn lose_program(&mut self, is_closed: bool) {
        self.program += 1;
        (self.is_deserted, self.to_host) = (true, OneWay::default());
        if is_closed && self.has_key() {
            self.cut();
            self.is_left = true;
        }
    }

    /// Whether the host has closed the connection since the last call.
    pub fn take_left(&mut self) -> bool {
        std::mem::take(&mut self.is_left)
    }

    /// A new connection of the host, whose handshake is done. Its nonces count the connections, so that a run repeats itself.
    fn agree(&mut self) -> Option<Agreement> {
        let (key, arm) = self.key?;
        let nonce = |side: u8| {
            let mut nonce = [side; 32];
            nonce[..8].copy_from_slice(&self.connection.to_le_bytes());
            nonce
        };
        let agreement = Agreement::new(key, arm, nonce(1), nonce(2));
        let (sealer, opener) = agreement.records(Side::Gateway);
        self.session = Some(Session { sealer, opener });
        Some(agreement)
    }

    /// Passes bytes of the host to the gateway; `false` if one of the records is not authentic.
    pub fn open(&mut self, bytes: &[u8], mut gateway: impl FnMut(&[u8])) -> bool {
        match (&mut self.session, &self.key) {
            (Some(session), _) => session.opener.feed(bytes, gateway).is_ok(),
            // Bytes of a connection that has ended.
            (None, Some(_)) => true,
            (None, None) => {
                gateway(bytes);
                true
            }
        }
    }

    /// An answer of the gateway that is sent now.
    pub fn answer(&mut self, now: MonotonicTime, bytes: &[u8]) {
        let sealed = self.session.as_mut().map(|session| session.sealer.seal(bytes));
        let bytes = match &sealed {
            Some(sealed) => sealed,
            None if self.has_key() => return,
            None => bytes,
        };
        if self.is_deserted {
            return;
        }
        let time = self.time_of(bytes.len());
        self.to_host.send(now, bytes, time);
    }

    /// What happens to the next bytes in this direction.
    pub fn tamper(&mut self, towards: Towards, tampering: Tampering) {
        let way = match towards {
            Towards::Host => &mut self.to_host,
            Towards::Gateway => &mut self.to_gateway,
        };
        way.tampering = Some(tampering);
    }
}

impl OneWay {
    fn send(&mut self, now: MonotonicTime, bytes: &[u8], takes: Duration) {
        match self.tampering.take() {
            Some(Tampering::Removed) => return,
            Some(Tampering::Repeated) => self.send(now, bytes, takes),
            Some(Tampering::Changed) => {
                self.send(now, bytes, takes);
                if let Some(last) = self.bytes.back_mut() {
                    *last ^= 1;
                }
                return;
            }
            None => {}
        }
        let free = self.pieces.back().map_or(now, |(last, _)| now.max(*last));
        self.bytes.extend(bytes);
        self.pieces.push_back((free + takes, bytes.len()));
    }

    /// Arrival time of the next bytes.
    pub fn next_arrival(&self) -> Option<MonotonicTime> {
        self.pieces.front().map(|(at, _)| *at)
    }

    /// Reads arrived bytes, as many as fit.
    pub fn take(&mut self, now: MonotonicTime, buffer: &mut [u8]) -> usize {
        let mut taken = 0;
        while let Some((_, left)) = self.pieces.front_mut().filter(|(at, _)| *at <= now) {
            let count = (*left).min(buffer.len() - taken);
            buffer[taken..].iter_mut().zip(self.bytes.drain(..count)).for_each(|(place, byte)| *place = byte);
            taken += count;
            *left -= count;
            if *left > 0 {
                break;
            }
            self.pieces.pop_front();
        }
        taken
    }
}

/// The host's end of a line.
struct VirtualLink {
    line: SharedLine,
    clock: Arc<dyn Clock>,
    connection: u64,
    program: u64,
    /// The gateway has something to notice.
    touched: Arc<AtomicBool>,
}

/// Opens the host's end, each time that the cable is plugged in.
pub(super) struct VirtualPort {
    pub line: SharedLine,
    pub clock: Arc<dyn Clock>,
    pub program: u64,
    pub touched: Arc<AtomicBool>,
}

impl Connector for VirtualPort {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        let mut line = lock(&self.line);
        if !line.is_plugged || line.program != self.program {
            return Err(NotPlugged.into());
        }
        line.is_deserted = false;
        let agreement = line.agree();
        let link = VirtualLink {
            line: Arc::clone(&self.line),
            clock: Arc::clone(&self.clock),
            connection: line.connection,
            program: self.program,
            touched: Arc::clone(&self.touched),
        };
        drop(line);
        Ok(match agreement {
            Some(agreement) => Box::new(KeyedLink::new(link, &agreement, Side::Host)),
            None => Box::new(link),
        })
    }

    fn target(&self) -> String {
        "emulated in virtual time".to_owned()
    }
}

impl VirtualLink {
    fn is_there(&self, line: &VirtualLine) -> bool {
        line.is_plugged && (line.connection, line.program) == (self.connection, self.program)
    }

    fn line(&self) -> Result<MutexGuard<'_, VirtualLine>, Unplugged> {
        let line = lock(&self.line);
        if self.is_there(&line) { Ok(line) } else { Err(Unplugged { symptom: Symptom::EndOfStream }) }
    }
}

impl Drop for VirtualLink {
    /// A serial line does not show that its host has closed it; a connection with a key does.
    fn drop(&mut self) {
        let mut line = lock(&self.line);
        if line.has_key() && self.is_there(&line) {
            line.cut();
            line.is_left = true;
            self.touched.store(true, Ordering::Release);
        }
    }
}

impl ByteLink for VirtualLink {
    fn name(&self) -> &str {
        "virtual line"
    }

    fn try_read(&mut self, buffer: &mut [u8]) -> Result<usize, Unplugged> {
        let now = self.clock.now();
        Ok(self.line()?.to_host.take(now, buffer))
    }

    fn try_write(&mut self, bytes: &[u8]) -> Result<usize, Unplugged> {
        let now = self.clock.now();
        let mut line = self.line()?;
        let time = line.time_of(bytes.len());
        line.to_gateway.send(now, bytes, time);
        Ok(bytes.len())
    }

    fn fd(&self) -> Option<BorrowedFd<'_>> {
        None
    }
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
