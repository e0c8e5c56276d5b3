//! The direct method on single pairs.

use image::RgbImage;
use nalgebra::{Matrix3, Vector2, Vector3};
use pb3dp_geometry::StereoRig;

use super::cold_start::{ColdStart, ColdStartConfig, ColdStartOutcome};
use super::colour_planes::Wanted;
use super::disparity_plane::{DisparityPlane, inverse_depth_from_disparity};
use super::front_end::StereoFrontEnd;
use super::region_pyramid::PyramidSource;
use super::row_measurement::{RowMeasurement, measure_rows};
use super::row_offset::RowOffset;
use crate::cpu::Kernels;
use crate::error::EstimationError;
use crate::estimate::{EstimateWarning, PlaneEstimate, PlanePose};
use crate::plane_hypothesis::{PlaneHypothesis, SearchRange};
use crate::region::{Region, RegionConfig};
use crate::status::Status;

/// Parameters of the direct method.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DirectConfig {
    /// Regions.
    pub region: RegionConfig,
    /// From nothing to a plane.
    pub cold_start: ColdStartConfig,
}

/// The direct method on single pairs.
#[derive(Clone, Debug)]
pub struct DirectEstimator {
    front_end: StereoFrontEnd,
    config: DirectConfig,
    cold_start: ColdStart,
    rows: RowOffset,
    outcome: Option<ColdStartOutcome>,
}

impl DirectEstimator {
    /// An estimator for a calibrated pair, rectified or not, with lens distortion or without.
    ///
    /// # Errors
    /// A parameter out of its range, or a rig that can not be rectified.
    pub fn new(rig: &StereoRig, config: DirectConfig) -> Result<Self, EstimationError> {
        Self::with_kernels(rig, config, Kernels::best())
    }

    /// As [`Self::new`], with given kernels; the answers are the same, the speed is not.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_kernels(rig: &StereoRig, config: DirectConfig, kernels: Kernels) -> Result<Self, EstimationError> {
        let front_end = StereoFrontEnd::new(rig, kernels)?;
        let cold_start = ColdStart::new(config.cold_start.clone(), kernels);
        Ok(Self { front_end, config, cold_start, rows: RowOffset::default(), outcome: None })
    }

    /// The row offset in use.
    pub fn rows(&self) -> &RowOffset {
        &self.rows
    }

    /// Uses a row offset that is known.
    pub fn set_rows(&mut self, rows: RowOffset) {
        self.rows = rows;
    }

    /// Measures the row offset of the rig on a pair of raw images, and uses it from now on if enough points were found.
    /// Takes some tens of milliseconds: once per rig, or per scene.
    ///
    /// # Errors
    /// Images that do not fit the calibration.
    pub fn measure_rows(&mut self, left: &RgbImage, right: &RgbImage) -> Result<RowMeasurement, EstimationError> {
        self.front_end.check(left, right)?;
        let measured = measure_rows(&self.front_end, left, right);
        self.rows = measured.rows;
        Ok(measured)
    }

    /// What the cold start of the last pair found.
    pub fn outcome(&self) -> Option<&ColdStartOutcome> {
        self.outcome.as_ref()
    }

    /// The cold start with its state after the last pair.
    pub fn cold_start(&self) -> &ColdStart {
        &self.cold_start
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
        range.validate()?;
        self.front_end.check(left, right)?;
        let raw_mask = region.rasterize(left, &self.config.region)?;
        let centroid_px = raw_mask.centroid_px().unwrap_or_default();
        let raw_ray = self.front_end.raw_rig().left().unproject(&centroid_px)?;
        let mask = self.front_end.rectified_region(raw_mask)?;
        let turn = self.front_end.cam_left_rect_from_cam_left();
        let depth_factor = turn.transform_vector(&raw_ray).z;
        let geometry = *self.front_end.geometry();
        let disparity = |z_m: f64| geometry.disparity_px(z_m * depth_factor);
        let disparity_px = (disparity(range.z_max_m), disparity(range.z_min_m));
        let source = PyramidSource {
            left,
            right,
            region: &mask,
            disparity_px,
            rows: self.rows,
            wanted: Wanted::Luminance,
            search_area_px: self.config.cold_start.search_area_px,
        };
        let limits = TiltLimits::new(range);
        let turn_back = turn.inverse();
        let allowed = |plane: &DisparityPlane| {
            let q = turn_back.transform_vector(&plane.inverse_depth_plane(&geometry));
            plane.d0_px >= disparity_px.0 - 1.0 && plane.d0_px <= disparity_px.1 + 1.0 && limits.allow(&q)
        };
        self.outcome = self.cold_start.run(&self.front_end, &source, allowed);
        let mut estimate = self.blank(centroid_px);
        if let Some(outcome) = &self.outcome {
            let (plane, covariance) = match &outcome.refined {
                Some(refined) if refined.converged => (refined.plane, Some(refined.covariance)),
                _ => (outcome.patch_plane, None),
            };
            let to_raw = |plane: &DisparityPlane| turn_back.transform_vector(&plane.inverse_depth_plane(&geometry));
            let q = to_raw(&plane);
            estimate.pose = PlanePose::from_inverse_depth_plane(q, &raw_ray);
            estimate.psi = PlaneHypothesis::from_inverse_depth_plane(&q, &raw_ray);
            if let (Some(covariance), Some(pose)) = (covariance, &estimate.pose) {
                let rotation: Matrix3<f64> = Matrix3::from_columns(&[
                    turn_back.transform_vector(&Vector3::x()),
                    turn_back.transform_vector(&Vector3::y()),
                    turn_back.transform_vector(&Vector3::z()),
                ]);
                let j = rotation * inverse_depth_from_disparity(&geometry, &plane.centre_px);
                let q_covariance = j * covariance * j.transpose();
                let dz = raw_ray * (-pose.z_m * pose.z_m);
                estimate.z_sigma_m = Some((dz.transpose() * q_covariance * dz).x.sqrt());
                let n = q / q.norm();
                let across = (Matrix3::identity() - n * n.transpose()) / q.norm();
                estimate.normal_sigma_rad = Some((across * q_covariance * across.transpose()).trace().sqrt());
            }
            estimate.status = Status::Ok;
            estimate.fitness = Some(outcome.finest.mean_correlation);
        }
        let _ = EstimateWarning::EndOfRange { z_mm: 0.0 };
        Ok(estimate)
    }

    fn blank(&self, centroid_px: Vector2<f64>) -> PlaneEstimate {
        PlaneEstimate {
            status: Status::NotObservable,
            reason: String::new(),
            warnings: Vec::new(),
            centroid_px,
            pose: None,
            psi: None,
            fitness: None,
            z_sigma_m: None,
            normal_sigma_rad: None,
            landscape: None,
            reference_optimum: None,
            left_camera: *self.front_end.raw_rig().left(),
        }
    }
}

/// The tilts that a search range allows.
#[derive(Clone, Copy, Debug)]
struct TiltLimits {
    tangent: f64,
    sine: f64,
}

impl TiltLimits {
    fn new(range: &SearchRange) -> Self {
        Self { tangent: range.tilt_max_rad.tan(), sine: range.tilt_max_rad.sin() }
    }

    /// Whether an inverse-depth plane in `cam_left` is tilted by no more.
    fn allow(&self, q: &Vector3<f64>) -> bool {
        q.z > 0.0 && q.x.abs() <= self.tangent * q.z && q.y.abs() <= self.sine * q.norm()
    }
}
