//! Gauss-Newton from coarse to fine: the pose at which a kept view explains both images.

use nalgebra::{Isometry3, Vector6};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use super::images::{EyeImages, LEVELS};
use super::kernels::{
    self, CHANNELS, CameraRows, NormalSums, PATCH, PairWeights, Photometry, ROW, ResidualGroup, ResidualSums, SHAPE,
    SeenGroup, TERMS,
};
use super::normal::{Free, NormalEquations, PatchScore, Prior, Step, Unknowns, UnknownsMatrix};
use super::relief::Correlation;
use super::surface::Surface;
use super::view::View;
use crate::cpu::Kernels;
use crate::wide::LANES;

/// Variance that residuals start with before anything is known, grey levels squared: small starts reject everything where
/// the cameras differ in gain.
const VARIANCE_START: f32 = 225.0;
/// Smallest variance, grey levels squared: below, quantisation counts.
const VARIANCE_MIN: f32 = 0.5;
/// What the robust weights take off the variance of normal residuals.
const TUKEY_LOSS: f32 = 1.25;
/// A level is done when a step moves the points by less, pixels of that level.
const STEP_DONE_PX: [f64; LEVELS] = [0.006, 0.03, 0.06, 0.1];
/// A view resembles the images from this correlation on.
const RESEMBLANCE_MIN: f64 = 0.6;
/// Fewer points in sight than this determine nothing.
const POINTS_MIN: f32 = 24.0;
/// Standard deviations of a motion between frames that is not believed in at all: metres and radians.
const MOTION_SIGMA: (f64, f64) = (0.1, 0.7);

/// Everything that is carried from frame to frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Estimate {
    pub(super) cam_left_from_model: Pose<CamLeft, Model>,
    pub(super) row_offset_px: f64,
    pub(super) gain: [[f32; CHANNELS]; 2],
    pub(super) offset: [[f32; CHANNELS]; 2],
    /// Of the residuals at full resolution.
    pub(super) variance: [[f32; CHANNELS]; TERMS],
    /// Standard deviation of a patch's offset against the kept view, grey levels.
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

/// What a frame is aligned with.
pub(super) struct Problem<'a> {
    pub(super) surface: &'a mut Surface,
    pub(super) view: &'a View,
    pub(super) images: &'a [EyeImages; 2],
    pub(super) rig: &'a StereoRig,
    /// What is known of row offset and surface.
    pub(super) knowledge: &'a Knowledge,
}

/// What earlier frames know.
#[derive(Clone, Copy, Debug)]
pub(super) struct Knowledge {
    /// Row offset, pixels, and its information, 1/px^2.
    pub(super) row_offset_px: f64,
    pub(super) row_information: f64,
    /// Information about the surface's plane.
    pub(super) shape_information: nalgebra::Matrix3<f64>,
}

/// What came out.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aligned {
    pub(super) steps: usize,
    /// The last step, for the surface.
    pub(super) last: Step,
}

/// Buffers for one surface.
#[derive(Clone, Debug)]
pub(super) struct Aligner {
    kernels: Kernels,
    pub(super) seen: [Vec<[SeenGroup; 2]>; LEVELS],
    pub(super) residuals: Vec<ResidualGroup>,
    patches: Vec<[f32; PATCH]>,
    pub(super) scores: Vec<PatchScore>,
    sums: Box<NormalSums>,
}

impl Aligner {
    pub(super) fn new(surface: &Surface, kernels: Kernels) -> Self {
        let count = surface.levels.iter().map(|level| level.groups.len()).max().unwrap_or(0);
        Self {
            kernels,
            seen: std::array::from_fn(|level| vec![Default::default(); surface.levels[level].groups.len()]),
            residuals: vec![ResidualGroup::default(); count],
            patches: vec![[0.0; PATCH]; count],
            scores: Vec::with_capacity(count),
            sums: Box::default(),
        }
    }

    /// Aligns on `levels`, coarse to fine; `may_continue` is asked before each step. `None` if too little is in sight or
    /// the equations determine nothing.
    pub(super) fn align(
        &mut self,
        problem: &mut Problem<'_>,
        estimate: &mut Estimate,
        levels: std::ops::RangeInclusive<usize>,
        (free, steps_max): (Free, usize),
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<Aligned> {
        let mut aligned = None;
        let mut steps = 0;
        let levels = *levels.start()..=self.first_level(problem, estimate, levels);
        for level in levels.rev() {
            if problem.surface.levels[level].groups.is_empty() {
                continue;
            }
            problem.linearise_lenses(level, &estimate.cam_left_from_model);
            let mut photometry = estimate.photometry();
            let first = self.look(problem, estimate, level, &photometry)?;
            photometry.learn(&first);
            for _ in 0..steps_max {
                if steps > 0 && !may_continue() {
                    return aligned;
                }
                let free = if level == 0 { free } else { free.without_shape() };
                let last = self.step(problem, estimate, level, &mut photometry, free)?;
                steps += 1;
                aligned = Some(Aligned { steps, last });
                if problem.moved_px(estimate, &last.unknowns) < STEP_DONE_PX[level] * f64::from(1_u32 << level) {
                    break;
                }
            }
            if level == 0 {
                estimate.variance = photometry.variance;
            }
        }
        aligned
    }

    /// The finest level at which the view already resembles both images: from there Gauss-Newton finds the way, and coarser
    /// levels, which know less, would only lead astray.
    fn first_level(
        &mut self,
        problem: &mut Problem<'_>,
        estimate: &Estimate,
        levels: std::ops::RangeInclusive<usize>,
    ) -> usize {
        for level in levels.clone() {
            problem.linearise_lenses(level, &estimate.cam_left_from_model);
            if self.look(problem, estimate, level, &estimate.photometry()).is_some()
                && self.resemblance(problem, level) >= RESEMBLANCE_MIN
            {
                return level;
            }
        }
        *levels.end()
    }

    /// Correlation of the view with the image that it resembles less.
    fn resemblance(&self, problem: &Problem<'_>, level: usize) -> f64 {
        let mut correlations = [Correlation::default(); 2];
        for (seen, view) in self.seen[level].iter().zip(&problem.view.levels[level]) {
            for (seen, correlation) in seen.iter().zip(&mut correlations) {
                for i in (0..LANES).filter(|&i| seen.valid.0[i] * view.valid.0[i] > 0.0) {
                    correlation.add(1.0, view.value.map(|v| v.0[i]), seen.value.map(|v| v.0[i]));
                }
            }
        }
        correlations[0].value().min(correlations[1].value())
    }

    /// One step.
    fn step(
        &mut self,
        problem: &mut Problem<'_>,
        estimate: &mut Estimate,
        level: usize,
        photometry: &mut Photometry,
        free: Free,
    ) -> Option<Step> {
        let sums = self.look(problem, estimate, level, photometry)?;
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
        photometry.learn(&sums);
        Some(step)
    }

    /// Projects, samples and weighs at the present estimate.
    pub(super) fn look(
        &mut self,
        problem: &Problem<'_>,
        estimate: &Estimate,
        level: usize,
        photometry: &Photometry,
    ) -> Option<ResidualSums> {
        let (kernels, surface) = (self.kernels, &problem.surface.levels[level]);
        let seen = &mut self.seen[level];
        for (eye, images) in problem.images.iter().enumerate() {
            let rows = camera_rows(&problem.cam_from_model(eye, &estimate.cam_left_from_model));
            let row_offset = if eye == 1 { estimate.row_offset_px as f32 } else { 0.0 };
            kernels::project(kernels, &surface.groups, &surface.lens[eye], &rows, row_offset, seen, eye);
            kernels::sample(kernels, &images.levels[level], level, &images.origin_px(), seen, eye);
        }
        let sums = kernels::weigh(kernels, seen, &problem.view.levels[level], photometry, &mut self.residuals);
        (sums.points[0].max(sums.points[1]) >= POINTS_MIN).then_some(sums)
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
            &self.seen[level][range.clone()],
            &problem.view.levels[level][range.clone()],
            &self.residuals[range.clone()],
            weights,
            &mut self.sums,
            &mut self.patches[range],
        );
    }

    /// The equations at the estimate, patch by patch, at full resolution: for covariance, relief and judgement. Variances
    /// are held below `variance_max`.
    pub(super) fn examine(
        &mut self,
        problem: &Problem<'_>,
        estimate: &Estimate,
        variance_max: &[[f32; CHANNELS]; TERMS],
    ) -> Option<NormalEquations> {
        let mut variance = estimate.variance;
        for (own, most) in variance.iter_mut().flatten().zip(variance_max.iter().flatten()) {
            *own = own.min(*most);
        }
        let photometry = estimate.photometry_with(variance);
        self.look(problem, estimate, 0, &photometry)?;
        let weights = PairWeights::of(&photometry.variance);
        let mut equations = NormalEquations::empty();
        self.scores.clear();
        let count = problem.surface.levels[0].groups.len();
        for group in 0..count {
            *self.sums = NormalSums::default();
            self.accumulate(problem, 0, group..group + 1, &weights);
            equations.add(&self.sums);
            self.scores.push(PatchScore::of(&self.sums, &self.patches[group], estimate.patch_sigma));
        }
        equations.remove_patch_offsets(&self.patches[..count], estimate.patch_sigma);
        Some(equations)
    }

    /// Mean residual of each patch against the kept view: how far shading departs, as a standard deviation in grey levels.
    pub(super) fn patch_spread(&self) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for patch in &self.patches[..self.scores.len()] {
            let own = f64::from(patch[PATCH - 2]);
            if own > 0.0 {
                let mean = f64::from(patch[PATCH - 1]) / own;
                sum += own * (mean * mean - 1.0 / own);
                weight += own;
            }
        }
        if weight > 0.0 { (sum / weight).max(0.0).sqrt() } else { 0.0 }
    }

    /// Projects one level of the surface into the left image, for taking a view.
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
        kernels::project(self.kernels, &surface.groups, &surface.lens[0], &rows, 0.0, &mut self.seen[level], 0);
    }
}

impl Free {
    fn without_shape(self) -> Self {
        if self == Self::Everything { Self::Motion } else { self }
    }
}

impl Estimate {
    /// As a level begins: nothing is known of its residuals.
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
        for eye in 0..2 {
            for c in 0..CHANNELS {
                self.gain[eye][c] += step.gain[eye][c] as f32;
                self.offset[eye][c] += step.offset[eye][c] as f32;
            }
        }
    }
}

impl Photometry {
    /// Takes the variance of the residuals over; within a level it only falls.
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
    pub(super) fn cam_from_model(&self, eye: usize, cam_left_from_model: &Pose<CamLeft, Model>) -> Isometry3<f64> {
        match eye {
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

    /// How far a step moves the points, pixels.
    fn moved_px(&self, estimate: &Estimate, unknowns: &Unknowns) -> f64 {
        let scale = self.rig.left().pinhole().fx / estimate.cam_left_from_model.translation_m().z.abs().max(1e-3);
        let (rho, phi) = (unknowns.fixed_rows::<3>(0).norm(), unknowns.fixed_rows::<3>(3).norm());
        scale * (rho + phi * 0.5 * self.surface.radius_m)
    }
}

impl Knowledge {
    pub(super) fn prior(&self, estimate: &Estimate) -> Prior {
        let mut information = UnknownsMatrix::zeros();
        for i in 0..6 {
            let sigma = if i < 3 { MOTION_SIGMA.0 } else { MOTION_SIGMA.1 };
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
