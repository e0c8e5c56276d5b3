//! From a region and a range of depths to one refined plane: search, patches, refinement.
//!
//! Works in the rectified pair; see [`super::estimator`] for what makes an answer of it.

use nalgebra::Vector2;

use super::disparity_plane::DisparityPlane;
use super::front_end::StereoFrontEnd;
use super::patches::{PatchConfig, PatchOutcome, SlantedPatches};
use super::photometric::{PlaneRefiner, RefineConfig, RefinedPlane};
use super::region_pyramid::{LevelPlane, PyramidSource, RegionPyramid};
use super::search::{PlaneSearch, PlaneSearchConfig};
use crate::cpu::Kernels;

/// Parameters of the cold start.
#[derive(Clone, Debug, PartialEq)]
pub struct ColdStartConfig {
    /// The search over all disparities runs on the first level on which the region has at most this many pixels.
    pub search_area_px: usize,
    /// Patches are looked at down to the first level on which the region has at most this many pixels.
    pub patch_area_px: usize,
    /// The search.
    pub search: PlaneSearchConfig,
    /// The patches.
    pub patches: PatchConfig,
    /// The refinement.
    pub refine: RefineConfig,
}

impl Default for ColdStartConfig {
    fn default() -> Self {
        Self {
            search_area_px: 6000,
            patch_area_px: 24_000,
            search: PlaneSearchConfig::default(),
            patches: PatchConfig::default(),
            refine: RefineConfig::default(),
        }
    }
}

/// A candidate with what the patches say of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// The plane in the rectified pair.
    pub plane: DisparityPlane,
    /// Share of the region's clear disparities on it.
    pub share: f64,
    /// What the patches said of it on the search level.
    pub patches: PatchOutcome,
    /// What orders the surfaces.
    pub score: f64,
}

/// What a cold start found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColdStartOutcome {
    /// The best surface of the search level.
    pub first: Surface,
    /// The next best that is another surface.
    pub second: Option<Surface>,
    /// Share of the region's pixels with a clear disparity.
    pub valid_share: f64,
    /// What the patches said of the plane on the finest level that they looked at.
    pub finest: PatchOutcome,
    /// The plane of the patches.
    pub patch_plane: DisparityPlane,
    /// The refined plane; `None` if it had too few points.
    pub refined: Option<RefinedPlane>,
}

/// Finds planes; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct ColdStart {
    config: ColdStartConfig,
    kernels: Kernels,
    pyramid: RegionPyramid,
    search: PlaneSearch,
    patches: SlantedPatches,
    refiner: PlaneRefiner,
    surfaces: Vec<Surface>,
}

impl ColdStart {
    /// With all buffers empty.
    pub fn new(config: ColdStartConfig, kernels: Kernels) -> Self {
        let refiner = PlaneRefiner::new(config.refine.clone(), kernels);
        Self { config, kernels, refiner, ..Self::default() }
    }

    /// The parameters.
    pub fn config(&self) -> &ColdStartConfig {
        &self.config
    }

    /// The region of the last pair.
    pub fn pyramid(&self) -> &RegionPyramid {
        &self.pyramid
    }

    /// Candidate surfaces of the last pair, best first.
    pub fn surfaces(&self) -> &[Surface] {
        &self.surfaces
    }

    /// Searches the plane of a region; `allowed` says which planes are within the search range. `None` if nothing can be
    /// compared.
    pub fn run(
        &mut self,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        allowed: impl Fn(&DisparityPlane) -> bool,
    ) -> Option<ColdStartOutcome> {
        self.surfaces.clear();
        if !self.pyramid.update(front_end, source) {
            return None;
        }
        let (centre, index) = (self.pyramid.centroid_px(), self.pyramid.search_level());
        let level = &self.pyramid.levels()[index];
        let is_allowed = |p: &LevelPlane| allowed(&level.full_plane(p, centre));
        self.search.run(level, source.disparity_px, &self.config.search, is_allowed, self.kernels);
        self.judge_candidates(index, centre);
        let first = *self.surfaces.first()?;
        let (patch_plane, finest) = self.descend(first.plane);
        let refined = self.refiner.refine(&self.pyramid, &patch_plane);
        let second = self.second_surface(&first);
        Some(ColdStartOutcome { first, second, valid_share: self.search.valid_share, finest, patch_plane, refined })
    }

    /// Looks at the patches of every candidate, twice, and puts the candidates into order.
    fn judge_candidates(&mut self, index: usize, centre: Vector2<f64>) {
        for candidate in &self.search.candidates {
            let level = &mut self.pyramid.levels_mut()[index];
            let before = self.patches.run(level, &candidate.plane, &self.config.patches, self.kernels);
            let patches = self.patches.run(level, &before.plane, &self.config.patches, self.kernels);
            let share = patches.textured_share * patches.support_share;
            let score = share * patches.mean_correlation + self.search.valid_share * candidate.share;
            let plane = level.full_plane(&before.plane, centre);
            self.surfaces.push(Surface { plane, share: candidate.share, patches, score });
        }
        self.surfaces.sort_by(|a, b| b.score.total_cmp(&a.score));
    }

    /// From the search level to the finest one for patches, two looks each.
    fn descend(&mut self, start: DisparityPlane) -> (DisparityPlane, PatchOutcome) {
        let centre = self.pyramid.centroid_px();
        let coarsest = self.pyramid.search_level();
        let limit = self.config.patch_area_px;
        let finest = self.pyramid.levels().iter().position(|l| l.area_px <= limit).unwrap_or(coarsest).min(coarsest);
        let mut plane = start;
        let mut outcome = None;
        for index in (finest..=coarsest).rev() {
            let level = &mut self.pyramid.levels_mut()[index];
            for _ in 0..2 {
                let found = self.patches.run(level, &level.level_plane(&plane), &self.config.patches, self.kernels);
                plane = level.full_plane(&found.plane, centre);
                outcome = Some(found);
            }
        }
        let blank = PatchOutcome {
            plane: self.pyramid.levels()[coarsest].level_plane(&plane),
            textured_share: 0.0,
            support_share: 0.0,
            mean_correlation: 0.0,
        };
        (plane, outcome.unwrap_or(blank))
    }

    /// The best surface that differs from the first by more than two pixels of the search level somewhere in the region.
    fn second_surface(&self, first: &Surface) -> Option<Surface> {
        let scale = (1 << self.pyramid.search_level()) as f64;
        let b = self.pyramid.box_px();
        let corners = [(0, 0), (b.width, 0), (0, b.height), (b.width, b.height)]
            .map(|(x, y)| Vector2::new(f64::from(b.x + x), f64::from(b.y + y)));
        let differs =
            |other: &Surface| corners.iter().any(|c| (other.plane.at(c) - first.plane.at(c)).abs() > 2.0 * scale);
        self.surfaces.iter().skip(1).find(|s| differs(s)).copied()
    }
}
