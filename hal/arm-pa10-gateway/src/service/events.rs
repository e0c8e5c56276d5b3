//! Events from the cycle thread to the owner: a queue of fixed size whose sender never blocks.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

use pb3dp_arm_pa10_protocol::gateway_protocol::{FaultReport, GatewayState, StopCause};
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_platform::transport::Symptom;

/// Capacity of the queue.
const EVENTS_MAX: usize = 1024;

/// An event with its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GatewayEvent {
    /// Time of the event.
    pub at: MonotonicTime,
    /// The event.
    pub what: Happened,
}

/// Events of a gateway.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Happened {
    /// The state changed.
    State {
        /// State before.
        from: GatewayState,
        /// State now.
        to: GatewayState,
        /// The latched cause.
        cause: StopCause,
        /// Axis and status word of the cause, if they show it.
        found: Option<FaultReport>,
    },
    /// The controller does not answer the stop order, which is repeated.
    StopUnacknowledged,
    /// The controller has answered the stop order.
    StopAcknowledged,
    /// A line to a host is open.
    HostConnected,
    /// A host sent HELLO.
    HostGreeted,
    /// The line to the host is closed.
    HostGone(Symptom),
    /// A new connection replaced a silent one.
    HostReplaced,
    /// A cycle began late by more than a tenth of a cycle.
    Overrun {
        /// The delay.
        late: Duration,
    },
    /// The bus went down.
    BusDown(Symptom),
    /// The bus is up again.
    BusUp,
}

/// The sending end.
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

    /// Sends an event without blocking and without allocating: the owner polls.
    pub fn tell(&self, at: MonotonicTime, what: Happened) {
        if self.sender.try_send(GatewayEvent { at, what }).is_err() {
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}
