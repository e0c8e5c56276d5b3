//! State shared by the thread of an arm and its owner.
//!
//! The thread never waits for a lock: if the owner holds one, the thread continues and tries again later. The owner only waits for
//! the thread's short copies. Observers have a copy of their own: a preempted observer delays neither the thread nor the owner.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_arm_pa10_protocol::gateway_protocol::{HelloReply, ParserCounters};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{ArmState, JointCommand};
use pb3dp_hal_platform::jitter::{Jitter, JitterMeter};
use pb3dp_hal_platform::transport::Unplugged;
use pb3dp_kinematics::JointState;

use super::trace::{RawBytes, Trace};
use crate::driver::{Activity, AxisLimits, DriverState, Latched, LinkCounters, Sample};

/// Snapshot of an arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmSnapshot {
    /// State of the driver.
    pub state: DriverState,
    /// Current activity.
    pub activity: Activity,
    /// Cause of the stop, if it is stopped.
    pub latched: Option<Latched>,
    /// Cause of the loss of the link, if it is lost.
    pub unplugged: Option<Unplugged>,
    /// The thread of the arm has ended with a panic.
    pub failed: bool,
    /// The newest joints.
    pub joints: Option<JointState>,
    /// Time of their arrival.
    pub sample_at: Option<MonotonicTime>,
    /// Number of measurements.
    pub samples: u64,
    /// The newest measurement with its status words.
    pub sample: Option<Sample>,
    /// Last measurement of an arm that its gateway had stopped before the connection, if available.
    pub shown: Option<Sample>,
    /// Limits in the controller, if they were read.
    pub limits: [Option<AxisLimits>; Axis::COUNT],
    /// Identification of the gateway.
    pub gateway: Option<HelloReply>,
    /// First state reported after the last connection or reset, before any wait for a busy gateway.
    pub gateway_found: Option<HelloReply>,
    /// Counters of messages.
    pub counters: LinkCounters,
    /// Counters of bytes on the line.
    pub line: ParserCounters,
    /// Frames that were dropped because the line accepted no more.
    pub frames_unsent: u64,
}

/// Command of the control loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Command {
    /// Number of the command: each is executed once.
    pub ticket: u64,
    /// Time at which the control loop gave it.
    pub at: MonotonicTime,
    pub command: JointCommand,
}

/// Requests of an operator; each takes a while.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PowerRequest {
    Connect = 1,
    Enable = 2,
    Stop = 3,
    Reset = 4,
    Look = 5,
}

impl PowerRequest {
    const ALL: [Self; 5] = [Self::Connect, Self::Enable, Self::Stop, Self::Reset, Self::Look];
}

#[derive(Debug)]
pub(super) struct Shared {
    command: Mutex<Command>,
    /// For the owner.
    snapshot: Mutex<ArmSnapshot>,
    changed: Condvar,
    /// For observers: the owner never takes this lock, and the thread does not wait for it.
    observed: Mutex<ArmSnapshot>,
    /// Number of the request times 8, plus the request.
    request: AtomicU64,
    release: AtomicBool,
    pub jitter: JitterMeter,
    pub round_trips: JitterMeter,
    pub control_trips: JitterMeter,
    pub trace: Trace,
}

impl Shared {
    pub fn new() -> Self {
        let command = Command { ticket: 0, at: MonotonicTime::ZERO, command: JointCommand::Hold };
        let snapshot = ArmSnapshot {
            state: DriverState::Disconnected,
            activity: Activity::None,
            latched: None,
            unplugged: None,
            failed: false,
            joints: None,
            sample_at: None,
            samples: 0,
            sample: None,
            shown: None,
            limits: [None; Axis::COUNT],
            gateway: None,
            gateway_found: None,
            counters: LinkCounters::default(),
            line: ParserCounters::default(),
            frames_unsent: 0,
        };
        Self {
            command: Mutex::new(command),
            snapshot: Mutex::new(snapshot),
            changed: Condvar::new(),
            observed: Mutex::new(snapshot),
            request: AtomicU64::new(0),
            release: AtomicBool::new(false),
            jitter: JitterMeter::default(),
            round_trips: JitterMeter::default(),
            control_trips: JitterMeter::default(),
            trace: Trace::new(),
        }
    }

    /// The control loop's side: replaces the command, whether or not it was executed.
    pub fn put_command(&self, at: MonotonicTime, command: JointCommand) {
        let mut slot = lock(&self.command);
        *slot = Command { ticket: slot.ticket + 1, at, command };
    }

    /// The thread's side: the command, if it is available without blocking.
    pub fn command(&self) -> Option<Command> {
        self.command.try_lock().ok().map(|slot| *slot)
    }

    /// The thread's side: whether the owner's snapshot could be replaced without blocking. While an observer holds its copy, this copy
    /// is only replaced on the next turn.
    pub fn publish(&self, snapshot: &ArmSnapshot) -> bool {
        if let Ok(mut observed) = self.observed.try_lock() {
            *observed = *snapshot;
        }
        let Ok(slot) = self.snapshot.try_lock() else { return false };
        self.replace(slot, snapshot);
        true
    }

    /// As [`Self::publish`], but blocks: for results that the owner must not miss, while nothing moves.
    pub fn publish_waiting(&self, snapshot: &ArmSnapshot) {
        self.replace(lock(&self.snapshot), snapshot);
        *lock(&self.observed) = *snapshot;
    }

    fn replace(&self, mut slot: MutexGuard<'_, ArmSnapshot>, snapshot: &ArmSnapshot) {
        let news = slot.samples != snapshot.samples || slot.state != snapshot.state || slot.failed != snapshot.failed;
        *slot = *snapshot;
        drop(slot);
        if news {
            self.changed.notify_all();
        }
    }

    /// The owner's side: the present snapshot.
    pub fn snapshot(&self) -> ArmSnapshot {
        *lock(&self.snapshot)
    }

    /// Waits until the snapshot meets a condition or this time is over, and returns the last one.
    pub fn wait_for(&self, timeout: std::time::Duration, wanted: impl Fn(&ArmSnapshot) -> bool) -> ArmSnapshot {
        let guard = lock(&self.snapshot);
        let waited = self.changed.wait_timeout_while(guard, timeout, |snapshot| !wanted(snapshot));
        *waited.unwrap_or_else(PoisonError::into_inner).0
    }

    /// The owner's side: the number of the request, which identifies its result.
    pub fn post_request(&self, request: PowerRequest) -> u64 {
        let number = self.request.load(Ordering::Relaxed) / 8 + 1;
        self.request.store(number * 8 + request as u64, Ordering::Release);
        number
    }

    /// The thread's side: the newest request and its number.
    pub fn request(&self) -> Option<(u64, PowerRequest)> {
        let word = self.request.load(Ordering::Acquire);
        let request = PowerRequest::ALL.into_iter().find(|request| *request as u64 == word % 8)?;
        Some((word / 8, request))
    }

    pub fn release(&self) {
        self.release.store(true, Ordering::Release);
    }

    pub fn is_released(&self) -> bool {
        self.release.load(Ordering::Acquire)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Read-only access to an arm for observers: panels, logs, tests.
#[derive(Clone, Debug)]
pub struct ArmMonitor {
    pub(super) shared: std::sync::Arc<Shared>,
}

impl ArmMonitor {
    /// The present snapshot. A caller that is preempted in here delays only other observers.
    pub fn snapshot(&self) -> ArmSnapshot {
        *lock(&self.shared.observed)
    }

    /// Lateness of the cycles of this arm's thread.
    pub fn jitter(&self) -> Jitter {
        self.shared.jitter.summary()
    }

    /// Number of cycles of this arm's thread that began later than this, accurate to an eighth.
    pub fn cycles_later_than(&self, limit: Duration) -> u64 {
        self.shared.jitter.later_than(limit)
    }

    /// Raw bytes of the last seconds, oldest first: for the record of a fault.
    pub fn raw_bytes(&self) -> Vec<RawBytes> {
        self.shared.trace.entries()
    }

    /// Response times of cyclic commands that were answered in time.
    pub fn round_trips(&self) -> Jitter {
        self.shared.round_trips.summary()
    }

    /// The same for all other messages: state requests, and start and end of the control mode.
    pub fn control_trips(&self) -> Jitter {
        self.shared.control_trips.summary()
    }
}

impl ArmSnapshot {
    /// The state in terms of the trait of all arms.
    pub fn arm_state(&self) -> ArmState {
        match self.state {
            DriverState::EStop => ArmState::EStop,
            _ if self.failed => ArmState::Fault,
            DriverState::Fault => ArmState::Fault,
            DriverState::Disconnected | DriverState::Connected | DriverState::Enabled => ArmState::Disabled,
            DriverState::Holding | DriverState::Moving => ArmState::Enabled,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::mpsc::channel;

    use super::*;

    /// An observer that is preempted while it copies its snapshot: in this time control and the thread of the arm exchange commands
    /// and samples as before. If either needed the observer's lock, the cycles would never end.
    #[test]
    fn a_preempted_observer_delays_no_cycle() {
        const CYCLES: u64 = 100;
        let shared = Arc::new(Shared::new());
        let monitor = ArmMonitor { shared: Arc::clone(&shared) };
        let preempted = lock(&shared.observed);
        let (done, is_done) = channel();
        let control = Arc::clone(&shared);
        let cycles = move || {
            let mut snapshot = control.snapshot();
            for cycle in 1..=CYCLES {
                control.put_command(MonotonicTime::from_nanos(cycle), JointCommand::Hold);
                let is_taken = control.command().is_some_and(|command| command.ticket == cycle);
                snapshot.samples = cycle;
                let is_published = control.publish(&snapshot);
                let snapshot = control.wait_for(Duration::ZERO, |snapshot| snapshot.samples == cycle);
                if !is_taken || !is_published || snapshot.samples != cycle || control.snapshot().samples != cycle {
                    break;
                }
                let _ = done.send(cycle);
            }
        };
        let thread = std::thread::spawn(cycles);
        let completed = (1..=CYCLES).map_while(|_| is_done.recv_timeout(Duration::from_secs(20)).ok()).last();
        assert_eq!(completed, Some(CYCLES), "cycles while an observer holds its lock");
        thread.join().unwrap();
        assert_eq!(preempted.samples, 0);
        drop(preempted);
        assert!(shared.publish(&ArmSnapshot { samples: CYCLES + 1, ..shared.snapshot() }));
        assert_eq!(monitor.snapshot().samples, CYCLES + 1);
    }
}
