//! One channel of a part of an image, single precision.

use std::ops::Range;

use nalgebra::Vector2;

/// A window of whole pixels with any origin, also outside the image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelWindow {
    /// First column.
    pub x: i32,
    /// First row.
    pub y: i32,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

impl PixelWindow {
    /// The part of the window inside an image of `width` x `height`; may be empty.
    pub fn clipped(&self, width: u32, height: u32) -> Self {
        let clip = |start: i32, length: usize, limit: u32| {
            let end = (i64::from(start) + length as i64).clamp(0, i64::from(limit));
            let start = i64::from(start).clamp(0, i64::from(limit));
            (start as i32, (end - start).max(0) as usize)
        };
        let ((x, width), (y, height)) = (clip(self.x, self.width, width), clip(self.y, self.height, height));
        Self { x, y, width, height }
    }

    /// The columns of a window inside an image.
    #[inline]
    pub fn columns(&self) -> Range<usize> {
        self.x as usize..self.x as usize + self.width
    }

    /// The rows of a window inside an image.
    #[inline]
    pub fn rows(&self) -> Range<usize> {
        self.y as usize..self.y as usize + self.height
    }

    /// The window on a grid with pixels of twice the size; its start must be even.
    pub fn halved(&self) -> Self {
        Self { x: self.x / 2, y: self.y / 2, width: self.width / 2, height: self.height / 2 }
    }

    /// The window on a grid with pixels of `scale` times the size; its start must be on that grid.
    pub fn reduced(&self, scale: usize) -> Self {
        let start = |start: i32| start / scale as i32;
        Self { x: start(self.x), y: start(self.y), width: self.width / scale, height: self.height / scale }
    }

    /// The window with `margin` more pixels on every side.
    pub fn grown(&self, margin: u32) -> Self {
        Self {
            x: self.x.saturating_sub(margin as i32),
            y: self.y.saturating_sub(margin as i32),
            width: self.width + 2 * margin as usize,
            height: self.height + 2 * margin as usize,
        }
    }
}

/// A rectangle of single-precision values, row-major, without padding. Integer coordinates are pixel centres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ImagePlane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl ImagePlane {
    /// A plane of zeros.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, values: vec![0.0; width * height] }
    }

    /// Creates a plane from `value(x, y)`.
    pub fn from_fn(width: usize, height: usize, mut value: impl FnMut(usize, usize) -> f32) -> Self {
        let values = (0..width * height).map(|i| value(i % width, i / width)).collect();
        Self { width, height, values }
    }

    /// Sets a new size; the contents are undefined afterwards. Allocates only if the plane was never as large.
    pub fn resize(&mut self, width: usize, height: usize) {
        (self.width, self.height) = (width, height);
        self.values.resize(width * height, 0.0);
    }

    /// Columns.
    #[inline]
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    #[inline]
    pub fn height(&self) -> usize {
        self.height
    }

    /// All values, row by row.
    #[inline]
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// All values, row by row.
    #[inline]
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }

    /// A row.
    #[inline]
    pub fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.width..(y + 1) * self.width]
    }

    /// A row.
    #[inline]
    pub fn row_mut(&mut self, y: usize) -> &mut [f32] {
        &mut self.values[y * self.width..(y + 1) * self.width]
    }

    /// Bilinear value; `None` outside the centres of the outermost pixels. For tests and rare use: kernels interpolate
    /// themselves.
    pub fn sample(&self, at: &Vector2<f64>) -> Option<f64> {
        let inside = |c: f64, length: usize| c >= 0.0 && length >= 2 && c <= (length - 1) as f64;
        if !inside(at.x, self.width) || !inside(at.y, self.height) {
            return None;
        }
        let (x, y) = ((at.x as usize).min(self.width - 2), (at.y as usize).min(self.height - 2));
        let (a, b) = (at.x - x as f64, at.y - y as f64);
        let (upper, lower) = (&self.row(y)[x..x + 2], &self.row(y + 1)[x..x + 2]);
        let mix = |row: &[f32]| f64::from(row[0]) * (1.0 - a) + f64::from(row[1]) * a;
        Some(mix(upper) * (1.0 - b) + mix(lower) * b)
    }

    /// Writes the plane at half the size into `out`: means of 2 x 2 pixels; an odd last column or row is dropped. Pixel `(x,
    /// y)` of the half-size plane has its centre at `(2 x + 0.5, 2 y + 0.5)` of this one.
    pub fn halve_into(&self, out: &mut Self) {
        out.resize(self.width / 2, self.height / 2);
        for y in 0..out.height {
            let (upper, lower) = (self.row(2 * y), self.row(2 * y + 1));
            let pairs = upper.chunks_exact(2).zip(lower.chunks_exact(2));
            for (out, (upper, lower)) in out.row_mut(y).iter_mut().zip(pairs) {
                *out = 0.25 * ((upper[0] + upper[1]) + (lower[0] + lower[1]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_are_clipped_and_grown() {
        let window = PixelWindow { x: -3, y: 5, width: 10, height: 4 };
        assert_eq!(window.clipped(5, 7), PixelWindow { x: 0, y: 5, width: 5, height: 2 });
        assert_eq!(window.grown(2), PixelWindow { x: -5, y: 3, width: 14, height: 8 });
        assert_eq!(PixelWindow { x: 9, y: 9, width: 3, height: 3 }.clipped(4, 4).width, 0);
    }

    #[test]
    fn halves_keep_a_ramp_where_it_was() {
        let ramp = |x: f64, y: f64| 3.0 * x - 2.0 * y + 7.0;
        let plane = ImagePlane::from_fn(9, 7, |x, y| ramp(x as f64, y as f64) as f32);
        let mut half = ImagePlane::default();
        plane.halve_into(&mut half);
        assert_eq!((half.width(), half.height()), (4, 3));
        assert_eq!(f64::from(half.row(2)[3]), ramp(6.5, 4.5));
        let at = Vector2::new(4.3, 5.9);
        assert!((plane.sample(&at).unwrap() - ramp(at.x, at.y)).abs() < 1e-5);
        assert_eq!(plane.sample(&Vector2::new(8.01, 3.0)), None);
        assert!(plane.sample(&Vector2::new(8.0, 6.0)).is_some());
    }
}
