//! The search for a lost target in whole images.

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, so3};

use super::periodic::WORSE;
use super::{Ending, Frame, Target, VISIBLE_MIN};
use crate::align::{AlignmentPlan, Estimate, StartLevel};
use crate::images::LEVELS;
use crate::judge::Fit;
use crate::normal::{Free, NormalEquations};
use crate::predict::Expected;
use crate::reach::{NEAR_RAD, Sighting, in_sight, reach, reach_rad};
use crate::search::{PLACES, POINTS_PREFERRED, Place, depth_by_stereo, hypotheses, hypothesis};
use crate::visible_planes::{SPACING_RADII, VisiblePlane};

/// Number of templates per frame while the target is lost. Chosen by hand: with this and the next three a lost frame took
/// less than 10 ms.
const TEMPLATES_PER_FRAME: usize = 7;
/// Number of candidate positions tested per lost frame. Chosen, see [`TEMPLATES_PER_FRAME`].
const CANDIDATES: usize = 4;
/// The same in a frame whose planes are searched. Chosen with figures: on the frames of three sequences of stills in which the target is lost,
/// as many are found as with 12, and less with 6.
const CANDIDATES_ON_PLANES: usize = 8;
/// Steps per level in the rough alignment of a candidate. Chosen, see [`TEMPLATES_PER_FRAME`].
const ROUGH_STEPS: usize = 6;
/// Number of rolls on a plane, and the angle between them, radians (15 degrees). Chosen with figures: on the frames of three sequences of
/// stills in which the target is lost, as many are found as with 24 rolls, which go all around.
const ROLLS: i32 = 7;
const ROLL_STEP_RAD: f64 = 0.262;
/// Correlation that the rough alignment must reach. Chosen, see [`TEMPLATES_PER_FRAME`].
const ROUGH_RESEMBLANCE_MIN: f64 = 0.5;
/// The same at a quarter of the resolution, if the target has enough points there. Chosen: four fifths of it, since most places that do
/// not match are below, and finer levels take most of the time.
const COARSE_RESEMBLANCE_MIN: f64 = 0.4;
/// Factor by which a target must be nearer to the prediction than its twin. Chosen by hand, not varied: with less, the twin is
/// accepted after fast motion; with more, the target stays lost longer.
const CLEARLY_NEARER: f64 = 2.0;

impl Target {
    /// Searches for a lost target in whole images.
    pub(crate) fn search(
        &mut self,
        expected: &Expected,
        planes: &[VisiblePlane],
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Ending {
        let predicted = &expected.pose;
        let before = self.estimate;
        let lost_frames = f64::from(self.lost_frames);
        let is_outside = in_sight(&self.outline_in_model, predicted, frame.rig) < VISIBLE_MIN;
        let mut ending = if is_outside { Ending::OutOfSight } else { Ending::NothingAlike };
        let mut candidates: [Option<Candidate>; CANDIDATES_ON_PLANES + 1] = [None; CANDIDATES_ON_PLANES + 1];
        candidates[0] =
            Some(Candidate { place: Place { cam_left_from_model: *predicted, correlation: 1.0 }, with_depth: false });
        let most = if planes.is_empty() { CANDIDATES } else { CANDIDATES_ON_PLANES };
        for place in self.places(frame).into_iter().flatten().chain(self.places_on(planes, predicted, frame)) {
            insert(&mut candidates[..=most], place);
        }
        let mut alike: [Option<Found>; CANDIDATES_ON_PLANES + 1] = [None; CANDIDATES_ON_PLANES + 1];
        let mut own = [None; CANDIDATES_ON_PLANES + 1];
        for (index, candidate) in candidates.into_iter().enumerate() {
            let Some(candidate) = candidate.filter(|_| may_continue()) else { break };
            self.estimate = before;
            match self.look_into(candidate, frame, may_continue) {
                Ok(_) => {
                    let sighting = self.sighting(predicted);
                    let Sighting { way_m, near_m, .. } = sighting;
                    let found = Found { view: self.view, way_m, near_m, estimate: self.estimate, fit: self.fit };
                    if sighting.can_be_the_target() {
                        own[index] = Some(found);
                        // Nothing else is looked for if the target is where it is expected.
                        if sighting.is_near() {
                            break;
                        }
                    } else {
                        ending = if sighting.is_one_of_two() { Ending::OneOfSeveral } else { Ending::OutOfReach };
                        alike[index] = sighting.is_one_of_two().then_some(found);
                    }
                }
                Err(Ending::OutOfSight) => {}
                Err(other) => ending = other,
            }
        }
        let best = own.iter().flatten().max_by(|a, b| a.fit.goodness().total_cmp(&b.fit.goodness()));
        if let Some(best) = best.copied().or_else(|| nearest_of_several(&alike)) {
            (self.view, self.estimate, self.fit) = (best.view, best.estimate, best.fit);
            if let Some(equations) = self.examine(frame, false) {
                self.take_found(equations, expected, lost_frames, frame, may_continue);
                self.is_unverified |= !self.is_near(predicted)
                    && (!self.fits_well()
                        || !may_continue()
                        || own.iter().flatten().any(|other| self.is_rival(other, frame, may_continue)));
                return Ending::Found;
            }
        }
        self.estimate = before;
        ending
    }

    /// Whether another pose explains the images nearly as well as the estimate, compared in the same view.
    fn is_rival(&mut self, other: &Found, frame: &Frame<'_>, may_continue: &mut dyn FnMut() -> bool) -> bool {
        let (view, estimate, fit) = (self.view, self.estimate, self.fit);
        let [pose, own_pose] = [&other.estimate, &estimate].map(|estimate| estimate.cam_left_from_model);
        let is_apart = (pose.translation_m() - own_pose.translation_m()).norm() > other.near_m
            || pose.rotation().angle_to(&own_pose.rotation()) > NEAR_RAD;
        let is_alike = |fit: &Fit| fit.goodness() >= WORSE * self.fit.goodness();
        if !is_apart || !is_alike(&other.fit) || other.view == view {
            return is_apart && is_alike(&other.fit);
        }
        let is_rival = self.attempt(&pose, StartLevel::Resembling, frame, may_continue).is_some()
            && self.fit.goodness() >= WORSE * fit.goodness();
        (self.view, self.estimate, self.fit) = (view, estimate, fit);
        self.examine(frame, false);
        is_rival
    }

    /// Completes the frame in which the target is found at the estimate. Near its expected pose, directions that the images do not show
    /// stay as expected.
    fn take_found(
        &mut self,
        equations: NormalEquations,
        expected: &Expected,
        lost_frames: f64,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) {
        let is_near = self.is_near(&expected.pose);
        let equations = self.settle(equations, &expected.pose, lost_frames, frame, may_continue);
        self.conclude(&equations, false);
        if is_near {
            self.keep_unseen(expected);
        }
    }

    /// Aligns at a candidate position, and evaluates the fit.
    pub(super) fn look_into(
        &mut self,
        Candidate { place, with_depth }: Candidate,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Result<NormalEquations, Ending> {
        let before = self.estimate;
        let at = place.cam_left_from_model;
        let start = if with_depth { self.with_depth(&at, frame) } else { Some(at) }.ok_or(Ending::OutOfSight)?;
        self.view = self.nearest_view(&start, frame.config).0;
        let rough = self.rough(&start, frame, may_continue).ok_or(Ending::OutOfSight)?;
        self.estimate = before;
        let found = self.attempt(&rough, StartLevel::Resembling, frame, may_continue);
        let equations = self.or_mirrored(found, frame, may_continue).ok_or(Ending::OutOfSight)?;
        self.fit.misfit(&self.limits(frame.config)).map_or(Ok(equations), |misfit| Err(Ending::Misfit(misfit)))
    }

    /// Runs a few steps at coarse levels; a candidate that does not match afterwards is dropped.
    fn rough(
        &mut self,
        start: &Pose<CamLeft, Model>,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<Pose<CamLeft, Model>> {
        self.estimate.cam_left_from_model = *start;
        let (mut problem, aligner, estimate) = self.problem(frame);
        let plan = AlignmentPlan { start: StartLevel::Coarsest, free: Free::Motion, steps_max: ROUGH_STEPS };
        let has_coarse_points = problem.surface.levels[2].points() >= POINTS_PREFERRED;
        let coarse = has_coarse_points.then_some((2..=LEVELS - 1, COARSE_RESEMBLANCE_MIN));
        let fine = (1..=if has_coarse_points { 1 } else { LEVELS - 1 }, ROUGH_RESEMBLANCE_MIN);
        for (levels, resemblance_min) in coarse.into_iter().chain([fine]) {
            let finest = *levels.start();
            aligner.align(&mut problem, estimate, levels, plan, may_continue)?;
            aligner.look(&problem, estimate, finest, &estimate.photometry())?;
            if aligner.resemblance(&problem, finest) < resemblance_min {
                return None;
            }
        }
        Some(estimate.cam_left_from_model)
    }

    fn with_depth(&self, pose: &Pose<CamLeft, Model>, frame: &Frame<'_>) -> Option<Pose<CamLeft, Model>> {
        // Chosen by hand, not varied: time grows on finer levels, steps of depth grow on coarser ones.
        let level = if self.surface.levels[2].points() >= POINTS_PREFERRED { 2 } else { 1 };
        let view = self.nearest_view(pose, frame.config).0;
        let (groups, view) = (&self.surface.levels[level].groups, &self.views[view].levels[level]);
        depth_by_stereo(groups, view, level, pose, &frame.images[1], frame.rig)
    }

    /// Candidate positions from this frame's share of the templates.
    fn places(&mut self, frame: &Frame<'_>) -> [Option<Place>; PLACES * TEMPLATES_PER_FRAME] {
        let mut all = [None; PLACES * TEMPLATES_PER_FRAME];
        let count = hypotheses(self.views.len());
        let last = self.motion.cam_left_from_model;
        let nearest = self.nearest_view(&last, frame.config).0;
        for turn in 0..TEMPLATES_PER_FRAME.min(count) {
            let others = (self.lost_frames as usize * (TEMPLATES_PER_FRAME - 1) + turn).saturating_sub(1);
            let index = if turn == 0 { 0 } else { 1 + others % (count - 1) };
            let (source, pose) = hypothesis(index, &last, &self.views);
            let view = if source == 0 { nearest } else { source - 1 };
            let found = self.places_of(view, &pose, frame);
            all[turn * PLACES..(turn + 1) * PLACES].copy_from_slice(&found);
        }
        all
    }

    /// The best position on each plane within reach.
    fn places_on(&mut self, planes: &[VisiblePlane], expected: &Pose<CamLeft, Model>, frame: &Frame<'_>) -> Vec<Place> {
        let last = self.motion.cam_left_from_model;
        let last_normal = last.rotation() * Vector3::z();
        let focal_px = frame.rig.left().pinhole().fx;
        let (reach_m, turn_max_rad) = (reach(self.away_s) * last.translation_m().norm(), reach_rad(self.away_s));
        let mut places = Vec::with_capacity(planes.len());
        for VisiblePlane { at_m, normal } in planes {
            let apart_m = SPACING_RADII * self.surface.radius_m;
            if (at_m - expected.translation_m()).norm() > reach_m + apart_m {
                continue;
            }
            let upright = UnitQuaternion::rotation_between(&last_normal, normal).unwrap_or_default() * last.rotation();
            let at_roll = |roll| Pose::from_parts(*at_m, upright * so3::exp(&(Vector3::z() * roll)));
            let rolls = (0..ROLLS).map(|k| at_roll(f64::from(k - ROLLS / 2) * ROLL_STEP_RAD));
            let mut best: Option<Place> = None;
            for pose in rolls {
                if pose.rotation().angle_to(&expected.rotation()) > turn_max_rad {
                    continue;
                }
                let view = &self.views[self.nearest_view(&pose, frame.config).0];
                let reach_px = 0.5 * apart_m / at_m.z * focal_px;
                let images = (&frame.images[0], frame.rig.left());
                let place = self.searcher.place_near(&self.surface, view, &pose, reach_px, images);
                best = best.into_iter().chain(place).max_by(|a, b| a.correlation.total_cmp(&b.correlation));
            }
            places.extend(best);
        }
        places
    }

    /// Positions in the left image that look like a view of the target from this pose.
    pub(super) fn places_of(
        &mut self,
        view: usize,
        pose: &Pose<CamLeft, Model>,
        frame: &Frame<'_>,
    ) -> [Option<Place>; PLACES] {
        self.searcher.places(&self.surface, &self.views[view], pose, &frame.images[0], frame.rig.left())
    }
}

/// A pose that fits.
#[derive(Clone, Copy, Debug)]
struct Found {
    view: usize,
    /// Distance from the predicted pose, and distance within which a target is near it, metres.
    way_m: f64,
    near_m: f64,
    estimate: Estimate,
    fit: Fit,
}

/// The target, if it and its twin are both visible and one is clearly nearer to the predicted pose. A single one may be either.
fn nearest_of_several(alike: &[Option<Found>]) -> Option<Found> {
    let all = || alike.iter().flatten();
    let nearest = all().min_by(|a, b| a.way_m.total_cmp(&b.way_m))?;
    let place = |alike: &Found| alike.estimate.cam_left_from_model.translation_m();
    let mut others = all().filter(|other| (place(other) - place(nearest)).norm() > nearest.near_m).peekable();
    let is_clear = others.peek().is_some() && others.all(|other| other.way_m > CLEARLY_NEARER * nearest.way_m);
    is_clear.then_some(*nearest)
}

/// A position at which a target may be.
#[derive(Clone, Copy)]
pub(super) struct Candidate {
    pub(super) place: Place,
    /// Whether its depth is searched first.
    pub(super) with_depth: bool,
}

/// Inserts a position into the sorted list after the prediction; a position next to a better one is dropped.
fn insert(candidates: &mut [Option<Candidate>], place: Place) {
    let at = place.cam_left_from_model.translation_m();
    let near = |other: &Place| (other.cam_left_from_model.translation_m() - at).norm() < 0.02 * at.z.abs();
    let Some(index) =
        (1..candidates.len()).find(|&i| candidates[i].is_none_or(|other| other.place.correlation < place.correlation))
    else {
        return;
    };
    if (1..index).any(|i| candidates[i].is_some_and(|other| near(&other.place))) {
        return;
    }
    candidates[index..].rotate_right(1);
    candidates[index] = Some(Candidate { place, with_depth: true });
}
