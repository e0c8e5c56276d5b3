//! The answer to "where is this surface": a plane, a status, and why.

use nalgebra::{Matrix3, Matrix6, Vector2, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Camera, Pose};

use crate::model_frame::{ModelFrame, frame_covariance, model_frame_on_plane};
use crate::plane_hypothesis::PlaneHypothesis;
use crate::region::RegionWarning;
use crate::status::Status;

/// What may make an estimate worse than it looks.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EstimateWarning {
    /// The region may serve badly.
    #[error(transparent)]
    Region(#[from] RegionWarning),
    /// The search ended below a score that the probe has met by chance.
    #[error(
        "the search ended at fitness {found:.3}, a coarse grid found {grid:.3}: allow more generations or narrow the search range"
    )]
    SearchIncomplete {
        /// Fitness of the answer.
        found: f64,
        /// Highest fitness of the probe.
        grid: f64,
    },
    /// The answer is tilted by more than was to be searched.
    #[error("the answer is tilted beyond the {limit_deg:.0} degrees that were searched: allow more tilt (--tilt-max)")]
    BeyondTilt {
        /// Largest tilt of the search range, degrees.
        limit_deg: f64,
    },
    /// The region is no plane.
    #[error("the region is no plane: mark a part that is flat, or track it, which recovers its surface")]
    NoPlane,
    /// The caller's time was over before the method had done everything.
    #[error("cut short by the deadline: this is the best answer so far")]
    CutShort,
    /// The rows of the two images are further apart than those of a calibrated rig.
    #[error(
        "rows of the right image lie up to {offset_max_px:.1} px off: this is taken into account, but depth and normal rest \
         on the same calibration: see that both cameras are triggered at the same moment, or calibrate again"
    )]
    RowsOff {
        /// Largest offset anywhere in the rectified images, pixels.
        offset_max_px: f64,
    },
    /// The answer lies at an end of the depth range.
    #[error("the answer, z = {z_mm:.1} mm, lies at the end of the depth range: widen the range")]
    EndOfRange {
        /// Depth, millimetres.
        z_mm: f64,
    },
}

/// A plane in `cam_left`, as found on one pair.
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
    /// The plane of an inverse-depth plane; `z_m` is taken on `centre_ray` (third component 1). `None` if the plane is not
    /// in front of the camera there.
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

/// The best of all 2^24 chromosomes: what lies between it and an answer is the fault of the search, what lies between it and
/// the truth the fault of the fitness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceOptimum {
    /// The hypothesis of the lowest chromosome that reaches the highest fitness.
    pub psi: PlaneHypothesis,
    /// The highest fitness, at most 1. An answer of this fitness has no search error, wherever on the plateau it lies.
    pub fitness: f64,
    /// How many chromosomes reach it, `psi` included: votes are counted, so the summit is a plateau.
    pub ties: u64,
}

/// Another surface in the same region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SecondPlane {
    /// The plane in `cam_left`; its depth is on the ray of the region's centroid, like that of the first.
    pub pose: PlanePose,
    /// Share of the region's pixels that lie on this plane and not on the first, 0 to 1.
    pub share: f64,
}

/// The outcome for one pair.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaneEstimate {
    /// How far the answer can be trusted.
    pub status: Status,
    /// What led to the status.
    pub reason: String,
    /// What may make the answer worse than it looks.
    pub warnings: Vec<EstimateWarning>,
    /// Centroid of the region's pixels, raw left image, pixels.
    pub centroid_px: Vector2<f64>,
    /// The plane; `None` where the method cannot say: status `not-observable`.
    pub pose: Option<PlanePose>,
    /// The best hypothesis, also where it decides nothing; its depth is on the ray of the model's centre, which for images
    /// with distortion differs from the centroid's ray by a fraction of a pixel. `None` if nothing was searched.
    pub psi: Option<PlaneHypothesis>,
    /// Fitness of `psi`, at most 1.
    pub fitness: Option<f64>,
    /// Standard deviation of the depth, metres; `None`: the method cannot say.
    pub z_sigma_m: Option<f64>,
    /// Standard deviation of the normal, radians; `None`: the method cannot say.
    pub normal_sigma_rad: Option<f64>,
    /// Covariance of `(z, theta_x, theta_y)` of the plane (metres and radians; see
    /// [`PlaneHypothesis`] for the angles); `None`: the method cannot say.
    pub plane_covariance: Option<Matrix3<f64>>,
    /// The other surface of a region that straddles a depth edge; `None` if none was found, or the method does not look.
    pub second_plane: Option<SecondPlane>,
    /// Row of the right image minus row of the left one at the region, of the rectified pair, pixels; `None`: the method
    /// takes the rows as they are.
    pub row_offset_px: Option<f64>,
    /// The best of all chromosomes; `None` unless the method's configuration asks for it.
    pub reference_optimum: Option<ReferenceOptimum>,
    /// The left camera of the raw image, for [`Self::depth_at_pixel`].
    pub left_camera: Camera,
}

impl PlaneEstimate {
    /// An answer without a pose, from a left camera, about a region with this centroid (raw image, pixels).
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

    /// The frame of the model on the plane, and its covariance if the method states that of the plane: origin on the ray of `pixel` (raw
    /// left image), axes and covariance as in [`TrackEstimate`]. `None` as in [`Self::depth_at_pixel`].
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

    /// Depth of the plane on the ray of a pixel of the raw left image, metres. `None` without a pose, where the pixel has no
    /// ray, or where the plane is not in front of the camera.
    pub fn depth_at_pixel(&self, pixel: &Vector2<f64>) -> Option<f64> {
        let ray = self.left_camera.unproject(pixel).ok()?;
        self.pose?.depth_on_ray(&ray)
    }
}

/// The outcome for one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackEstimate {
    /// How far the answer can be trusted; `lost` where there is none.
    pub status: Status,
    /// What led to the status.
    pub reason: String,
    /// Why the marked region or what was found in it may serve badly: told once, by the start; empty in every later frame.
    pub warnings: Vec<EstimateWarning>,
    /// Pose of the model in the left camera; `None` if lost or not observable.
    ///
    /// Model frame: origin at the plane point on the ray of the region's centroid in the first frame, z along the plane's
    /// normal away from the camera, x the image's x axis projected into the plane in the first frame. A method that cannot
    /// measure the rotation about the normal holds it: the first axes, carried by the known motion of the camera and turned
    /// by the smallest rotation that brings z to the normal found.
    pub cam_left_from_model: Option<Pose<CamLeft, Model>>,
    /// Covariance of the pose; `None`: the method cannot say.
    pub covariance: Option<Matrix6<f64>>,
    /// Best hypothesis, about the centre of this frame's region; `None` if nothing was searched, or the method has none.
    pub psi: Option<PlaneHypothesis>,
    /// Agreement of model and images, at most 1: the fitness of `psi`, or for the direct method the smaller of the correlations
    /// of its view with both images.
    pub fitness: Option<f64>,
    /// Outline of the region in this frame, raw left image, pixels.
    pub outline_px: Vec<Vector2<f64>>,
    /// Whether the rotation about the normal was measured; never by the published method.
    pub rotation_about_normal_observed: bool,
}

impl TrackEstimate {
    /// An answer without a pose.
    pub fn without_pose(status: Status, reason: String) -> Self {
        Self {
            status,
            reason,
            warnings: Vec::new(),
            cam_left_from_model: None,
            covariance: None,
            psi: None,
            fitness: None,
            outline_px: Vec::new(),
            rotation_about_normal_observed: false,
        }
    }
}
