//! The direct method on single pairs.

use nalgebra::{Matrix3, Point3, Vector2, Vector3};
use pb3dp_estimation_core::Argument;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{EstimateWarning, PlaneEstimate, SecondPlane};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, MarkedTarget, VisiblePoint};
use pb3dp_estimation_core::plane_hypothesis::{PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::region::{RegionConfig, RegionMask};
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::StereoRig;

use super::cold_start::{COPY_SCORE_MIN, ColdStart, ColdStartConfig};
use super::compression::{RowPair, is_of_blocks};
use super::directions::tell;
use super::final_plane::final_plane;
use super::search::PlaneSearchConfig;
use super::shape::{self, ShapePixel};
use super::spread::{Spread, include_second};
pub use super::surface_plane::SurfacePlane;
use super::surface_plane::surface_plane;
use super::tilt_limits::TiltLimits;
use super::verdict::{
    DirectVerdictConfig, ONLY_BLOCKS, SAME_IMAGE, Searched, Steeper, is_no_plane, judge, lies_beyond, may_be_unseen,
    nothing_found, same_elsewhere, similar_second,
};
use crate::outcome::{ColdStartOutcome, Rival, UnlimitedPlane};
use pb3dp_estimation_core::rig_errors::RigErrors;
use pb3dp_estimation_views::colour_planes::Wanted;
use pb3dp_estimation_views::disparity_plane::{DisparityPlane, DisparityRange, inverse_depth_from_disparity};
use pb3dp_estimation_views::front_end::StereoFrontEnd;
use pb3dp_estimation_views::raw_view::RawView;
use pb3dp_estimation_views::region_pyramid::{PyramidSource, RegionLevel, RegionPyramid};

/// Parameters of the direct method.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DirectConfig {
    /// Parameters of regions.
    pub region: RegionConfig,
    /// Parameters of the cold start.
    pub cold_start: ColdStartConfig,
    /// Limits of the status.
    pub verdict: DirectVerdictConfig,
}

impl DirectConfig {
    /// Checks all ranges.
    ///
    /// # Errors
    /// The parameter that is out of its range.
    pub fn validate(&self) -> Result<(), EstimationError> {
        self.cold_start.validate()?;
        Ok(self.verdict.validate()?)
    }
}

/// Estimator of the direct method for single pairs.
///
/// A small vertical misalignment is estimated with every plane. Errors of the rig that were measured on more than the region are set with
/// [`EstimationMethod::correct_rig`].
#[derive(Clone, Debug)]
pub struct DirectEstimator {
    front_end: StereoFrontEnd,
    config: DirectConfig,
    cold_start: ColdStart,
    /// The errors that were corrected in the rig, with their covariance.
    errors: Option<RigErrors>,
    outcome: Option<ColdStartOutcome>,
    mask: RegionMask,
    rectified: RegionMask,
    rows: RowPair,
}

impl DirectEstimator {
    /// Creates an estimator for a calibrated pair, rectified or not, with or without lens distortion.
    ///
    /// # Errors
    /// A parameter out of its range, or a rig that cannot be rectified.
    pub fn new(rig: &StereoRig, config: DirectConfig) -> Result<Self, EstimationError> {
        Self::with_kernels(rig, config, Kernels::best())
    }

    /// As [`Self::new`], with the given kernels; the estimates are identical, the speed differs.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_kernels(rig: &StereoRig, config: DirectConfig, kernels: Kernels) -> Result<Self, EstimationError> {
        config.validate()?;
        let front_end = StereoFrontEnd::new(rig, kernels)?;
        let cold_start = ColdStart::new(config.cold_start.clone(), kernels);
        let mask = RegionMask::empty(rig.left().size());
        let (rectified, rows) = Default::default();
        Ok(Self { front_end, config, cold_start, errors: None, outcome: None, mask, rectified, rows })
    }

    /// The parameters.
    pub fn config(&self) -> &DirectConfig {
        &self.config
    }

    /// Outcome of the cold start for the last pair.
    pub fn outcome(&self) -> Option<&ColdStartOutcome> {
        self.outcome.as_ref()
    }

    /// The cold start with its state after the last pair.
    pub fn cold_start(&self) -> &ColdStart {
        &self.cold_start
    }

    fn view(&self, centroid_px: &Vector2<f64>) -> Result<RawView, EstimationError> {
        let back = self.front_end.cam_left_rect_from_cam_left().inverse();
        let columns = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| back.transform_vector(&axis));
        Ok(RawView {
            geometry: *self.front_end.geometry(),
            turn: Matrix3::from_columns(&columns),
            ray: self.front_end.raw_rig().left().unproject(centroid_px)?,
            errors: self.errors,
        })
    }

    fn fill(&self, estimate: &mut PlaneEstimate, outcome: &ColdStartOutcome, view: &RawView, range: &SearchRange) {
        let choice = &self.config.cold_start.choice;
        let side_px = (self.cold_start.pyramid().area_px() as f64).sqrt();
        let is_exact = self.config.cold_start.refine.calibration_sigma_px == 0.0;
        let (plane, covariance) = final_plane(outcome, side_px, is_exact, choice);
        let covariance = covariance.map(|covariance| covariance + view.covariance_of_errors(&plane));
        let Some(pose) = view.pose(&plane) else {
            estimate.reason =
                "the best plane is behind the camera: check the depth range and the calibration".to_owned();
            return;
        };
        let spread = covariance.map(|covariance| Spread::of(&covariance, &plane, &pose, view));
        let normal_sigma_rad = spread.map(|spread| spread.normal_sigma_rad);
        let searched = Searched { range: *range, steeper: steeper(outcome, view, range) };
        let verdict = judge(outcome, normal_sigma_rad, &searched, &self.config.verdict, choice);
        (estimate.status, estimate.reason) = (verdict.status, verdict.reason);
        estimate.psi = PlaneHypothesis::from_inverse_depth_plane(&pose.inverse_depth_plane, &view.ray);
        estimate.fitness = Some(outcome.finest.mean_correlation);
        let estimated_px = outcome.refined.map_or(0.0, |refined| refined.row_offset_px);
        estimate.row_offset_px = Some(view.row_offset_px(&plane) + estimated_px);
        if estimate.status == Status::NotObservable {
            return;
        }
        if is_no_plane(outcome, &self.config.verdict, choice) {
            estimate.warnings.push(EstimateWarning::NoPlane);
        }
        estimate.pose = Some(pose);
        estimate.z_sigma_m = spread.map(|spread| spread.covariance[(0, 0)].sqrt());
        estimate.normal_sigma_rad = normal_sigma_rad;
        estimate.plane_covariance = spread.map(|spread| spread.covariance);
        let second = |rival: &Rival| Some(SecondPlane { pose: view.pose(&rival.plane)?, share: rival.own_share });
        estimate.second_plane = outcome.second.as_ref().and_then(second);
        let DisparityRange { lowest: farthest_px, highest: nearest_px } = disparity_range(view, range);
        if plane.d0_px < farthest_px + choice.end_of_range_px || plane.d0_px > nearest_px - choice.end_of_range_px {
            estimate.warnings.push(EstimateWarning::EndOfRange { z_mm: 1000.0 * pose.z_m });
            if estimate.status.depth_is_sure() {
                estimate.status = Status::Ambiguous;
                estimate
                    .reason
                    .push_str(", but the plane is at the end of the depth range: the target may be beyond it");
            }
        }
        // A tilt exactly at the limit may be estimated slightly beyond it.
        if !TiltLimits::new(range).allow(&view.inverse_depth_plane(&plane)) {
            let limit_deg = range.tilt_max_rad.to_degrees();
            estimate.warnings.push(EstimateWarning::BeyondTilt { limit_deg });
            let is_beyond = spread.is_some_and(|spread| spread.is_tilted_beyond(&pose, range.tilt_max_rad));
            if is_beyond && estimate.status.depth_is_sure() {
                estimate.status = Status::Ambiguous;
                estimate.reason +=
                    &format!(", but the tilt is out of range: raise the limit ({})", Argument::TiltLimit);
            }
        }
    }

    /// Estimates the plane of a region in one pair of raw images, without a start value: the whole range is searched.
    ///
    /// # Errors
    /// As [`EstimationMethod::estimate`].
    pub fn plane(&mut self, request: &mut EstimateRequest<'_>) -> Result<PlaneEstimate, EstimationError> {
        let MarkedTarget { region, range, .. } = request.marked()?;
        let EstimateRequest { left, right, ref mut deadline, .. } = *request;
        range.validate()?;
        self.front_end.check(left, right)?;
        region.rasterize_into(left, &self.config.region, &mut self.mask)?;
        let centroid_px = self.mask.centroid_px().unwrap_or_default();
        let of_region = region.inspect_shape(&self.mask).into_iter().map(EstimateWarning::Region);
        let warnings = of_region.collect();
        if is_same_image(left, right) {
            return Ok(PlaneEstimate { reason: SAME_IMAGE.to_owned(), warnings, ..self.blank(centroid_px) });
        }
        if is_of_blocks(left, &self.mask, &mut self.rows) {
            return Ok(PlaneEstimate { reason: ONLY_BLOCKS.to_owned(), warnings, ..self.blank(centroid_px) });
        }
        let view = self.view(&centroid_px)?;
        let mut rectified = std::mem::take(&mut self.rectified);
        let raw = std::mem::take(&mut self.mask);
        let mask = self.front_end.rectified_region(&raw, &mut rectified)?;
        let disparity_px = disparity_range(&view, range);
        let source = PyramidSource {
            left,
            right,
            region: mask,
            disparity_px,
            rows: view.rows(middle_depth_m(range)),
            wanted: Wanted::Luminance,
            search_area_px: self.config.cold_start.search_area_px,
        };
        let limits = TiltLimits::new(range);
        let allowed = |plane: &DisparityPlane| limits.allow(&view.inverse_depth_plane(plane));
        self.outcome = self.cold_start.run(&self.front_end, &source, allowed, &mut || deadline.may_continue());
        let mut estimate = PlaneEstimate { warnings, ..self.blank(centroid_px) };
        match &self.outcome {
            Some(outcome) => self.fill(&mut estimate, outcome, &view, range),
            None => estimate.reason = nothing_found(range),
        }
        let limit = self.config.verdict.alias_score_max;
        if estimate.status.depth_is_sure()
            && deadline.may_continue()
            && let Some(outcome) = &self.outcome
            && let Some(reason) =
                objection(&mut self.cold_start, outcome, &self.front_end, &source, allowed, &view, limit)
        {
            (estimate.status, estimate.reason) = (Status::Ambiguous, reason);
        }
        if let (Status::Ambiguous, Some(outcome)) = (estimate.status, &self.outcome)
            && similar_second(outcome, &self.config.verdict).is_some()
            && !is_no_plane(outcome, &self.config.verdict, &self.config.cold_start.choice)
        {
            include_second(&mut estimate, outcome.finest.support_share);
        }
        (self.mask, self.rectified) = (raw, rectified);
        Ok(estimate)
    }

    /// The pixels of the visible surface, the distance of neighbours, and the view that they belong to.
    fn shape(&mut self, request: &EstimateRequest<'_>) -> Result<(Vec<ShapePixel>, f64, RawView), EstimationError> {
        let (pixels, spacing_px, view) = self.matched(request, shape::AREA_MAX_PX, shape::shape_of)?;
        shape::check_matched(&pixels)?;
        Ok((pixels, spacing_px, view))
    }

    /// What `pixels_of` reads from the level of the region that has at most `search_area_px`, with the side of its pixels and the view.
    fn matched<T>(
        &mut self,
        request: &EstimateRequest<'_>,
        search_area_px: usize,
        pixels_of: impl FnOnce(&RegionLevel, DisparityRange, &PlaneSearchConfig, Kernels) -> Vec<T>,
    ) -> Result<(Vec<T>, f64, RawView), EstimationError> {
        let MarkedTarget { region, range, .. } = request.marked()?;
        let EstimateRequest { left, right, .. } = *request;
        range.validate()?;
        self.front_end.check(left, right)?;
        region.rasterize_into(left, &self.config.region, &mut self.mask)?;
        let view = self.view(&self.mask.centroid_px().unwrap_or_default())?;
        let disparity_px = disparity_range(&view, range);
        let source = PyramidSource {
            left,
            right,
            region: self.front_end.rectified_region(&self.mask, &mut self.rectified)?,
            disparity_px,
            rows: view.rows(middle_depth_m(range)),
            wanted: Wanted::Luminance,
            search_area_px,
        };
        let mut pyramid = RegionPyramid::default();
        let is_visible = !is_same_image(left, right) && pyramid.update(&self.front_end, &source);
        let search = &self.config.cold_start.search;
        let (pixels, spacing_px) = match is_visible {
            true => {
                let level = &pyramid.levels()[pyramid.search_level()];
                (pixels_of(level, disparity_px, search, self.front_end.kernels()), level.scale as f64)
            }
            false => (Vec::new(), 1.0),
        };
        Ok((pixels, spacing_px, view))
    }

    /// Points of what both images show of a region, in `cam_left`, metres: few, and only where the match is clear.
    ///
    /// # Errors
    /// As [`EstimationMethod::visible_surface`], but a region without a match is no error.
    pub fn coarse_points(&mut self, request: &EstimateRequest<'_>) -> Result<Vec<Point3<f64>>, EstimationError> {
        let (pixels, _, view) = self.matched(request, shape::COARSE_MAX_PX, shape::clear_pixels)?;
        let point = |(at_px, disparity_px): &(Vector2<f64>, f64)| {
            let z_m = view.depth_m(at_px, *disparity_px)?;
            Some(Point3::from(view.turn * view.geometry.left_ray(at_px) * z_m))
        };
        Ok(pixels.iter().filter_map(point).collect())
    }

    /// The plane of the largest connected surface of a region that is no plane. `None` if the pair shows too little of it.
    ///
    /// # Errors
    /// As [`EstimationMethod::visible_surface`].
    pub fn plane_of_surface(&mut self, request: &EstimateRequest<'_>) -> Result<Option<SurfacePlane>, EstimationError> {
        let (pixels, spacing_px, view) = self.shape(request)?;
        let Some((plane, covariance)) = surface_plane(&pixels, spacing_px) else { return Ok(None) };
        let by = view.turn * inverse_depth_from_disparity(&view.geometry, &plane.centre_px);
        let covariance = covariance + view.covariance_of_errors(&plane);
        let inverse_depth_plane = view.inverse_depth_plane(&plane);
        Ok(Some(SurfacePlane { inverse_depth_plane, covariance: by * covariance * by.transpose() }))
    }

    fn visible(&mut self, request: &EstimateRequest<'_>) -> Result<Vec<VisiblePoint>, EstimationError> {
        let left = request.left;
        let (pixels, _, view) = self.shape(request)?;
        let camera = self.front_end.raw_rig().left();
        let point = |pixel: &ShapePixel| {
            let z_m = view.depth_m(&pixel.at_px, pixel.disparity_px)?;
            let ray = view.turn * view.geometry.left_ray(&pixel.at_px);
            let position_in_cam_left_m = Point3::from(ray * z_m);
            let pixel_px = camera.project(&position_in_cam_left_m)?;
            let [u, v] = [pixel_px.x, pixel_px.y].map(|x| x.round());
            let is_inside = u >= 0.0 && v >= 0.0 && u < f64::from(left.width()) && v < f64::from(left.height());
            let sigma_m = z_m * z_m / view.geometry.focal_baseline_px_m() * pixel.sigma_px * ray.norm();
            let rgb = is_inside.then(|| left.get_pixel(u as u32, v as u32).0)?;
            let is_measured = pixel.is_measured;
            Some(VisiblePoint { pixel_px, position_in_cam_left_m, sigma_m, is_measured, rgb })
        };
        Ok(pixels.iter().filter_map(point).collect())
    }

    fn blank(&self, centroid_px: Vector2<f64>) -> PlaneEstimate {
        let left_camera = *self.front_end.raw_rig().left();
        PlaneEstimate::without_pose(Status::NotObservable, String::new(), centroid_px, left_camera)
    }
}

/// Without refinement, if the time was not sufficient, there is no standard deviation, and the status is at best `weak-tilt`.
/// Estimates are deterministic: the result depends only on the request and the row offset, not on earlier requests.
impl EstimationMethod for DirectEstimator {
    type Answer = PlaneEstimate;

    /// As [`Self::plane`], and tells which directions the pair determines.
    fn answer(&mut self, request: &mut EstimateRequest<'_>) -> Result<PlaneEstimate, EstimationError> {
        let mut estimate = self.plane(request)?;
        tell(&mut estimate, self.config.verdict.normal_sigma_max_deg);
        Ok(estimate)
    }

    /// Keeps parameters and memory.
    fn set_rig(&mut self, rig: &StereoRig) -> Result<(), EstimationError> {
        self.front_end = StereoFrontEnd::new(rig, self.front_end.kernels())?;
        (self.errors, self.outcome) = (None, None);
        self.mask = RegionMask::empty(rig.left().size());
        Ok(())
    }

    /// Keeps the rig, so that images need no other resampling: rows are moved, and planes are corrected.
    fn correct_rig(&mut self, _rig: &StereoRig, errors: &RigErrors) -> Result<(), EstimationError> {
        self.errors = Some(*errors);
        Ok(())
    }

    fn visible_surface(&mut self, request: &EstimateRequest<'_>) -> Result<Vec<VisiblePoint>, EstimationError> {
        self.visible(request)
    }
}

/// Whether both images are identical. Two blank images of one colour may be equal and do not count.
fn is_same_image(left: ImageView<'_>, right: ImageView<'_>) -> bool {
    let (mut first, mut buffers, mut shows_something) = (None, [const { Vec::new() }; 2], false);
    left.dimensions() == right.dimensions()
        && (0..left.height()).all(|y| {
            let [a, b] = &mut buffers;
            let row = left.row(y, a);
            let (pixels, _) = row.as_chunks::<3>();
            let first = first.get_or_insert_with(|| pixels.first().copied());
            shows_something = shows_something || pixels.iter().any(|pixel| Some(*pixel) != *first);
            row == right.row(y, b)
        })
        && shows_something
}

/// Reasons against a confident estimate from outside the searched range: depths at which the right image does not show the
/// region, and depths beyond the range, where a plane may reach `score_max` of the estimate's score.
fn objection(
    cold_start: &mut ColdStart,
    outcome: &ColdStartOutcome,
    front_end: &StereoFrontEnd,
    source: &PyramidSource<'_>,
    allowed: impl Fn(&DisparityPlane) -> bool,
    view: &RawView,
    score_max: f64,
) -> Option<String> {
    let choice = cold_start.config().choice;
    let centre_px = cold_start.pyramid().centroid_px();
    // From this disparity on, the middle of the region is outside the right image.
    let leaves_px = centre_px.x;
    let correlation = outcome.finest.mean_correlation;
    if source.disparity_px.highest > leaves_px && correlation < choice.unseen_correlation_min {
        let nearest = view.pose(&DisparityPlane { centre_px, d0_px: leaves_px, slope: Vector2::zeros() })?;
        return Some(may_be_unseen(nearest.z_m, correlation, choice.unseen_correlation_min));
    }
    let copies = cold_start.look_elsewhere(outcome, front_end, source);
    if let Some(best) = copies.first() {
        let DisparityRange { lowest, highest } = source.disparity_px;
        let is_outside = !(lowest..=highest).contains(&best.plane.d0_px);
        // The answer does not explain the region as well as this, so that there is one explanation.
        if is_outside && best.score_ratio * COPY_SCORE_MIN > 1.0 {
            return Some(lies_beyond(view.pose(&best.plane).map(|pose| pose.z_m), best.score_ratio));
        }
        let planes = std::iter::once(&outcome.patch_plane).chain(copies.iter().map(|copy| &copy.plane));
        let depths_m = planes.map(|plane| view.pose(plane).map(|pose| pose.z_m)).collect::<Vec<_>>();
        return Some(same_elsewhere(&depths_m, best.score_ratio));
    }
    let found = cold_start.look_beyond(outcome, front_end, source, allowed)?;
    let z_m = view.pose(&found.plane).map(|pose| pose.z_m);
    (found.score_ratio > score_max).then(|| lies_beyond(z_m, found.score_ratio))
}

/// The plane that explains the most disparities, if its depth is within the range but its tilt is not.
fn steeper(outcome: &ColdStartOutcome, view: &RawView, range: &SearchRange) -> Option<Steeper> {
    let UnlimitedPlane { plane, share } = outcome.unlimited?;
    let pose = view.pose(&plane)?;
    let q = &pose.inverse_depth_plane;
    let is_within = (range.z_min_m..=range.z_max_m).contains(&pose.z_m) && q.z > 0.0;
    let is_better = share > STEEPER_GAIN_MIN * outcome.valid_share * outcome.first.share;
    let tilt_rad = (q.x.abs() / q.z).atan().max((q.y.abs() / q.norm()).asin());
    (is_within && is_better && !TiltLimits::new(range).allow(q))
        .then_some(Steeper { tilt_deg: tilt_rad.to_degrees(), share })
}

/// A steeper plane than allowed is reported if it explains this many times as many pixels. Chosen by hand, not varied: only
/// the stated reason depends on it.
const STEEPER_GAIN_MIN: f64 = 1.5;

/// Disparities of the two ends of a depth range on the centroid's ray, lowest first.
fn disparity_range(view: &RawView, range: &SearchRange) -> DisparityRange {
    let depth_factor = (view.turn.transpose() * view.ray).z;
    let at = |z_m: f64| view.geometry.disparity_px(z_m * depth_factor);
    DisparityRange { lowest: at(range.z_max_m), highest: at(range.z_min_m) }
}

/// The depth in the middle of the disparities of a range, metres.
fn middle_depth_m(range: &SearchRange) -> f64 {
    2.0 / (1.0 / range.z_min_m + 1.0 / range.z_max_m)
}
