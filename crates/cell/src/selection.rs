//! Targets that an operator selects while a run goes on.

use std::sync::Arc;
use std::time::Duration;

use pb3dp_estimation_core::region::Region;
use pb3dp_hal_api::FramePair;

use crate::handover::Newest;

/// A target that the operator has selected.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Region in the left image of the pair.
    pub region: Region,
    /// The pair on which the operator drew; the method starts with it and finds the target again in the next pair. Without it the method
    /// starts with the next pair.
    pub drawn_on: Option<Arc<FramePair>>,
}

/// Passes selections to the estimation; of unread selections only the newest one is kept.
#[derive(Clone, Default)]
pub struct Selections(Arc<Newest<Selection>>);

impl Selections {
    /// Selects a target; returns whether the previous selection was overwritten unread.
    pub fn give(&self, selection: Selection) -> bool {
        self.0.give(selection)
    }

    /// The newest selection, unless it was already taken.
    pub fn take(&self) -> Option<Selection> {
        self.0.wait(Duration::ZERO)
    }
}
