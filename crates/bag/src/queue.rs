//! A queue between two threads that is limited in items and bytes. A sender never waits, unless it asks for it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::time::Duration;

/// Time between two looks at a full queue.
const LOOK_AFTER: Duration = Duration::from_millis(1);

/// What happens to a message when the queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// It is dropped and counted: in real time.
    Drop,
    /// The caller waits: in simulated time.
    Wait,
}

#[derive(Debug, Default)]
struct Load {
    items: AtomicU64,
    bytes: AtomicU64,
    /// The receiver is gone.
    is_closed: AtomicBool,
}

/// The end that puts items in.
#[derive(Debug)]
pub(crate) struct Sender<T> {
    channel: mpsc::Sender<(T, u64)>,
    load: Arc<Load>,
    items_max: u64,
    bytes_max: u64,
}

/// The end that takes items out.
#[derive(Debug)]
pub(crate) struct Receiver<T> {
    channel: mpsc::Receiver<(T, u64)>,
    load: Arc<Load>,
}

/// A queue of at most `items_max` items of `bytes_max` bytes in all; a single item may be longer.
pub(crate) fn bounded<T>(items_max: u64, bytes_max: u64) -> (Sender<T>, Receiver<T>) {
    let (sender, receiver) = mpsc::channel();
    let load = Arc::new(Load::default());
    (Sender { channel: sender, load: Arc::clone(&load), items_max, bytes_max }, Receiver { channel: receiver, load })
}

impl<T> Sender<T> {
    /// Puts an item of that many bytes in; false if it was dropped, since the queue is full or has no receiver any more.
    pub(crate) fn send(&self, item: T, bytes: u64, when_full: WhenFull) -> bool {
        while self.is_full(bytes) {
            if when_full == WhenFull::Drop || self.load.is_closed.load(Ordering::SeqCst) {
                return false;
            }
            std::thread::sleep(LOOK_AFTER);
        }
        self.put(item, bytes)
    }

    /// Puts an item in, also into a full queue: for the few that must not be lost.
    pub(crate) fn put(&self, item: T, bytes: u64) -> bool {
        self.load.items.fetch_add(1, Ordering::SeqCst);
        self.load.bytes.fetch_add(bytes, Ordering::SeqCst);
        self.channel.send((item, bytes)).is_ok()
    }

    fn is_full(&self, more: u64) -> bool {
        let (items, bytes) = (self.load.items.load(Ordering::SeqCst), self.load.bytes.load(Ordering::SeqCst));
        items >= self.items_max || (items > 0 && bytes.saturating_add(more) > self.bytes_max)
    }
}

impl<T> Receiver<T> {
    /// Waits for the next item.
    pub(crate) fn recv_timeout(&self, timeout: Duration) -> Result<T, mpsc::RecvTimeoutError> {
        self.channel.recv_timeout(timeout).map(|taken| self.taken(taken))
    }

    /// Waits for the next item; `None` after the last one of a sender that is gone.
    pub(crate) fn recv(&self) -> Option<T> {
        self.channel.recv().ok().map(|taken| self.taken(taken))
    }

    /// The next item, if there is one.
    pub(crate) fn try_recv(&self) -> Option<T> {
        self.channel.try_recv().ok().map(|taken| self.taken(taken))
    }

    fn taken(&self, (item, bytes): (T, u64)) -> T {
        self.load.items.fetch_sub(1, Ordering::SeqCst);
        self.load.bytes.fetch_sub(bytes, Ordering::SeqCst);
        item
    }
}

impl<T> Drop for Receiver<T> {
    fn drop(&mut self) {
        self.load.is_closed.store(true, Ordering::SeqCst);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_queue_drops_by_items_and_by_bytes() {
        let (sender, receiver) = bounded(3, 100);
        assert!(sender.send(1, 1000, WhenFull::Drop), "a single item may be longer");
        assert!(!sender.send(2, 1, WhenFull::Drop));
        assert_eq!(receiver.try_recv(), Some(1));
        assert!(sender.send(3, 60, WhenFull::Drop) && !sender.send(4, 60, WhenFull::Drop));
        assert!(sender.send(5, 10, WhenFull::Drop) && sender.send(6, 10, WhenFull::Drop));
        assert!(!sender.send(7, 10, WhenFull::Drop));
        assert!(sender.put(8, 10), "what must not be lost");
        let taken: Vec<i32> = std::iter::from_fn(|| receiver.try_recv()).collect();
        assert_eq!(taken, [3, 5, 6, 8]);
        drop(receiver);
        assert!(!sender.send(9, 1, WhenFull::Drop));
    }

    #[test]
    fn a_sender_that_waits_ends_with_its_receiver() {
        let (sender, receiver) = bounded(1, 100);
        assert!(sender.send(1, 1, WhenFull::Wait));
        let waiting =
            std::thread::spawn(move || (sender.send(2, 1, WhenFull::Wait), sender.send(3, 1, WhenFull::Wait)));
        assert_eq!((receiver.recv(), receiver.recv()), (Some(1), Some(2)));
        drop(receiver);
        assert!(waiting.join().unwrap().0);
        let (sender, receiver) = bounded(1, 100);
        assert!(sender.send(1, 1, WhenFull::Wait));
        let waiting = std::thread::spawn(move || sender.send(2, 1, WhenFull::Wait));
        std::thread::sleep(Duration::from_millis(20));
        drop(receiver);
        assert!(!waiting.join().unwrap());
    }
}
