//! The line of an estimate from one pair.

use nalgebra::{Matrix6, Vector2};
use pb3dp_estimation_core::estimate::{PlaneEstimate, SecondPlane};
use pb3dp_estimation_core::status::SCHEMA_VERSION;
use pb3dp_record::plain_zero::plain_zero;
use serde::Serialize;

use super::millimetres::{covariance_mm, row_major_mm};

/// The result of one case, in the units of the interface; the order of the fields is that of the JSON line.
#[derive(Clone, Debug, Serialize)]
pub struct EstimateLine {
    /// [`SCHEMA_VERSION`].
    pub schema_version: u32,
    /// Name of the case.
    pub case: String,
    /// Name of the method.
    pub method: &'static str,
    /// `ok`, `weak-tilt`, `ambiguous`, `miscalibrated`, `not-observable` or `error`.
    pub status: &'static str,
    /// Depth of the plane on the ray of the region's centroid, millimetres.
    pub z_mm: Option<f64>,
    /// Unit normal in `cam_left`, towards the camera.
    pub normal: Option<[f64; 3]>,
    /// Fitness, eq. (10).
    pub fitness: Option<f64>,
    /// Standard deviation of the depth, millimetres.
    pub z_sigma_mm: Option<f64>,
    /// Standard deviation of the normal, degrees.
    pub normal_sigma_deg: Option<f64>,
    /// CPU time of one thread from images in memory to pose, milliseconds.
    pub ms: Option<f64>,
    /// The point of the raw left image on whose ray the depths are given, pixels.
    pub centroid_px: Option<[f64; 2]>,
    /// The second surface of a region across a depth edge.
    pub second_plane: Option<SecondPlaneLine>,
    /// Intersection of the plane with the ray of `centroid_px`, in `cam_left`, millimetres.
    pub point_mm: Option<[f64; 3]>,
    /// The frame of the model, 16 numbers, row by row, millimetres.
    pub cam_left_from_model: Option<[f64; 16]>,
    /// Covariance of this frame, 36 numbers, row by row, as in the lines of `pb3dp track`.
    pub covariance: Option<Vec<f64>>,
    /// The sum of `covariance` and `calibration_covariance`.
    pub pose_covariance: Option<Vec<f64>>,
    /// The share of the calibration in the covariance of this frame, not contained in `covariance`; only if the calibration file has a
    /// covariance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration_covariance: Option<Vec<f64>>,
    /// Whether the pair determines each direction of this frame, in the order of `covariance`; null if the method does not tell.
    pub observed: Option<[bool; 6]>,
    /// Row of the right image minus row of the left one, of the rectified pair, pixels.
    pub row_offset_px: Option<f64>,
    /// The file of the visible surface; only if one was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceLine>,
    /// Reason for the status.
    pub reason: String,
    /// Warnings: what may make the answer worse than its status.
    pub warnings: Vec<String>,
}

/// The file of a visible surface.
#[derive(Clone, Debug, Serialize)]
pub struct SurfaceLine {
    /// Its path.
    pub file: String,
    /// Number of points.
    pub points: usize,
    /// Number of points with a match of their own in the right image.
    pub measured: usize,
    /// Median of the standard deviations, millimetres.
    pub sigma_median_mm: f64,
}

/// A second surface in the region.
#[derive(Clone, Debug, Serialize)]
pub struct SecondPlaneLine {
    /// Depth on the ray of the region's centroid, millimetres; `None` if that ray does not intersect the plane.
    pub z_mm: Option<f64>,
    /// Unit normal in `cam_left`, towards the camera.
    pub normal: [f64; 3],
    /// Share of the region's pixels that lie on this plane and not on the first, 0 to 1.
    pub share: f64,
}

impl SecondPlaneLine {
    fn of(plane: &SecondPlane, estimate: &PlaneEstimate, centroid_px: &Vector2<f64>) -> Self {
        let ray = estimate.left_camera.unproject(centroid_px).ok();
        Self {
            z_mm: ray.and_then(|ray| plane.pose.depth_on_ray(&ray)).map(|z| z * 1e3),
            normal: plane.pose.normal_in_cam_left.into(),
            share: plane.share,
        }
    }
}

impl EstimateLine {
    /// A failed case with its reason.
    pub fn of_error(case: &str, method: &'static str, reason: String) -> Self {
        Self {
            schema_version: SCHEMA_VERSION,
            case: case.to_owned(),
            method,
            status: "error",
            z_mm: None,
            normal: None,
            fitness: None,
            z_sigma_mm: None,
            normal_sigma_deg: None,
            ms: None,
            centroid_px: None,
            second_plane: None,
            point_mm: None,
            cam_left_from_model: None,
            covariance: None,
            pose_covariance: None,
            calibration_covariance: None,
            observed: None,
            row_offset_px: None,
            surface: None,
            reason,
            warnings: Vec::new(),
        }
    }

    /// The line of an estimate; `z_m` is the depth on the ray of `centroid_px`.
    pub fn of(
        case: &str,
        method: &'static str,
        estimate: &PlaneEstimate,
        (centroid_px, z_m): (Vector2<f64>, Option<f64>),
        calibration: Option<&Matrix6<f64>>,
        ms: f64,
    ) -> Self {
        let second = estimate.second_plane.as_ref();
        let frame = estimate.model_frame(&centroid_px);
        let covariance = frame.and_then(|frame| frame.covariance);
        Self {
            status: estimate.status.as_str(),
            z_mm: z_m.map(|z| z * 1e3),
            normal: estimate.normal_in_cam_left().map(Into::into),
            fitness: estimate.fitness,
            z_sigma_mm: estimate.z_sigma_m.map(|sigma| sigma * 1e3),
            normal_sigma_deg: estimate.normal_sigma_rad.map(f64::to_degrees),
            ms: Some(ms),
            centroid_px: Some(centroid_px.into()),
            second_plane: second.map(|plane| SecondPlaneLine::of(plane, estimate, &centroid_px)),
            point_mm: frame.map(|frame| (frame.cam_left_from_model.translation_m() * 1e3).into()),
            cam_left_from_model: frame.map(|frame| row_major_mm(&frame.cam_left_from_model)),
            covariance: covariance.as_ref().map(covariance_mm),
            pose_covariance: covariance.map(|own| covariance_mm(&calibration.map_or(own, |share| own + share))),
            calibration_covariance: calibration.map(covariance_mm),
            observed: estimate.observed,
            row_offset_px: estimate.row_offset_px,
            surface: None,
            warnings: estimate.warnings.iter().map(ToString::to_string).collect(),
            ..Self::of_error(case, method, estimate.reason.clone())
        }
    }

    /// Heading of the human table.
    pub const HEADING: &'static str =
        "case                      status              z mm    +-mm  normal (x, y, z)         +-deg  fitness       ms";

    /// A line of the human table; standard deviations follow "+-".
    pub fn human(&self) -> String {
        let number = |value: Option<f64>, decimals: usize| value.map_or("-".into(), |x| format!("{x:.decimals$}"));
        let normal = self.normal.map_or("-".into(), |[x, y, z]| format!("{x:+.3} {y:+.3} {z:+.3}"));
        plain_zero(&format!(
            "{:<25} {:<14} {:>9} {:>7}  {:<23} {:>6}  {:>7} {:>8}",
            self.case,
            self.status,
            number(self.z_mm, 2),
            number(self.z_sigma_mm, 2),
            normal,
            number(self.normal_sigma_deg, 2),
            number(self.fitness, 3),
            number(self.ms, 2)
        ))
    }
}
