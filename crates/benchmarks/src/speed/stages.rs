//! The stages of a cold start, one by one, with any kernels: at the levels and the plane of a complete cold start.

use std::ops::RangeInclusive;

use anyhow::{Context, bail};
use image::RgbImage;
use pb3dp_estimation_core::cpu::{KernelSet, Kernels};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::{Region, RegionMask};
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_estimation_direct::patches::SlantedPatches;
use pb3dp_estimation_direct::photometric::PlaneRefiner;
use pb3dp_estimation_direct::search::PlaneSearch;
use pb3dp_estimation_direct::search::aggregate::Aggregation;
use pb3dp_estimation_direct::search::volume::{CostVolume, LevelBox};
use pb3dp_geometry::StereoRig;
use serde_json::Value;

use super::times::Times;
use pb3dp_estimation_views::colour_planes::Wanted;
use pb3dp_estimation_views::disparity_plane::{DisparityPlane, DisparityRange};
use pb3dp_estimation_views::front_end::StereoFrontEnd;
use pb3dp_estimation_views::region_pyramid::{PyramidSource, RegionLevel, RegionPyramid};
use pb3dp_hal_platform::cpu_time::timed;

/// Input of a cold start.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    /// The cameras.
    pub rig: &'a StereoRig,
    /// Left image.
    pub left: &'a RgbImage,
    /// Right image.
    pub right: &'a RgbImage,
    /// The region.
    pub region: &'a Region,
    /// Search range of depths and tilts.
    pub range: &'a SearchRange,
}

/// A stage of the cold start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Luminance pyramids of both windows.
    Windows,
    /// Costs of all pixels and disparities.
    Costs,
    /// Semi-global aggregation, including the winners.
    Aggregation,
    /// The whole search for planes: costs, aggregation, three-point planes.
    Search,
    /// One pass over all patches around a plane.
    Patches,
    /// Refinement of a plane.
    Refinement,
    /// The whole cold start.
    Whole,
}

impl Stage {
    /// All stages, in order.
    pub const ALL: [Self; 7] =
        [Self::Windows, Self::Costs, Self::Aggregation, Self::Search, Self::Patches, Self::Refinement, Self::Whole];

    /// All but the whole.
    pub const PARTS: [Self; 6] =
        [Self::Windows, Self::Costs, Self::Aggregation, Self::Search, Self::Patches, Self::Refinement];

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Windows => "windows",
            Self::Costs => "matching costs",
            Self::Aggregation => "aggregation",
            Self::Search => "search of planes",
            Self::Patches => "patches, one pass",
            Self::Refinement => "refinement",
            Self::Whole => "cold start",
        }
    }

    /// Unit of a sample.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Windows => "pixel of both windows",
            Self::Costs | Self::Aggregation | Self::Search => "pixel and disparity",
            Self::Patches => "pixel and shift",
            Self::Refinement => "point and step",
            Self::Whole => "pixel of the region",
        }
    }
}

/// Runs the stages.
pub struct StageBench<'a> {
    problem: Problem<'a>,
    kernels: Kernels,
    config: DirectConfig,
    front_end: StereoFrontEnd,
    estimator: DirectEstimator,
    mask: RegionMask,
    disparity_px: DisparityRange,
    pyramid: RegionPyramid,
    searched: usize,
    plane: DisparityPlane,
    loaded: RegionPyramid,
    volume: CostVolume,
    aggregation: Aggregation,
    search: PlaneSearch,
    patches: SlantedPatches,
    refiner: PlaneRefiner,
    steps: usize,
    samples_ms: [Vec<f64>; Stage::ALL.len()],
}

impl<'a> StageBench<'a> {
    /// Prepares one family of kernels.
    ///
    /// # Errors
    /// A problem without a solution: there is nothing to measure.
    pub fn new(problem: Problem<'a>, kernels: Kernels) -> anyhow::Result<Self> {
        let config = DirectConfig::default();
        let mut estimator = DirectEstimator::with_kernels(problem.rig, config.clone(), kernels)?;
        let found = estimator.estimate(EstimateRequest::new_target(
            problem.left,
            problem.right,
            problem.region,
            problem.range,
        ))?;
        let Some(outcome) = estimator.outcome() else { bail!("no estimate, nothing to measure: {}", found.reason) };
        let front_end = StereoFrontEnd::new(problem.rig, kernels)?;
        let raw = problem.region.rasterize(problem.left, &config.region)?;
        let mut buffer = RegionMask::default();
        let mask = front_end.rectified_region(&raw, &mut buffer)?.clone();
        let disparity = |z_m: f64| front_end.geometry().disparity_px(z_m);
        Ok(Self {
            disparity_px: DisparityRange {
                lowest: disparity(problem.range.z_max_m),
                highest: disparity(problem.range.z_min_m),
            },
            problem,
            kernels,
            mask,
            front_end,
            pyramid: estimator.cold_start().pyramid().clone(),
            searched: estimator.cold_start().searched_level(),
            plane: outcome.patch_plane,
            loaded: RegionPyramid::up_to(config.cold_start.finest_area_px()).keeping_colours(),
            volume: CostVolume::default(),
            aggregation: Aggregation::default(),
            search: PlaneSearch::default(),
            patches: SlantedPatches::default(),
            refiner: PlaneRefiner::new(config.cold_start.refine.clone(), kernels),
            estimator,
            config,
            steps: 1,
            samples_ms: Default::default(),
        })
    }

    /// The family of kernels.
    pub fn set(&self) -> KernelSet {
        self.kernels.set()
    }

    /// Runs every stage once; the times count if `is_warm`.
    ///
    /// # Errors
    /// Errors of the estimator.
    pub fn round(&mut self, is_warm: bool) -> anyhow::Result<()> {
        for (stage, index) in Stage::ALL.into_iter().zip(0..) {
            let (outcome, ms) = timed(|| self.run(stage));
            outcome?;
            if is_warm {
                self.samples_ms[index].push(ms);
            }
        }
        Ok(())
    }

    fn run(&mut self, stage: Stage) -> anyhow::Result<()> {
        let Self { problem, kernels, pyramid, config, .. } = self;
        let (search, kernels) = (&config.cold_start.search, *kernels);
        let Problem { left, right, .. } = *problem;
        let source = PyramidSource {
            left: left.into(),
            right: right.into(),
            region: &self.mask,
            disparity_px: self.disparity_px,
            rows: Default::default(),
            wanted: Wanted::Luminance,
            search_area_px: config.cold_start.search_area_px,
        };
        match stage {
            Stage::Windows => {
                self.loaded.update(&self.front_end, &source);
            }
            Stage::Costs => {
                let level = &pyramid.levels()[self.searched];
                let range = level_range(level, self.disparity_px);
                self.volume.compute(level, region_box(level)?, range, search.noise as f32, kernels);
            }
            Stage::Aggregation => self.aggregation.run(&self.volume, search.penalties, search.winner, kernels),
            Stage::Search => {
                let level = &pyramid.levels()[self.searched];
                self.search.run(level, self.disparity_px, search, |_| true, kernels);
            }
            Stage::Patches => {
                let level = &mut pyramid.levels_mut()[self.searched];
                let plane = level.level_plane(&self.plane);
                self.patches.run(level, &plane, &config.cold_start.patches, kernels);
            }
            Stage::Refinement => {
                if let Some(refined) = self.refiner.refine(&self.front_end, &source, pyramid, &self.plane) {
                    self.steps = refined.points * refined.iterations;
                }
            }
            Stage::Whole => {
                let Problem { region, range, .. } = *problem;
                self.estimator.estimate(EstimateRequest::new_target(left, right, region, range))?;
            }
        }
        Ok(())
    }

    /// Number of samples of a stage.
    ///
    /// # Errors
    /// An empty region.
    pub fn samples(&self, stage: Stage) -> anyhow::Result<usize> {
        let level = &self.pyramid.levels()[self.searched];
        let area = region_box(level)?;
        let count = match stage {
            Stage::Windows => {
                let [left, right] = [&self.pyramid.levels()[0].left, &self.pyramid.levels()[0].right];
                [left, right].map(|side| side.window.width * side.window.height).iter().sum()
            }
            Stage::Costs | Stage::Aggregation | Stage::Search => area.width * area.height * self.volume.count,
            Stage::Patches => area.width * area.height * (2 * self.config.cold_start.patches.reach + 1),
            Stage::Refinement => self.steps,
            Stage::Whole => self.pyramid.area_px(),
        };
        Ok(count.max(1))
    }

    /// Times of a stage; `None` before the first round that counts.
    pub fn times(&self, stage: Stage) -> Option<Times> {
        let index = Stage::ALL.iter().position(|other| *other == stage)?;
        Times::of(&self.samples_ms[index])
    }

    /// Times of all parts.
    pub fn to_json(&self) -> Value {
        let part = |stage: &Stage| Some((stage.name().to_owned(), self.times(*stage)?.to_json()));
        Value::Object(Stage::PARTS.iter().filter_map(part).collect())
    }
}

/// Margin around the region's bounding box: as in the search.
const MARGIN: usize = 2;

fn region_box(level: &RegionLevel) -> anyhow::Result<LevelBox> {
    let (width, height) = (level.left.window.width, level.left.window.height);
    let inside = || (0..width * height).filter(|i| level.region[*i] != 0).map(|i| (i % width, i / width));
    let span = |values: &mut dyn Iterator<Item = usize>, limit: usize| {
        let (low, high) = values.fold((usize::MAX, 0), |(low, high), v| (low.min(v), high.max(v)));
        let start = low.saturating_sub(MARGIN);
        (low <= high).then(|| (start, (high + 1 + MARGIN).min(limit) - start))
    };
    let x = span(&mut inside().map(|(x, _)| x), width).context("the region is empty on the level of the search")?;
    let y = span(&mut inside().map(|(_, y)| y), height).context("the region is empty on the level of the search")?;
    Ok(LevelBox { x: x.0, y: y.0, width: x.1, height: y.1 })
}

fn level_range(level: &RegionLevel, disparity_px: DisparityRange) -> RangeInclusive<i32> {
    let scale = level.scale as f64;
    (disparity_px.lowest / scale).floor() as i32 - 1..=(disparity_px.highest / scale).ceil() as i32 + 1
}

/// Runs several families of kernels in turn, so that other load on the machine affects all families alike.
///
/// # Errors
/// Those of [`StageBench::round`].
pub fn run_in_turn(benches: &mut [StageBench<'_>], rounds: usize) -> anyhow::Result<()> {
    const WARM_UP: usize = 3;
    for round in 0..WARM_UP + rounds {
        for bench in benches.iter_mut() {
            bench.round(round >= WARM_UP)?;
        }
    }
    Ok(())
}
