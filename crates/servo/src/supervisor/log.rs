//! The last transitions.

use pb3dp_geometry::MonotonicTime;

use super::findings::Cause;
use super::table::{Event, State};

/// How many are kept.
pub const TRANSITIONS_KEPT: usize = 64;

/// A change of state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// When.
    pub at: MonotonicTime,
    /// From here.
    pub from: State,
    /// To here; the same state if it began anew.
    pub to: State,
    /// By this.
    pub event: Event,
    /// What was found, with value and threshold; none if the operator said so or the hand got there.
    pub cause: Option<Cause>,
}

/// A ring of the last transitions. It takes nothing from the heap.
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

    /// The last one.
    pub fn newest(&self) -> Option<Transition> {
        self.ring[self.total.checked_sub(1)? % TRANSITIONS_KEPT]
    }

    /// How many there were, with those that are no longer kept.
    pub fn total(&self) -> usize {
        self.total
    }

    /// Those that are kept, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &Transition> {
        let oldest = if self.total > TRANSITIONS_KEPT { self.total % TRANSITIONS_KEPT } else { 0 };
        let (newer, older) = self.ring.split_at(oldest);
        older.iter().chain(newer).flatten()
    }
}
