//! Targets that an operator selects while a run goes on.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use pb3dp_estimation_core::method::KnownModel;
use pb3dp_estimation_core::region::Region;
use pb3dp_hal_api::FramePair;

use crate::perception::TargetSource;

/// A target that the operator has selected.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Region in the left image of the pair.
    pub region: Region,
    /// The pair on which the operator drew; the method starts with it and finds the target again in the next pair. Without it the method
    /// starts with the next pair.
    pub drawn_on: Option<Arc<FramePair>>,
    /// The frame `model` of a target that was followed before, in the pair `drawn_on`: it is restored.
    pub model: Option<Box<KnownModel>>,
}

/// What a `select` chooses.
#[derive(Clone, Debug)]
pub enum Choice {
    /// The target that the setup names.
    OfSetup,
    /// The target that the operator has marked.
    Marked(Selection),
}

/// Passes selections to the estimation, each with its command: a selection is offered, then a control step accepts or refuses it. Of
/// accepted selections that the estimation has not taken, only the newest one is kept.
#[derive(Clone, Default)]
pub struct Selections(Arc<Shared>);

#[derive(Default)]
struct Shared {
    offered: Mutex<Offered>,
    /// Offers up to this number are accepted, refused or overtaken.
    settled: AtomicU64,
    /// The newest accepted offer.
    accepted: AtomicU64,
    /// The newest accepted offer whose estimate the estimation has passed on.
    done: AtomicU64,
    /// How the setup marks its target.
    of_setup: OnceLock<TargetSource>,
}

#[derive(Default)]
struct Offered {
    /// Number of the newest offer; the first one has the number 1.
    newest: u64,
    /// The offer that the estimation has taken last.
    taken: u64,
    waiting: VecDeque<(u64, Choice)>,
}

impl Selections {
    fn lock(&self) -> MutexGuard<'_, Offered> {
        self.0.offered.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the target that the setup names. Later calls, and a marking that needs an operator, change nothing.
    pub fn set_target_of_setup(&self, marking: &TargetSource) {
        if !matches!(marking, TargetSource::FromOperator | TargetSource::None) {
            // The first one counts.
            let _ = self.0.of_setup.set(marking.clone());
        }
    }

    /// The target that the setup names, if it names one.
    pub fn target_of_setup(&self) -> Option<&TargetSource> {
        self.0.of_setup.get()
    }

    /// Adds what a command selects; returns the number with which a control step accepts or refuses it.
    pub fn offer(&self, choice: Choice) -> u64 {
        let mut offered = self.lock();
        let settled = self.0.settled.load(Ordering::SeqCst);
        let accepted = self.0.accepted.load(Ordering::SeqCst);
        offered.waiting.retain(|(number, _)| *number > settled || *number == accepted);
        offered.newest += 1;
        let number = offered.newest;
        offered.waiting.push_back((number, choice));
        number
    }

    /// Gives an offer to the estimation. Never waits: for the thread that moves the arms.
    pub fn accept(&self, number: u64) {
        self.0.accepted.fetch_max(number, Ordering::SeqCst);
        self.drop_offer(number);
    }

    /// Drops an offer, and unsettled ones before it. Never waits, as [`Self::accept`].
    pub fn drop_offer(&self, number: u64) {
        self.0.settled.fetch_max(number, Ordering::SeqCst);
    }

    /// Removes the newest offer, whose command was never queued: earlier ones stay unsettled.
    pub fn withdraw(&self, number: u64) {
        self.lock().waiting.retain(|(waiting, _)| *waiting != number);
    }

    /// Offers and accepts a selection.
    pub fn give(&self, choice: Choice) {
        self.accept(self.offer(choice));
    }

    /// The newest accepted choice, unless it was already taken. To be called for each pair, after the estimate of the pair before was passed
    /// on.
    pub fn take(&self) -> Option<Choice> {
        let mut offered = self.lock();
        self.0.done.fetch_max(offered.taken, Ordering::SeqCst);
        let accepted = self.0.accepted.load(Ordering::SeqCst);
        if accepted == offered.taken {
            return None;
        }
        offered.taken = accepted;
        offered.waiting.retain(|(number, _)| *number >= accepted);
        let is_first = offered.waiting.front().is_some_and(|(number, _)| *number == accepted);
        if is_first { offered.waiting.pop_front().map(|(_, choice)| choice) } else { None }
    }

    /// Whether the estimation still follows the target before the newest accepted one. Never waits.
    pub fn is_awaited(&self) -> bool {
        self.0.accepted.load(Ordering::SeqCst) > self.0.done.load(Ordering::SeqCst)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn marked(x: i32) -> Choice {
        Choice::Marked(Selection {
            region: Region::Rectangle { x, y: 0, width: 5, height: 5 },
            drawn_on: None,
            model: None,
        })
    }

    fn taken(selections: &Selections) -> Option<i32> {
        match selections.take()? {
            Choice::Marked(Selection { region: Region::Rectangle { x, .. }, .. }) => Some(x),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn only_an_accepted_selection_is_taken_and_it_is_awaited_until_its_estimate_is_passed_on() {
        let selections = Selections::default();
        let [first, second, third] = [1, 2, 3].map(|x| selections.offer(marked(x)));
        assert_eq!(taken(&selections), None);
        selections.drop_offer(first);
        assert_eq!((taken(&selections), selections.is_awaited()), (None, false));
        selections.accept(second);
        // An offer that comes now drops those that are settled, but not the accepted one.
        let fourth = selections.offer(marked(4));
        assert!(selections.is_awaited());
        assert_eq!((taken(&selections), selections.is_awaited()), (Some(2), true));
        assert_eq!((taken(&selections), selections.is_awaited()), (None, false));
        selections.drop_offer(third);
        selections.accept(fourth);
        assert_eq!(taken(&selections), Some(4));
        assert!(selections.lock().waiting.is_empty());
    }

    #[test]
    fn settled_offers_are_not_kept_and_the_newest_accepted_one_wins() {
        let selections = Selections::default();
        for x in 0..100 {
            selections.drop_offer(selections.offer(marked(x)));
        }
        assert_eq!(selections.lock().waiting.len(), 1);
        selections.give(marked(1));
        selections.give(marked(2));
        assert_eq!((taken(&selections), taken(&selections)), (Some(2), None));
    }
}
