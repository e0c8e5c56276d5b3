//! The last transitions.

use pb3dp_geometry::MonotonicTime;

use super::findings::Cause;
use super::table::{Event, State};

/// Number of transitions that are kept.
pub const TRANSITIONS_KEPT: usize = 64;

/// A change of state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// Time of the transition.
    pub at: MonotonicTime,
    /// Previous state.
    pub from: State,
    /// New state; the same one if it was entered again.
    pub to: State,
    /// The event.
    pub event: Event,
    /// The condition with value and threshold; `None` if no condition caused the event.
    pub cause: Option<Cause>,
}

/// Ring buffer of the last transitions, without heap memory.
#[derive(Clone, Debug)]
pub struct TransitionLog {
    ring: [Option<Transition>; TRANSITIONS_KEPT],
    total: usize,
}

impl TransitionLog {
    pub(super) fn new() -> Self {
        Self { ring: [None; TRANSITIONS_KEPT], total: 0 }
    }

    pub(super) fn push(&mut self, transition: Transition) {
        self.ring[self.total % TRANSITIONS_KEPT] = Some(transition);
        self.total += 1;
    }

    /// The last transition.
    pub fn newest(&self) -> Option<Transition> {
        self.ring[self.total.checked_sub(1)? % TRANSITIONS_KEPT]
    }

    /// Number of all transitions, including those that are no longer kept.
    pub fn total(&self) -> usize {
        self.total
    }

    /// The kept transitions, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &Transition> {
        let oldest = if self.total > TRANSITIONS_KEPT { self.total % TRANSITIONS_KEPT } else { 0 };
        let (newer, older) = self.ring.split_at(oldest);
        older.iter().chain(newer).flatten()
    }
}
