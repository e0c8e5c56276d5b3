//! Rotation of the outline in its plane.
//!
//! The model is rebuilt inside the outline in every frame, so the outline must stay on the target. On a target that rotates
//! about its normal it would not. The rotation is estimated from pairs of points on either side of the outline: inside points
//! should look like the target, outside points should not. This rotates the region only. The pose's rotation about the normal
//! remains unobserved, because an almost round outline, or a background of the same hue, contains no information about it.

use nalgebra::Vector2;
use pb3dp_estimation_core::trig;

/// Spacing of the pairs along the outline, pixels.
const SPACING_PX: f64 = 2.0;
/// Distance of the two points from the outline, pixels.
const OFFSET_PX: f64 = 3.0;
/// Number of tested angles to either side.
const STEPS: i32 = 2;
/// Spacing of the tested angles, radians.
const STEP_RAD: f64 = 0.015;
/// Smallest gain in contrast per pair for a rotation of the outline.
const GAIN_MIN: f64 = 0.004;

/// Two points on either side of the outline, on the plane, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
struct EdgePair {
    inside: Vector2<f64>,
    outside: Vector2<f64>,
}

/// The outline's edge on the plane of the model.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct OutlineEdge {
    pairs: Vec<EdgePair>,
}

impl OutlineEdge {
    /// Creates the edge from an outline on the plane, metres, and the size of a pixel there, metres.
    pub(super) fn new(outline_m: &[Vector2<f64>], pixel_m: f64) -> Self {
        let mut pairs = Vec::new();
        let next = |i: usize| outline_m[(i + 1) % outline_m.len()];
        let area: f64 = (0..outline_m.len()).map(|i| outline_m[i].perp(&next(i))).sum();
        for (i, corner) in outline_m.iter().enumerate() {
            let along = next(i) - corner;
            let count = (along.norm() / (SPACING_PX * pixel_m)).round().min(10_000.0) as usize;
            // With a positive area the inside is at +90 degrees from the direction of travel.
            let inwards = Vector2::new(-along.y, along.x).normalize() * area.signum();
            for k in 0..count {
                let point = corner + along * ((k as f64 + 0.5) / count as f64);
                let offset = inwards * (OFFSET_PX * pixel_m);
                pairs.push(EdgePair { inside: point + offset, outside: point - offset });
            }
        }
        Self { pairs }
    }

    /// The angle near `roll_rad` at which the outline fits best. `weight` is the similarity of a point of the plane to the
    /// target, 0 to 1. Without a clear gain the angle does not change.
    pub(super) fn fit(&self, roll_rad: f64, weight: impl Fn(&Vector2<f64>) -> f64) -> f64 {
        if self.pairs.is_empty() {
            return roll_rad;
        }
        let contrast = |step: i32| {
            let turn = trig::rotation(roll_rad + f64::from(step) * STEP_RAD);
            let across = |pair: &EdgePair| weight(&(turn * pair.inside)) - weight(&(turn * pair.outside));
            self.pairs.iter().map(across).sum::<f64>() / self.pairs.len() as f64
        };
        let tried: [f64; 2 * STEPS as usize + 1] = std::array::from_fn(|k| contrast(k as i32 - STEPS));
        let middle = STEPS as usize;
        let best = (0..tried.len()).fold(middle, |best, k| if tried[k] > tried[best] { k } else { best });
        if best != middle && tried[best] - tried[middle] < GAIN_MIN {
            return roll_rad;
        }
        let refined = if best == 0 || best + 1 == tried.len() { 0.0 } else { summit(&tried[best - 1..=best + 1]) };
        roll_rad + (best as f64 - middle as f64 + refined) * STEP_RAD
    }
}

/// Position of the maximum of the parabola through three values at -1, 0, 1; 0 if it has no maximum there.
fn summit(values: &[f64]) -> f64 {
    let bend = values[0] - 2.0 * values[1] + values[2];
    if bend < -2.0 * GAIN_MIN { (0.5 * (values[0] - values[2]) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation2;

    use super::*;

    /// A right-angled outline without symmetry, metres.
    fn outline() -> Vec<Vector2<f64>> {
        [(-0.05, -0.03), (0.06, -0.03), (0.06, 0.0), (0.0, 0.005), (0.0, 0.05), (-0.05, 0.05)]
            .map(|(x, y)| Vector2::new(x, y))
            .to_vec()
    }

    fn inside(point: &Vector2<f64>) -> bool {
        let (x, y) = (point.x, point.y);
        (-0.05..0.06).contains(&x) && (-0.03..0.05).contains(&y) && (x < 0.0 || y < 0.005 - x / 12.0)
    }

    fn follow(truth_rad: f64, start_rad: f64, reversed: bool) -> f64 {
        let mut points = outline();
        if reversed {
            points.reverse();
        }
        let edge = OutlineEdge::new(&points, 0.0007);
        let back = Rotation2::new(-truth_rad);
        (0..4).fold(start_rad, |roll, _| edge.fit(roll, |p| if inside(&(back * p)) { 0.9 } else { 0.05 }))
    }

    #[test]
    fn the_outline_turns_with_the_target_whichever_way_round_it_is_given() {
        for truth_rad in [-0.07, -0.02, 0.0, 0.031, 0.09] {
            for reversed in [false, true] {
                let found = follow(truth_rad, 0.0, reversed);
                assert!((found - truth_rad).abs() < 0.008, "{found} for {truth_rad}");
            }
        }
    }

    #[test]
    fn without_contrast_the_angle_stays() {
        let edge = OutlineEdge::new(&outline(), 0.0007);
        assert_eq!(edge.fit(0.2, |_| 0.7), 0.2);
        assert_eq!(OutlineEdge::new(&[], 0.0007).fit(0.3, |_| 0.0), 0.3);
    }
}
