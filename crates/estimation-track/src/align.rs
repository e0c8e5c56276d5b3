//! Gauss-Newton alignment from coarse to fine: estimates the pose at which a stored view explains both images.

use nalgebra::{Isometry3, Vector6};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use super::images::{CameraImages, LEVELS};
use super::kernels::{
    self, CHANNELS, CameraRows, GroupScore, NormalSums, PATCH, PATCH_OWN, PATCH_RESIDUAL, PairWeights, Photometry, ROW,
    ResidualGroup, ResidualSums, SHAPE, SampledGroup, TERMS, ViewGroup,
};
use super::normal::{Free, NormalEquations, PatchScore, Prior, Step, Unknowns, UnknownsMatrix};
use super::observed::{noise_information, noise_weights, symmetric};
use super::surface::Surface;
use super::view::View;
use crate::kernels::Correlation;

/// Initial variance of the residuals, squared grey levels: small initial values reject everything if the cameras differ in
/// gain. Chosen by hand, not varied: 40 squared, as the prior of an offset.
const VARIANCE_START: f32 = 1600.0;
/// Smallest variance, squared grey levels: below it, quantisation dominates (1/12 for each of two images). Chosen by hand,
/// not varied: three times the quantisation.
const VARIANCE_MIN: f32 = 0.5;
/// Factor by which the robust weights reduce the variance of normal residuals. Chosen by hand, not varied; for normal
/// residuals in three channels it is 1.18 at `kernels::TUKEY`.
const TUKEY_LOSS: f32 = 1.25;
/// A level has converged when a step moves the points by less than this, pixels of that level. Chosen by hand, not varied:
/// smaller limits take more steps, larger ones leave a part of the motion as error.
const STEP_DONE_PX: [f64; LEVELS] = [0.012, 0.05, 0.1, 0.15];
/// Number of rounds in which weights and variances are updated alternately, in each step. Chosen by hand, not varied: the
/// time of a step grows with it.
const SCALE_ROUNDS: usize = 3;
/// Smallest correlation at which a view matches the images, by level. Chosen by hand, not varied: with less, alignments
/// start too fine to converge; with more, they start coarser and take longer.
const RESEMBLANCE_MIN: [f64; LEVELS] = [0.75, 0.7, 0.6, 0.0];
/// Smallest number of visible points for an alignment. Chosen by hand, not varied: three for each of the eight values of an
/// alignment (six of motion, gain and offset).
const POINTS_MIN: f32 = 24.0;
/// Prior standard deviations of the motion between frames: as a share of the distance from the camera, and radians. Larger motions
/// are implausible. Chosen by hand, not varied: weak beside a frame, it only holds motions that the images do not show.
const MOTION_SIGMA: f64 = 0.2;
const MOTION_SIGMA_RAD: f64 = 0.7;

/// State carried from frame to frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Estimate {
    pub(super) cam_left_from_model: Pose<CamLeft, Model>,
    pub(super) row_offset_px: f64,
    pub(super) gain: [[f32; CHANNELS]; 2],
    pub(super) offset: [[f32; CHANNELS]; 2],
    /// Variance of the residuals at full resolution.
    pub(super) variance: [[f32; CHANNELS]; TERMS],
    /// Standard deviation of a patch's offset relative to the stored view, grey levels.
    pub(super) patch_sigma: f64,
}

impl Estimate {
    pub(super) fn at(cam_left_from_model: Pose<CamLeft, Model>) -> Self {
        Self {
            cam_left_from_model,
            row_offset_px: 0.0,
            gain: [[1.0; CHANNELS]; 2],
            offset: [[0.0; CHANNELS]; 2],
            variance: [[VARIANCE_START; CHANNELS]; TERMS],
            patch_sigma: 1.0,
        }
    }
}

/// Input of an alignment.
pub(super) struct Problem<'a> {
    pub(super) surface: &'a mut Surface,
    pub(super) view: &'a View,
    pub(super) images: &'a [CameraImages; 2],
    pub(super) rig: &'a StereoRig,
    /// Prior knowledge of row offset and surface.
    pub(super) knowledge: &'a Knowledge,
}

/// Level at which an alignment starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StartLevel {
    /// The finest level at which view and images already match.
    Resembling,
    /// The coarsest level.
    Coarsest,
    /// The second finest level: the alignment stays where it starts, or fails.
    Fine,
}

/// How an alignment proceeds.
#[derive(Clone, Copy, Debug)]
pub(super) struct AlignmentPlan {
    pub start: StartLevel,
    /// Unknowns that are free at full resolution.
    pub free: Free,
    /// Largest number of steps per level.
    pub steps_max: usize,
}

/// Knowledge from earlier frames.
#[derive(Clone, Copy, Debug)]
pub(super) struct Knowledge {
    /// Row offset, pixels, and its information, 1/px^2.
    pub(super) row_offset_px: f64,
    pub(super) row_information: f64,
    /// Information about the surface's plane.
    pub(super) shape_information: nalgebra::Matrix3<f64>,
}

/// Result of an alignment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aligned {
    /// Whether the last step was below the convergence limit.
    pub(super) has_converged: bool,
    /// The last step, for updating the surface.
    pub(super) last: Step,
}

/// Buffers for one surface.
#[derive(Clone, Debug)]
pub(super) struct Aligner {
    kernels: Kernels,
    pub(super) sampled: [Vec<[SampledGroup; 2]>; LEVELS],
    pub(super) residuals: Vec<ResidualGroup>,
    patches: Vec<[f32; PATCH]>,
    group_scores: Vec<GroupScore>,
    pub(super) scores: Vec<PatchScore>,
    sums: Box<NormalSums>,
}

impl Aligner {
    pub(super) fn new(surface: &Surface, kernels: Kernels) -> Self {
        let count = surface.levels.iter().map(|level| level.groups.len()).max().unwrap_or(0);
        Self {
            kernels,
            sampled: std::array::from_fn(|level| vec![Default::default(); surface.levels[level].groups.len()]),
            residuals: vec![ResidualGroup::default(); count],
            patches: vec![[0.0; PATCH]; count],
            group_scores: vec![GroupScore::default(); count],
            scores: Vec::with_capacity(count),
            sums: Box::default(),
        }
    }

    /// Buffers of its own for the same surface.
    pub(super) fn another(&self, surface: &Surface) -> Self {
        Self::new(surface, self.kernels)
    }

    /// Aligns on `levels`, coarse to fine; calls `may_continue` before each step. `None` if too few points are visible or the
    /// equations are singular.
    pub(super) fn align(
        &mut self,
        problem: &mut Problem<'_>,
        estimate: &mut Estimate,
        levels: std::ops::RangeInclusive<usize>,
        AlignmentPlan { start, free, steps_max }: AlignmentPlan,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<Aligned> {
        let mut aligned = None;
        let mut steps = 0;
        let (first, mut is_fresh) = match start {
            StartLevel::Coarsest => (*levels.end(), false),
            StartLevel::Fine => (*levels.start() + 1, false),
            StartLevel::Resembling => self.first_level(problem, estimate, levels.clone()),
        };
        let levels = *levels.start()..=first;
        for level in levels.clone().rev() {
            // A small target has too few points on coarse levels.
            if (problem.surface.levels[level].points() as f32) < POINTS_MIN && level > *levels.start() {
                continue;
            }
            if !is_fresh {
                problem.linearise_lenses(level, &estimate.cam_left_from_model);
            }
            let mut photometry = estimate.photometry();
            for _ in 0..steps_max {
                if steps > 0 && !may_continue() {
                    return aligned;
                }
                let free = if level == 0 { free } else { free.without_shape() };
                let last = self.step(problem, estimate, level, &mut photometry, free, is_fresh)?;
                is_fresh = false;
                steps += 1;
                let moved_px = problem.moved_px(estimate, &last.unknowns);
                let has_converged = moved_px < STEP_DONE_PX[level] * f64::from(1_u32 << level);
                aligned = Some(Aligned { has_converged, last });
                if has_converged {
                    break;
                }
            }
            if level == 0 {
                estimate.variance = photometry.variance;
            }
        }
        aligned
    }

    /// The finest level at which the view already matches both images. Gauss-Newton converges from there; coarser levels
    /// contain less information and could only mislead it.
    fn first_level(
        &mut self,
        problem: &mut Problem<'_>,
        estimate: &Estimate,
        levels: std::ops::RangeInclusive<usize>,
    ) -> (usize, bool) {
        for level in levels.clone() {
            problem.linearise_lenses(level, &estimate.cam_left_from_model);
            if self.look(problem, estimate, level, &estimate.photometry()).is_some()
                && self.resemblance(problem, level) >= RESEMBLANCE_MIN[level]
            {
                return (level, true);
            }
        }
        (*levels.end(), true)
    }

    /// Correlation of the view with the image that it matches worse.
    pub(super) fn resemblance(&self, problem: &Problem<'_>, level: usize) -> f64 {
        let [left, right] = kernels::correlate(self.kernels, &self.sampled[level], &problem.view.levels[level], None);
        left.value().min(right.value())
    }

    /// Weighted correlations of the view with both images at full resolution.
    pub(super) fn correlate(&self, view: &[ViewGroup]) -> [Correlation; 2] {
        kernels::correlate(self.kernels, &self.sampled[0], view, Some(&self.residuals))
    }

    /// Runs one step.
    fn step(
        &mut self,
        problem: &mut Problem<'_>,
        estimate: &mut Estimate,
        level: usize,
        photometry: &mut Photometry,
        free: Free,
        is_fresh: bool,
    ) -> Option<Step> {
        let mut sums = if is_fresh {
            self.weigh(problem, level, photometry)
        } else {
            self.look(problem, estimate, level, photometry)?
        };
        for _ in 0..SCALE_ROUNDS {
            photometry.learn(&sums);
            sums = self.weigh(problem, level, photometry);
        }
        let count = problem.surface.levels[level].groups.len();
        let weights = PairWeights::of(&photometry.variance);
        *self.sums = NormalSums::default();
        self.accumulate(problem, level, 0..count, &weights);
        let mut equations = NormalEquations::empty();
        equations.add(&self.sums);
        equations.remove_patch_offsets(&self.patches[..count], estimate.patch_sigma);
        let step = equations.solve(&problem.prior(estimate), free)?;
        estimate.apply(&step, free);
        (photometry.gain, photometry.offset) = (estimate.gain, estimate.offset);
        Some(step)
    }

    /// Projects, samples and weights the points at the current estimate.
    pub(super) fn look(
        &mut self,
        problem: &Problem<'_>,
        estimate: &Estimate,
        level: usize,
        photometry: &Photometry,
    ) -> Option<ResidualSums> {
        let (kernels, surface) = (self.kernels, &problem.surface.levels[level]);
        let sampled = &mut self.sampled[level];
        for (side, images) in problem.images.iter().enumerate() {
            let rows = camera_rows(&problem.cam_from_model(side, &estimate.cam_left_from_model));
            let row_offset = if side == 1 { estimate.row_offset_px as f32 } else { 0.0 };
            kernels::project(kernels, &surface.groups, &surface.lens[side], &rows, row_offset, sampled, side);
            kernels::sample(kernels, images, level, sampled, side);
        }
        let sums = self.weigh(problem, level, photometry);
        (sums.points[0].max(sums.points[1]) >= POINTS_MIN).then_some(sums)
    }

    fn weigh(&mut self, problem: &Problem<'_>, level: usize, photometry: &Photometry) -> ResidualSums {
        let view = &problem.view.levels[level];
        kernels::weigh(self.kernels, &self.sampled[level], view, photometry, &mut self.residuals)
    }

    fn accumulate(
        &mut self,
        problem: &Problem<'_>,
        level: usize,
        range: std::ops::Range<usize>,
        weights: &PairWeights,
    ) {
        kernels::accumulate(
            self.kernels,
            &problem.surface.levels[level].groups[range.clone()],
            &self.sampled[level][range.clone()],
            &problem.view.levels[level][range.clone()],
            &self.residuals[range.clone()],
            weights,
            &mut self.sums,
            &mut self.patches[range],
        );
    }

    /// The normal equations at the estimate, patch by patch, at full resolution: for covariance, relief and evaluation.
    /// Variances are limited to `variance_max`. If it `is_fresh`, i.e. the last step moved nothing, the samples of that step
    /// are reused.
    pub(super) fn examine(
        &mut self,
        problem: &Problem<'_>,
        estimate: &Estimate,
        variance_max: &[[f32; CHANNELS]; TERMS],
        is_fresh: bool,
    ) -> Option<NormalEquations> {
        let mut variance = estimate.variance;
        for (own, most) in variance.iter_mut().flatten().zip(variance_max.iter().flatten()) {
            *own = own.min(*most);
        }
        let photometry = estimate.photometry_with(variance);
        if is_fresh {
            self.weigh(problem, 0, &photometry);
        } else {
            self.look(problem, estimate, 0, &photometry)?;
        }
        let sharing = problem.surface.noise_sharing as f32;
        let weights = PairWeights::of(&photometry.variance.map(|term| term.map(|v| v * sharing)));
        let count = problem.surface.levels[0].groups.len();
        *self.sums = NormalSums::default();
        self.accumulate(problem, 0, 0..count, &weights);
        let mut equations = NormalEquations::empty();
        equations.add(&self.sums);
        equations.remove_patch_offsets(&self.patches[..count], estimate.patch_sigma);
        let noise = noise_weights(&weights, &photometry.variance[2], &problem.view.noise_variance);
        let (groups, sampled) = (&problem.surface.levels[0].groups, &self.sampled[0]);
        equations.noise = symmetric(&noise_information(self.kernels, groups, sampled, &self.residuals, &noise));
        kernels::score(
            self.kernels,
            &problem.surface.levels[0].groups,
            &self.sampled[0],
            &problem.view.levels[0],
            &self.residuals,
            &weights,
            &mut self.group_scores[..count],
        );
        self.scores.clear();
        let groups = self.group_scores[..count].iter().zip(&self.patches);
        self.scores.extend(groups.map(|(group, patch)| PatchScore::of(group, patch, estimate.patch_sigma)));
        Some(equations)
    }

    /// Spread of the patches' mean residuals relative to the stored view: standard deviation of the shading, grey levels.
    pub(super) fn patch_spread(&self) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for patch in &self.patches[..self.scores.len()] {
            let own = f64::from(patch[PATCH_OWN]);
            if own > 0.0 {
                let mean = f64::from(patch[PATCH_RESIDUAL]) / own;
                sum += own * (mean * mean - 1.0 / own);
                weight += own;
            }
        }
        if weight > 0.0 { (sum / weight).max(0.0).sqrt() } else { 0.0 }
    }

    /// Projects one level of the surface into the left image, for storing a view.
    pub(super) fn project_left(
        &mut self,
        problem_surface: &mut Surface,
        level: usize,
        rig: &StereoRig,
        pose: &Pose<CamLeft, Model>,
    ) {
        problem_surface.linearise_lens(level, 0, rig.left(), pose.isometry());
        let surface = &problem_surface.levels[level];
        let rows = camera_rows(pose.isometry());
        kernels::project(self.kernels, &surface.groups, &surface.lens[0], &rows, 0.0, &mut self.sampled[level], 0);
    }
}

impl Free {
    fn without_shape(self) -> Self {
        if self == Self::Everything { Self::Motion } else { self }
    }
}

impl Estimate {
    /// Initial photometric state of a level: its residuals are unknown.
    pub(super) fn photometry(&self) -> Photometry {
        self.photometry_with([[VARIANCE_START; CHANNELS]; TERMS])
    }

    fn photometry_with(&self, variance: [[f32; CHANNELS]; TERMS]) -> Photometry {
        Photometry { gain: self.gain, offset: self.offset, variance }
    }

    fn apply(&mut self, step: &Step, free: Free) {
        if free != Free::Surface {
            let xi: Vector6<f64> = step.unknowns.fixed_rows::<6>(0).into_owned();
            self.cam_left_from_model = self.cam_left_from_model.perturbed_in_from(&xi);
        }
        self.row_offset_px += step.unknowns[ROW];
        for side in 0..2 {
            for c in 0..CHANNELS {
                self.gain[side][c] += step.gain[side][c] as f32;
                self.offset[side][c] += step.offset[side][c] as f32;
            }
        }
    }
}

impl Photometry {
    /// Updates the variance of the residuals; within a level it only decreases.
    fn learn(&mut self, sums: &ResidualSums) {
        for term in 0..TERMS {
            for c in 0..CHANNELS {
                if sums.weights[term] > 0.0 {
                    let measured = TUKEY_LOSS * sums.squares[term][c] / sums.weights[term];
                    self.variance[term][c] = measured.min(self.variance[term][c]).max(VARIANCE_MIN);
                }
            }
        }
    }
}

impl Problem<'_> {
    pub(super) fn cam_from_model(&self, side: usize, cam_left_from_model: &Pose<CamLeft, Model>) -> Isometry3<f64> {
        match side {
            0 => *cam_left_from_model.isometry(),
            _ => *(*self.rig.cam_right_from_cam_left() * *cam_left_from_model).isometry(),
        }
    }

    fn linearise_lenses(&mut self, level: usize, pose: &Pose<CamLeft, Model>) {
        let (left, right) = (self.cam_from_model(0, pose), self.cam_from_model(1, pose));
        self.surface.linearise_lens(level, 0, self.rig.left(), &left);
        self.surface.linearise_lens(level, 1, self.rig.right(), &right);
    }

    pub(super) fn prior(&self, estimate: &Estimate) -> Prior {
        self.knowledge.prior(estimate)
    }

    /// Largest motion of the points by a step, pixels.
    fn moved_px(&self, estimate: &Estimate, unknowns: &Unknowns) -> f64 {
        let scale = self.rig.left().pinhole().fx / estimate.cam_left_from_model.translation_m().z.abs().max(1e-3);
        let (rho, phi) = (unknowns.fixed_rows::<3>(0).norm(), unknowns.fixed_rows::<3>(3).norm());
        scale * (rho + phi * 0.5 * self.surface.radius_m)
    }
}

impl Knowledge {
    pub(super) fn prior(&self, estimate: &Estimate) -> Prior {
        let mut information = UnknownsMatrix::zeros();
        let distance_m = estimate.cam_left_from_model.translation_m().norm();
        for i in 0..6 {
            let sigma = if i < 3 { MOTION_SIGMA * distance_m } else { MOTION_SIGMA_RAD };
            information[(i, i)] = 1.0 / (sigma * sigma);
        }
        information[(ROW, ROW)] = self.row_information;
        information.fixed_view_mut::<3, 3>(SHAPE, SHAPE).copy_from(&self.shape_information);
        let mut pull = Unknowns::zeros();
        pull[ROW] = self.row_information * (self.row_offset_px - estimate.row_offset_px);
        Prior { information, pull }
    }
}

fn camera_rows(cam_from_model: &Isometry3<f64>) -> CameraRows {
    let matrix = cam_from_model.to_homogeneous();
    std::array::from_fn(|i| matrix[(i / 4, i % 4)] as f32)
}
