//! How the threads of a run in the machine's time hand over what they have: newest wins.
//!
//! What reaches the thread that moves the arms goes through [`latest`]: neither end ever waits, locks or takes from the heap. Between
//! threads that may wait for a moment there is [`Newest`].

use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use triple_buffer::{Input, Output, triple_buffer};

/// The end that gives.
pub struct Giver<T: Send>(Input<Option<T>>);

/// The end that takes.
pub struct Taker<T: Send>(Output<Option<T>>);

/// Both ends of a place for the newest item, for one thread each.
pub fn latest<T: Copy + Send>() -> (Giver<T>, Taker<T>) {
    let (input, output) = triple_buffer(&None);
    (Giver(input), Taker(output))
}

impl<T: Copy + Send> Giver<T> {
    /// Puts an item there; whether the one before was taken by nobody.
    pub fn give(&mut self, item: T) -> bool {
        *self.0.input_buffer_mut() = Some(item);
        self.0.publish()
    }
}

impl<T: Copy + Send> Taker<T> {
    /// The newest item, if it was not taken before.
    pub fn take(&mut self) -> Option<T> {
        if self.0.update() { *self.0.output_buffer() } else { None }
    }
}

/// A place for the newest item, whose taker waits for it.
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
    /// Puts an item there; whether the one before was taken by nobody.
    pub fn give(&self, item: T) -> bool {
        // What is overwritten may be large: it goes when the slot is free again.
        let before = self.slot.lock().unwrap_or_else(PoisonError::into_inner).replace(item);
        self.given.notify_one();
        before.is_some()
    }

    /// Takes the newest item, and waits for it as long as this at most.
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
        let (mut giver, mut taker) = latest();
        assert_eq!(taker.take(), None);
        assert!(!giver.give(1));
        assert!(giver.give(2), "nobody has taken the first one");
        assert_eq!((taker.take(), taker.take()), (Some(2), None));
        assert!(!giver.give(3));
        assert_eq!(taker.take(), Some(3));
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
