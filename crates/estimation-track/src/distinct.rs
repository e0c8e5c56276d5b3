//! Distinctiveness of a target's texture: its number of independent points.

use pb3dp_estimation_core::wide::LANES;

use super::kernels::{CHANNELS, ViewGroup};
use super::surface::SurfaceLevel;

/// Largest number of points that are compared with each other. Chosen by hand, not varied: time grows with its square.
const POINTS_MAX: usize = 1024;
/// Number of distance classes over the extent of the target. Chosen by hand, not varied: resolution of the correlation over
/// distance.
const DISTANCES: usize = 64;
/// Number of parameters of an alignment: six of motion, gain and offset.
const ADAPTED: f64 = 8.0;

/// A point: its pixel in the first view and its channels.
type Point = ([f32; 2], [f32; CHANNELS]);

/// Effective number of independent points of a target's texture: two unrelated images of such texture correlate by chance with
/// a variance of one over this number (Clifford, Richardson and Hemon 1989, for equal textures).
///
/// Smooth and regular textures have few independent points, however many points are sampled.
pub(super) fn independent_points(level: &SurfaceLevel, view: &[ViewGroup]) -> f64 {
    let groups = level.groups.iter().zip(&level.places).zip(view);
    let all: Vec<Point> = groups
        .flat_map(|((group, place), view)| {
            let valid_lanes = (0..LANES).filter(|&i| view.valid.0[i] * group.mask.0[i] > 0.0);
            valid_lanes.map(|i| (place.pixel.map(|x| x.0[i]), view.value.map(|v| v.0[i])))
        })
        .collect();
    independent(all.iter().step_by(all.len().div_ceil(POINTS_MAX).max(1)).copied().collect())
}

fn independent(mut points: Vec<Point>) -> f64 {
    let count = points.len() as f64;
    for c in 0..CHANNELS {
        let mean = points.iter().map(|point| f64::from(point.1[c])).sum::<f64>() / count.max(1.0);
        points.iter_mut().for_each(|point| point.1[c] -= mean as f32);
    }
    let product = |a: &Point, b: &Point| a.1.iter().zip(&b.1).map(|(a, b)| f64::from(a * b)).sum::<f64>();
    let distance = |a: &Point, b: &Point| f64::from((a.0[0] - b.0[0]).hypot(a.0[1] - b.0[1]));
    let variance = points.iter().map(|point| product(point, point)).sum::<f64>() / count.max(1.0);
    let extent = points.iter().map(|point| distance(point, &points[0])).fold(0.0, f64::max);
    if variance <= 0.0 || extent <= 0.0 {
        return 0.0;
    }
    // Pairs of points and the sum of their products, by distance; no distance exceeds twice the largest distance from the first
    // point.
    let mut classes = [(0.0, 0.0); DISTANCES];
    for (i, point) in points.iter().enumerate() {
        for other in &points[..i] {
            let class = (distance(point, other) / (2.0 * extent) * DISTANCES as f64) as usize;
            let (pairs, sum) = &mut classes[class.min(DISTANCES - 1)];
            (*pairs, *sum) = (*pairs + 1.0, *sum + product(point, other));
        }
    }
    let shared = |&(pairs, sum): &(f64, f64)| if pairs > 0.0 { sum * sum / (pairs * variance * variance) } else { 0.0 };
    count * count / (count + 2.0 * classes.iter().map(shared).sum::<f64>())
}

/// Number of standard deviations by which a correlation exceeds chance, for a target with this many `independent` points of
/// which a share fits (Fisher's transformation).
pub(super) fn beyond_chance(correlation: f64, share: f64, independent: f64) -> f64 {
    correlation.clamp(0.0, 0.999).atanh() * (independent * share - ADAPTED).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use pb3dp_estimation_core::rng::SplitMix64;

    use super::*;

    /// A texture of waves of about this length, pixels, on a square of 96 px.
    fn texture(length_px: f32) -> Vec<Point> {
        let mut random = SplitMix64::new(7);
        let mut random = || random.unit() as f32;
        let waves: Vec<[f32; 3]> = (0..60)
            .map(|_| {
                let (turn, phase) = (random() * std::f32::consts::TAU, random() * std::f32::consts::TAU);
                let speed = std::f32::consts::TAU / length_px * (0.5 + random());
                [speed * turn.cos(), speed * turn.sin(), phase]
            })
            .collect();
        let value = |x: f32, y: f32| 30.0 * waves.iter().map(|w| (w[0] * x + w[1] * y + w[2]).sin()).sum::<f32>();
        let at = |i: usize| [3.0 * (i % 32) as f32, 3.0 * (i / 32) as f32];
        (0..1024).map(|i| (at(i), [value(at(i)[0], at(i)[1]), 0.0, 0.0])).collect()
    }

    #[test]
    fn fine_texture_is_worth_more_points_than_smooth_texture() {
        let worth = [8.0, 24.0, 120.0].map(|length| independent(texture(length)));
        assert!(worth[0] > 150.0 && worth[0] <= 1024.0, "{worth:?}");
        assert!(worth[1] < 0.4 * worth[0] && worth[1] > 15.0, "{worth:?}");
        assert!(worth[2] < 8.0, "{worth:?}");
    }

    #[test]
    fn stripes_are_worth_little_however_fine() {
        let mut points = texture(8.0);
        points.iter_mut().for_each(|point| point.1[0] = 50.0 * (point.0[0] * 0.7).sin());
        let (stripes, fine) = (independent(points), independent(texture(8.0)));
        assert!(stripes < 0.3 * fine, "{stripes} of {fine}");
    }

    #[test]
    fn a_blank_target_is_worth_nothing() {
        let mut points = texture(8.0);
        points.iter_mut().for_each(|point| point.1 = [120.0, 0.0, 0.0]);
        assert!(independent(points) == 0.0 && independent(Vec::new()) == 0.0);
    }

    #[test]
    fn a_perfect_fit_of_few_points_is_no_more_than_chance() {
        assert!(beyond_chance(0.99, 1.0, 8.0) == 0.0);
        assert!(beyond_chance(0.9, 1.0, 10.0) < 3.0);
        assert!(beyond_chance(0.9, 0.9, 100.0) > 10.0);
    }
}
