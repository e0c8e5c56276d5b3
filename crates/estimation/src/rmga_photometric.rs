//! RM-GA with a photometric score: the search of the paper, the comparison of modern stereo.
//!
//! The genetic algorithm is that of the [published method](crate::published); what it maximises is a correlation of
//! luminance and chroma instead of votes of hue. So it works on grey targets, does not mind gain, offset and white balance,
//! and its summit lies where the plane is; its step is still that of the chromosome. It estimates single pairs.

use image::RgbImage;
use nalgebra::{Vector2, Vector3};
use pb3dp_geometry::StereoRig;

use crate::cpu::Kernels;
use crate::direct::colour_planes::Wanted;
use crate::direct::filters::{Smoother, Taps};
use crate::direct::front_end::StereoFrontEnd;
use crate::direct::image_plane::ImagePlane;
use crate::direct::region_pyramid::{PyramidSource, RegionPyramid};
use crate::direct::row_offset::RowOffset;
use crate::error::{EstimationError, check_range};
use crate::estimate::{EstimateWarning, PlaneEstimate, PlanePose};
use crate::observability::{Landscape, LandscapeProbe, ObservabilityConfig, ProbeTarget, Scored};
use crate::plane_hypothesis::{PlaneHypothesis, SearchRange};
use crate::region::{Region, RegionConfig};
use crate::search::rmga::{Best, Population, RmGa, RmGaConfig};
use crate::status::Status;

mod correlation;

use correlation::{CorrelationScore, Mapping, PointBlocks, PointWish, SCORE_MAX};

/// The answer lies at an end of the depth range if it is this close to it, as a share of the range.
const END_OF_RANGE_SHARE: f64 = 0.004;

/// Parameters of the method.
#[derive(Clone, Debug, PartialEq)]
pub struct RmgaPhotometricConfig {
    /// Wanted number of points, 100 to 20000. Default 1000.
    pub points: usize,
    /// The region is compared with a border of this many pixels around it, 0 to 8: the outline of a one-coloured target is
    /// all that it has. Default 2.
    pub margin_px: usize,
    /// Standard deviation of the smoothing of both eyes, pixels of the level that is compared, 0.3 to 4. Default 1.
    pub smoothing_px: f64,
    /// Images are halved until the region has at most this many pixels, 200 to 1000000. Default 6000.
    pub area_max_px: usize,
    /// Coarser levels on which the population evolves before, 0 to 4. Default 2.
    pub coarse_levels: usize,
    /// Blocks along each side of the region that are correlated by themselves, 2 to 8. Default 4.
    pub blocks_per_side: usize,
    /// Smallest share of the contrast that stands above noise, 0 to 1; below, `not-observable`. Default 0.15.
    pub texture_share_min: f64,
    /// The genetic algorithm; `generations` are those of one level. Default 30 generations, else as published.
    pub rmga: RmGaConfig,
    /// Regions.
    pub region: RegionConfig,
    /// The judgement of answers.
    pub observability: ObservabilityConfig,
}

impl Default for RmgaPhotometricConfig {
    fn default() -> Self {
        Self {
            points: 1000,
            margin_px: 2,
            smoothing_px: 1.0,
            area_max_px: 6000,
            coarse_levels: 2,
            blocks_per_side: 4,
            texture_share_min: 0.15,
            rmga: RmGaConfig { generations: 30, ..RmGaConfig::default() },
            region: RegionConfig::default(),
            observability: ObservabilityConfig::default(),
        }
    }
}

impl RmgaPhotometricConfig {
    /// Checks all ranges.
    ///
    /// # Errors
    /// The parameter that is out of its range.
    pub fn validate(&self) -> Result<(), EstimationError> {
        let count = |name, value: usize, (low, high): (f64, f64), expected| {
            check_range(name, value as f64, (low, high), expected)
        };
        count("rmga-photometric points", self.points, (100.0, 2e4), "must be between 100 and 20000")?;
        count("rmga-photometric margin_px", self.margin_px, (0.0, 8.0), "must be between 0 and 8")?;
        count("rmga-photometric area_max_px", self.area_max_px, (200.0, 1e6), "must be between 200 and 1000000")?;
        count("rmga-photometric coarse_levels", self.coarse_levels, (0.0, 4.0), "must be between 0 and 4")?;
        count("rmga-photometric blocks_per_side", self.blocks_per_side, (2.0, 8.0), "must be between 2 and 8")?;
        check_range("rmga-photometric smoothing_px", self.smoothing_px, (0.3, 4.0), "must be between 0.3 and 4")?;
        let share = self.texture_share_min;
        check_range("rmga-photometric texture_share_min", share, (0.0, 1.0), "must be between 0 and 1")?;
        self.rmga.validate()?;
        self.observability.validate()
    }
}

/// The method on single pairs; keeps its buffers.
#[derive(Clone, Debug)]
pub struct RmgaPhotometricEstimator {
    config: RmgaPhotometricConfig,
    front_end: StereoFrontEnd,
    pyramid: RegionPyramid,
    smoother: Smoother,
    left: [ImagePlane; 3],
    right: [ImagePlane; 3],
    points: PointBlocks,
    probe: LandscapeProbe,
}

impl RmgaPhotometricEstimator {
    /// An estimator for a calibrated pair, rectified or not, with lens distortion or without.
    ///
    /// # Errors
    /// A parameter out of its range, or a rig that can not be rectified.
    pub fn new(rig: &StereoRig, config: RmgaPhotometricConfig) -> Result<Self, EstimationError> {
        Self::with_kernels(rig, config, Kernels::best())
    }

    /// As [`Self::new`], with given kernels; the answers are the same, the speed is not.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_kernels(
        rig: &StereoRig,
        config: RmgaPhotometricConfig,
        kernels: Kernels,
    ) -> Result<Self, EstimationError> {
        config.validate()?;
        Ok(Self {
            front_end: StereoFrontEnd::new(rig, kernels)?,
            pyramid: RegionPyramid::default(),
            smoother: Smoother::default(),
            left: Default::default(),
            right: Default::default(),
            points: PointBlocks::default(),
            probe: LandscapeProbe::new(config.observability)?,
            config,
        })
    }

    /// The parameters.
    pub fn config(&self) -> &RmgaPhotometricConfig {
        &self.config
    }

    /// The plane of a region of one pair of raw images, from nothing: no start value, the whole `range` is searched.
    ///
    /// # Errors
    /// Images that do not fit the calibration, a region that can not serve, a bad range. That a plane can not be determined
    /// is not an error but the status `not-observable`.
    pub fn estimate(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        region: &Region,
        range: &SearchRange,
    ) -> Result<PlaneEstimate, EstimationError> {
        self.estimate_while(left, right, region, range, &mut || true)
    }

    /// As [`Self::estimate`]; once `may_continue` says no, the best of the generations so far is judged and given.
    ///
    /// # Errors
    /// As [`Self::estimate`].
    pub fn estimate_while(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        region: &Region,
        range: &SearchRange,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Result<PlaneEstimate, EstimationError> {
        range.validate()?;
        self.front_end.check(left, right)?;
        let mask = region.rasterize(left, &self.config.region)?;
        let warnings = region.inspect_shape(&mask);
        let centroid_px = mask.centroid_px().unwrap_or_default();
        let raw_ray = self.front_end.raw_rig().left().unproject(&centroid_px)?;
        let mut estimate = self.blank(centroid_px, warnings.into_iter().map(EstimateWarning::Region).collect());
        let mask = self.front_end.rectified_region(&mask)?;
        let geometry = *self.front_end.geometry();
        let turn = self.front_end.cam_left_rect_from_cam_left().rotation();
        let depth_factor = (turn * raw_ray).z;
        let near = geometry.disparity_px(range.z_min_m * depth_factor);
        let far = geometry.disparity_px(range.z_max_m * depth_factor);
        let source = PyramidSource {
            left,
            right,
            region: &mask,
            disparity_px: (far.min(near), near.max(far)),
            rows: RowOffset::default(),
            wanted: Wanted::Colour,
            search_area_px: self.config.area_max_px,
        };
        if !self.pyramid.update(&self.front_end, &source) {
            estimate.reason = "the right image shows nothing of the region within the search range".to_owned();
            return Ok(estimate);
        }
        let b = self.pyramid.box_px();
        let corner = |x: u32, y: u32| Vector2::new(f64::from(b.x + x), f64::from(b.y + y));
        let mapping = Mapping {
            raw_ray,
            turn,
            geometry,
            centroid_px: self.pyramid.centroid_px(),
            corners_px: [corner(0, 0), corner(b.width, 0), corner(0, b.height), corner(b.width, b.height)],
            range: *range,
        };
        self.search(&mut estimate, &mapping, may_continue)?;
        Ok(estimate)
    }

    /// Evolves on coarse levels first, where the summit is wide, and carries the population on to the finest.
    fn search(
        &mut self,
        estimate: &mut PlaneEstimate,
        mapping: &Mapping,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Result<(), EstimationError> {
        let finest = self.pyramid.search_level();
        let coarsest = (finest + self.config.coarse_levels).min(self.pyramid.levels().len().max(1) - 1);
        let mut rmga = RmGa::new(self.config.rmga, mapping.range)?;
        let mut population = Population::random(&self.config.rmga);
        let kernels = self.front_end.kernels();
        for index in (finest..=coarsest).rev() {
            self.prepare(index);
            let texture = self.points.texture_share();
            if index == finest && texture < self.config.texture_share_min {
                let (percent, limit) = (100.0 * texture, 100.0 * self.config.texture_share_min);
                estimate.reason = format!(
                    "{percent:.0} % of the region's contrast stands above noise (limit {limit:.0} %): it is blank"
                );
                return Ok(());
            }
            let Some(level) = self.pyramid.levels().get(index) else { continue };
            let (points, right) = (&self.points, &self.right);
            let score = CorrelationScore { points, level, right, mapping, kernels, block: None };
            let best = rmga.evolve_while(&mut population, &score, may_continue);
            if index > finest && may_continue() {
                continue;
            }
            if !best.is_scored() {
                estimate.reason =
                    "every hypothesis of the search range lies behind a camera: check the range".to_owned();
                return Ok(());
            }
            let landscape = survey(&mut self.probe, &score, &best, level.scale);
            fill(estimate, &best, &landscape, &mapping.raw_ray, &self.config.observability, &mapping.range);
            break;
        }
        Ok(())
    }

    /// Smooths both eyes of a level and takes the points.
    fn prepare(&mut self, index: usize) {
        let Some(level) = self.pyramid.levels().get(index) else { return };
        let taps = Taps::gaussian(self.config.smoothing_px, 0.0);
        for (eye, smooth) in [(&level.left, &mut self.left), (&level.right, &mut self.right)] {
            for (plane, smooth) in eye.planes.iter().zip(smooth) {
                self.smoother.smooth(plane, &taps, &taps, smooth, self.front_end.kernels());
            }
        }
        let mask = correlation::grown(&level.region, &level.left, self.config.margin_px);
        let wish = PointWish { points: self.config.points, blocks_per_side: self.config.blocks_per_side };
        self.points.take(level, &mask, &self.left, &wish);
    }

    fn blank(&self, centroid_px: Vector2<f64>, warnings: Vec<EstimateWarning>) -> PlaneEstimate {
        PlaneEstimate {
            status: Status::NotObservable,
            reason: String::new(),
            warnings,
            centroid_px,
            pose: None,
            psi: None,
            fitness: None,
            z_sigma_m: None,
            normal_sigma_rad: None,
            plane_covariance: None,
            second_plane: None,
            row_offset_px: None,
            landscape: None,
            reference_optimum: None,
            left_camera: *self.front_end.raw_rig().left(),
        }
    }
}

/// The landscape around and away from the best hypothesis on a level.
fn survey(probe: &mut LandscapeProbe, score: &CorrelationScore<'_>, best: &Best, scale: usize) -> Landscape {
    let parts: Vec<_> = score.parts().map(|part| Scored { score_max: part.score_max(), score: part }).collect();
    let target = ProbeTarget {
        answer: best.hypothesis,
        range: score.mapping.range,
        focal_baseline_px_m: score.mapping.geometry.focal_baseline_px_m() / scale as f64,
    };
    probe.survey(&Scored { score_max: score.score_max(), score: *score }, &parts, &target)
}

fn fill(
    estimate: &mut PlaneEstimate,
    best: &Best,
    landscape: &Landscape,
    raw_ray: &Vector3<f64>,
    judge: &ObservabilityConfig,
    range: &SearchRange,
) {
    let verdict = landscape.verdict(judge);
    let psi: PlaneHypothesis = best.hypothesis;
    let pose = psi.inverse_depth_plane(raw_ray).and_then(|q| PlanePose::from_inverse_depth_plane(q, raw_ray));
    let height = landscape.fitness_highest - landscape.fitness_median;
    estimate.pose = pose.filter(|_| verdict.status != Status::NotObservable);
    estimate.status = verdict.status;
    estimate.reason = if height < judge.height_min {
        let (highest, limit) = (landscape.fitness_highest, judge.height_min);
        format!(
            "the correlation is flat: its summit {highest:.3} stands {height:.3} above the median of the search range (limit {limit:.2})"
        )
    } else {
        verdict.reason
    };
    let fitness = f64::from(best.score) / f64::from(SCORE_MAX);
    (estimate.psi, estimate.fitness, estimate.landscape) = (Some(psi), Some(fitness), Some(*landscape));
    if landscape.fitness_highest > fitness + 0.02 {
        let grid = landscape.fitness_highest;
        estimate.warnings.push(EstimateWarning::SearchIncomplete { found: fitness, grid });
    }
    let margin_m = END_OF_RANGE_SHARE * (range.z_max_m - range.z_min_m);
    if psi.z_m < range.z_min_m + margin_m || psi.z_m > range.z_max_m - margin_m {
        estimate.warnings.push(EstimateWarning::EndOfRange { z_mm: 1000.0 * psi.z_m });
    }
}
