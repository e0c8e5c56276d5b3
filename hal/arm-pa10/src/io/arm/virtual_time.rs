//! Arms in virtual time: what their threads, lines, gateways and servo controllers do happens when somebody sleeps, in the order of its
//! times and in one thread.
//!
//! [`VirtualTime`] stands in the place of the clock. Whoever waits until a time lets everything happen that is due before it; the work
//! of an arm's thread is that of the real one, turn for turn. The same commands at the same times give the same bytes.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::Clock;

use super::shared::Shared;
use super::virtual_line::{SharedLine, VirtualLine, VirtualPort, lock};
use super::worker::Worker;
use crate::far_end::FarEnd;
use crate::io::transport::Connector;
use crate::mock_controller::LineError;

/// Time that passes only when somebody sleeps, and the arms that live in it.
pub struct VirtualTime {
    clock: Arc<dyn Clock>,
    arms: Mutex<Vec<Stepped>>,
}

/// One arm.
struct Stepped {
    worker: Worker,
    end: VirtualEnd,
    /// When there was something to do last: time goes on after it.
    worked_at: MonotonicTime,
    /// When the worker looks around by itself.
    turn_at: MonotonicTime,
}

/// The far end of the line of an arm in virtual time: what an operator and a test can do there.
#[derive(Clone, Debug)]
pub struct VirtualEnd {
    far: Arc<Mutex<FarEnd>>,
    line: SharedLine,
    /// Something was done that the host has not seen.
    touched: Arc<AtomicBool>,
}

impl VirtualTime {
    /// Over a clock that shows simulated time, and passes when somebody sleeps.
    pub fn over(clock: Arc<dyn Clock>) -> Self {
        Self { clock, arms: Mutex::default() }
    }

    /// Whether no arm lives in it.
    pub fn is_empty(&self) -> bool {
        lock(&self.arms).is_empty()
    }

    pub(super) fn add(&self, mut worker: Worker, end: VirtualEnd) {
        let now = self.clock.now();
        worker.turn();
        lock(&self.arms).push(Stepped { worker, end, worked_at: now, turn_at: now });
    }

    /// An arm whose owner is gone is stopped, at most until then.
    pub(super) fn let_go(&self, shared: &Arc<Shared>, deadline: MonotonicTime) {
        let lives = || lock(&self.arms).iter().any(|arm| Arc::ptr_eq(&arm.worker.shared, shared));
        while lives() && self.step(deadline) {}
        lock(&self.arms).retain(|arm| !Arc::ptr_eq(&arm.worker.shared, shared));
    }

    /// Lets the next thing happen, if it happens until then; else time goes on to then, and `false` comes back.
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
        if self.worker.seat.is_woken() || self.end.touched.load(Ordering::Acquire) {
            return now;
        }
        let line = lock(&self.end.line);
        let far = lock(&self.end.far);
        let heard = line.to_gateway.next_arrival().map(|at| match far.controller.readable_on_line(at.max(now)) {
            0 => far.controller.reads_line_again().unwrap_or(self.turn_at),
            _ => at,
        });
        let due = [heard, line.to_host.next_arrival(), far.next_deadline()];
        let next = due.into_iter().flatten().fold(self.turn_at, MonotonicTime::min);
        next.max(self.worked_at + Duration::from_nanos(1))
    }

    fn work(&mut self, now: MonotonicTime) {
        self.worked_at = now;
        let mut line = lock(&self.end.line);
        let arrives = line.to_host.next_arrival().is_some_and(|at| at <= now);
        self.end.work(now, &mut line);
        drop(line);
        let is_touched = self.end.touched.swap(false, Ordering::AcqRel);
        if arrives || is_touched || self.worker.seat.is_woken() || self.turn_at <= now {
            self.worker.turn();
            self.turn_at = now + self.worker.idle_for(now);
        }
    }
}

impl VirtualEnd {
    /// The far end of a line of so many bits per second.
    pub fn new(far: FarEnd, baud: u32) -> Self {
        Self {
            far: Arc::new(Mutex::new(far)),
            line: Arc::new(Mutex::new(VirtualLine::new(baud))),
            touched: Arc::default(),
        }
    }

    pub(super) fn port(&self, clock: &Arc<dyn Clock>) -> Box<dyn Connector> {
        Box::new(VirtualPort { line: Arc::clone(&self.line), clock: Arc::clone(clock) })
    }

    /// Looks at gateway and controller.
    pub fn look<T>(&self, look: impl FnOnce(&FarEnd) -> T) -> T {
        look(&lock(&self.far))
    }

    /// Lets something go wrong, or end going wrong: a line as in a script.
    ///
    /// # Errors
    /// Names the word that is wrong and what to write instead; nothing happens then.
    pub fn command_line(&self, line: &str) -> Result<(), LineError> {
        let mut far = lock(&self.far);
        let now = far.now();
        far.controller.command_line(now, line)
    }

    /// Pulls the cable: both sides notice.
    pub fn unplug(&self) {
        self.set_plugged(false);
    }

    /// Plugs the cable in again. The arm is had again by a reset.
    pub fn plug(&self) {
        self.set_plugged(true);
    }

    fn set_plugged(&self, is_plugged: bool) {
        let mut line = lock(&self.line);
        if line.is_plugged() != is_plugged {
            line.set_plugged(is_plugged);
            lock(&self.far).hang_up();
            self.touched.store(true, Ordering::Release);
        }
    }

    /// Everything that is due here.
    fn work(&self, now: MonotonicTime, line: &mut VirtualLine) {
        let mut far = lock(&self.far);
        far.advance(now, |_| {});
        let mut buffer = [0; 512];
        let room = far.controller.readable_on_line(now).min(buffer.len());
        let count = line.to_gateway.take(now, &mut buffer[..room]);
        if count > 0 {
            far.hear(now, &buffer[..count]);
            far.exchange(&mut |_| {});
        }
        far.answer(now, |bytes| {
            if line.is_plugged() {
                line.answer(now, bytes);
            }
        });
    }
}
