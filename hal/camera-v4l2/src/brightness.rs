//! Brightness of an image: a mean of its pixels that highlights and shadows hardly change.

use image::RgbImage;

/// Every so many pixels of a row, and rows, one is read: 4800 of an image with 640x480 pixels. Chosen; at twice the distance a target of
/// 100 pixels still has 40 of them.
const STRIDE: usize = 8;

/// Share of the pixels that is left out at either end: highlights, lamps, a dark edge. Chosen; at twice the share a white sheet that
/// covers a tenth of an image may be overexposed.
const LEFT_OUT_SHARE: f64 = 0.05;

/// Luminance from which a pixel is saturated.
const SATURATED: usize = 250;

/// Brightness of one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Brightness {
    /// Mean luminance without the darkest and the brightest twentieth of the pixels, grey levels.
    pub grey: f64,
    /// Share of saturated pixels, 0 to 1.
    pub saturated_share: f64,
}

/// Measures an image; black for an image without pixels.
pub fn brightness_of(image: &RgbImage) -> Brightness {
    let mut histogram = [0_u32; 256];
    let row_bytes = 3 * image.width() as usize;
    for row in image.as_raw().chunks_exact(row_bytes.max(1)).step_by(STRIDE) {
        for pixel in row.chunks_exact(3).step_by(STRIDE) {
            let [r, g, b] = [pixel[0], pixel[1], pixel[2]].map(u32::from);
            histogram[((r * 77 + g * 150 + b * 29) >> 8) as usize] += 1;
        }
    }
    let count = f64::from(histogram.iter().sum::<u32>().max(1));
    let saturated = histogram[SATURATED..].iter().sum::<u32>();
    Brightness { grey: trimmed_mean(&histogram, count), saturated_share: f64::from(saturated) / count }
}

/// Mean of a histogram without its ends.
fn trimmed_mean(histogram: &[u32; 256], count: f64) -> f64 {
    let [from, until] = [LEFT_OUT_SHARE * count, (1.0 - LEFT_OUT_SHARE) * count];
    let (mut below, mut sum) = (0.0, 0.0);
    for (grey, pixels) in histogram.iter().enumerate() {
        let above = below + f64::from(*pixels);
        sum += grey as f64 * (above.min(until) - f64::max(below, from)).max(0.0);
        below = above;
    }
    sum / (until - from)
}

#[cfg(test)]
mod tests {
    use image::Rgb;

    use super::*;

    /// An image with this grey level, and another one in its first rows.
    fn image(grey: u8, (rows, other): (u32, u8)) -> RgbImage {
        RgbImage::from_fn(640, 480, |_, v| Rgb([if v < rows { other } else { grey }; 3]))
    }

    #[test]
    fn the_mean_ignores_a_few_highlights_and_not_many() {
        let of = |rows: (u32, u8)| brightness_of(&image(100, rows));
        assert_eq!(of((0, 0)), Brightness { grey: 100.0, saturated_share: 0.0 });
        let few = of((16, 255));
        assert!((few.grey - 100.0).abs() < 1e-9 && (few.saturated_share - 16.0 / 480.0).abs() < 1e-9, "{few:?}");
        assert!((of((16, 0)).grey - 100.0).abs() < 1e-9);
        let many = of((240, 255));
        assert!((many.grey - 177.5).abs() < 1.0 && (many.saturated_share - 0.5).abs() < 1e-9, "{many:?}");
    }

    #[test]
    fn an_image_without_pixels_is_black() {
        assert_eq!(brightness_of(&RgbImage::new(0, 0)), Brightness { grey: 0.0, saturated_share: 0.0 });
    }
}
