//! Noise of a region's pixels.

use pb3dp_estimation_views::region_pyramid::RegionLevel;

/// Approximate number of pixels that are looked at. Derived: a quartile of 600 values is accurate to 6 %.
const SAMPLES: usize = 600;
/// With fewer pixels the noise is unknown.
const SAMPLES_MIN: usize = 20;
/// Lower quartile of the absolute value of a normal variable, standard deviations.
const QUARTILE: f32 = 0.3186;
/// Standard deviation of the sum with weights 1, -2, 1 along rows and columns, standard deviations of a pixel.
const GAIN: f32 = 6.0;

/// Standard deviation of the luminance of a pixel of the region by noise, by the second differences along rows and columns (Immerkaer,
/// Fast noise variance estimation, 1996, eq. 2); their lower quartile instead of their mean, because most of a textured region
/// shows more than noise. `None` if the region is too small.
pub(super) fn noise_grey(level: &RegionLevel, samples: &mut Vec<f32>) -> Option<f32> {
    let (width, height) = (level.left.window.width, level.left.window.height);
    let step = ((level.area_px / SAMPLES) as f64).sqrt().max(1.0) as usize;
    samples.clear();
    for y in (1..height.saturating_sub(1)).step_by(step) {
        let inside = &level.region[y * width..(y + 1) * width];
        let rows = [y - 1, y, y + 1].map(|row| level.left.luminance().row(row));
        for x in (1..width.saturating_sub(1)).step_by(step).filter(|&x| inside[x] != 0) {
            let [above, here, below] = rows.map(|row| row[x - 1] - 2.0 * row[x] + row[x + 1]);
            samples.push((above - 2.0 * here + below).abs());
        }
    }
    if samples.len() < SAMPLES_MIN {
        return None;
    }
    let quarter = samples.len() / 4;
    let (_, quartile, _) = samples.select_nth_unstable_by(quarter, f32::total_cmp);
    Some(*quartile / (QUARTILE * GAIN))
}
