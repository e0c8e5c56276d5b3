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

    /// Largest absolute offset within an image of `width` x `height`, pixels.
    pub fn magnitude_max_px(&self, width: u32, height: u32) -> f64 {
        let (right, bottom) = (f64::from(width.saturating_sub(1)), f64::from(height.saturating_sub(1)));
        let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)];
        corners.iter().map(|&(u, v)| self.at(&Vector2::new(u, v)).abs()).fold(0.0, f64::max)
    }
}

/// A row offset measured on one pair.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RowMeasurement {
    /// The offset; zero if too few points were matched.
    pub rows: RowOffset,
    /// Number of matched points.
    pub matches: usize,
    /// Robust standard deviation of a point about the fit, pixels.
    pub spread_px: f64,
}
