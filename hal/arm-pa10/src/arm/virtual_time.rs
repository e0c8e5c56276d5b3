//! Arms in virtual time: the work of their threads, lines, gateways and servo controllers is executed while somebody sleeps,
//! ordered by time, in one thread.
//!
//! [`VirtualTime`] replaces the clock. A wait until a time executes everything that is due before it; the work of an arm's thread
//! is the real one, turn by turn. The same commands at the same times give the same bytes.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;
use pb3dp_hal_platform::transport::Connector;

use super::shared::Shared;
use super::worker::Worker;

/// Time that only passes while somebody sleeps, and its arms.
pub struct VirtualTime {
    clock: Arc<dyn Clock>,
    arms: Mutex<Vec<Stepped>>,
}

/// One arm.
struct Stepped {
    worker: Worker,
    end: Box<dyn VirtualFarEnd>,
    /// Time of the last work: later work is after it.
    worked_at: MonotonicTime,
    /// Time of the next turn of the worker.
    turn_at: MonotonicTime,
}

/// The other end of the line of an arm in virtual time: the peer and the line.
pub trait VirtualFarEnd: Send + Sync {
    /// The host's end.
    fn connector(&self, clock: Arc<dyn Clock>) -> Box<dyn Connector>;

    /// Whether something happened that the host has not seen.
    fn is_touched(&self) -> bool;

    /// Time of the next event here or on the line; `None` without any.
    fn next_deadline(&self, now: MonotonicTime) -> Option<MonotonicTime>;

    /// Executes everything that is due. Returns whether the host must read its line.
    fn work(&self, now: MonotonicTime) -> bool;
}

impl VirtualTime {
    /// Creates virtual time on a clock of simulated time.
    pub fn over(clock: Arc<dyn Clock>) -> Self {
        Self { clock, arms: Mutex::default() }
    }

    /// Whether there is no arm.
    pub fn is_empty(&self) -> bool {
        lock(&self.arms).is_empty()
    }

    pub(super) fn add(&self, mut worker: Worker, end: Box<dyn VirtualFarEnd>) {
        let now = self.clock.now();
        worker.turn();
        lock(&self.arms).push(Stepped { worker, end, worked_at: now, turn_at: now });
    }

    /// An arm whose owner is gone is stopped, by this time at the latest.
    pub(super) fn release(&self, shared: &Arc<Shared>, deadline: MonotonicTime) {
        let lives = || lock(&self.arms).iter().any(|arm| Arc::ptr_eq(&arm.worker.shared, shared));
        while lives() && self.step(deadline) {}
        lock(&self.arms).retain(|arm| !Arc::ptr_eq(&arm.worker.shared, shared));
    }

    /// Executes the next event, if it is due by this time; else advances the time and returns `false`.
    pub(super) fn step(&self, until: MonotonicTime) -> bool {
        let mut arms = lock(&self.arms);
        let now = self.clock.now();
        let next = arms.iter().map(|arm| arm.next(now)).enumerate().min_by_key(|(_, at)| *at);
        let Some((index, at)) = next.filter(|(_, at)| *at <= until) else {
            self.clock.sleep_until(until);
            return false;
        };
        self.clock.sleep_until(at);
        arms[index].work(at);
        if arms[index].worker.is_over() {
            arms.remove(index);
        }
        true
    }
}

impl Clock for VirtualTime {
    fn now(&self) -> MonotonicTime {
        self.clock.now()
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        while self.step(deadline) {}
    }
}

impl Stepped {
    fn next(&self, now: MonotonicTime) -> MonotonicTime {
        if self.worker.seat.is_woken() || self.end.is_touched() {
            return now;
        }
        let next = self.end.next_deadline(now).map_or(self.turn_at, |due| due.min(self.turn_at));
        next.max(self.worked_at + Duration::from_nanos(1))
    }

    fn work(&mut self, now: MonotonicTime) {
        self.worked_at = now;
        if self.end.work(now) || self.worker.seat.is_woken() || self.turn_at <= now {
            self.worker.turn();
            self.turn_at = now + self.worker.idle_for(now);
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
