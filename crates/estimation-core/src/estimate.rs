//! Results of the estimators: a plane or a pose, a status, and the reason for the status.

use nalgebra::{Matrix3, Matrix6, Vector2, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model, Surface};
use pb3dp_geometry::{Camera, Pose};
use pb3dp_message_codes::Argument;

use crate::model_frame::{ModelFrame, frame_covariance, model_frame_on_plane};
use crate::plane_hypothesis::PlaneHypothesis;
use crate::region::RegionWarning;
use crate::status::Status;

/// Warnings about an estimate: conditions that may make it worse than its status suggests.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EstimateWarning {
    /// The region may be unsuitable.
    #[error(transparent)]
    Region(#[from] RegionWarning),
    /// The search ended at a lower fitness than a coarse grid of probes found.
    #[error(
        "the search ended at fitness {found:.3}, a coarse grid found {grid:.3}: allow more generations or narrow the search range"
    )]
    SearchIncomplete {
        /// Fitness of the answer.
        found: f64,
        /// Highest fitness of the probe.
        grid: f64,
    },
    /// The estimated tilt is outside the searched range.
    #[error(
        "the estimated tilt is beyond the {limit_deg:.0} degrees of the search range: raise the limit ({})",
        Argument::TiltLimit
    )]
    BeyondTilt {
        /// Largest tilt of the search range, degrees.
        limit_deg: f64,
    },
    /// No plane within the range of depths explains the region: its surface is not planar, or lies elsewhere.
    #[error(
        "no plane explains the region: if the object may be elsewhere, widen the range of depths ({}); if it is curved, mark a flat part, write its surface ({}), or track it",
        Argument::DepthRange,
        Argument::VisibleSurface
    )]
    NoPlane,
    /// The tracker follows a part of the region.
    #[error("the region shows several surfaces: the largest one is followed, {percent:.0} % of the region")]
    PartFollowed {
        /// Share of the region's pixels, percent.
        percent: f64,
    },
    /// The deadline stopped the method before its last step.
    #[error("cut short by the deadline: this is the best estimate so far")]
    CutShort,
    /// Errors of the calibration that the rows of the images show, and that were corrected.
    #[error(
        "vertical misalignment of up to {offset_max_px:.1} px ({errors}): corrected, but what no row shows may have changed as well: \
         check that both cameras are triggered simultaneously, or calibrate again"
    )]
    RowsOff {
        /// Largest vertical offset anywhere in the rectified images, pixels.
        offset_max_px: f64,
        /// The errors, as text.
        errors: String,
    },
    /// The images do not show whether the calibration is right.
    #[error(
        "these images do not show whether the calibration is right, because too few of their points can be compared: with a wrong one the \
         answer would look the same"
    )]
    RigUnchecked,
    /// The right camera exposes at another time than the left one.
    #[error(
        "the right camera exposes {skew_ms:+.1} ± {sigma_ms:.1} ms after the left one, as its rows show when the target moves: state it \
         ({}), so that the first pair is right as well",
        Argument::Skew
    )]
    Skewed {
        /// Middle of the right exposure minus middle of the left one, milliseconds.
        skew_ms: f64,
        /// Standard deviation, milliseconds.
        sigma_ms: f64,
    },
    /// The rows of a moving target contradict the skew that was stated.
    #[error(
        "the rows of the target show a skew of {skew_ms:+.1} ± {sigma_ms:.1} ms, and {stated_ms:+.1} ms are stated: check value and sign \
         ({}), or leave it out",
        Argument::Skew
    )]
    SkewContradicted {
        /// What was stated, milliseconds.
        stated_ms: f64,
        /// What the rows show, milliseconds.
        skew_ms: f64,
        /// Its standard deviation, milliseconds.
        sigma_ms: f64,
    },
    /// Nothing tells whether both cameras expose at once.
    #[error(
        "neither the recording nor the motion tells whether both cameras expose at once: at this speed {example_ms:.0} ms cost \
         {cost_mm:.1} mm of depth and {cost_deg:.1} degrees of tilt: state the time between them ({}; 0 if one trigger drives both)",
        Argument::Skew
    )]
    SkewUnknown {
        /// The skew of the example, milliseconds.
        example_ms: f64,
        /// Its depth error, millimetres.
        cost_mm: f64,
        /// Its tilt error, degrees.
        cost_deg: f64,
    },
    /// The estimated depth is at an end of the depth range.
    #[error("the estimated depth, z = {z_mm:.1} mm, is at the end of the depth range: widen the range")]
    EndOfRange {
        /// Depth, millimetres.
        z_mm: f64,
    },
}

/// Largest standard deviation of an observed shift or depth, relative to the distance: then 95 % of the answers are within 1 %.
pub const SHIFT_SIGMA_SURE: f64 = 0.005;

/// A plane in `cam_left`, estimated from one stereo pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanePose {
    /// Depth of the plane on the ray of the region's centroid, metres.
    pub z_m: f64,
    /// Unit normal in `cam_left`, towards the camera.
    pub normal_in_cam_left: Vector3<f64>,
    /// The inverse-depth plane: 1/depth on a ray `d` (third component 1) is `q . d`, 1/m.
    pub inverse_depth_plane: Vector3<f64>,
}

impl PlanePose {
    /// Converts an inverse-depth plane; `z_m` is the depth on `centre_ray` (third component 1). `None` if the plane is not in
    /// front of the camera there.
    pub fn from_inverse_depth_plane(q: Vector3<f64>, centre_ray: &Vector3<f64>) -> Option<Self> {
        let inverse_depth = q.dot(centre_ray);
        let length = q.norm();
        (inverse_depth > 0.0 && length.is_finite()).then(|| Self {
            z_m: 1.0 / inverse_depth,
            normal_in_cam_left: -q / length,
            inverse_depth_plane: q,
        })
    }

    /// Depth of the plane on a ray of `cam_left` (third component 1), metres; `None` where it is not in front of the camera.
    pub fn depth_on_ray(&self, ray: &Vector3<f64>) -> Option<f64> {
        let inverse_depth = self.inverse_depth_plane.dot(ray);
        (inverse_depth > 0.0).then(|| 1.0 / inverse_depth)
    }
}

/// The best of all 2^24 chromosomes. The difference between this optimum and an estimate is the error of the search; the
/// difference between this optimum and the truth is the error of the fitness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceOptimum {
    /// The hypothesis of the lowest chromosome that has the highest fitness.
    pub psi: PlaneHypothesis,
    /// The highest fitness, at most 1. An estimate with this fitness has no search error, wherever on the plateau it is.
    pub fitness: f64,
    /// Number of chromosomes with this fitness, `psi` included. Votes are counted, so the maximum is a plateau.
    pub ties: u64,
}

/// A second surface in the same region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondPlane {
    /// The plane in `cam_left`; its depth is on the ray of the region's centroid, as for the first plane.
    pub pose: PlanePose,
    /// Share of the region's pixels on this plane and not on the first plane, 0 to 1.
    pub share: f64,
}

/// Plane estimate for one stereo pair.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneEstimate {
    /// Confidence class of the estimate.
    pub status: Status,
    /// Measured reason for the status.
    pub reason: String,
    /// Conditions that may make the estimate worse than its status suggests.
    pub warnings: Vec<EstimateWarning>,
    /// Centroid of the region's pixels, raw left image, pixels.
    pub centroid_px: Vector2<f64>,
    /// The plane; `None` if the method cannot determine it (status `not-observable`).
    pub pose: Option<PlanePose>,
    /// The best hypothesis, also if it was rejected. Its depth is on the ray of the model's centre. In distorted images this
    /// ray differs from the centroid's ray by a fraction of a pixel. `None` if nothing was searched.
    pub psi: Option<PlaneHypothesis>,
    /// Fitness of `psi`, at most 1.
    pub fitness: Option<f64>,
    /// Standard deviation of the depth, metres; `None` if the method does not provide it.
    pub z_sigma_m: Option<f64>,
    /// Standard deviation of the normal, radians; `None` if the method does not provide it.
    pub normal_sigma_rad: Option<f64>,
    /// Covariance of `(z, theta_x, theta_y)` of the plane (metres and radians; see [`PlaneHypothesis`] for the angles). `None`
    /// if the method does not provide it.
    pub plane_covariance: Option<Matrix3<f64>>,
    /// Whether each direction of the model frame is determined, in the order of [`TrackEstimate::observed`]. `None` if the method does
    /// not tell. The region fixes x, y and the rotation about the normal, because it is the model: only the depth and the two tilts
    /// are measured.
    pub observed: Option<[bool; 6]>,
    /// The other surface of a region that straddles a depth edge. `None` if none was found or the method does not search for
    /// it.
    pub second_plane: Option<SecondPlane>,
    /// Vertical offset at the region in the rectified pair: row of the right image minus row of the left image, pixels. `None`
    /// if the method does not measure row offsets.
    pub row_offset_px: Option<f64>,
    /// The best of all chromosomes; `None` unless the method's configuration requests it.
    pub reference_optimum: Option<ReferenceOptimum>,
    /// Left camera of the raw image, for [`Self::depth_at_pixel`].
    pub left_camera: Camera,
}

impl PlaneEstimate {
    /// An estimate without a pose, for a region with this centroid (raw left image, pixels).
    pub fn without_pose(status: Status, reason: String, centroid_px: Vector2<f64>, left_camera: Camera) -> Self {
        Self {
            status,
            reason,
            warnings: Vec::new(),
            centroid_px,
            pose: None,
            psi: None,
            fitness: None,
            z_sigma_m: None,
            normal_sigma_rad: None,
            plane_covariance: None,
            observed: None,
            second_plane: None,
            row_offset_px: None,
            reference_optimum: None,
            left_camera,
        }
    }

    /// Depth of the plane on the ray of the region's centroid, metres.
    pub fn z_m(&self) -> Option<f64> {
        self.pose.map(|pose| pose.z_m)
    }

    /// Unit normal in `cam_left`, towards the camera.
    pub fn normal_in_cam_left(&self) -> Option<Vector3<f64>> {
        self.pose.map(|pose| pose.normal_in_cam_left)
    }

    /// The model frame on the plane, with its covariance if the method provides the covariance of the plane. The origin is on
    /// the ray of `pixel` (raw left image); axes and covariance as in [`TrackEstimate`]. `None` as in [`Self::depth_at_pixel`].
    pub fn model_frame(&self, pixel: &Vector2<f64>) -> Option<ModelFrame> {
        let ray = self.left_camera.unproject(pixel).ok()?;
        let pose = self.pose?;
        let frame = model_frame_on_plane(ray * pose.depth_on_ray(&ray)?, &pose.normal_in_cam_left)?;
        let plane = PlaneHypothesis::from_inverse_depth_plane(&pose.inverse_depth_plane, &ray);
        let covariance = plane
            .zip(self.plane_covariance)
            .and_then(|(plane, covariance)| frame_covariance(&plane, &ray, &covariance));
        Some(ModelFrame { cam_left_from_model: frame, covariance })
    }

    /// The point on whose ray a depth is reported, and this depth in metres: `at_px` (raw left image, pixels), or else the centroid of the
    /// region. No depth as in [`Self::depth_at_pixel`].
    pub fn point_at(&self, at_px: Option<Vector2<f64>>) -> (Vector2<f64>, Option<f64>) {
        match at_px {
            Some(at_px) => (at_px, self.depth_at_pixel(&at_px)),
            None => (self.centroid_px, self.z_m()),
        }
    }

    /// Depth of the plane on the ray of a pixel of the raw left image, metres. `None` if there is no pose, if the pixel has no
    /// ray, or if the plane is not in front of the camera there.
    pub fn depth_at_pixel(&self, pixel: &Vector2<f64>) -> Option<f64> {
        let ray = self.left_camera.unproject(pixel).ok()?;
        self.pose?.depth_on_ray(&ray)
    }
}

/// The shares of the calibration in a pose: covariances of `xi = (rho, phi)` in `true pose = pose * exp(xi)`, metres and radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationShare {
    /// In the absolute pose, beside the covariance of the estimate.
    pub pose: Matrix6<f64>,
    /// In the motion since the first pair: the truth is that motion of the first answer. Zero in the first pair, and small while the target
    /// is near its first pose, because the errors of both poses are then nearly the same.
    pub motion: Matrix6<f64>,
}

/// The plane of the visible surface beside `model`: later pairs improve it, and `model` itself never moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceEstimate {
    /// Pose of `model` relative to the plane; coincident in version 0.
    pub surface_from_model: Pose<Surface, Model>,
    /// Covariance of the plane against the visible surface: metres and radians, translation first, axes of `surface`. In version 0 it is that of
    /// the first pose.
    pub covariance: Matrix6<f64>,
    /// 0: the first pair alone; one more with each pair that has improved it.
    pub version: u32,
}

/// Tracking result for one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackEstimate {
    /// Confidence class of the estimate; `lost` if the target was not found.
    pub status: Status,
    /// Measured reason for the status.
    pub reason: String,
    /// Warnings about the marked region and the initial estimate. Reported once, with the first frame; empty in all later
    /// frames.
    pub warnings: Vec<EstimateWarning>,
    /// Pose of the model in the left camera; `None` if the target is lost or not observable.
    ///
    /// Model frame: the origin is the plane point on the ray of the region's centroid in the first frame. The z axis is the
    /// plane normal, pointing away from the camera. The x axis is the image's x axis, projected into the plane in the first
    /// frame. A method that cannot measure the rotation about the normal keeps it constant: it moves the first axes with the
    /// known camera motion and applies the smallest rotation that aligns z with the estimated normal.
    pub cam_left_from_model: Option<Pose<CamLeft, Model>>,
    /// Covariance of the pose since the first one, which defines `model`; in the first frame that of the first pose. `None` if the method does
    /// not provide it.
    pub covariance: Option<Matrix6<f64>>,
    /// Covariance of the first pose against the visible surface of the target, in every frame: choice of the surface, relief, noise, motion
    /// between the exposures, and calibration. `None` as for `covariance`.
    pub first_pose_covariance: Option<Matrix6<f64>>,
    /// The sum: covariance of the pose against the visible surface. `None` as for `covariance`.
    pub pose_covariance: Option<Matrix6<f64>>,
    /// The share of the calibration, which both of the last two contain and `covariance` does not; `None` if its errors are not known.
    pub calibration: Option<CalibrationShare>,
    /// The plane of the visible surface beside `model`, as the pairs so far show it. `None` without a pose or `first_pose_covariance`.
    pub surface: Option<SurfaceEstimate>,
    /// Best hypothesis, at the centre of this frame's region. `None` if nothing was searched or the method has no hypotheses.
    pub psi: Option<PlaneHypothesis>,
    /// Agreement of model and images, at most 1: the fitness of `psi`, or, for the direct method, the smaller of the
    /// correlations of its view with the two images.
    pub fitness: Option<f64>,
    /// Outline of the region in this frame, raw left image, pixels.
    pub outline_px: Vec<Vector2<f64>>,
    /// Whether the images determine each direction of the pose: x, y, z, then the rotations about them (axes of `model`). `None` if the
    /// method does not tell.
    pub observed: Option<[bool; 6]>,
    /// Whether the rotation about the normal was measured. The published method never measures it.
    pub rotation_about_normal_observed: bool,
}

impl TrackEstimate {
    /// Whether each direction is measured; a method that does not tell measures all but perhaps the rotation about the normal.
    pub fn observed_directions(&self) -> [bool; 6] {
        let [x, y, z, about_x, about_y, about_z] = self.observed.unwrap_or([true; 6]);
        [x, y, z, about_x, about_y, about_z && self.rotation_about_normal_observed]
    }

    /// A result without a pose.
    pub fn without_pose(status: Status, reason: String) -> Self {
        Self {
            status,
            reason,
            warnings: Vec::new(),
            cam_left_from_model: None,
            covariance: None,
            first_pose_covariance: None,
            pose_covariance: None,
            calibration: None,
            surface: None,
            psi: None,
            fitness: None,
            outline_px: Vec::new(),
            observed: None,
            rotation_about_normal_observed: false,
        }
    }
}
