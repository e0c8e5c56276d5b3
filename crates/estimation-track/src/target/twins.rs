//! Others that look like the target: a second part of the same kind, another face with the same print.
//!
//! A target that is lost and seen again elsewhere may be such another one, and nothing in the pair of images tells. What tells is that it was
//! seen beside the target, in the first pair or later, so the whole image is looked at while the target is followed. A box shows its
//! next face turned away as the marked one turns away to the other side, so the views are sought with their tilts mirrored, too.

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

use super::lost::Candidate;
use super::{FOUND_AGAIN_STRICTER, Frame, Target};
use crate::align::StartLevel;
use crate::normal::NormalEquations;
use crate::reach::in_sight;
use crate::search::{PLACES, Place, hypotheses, hypothesis, mirrored};

/// Frames between two looks for the target's present appearance alone. Chosen by hand, not varied: what crosses an image in half a second is seen
/// twice.
const LOOK_EVERY: u64 = 5;
/// Hypotheses in a frame of a look. Chosen by hand, not varied: they take as long as a frame of a target that is followed.
const IN_A_FRAME: usize = 2;
/// Tilt below which the mirrored pose is not another hypothesis, radians (10 degrees). Chosen by hand, not varied: a template resembles what is turned
/// by twice this.
const TILTED_MIN_RAD: f64 = 0.17;
/// Correlation with the left image from which a place is compared in both. Chosen by hand, not varied: twins have 0.8 to 0.95, others up to 0.6.
const RESEMBLANCE_MIN: f64 = 0.65;

/// The same for a place that a camera does not see whole, which counts as another one then. Chosen by hand, not varied.
const RESEMBLANCE_ALONE_MIN: f64 = 0.85;
/// Share of the outline inside both images from which they see a place whole. Chosen by hand, not varied.
const WHOLE_MIN: f64 = 0.9;

/// A place in the left image that looks like a view of the target.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LookAlike {
    view: usize,
    place: Place,
}

impl Target {
    /// Searches the whole first pair for similar objects.
    pub(crate) fn find_ambiguous_views(&mut self, frame: &Frame<'_>) {
        let own = self.estimate.cam_left_from_model;
        for index in 0..hypotheses(0) {
            let (_, turned) = hypothesis(index, &own, &[]);
            for place in self.places_of(0, &turned, frame).into_iter().flatten() {
                if self.is_apart(&place) {
                    self.examine_other(LookAlike { view: 0, place }, frame, &mut || true);
                }
            }
        }
    }

    /// Begins a look if one is due in this frame, in which the target was found.
    pub(super) fn plan_look(&mut self, has_new_view: bool) {
        if has_new_view {
            self.looks_open = 2 * (self.views.len() + 1);
        } else if self.frame.is_multiple_of(LOOK_EVERY) {
            self.looks_open = self.looks_open.max(2);
        }
    }

    /// Whether hypotheses of a look are open.
    pub(crate) fn looks_around(&self) -> bool {
        !self.has_twin && self.looks_open > 0
    }

    /// Places in the whole left image of a frame, in which the target was found, that look like the next views.
    pub(crate) fn look_around(&mut self, frame: &Frame<'_>) -> [Option<LookAlike>; PLACES * IN_A_FRAME] {
        let mut found = [None; PLACES * IN_A_FRAME];
        for found in found.chunks_exact_mut(PLACES) {
            self.look(frame, found);
        }
        found
    }

    /// As [`Self::look_around`] and [`Self::examine_other`] with all views, in a whole pair.
    pub(crate) fn look_everywhere(&mut self, frame: &Frame<'_>, may_continue: &mut dyn FnMut() -> bool) {
        self.looks_open = 2 * (self.views.len() + 1);
        while self.looks_around() && may_continue() {
            for other in self.look_around(frame).into_iter().flatten() {
                self.examine_other(other, frame, may_continue);
            }
        }
    }

    /// Takes the next hypothesis: a view as it was seen or with its tilt mirrored, the present one last.
    fn look(&mut self, frame: &Frame<'_>, found: &mut [Option<LookAlike>]) {
        let own = self.estimate.cam_left_from_model;
        while let Some(index) = self.looks_open.checked_sub(1) {
            self.looks_open = index;
            let (source, mut pose) = hypothesis((index / 2).min(self.views.len()), &own, &self.views);
            if index % 2 == 1 {
                let other = mirrored(&pose);
                if other.rotation().angle_to(&pose.rotation()) < 2.0 * TILTED_MIN_RAD {
                    continue;
                }
                pose = other;
            }
            let view = if source == 0 { self.nearest_view(&own, frame.config).0 } else { source - 1 };
            for (found, place) in found.iter_mut().zip(self.places_of(view, &pose, frame)) {
                *found = place
                    .filter(|place| place.correlation >= RESEMBLANCE_MIN && self.is_apart(place))
                    .map(|place| LookAlike { view, place });
            }
            return;
        }
    }

    /// Whether a place in the left image is not that of the target.
    fn is_apart(&self, place: &Place) -> bool {
        let own = &self.estimate.cam_left_from_model;
        let along = |pose: &Pose<CamLeft, Model>| pose.translation_m().normalize() * own.translation_m().norm();
        (along(&place.cam_left_from_model) - along(own)).norm() > self.sighting(own).near_m
    }

    /// Compares a place in the whole pair with the target. A copy inside a texture that repeats is no twin: [`Self::settle`] tells copies apart.
    pub(crate) fn examine_other(
        &mut self,
        LookAlike { view, place }: LookAlike,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) {
        let (estimate, fit, own_view) = (self.estimate, self.fit, self.view);
        let own = estimate.cam_left_from_model;
        let limits = self.limits(frame.config).stricter(FOUND_AGAIN_STRICTER);
        self.view = view;
        let fits = self.look_into(Candidate { place, with_depth: true }, frame, may_continue).is_ok();
        let is_another = self.sighting(&own).is_another() && !self.is_copy_of(&own);
        let is_whole = || in_sight(&self.outline_in_model, &place.cam_left_from_model, frame.rig) >= WHOLE_MIN;
        let is_alike_alone = !fits && place.correlation >= RESEMBLANCE_ALONE_MIN && !is_whole();
        self.has_twin |= is_alike_alone || fits && self.fit.misfit(&limits).is_none() && is_another;
        (self.estimate, self.fit, self.view) = (estimate, fit, own_view);
    }

    /// Keeps the result if it is near the expected pose. Elsewhere the alignment may have ended at another one that comes before the target,
    /// though a part of the target is still seen where it is expected: that is taken then.
    pub(super) fn or_still_there(
        &mut self,
        found: Option<NormalEquations>,
        expected: &Pose<CamLeft, Model>,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<NormalEquations> {
        let sighting = self.sighting(expected);
        let is_another = found.is_some() && sighting.is_another();
        if found.is_some() && sighting.is_near() || self.periodic.is_some() || !may_continue() {
            return found;
        }
        let (estimate, fit) = (self.estimate, self.fit);
        let there = self.attempt(expected, StartLevel::Fine, frame, may_continue);
        if there.is_some() && self.fit.misfit(&self.limits(frame.config)).is_none() && self.sighting(expected).is_near()
        {
            self.has_twin |= is_another;
            return there;
        }
        (self.estimate, self.fit) = (estimate, fit);
        let found = found?;
        Some(self.examine(frame, false).unwrap_or(found))
    }
}
