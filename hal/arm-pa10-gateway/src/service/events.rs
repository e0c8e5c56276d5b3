//! What happened, from the thread of the cycle to its owner: a queue of fixed size whose sender never waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use pb3dp_arm_pa10_protocol::gateway_protocol::{Dialect, FaultReport, GatewayState, StopCause};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::transport::Symptom;

/// Events that wait for the owner.
const EVENTS_MAX: usize = 1024;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GatewayEvent {
    /// When.
    pub at: MonotonicTime,
    /// What.
    pub what: Happened,
}

/// What can happen to a gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Happened {
    /// Another state, and why.
    State {
        /// Before.
        from: GatewayState,
        /// Now.
        to: GatewayState,
        /// The cause that is latched.
        cause: StopCause,
        /// What it was found in: axis and status word, where they show it.
        found: Option<FaultReport>,
    },
    /// The controller does not answer the stop order, which goes on.
    Unheard,
    /// It has.
    Heard,
    /// A line to a host is there.
    HostConnected,
    /// A host said HELLO.
    HostGreeted(Dialect),
    /// The line to the host is gone.
    HostGone(Symptom),
    /// Another connection took the place of one that had been silent.
    HostReplaced,
    /// A cycle began late by more than a tenth.
    Overrun {
        /// By how much.
        late: Duration,
    },
    /// The bus went down.
    BusDown(Symptom),
    /// The bus is there again.
    BusUp,
}

/// The sender's end.
#[derive(Debug)]
pub(super) struct EventQueue {
    sender: SyncSender<GatewayEvent>,
    dropped: Arc<AtomicU64>,
}

impl EventQueue {
    pub fn new() -> (Self, Receiver<GatewayEvent>) {
        let (sender, receiver) = sync_channel(EVENTS_MAX);
        (Self { sender, dropped: Arc::new(AtomicU64::new(0)) }, receiver)
    }

    pub fn dropped(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.dropped)
    }

    /// Without waiting and without allocating: the owner only ever looks whether something is there.
    pub fn tell(&self, at: MonotonicTime, what: Happened) {
        if self.sender.try_send(GatewayEvent { at, what }).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}
