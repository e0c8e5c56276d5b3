//! Errors of a calibrated rig that show as differences between the rows of the rectified pair.
//!
//! With a perfect calibration a point is on the same row of both rectified images. Small errors of the calibration move it to another row
//! of the right image. To first order, in tangents of angles, at the right ray `(x, y, 1)` and with the disparity `delta`, the offset is
//!
//! `offset - pitch (1 + y^2) + roll x + scale y - baseline delta`
//!
//! (the right camera's rotation by small angles about x and z, a ratio of the focal lengths, with `x` and `y` from the optical axes then, a
//! turn of the baseline about the viewing direction). Each of them moves columns as well, and so depth and tilt:
//! `-pitch x y - roll y + scale x`. A yaw of one camera, the length of the baseline, and an error of both focal lengths move hardly any row, and
//! cannot be found so.

use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};
use pb3dp_geometry::frames::{CamLeft, CamLeftRect, CamRight, CamRightRect};
use pb3dp_geometry::{Camera, Pinhole, Pose, Rectification, StereoRig, so3};

/// Number of the errors.
pub const ERRORS: usize = 5;
/// Index of the offset of all rows, in tangents.
pub const OFFSET: usize = 0;
/// Index of the right camera's rotation about its x axis, radians.
pub const PITCH: usize = 1;
/// Index of the right camera's rotation about its z axis, radians.
pub const ROLL: usize = 2;
/// Index of the right focal length relative to the left one, minus 1.
pub const SCALE: usize = 3;
/// Index of the baseline's turn about the viewing direction, radians.
pub const BASELINE: usize = 4;

/// The errors in the order of the indices.
pub type ErrorVector = SVector<f64, ERRORS>;
/// Their covariance.
pub type ErrorCovariance = SMatrix<f64, ERRORS, ERRORS>;

/// Standard deviations before any image, of a rig that was calibrated with care. Chosen with figures: of 60 public rigs half are within one
/// and nearly all within two of them.
pub const CALIBRATED_SIGMAS: [f64; ERRORS] = [4e-4, 4e-4, 3e-4, 4e-4, 5e-4];
/// The same of a rig that was knocked, or whose calibration belongs to another one. Chosen by hand, not varied: wide enough not to matter
/// beside 30 points, and small enough to decide where a single plane cannot.
pub const MOVED_SIGMAS: [f64; ERRORS] = [2e-3, 2e-3, 3.5e-3, 3e-3, 3.5e-3];
/// The same of a rig between both.
const SHIFTED_SIGMAS: [f64; ERRORS] = [1e-3, 1e-3, 1e-3, 1.2e-3, 1.5e-3];
/// Kinds of rigs, with their probabilities before any image. Chosen by hand, not varied.
const KINDS: [(f64, [f64; ERRORS]); 3] = [(0.7, CALIBRATED_SIGMAS), (0.2, SHIFTED_SIGMAS), (0.1, MOVED_SIGMAS)];

/// Probability of [`RigErrors::believed`] from which a rig has moved. Chosen by hand, not varied.
pub const MOVED_FROM: f64 = 0.9;

/// Errors of a rig, measured on the rows of one or more pairs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigErrors {
    /// What the rig really is, minus what the calibration states.
    pub errors: ErrorVector,
    /// Covariance of `errors`. Of a measurement that found nothing it is that of [`MOVED_SIGMAS`].
    pub covariance: ErrorCovariance,
    /// Number of points that were found in both images and agree with each other.
    pub matches: usize,
    /// Robust standard deviation of the row of all points that were found, about the fit, pixels.
    pub spread_px: f64,
    /// Optical axes of the raw left and right camera in the rectified frame, tangents: a wrong focal length moves points away from them.
    pub axes: [Vector2<f64>; 2],
}

impl Default for RigErrors {
    /// Nothing measured.
    fn default() -> Self {
        let (errors, covariance) = (ErrorVector::zeros(), diagonal(&MOVED_SIGMAS));
        Self { errors, covariance, matches: 0, spread_px: 0.0, axes: [Vector2::zeros(); 2] }
    }
}

impl RigErrors {
    /// What is to be believed of a rig that no image has shown: that it was calibrated with care, or has shifted a little. Whether it has moved, no
    /// standard deviation can say.
    #[must_use]
    pub fn unseen(&self) -> Self {
        let [(calibrated, sigmas), (shifted, shifted_sigmas), _] = KINDS;
        let share = shifted / (calibrated + shifted);
        let covariance = diagonal(&sigmas) * (1.0 - share) + diagonal(&shifted_sigmas) * share;
        Self { errors: ErrorVector::zeros(), covariance, ..*self }
    }

    /// Nothing measured yet of a rig with this rectification.
    pub fn of_rig(rectification: &Rectification) -> Self {
        let Rectification { cam_left_rect_from_cam_left, cam_right_rect_from_cam_right, .. } = rectification;
        let axes = [
            cam_left_rect_from_cam_left.transform_vector(&Vector3::z()),
            cam_right_rect_from_cam_right.transform_vector(&Vector3::z()),
        ];
        Self { axes: axes.map(|axis| axis.xy() / axis.z), ..Self::default() }
    }

    /// Derivative of the row offset (right row minus left row, tangents) with respect to the errors, at a right ray with third component 1
    /// and a disparity (tangents: baseline over depth).
    pub fn row_derivative(&self, ray: &Vector2<f64>, disparity: f64) -> ErrorVector {
        ErrorVector::from([1.0, -(1.0 + ray.y * ray.y), ray.x, ray.y - self.middle_axis().y, -disparity])
    }

    fn middle_axis(&self) -> Vector2<f64> {
        0.5 * (self.axes[0] + self.axes[1])
    }

    /// The row offset at a right ray with third component 1 and a disparity, and its standard deviation; tangents.
    pub fn row_offset(&self, ray: &Vector2<f64>, disparity: f64) -> (f64, f64) {
        let by = self.row_derivative(ray, disparity);
        (by.dot(&self.errors), (by.transpose() * self.covariance * by).x.max(0.0).sqrt())
    }

    /// Derivative of the row offset along columns and rows at a right ray with third component 1.
    pub fn row_slope(&self, ray: &Vector2<f64>) -> [f64; 2] {
        [self.errors[ROLL], self.errors[SCALE] - 2.0 * ray.y * self.errors[PITCH]]
    }

    /// Squared distance from a rig that was calibrated with care, in standard deviations.
    pub fn significance(&self) -> f64 {
        let expected = (self.covariance + diagonal(&CALIBRATED_SIGMAS)).cholesky();
        expected.map_or(0.0, |expected| self.errors.dot(&expected.solve(&self.errors)))
    }

    /// What is to be believed after this measurement, and the probability that the rig has moved. A rig was calibrated with care, or it has
    /// moved, by little or by much (`KINDS`); each kind explains the measurement with its own errors, and the answer is their mixture.
    pub fn believed(&self) -> (Self, f64) {
        self.mixture().unwrap_or((*self, 0.0))
    }

    fn mixture(&self) -> Option<(Self, f64)> {
        let known = self.covariance.cholesky()?.inverse();
        let (pull, data) = (known * self.errors, known - diagonal(&MOVED_SIGMAS).cholesky()?.inverse());
        // Errors, their covariance, and the logarithm of the evidence.
        let explained = KINDS.map(|(probability, sigmas)| {
            let prior = diagonal(&sigmas);
            let information = (data + prior.cholesky()?.inverse()).cholesky()?;
            let errors = information.solve(&pull);
            let volume = information.determinant().ln() + prior.determinant().ln();
            Some((errors, information.inverse(), probability.ln() + 0.5 * (pull.dot(&errors) - volume)))
        });
        let [Some(calibrated), Some(shifted), Some(moved)] = explained else { return None };
        let all = [calibrated, shifted, moved];
        let best = all.iter().fold(f64::NEG_INFINITY, |best, (.., evidence)| best.max(*evidence));
        let weights = all.map(|(.., evidence)| (evidence - best).exp());
        let sum: f64 = weights.iter().sum();
        let parts =
            || all.iter().zip(weights).map(|((errors, covariance, _), weight)| (errors, covariance, weight / sum));
        let errors: ErrorVector = parts().map(|(errors, _, share)| errors * share).sum();
        let spread = |(own, covariance, share): (&ErrorVector, &ErrorCovariance, f64)| {
            let apart = own - errors;
            (covariance + apart * apart.transpose()) * share
        };
        Some((Self { errors, covariance: parts().map(spread).sum(), ..*self }, 1.0 - weights[0] / sum))
    }

    /// The rig with these errors corrected, for methods that follow any rig. Which camera has the wrong focal length, no row shows: each gets half of the correction.
    /// `rectification`: that of `rig`. `None` if the corrected rig is not a possible one.
    pub fn corrected(&self, rig: &StereoRig, rectification: &Rectification) -> Option<StereoRig> {
        let e = &self.errors;
        let Rectification { cam_left_rect_from_cam_left, cam_right_rect_from_cam_right, .. } = rectification;
        let baseline = so3::exp(&Vector3::new(0.0, 0.0, e[BASELINE])) * Vector3::new(-rig.baseline_m(), 0.0, 0.0);
        let turn = so3::exp(&Vector3::new(e[PITCH], 0.0, e[ROLL]));
        let right_from_left: Pose<CamRightRect, CamLeftRect> = Pose::from_parts(turn * baseline, turn);
        let right_rect_from_left = right_from_left * *cam_left_rect_from_cam_left;
        let cam_right_from_cam_left: Pose<CamRight, CamLeft> =
            cam_right_rect_from_cam_right.inverse() * right_rect_from_left;
        // The direction of the rectified rows in the raw right image.
        let down = cam_right_rect_from_cam_right.inverse().transform_vector(&Vector3::y());
        let focal = |camera: &Camera, ratio: f64, shift: Vector2<f64>| {
            let Pinhole { fx, fy, cx, cy } = *camera.pinhole();
            let pinhole = Pinhole { fx: fx * ratio, fy: fy * ratio, cx: cx + fx * shift.x, cy: cy + fy * shift.y };
            Camera::new(camera.size(), pinhole, *camera.distortion()).ok()
        };
        let left = focal(rig.left(), 1.0 - 0.5 * e[SCALE], Vector2::zeros())?;
        let right = focal(rig.right(), 1.0 + 0.5 * e[SCALE], down.xy() * e[OFFSET])?;
        StereoRig::new(left, right, cam_right_from_cam_left).ok()
    }

    /// What the errors do to a disparity plane `(d0, du, dv)` of the rectified pair, pixels and pixels per pixel; to be subtracted.
    pub fn of_plane(&self, at: &PlanePlace) -> Vector3<f64> {
        at.derivative(&self.middle_axis()) * self.errors
    }

    /// What their uncertainty does to it: covariance. The focal length that is common to both cameras is uncertain by half of the ratio's
    /// correction.
    pub fn plane_covariance(&self, at: &PlanePlace) -> Matrix3<f64> {
        let by = at.derivative(&self.middle_axis());
        let from_axes = at.disparity - (self.axes[0].x - self.axes[1].x);
        let common = Vector3::new(at.focal_px.x * from_axes * 0.5 * self.errors[SCALE], 0.0, 0.0);
        by * self.covariance * by.transpose() + common * common.transpose()
    }
}

/// Where a disparity plane is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanePlace {
    /// Left rectified ray of its centre, third component 1.
    pub ray: Vector2<f64>,
    /// Its disparity there, tangents: baseline over depth.
    pub disparity: f64,
    /// Focal lengths of the rectified pair, pixels.
    pub focal_px: Vector2<f64>,
}

impl PlanePlace {
    /// Right rectified ray of the centre, third component 1.
    pub fn right_ray(&self) -> Vector2<f64> {
        self.ray - Vector2::new(self.disparity, 0.0)
    }

    /// Derivative of `(d0, du, dv)` with respect to the errors. `axis`: the optical axis midway between both cameras.
    fn derivative(&self, axis: &Vector2<f64>) -> SMatrix<f64, 3, ERRORS> {
        let ([fx, fy], [x, y], right_x) =
            ([self.focal_px.x, self.focal_px.y], [self.ray.x, self.ray.y], self.right_ray().x);
        let mut by = SMatrix::<f64, 3, ERRORS>::zeros();
        by.set_column(PITCH, &Vector3::new(fx * right_x * y, y, right_x * fx / fy));
        by.set_column(ROLL, &Vector3::new(fx * y, 0.0, fx / fy));
        by.set_column(SCALE, &-Vector3::new(fx * (x - 0.5 * self.disparity - axis.x), 1.0, 0.0));
        by
    }
}

fn diagonal(sigmas: &[f64; ERRORS]) -> ErrorCovariance {
    ErrorCovariance::from_diagonal(&ErrorVector::from(*sigmas).map(|sigma| sigma * sigma))
}
