//! Hue backprojection and mean shift: finds the target's pixels and their centroid.
//!
//! The hue histograms of the target and of its surroundings are computed once, in the first frame (32 bins around the hue
//! circle and one for pixels without hue). The weight of a pixel is the relative frequency of its bin on the target compared
//! with the surroundings, `max(0, (target - around) / (target + around))`. Colours common to both get no weight.
//!
//! In a later frame the weighted centroid is computed inside a window of the target's shape, the window is moved by the motion
//! of the centroid, and so on (mean shift). The centroid's position on the target was measured in the same way in the first
//! frame, so texture and dark spots cause no bias.

use nalgebra::Vector2;
use pb3dp_estimation_core::region::RegionMask;

use crate::hue::{Hue, HuePlane};

/// Number of bins around the hue circle.
const HUE_CLASSES: usize = 32;
/// Number of all bins; the last one is for pixels without hue.
const CLASSES: usize = HUE_CLASSES + 1;
/// The mean shift ends when the window moves by less than this, pixels.
const CONVERGED_PX: f64 = 0.02;

/// Limits of a mean shift.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShiftLimits {
    /// Largest number of steps.
    pub steps_max: usize,
    /// Largest displacement in total, pixels.
    pub shift_max_px: f64,
}

/// Weight of each hue bin for the target, 0 to 1.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Backprojection {
    weights: [f64; CLASSES],
}

/// Sum and centroid of the weights inside a window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mass {
    /// Sum of the weights: approximately the number of pixels that look like the target.
    pub sum_px: f64,
    pub centroid_px: Vector2<f64>,
}

impl Backprojection {
    /// Computes the weights from the pixels of the target and of its surroundings (disjoint masks).
    pub(super) fn learn(hue: &HuePlane, target: &RegionMask, around: &RegionMask) -> Self {
        let (target, around) = (histogram(hue, target), histogram(hue, around));
        let mut weights = [0.0; CLASSES];
        for ((weight, t), a) in weights.iter_mut().zip(target).zip(around) {
            *weight = if t > 0.0 { ((t - a) / (t + a)).max(0.0) } else { 0.0 };
        }
        Self { weights }
    }

    /// The weight of the pixel nearest to `pixel`; 0 outside the image.
    pub(super) fn weight_at(&self, hue: &HuePlane, pixel: &Vector2<f64>) -> f64 {
        let (u, v) = (pixel.x.round(), pixel.y.round());
        let inside = u >= 0.0 && v >= 0.0 && u < hue.width() as f64 && v < hue.height() as f64;
        if inside { self.weights[class(hue.at(u as i32, v as i32))] } else { 0.0 }
    }

    /// The mass inside `window` moved by `shift_px` (rounded to pixels); `None` if there is none.
    pub(super) fn mass(&self, hue: &HuePlane, window: &RegionMask, shift_px: &Vector2<f64>) -> Option<Mass> {
        let (dx, dy) = (shift_px.x.round() as i32, shift_px.y.round() as i32);
        let (mut sum, mut sum_x, mut sum_y) = (0.0, 0.0, 0.0);
        window.for_each_run(|y, first, last| {
            let v = y as i32 + dy;
            let (mut row, mut row_x) = (0.0, 0.0);
            for u in first as i32 + dx..=last as i32 + dx {
                if u >= 0 && v >= 0 && (u as usize) < hue.width() && (v as usize) < hue.height() {
                    let weight = self.weights[class(hue.at(u, v))];
                    row += weight;
                    row_x += weight * f64::from(u);
                }
            }
            sum += row;
            sum_x += row_x;
            sum_y += row * f64::from(v);
        });
        (sum > 0.0).then(|| Mass { sum_px: sum, centroid_px: Vector2::new(sum_x, sum_y) / sum })
    }

    /// Displacement of the target from the expected position, and the mass found there. `window` is the target's window at the
    /// expected position.
    pub(super) fn mean_shift(
        &self,
        hue: &HuePlane,
        window: &RegionMask,
        expected_px: &Vector2<f64>,
        ShiftLimits { steps_max, shift_max_px }: ShiftLimits,
    ) -> Option<(Vector2<f64>, Mass)> {
        let mut shift_px = Vector2::zeros();
        let mut mass = self.mass(hue, window, &shift_px)?;
        for _ in 0..steps_max {
            let next_px = limited(mass.centroid_px - expected_px, shift_max_px);
            let step_px = (next_px - shift_px).norm();
            shift_px = next_px;
            if step_px < CONVERGED_PX {
                break;
            }
            mass = self.mass(hue, window, &shift_px)?;
        }
        Some((shift_px, mass))
    }
}

fn limited(shift: Vector2<f64>, length_max: f64) -> Vector2<f64> {
    let length = shift.norm();
    if length > length_max { shift * (length_max / length) } else { shift }
}

fn class(hue: Option<Hue>) -> usize {
    hue.map_or(HUE_CLASSES, |hue| ((hue.degrees() * (HUE_CLASSES as f64 / 360.0)) as usize).min(HUE_CLASSES - 1))
}

/// Share of each bin among the pixels of a mask, smoothed over neighbouring hues (1, 2, 1) against noise at bin borders.
fn histogram(hue: &HuePlane, mask: &RegionMask) -> [f64; CLASSES] {
    let mut counts = [0.0; CLASSES];
    let mut total = 0.0_f64;
    mask.for_each(|x, y| {
        counts[class(hue.at(x as i32, y as i32))] += 1.0;
        total += 1.0;
    });
    let mut shares = [0.0; CLASSES];
    for (k, share) in shares.iter_mut().enumerate().take(HUE_CLASSES) {
        let (before, after) = ((k + HUE_CLASSES - 1) % HUE_CLASSES, (k + 1) % HUE_CLASSES);
        *share = (counts[before] + 2.0 * counts[k] + counts[after]) / (4.0 * total.max(1.0));
    }
    shares[HUE_CLASSES] = counts[HUE_CLASSES] / total.max(1.0);
    shares
}

#[cfg(test)]
mod tests {
    use image::{Rgb, RgbImage};
    use pb3dp_geometry::ImageSize;

    use super::*;
    use crate::hue::HueConfig;

    const SIZE: ImageSize = ImageSize { width: 120, height: 90 };

    /// A two-coloured disc with an off-centre spot of the background's hue, on a background with one of the disc's colours in a
    /// corner.
    fn scene(centre: (f64, f64)) -> HuePlane {
        let image = RgbImage::from_fn(SIZE.width, SIZE.height, |x, y| {
            let (dx, dy) = (f64::from(x) - centre.0, f64::from(y) - centre.1);
            if (dx + 6.0).hypot(dy - 4.0) < 5.0 {
                Rgb([40, 110, 200])
            } else if dx.hypot(dy) < 18.0 {
                if dx > 3.0 { Rgb([220, 60, 40]) } else { Rgb([210, 190, 30]) }
            } else if x < 20 && y < 20 {
                Rgb([220, 60, 40])
            } else {
                Rgb([40, 110, 200])
            }
        });
        HuePlane::from_rgb(&image, &HueConfig::default())
    }

    fn disc(centre: (f64, f64), radius: f64) -> RegionMask {
        RegionMask::from_fn(SIZE, |x, y| (f64::from(x) - centre.0).hypot(f64::from(y) - centre.1) < radius)
    }

    fn learnt() -> (Backprojection, Vector2<f64>) {
        let centre = (60.0, 45.0);
        let (hue, target) = (scene(centre), disc(centre, 18.0));
        let window = target.dilate(6);
        let around = RegionMask::from_fn(SIZE, |x, y| {
            window.contains(x as i32, y as i32) && !target.contains(x as i32, y as i32)
        });
        let colours = Backprojection::learn(&hue, &target, &around);
        let mass = colours.mass(&hue, &window, &Vector2::zeros()).expect("a disc");
        assert!((mass.sum_px - (target.area_px() as f64 - 80.0)).abs() < 40.0, "{mass:?}");
        (colours, mass.centroid_px - Vector2::new(centre.0, centre.1))
    }

    #[test]
    fn the_shift_of_a_spotted_disc_is_found_to_a_fraction_of_a_pixel() {
        let (colours, offset) = learnt();
        assert!(offset.norm() > 0.3, "the spot moves the mass: {offset}");
        let moved = (64.0, 39.5);
        let window = disc((60.0, 45.0), 18.0).dilate(6);
        let expected = Vector2::new(60.0, 45.0) + offset;
        let (shift, _) = colours
            .mean_shift(&scene(moved), &window, &expected, ShiftLimits { steps_max: 8, shift_max_px: 20.0 })
            .expect("mass");
        assert!((shift - Vector2::new(4.0, -5.5)).norm() < 0.15, "{shift}");
        let (limited, _) = colours
            .mean_shift(&scene(moved), &window, &expected, ShiftLimits { steps_max: 8, shift_max_px: 2.0 })
            .expect("mass");
        assert!((limited.norm() - 2.0).abs() < 1e-9);
    }

    #[test]
    fn colours_of_the_surroundings_have_no_weight() {
        let (hue, target) = (scene((60.0, 45.0)), disc((20.0, 70.0), 8.0));
        let around = disc((100.0, 70.0), 8.0);
        let colours = Backprojection::learn(&hue, &target, &around);
        assert_eq!(colours.mass(&hue, &target, &Vector2::zeros()), None);
    }
}
