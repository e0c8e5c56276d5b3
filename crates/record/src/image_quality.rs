//! Image quality: brightness and sharpness, and differences between the cameras of a stereo rig.

use image::RgbImage;

/// Grey level from which a pixel is overexposed; [`DARK`] is the level up to which it is underexposed.
pub const BRIGHT: u8 = 254;
/// See [`BRIGHT`].
pub const DARK: u8 = 4;

/// Minimum height of an edge used for the blur measurement, grey levels.
pub const EDGE_MIN_GREY: f64 = 40.0;
/// Minimum number of edges.
pub const EDGES_MIN: usize = 200;
/// Share of the sharpest edges used; other edges may be soft in the scene.
const SHARPEST_SHARE: f64 = 0.25;

/// Brightness of the images of one camera.
#[derive(Clone, Copy, Debug)]
pub struct Exposure {
    /// Share of the pixels with at least one saturated channel, percent.
    pub bright_percent: f64,
    /// Share of the pixels with all channels black, percent.
    pub dark_percent: f64,
    /// Mean luminance, grey levels.
    pub mean_grey: f64,
    /// 5, 50 and 95 % quantiles of the luminance, grey levels.
    pub quantiles_grey: [usize; 3],
}

impl Exposure {
    /// Exposure of all given images together.
    pub fn of(images: &[&RgbImage]) -> Self {
        let mut histogram = [0_u64; 256];
        let (mut bright, mut dark, mut sum) = (0_u64, 0_u64, 0_u64);
        for pixel in images.iter().flat_map(|image| image.pixels()) {
            let [r, g, b] = pixel.0;
            // One saturated channel loses the colour; all channels at zero lose everything.
            bright += u64::from(r.max(g).max(b) >= BRIGHT);
            dark += u64::from(r.max(g).max(b) <= DARK);
            let grey = luminance(pixel.0);
            histogram[grey as usize] += 1;
            sum += u64::from(grey);
        }
        let count = histogram.iter().sum::<u64>().max(1);
        let quantile = |share: f64| {
            let mut below = 0;
            histogram.iter().position(|pixels| {
                below += pixels;
                below as f64 >= share * count as f64
            })
        };
        let percent = |pixels: u64| pixels as f64 / count as f64 * 100.0;
        Self {
            bright_percent: percent(bright),
            dark_percent: percent(dark),
            mean_grey: sum as f64 / count as f64,
            quantiles_grey: [0.05, 0.5, 0.95].map(|share| quantile(share).unwrap_or_default()),
        }
    }
}

fn luminance([r, g, b]: [u8; 3]) -> u8 {
    ((u32::from(r) * 77 + u32::from(g) * 150 + u32::from(b) * 29) >> 8) as u8
}

/// Blur of the sharpest edges of the images, standard deviation in pixels; `None` if there are too few edges.
///
/// An edge of height A blurred by a Gaussian of standard deviation s has the steepest slope A / (s sqrt(2 pi)), which gives s.
/// The height is the monotonic change of luminance along a row.
pub fn blur_of(images: &[&RgbImage]) -> Option<f64> {
    let mut blurs = Vec::new();
    let mut row = Vec::new();
    for image in images {
        let width = image.width() as usize;
        for pixels in image.as_raw().chunks_exact((3 * width).max(1)) {
            row.clear();
            row.extend(pixels.chunks_exact(3).map(|rgb| f64::from(luminance([rgb[0], rgb[1], rgb[2]]))));
            edges(&row, &mut blurs);
        }
    }
    if blurs.len() < EDGES_MIN {
        return None;
    }
    let at = (blurs.len() as f64 * SHARPEST_SHARE / 2.0) as usize;
    // Median of the sharpest quarter.
    Some(*blurs.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// Blurs of all edges along a row.
fn edges(row: &[f64], blurs: &mut Vec<f64>) {
    let mut begin = 0;
    while begin + 1 < row.len() {
        let sign = (row[begin + 1] - row[begin]).signum();
        let mut end = begin + 1;
        while end + 1 < row.len() && (row[end + 1] - row[end]) * sign > 0.0 {
            end += 1;
        }
        let height = (row[end] - row[begin]).abs();
        // Both ends must be inside the image and not clipped at white or black.
        let is_whole = begin > 0 && end + 1 < row.len() && row[begin].max(row[end]) < f64::from(BRIGHT);
        if height >= EDGE_MIN_GREY && is_whole && row[begin].min(row[end]) > f64::from(DARK) {
            // Central differences, because the steepest point may lie between two pixels.
            let slope =
                (begin..=end).filter(|&x| x > 0 && x + 1 < row.len()).map(|x| 0.5 * (row[x + 1] - row[x - 1]).abs());
            let slope = slope.fold(0.0, f64::max);
            if slope > 0.0 {
                blurs.push(height / (slope * std::f64::consts::TAU.sqrt()));
            }
        }
        begin = end;
    }
}

/// Additional blur of one camera relative to the other, from the blur of both in pixels: positive if the right image is softer.
pub fn softer_by_px([left_px, right_px]: [f64; 2]) -> f64 {
    (right_px * right_px - left_px * left_px).abs().sqrt().copysign(right_px - left_px)
}

/// Difference of the mean luminances of both cameras, percent of the brighter one: positive if the right camera is brighter.
pub fn brighter_by_percent(exposures: &[Exposure; 2]) -> f64 {
    let [left, right] = exposures.map(|exposure| exposure.mean_grey);
    (right - left) / left.max(right).max(1.0) * 100.0
}
