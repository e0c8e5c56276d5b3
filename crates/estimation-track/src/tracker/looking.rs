//! Looking at whole images: for a lost target, and for others that look the same.

use pb3dp_estimation_core::image_view::ImageView;

use super::DirectTracker;
use crate::predict::Expected;
use crate::target::{Ending, Target};

/// Longest time after which a pair confirms that the target was found elsewhere, seconds. Chosen by hand, not varied: a motion is foreseen so long.
const CONFIRMED_WITHIN_S: f64 = 0.25;

impl DirectTracker {
    /// Searches a lost target in a pair, the time `step_s` after the last one. If it is found where it was not expected, it must be the only
    /// one that looks so, and the next pair must confirm it.
    pub(super) fn search(
        &mut self,
        target: &mut Target,
        (expected, step_s): (&Expected, Option<f64>),
        (left, right): (ImageView<'_>, ImageView<'_>),
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Ending {
        self.load_both(left, right);
        let frame = self.frame();
        let before = target.estimate;
        let ending = target.search(expected, &frame, may_continue);
        if ending != Ending::Found || !target.is_unverified {
            return ending;
        }
        target.look_everywhere(&frame, may_continue);
        if target.has_twin {
            (target.estimate, target.is_unverified) = (before, false);
            return Ending::OneOfSeveral;
        }
        // A pair long after confirms nothing.
        target.is_unverified = step_s.is_some_and(|step_s| step_s <= CONFIRMED_WITHIN_S);
        ending
    }

    /// Looks for others like the target that was found in this frame. The right image is needed only where the left one shows something alike.
    pub(super) fn look_around(
        &mut self,
        target: &mut Target,
        (left, right): (ImageView<'_>, ImageView<'_>),
        may_continue: &mut dyn FnMut() -> bool,
    ) {
        self.load_whole(0, left);
        let others = target.look_around(&self.frame());
        for (count, other) in others.into_iter().flatten().enumerate() {
            if count == 0 {
                self.load_whole(1, right);
            }
            target.examine_other(other, &self.frame(), may_continue);
        }
    }
}
