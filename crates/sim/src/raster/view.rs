//! One camera, prepared for rendering: the ray of every pixel.

use nalgebra::Vector2;
use pb3dp_geometry::{Camera, CameraError};

/// Rays of all pixel centres of one camera, lens distortion included.
///
/// Triangles are tested against these rays directly, so a distorted image is rendered exactly, without remapping.
#[derive(Clone, Debug)]
pub(crate) struct View {
    pub(crate) width: usize,
    pub(crate) height: usize,
    /// x of the ray `(x, y, 1)`, row-major.
    pub(crate) ray_x: Vec<f32>,
    /// y of the ray.
    pub(crate) ray_y: Vec<f32>,
    /// Pixel width and height in normalised coordinates, at the principal point.
    pub(crate) pixel_size: [f32; 2],
    /// Range of the rays of each block of a row, row-major (see [`BLOCK`]).
    blocks: Vec<RayRange>,
    columns: Bounds,
    rows: Bounds,
}

/// Pixels of a row that are tested together.
pub(crate) const BLOCK: usize = 32;

/// Smallest and largest coordinates of some rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RayRange {
    pub(crate) x: (f32, f32),
    pub(crate) y: (f32, f32),
}

/// Lookup of the columns (or rows) that can contain a normalised coordinate.
#[derive(Clone, Debug)]
struct Bounds {
    /// Largest coordinate in columns `0..=i`.
    max_so_far: Vec<f32>,
    /// Smallest coordinate in columns `i..`.
    min_from_here: Vec<f32>,
}

impl Bounds {
    fn new(lines: impl Iterator<Item = (f32, f32)>) -> Self {
        let (mut min_from_here, mut max_so_far): (Vec<f32>, Vec<f32>) = lines.unzip();
        for i in 1..max_so_far.len() {
            max_so_far[i] = max_so_far[i].max(max_so_far[i - 1]);
        }
        for i in (0..min_from_here.len().saturating_sub(1)).rev() {
            min_from_here[i] = min_from_here[i].min(min_from_here[i + 1]);
        }
        Self { max_so_far, min_from_here }
    }

    /// All lines that may contain a coordinate between `low` and `high`.
    fn lines(&self, low: f32, high: f32) -> (usize, usize) {
        let first = self.max_so_far.partition_point(|&max| max < low);
        let end = self.min_from_here.partition_point(|&min| min <= high);
        (first, end.max(first))
    }
}

/// Pixels `x.0..x.1`, `y.0..y.1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PixelBox {
    pub(crate) x: (usize, usize),
    pub(crate) y: (usize, usize),
}

impl View {
    /// Computes every ray once.
    ///
    /// # Errors
    /// A pixel of the camera has no ray.
    pub(crate) fn new(camera: &Camera) -> Result<Self, CameraError> {
        let (width, height) = (camera.size().width as usize, camera.size().height as usize);
        let (mut ray_x, mut ray_y) = (Vec::with_capacity(width * height), Vec::with_capacity(width * height));
        for row in 0..height {
            for column in 0..width {
                let ray = camera.unproject(&Vector2::new(column as f64, row as f64))?;
                ray_x.push(ray.x as f32);
                ray_y.push(ray.y as f32);
            }
        }
        let rows = Bounds::new(ray_y.chunks_exact(width).map(|row| range(row.iter())));
        let columns = Bounds::new((0..width).map(|column| range(ray_x.iter().skip(column).step_by(width))));
        let pixel_size = [(1.0 / camera.pinhole().fx) as f32, (1.0 / camera.pinhole().fy) as f32];
        let blocks = ray_x
            .chunks_exact(width)
            .zip(ray_y.chunks_exact(width))
            .flat_map(|(x, y)| x.chunks(BLOCK).zip(y.chunks(BLOCK)))
            .map(|(x, y)| RayRange { x: range(x.iter()), y: range(y.iter()) })
            .collect();
        Ok(Self { width, height, ray_x, ray_y, pixel_size, blocks, columns, rows })
    }

    /// Pixels whose rays, or any ray within their area, may lie in the given range of normalised coordinates.
    pub(crate) fn pixel_box(&self, x: (f32, f32), y: (f32, f32)) -> PixelBox {
        let [margin_x, margin_y] = self.pixel_size;
        PixelBox {
            x: self.columns.lines(x.0 - margin_x, x.1 + margin_x),
            y: self.rows.lines(y.0 - margin_y, y.1 + margin_y),
        }
    }

    /// Range of the rays of the block of a row that contains `column`.
    pub(crate) fn block(&self, column: usize, row: usize) -> &RayRange {
        &self.blocks[row * self.width.div_ceil(BLOCK) + column / BLOCK]
    }

    /// Change of the ray from one pixel to the next: `[dx/du, dx/dv, dy/du, dy/dv]`.
    pub(crate) fn ray_slopes(&self, column: usize, row: usize) -> [f32; 4] {
        let (left, right) = (column.saturating_sub(1), (column + 1).min(self.width - 1));
        let (up, down) = (row.saturating_sub(1), (row + 1).min(self.height - 1));
        let (across, along) = ((right - left).max(1) as f32, (down - up).max(1) as f32);
        let difference = |rays: &[f32], a: (usize, usize), b: (usize, usize)| {
            rays[b.1 * self.width + b.0] - rays[a.1 * self.width + a.0]
        };
        [
            difference(&self.ray_x, (left, row), (right, row)) / across,
            difference(&self.ray_x, (column, up), (column, down)) / along,
            difference(&self.ray_y, (left, row), (right, row)) / across,
            difference(&self.ray_y, (column, up), (column, down)) / along,
        ]
    }
}

fn range<'a>(values: impl Iterator<Item = &'a f32>) -> (f32, f32) {
    values.fold((f32::INFINITY, f32::NEG_INFINITY), |(min, max), &value| (min.min(value), max.max(value)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use pb3dp_geometry::{Distortion, ImageSize, Pinhole};

    #[test]
    fn boxes_hold_their_pixels() {
        let size = ImageSize { width: 64, height: 48 };
        let pinhole = Pinhole { fx: 70.0, fy: 75.0, cx: 30.5, cy: 25.0 };
        let view = View::new(&Camera::new(size, pinhole, Distortion::None).unwrap()).unwrap();
        let found = view.pixel_box(((10.2 - 30.5) / 70.0, (12.8 - 30.5) / 70.0), (-0.1, 0.2));
        assert_eq!(found.x, (10, 14));
        assert_eq!(found.y, (17, 42));
        assert_eq!(view.pixel_box((5.0, 6.0), (0.0, 0.0)).x, (64, 64));
        let slopes = view.ray_slopes(0, 47);
        assert!((slopes[0] - 1.0 / 70.0).abs() < 1e-6 && (slopes[3] - 1.0 / 75.0).abs() < 1e-6);
        assert_eq!((slopes[1], slopes[2]), (0.0, 0.0));
    }
}
