//! Pinhole cameras with lens distortion.

mod distortion;

use nalgebra::{Matrix2x3, Matrix3, Point3, Vector2, Vector3};

pub use distortion::Distortion;

/// Largest accepted image side, pixels.
pub(crate) const SIDE_MAX_PX: u32 = 32_768;
/// Range of accepted focal lengths, pixels: normalised coordinates of all pixels then have no more than seven digits.
const FOCAL_PX: std::ops::RangeInclusive<f64> = 0.01..=1e7;
/// Largest accepted distance of the principal point from the first pixel, pixels.
const PRINCIPAL_MAX_PX: f64 = 1e7;
/// Largest accepted magnitude of a distortion coefficient: the distortion of any pixel's ray is then finite.
const COEFFICIENT_MAX: f64 = 1e9;
/// Largest round-trip error of a pixel's ray projected back, pixels.
const ROUND_TRIP_PX: f64 = 1e-9;

/// Size of an image in pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ImageSize {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Intrinsics of a pinhole camera, in pixels. Integer pixel coordinates are pixel centres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pinhole {
    /// Focal length divided by the pixel width.
    pub fx: f64,
    /// Focal length divided by the pixel height.
    pub fy: f64,
    /// Column of the principal point.
    pub cx: f64,
    /// Row of the principal point.
    pub cy: f64,
}

impl Pinhole {
    /// The camera matrix K.
    #[inline]
    pub fn matrix(&self) -> Matrix3<f64> {
        Matrix3::new(self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0)
    }

    /// Pixel of the ray `(x, y, 1)`.
    #[inline]
    pub fn pixel_from_normalized(&self, xy: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(self.fx * xy.x + self.cx, self.fy * xy.y + self.cy)
    }

    /// `(x, y)` of the ray `(x, y, 1)` through a pixel.
    #[inline]
    pub fn normalized_from_pixel(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy)
    }
}

/// A camera model: image size, pinhole, distortion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    size: ImageSize,
    pinhole: Pinhole,
    distortion: Distortion,
    /// Largest undistorted radius that the lens images; see `Distortion::fold_radius`.
    fold_radius: f64,
}

/// Why a camera was rejected or a pixel has no ray.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// A parameter is not finite or out of its range.
    #[error("camera parameter {name} is {value}: {expected}")]
    Parameter {
        /// Name of the parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The allowed range.
        expected: &'static str,
    },
    /// The pixel has no ray: the distortion cannot be inverted there ([`Camera::unproject`]).
    #[error(
        "pixel ({u}, {v}) has no ray: the distortion model cannot be inverted there; use a region nearer to the image's centre, or calibrate with targets that reach this part of the image"
    )]
    NotInvertible {
        /// Column.
        u: f64,
        /// Row.
        v: f64,
    },
}

impl Camera {
    /// Creates a camera from its parts.
    ///
    /// # Errors
    /// A parameter that is not finite or absurdly large, a focal length below 0.01 pixels, an image that is empty or has a side
    /// above 32768 pixels.
    pub fn new(size: ImageSize, pinhole: Pinhole, distortion: Distortion) -> Result<Self, CameraError> {
        for (name, side) in [("width", size.width), ("height", size.height)] {
            if side == 0 || side > SIDE_MAX_PX {
                let expected = "must be between 1 and 32768 pixels";
                return Err(CameraError::Parameter { name, value: f64::from(side), expected });
            }
        }
        for (name, value) in [("fx", pinhole.fx), ("fy", pinhole.fy)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(CameraError::Parameter { name, value, expected: "must be positive" });
            }
            if !FOCAL_PX.contains(&value) {
                let expected = "must be between 0.01 and 10000000 pixels";
                return Err(CameraError::Parameter { name, value, expected });
            }
        }
        for (name, value) in [("cx", pinhole.cx), ("cy", pinhole.cy)] {
            if value.abs() > PRINCIPAL_MAX_PX {
                let expected = "must be within 10000000 pixels of the image's first pixel";
                return Err(CameraError::Parameter { name, value, expected });
            }
        }
        for (name, value) in distortion.named_coefficients() {
            if value.abs() > COEFFICIENT_MAX {
                let expected = "must be finite and between -1000000000 and 1000000000";
                return Err(CameraError::Parameter { name, value, expected });
            }
        }
        let finite = [("cx", pinhole.cx), ("cy", pinhole.cy)].into_iter().chain(distortion.named_coefficients());
        for (name, value) in finite {
            if !value.is_finite() {
                return Err(CameraError::Parameter { name, value, expected: "must be finite" });
            }
        }
        Ok(Self { size, pinhole, distortion, fold_radius: distortion.fold_radius() })
    }

    /// Image size.
    #[inline]
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// The pinhole part.
    #[inline]
    pub fn pinhole(&self) -> &Pinhole {
        &self.pinhole
    }

    /// The distortion part.
    #[inline]
    pub fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// The ideal camera with the same image size and pinhole: the destination of [`crate::maps::RemapTable::undistort`].
    pub fn undistorted(&self) -> Self {
        Self { distortion: Distortion::None, fold_radius: f64::INFINITY, ..*self }
    }

    /// The camera of smaller images: each pixel is the mean of a square of `scale` x `scale` pixels; incomplete squares at the edges are
    /// left out, so the image may be empty.
    pub(crate) fn reduced(&self, scale: u32) -> Self {
        let (scale, Pinhole { fx, fy, cx, cy }) = (scale.max(1), self.pinhole);
        let size = ImageSize { width: self.size.width / scale, height: self.size.height / scale };
        let s = f64::from(scale);
        // Pixel centres have integer coordinates.
        let pinhole = Pinhole { fx: fx / s, fy: fy / s, cx: (cx + 0.5) / s - 0.5, cy: (cy + 0.5) / s - 0.5 };
        Self { size, pinhole, ..*self }
    }

    /// Projects a point in this camera's frame (metres) to a pixel, which may be outside the image.
    ///
    /// `None` if the point is not in front of the camera, has no finite pixel, or is too far from the axis: there the distortion model
    /// folds back, and would place the point among visible ones.
    #[inline]
    pub fn project(&self, point_in_cam: &Point3<f64>) -> Option<Vector2<f64>> {
        let xy = self.visible_normalized(point_in_cam)?;
        finite(self.pinhole.pixel_from_normalized(&self.distort(&xy)))
    }

    /// [`Self::project`] and the derivative of the pixel with respect to the point, pixels per metre.
    #[inline]
    pub fn project_with_jacobian(&self, point_in_cam: &Point3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let xy = self.visible_normalized(point_in_cam)?;
        let (distorted, by_xy) = self.distortion.distort_with_jacobian(&xy);
        let xy_by_point = Matrix2x3::new(1.0, 0.0, -xy.x, 0.0, 1.0, -xy.y) / point_in_cam.z;
        let mut jacobian = by_xy * xy_by_point;
        jacobian.row_mut(0).scale_mut(self.pinhole.fx);
        jacobian.row_mut(1).scale_mut(self.pinhole.fy);
        Some((finite(self.pinhole.pixel_from_normalized(&distorted))?, jacobian))
    }

    /// The ray `(x, y, 1)` through a pixel, in this camera's frame; it projects back within 1e-9 pixels.
    ///
    /// # Errors
    /// If the distortion cannot be inverted at that pixel: the pixel is outside the valid area of the lens model, 90 degrees or
    /// more from the axis, or not finite.
    pub fn unproject(&self, pixel: &Vector2<f64>) -> Result<Vector3<f64>, CameraError> {
        let distorted = self.pinhole.normalized_from_pixel(pixel);
        let tolerance = ROUND_TRIP_PX / self.pinhole.fx.max(self.pinhole.fy);
        match self.distortion.undistort(&distorted, self.fold_radius, tolerance) {
            Some(xy) => Ok(Vector3::new(xy.x, xy.y, 1.0)),
            None => Err(CameraError::NotInvertible { u: pixel.x, v: pixel.y }),
        }
    }

    /// Distorts undistorted normalised coordinates.
    #[inline]
    pub fn distort(&self, xy: &Vector2<f64>) -> Vector2<f64> {
        self.distortion.distort(xy)
    }

    /// `(x / z, y / z)` of a point that the model images exactly once.
    #[inline]
    fn visible_normalized(&self, point_in_cam: &Point3<f64>) -> Option<Vector2<f64>> {
        if point_in_cam.z <= 0.0 {
            return None;
        }
        let xy = Vector2::new(point_in_cam.x / point_in_cam.z, point_in_cam.y / point_in_cam.z);
        (xy.norm_squared() <= self.fold_radius * self.fold_radius).then_some(xy)
    }
}

/// A pixel that is a number.
#[inline]
fn finite(pixel: Vector2<f64>) -> Option<Vector2<f64>> {
    (pixel.x.is_finite() && pixel.y.is_finite()).then_some(pixel)
}
