//! Image motion between two consecutive images.
//!
//! Each of 3 x 3 blocks gets the shift that best explains the change of luminance by least squares over its pixels (one step of Lucas and
//! Kanade, 1981, on the whole block). For shifts below one pixel its error is some thousandths of a pixel where there is texture. Without
//! texture, noise produces a small number, not a large one.

use image::RgbImage;
use nalgebra::{Matrix2, Vector2};

/// Blocks along each side: some of them show rotations and single moving parts.
const BLOCKS: u32 = 3;

/// The largest shift of a block, pixels; infinite for images of unequal size.
pub fn shift_px(before: &RgbImage, after: &RgbImage) -> f64 {
    if before.dimensions() != after.dimensions() {
        return f64::INFINITY;
    }
    let (width, height) = before.dimensions();
    let blocks = (0..BLOCKS).flat_map(|row| (0..BLOCKS).map(move |column| (column, row)));
    let shift = |(column, row): (u32, u32)| {
        let range =
            |at: u32, size: u32| (at * size / BLOCKS).max(1)..((at + 1) * size / BLOCKS).min(size.saturating_sub(1));
        block_shift_px(before, after, range(column, width), range(row, height))
    };
    blocks.map(shift).fold(0.0, f64::max)
}

fn block_shift_px(
    before: &RgbImage,
    after: &RgbImage,
    columns: std::ops::Range<u32>,
    rows: std::ops::Range<u32>,
) -> f64 {
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for y in rows {
        for x in columns.clone() {
            // Both images share the gradient; it is evaluated midway between them.
            let mean = |x: u32, y: u32| 0.5 * (grey(before, x, y) + grey(after, x, y));
            let gradient = Vector2::new(mean(x + 1, y) - mean(x - 1, y), mean(x, y + 1) - mean(x, y - 1)) * 0.5;
            normal += gradient * gradient.transpose();
            right -= gradient * (grey(after, x, y) - grey(before, x, y));
        }
    }
    normal.try_inverse().map_or(0.0, |inverse| (inverse * right).norm())
}

/// Green: the channel with the largest weight in luminance, and the only information of a monochrome camera.
fn grey(image: &RgbImage, x: u32, y: u32) -> f64 {
    f64::from(image.get_pixel(x, y).0[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pattern with texture in all blocks, shifted by this vector, with noise of one or two grey levels.
    fn image([dx, dy]: [f64; 2], noise: u32) -> RgbImage {
        RgbImage::from_fn(160, 120, |x, y| {
            let (u, v) = (f64::from(x) - dx, f64::from(y) - dy);
            let hash = (x.wrapping_mul(73_856_093) ^ y.wrapping_mul(19_349_663) ^ noise.wrapping_mul(83_492_791)) >> 7;
            let grain = f64::from(hash % 5) - 2.0;
            let value = 120.0 + 50.0 * (u * 0.31).sin() * (v * 0.27).cos() + 20.0 * (u * 0.11 + v * 0.17).sin() + grain;
            image::Rgb([0, value.round() as u8, 0])
        })
    }

    #[test]
    fn shifts_are_measured_to_a_hundredth_of_a_pixel() {
        let rest = image([0.0; 2], 1);
        for (moved, expected) in [([0.0; 2], 0.0), ([0.05, 0.0], 0.05), ([0.03, -0.04], 0.05), ([0.0, 0.5], 0.5)] {
            let found = shift_px(&rest, &image(moved, 2));
            assert!((found - expected).abs() < 0.02, "{moved:?}: {found}");
        }
    }

    #[test]
    fn one_part_that_moves_is_enough_and_an_image_without_texture_rests() {
        let mut corner = image([0.0; 2], 1);
        let moved = image([0.4, 0.0], 1);
        for (x, y, pixel) in moved.enumerate_pixels().filter(|(x, y, _)| *x < 53 && *y < 40) {
            corner.put_pixel(x, y, *pixel);
        }
        let found = shift_px(&image([0.0; 2], 2), &corner);
        assert!((0.3..0.5).contains(&found), "{found}");
        let plain = RgbImage::from_pixel(160, 120, image::Rgb([90; 3]));
        assert_eq!(shift_px(&plain, &plain), 0.0);
        assert_eq!(shift_px(&plain, &RgbImage::new(8, 8)), f64::INFINITY);
    }
}
