//! Shared core of estimator and tracker: images, model, search, evaluation.

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::ReferenceOptimum;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::Deadline;
use pb3dp_estimation_core::plane_hypothesis::{PinholePair, SearchRange};
use pb3dp_estimation_core::region::{Region, RegionMask, RegionWarning};
use pb3dp_geometry::{Camera, StereoRig};

use super::PublishedConfig;
use super::front_end::FrontEnd;
use crate::fitness::{HueFitness, PreparedFitness};
use crate::hue::HuePlane;
use crate::observability::survey::Survey;
use crate::observability::{Landscape, Spread};
use crate::photo_model::{PhotoModel, PhotoModelScratch};
use crate::search::Found;
use crate::search::chromosome::Codec;
use crate::search::exhaustive::{self, Optimum};
use crate::search::rmga::{Population, RmGa};

/// Result of loading a region into the model.
#[derive(Clone, Debug)]
pub(super) struct LoadedRegion {
    pub warnings: Vec<RegionWarning>,
    /// Centroid of the region in the raw left image.
    pub centroid_px: Vector2<f64>,
    /// The region in the undistorted left image.
    pub mask: RegionMask,
    /// Its outline there.
    pub outline_px: Vec<Vector2<f64>>,
}

/// Buffers and state for the recognition of one target.
#[derive(Clone, Debug)]
pub(super) struct Core {
    config: PublishedConfig,
    front: FrontEnd,
    model: PhotoModel,
    scratch: PhotoModelScratch,
    fitness: HueFitness,
}

impl Core {
    pub(super) fn new(rig: &StereoRig, config: PublishedConfig, kernels: Kernels) -> Result<Self, EstimationError> {
        config.validate()?;
        Ok(Self {
            front: FrontEnd::new(rig, config.hue, kernels)?,
            model: PhotoModel::default(),
            scratch: PhotoModelScratch::default(),
            fitness: HueFitness::new(config.fitness, kernels)?,
            config,
        })
    }

    pub(super) fn config(&self) -> &PublishedConfig {
        &self.config
    }

    pub(super) fn left_camera(&self) -> &Camera {
        self.front.rig().left()
    }

    pub(super) fn pair(&self) -> &PinholePair {
        self.front.pair()
    }

    pub(super) fn left_hue(&self) -> &HuePlane {
        self.front.left_hue()
    }

    /// Centre of the current model, undistorted left image.
    pub(super) fn model_centre_px(&self) -> Vector2<f64> {
        self.model.centre_px()
    }

    /// Loads both images and creates the model of a region of the raw left image.
    pub(super) fn take(
        &mut self,
        left: ImageView<'_>,
        right: ImageView<'_>,
        region: &Region,
    ) -> Result<LoadedRegion, EstimationError> {
        self.front.check_sizes(left, right)?;
        let mask = region.rasterize(left, &self.config.region)?;
        let warnings = region.inspect(left, &mask, &self.config.region);
        let centroid_px = mask.centroid_px().unwrap_or_default();
        // Vertices without a ray are dropped.
        let outline_px =
            region.outline_px(&mask).iter().filter_map(|vertex| self.front.undistort_pixel(vertex)).collect();
        self.load(left, right)?;
        let mask = self.front.undistort_region(mask)?;
        self.remake_model(&mask);
        Ok(LoadedRegion { warnings, centroid_px, mask, outline_px })
    }

    /// Loads both images.
    pub(super) fn load(&mut self, left: ImageView<'_>, right: ImageView<'_>) -> Result<(), EstimationError> {
        self.front.load(left, right)
    }

    /// Rebuilds the model from a region of the undistorted left image.
    pub(super) fn remake_model(&mut self, mask: &RegionMask) {
        let Self { model, front, config, scratch, .. } = self;
        model.resample(front.left_hue(), mask, &config.model, scratch);
    }

    /// Reason why the model cannot be searched, if too few of its points have a hue.
    pub(super) fn lack_of_hue(&self) -> Option<String> {
        let limits = &self.config.hue_support;
        let share = self.model.coloured_share();
        let points = self.model.inner().len();
        if share >= limits.coloured_share_min && points >= limits.points_min {
            return None;
        }
        Some(format!(
            "{points} of {} model points ({:.0} %) have a hue, at least {} and {:.0} % are needed: the target is grey, dark or too small for a method that compares hue; choose a coloured target",
            self.model.inner_sampled(),
            100.0 * share,
            limits.points_min,
            100.0 * limits.coloured_share_min
        ))
    }

    /// Evolves the population on the current frame while the deadline allows it; `None` if no individual could be scored.
    pub(super) fn search(
        &mut self,
        rmga: &mut RmGa,
        population: &mut Population,
        generations: usize,
        deadline: &mut Deadline<'_>,
    ) -> Result<Option<Found>, EstimationError> {
        let Self { fitness, front, model, .. } = self;
        let prepared = fitness.prepare(front.pair(), model, front.right_hue(), rmga.codec().range())?;
        let best = rmga.evolve_while(population, &prepared, generations, &mut || deadline.may_continue());
        Ok(prepared.fitness(best.score).map(|fitness| Found { psi: best.hypothesis, fitness }))
    }

    /// Surveys the fitness landscape near and far from an estimate on the current frame.
    pub(super) fn survey(&mut self, found: &Found, range: &SearchRange) -> Result<Landscape, EstimationError> {
        self.with_survey(found, range, |survey| survey.landscape())
    }

    /// Spread near an estimate on the current frame.
    pub(super) fn spread_nearby(&mut self, found: &Found, range: &SearchRange) -> Result<Spread, EstimationError> {
        self.with_survey(found, range, |survey| survey.spread_nearby())
    }

    fn with_survey<T>(
        &mut self,
        found: &Found,
        range: &SearchRange,
        ask: impl FnOnce(&Survey<'_, PreparedFitness<'_>>) -> T,
    ) -> Result<T, EstimationError> {
        let Self { fitness, front, model, config, .. } = self;
        let parts = model.blocks(config.observability.blocks_per_side);
        let mut memories = vec![fitness.clone(); parts.len()];
        let prepared = memories.iter_mut().zip(&parts);
        let prepared = prepared.map(|(memory, part)| memory.prepare(front.pair(), part, front.right_hue(), range));
        let blocks = prepared.collect::<Result<Vec<_>, _>>()?;
        Ok(ask(&Survey {
            config: &config.observability,
            whole: &fitness.prepare(front.pair(), model, front.right_hue(), range)?,
            blocks: &blocks,
            answer: found.psi,
            range: *range,
            focal_baseline_px_m: front.rig().left().pinhole().fx * front.rig().baseline_m(),
        }))
    }

    /// The best of all chromosomes on the current frame.
    pub(super) fn reference_optimum(&mut self, codec: &Codec) -> Result<Option<ReferenceOptimum>, EstimationError> {
        let Self { fitness, front, model, .. } = self;
        let prepared = fitness.prepare(front.pair(), model, front.right_hue(), codec.range())?;
        let Optimum { score, chromosome, ties } = exhaustive::optimum(&prepared, codec);
        let psi = codec.decode(chromosome);
        Ok(prepared.fitness(score).map(|fitness| ReferenceOptimum { psi, fitness, ties }))
    }
}
