//! The line between a host and an emulated arm in simulated time: transmission delays, and a cable that can be unplugged.

use std::collections::VecDeque;
use std::os::fd::BorrowedFd;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

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
    /// Number of connections: a link that was opened before the last one is lost.
    plugged_in: u64,
    pub to_gateway: OneWay,
    pub to_host: OneWay,
}

/// Bytes in one direction, in the order in which they were sent.
#[derive(Debug, Default)]
pub(super) struct OneWay {
    bytes: VecDeque<u8>,
    /// Arrival time of this number of bytes.
    pieces: VecDeque<(MonotonicTime, usize)>,
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
            plugged_in: 0,
            to_gateway: OneWay::default(),
            to_host: OneWay::default(),
        }
    }

    /// Transmission time of bytes.
    pub fn time_of(&self, count: usize) -> Duration {
        Duration::from_nanos(self.nanos_per_byte * count as u64)
    }

    pub fn is_plugged(&self) -> bool {
        self.is_plugged
    }

    /// Unplugs the cable, or plugs it in again; the content of the line is lost.
    pub fn set_plugged(&mut self, is_plugged: bool) {
        self.plugged_in += u64::from(is_plugged && !self.is_plugged);
        self.is_plugged = is_plugged;
        (self.to_gateway, self.to_host) = (OneWay::default(), OneWay::default());
    }

    /// An answer of the gateway that is sent now.
    pub fn answer(&mut self, now: MonotonicTime, bytes: &[u8]) {
        let time = self.time_of(bytes.len());
        self.to_host.send(now, bytes, time);
    }
}

impl OneWay {
    fn send(&mut self, now: MonotonicTime, bytes: &[u8], takes: Duration) {
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
    plugged_in: u64,
}

/// Opens the host's end, each time that the cable is plugged in.
pub(super) struct VirtualPort {
    pub line: SharedLine,
    pub clock: Arc<dyn Clock>,
}

impl Connector for VirtualPort {
    fn connect(&mut self) -> Result<Box<dyn ByteLink>, ConnectError> {
        let line = lock(&self.line);
        if !line.is_plugged {
            return Err(NotPlugged.into());
        }
        let plugged_in = line.plugged_in;
        drop(line);
        Ok(Box::new(VirtualLink { line: Arc::clone(&self.line), clock: Arc::clone(&self.clock), plugged_in }))
    }

    fn target(&self) -> String {
        "emulated in virtual time".to_owned()
    }
}

impl VirtualLink {
    fn line(&self) -> Result<MutexGuard<'_, VirtualLine>, Unplugged> {
        let line = lock(&self.line);
        let is_there = line.is_plugged && line.plugged_in == self.plugged_in;
        if is_there { Ok(line) } else { Err(Unplugged { symptom: Symptom::EndOfStream }) }
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
