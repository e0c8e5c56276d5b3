//! Vertical misalignment between the rows of the right and the left rectified image.

use nalgebra::Vector2;

/// Affine row offset of a rectified pair: a point on row `v` of the left image appears in the right image, at the right pixel
/// `(u, w)`, on row `w = v + offset(u, w)`.
///
/// With a perfect calibration the offset is zero. Coordinates are pixels of the right image of `StereoRig::rectify`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RowOffset {
    /// Reference pixel of `offset_px`.
    pub centre_px: Vector2<f64>,
    /// Offset at `centre_px`, pixels; positive if the right image is lower.
    pub offset_px: f64,
    /// Gradient along columns and rows, pixels per pixel.
    pub slope: Vector2<f64>,
}

impl RowOffset {
    /// Offset at a pixel of the right image, pixels.
    pub fn at(&self, right_px: &Vector2<f64>) -> f64 {
        self.offset_px + self.slope.dot(&(right_px - self.centre_px))
    }

    /// The same offset for a reduced image, in which one pixel is `scale` full-size pixels wide.
    pub fn at_scale(&self, scale: f64) -> Self {
        let centre_px = (self.centre_px.add_scalar(0.5) / scale).add_scalar(-0.5);
        Self { centre_px, offset_px: self.offset_px / scale, slope: self.slope }
    }

    /// Whether the offset is zero everywhere.
    pub fn is_zero(&self) -> bool {
        self.offset_px == 0.0 && self.slope == Vector2::zeros()
    }
}
