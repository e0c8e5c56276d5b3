//! Plane hypotheses: psi = (z, theta_x, theta_y), and the homography that each plane induces between the images.
//!
//! The plane goes through the point `z_m` times the ray of the model's centre pixel (third component of the ray is 1).
//! Its normal `n = Ry(theta_y) Rx(theta_x) e_z` points away from the cameras. All quantities are in `cam_left`, metres and
//! radians. The inverse-depth plane `q = n / (n . p0)` holds the same three numbers in a form that makes the map between the
//! images linear: the inverse depth of the plane on a ray `d` is `q . d`.
//!
//! The images must be free of distortion: undistort or rectify them first (see `pb3dp_geometry::maps`).

use std::ops::RangeInclusive;

use nalgebra::{Matrix3, Vector2, Vector3};
use pb3dp_geometry::{Distortion, ImageSize, Pinhole, StereoRig, ranges};

use crate::error::EstimationError;
use crate::trig;

/// psi of the paper: depth of the model's origin and two tilts of the model's plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaneHypothesis {
    /// Depth of the model's origin in `cam_left`, metres.
    pub z_m: f64,
    /// First rotation, about x, radians.
    pub theta_x_rad: f64,
    /// Second rotation, about y, radians.
    pub theta_y_rad: f64,
}

impl PlaneHypothesis {
    /// Unit normal in `cam_left`, away from the cameras.
    pub fn normal(&self) -> Vector3<f64> {
        let (sx, cx) = trig::sin_cos(self.theta_x_rad);
        let (sy, cy) = trig::sin_cos(self.theta_y_rad);
        Vector3::new(sy * cx, -sx, cy * cx)
    }

    /// `q = n / (n . p0)`, in 1/m; `None` if the depth is not positive, or if the camera sees the plane from behind or edge-on
    /// at the centre (`n . d_c <= 0`). `centre_ray` has third component 1.
    pub fn inverse_depth_plane(&self, centre_ray: &Vector3<f64>) -> Option<Vector3<f64>> {
        let normal = self.normal();
        let distance_m = self.z_m * normal.dot(centre_ray);
        (self.z_m > 0.0 && distance_m > 0.0 && distance_m.is_finite()).then(|| normal / distance_m)
    }

    /// The hypothesis of an inverse-depth plane; `None` if the plane is behind the camera on the centre's ray or its normal
    /// points towards the camera.
    pub fn from_inverse_depth_plane(q: &Vector3<f64>, centre_ray: &Vector3<f64>) -> Option<Self> {
        let inverse_depth = q.dot(centre_ray);
        let length = q.norm();
        if !(inverse_depth > 0.0 && q.z > 0.0 && length.is_finite()) {
            return None;
        }
        let (theta_x_rad, theta_y_rad) = (trig::atan2(-q.y, q.xz().norm()), trig::atan2(q.x, q.z));
        Some(Self { z_m: 1.0 / inverse_depth, theta_x_rad, theta_y_rad })
    }

    /// Depth of the plane on the ray of a left pixel, metres; `None` where the plane is not in front of the camera.
    pub fn depth_at_pixel(&self, pair: &PinholePair, centre_px: &Vector2<f64>, pixel: &Vector2<f64>) -> Option<f64> {
        let q = self.inverse_depth_plane(&pair.left_ray(centre_px))?;
        let inverse_depth = q.dot(&pair.left_ray(pixel));
        (inverse_depth > 0.0).then(|| 1.0 / inverse_depth)
    }

    /// Projects a left pixel into the right image: inverse projection onto the plane and re-projection (eqs (4) to (7) of the
    /// paper). `None` if the point is behind a camera.
    pub fn right_pixel(
        &self,
        pair: &PinholePair,
        centre_px: &Vector2<f64>,
        pixel: &Vector2<f64>,
    ) -> Option<Vector2<f64>> {
        let depth_m = self.depth_at_pixel(pair, centre_px, pixel)?;
        let point_in_cam_left = pair.left_ray(pixel) * depth_m;
        let point_in_cam_right = pair.rotation * point_in_cam_left + pair.translation_m;
        (point_in_cam_right.z > 0.0)
            .then(|| pair.right.pixel_from_normalized(&(point_in_cam_right.xy() / point_in_cam_right.z)))
    }

    /// The same map as a homography, `H = K_R (R + t qT) K_L^-1`; `None` if the plane is not in front of the left camera at the
    /// centre.
    pub fn homography(&self, pair: &PinholePair, centre_px: &Vector2<f64>) -> Option<Matrix3<f64>> {
        Some(pair.image_right_from_image_left(&self.inverse_depth_plane(&pair.left_ray(centre_px))?))
    }
}

/// Two pinhole cameras without distortion and the rigid transform between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PinholePair {
    left: Pinhole,
    right: Pinhole,
    left_size: ImageSize,
    right_size: ImageSize,
    rotation: Matrix3<f64>,
    translation_m: Vector3<f64>,
    rectified: bool,
}

impl PinholePair {
    /// Creates the pair from a rig without lens distortion.
    ///
    /// # Errors
    /// A camera with distortion.
    pub fn from_rig(rig: &StereoRig) -> Result<Self, EstimationError> {
        for (side, camera) in [("left", rig.left()), ("right", rig.right())] {
            if !matches!(camera.distortion(), Distortion::None) {
                return Err(EstimationError::Distorted { side });
            }
        }
        let cam_right_from_cam_left = rig.cam_right_from_cam_left();
        Ok(Self {
            left: *rig.left().pinhole(),
            right: *rig.right().pinhole(),
            left_size: rig.left().size(),
            right_size: rig.right().size(),
            rotation: cam_right_from_cam_left.rotation_matrix(),
            translation_m: cam_right_from_cam_left.translation_m(),
            rectified: rig.is_rectified(),
        })
    }

    /// Pinhole of the left camera.
    pub fn left(&self) -> &Pinhole {
        &self.left
    }

    /// Pinhole of the right camera.
    pub fn right(&self) -> &Pinhole {
        &self.right
    }

    /// Size of the left image.
    pub fn left_size(&self) -> ImageSize {
        self.left_size
    }

    /// Size of the right image.
    pub fn right_size(&self) -> ImageSize {
        self.right_size
    }

    /// Rotation of `cam_right_from_cam_left`.
    pub fn rotation(&self) -> &Matrix3<f64> {
        &self.rotation
    }

    /// Translation of `cam_right_from_cam_left`, metres.
    pub fn translation_m(&self) -> &Vector3<f64> {
        &self.translation_m
    }

    /// Whether the pair is rectified: rows correspond, and columns differ by the disparity only.
    pub fn is_rectified(&self) -> bool {
        self.rectified
    }

    /// Ray of a left pixel in `cam_left`, third component 1.
    pub fn left_ray(&self, pixel: &Vector2<f64>) -> Vector3<f64> {
        let xy = self.left.normalized_from_pixel(pixel);
        Vector3::new(xy.x, xy.y, 1.0)
    }

    /// The homography of the plane `q` (inverse depth, 1/m): maps left pixels to right pixels, up to scale.
    pub fn image_right_from_image_left(&self, q: &Vector3<f64>) -> Matrix3<f64> {
        self.infinite_homography() + self.epipole() * self.pixel_plane(q).transpose()
    }

    /// `K_R R K_L^-1`: the homography of the plane at infinity.
    pub fn infinite_homography(&self) -> Matrix3<f64> {
        self.right.matrix() * self.rotation * inverse_camera_matrix(&self.left)
    }

    /// `K_R t`: the epipole in the right image (image of the left camera's centre), times its depth in metres.
    pub fn epipole(&self) -> Vector3<f64> {
        self.right.matrix() * self.translation_m
    }

    /// `K_L^-T q`: inverse depth as a linear function of homogeneous left pixels.
    pub fn pixel_plane(&self, q: &Vector3<f64>) -> Vector3<f64> {
        let (x, y) = (q.x / self.left.fx, q.y / self.left.fy);
        Vector3::new(x, y, q.z - x * self.left.cx - y * self.left.cy)
    }
}

fn inverse_camera_matrix(pinhole: &Pinhole) -> Matrix3<f64> {
    let (ix, iy) = (1.0 / pinhole.fx, 1.0 / pinhole.fy);
    Matrix3::new(ix, 0.0, -pinhole.cx * ix, 0.0, iy, -pinhole.cy * iy, 0.0, 0.0, 1.0)
}

/// Search range of the hypotheses; the chromosomes cover exactly this box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchRange {
    /// Nearest depth, metres.
    pub z_min_m: f64,
    /// Farthest depth, metres.
    pub z_max_m: f64,
    /// Largest tilt about x and about y, radians; the box is symmetric.
    pub tilt_max_rad: f64,
}

impl SearchRange {
    ranges! {
        fn check_ranges "search range ";
        z_min_m, Z_M: f64 = 1e-3..=1e3;
        tilt_max_rad, TILT_MAX_RAD: f64 = 0.0..=85f64.to_radians();
    }

    /// Least depth of a range, metres: chosen, a range of one depth has nothing to search.
    const LEAST_DEPTH_M: f64 = 1e-3;

    /// Creates a validated range.
    ///
    /// # Errors
    /// A depth that is not positive, a far limit not beyond the near limit, or a tilt outside 0 to 85 degrees.
    pub fn new(z_min_m: f64, z_max_m: f64, tilt_max_rad: f64) -> Result<Self, EstimationError> {
        let range = Self { z_min_m, z_max_m, tilt_max_rad };
        range.validate()?;
        Ok(range)
    }

    /// Allowed values of `z_max_m`.
    pub fn z_max_m_allowed(&self) -> RangeInclusive<f64> {
        let (nearest_m, farthest_m) = Self::Z_M.into_inner();
        // Of NaN and a number, `max` gives the number.
        (self.z_min_m.max(nearest_m) + Self::LEAST_DEPTH_M).min(farthest_m)..=farthest_m
    }

    /// Checks the limits, see [`SearchRange::new`].
    ///
    /// # Errors
    /// The parameter that is out of its range.
    pub fn validate(&self) -> Result<(), EstimationError> {
        self.check_ranges()?;
        Ok(ranges::check_range("search range z_max_m", self.z_max_m, self.z_max_m_allowed())?)
    }

    /// Whether a hypothesis is in the range (with a tolerance of 1e-9 for rounding).
    pub fn contains(&self, psi: &PlaneHypothesis) -> bool {
        let tilt = self.tilt_max_rad + 1e-9;
        psi.z_m >= self.z_min_m - 1e-9
            && psi.z_m <= self.z_max_m + 1e-9
            && psi.theta_x_rad.abs() <= tilt
            && psi.theta_y_rad.abs() <= tilt
    }

    /// Centre of the range, without tilt.
    pub fn centre(&self) -> PlaneHypothesis {
        PlaneHypothesis { z_m: 0.5 * (self.z_min_m + self.z_max_m), theta_x_rad: 0.0, theta_y_rad: 0.0 }
    }
}

#[cfg(test)]
#[path = "plane_hypothesis_tests.rs"]
mod tests;
