//! Shared core of estimator and tracker: images, model, search, evaluation.

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::ReferenceOptimum;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::Deadline;
use pb3dp_estimation_core::plane_hypothesis::{PinholePair, PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::region::{Region, RegionMask, RegionWarning};
use pb3dp_geometry::{Camera, StereoRig};

use super::PublishedConfig;
use super::front_end::FrontEnd;
use crate::fitness::{HueFitness, PreparedFitness};
use crate::hue::HuePlane;
use crate::observability::{Landscape, LandscapeProbe, ProbeTarget, Scored, Spread};
use crate::photo_model::{ModelPoint, PhotoModel, PhotoModelScratch};
use crate::search::chromosome::Codec;
use crate::search::exhaustive::{self, Optimum};
use crate::search::rmga::{Population, RmGa};

/// Result of a search: the best individual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct BestHypothesis {
    pub psi: PlaneHypothesis,
    pub fitness: f64,
}

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
    blocks: Vec<(PhotoModel, HueFitness)>,
    probe: LandscapeProbe,
    focal_baseline_px_m: f64,
}

impl Core {
    pub(super) fn new(rig: &StereoRig, config: PublishedConfig, kernels: Kernels) -> Result<Self, EstimationError> {
        config.validate()?;
        let side = config.observability.blocks_per_side as usize;
        let fitness = HueFitness::new(config.fitness, kernels)?;
        Ok(Self {
            front: FrontEnd::new(rig, config.hue, kernels)?,
            model: PhotoModel::default(),
            scratch: PhotoModelScratch::default(),
            blocks: vec![(PhotoModel::default(), fitness.clone()); side * side],
            fitness,
            probe: LandscapeProbe::new(config.observability)?,
            focal_baseline_px_m: rig.left().pinhole().fx * rig.baseline_m(),
            config,
        })
    }

    pub(super) fn config(&self) -> &PublishedConfig {
        &self.config
    }

    pub(super) fn left_camera(&self) -> &Camera {
        self.front.left_camera()
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
        self.front.check_left_size(left)?;
        let mask = region.rasterize(left, &self.config.region)?;
        let warnings = region.inspect(left, &mask, &self.config.region);
        let centroid_px = mask.centroid_px().unwrap_or_default();
        let outline_px = self.undistorted_outline(region, &mask);
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

    /// Evolves the population on the current frame while `may_continue` allows it; `None` if no individual could be scored.
    pub(super) fn search(
        &mut self,
        rmga: &mut RmGa,
        population: &mut Population,
        deadline: &mut Deadline<'_>,
    ) -> Result<Option<BestHypothesis>, EstimationError> {
        let Self { fitness, front, model, .. } = self;
        let range = *rmga.codec().range();
        let prepared = fitness.prepare(front.pair(), model, front.right_hue(), &range)?;
        let best = rmga.evolve_while(population, &prepared, &mut || deadline.may_continue());
        Ok(prepared.fitness(best.score).map(|fitness| BestHypothesis { psi: best.hypothesis, fitness }))
    }

    /// Surveys the fitness landscape near and far from an estimate on the current frame.
    pub(super) fn survey(&mut self, found: &BestHypothesis, range: &SearchRange) -> Result<Landscape, EstimationError> {
        let target = self.probe_target(found, range);
        self.probe_with(range, |probe, whole, blocks| probe.survey(whole, blocks, &target))
    }

    /// Spread near an estimate on the current frame.
    pub(super) fn survey_nearby(
        &mut self,
        found: &BestHypothesis,
        range: &SearchRange,
    ) -> Result<Spread, EstimationError> {
        let target = self.probe_target(found, range);
        self.probe_with(range, |probe, whole, blocks| probe.survey_nearby(whole, blocks, &target))
    }

    /// The best of all chromosomes on the current frame.
    pub(super) fn reference_optimum(&mut self, codec: &Codec) -> Result<Option<ReferenceOptimum>, EstimationError> {
        let Self { fitness, front, model, .. } = self;
        let prepared = fitness.prepare(front.pair(), model, front.right_hue(), codec.range())?;
        let Optimum { score, chromosome, ties } = exhaustive::optimum(&prepared, codec);
        let psi = codec.decode(chromosome);
        Ok(prepared.fitness(score).map(|fitness| ReferenceOptimum { psi, fitness, ties }))
    }

    fn probe_target(&self, found: &BestHypothesis, range: &SearchRange) -> ProbeTarget {
        ProbeTarget { answer: found.psi, range: *range, focal_baseline_px_m: self.focal_baseline_px_m }
    }

    fn probe_with<T>(
        &mut self,
        range: &SearchRange,
        probe_call: impl FnOnce(&mut LandscapeProbe, &Scored<PreparedFitness<'_>>, &[Scored<PreparedFitness<'_>>]) -> T,
    ) -> Result<T, EstimationError> {
        let side = self.config.observability.blocks_per_side;
        let Self { fitness, front, model, blocks, probe, .. } = self;
        cut_into_blocks(model, side, blocks);
        let scored = |score: PreparedFitness<'_>| score.score_max();
        let whole = fitness.prepare(front.pair(), model, front.right_hue(), range)?;
        let whole = Scored { score_max: scored(whole.clone()), score: whole };
        let mut parts = Vec::with_capacity(blocks.len());
        for (part, part_fitness) in blocks.iter_mut() {
            if part.inner().is_empty() && part.outer().is_empty() {
                continue;
            }
            let score = part_fitness.prepare(front.pair(), part, front.right_hue(), range)?;
            parts.push(Scored { score_max: score.score_max(), score });
        }
        Ok(probe_call(probe, &whole, &parts))
    }

    /// The outline of a region in the undistorted left image; vertices without a ray are dropped.
    fn undistorted_outline(&self, region: &Region, mask: &RegionMask) -> Vec<Vector2<f64>> {
        let outline = region.outline_px(mask);
        outline.iter().filter_map(|vertex| self.front.undistort_pixel(vertex).ok()).collect()
    }
}

/// Distributes the model's points over `side` x `side` blocks of the box around its inner points.
fn cut_into_blocks(model: &PhotoModel, side: u32, blocks: &mut [(PhotoModel, HueFitness)]) {
    let bounds = Bounds::of(model.inner());
    let part_of = |point: &ModelPoint| bounds.block(point, side);
    for (index, (part, _)) in blocks.iter_mut().enumerate() {
        let own = |points: &[ModelPoint]| points.iter().filter(|p| part_of(p) == index).copied().collect();
        *part = PhotoModel::from_points(model.centre_px(), own(model.inner()), own(model.outer()));
    }
}

/// Bounding box of some points.
struct Bounds {
    u: (i32, i32),
    v: (i32, i32),
}

impl Bounds {
    fn of(points: &[ModelPoint]) -> Self {
        let range = |values: &mut dyn Iterator<Item = i32>| {
            values.fold((i32::MAX, i32::MIN), |(low, high), value| (low.min(value), high.max(value)))
        };
        Self { u: range(&mut points.iter().map(|p| p.u)), v: range(&mut points.iter().map(|p| p.v)) }
    }

    fn block(&self, point: &ModelPoint, side: u32) -> usize {
        let part = |value: i32, (low, high): (i32, i32)| {
            let extent = (i64::from(high) - i64::from(low) + 1).max(1);
            let scaled = (i64::from(value) - i64::from(low)) * i64::from(side);
            scaled.div_euclid(extent).clamp(0, i64::from(side) - 1) as usize
        };
        part(point.v, self.v) * side as usize + part(point.u, self.u)
    }
}
