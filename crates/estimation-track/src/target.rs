//! One target: its surface, its stored views, and its state.

mod ending;
mod exposures;
mod lost;
mod periodic;
mod placing;
mod surface_evidence;
mod twins;

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, Vector2};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::LANES;
use pb3dp_estimation_views::image_plane::PixelWindow;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Camera, Pose, StereoRig};

use super::align::{Aligned, Aligner, AlignmentPlan, Estimate, Knowledge, Problem, StartLevel};
use super::config::DirectTrackerConfig;
use super::distinct::independent_points;
use super::export::surface_point;
use super::images::{CameraImages, LEVELS};
use super::judge::{Fit, Limits};
use super::kernels::{CHANNELS, ROW, TERMS};
use super::normal::{Free, NormalEquations};
use super::one_surface::{Pair, Part, has_relief, is_curved, largest_part};
use super::predict::{Expected, Motion};
use super::reach::{Sighting, near_m};
use super::search::{Searcher, mirrored};
use super::shape::Shares;
use super::stereo_relief;
use super::surface::Surface;
use super::view::View;
pub(super) use ending::Ending;
use pb3dp_estimation_core::method::{FramePrior, SurfacePoint};
use periodic::Periodic;
use surface_evidence::SurfaceEvidence;

/// Weights of a frame's information about the surface. All frames share the noise of the stored view, which hardly affects
/// the disparities that determine the relief. The view alone determines the plane's tilt: half of the variance is the
/// view's own, so any number of frames gives no more information than two would without it (`plane_in_all`). The two other
/// weights are chosen by hand, not varied.
const SHARES: Shares = Shares { relief: 0.5, plane: 0.15, plane_in_all: 2.0 };
/// Weight of a frame's information about the row offset. Chosen by hand, not varied: 50 frames count as much as one that is
/// independent.
const ROW_SHARE: f64 = 0.02;
/// Information about the row offset before the first frame: a standard deviation of half a pixel, as of a moderate calibration. Chosen by
/// hand, not varied.
const ROW_INFORMATION_START: f64 = 4.0;
/// Largest information about the row offset (0.01 px). Chosen by hand, not varied: with more, a row offset that drifts is
/// not followed.
const ROW_INFORMATION_MAX: f64 = 1e4;
/// Largest ratio of residual variances to those of fitting frames. Chosen by hand, not varied: with more, a bad frame sets
/// the noise of later ones.
const VARIANCE_SLACK: f32 = 3.0;
/// Rate at which the reference variances are updated. Chosen by hand, not varied: 20 frames.
const REFERENCE_RATE: f32 = 0.05;
/// Smallest visible share of the model. Chosen by hand, not varied: with less, poses of a small part of the target are
/// given.
const VISIBLE_MIN: f64 = 0.35;
/// A fit is as good as noise allows if it reaches these shares of the expected correlation and of inliers. Chosen by hand,
/// not varied: with more, more frames are aligned twice; with less, worse frames are learned from.
const WELL_CORRELATED: f64 = 0.96;
const WELL_FITTING: f64 = 0.88;
/// Largest share of points with a saturated colour in a view that is kept. Chosen by hand, not varied: with more, views lack
/// points; with less, a target with a few bright spots gets no new views.
const CLIPPED_MAX: f32 = 0.1;
/// Factor by which the limits are stricter for a target that is found again. Chosen by hand, not varied: with less, other
/// objects are accepted; with more, a hidden target stays lost longer.
const FOUND_AGAIN_STRICTER: f64 = 1.25;
/// Range of the shading's standard deviation, grey levels, and its update rate. Chosen by hand, not varied: the update
/// takes about five frames.
const PATCH_SIGMA_MIN: f64 = 0.5;
const PATCH_SIGMA_MAX: f64 = 30.0;
const PATCH_SIGMA_RATE: f64 = 0.2;

/// Input of a frame.
pub(super) struct Frame<'a> {
    pub(super) images: &'a [CameraImages; 2],
    pub(super) rig: &'a StereoRig,
    pub(super) config: &'a DirectTrackerConfig,
}

#[derive(Clone, Debug)]
pub(super) struct Target {
    pub(super) surface: Surface,
    /// Views in use; the first one is the initial view.
    pub(super) views: Vec<View>,
    /// Preallocated views, so that storing a view allocates no memory.
    spare_views: Vec<View>,
    view: usize,
    aligner: Aligner,
    searcher: Searcher,
    pub(super) estimate: Estimate,
    knowledge: Knowledge,
    pub(super) motion: Motion,
    pub(super) frame: u64,
    pub(super) lost_frames: u32,
    /// Time since the target was last found, seconds.
    pub(super) away_s: f64,
    pub(super) outline_in_model: Vec<Point3<f64>>,
    pub(super) covariance: Option<Matrix6<f64>>,
    /// Takes motions that the images do not show out of a motion; `None` if they show all.
    keep: Option<Matrix6<f64>>,
    pub(super) fit: Fit,
    reference: [[f32; CHANNELS]; TERMS],
    /// Number of independent points of the texture.
    independent_points: f64,
    /// Whether a similar object was seen beside the target.
    pub(super) has_twin: bool,
    /// Hypotheses of a look for similar objects that were not tried yet.
    looks_open: usize,
    /// Whether the target was found where it was not expected, and no later frame has confirmed it.
    pub(super) is_unverified: bool,
    /// Periods of the texture; `None` if it does not repeat.
    periodic: Option<Box<Periodic>>,
    /// Whether the frame `model` is on the plane of the visible surface, whose covariance is in that of the first pose.
    pub(super) is_on_surface: bool,
    /// What later pairs show of the surface.
    evidence: SurfaceEvidence,
    /// Covariance of the first pose.
    pub(super) first_pose_covariance: Option<Matrix6<f64>>,
    /// The same without the error of a motion between the exposures of the first pair.
    pub(super) first_pose_covariance_at_rest: Option<Matrix6<f64>>,
    /// Time between the exposures of the first pair, as long as the motion in it is not known, seconds.
    pub(super) first_skew_s: Option<f64>,
}

impl Target {
    /// Creates a target with a surface close to the plane of `surface`, in the first pair (both windows loaded).
    pub(super) fn first(
        mut surface: Surface,
        pose: Pose<CamLeft, Model>,
        outline_in_model: Vec<Point3<f64>>,
        frame: &Frame<'_>,
        kernels: Kernels,
    ) -> Self {
        let aligner = Aligner::new(&surface, kernels);
        let blank = View::empty(std::array::from_fn(|level| surface.levels[level].groups.len()));
        surface.rebuild();
        let size = frame.rig.left().size();
        let mut target = Self {
            surface,
            views: Vec::with_capacity(frame.config.views_max),
            spare_views: vec![blank; frame.config.views_max],
            view: 0,
            aligner,
            searcher: Searcher::new(size.width, size.height, kernels),
            estimate: Estimate::at(pose),
            knowledge: Knowledge {
                row_offset_px: 0.0,
                row_information: ROW_INFORMATION_START,
                shape_information: Matrix3::identity() * 1e-3,
            },
            motion: Motion::resting(pose),
            frame: 0,
            lost_frames: 0,
            away_s: 0.0,
            outline_in_model,
            covariance: None,
            keep: None,
            fit: Fit::default(),
            reference: [[0.0; CHANNELS]; TERMS],
            independent_points: 0.0,
            has_twin: false,
            looks_open: 0,
            is_unverified: false,
            periodic: None,
            is_on_surface: false,
            evidence: SurfaceEvidence::default(),
            first_pose_covariance: None,
            first_pose_covariance_at_rest: None,
            first_skew_s: None,
        };
        target.keep_view(frame, false);
        target.independent_points = independent_points(&target.surface.levels[0], &target.views[0].levels[0]);
        target.find_relief(frame);
        target
    }

    fn find_relief(&mut self, frame: &Frame<'_>) {
        let Self { surface, views, aligner, estimate, knowledge, .. } = self;
        let Some(view) = views.first() else { return };
        let mut problem = Problem { surface, view, images: frame.images, rig: frame.rig, knowledge };
        stereo_relief::find(aligner, &mut problem, estimate, frame.config.relief_sigma_px);
        // The view is the left image itself, so its difference from the left image is as small as noise alone makes that from
        // the right.
        estimate.variance[0] = estimate.variance[1];
        self.reference = self.estimate.variance;
        if let Some(equations) = self.examine(frame, false) {
            self.judge();
            self.conclude(&equations, false);
        }
    }

    /// The largest part of the region that is one surface; `None` if the whole region is. `of_several`: the region is the
    /// remainder of several surfaces.
    pub(super) fn largest_part(&self, of_several: bool) -> Option<Part> {
        largest_part(&self.surface, self.first_pair(), of_several)
    }

    fn first_pair(&self) -> Pair<'_> {
        let Aligner { sampled, residuals, .. } = &self.aligner;
        Pair { view: &self.views[0].levels[0], sampled: &sampled[0], residuals }
    }

    /// Whether the surface of the first pair is curved.
    pub(super) fn is_curved(&self) -> bool {
        is_curved(&self.surface, self.first_pair())
    }

    /// Whether it has a relief, be it a small one.
    pub(super) fn has_relief(&self) -> bool {
        has_relief(&self.surface, self.first_pair())
    }

    /// The points of the surface, with their colours in the first view.
    pub(super) fn surface_points(&self) -> Vec<SurfacePoint> {
        let (groups, view) = (&self.surface.levels[0].groups, &self.views[0].levels[0]);
        let sigmas_px = self.surface.shape.sigmas_px();
        let first_from_model = self.surface.model_from_first.inverse();
        let lanes = groups.iter().zip(view).zip(&sigmas_px).flat_map(|((group, view), sigma_px)| {
            let sigma_inverse = sigma_px * self.surface.relief.inverse_depth_per_px();
            (0..LANES)
                .filter(|&i| group.mask.0[i] > 0.0)
                .map(move |i| surface_point(group, view, i, &first_from_model, sigma_inverse))
        });
        lanes.collect()
    }

    /// Aligns from a predicted pose, and evaluates the fit. `step_s`: time since the last frame, seconds.
    pub(super) fn follow(
        &mut self,
        expected: &Expected,
        step_s: Option<f64>,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Ending {
        let predicted = &expected.pose;
        self.view = self.nearest_view(predicted, frame.config).0;
        let mut found = self.attempt(predicted, StartLevel::Resembling, frame, may_continue);
        if !found.as_ref().is_some_and(|_| self.fits_well()) && may_continue() {
            found = self.or_better(found, predicted, StartLevel::Coarsest, frame, may_continue);
        }
        let found = self.or_mirrored(found, frame, may_continue);
        let found = self.or_still_there(found, predicted, frame, may_continue);
        let Some(equations) = found else { return Ending::OutOfSight };
        if let Some(misfit) = self.fit.misfit(&self.limits(frame.config)) {
            return Ending::Misfit(misfit);
        }
        let sighting = self.sighting(predicted);
        if !sighting.is_within_step(step_s) || !self.fits_well() && !sighting.can_have_moved() {
            return Ending::OutOfReach;
        }
        let equations = self.settle(equations, predicted, 0.0, frame, may_continue);
        self.learn(&equations);
        self.keep_unseen(expected);
        Ending::Found
    }

    /// Takes motions that the images do not show from the expected pose: otherwise noise would move the pose along them, frame by frame
    /// and further each time. Their velocity decreases, since nothing confirms it.
    fn keep_unseen(&mut self, Expected { pose, coasted }: &Expected) {
        if let Some(keep) = &self.keep {
            let found = (pose.inverse() * self.estimate.cam_left_from_model).log();
            let coasted = (pose.inverse() * *coasted).log();
            self.estimate.cam_left_from_model = pose.perturbed_in_from(&(coasted + keep * (found - coasted)));
        }
    }

    /// Keeps the result, or takes that of another start if it fits better.
    fn or_better(
        &mut self,
        found: Option<NormalEquations>,
        from: &Pose<CamLeft, Model>,
        start: StartLevel,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<NormalEquations> {
        let (estimate, fit) = (self.estimate, self.fit);
        let other = self.attempt(from, start, frame, may_continue);
        let Some(found) = found else { return other };
        if other.is_some() && self.fit.goodness() > fit.goodness() {
            return other;
        }
        (self.estimate, self.fit) = (estimate, fit);
        Some(self.examine(frame, false).unwrap_or(found))
    }

    /// Keeps the result, or takes that with mirrored tilt if it fits better. With one camera a small target looks nearly the
    /// same with its tilt mirrored; if the images do not agree, an alignment may have ended at the wrong tilt.
    fn or_mirrored(
        &mut self,
        found: Option<NormalEquations>,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<NormalEquations> {
        let mirrored = mirrored(&self.estimate.cam_left_from_model);
        if found.is_none() || self.fits_well() || !self.fit.images_disagree() || !may_continue() {
            return found;
        }
        self.or_better(found, &mirrored, StartLevel::Resembling, frame, may_continue)
    }

    /// One alignment from a pose, examined and evaluated by [`Self::fit`].
    fn attempt(
        &mut self,
        from: &Pose<CamLeft, Model>,
        start: StartLevel,
        frame: &Frame<'_>,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<NormalEquations> {
        self.estimate.cam_left_from_model = *from;
        let aligned = self.align(frame, start, Free::Motion, may_continue)?;
        let equations = self.examine(frame, aligned.has_converged)?;
        self.judge();
        Some(equations)
    }

    /// Whether the fit is as good as noise allows, so that no better one needs to be searched.
    fn fits_well(&self) -> bool {
        let relative = |side: usize| self.fit.correlation[side] / self.fit.correlation_expected[side];
        relative(0).min(relative(1)) >= WELL_CORRELATED
            && self.fit.inlier_share[0].min(self.fit.inlier_share[1]) >= WELL_FITTING
    }

    fn problem<'a>(&'a mut self, frame: &'a Frame<'_>) -> (Problem<'a>, &'a mut Aligner, &'a mut Estimate) {
        let Self { surface, views, view, aligner, estimate, knowledge, .. } = self;
        (Problem { surface, view: &views[*view], images: frame.images, rig: frame.rig, knowledge }, aligner, estimate)
    }

    fn align(
        &mut self,
        frame: &Frame<'_>,
        start: StartLevel,
        free: Free,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<Aligned> {
        let steps_max = frame.config.steps_max;
        let (mut problem, aligner, estimate) = self.problem(frame);
        aligner.align(&mut problem, estimate, 0..=LEVELS - 1, AlignmentPlan { start, free, steps_max }, may_continue)
    }

    fn examine(&mut self, frame: &Frame<'_>, is_fresh: bool) -> Option<NormalEquations> {
        let most = self.reference.map(|term| term.map(|v| v * VARIANCE_SLACK));
        let (problem, aligner, estimate) = self.problem(frame);
        aligner.examine(&problem, estimate, &most, is_fresh)
    }

    fn limits(&self, config: &DirectTrackerConfig) -> Limits {
        let limits = Limits {
            inlier_share_min: config.inlier_share_min,
            correlation_min: config.correlation_min,
            visible_share_min: VISIBLE_MIN,
        };
        limits.stricter(if self.lost_frames > 0 { FOUND_AGAIN_STRICTER } else { 1.0 })
    }

    fn judge(&mut self) {
        let view = &self.views[self.view].levels[0];
        let points = self.surface.points() as f64;
        let Aligner { sampled, residuals, .. } = &self.aligner;
        let correlations = self.aligner.correlate(view);
        self.fit = Fit::measure(&sampled[0], view, residuals, &correlations, points, &self.reference);
    }

    /// Computes the covariance of the pose; if the frame `learns`, adds its information to the surface and corrects the pose.
    fn conclude(&mut self, equations: &NormalEquations, learns: bool) {
        let Self { surface, aligner, estimate, knowledge, .. } = self;
        (self.covariance, self.keep) = (None, None);
        let Some(equations) = equations.inverse(&knowledge.prior(estimate), Free::Motion) else { return };
        let depth_sigma = surface.relief.depth_sigma();
        let Some(shown) = equations.pose_covariance(&aligner.scores, depth_sigma) else { return };
        surface.shape.read(&equations, &aligner.scores, surface.relief.inverse_depth_per_px());
        let is_known = if learns { surface.shape.learn(&SHARES) } else { surface.shape.hold() };
        if !is_known {
            return;
        }
        let (step, open) = surface.shape.pose();
        self.covariance = Some(shown.covariance + open);
        self.keep = shown.is_partial.then_some(shown.keep);
        if learns {
            estimate.cam_left_from_model = estimate.cam_left_from_model.perturbed_in_from(&step);
            surface.take_shape();
        }
        let row = equations.inverse[(ROW, ROW)];
        let gained = (1.0 / row - knowledge.row_information).max(0.0);
        knowledge.row_information = (knowledge.row_information + ROW_SHARE * gained).min(ROW_INFORMATION_MAX);
        knowledge.row_offset_px = estimate.row_offset_px;
    }

    /// Updates surface, row offset, noise and shading. Later views are tied to estimated poses and their errors. They therefore
    /// contribute no information about the surface, only their own errors.
    fn learn(&mut self, equations: &NormalEquations) {
        let fits_well = self.fits_well() && !self.in_doubt();
        self.conclude(equations, fits_well && self.view == 0);
        let Self { aligner, estimate, reference, .. } = self;
        if !fits_well {
            return;
        }
        for (old, new) in reference.iter_mut().flatten().zip(estimate.variance.iter().flatten()) {
            *old += REFERENCE_RATE * (new.min(VARIANCE_SLACK * *old) - *old);
        }
        let spread = aligner.patch_spread().clamp(PATCH_SIGMA_MIN, PATCH_SIGMA_MAX);
        estimate.patch_sigma += PATCH_SIGMA_RATE * (spread - estimate.patch_sigma);
    }

    /// The view nearest to a pose, and its distance: 1 where a new view is due.
    fn nearest_view(&self, pose: &Pose<CamLeft, Model>, config: &DirectTrackerConfig) -> (usize, f64) {
        let distance = |view: &View| view.distance(pose, config.view_turn_deg.to_radians(), config.view_scale);
        let mut best = (0, f64::MAX);
        for (index, view) in self.views.iter().enumerate() {
            let distance = distance(view);
            if distance < best.1 {
                best = (index, distance);
            }
        }
        best
    }

    /// Completes a frame in which the target was found: updates the motion, and stores a new view if all are far.
    pub(super) fn accept(&mut self, frame: &Frame<'_>, prior: &FramePrior) {
        let pose = self.estimate.cam_left_from_model;
        if self.lost_frames > 0 {
            self.motion.restart(&pose);
        } else {
            self.motion.learn(&pose, prior);
            self.is_unverified = false;
        }
        (self.lost_frames, self.away_s) = (0, 0.0);
        self.views[self.view].last_used = self.frame;
        let is_good = self.fits_well() && !self.in_doubt() && !self.is_unverified && !self.is_overexposed();
        let is_new = is_good && self.nearest_view(&pose, frame.config).1 > 1.0;
        if is_new {
            self.keep_view(frame, true);
        }
        self.plan_look(is_new);
    }

    /// Whether so much of the left image is saturated that a view of it would lack many points.
    fn is_overexposed(&self) -> bool {
        let (mut clipped, mut valid) = (0.0, 0.0);
        for [left, _] in &self.aligner.sampled[0] {
            valid += left.valid.sum();
            clipped += (0..LANES).filter(|&i| left.valid.0[i] > 0.0 && left.clipped.0[i] > 0.0).count() as f32;
        }
        clipped > CLIPPED_MAX * valid
    }

    /// Stores the current left image as a view; if there is no free slot, it replaces the least recently used view.
    fn keep_view(&mut self, frame: &Frame<'_>, only_fitting: bool) {
        let pose = self.estimate.cam_left_from_model;
        let index = if let Some(view) = self.spare_views.pop() {
            self.views.push(view);
            self.views.len() - 1
        } else {
            let oldest = (1..self.views.len()).min_by_key(|&i| self.views[i].last_used);
            let Some(oldest) = oldest else { return };
            oldest
        };
        for level in 0..LEVELS {
            self.aligner.project_left(&mut self.surface, level, frame.rig, &pose);
            let fitting = (only_fitting && level == 0).then_some(self.aligner.residuals.as_slice());
            self.views[index].take_level(level, &frame.images[0], &self.aligner.sampled[level], fitting);
        }
        self.views[index].cam_left_from_model = pose;
        self.views[index].last_used = self.frame;
    }

    /// Whether the first pair certainly shows one surface.
    pub(super) fn is_a_surface(&self) -> bool {
        self.fit.is_a_surface(self.independent_points)
    }

    /// Whether the estimate is near the expected pose.
    pub(super) fn is_near(&self, expected: &Pose<CamLeft, Model>) -> bool {
        self.sighting(expected).is_near()
    }

    /// The estimate as a candidate, relative to the expected pose.
    fn sighting(&self, expected: &Pose<CamLeft, Model>) -> Sighting<'_> {
        let found = &self.estimate.cam_left_from_model;
        let distance_m = expected.translation_m().norm();
        let moved_m = (expected.translation_m() - self.motion.cam_left_from_model.translation_m()).norm();
        Sighting {
            fit: &self.fit,
            independent: self.independent_points,
            near_m: near_m(self.surface.radius_m, distance_m, moved_m),
            distance_m,
            way_m: (found.translation_m() - expected.translation_m()).norm(),
            turn_rad: found.rotation().angle_to(&expected.rotation()),
            away_s: self.away_s,
            has_twin: self.has_twin,
        }
    }
}

/// Box around the target in an image.
pub(super) fn window(
    outline_in_model: &[Point3<f64>],
    camera: &Camera,
    cam_from_model: &Isometry3<f64>,
) -> PixelWindow {
    let (mut low, mut high) = (Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN));
    for point in outline_in_model {
        if let Some(px) = camera.project(&(cam_from_model * point)) {
            (low, high) = (low.inf(&px), high.sup(&px));
        }
    }
    if low.x > high.x {
        return PixelWindow::default();
    }
    let most = 2.0 * f64::from(camera.size().width.max(camera.size().height));
    let (low, high) = (low.map(|x| x.clamp(-most, most)), high.map(|x| x.clamp(-most, most)));
    PixelWindow {
        x: low.x.floor() as i32,
        y: low.y.floor() as i32,
        width: (high.x - low.x).ceil() as usize + 1,
        height: (high.y - low.y).ceil() as usize + 1,
    }
}
