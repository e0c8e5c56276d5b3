//! Handover of the newest item between the threads of a real-time run.
//!
//! Data for the thread that moves the arms goes through [`latest`]: neither end ever waits, locks or allocates. Threads that may wait use
//! [`Newest`].

use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use triple_buffer::{Input, Output, triple_buffer};

/// The producer end.
pub struct LatestProducer<T: Send>(Input<Option<T>>);

/// The consumer end.
pub struct LatestConsumer<T: Send>(Output<Option<T>>);

/// Both ends of a slot for the newest item, one thread each.
pub fn latest<T: Copy + Send>() -> (LatestProducer<T>, LatestConsumer<T>) {
    let (input, output) = triple_buffer(&None);
    (LatestProducer(input), LatestConsumer(output))
}

impl<T: Copy + Send> LatestProducer<T> {
    /// Stores an item; returns whether the previous one was overwritten unread.
    pub fn give(&mut self, item: T) -> bool {
        *self.0.input_buffer_mut() = Some(item);
        self.0.publish()
    }
}

impl<T: Copy + Send> LatestConsumer<T> {
    /// The newest item, unless it was already taken.
    pub fn take(&mut self) -> Option<T> {
        if self.0.update() { *self.0.output_buffer() } else { None }
    }
}

/// A slot for the newest item whose consumer waits for it.
pub struct Newest<T> {
    slot: Mutex<Option<T>>,
    given: Condvar,
}

impl<T> Default for Newest<T> {
    fn default() -> Self {
        Self { slot: Mutex::new(None), given: Condvar::new() }
    }
}

impl<T> Newest<T> {
    /// Stores an item; returns whether the previous one was overwritten unread.
    pub fn give(&self, item: T) -> bool {
        // The overwritten item may be large: it is dropped after the lock is released.
        let before = self.slot.lock().unwrap_or_else(PoisonError::into_inner).replace(item);
        self.given.notify_one();
        before.is_some()
    }

    /// Takes the newest item; waits for it up to `timeout`.
    pub fn wait(&self, timeout: Duration) -> Option<T> {
        let slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.given.wait_timeout_while(slot, timeout, |slot| slot.is_none());
        waited.unwrap_or_else(PoisonError::into_inner).0.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_item_wins_and_is_taken_once() {
        let (mut producer, mut consumer) = latest();
        assert_eq!(consumer.take(), None);
        assert!(!producer.give(1));
        assert!(producer.give(2), "the first item was not taken");
        assert_eq!((consumer.take(), consumer.take()), (Some(2), None));
        assert!(!producer.give(3));
        assert_eq!(consumer.take(), Some(3));
    }

    #[test]
    fn who_waits_for_the_newest_item_gets_it_or_goes_on() {
        let newest = Newest::default();
        assert_eq!(newest.wait(Duration::from_millis(1)), None);
        assert!(!newest.give("a"));
        assert!(newest.give("b"));
        assert_eq!(newest.wait(Duration::ZERO), Some("b"));
        let taken = std::thread::scope(|scope| {
            let thread = scope.spawn(|| newest.wait(Duration::from_secs(30)));
            newest.give("c");
            thread.join().unwrap()
        });
        assert_eq!(taken, Some("c"));
    }
}
