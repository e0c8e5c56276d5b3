//! How far the rows of the right rectified image are off those of the left one.

use nalgebra::Vector2;

/// Affine row offset of a rectified pair: what the left image shows on row `v` stands in the right image, at the right
/// pixel `(u, w)`, on row `w = v + offset(u, w)`.
///
/// A perfect calibration gives zero. Coordinates are rectified pixels of the full right image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RowOffset {
    /// Where `offset_px` holds.
    pub centre_px: Vector2<f64>,
    /// Offset at the centre, pixels; positive: the right image is lower.
    pub offset_px: f64,
    /// Change along columns and rows, pixel per pixel.
    pub slope: Vector2<f64>,
}

impl RowOffset {
    /// Offset at a right pixel, pixels.
    pub fn at(&self, right_px: &Vector2<f64>) -> f64 {
        self.offset_px + self.slope.dot(&(right_px - self.centre_px))
    }

    /// The offset in pixels of an image whose pixels are `scale` full ones wide.
    pub fn at_scale(&self, scale: f64) -> Self {
        let centre_px = (self.centre_px.add_scalar(0.5) / scale).add_scalar(-0.5);
        Self { centre_px, offset_px: self.offset_px / scale, slope: self.slope }
    }

    /// Whether there is nothing to correct.
    pub fn is_zero(&self) -> bool {
        self.offset_px == 0.0 && self.slope == Vector2::zeros()
    }

    /// Largest magnitude within an image of `width` x `height`, pixels.
    pub fn magnitude_max_px(&self, width: u32, height: u32) -> f64 {
        let (right, bottom) = (f64::from(width.saturating_sub(1)), f64::from(height.saturating_sub(1)));
        let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)];
        corners.iter().map(|&(u, v)| self.at(&Vector2::new(u, v)).abs()).fold(0.0, f64::max)
    }
}

/// A row offset as it was measured on one pair.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RowMeasurement {
    /// The offset; zero if too few points were found again.
    pub rows: RowOffset,
    /// Points found again.
    pub matches: usize,
    /// Standard deviation (robust) of a point around the fit, pixels.
    pub spread_px: f64,
}
