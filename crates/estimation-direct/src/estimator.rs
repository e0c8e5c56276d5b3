//! The direct method on single pairs.

use nalgebra::{Matrix3, Point3, Vector2, Vector3};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{EstimateWarning, PlaneEstimate, PlanePose, SecondPlane};
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, MarkedTarget, VisiblePoint};
use pb3dp_estimation_core::plane_hypothesis::{PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::region::{RegionConfig, RegionMask};
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::StereoRig;

use super::cold_start::{ColdStart, ColdStartConfig};
use super::colour_planes::Wanted;
use super::directions::tell;
use super::disparity_plane::{DisparityPlane, DisparityRange, RectifiedGeometry, inverse_depth_from_disparity};
use super::final_plane::final_plane;
use super::front_end::StereoFrontEnd;
use super::region_pyramid::{PyramidSource, RegionPyramid};
use super::row_measurement::measure_rows;
use super::shape::{self, ShapePixel};
use super::tilt_limits::TiltLimits;
use super::verdict::{
    DirectVerdictConfig, SAME_IMAGE, Searched, Steeper, is_no_plane, judge, lies_beyond, may_be_unseen, nothing_found,
};
use crate::outcome::{ColdStartOutcome, Rival, UnlimitedPlane};
use pb3dp_estimation_core::row_offset::{RowMeasurement, RowOffset};

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
        self.verdict.validate()
    }
}

/// Estimator of the direct method for single pairs.
///
/// A vertical misalignment of some tenths of a pixel reduces the accuracy: measure the row offset once with
/// [`Self::measure_rows`], or set it with [`Self::set_rows`]. A small residual offset is estimated with every plane.
#[derive(Clone, Debug)]
pub struct DirectEstimator {
    front_end: StereoFrontEnd,
    config: DirectConfig,
    cold_start: ColdStart,
    rows: RowOffset,
    outcome: Option<ColdStartOutcome>,
    mask: RegionMask,
    rectified: RegionMask,
}

/// Conversion of planes from the rectified pair to the raw left camera.
struct RawView {
    geometry: RectifiedGeometry,
    /// Rotation `cam_left_from_cam_left_rect`.
    turn: Matrix3<f64>,
    /// Ray of the region's centroid, third component 1.
    ray: Vector3<f64>,
}

impl RawView {
    fn inverse_depth_plane(&self, plane: &DisparityPlane) -> Vector3<f64> {
        self.turn * plane.inverse_depth_plane(&self.geometry)
    }

    fn pose(&self, plane: &DisparityPlane) -> Option<PlanePose> {
        PlanePose::from_inverse_depth_plane(self.inverse_depth_plane(plane), &self.ray)
    }
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
        Ok(Self {
            front_end,
            config,
            cold_start,
            rows: RowOffset::default(),
            outcome: None,
            mask,
            rectified: RegionMask::default(),
        })
    }

    /// The parameters.
    pub fn config(&self) -> &DirectConfig {
        &self.config
    }

    /// Measures the row offset of the rig on a pair of raw images and uses it from now on. It takes some milliseconds and is
    /// intended once per rig or per scene. With too few matched points the offset is zero.
    ///
    /// # Errors
    /// Images that do not match the calibration.
    pub fn measure_rows<'a>(
        &mut self,
        left: impl Into<ImageView<'a>>,
        right: impl Into<ImageView<'a>>,
    ) -> Result<RowMeasurement, EstimationError> {
        let (left, right) = (left.into(), right.into());
        self.front_end.check(left, right)?;
        let measured = measure_rows(&self.front_end, left, right);
        self.rows = measured.rows;
        Ok(measured)
    }

    /// The current row offset.
    pub fn rows(&self) -> &RowOffset {
        &self.rows
    }

    /// Sets a known row offset.
    pub fn set_rows(&mut self, rows: RowOffset) {
        self.rows = rows;
    }

    fn rows_warning(&self, right: ImageView<'_>) -> Option<EstimateWarning> {
        let offset_max_px = self.rows.magnitude_max_px(right.width(), right.height());
        (offset_max_px > ROWS_OFF_MAX_PX).then_some(EstimateWarning::RowsOff { offset_max_px })
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
        })
    }

    fn fill(&self, estimate: &mut PlaneEstimate, outcome: &ColdStartOutcome, view: &RawView, range: &SearchRange) {
        let choice = &self.config.cold_start.choice;
        let side_px = (self.cold_start.pyramid().area_px() as f64).sqrt();
        let is_exact = self.config.cold_start.refine.calibration_sigma_px == 0.0;
        let (plane, covariance) = final_plane(outcome, side_px, is_exact, choice);
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
        estimate.row_offset_px = Some(self.row_offset_px(outcome, &plane));
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
                estimate.reason.push_str(", but the tilt is out of range: raise the limit (--tilt-max)");
            }
        }
    }

    /// Sum of the known and the estimated row offset at the region's centroid.
    fn row_offset_px(&self, outcome: &ColdStartOutcome, plane: &DisparityPlane) -> f64 {
        let right_px = plane.centre_px - Vector2::new(plane.d0_px, 0.0);
        self.front_end.rows_of_whole(&self.rows).at(&right_px)
            + outcome.refined.map_or(0.0, |refined| refined.row_offset_px)
    }

    /// Estimates the plane of a region in one pair of raw images, without a start value: the whole range is searched.
    ///
    /// # Errors
    /// As [`EstimationMethod::estimate`].
    pub fn plane(&mut self, request: &mut EstimateRequest<'_>) -> Result<PlaneEstimate, EstimationError> {
        let MarkedTarget { region, range } = request.marked()?;
        let EstimateRequest { left, right, ref mut deadline, .. } = *request;
        range.validate()?;
        self.front_end.check(left, right)?;
        region.rasterize_into(left, &self.config.region, &mut self.mask)?;
        let centroid_px = self.mask.centroid_px().unwrap_or_default();
        let of_region = region.inspect_shape(&self.mask).into_iter().map(EstimateWarning::Region);
        let warnings = of_region.chain(self.rows_warning(right)).collect();
        if is_same_image(left, right) {
            return Ok(PlaneEstimate { reason: SAME_IMAGE.to_owned(), warnings, ..self.blank(centroid_px) });
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
            rows: self.front_end.rows_of_whole(&self.rows),
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
        (self.mask, self.rectified) = (raw, rectified);
        Ok(estimate)
    }

    fn visible(&mut self, request: &EstimateRequest<'_>) -> Result<Vec<VisiblePoint>, EstimationError> {
        let MarkedTarget { region, range } = request.marked()?;
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
            rows: self.front_end.rows_of_whole(&self.rows),
            wanted: Wanted::Luminance,
            search_area_px: shape::AREA_MAX_PX,
        };
        let mut pyramid = RegionPyramid::default();
        if !pyramid.update(&self.front_end, &source) {
            return Ok(Vec::new());
        }
        let search = &self.config.cold_start.search;
        let pixels = shape::shape_of(&pyramid, disparity_px, search, self.front_end.kernels());
        let camera = self.front_end.raw_rig().left();
        let point = |pixel: &ShapePixel| {
            let z_m = view.geometry.depth_m(pixel.disparity_px)?;
            let ray = view.turn * view.geometry.left_ray(&pixel.at_px);
            let position_in_cam_left_m = Point3::from(ray * z_m);
            let pixel_px = camera.project(&position_in_cam_left_m)?;
            let [u, v] = [pixel_px.x, pixel_px.y].map(|x| x.round());
            let is_inside = u >= 0.0 && v >= 0.0 && u < f64::from(left.width()) && v < f64::from(left.height());
            let sigma_m = z_m * z_m / view.geometry.focal_baseline_px_m() * pixel.sigma_px * ray.norm();
            let rgb = is_inside.then(|| left.get_pixel(u as u32, v as u32).0)?;
            Some(VisiblePoint { pixel_px, position_in_cam_left_m, sigma_m, rgb })
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

    /// Keeps parameters and memory, but not the row offset.
    fn set_rig(&mut self, rig: &StereoRig) -> Result<(), EstimationError> {
        self.front_end = StereoFrontEnd::new(rig, self.front_end.kernels())?;
        (self.rows, self.outcome) = (RowOffset::default(), None);
        self.mask = RegionMask::empty(rig.left().size());
        Ok(())
    }

    /// Measures the row offset of the rig and uses it from now on; takes some milliseconds. With too few matched points the
    /// offset is zero.
    fn prepare(
        &mut self,
        left: ImageView<'_>,
        right: ImageView<'_>,
    ) -> Result<Option<RowMeasurement>, EstimationError> {
        self.measure_rows(left, right).map(Some)
    }

    fn use_rows(&mut self, measured: &RowMeasurement) {
        self.set_rows(measured.rows);
    }

    fn visible_surface(&mut self, request: &EstimateRequest<'_>) -> Result<Vec<VisiblePoint>, EstimationError> {
        self.visible(request)
    }
}

/// A vertical misalignment above this indicates an invalid calibration, pixels. Chosen by hand, not varied: that of real
/// rigs stays below 0.6.
const ROWS_OFF_MAX_PX: f64 = 1.5;

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

/// Root mean square angle between the pole of a half-sphere and normals distributed uniformly over it, `sqrt(pi - 2)`, radians:
/// upper bound of the uncertainty of a normal that faces the camera.
const ANY_NORMAL_RAD: f64 = 1.0684;

/// An estimate is tilted beyond the range if it exceeds the limit by this many standard deviations. 95 % of normal errors.
const TILT_SIGMAS: f64 = 2.0;

/// Uncertainty of a plane in `cam_left`.
#[derive(Clone, Copy, Debug)]
struct Spread {
    /// Covariance of `(z, theta_x, theta_y)`: metres and radians.
    covariance: Matrix3<f64>,
    normal_sigma_rad: f64,
}

impl Spread {
    fn of(covariance: &Matrix3<f64>, plane: &DisparityPlane, pose: &PlanePose, view: &RawView) -> Self {
        let j = view.turn * inverse_depth_from_disparity(&view.geometry, &plane.centre_px);
        let q_covariance = j * covariance * j.transpose();
        let q = pose.inverse_depth_plane;
        // z = 1 / (q . ray), theta_x = atan2(-qy, r) with r = |(qx, qz)|, theta_y = atan2(qx, qz).
        let (r2, n2) = (q.x * q.x + q.z * q.z, q.norm_squared());
        let r = r2.sqrt();
        let dz = view.ray * (-pose.z_m * pose.z_m);
        let dx = Vector3::new(q.x * q.y / r, -r, q.z * q.y / r) / n2;
        let dy = Vector3::new(q.z, 0.0, -q.x) / r2;
        let jacobian = Matrix3::from_rows(&[dz.transpose(), dx.transpose(), dy.transpose()]);
        let normal = q / q.norm();
        let across = (Matrix3::identity() - normal * normal.transpose()) / q.norm();
        let normal_sigma_rad = (across * q_covariance * across.transpose()).trace().max(0.0).sqrt().min(ANY_NORMAL_RAD);
        Self { covariance: jacobian * q_covariance * jacobian.transpose(), normal_sigma_rad }
    }

    /// Whether a tilt of `pose` exceeds a limit by more than its uncertainty.
    fn is_tilted_beyond(&self, pose: &PlanePose, limit_rad: f64) -> bool {
        let q = pose.inverse_depth_plane;
        let tilts_rad = [(-q.y).atan2(q.x.hypot(q.z)), q.x.atan2(q.z)];
        let is_beyond = |(axis, tilt_rad): (usize, f64)| {
            tilt_rad.abs() - limit_rad > TILT_SIGMAS * self.covariance[(axis + 1, axis + 1)].max(0.0).sqrt()
        };
        tilts_rad.into_iter().enumerate().any(is_beyond)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view() -> RawView {
        let turn = pb3dp_geometry::so3::exp(&Vector3::new(0.03, -0.06, 0.02)).to_rotation_matrix();
        RawView {
            geometry: RectifiedGeometry {
                focal_px: Vector2::new(740.0, 755.0),
                left_principal_px: Vector2::new(311.0, 252.0),
                disparity_offset_px: 12.5,
                baseline_m: 0.1,
            },
            turn: *turn.matrix(),
            ray: Vector3::new(0.12, -0.07, 1.0),
        }
    }

    fn plane() -> DisparityPlane {
        DisparityPlane { centre_px: Vector2::new(380.0, 210.0), d0_px: 133.0, slope: Vector2::new(0.06, -0.04) }
    }

    /// Checks against numerical differences of the plane's parameters, not against the formula.
    #[test]
    fn the_covariance_is_that_of_small_changes() {
        let (view, plane) = (view(), plane());
        let psi = |p: &Vector3<f64>| {
            let q = view.inverse_depth_plane(&plane.with_parameters(p));
            let psi = PlaneHypothesis::from_inverse_depth_plane(&q, &view.ray).unwrap();
            Vector3::new(psi.z_m, psi.theta_x_rad, psi.theta_y_rad)
        };
        let p0 = plane.parameters();
        let steps = [1e-4, 1e-7, 1e-7];
        let jacobian = Matrix3::from_columns(&[0, 1, 2].map(|i| {
            let step = Vector3::ith(i, steps[i]);
            (psi(&(p0 + step)) - psi(&(p0 - step))) / (2.0 * steps[i])
        }));
        let root = Matrix3::new(0.05, 0.0, 0.0, 1e-4, 3e-4, 0.0, -2e-4, 1e-4, 4e-4);
        let covariance = root * root.transpose();
        let pose = view.pose(&plane).unwrap();
        let spread = Spread::of(&covariance, &plane, &pose, &view);
        let expected = jacobian * covariance * jacobian.transpose();
        for i in 0..3 {
            for j in 0..3 {
                let scale = (expected[(i, i)] * expected[(j, j)]).sqrt();
                assert!((spread.covariance[(i, j)] - expected[(i, j)]).abs() < 1e-4 * scale, "{i} {j}");
            }
        }
        // A rotation by theta_y moves the normal by cos theta_x of it.
        let cosine = psi(&p0).y.cos();
        let sum = expected[(1, 1)] + cosine * cosine * expected[(2, 2)];
        assert!((spread.normal_sigma_rad - sum.sqrt()).abs() < 1e-4 * sum.sqrt());
    }

    #[test]
    fn no_normal_is_known_worse_than_one_that_may_be_any() {
        let (view, plane) = (view(), plane());
        let pose = view.pose(&plane).unwrap();
        let sigma = |scale: f64| Spread::of(&(Matrix3::identity() * scale), &plane, &pose, &view).normal_sigma_rad;
        assert!(sigma(1e-8) < 0.01 && sigma(1.0) == ANY_NORMAL_RAD, "{} {}", sigma(1e-8), sigma(1.0));
        // Simpson's rule over the squared angle, weighted by the ring of normals at that angle.
        let value = |i: usize| {
            (std::f64::consts::FRAC_PI_2 * i as f64 / 1000.0).powi(2)
                * (std::f64::consts::FRAC_PI_2 * i as f64 / 1000.0).sin()
        };
        let inner: f64 = (1..1000).map(|i| value(i) * if i % 2 == 1 { 4.0 } else { 2.0 }).sum();
        let mean = (value(0) + inner + value(1000)) * std::f64::consts::FRAC_PI_2 / 3000.0;
        assert!((mean.sqrt() - ANY_NORMAL_RAD).abs() < 1e-4, "{}", mean.sqrt());
    }
}
