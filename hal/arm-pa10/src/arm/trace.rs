//! Raw bytes of the last seconds, to analyse a fault.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use pb3dp_arm_pa10_protocol::codec::ByteBuffer;
use pb3dp_geometry::MonotonicTime;

/// Bytes of one entry; longer pieces take several. A frame of the gateway's protocol fits.
const PIECE: usize = 160;

/// Number of entries: two seconds of commands and answers at 500 per second.
const ENTRIES: usize = 2000;

/// Capacity for entries while a reader holds the lock.
const WAITING_MAX: usize = 32;

/// Bytes on the line at one time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawBytes {
    /// Time at which they were sent or received.
    pub at: MonotonicTime,
    /// Direction.
    pub way: Direction,
    bytes: ByteBuffer<PIECE>,
}

/// Direction of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// To gateway or controller.
    Out,
    /// From gateway or controller.
    In,
}

impl RawBytes {
    /// The bytes.
    pub fn bytes(&self) -> &[u8] {
        self.bytes.as_slice()
    }
}

/// The record; clones share it.
#[derive(Clone, Debug)]
pub(super) struct Trace {
    ring: Arc<Mutex<VecDeque<RawBytes>>>,
}

/// The thread's side: never blocks. While a reader holds the lock, a few entries are buffered, and more are dropped.
#[derive(Debug)]
pub(super) struct Tracer {
    trace: Trace,
    waiting: VecDeque<RawBytes>,
}

impl Trace {
    pub fn new() -> Self {
        Self { ring: Arc::new(Mutex::new(VecDeque::with_capacity(ENTRIES))) }
    }

    /// Oldest first.
    pub fn entries(&self) -> Vec<RawBytes> {
        // Allocates before taking the lock, so that the thread of the arm never waits for an allocation.
        let mut entries = Vec::with_capacity(ENTRIES);
        entries.extend(self.ring.lock().unwrap_or_else(PoisonError::into_inner).iter().copied());
        entries
    }
}

impl Tracer {
    pub fn new(trace: Trace) -> Self {
        Self { trace, waiting: VecDeque::with_capacity(WAITING_MAX) }
    }

    pub fn record(&mut self, at: MonotonicTime, way: Direction, bytes: &[u8]) {
        for piece in bytes.chunks(PIECE) {
            if let (true, Some(bytes)) = (self.waiting.len() < WAITING_MAX, ByteBuffer::from_slice(piece)) {
                self.waiting.push_back(RawBytes { at, way, bytes });
            }
        }
        let Ok(mut ring) = self.trace.ring.try_lock() else { return };
        for entry in self.waiting.drain(..) {
            if ring.len() == ENTRIES {
                ring.pop_front();
            }
            ring.push_back(entry);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(count: usize) -> MonotonicTime {
        MonotonicTime::from_nanos(count as u64)
    }

    #[test]
    fn the_last_entries_are_kept_in_order_and_long_ones_in_pieces() {
        let trace = Trace::new();
        let mut tracer = Tracer::new(trace.clone());
        for count in 0..ENTRIES + 10 {
            tracer.record(at(count), if count % 2 == 0 { Direction::Out } else { Direction::In }, &[count as u8, 7]);
        }
        let entries = trace.entries();
        assert_eq!(entries.len(), ENTRIES);
        assert_eq!((entries[0].at, entries[0].way, entries[0].bytes()), (at(10), Direction::Out, &[10, 7][..]));
        assert!(entries.is_sorted_by_key(|entry| entry.at));
        let long: Vec<u8> = (0..=255).collect();
        tracer.record(at(9999), Direction::In, &long);
        let last: Vec<u8> = trace.entries()[ENTRIES - 2..].iter().flat_map(|entry| entry.bytes().to_vec()).collect();
        assert_eq!(last, long);
    }

    #[test]
    fn a_reader_holds_nothing_up_and_loses_little() {
        let trace = Trace::new();
        let mut tracer = Tracer::new(trace.clone());
        let reading = trace.ring.lock().unwrap();
        for count in 0..WAITING_MAX + 5 {
            tracer.record(at(count), Direction::Out, &[1]);
        }
        drop(reading);
        assert_eq!(trace.entries(), []);
        tracer.record(at(9999), Direction::In, &[2]);
        // The reader held the lock for longer than the buffer lasts.
        assert_eq!(trace.entries().len(), WAITING_MAX);
        tracer.record(at(10_000), Direction::In, &[3]);
        assert_eq!(trace.entries().last().unwrap().bytes(), [3]);
    }
}
