//! What the thread of an arm and its owner share.
//!
//! The thread never waits for a lock: where the owner holds one, the thread goes on and comes back to it. The owner waits for the
//! thread's short copies only. Nothing else uses these locks.

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

/// What is known of an arm at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmSnapshot {
    /// Where the driver is.
    pub state: DriverState,
    /// What is going on besides.
    pub activity: Activity,
    /// Why the arm is stopped, if it is.
    pub latched: Option<Latched>,
    /// Why the link is gone, if it is.
    pub unplugged: Option<Unplugged>,
    /// The thread of the arm has ended by a mistake of the program.
    pub failed: bool,
    /// The newest joints.
    pub joints: Option<JointState>,
    /// When they came.
    pub sample_at: Option<MonotonicTime>,
    /// Counts the joints that were measured.
    pub samples: u64,
    /// The newest measurement with its status words.
    pub sample: Option<Sample>,
    /// The last measurement of an arm that its gateway had stopped before it was reached, if it shows it.
    pub shown: Option<Sample>,
    /// Limits as the controller keeps them, where they were read.
    pub limits: [Option<AxisLimits>; Axis::COUNT],
    /// What the gateway said of itself.
    pub gateway: Option<HelloReply>,
    /// What it said first of the last time that it was connected to or reset: one that was still busy was waited for.
    pub gateway_found: Option<HelloReply>,
    /// What happened to messages.
    pub counters: LinkCounters,
    /// What happened to the bytes of the line.
    pub line: ParserCounters,
    /// Frames that could not be handed over because the line took nothing more.
    pub frames_unsent: u64,
    /// On a bus: the controller has not answered the stop order. The arm may move; the thread goes on telling it to stop.
    pub unheard: bool,
}

/// What the control loop wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Command {
    /// Counts commands: each is taken once.
    pub ticket: u64,
    /// When the control loop gave it.
    pub at: MonotonicTime,
    pub command: JointCommand,
}

/// What an operator wants; each takes a while.
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
    snapshot: Mutex<ArmSnapshot>,
    changed: Condvar,
    /// Number of the request times 8, plus the request.
    request: AtomicU64,
    let_go: AtomicBool,
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
            unheard: false,
        };
        Self {
            command: Mutex::new(command),
            snapshot: Mutex::new(snapshot),
            changed: Condvar::new(),
            request: AtomicU64::new(0),
            let_go: AtomicBool::new(false),
            jitter: JitterMeter::default(),
            round_trips: JitterMeter::default(),
            control_trips: JitterMeter::default(),
            trace: Trace::new(),
        }
    }

    /// The control loop's side: replaces the command, whether or not it was taken.
    pub fn put_command(&self, at: MonotonicTime, command: JointCommand) {
        let mut slot = self.command.lock().unwrap_or_else(PoisonError::into_inner);
        *slot = Command { ticket: slot.ticket + 1, at, command };
    }

    /// The thread's side: the command, if it can be had without waiting.
    pub fn command(&self) -> Option<Command> {
        self.command.try_lock().ok().map(|slot| *slot)
    }

    /// The thread's side: whether the snapshot could be replaced without waiting.
    pub fn publish(&self, snapshot: &ArmSnapshot) -> bool {
        let Ok(slot) = self.snapshot.try_lock() else { return false };
        self.replace(slot, snapshot);
        true
    }

    /// As [`Self::publish`], but waits: for what the owner must not miss, while nothing moves.
    pub fn publish_waiting(&self, snapshot: &ArmSnapshot) {
        self.replace(self.lock_snapshot(), snapshot);
    }

    fn replace(&self, mut slot: MutexGuard<'_, ArmSnapshot>, snapshot: &ArmSnapshot) {
        let news = slot.samples != snapshot.samples || slot.state != snapshot.state || slot.failed != snapshot.failed;
        *slot = *snapshot;
        drop(slot);
        if news {
            self.changed.notify_all();
        }
    }

    /// What is known now.
    pub fn snapshot(&self) -> ArmSnapshot {
        *self.lock_snapshot()
    }

    /// Waits until the snapshot is as wanted or this time is over, and returns the last one.
    pub fn wait_for(&self, timeout: std::time::Duration, wanted: impl Fn(&ArmSnapshot) -> bool) -> ArmSnapshot {
        let guard = self.lock_snapshot();
        let waited = self.changed.wait_timeout_while(guard, timeout, |snapshot| !wanted(snapshot));
        *waited.unwrap_or_else(PoisonError::into_inner).0
    }

    fn lock_snapshot(&self) -> MutexGuard<'_, ArmSnapshot> {
        self.snapshot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The owner's side: the number of the request, by which its end will be told.
    pub fn put_wish(&self, request: PowerRequest) -> u64 {
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

    pub fn let_go(&self) {
        self.let_go.store(true, Ordering::Release);
    }

    pub fn is_let_go(&self) -> bool {
        self.let_go.load(Ordering::Acquire)
    }
}

/// Shows an arm to observers: panels, logs, tests. It disturbs nothing.
#[derive(Clone, Debug)]
pub struct ArmMonitor {
    pub(super) shared: std::sync::Arc<Shared>,
}

impl ArmMonitor {
    /// What is known now.
    pub fn snapshot(&self) -> ArmSnapshot {
        self.shared.snapshot()
    }

    /// How late the cycles of this arm's thread began.
    pub fn jitter(&self) -> Jitter {
        self.shared.jitter.summary()
    }

    /// How many cycles of this arm's thread began later than this, exact to an eighth.
    pub fn cycles_later_than(&self, limit: Duration) -> u64 {
        self.shared.jitter.later_than(limit)
    }

    /// The raw bytes of the last seconds, oldest first: for the record of a fault.
    pub fn raw_bytes(&self) -> Vec<RawBytes> {
        self.shared.trace.entries()
    }

    /// How long answers to cyclic commands took, of those that were answered in time.
    pub fn round_trips(&self) -> Jitter {
        self.shared.round_trips.summary()
    }

    /// The same for all other messages: those that look at the arm, and those that begin and end its control mode.
    pub fn control_trips(&self) -> Jitter {
        self.shared.control_trips.summary()
    }
}

impl ArmSnapshot {
    /// The state as the trait of all arms has it.
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
