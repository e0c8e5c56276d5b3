//! Cold start: from a region and a depth range to one refined plane, by search, patches and refinement.
//!
//! Works in the rectified pair; [`super::estimator`] converts the result into an estimate.

mod areas;
mod contest;
mod elsewhere;
mod levels;

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_views::disparity_plane::{DisparityPlane, DisparityRange};
use pb3dp_estimation_views::front_end::StereoFrontEnd;
use pb3dp_estimation_views::reach;
use pb3dp_estimation_views::region_pyramid::{PyramidSource, RegionPyramid};
use pb3dp_geometry::ranges;

pub use self::elsewhere::COPY_SCORE_MIN;
use super::beyond::Beyond;
use super::patches::{PatchConfig, PatchOutcome, SUPPORTS, SlantedPatches};
use super::photometric::{PlaneRefiner, RefineConfig, RefinedPlane};
use super::repetition::{PeriodSearch, Repetition};
use super::search::{PlaneSearch, PlaneSearchConfig};
use super::surroundings::{self, Surroundings};
use crate::outcome::{
    ColdStartOutcome, ContinuedPlane, Rival, Surface, UnlimitedPlane, WidestPlane, support_of, surface_score,
};
use crate::surface_choice::SurfaceChoice;

/// Parameters of the cold start.
#[derive(Clone, Debug, PartialEq)]
pub struct ColdStartConfig {
    /// The search over all disparities first runs on the first level on which the region has at most this many pixels.
    pub quick_area_px: usize,
    /// If this search is not decisive, it is repeated on the first level on which the region has at most this many pixels.
    pub search_area_px: usize,
    /// Share of the region's pixels that must lie on one plane for the quick search to be decisive.
    pub quick_share_min: f64,
    /// Patches are evaluated down to the first level on which the region has at most this many pixels.
    pub patch_area_px: usize,
    /// Parameters of the search.
    pub search: PlaneSearchConfig,
    /// Parameters of the patches.
    pub patches: PatchConfig,
    /// Parameters of the refinement.
    pub refine: RefineConfig,
    /// A small region with an uncertain tilt is refined together with the pixels around it that agree with its plane, up to
    /// this distance in pixels, 0 to 16; 0: the region only.
    pub surroundings_px: usize,
    /// Constants of the choice between candidate surfaces.
    pub choice: SurfaceChoice,
}

impl Default for ColdStartConfig {
    fn default() -> Self {
        Self {
            quick_area_px: 6000,
            search_area_px: 12_000,
            quick_share_min: 0.6,
            patch_area_px: 24_000,
            search: PlaneSearchConfig::default(),
            patches: PatchConfig::default(),
            refine: RefineConfig {
                levels_max: 1,
                erosion_max_px: 2.0,
                erosion_share_max: 0.12,
                calibration_sigma_px: CALIBRATION_SIGMA_PX,
                blur_sigma_px2: BLUR_SIGMA_PX2,
                ..RefineConfig::default()
            },
            surroundings_px: reach::REACH_MAX_PX,
            choice: SurfaceChoice::default(),
        }
    }
}

impl ColdStartConfig {
    /// Levels on which the region has more pixels than this are not needed.
    pub fn finest_area_px(&self) -> usize {
        self.patch_area_px.max(self.refine.area_max_px)
    }

    ranges! {
        fn check_ranges "direct.cold_start.";
        quick_area_px, QUICK_AREA_PX: usize = 200..=1_000_000;
        quick_share_min, QUICK_SHARE_MIN: f64 = 0.0..=1.0;
        search_area_px, SEARCH_AREA_PX: usize = 200..=1_000_000;
        patch_area_px, PATCH_AREA_PX: usize = 200..=1_000_000;
        surroundings_px, SURROUNDINGS_PX: usize = 0..=reach::REACH_MAX_PX;
    }

    /// Checks all ranges.
    ///
    /// # Errors
    /// The parameter that is out of its range.
    pub fn validate(&self) -> Result<(), ranges::OutOfRange> {
        self.check_ranges()?;
        self.search.validate()?;
        self.patches.validate()?;
        self.refine.validate()
    }
}

impl RefineConfig {
    ranges! {
        fn validate "direct.refine.";
        area_max_px, AREA_MAX_PX: usize = 200..=1_000_000;
        points_max, POINTS_MAX: usize = 100..=1_000_000;
        iterations_max, ITERATIONS_MAX: usize = 1..=100;
        place_sigma_px, PLACE_SIGMA_PX: f64 = 0.0..=2.0;
        row_sigma_px, ROW_SIGMA_PX: f64 = 0.0..=5.0;
        calibration_sigma_px, CALIBRATION_SIGMA_PX: f64 = 0.0..=5.0;
        blur_sigma_px2, BLUR_SIGMA_PX2: f64 = 0.0..=5.0;
    }
}

/// Residual disparity error of the calibration of real rigs, pixels: on real pairs with ground truth, covariances without
/// it are too small. If the calibration is exact, as on rendered pairs, set the value that is correct there. Chosen by
/// hand, not varied: it is the lower bound of all standard deviations that are stated for real pairs.
const CALIBRATION_SIGMA_PX: f64 = 0.03;
/// Lenses, focus and the demosaicing of colours make edges of real pairs differ by this much, squared pixels. Chosen: with this
/// and the slope of rows 22 of 116 confident rectangles of 30 to 50 px on chessboards have errors above 5 degrees, without 49
/// of 166.
const BLUR_SIGMA_PX2: f64 = 0.2;

/// Standard deviation of the mean of the clear disparities of a region, pixels of the level: their errors of a quarter of a pixel are those
/// of whole patches. Chosen with figures: on rendered shells of 10 mm the NEES is 0.7.
const CONTINUED_SIGMA_PX: f64 = 0.05;

/// Smallest share of the region that must support a plane on which it lies as a whole: the default of
/// `direct.status.support_sure_min`.
const WHOLE_AREA_MIN: f64 = 0.3;

/// A candidate, refined down to the finest level.
#[derive(Clone, Copy, Debug)]
struct Descent {
    /// The plane fitted to the patches, starting from the candidate.
    plane: DisparityPlane,
    /// Result of the patches for this plane.
    patches: PatchOutcome,
    /// Index of the level.
    level: usize,
}

/// Finds the plane of a region without a start value; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct ColdStart {
    config: ColdStartConfig,
    kernels: Kernels,
    pyramid: RegionPyramid,
    search: PlaneSearch,
    /// Search of the disparity of every pixel.
    dense: PlaneSearch,
    patches: SlantedPatches,
    refiner: PlaneRefiner,
    /// The region with its surroundings, loaded only where they are used.
    surrounded: RegionPyramid,
    surroundings: Surroundings,
    repetition: Repetition,
    beyond: Beyond,
    surfaces: Vec<Surface>,
    masks: Vec<Vec<u8>>,
    searched: usize,
}

impl ColdStart {
    /// Creates a cold start with empty buffers.
    pub fn new(config: ColdStartConfig, kernels: Kernels) -> Self {
        let refiner = PlaneRefiner::new(config.refine.clone(), kernels);
        let pyramid = RegionPyramid::up_to(config.finest_area_px()).keeping_colours();
        let beyond = Beyond::new(&config.choice, config.patch_area_px);
        let surrounded = RegionPyramid::surrounded(config.surroundings_px);
        Self { config, kernels, pyramid, surrounded, refiner, beyond, ..Self::default() }
    }

    /// The parameters.
    pub fn config(&self) -> &ColdStartConfig {
        &self.config
    }

    /// The pyramid of the last region.
    pub fn pyramid(&self) -> &RegionPyramid {
        &self.pyramid
    }

    /// Index of the level on which the last result was searched.
    pub fn searched_level(&self) -> usize {
        self.searched
    }

    /// Candidate surfaces of the last pair, best first.
    pub fn surfaces(&self) -> &[Surface] {
        &self.surfaces
    }

    /// Searches the plane of a region within the disparities of `source`. `is_tilt_allowed` checks a plane's tilt against the
    /// search range. Once `may_continue` returns false, finer levels and the refinement are skipped. `None` if there is no
    /// candidate.
    pub fn run(
        &mut self,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        is_tilt_allowed: impl Fn(&DisparityPlane) -> bool,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<ColdStartOutcome> {
        let allowed = |plane: &DisparityPlane| {
            let within =
                plane.d0_px >= source.disparity_px.lowest - 1.0 && plane.d0_px <= source.disparity_px.highest + 1.0;
            within && is_tilt_allowed(plane)
        };
        self.surfaces.clear();
        if !self.pyramid.update(front_end, source) {
            return None;
        }
        self.search(source.disparity_px, &allowed, may_continue);
        if may_continue() {
            self.prefer_larger(source.disparity_px);
        }
        let (Descent { plane: patch_plane, patches: finest, level }, contender) = self.contest(may_continue)?;
        let first = *self.surfaces.first()?;
        let (second, alias) = self.rivals(&first);
        let refined = self.refined(front_end, source, &patch_plane, &finest, may_continue);
        let at_refined = refined.map(|refined| match self.is_settled(level, &patch_plane, &refined.plane) {
            true => finest,
            false => self.look(level, &refined.plane),
        });
        let (centre, valid_share) = (self.pyramid.centroid_px(), self.search.valid_share);
        let plane_at_refined = at_refined.map(|found| self.pyramid.levels()[level].full_plane(&found.plane, centre));
        let reached = refined.map_or(patch_plane, |refined| refined.plane);
        let searched = &self.pyramid.levels()[self.searched];
        let pixels = self.search.pixels_for(searched, &searched.level_plane(&reached));
        let (mut widest, mut unlimited) = (None, None);
        if support_of(&finest) < self.config.choice.plane_support_min && may_continue() {
            if finest.mean_correlation >= self.config.choice.plane_correlation_min {
                widest = self.widest(&[reached, patch_plane], allowed);
            }
            unlimited = self.unlimited();
        }
        let is_partial = !self.is_whole(&finest);
        let repeats_px = match is_partial && may_continue() {
            true => self.repeats_px(&reached, source.disparity_px, front_end.geometry().disparity_offset_px),
            false => None,
        };
        let nearby =
            refined.and_then(|refined| if is_partial && may_continue() { self.nearby(&refined.plane) } else { None });
        let continued = if may_continue() { self.continued(&reached, support_of(&finest)) } else { None };
        Some(ColdStartOutcome {
            first,
            second,
            alias,
            contender,
            valid_share,
            pixels,
            finest,
            patch_plane,
            refined,
            at_refined,
            plane_at_refined,
            nearby,
            widest,
            continued,
            relief_px: self.patches.relief_px() * self.pyramid.levels()[level].scale as f64,
            unlimited,
            repeats_px,
        })
    }

    /// Whether the region lies on the plane as a whole, but for parts without texture.
    fn is_whole(&self, patches: &PatchOutcome) -> bool {
        patches.support_share >= self.config.choice.whole_support_min && support_of(patches) >= WHOLE_AREA_MIN
    }

    /// Refines a plane, of a small region with its surroundings, if there is time; `None` without time or with too few points.
    fn refined(
        &mut self,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        start: &DisparityPlane,
        finest: &PatchOutcome,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Option<RefinedPlane> {
        if !may_continue() {
            return None;
        }
        let own = self.refiner.refine(front_end, source, &self.pyramid, start)?;
        Some(if may_continue() { self.with_surroundings(own, front_end, source, finest) } else { own })
    }

    /// Refines the plane of a small region together with its agreeing surroundings, if this is more accurate; see
    /// [`super::surroundings`].
    fn with_surroundings(
        &mut self,
        own: RefinedPlane,
        front_end: &StereoFrontEnd,
        source: &PyramidSource<'_>,
        finest: &PatchOutcome,
    ) -> RefinedPlane {
        let reach = self.config.surroundings_px.min(reach::REACH_MAX_PX);
        let Some(level) = self.pyramid.levels().first().filter(|level| level.scale == 1) else { return own };
        let area_px = self.pyramid.area_px();
        let is_small = area_px <= reach::SMALL_PX;
        let may_grow = reach > 0 && (is_small || area_px <= reach::AREA_MAX_PX && self.is_whole(finest));
        if !may_grow || !surroundings::are_wanted(&own, front_end.geometry(), is_small) {
            return own;
        }
        // The windows of the search do not show the surroundings.
        if !self.surrounded.update(front_end, source) {
            return own;
        }
        let wide = &mut self.surrounded.levels_mut()[0];
        wide.take_support(level);
        if self.surroundings.extend(wide, &own, reach, self.kernels) == 0 {
            return own;
        }
        let wide = self.refiner.refine(front_end, source, &self.surrounded, &own.plane);
        wide.and_then(|wide| surroundings::replacement(wide, &own)).unwrap_or(own)
    }

    /// The plane that explains the most clear disparities within one pixel. `None` if there are too few of them, if the plane
    /// equals the first of `known`, or if it is another surface.
    fn widest(&mut self, known: &[DisparityPlane], allowed: impl Fn(&DisparityPlane) -> bool) -> Option<WidestPlane> {
        let (centre, level) = (self.pyramid.centroid_px(), &self.pyramid.levels()[self.searched]);
        let tolerance_px =
            (self.config.choice.widest_px / level.scale as f64).max(self.config.choice.widest_level_px_min);
        if self.search.valid_share < self.config.choice.widest_valid_min {
            return None;
        }
        let own = level.level_plane(known.first()?);
        let share = |tolerance_px| self.search.share_within(level, &own, tolerance_px, self.kernels);
        let is_spread = share(0.5 * tolerance_px) < self.config.choice.spread_near_max * share(tolerance_px);
        let seeds = known.iter().chain(self.surfaces.iter().map(|surface| &surface.plane));
        let found = self.search.widest(
            level,
            seeds.map(|plane| level.level_plane(plane)),
            &self.config.search,
            tolerance_px,
            |plane| allowed(&level.full_plane(plane, centre)),
            self.kernels,
        )?;
        let plane = level.full_plane(&found.plane, centre);
        // If the disparities lie on a plane and do not scatter around it, a more distant plane is another surface.
        if !is_spread && (plane.at(&centre) - known[0].at(&centre)).abs() > self.config.choice.widest_px {
            return None;
        }
        let apart = |at: &Vector2<f64>| (plane.at(at) - known[0].at(at)).abs() > self.config.choice.widest_apart_px;
        self.box_corners().iter().any(apart).then_some(WidestPlane { plane, is_spread })
    }

    /// The plane of least squares through the clear disparities that a plane explains.
    fn nearby(&self, plane: &DisparityPlane) -> Option<DisparityPlane> {
        let level = &self.pyramid.levels()[self.searched];
        let distance_px =
            (self.config.choice.widest_px / level.scale as f64).max(self.config.choice.widest_level_px_min);
        let found = self.search.nearby(level, &level.level_plane(plane), distance_px)?;
        Some(level.full_plane(&found, plane.centre_px))
    }

    /// The plane of least squares through the surface that continues a plane, if that surface is curved; `support` is the share of the
    /// region that agrees with the plane. If it is uncertain whether the
    /// region shows one surface, only where the plane explains little of it.
    fn continued(&mut self, plane: &DisparityPlane, support: f64) -> Option<ContinuedPlane> {
        let (level, choice) = (&self.pyramid.levels()[self.searched], &self.config.choice);
        if support >= choice.continued_support_max {
            return None;
        }
        let (surface, found) = self.search.continued(level, &level.level_plane(plane), choice)?;
        let is_curved = self.search.valid_share >= choice.widest_valid_min
            && surface.share >= choice.continued_share_min
            && surface.rms_px >= choice.continued_rms_min_px;
        let is_certain = surface.steps <= choice.continued_steps_max;
        let counts = is_curved && (is_certain || surface.near_share < choice.continued_doubt_max);
        counts.then_some(ContinuedPlane {
            plane: level.full_plane(&found, plane.centre_px),
            sigma_px: CONTINUED_SIGMA_PX * level.scale as f64,
            is_certain,
        })
    }

    fn unlimited(&mut self) -> Option<UnlimitedPlane> {
        let (centre, level) = (self.pyramid.centroid_px(), &self.pyramid.levels()[self.searched]);
        let (none, config) = (std::iter::empty(), &self.config.search);
        let found = self.search.widest(level, none, config, config.hypotheses.tolerance_px, |_| true, self.kernels)?;
        let (plane, share) = (level.full_plane(&found.plane, centre), found.share * self.search.valid_share);
        Some(UnlimitedPlane { plane, share })
    }

    /// The period of the region's texture, if a plane shifted by one period would be outside the searched disparities.
    fn repeats_px(&mut self, plane: &DisparityPlane, searched_px: DisparityRange, infinity_px: f64) -> Option<f64> {
        let own_px = plane.at(&self.pyramid.centroid_px());
        // At closer range the right image does not show the middle of the region.
        let nearest_px = searched_px.highest.min(self.pyramid.centroid_px().x);
        let leaves_px = (own_px - searched_px.lowest).min(nearest_px - own_px).max(0.0);
        self.period_px(self.searched, plane, leaves_px, infinity_px)
    }

    /// The shortest period of the region's texture along the rows that is at least `shortest_px`, as a level shows it.
    fn period_px(&mut self, index: usize, plane: &DisparityPlane, shortest_px: f64, infinity_px: f64) -> Option<f64> {
        let level = &self.pyramid.levels()[index];
        let scale = level.scale as f64;
        let sought = PeriodSearch {
            middle_px: plane.at(&self.pyramid.centroid_px()) / scale,
            infinity_px: infinity_px / scale,
            shortest_px: shortest_px / scale,
        };
        Some(scale * self.repetition.period_px(level, &level.level_plane(plane), sought, &self.config.choice)?)
    }

    /// Index of the level on which the patches are evaluated last.
    fn finest_level(&self) -> usize {
        let limit = self.config.patch_area_px;
        self.pyramid.levels().iter().position(|l| l.area_px <= limit).unwrap_or(self.searched).min(self.searched)
    }

    /// Evaluates the patches for a plane.
    fn look(&mut self, index: usize, plane: &DisparityPlane) -> PatchOutcome {
        let level = &mut self.pyramid.levels_mut()[index];
        self.patches.run(level, &level.level_plane(plane), &self.config.patches, self.kernels)
    }

    /// Evaluates the patches of every candidate and sorts the candidates.
    fn judge_candidates(&mut self, index: usize, centre: Vector2<f64>) {
        if self.masks.len() < self.search.candidates.len() {
            self.masks.resize_with(self.search.candidates.len(), Vec::new);
        }
        for (mask, candidate) in self.search.candidates.iter().enumerate() {
            let level = &mut self.pyramid.levels_mut()[index];
            let patches = self.patches.run(level, &candidate.plane, &self.config.patches, self.kernels);
            let score = surface_score(&patches, self.search.valid_share * candidate.share);
            let plane = level.full_plane(&patches.plane, centre);
            self.masks[mask].clone_from(&level.support);
            self.surfaces.push(Surface { plane, share: candidate.share, patches, score, area_share: None, mask });
        }
        self.surfaces.sort_by(|a, b| b.score.total_cmp(&a.score));
        self.look_again_at_near_equals(index, centre);
    }

    /// Candidates are first evaluated at the plane from single pixels. If another candidate is nearly as good as the best, this
    /// is unfair to the one that started farther away, so these candidates are evaluated again at the plane from their patches.
    fn look_again_at_near_equals(&mut self, index: usize, centre: Vector2<f64>) {
        let Some(first) = self.surfaces.first().copied() else { return };
        let is_near = |other: &Surface| other.score >= self.config.choice.nearly_equal * first.score;
        let count = self.surfaces.iter().take_while(|other| is_near(other)).count();
        if !self.surfaces[..count].iter().any(|other| self.differs(&first.plane, &other.plane)) {
            return;
        }
        for i in 0..count {
            let old = self.surfaces[i];
            let patches = self.look(index, &old.plane);
            let score = surface_score(&patches, self.search.valid_share * old.share);
            let level = &self.pyramid.levels()[index];
            self.masks[old.mask].clone_from(&level.support);
            self.surfaces[i] = Surface { plane: level.full_plane(&patches.plane, centre), patches, score, ..old };
        }
        self.surfaces.sort_by(|a, b| b.score.total_cmp(&a.score));
    }

    /// Refines a plane from the searched level to the finest patch level, with one or two evaluations per level. Afterwards the
    /// levels mark the pixels that agree with the plane.
    fn descend(&mut self, start: DisparityPlane, may_continue: &mut dyn FnMut() -> bool) -> Descent {
        let (centre, coarsest, finest) = (self.pyramid.centroid_px(), self.searched, self.finest_level());
        let mut plane = start;
        let mut index = coarsest;
        loop {
            let outcome = self.look_twice(index, &mut plane, centre);
            if index == finest || !may_continue() {
                let (plane, patches) = self.closest(index, plane, outcome, centre);
                return Descent { plane, patches, level: index };
            }
            index -= 1;
        }
    }

    /// The plane found on a level, or the plane that clearly more of its patches fit closely, if at least as many patches
    /// support it.
    fn closest(
        &mut self,
        index: usize,
        plane: DisparityPlane,
        outcome: PatchOutcome,
        centre: Vector2<f64>,
    ) -> (DisparityPlane, PatchOutcome) {
        let Some(closest) = self.patches.closest_plane(&self.config.choice, self.kernels) else {
            return (plane, outcome);
        };
        let mut other = self.pyramid.levels()[index].full_plane(&closest, centre);
        let look = self.look_twice(index, &mut other, centre);
        if support_of(&look) >= support_of(&outcome) {
            return (other, look);
        }
        self.look(index, &plane);
        (plane, outcome)
    }

    /// Evaluates the patches for a plane and corrects the plane; evaluates them again if the correction was not small.
    fn look_twice(&mut self, index: usize, plane: &mut DisparityPlane, centre: Vector2<f64>) -> PatchOutcome {
        let mut outcome = self.look(index, plane);
        let found = self.pyramid.levels()[index].full_plane(&outcome.plane, centre);
        let is_settled = self.is_settled(index, plane, &found);
        *plane = found;
        if !is_settled {
            outcome = self.look(index, plane);
            *plane = self.pyramid.levels()[index].full_plane(&outcome.plane, centre);
        }
        outcome
    }

    /// Whether the patch result for one plane is valid for another.
    fn is_settled(&self, index: usize, a: &DisparityPlane, b: &DisparityPlane) -> bool {
        let limit = self.config.choice.settled_px * self.pyramid.levels()[index].scale as f64;
        self.box_corners().iter().all(|at| (a.at(at) - b.at(at)).abs() <= limit)
    }

    fn box_corners(&self) -> [Vector2<f64>; 4] {
        let box_px = self.pyramid.box_px();
        let corner = |x: u32, y: u32| Vector2::new(f64::from(box_px.x + x), f64::from(box_px.y + y));
        let (w, h) = (box_px.width, box_px.height);
        [corner(0, 0), corner(w, 0), corner(0, h), corner(w, h)]
    }

    /// The other surface with the most pixels of its own, and the best alternative explanation of the same pixels.
    fn rivals(&self, first: &Surface) -> (Option<Rival>, Option<Rival>) {
        let (mut second, mut alias): (Option<Rival>, Option<Rival>) = (None, None);
        for other in self.surfaces.iter().skip(1).filter(|other| self.differs(&first.plane, &other.plane)) {
            let rival = self.rival(first, other);
            if rival.overlap > self.config.choice.overlap_of_alias {
                if alias.is_none_or(|known| rival.score_ratio > known.score_ratio) {
                    alias = Some(rival);
                }
                continue;
            }
            let rival = Rival { own_share: other.area_share.unwrap_or(rival.own_share), ..rival };
            if rival.own_share >= self.config.choice.own_share_min
                && second.is_none_or(|known| rival.own_share > known.own_share)
            {
                second = Some(rival);
            }
        }
        (second, alias)
    }

    fn rival(&self, first: &Surface, other: &Surface) -> Rival {
        let (mut a, mut b, mut both) = (0_usize, 0_usize, 0_usize);
        for (p, q) in self.masks[first.mask].iter().zip(&self.masks[other.mask]) {
            let (p, q) = (usize::from(p & SUPPORTS != 0), usize::from(q & SUPPORTS != 0));
            a += p;
            b += q;
            both += p & q;
        }
        let area_px = self.pyramid.levels()[self.searched].area_px.max(1);
        Rival {
            plane: other.plane,
            score_ratio: other.score / first.score.max(1e-9),
            own_share: (b - both) as f64 / area_px as f64,
            overlap: both as f64 / a.min(b).max(1) as f64,
        }
    }

    /// Whether two planes differ by more than two pixels of the search level at the region's centroid or, on average, at the
    /// corners of its box.
    fn differs(&self, a: &DisparityPlane, b: &DisparityPlane) -> bool {
        self.differs_on(self.searched, a, b)
    }

    /// The same for two pixels of another level.
    fn differs_on(&self, index: usize, a: &DisparityPlane, b: &DisparityPlane) -> bool {
        let limit = self.config.choice.differs_px * self.pyramid.levels()[index].scale as f64;
        let gap = |at: &Vector2<f64>| (a.at(at) - b.at(at)).abs();
        gap(&self.pyramid.centroid_px()) > limit || self.box_corners().iter().map(gap).sum::<f64>() > 4.0 * limit
    }
}
