//! The surface that continues a plane: all pixels of a region that are reached from the plane without a jump in disparity.
//!
//! The refinement finds a plane that many pixels share. On a curved surface this is the plane at some place of it, and the texture
//! decides at which. The plane of least squares through all of the surface depends on the surface alone.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use super::hypotheses::PlaneCoefficients;
use crate::surface_choice::SurfaceChoice;

/// Pixels without a clear disparity are bridged up to this distance. Chosen by hand, not varied: surroundings of occlusions are wider.
const BRIDGED: usize = 2;
/// Two pixels of a row or column are neighbours if at most this many pixels without a clear disparity are between them. Chosen by hand,
/// not varied.
const GAP_MAX: usize = 5;
/// Largest slope of a surface relative to its plane, pixel per pixel. Chosen by hand, not varied: at 500 mm and 100 mm of baseline a
/// surface at 70 degrees to its plane has it.
const SLOPE_MAX: f32 = 0.5;
/// A pixel belongs to a plane within this distance, pixels of the level. Derived: disparities of the search have whole steps, and their
/// fractions are accurate to a quarter.
const NEAR_PX: f32 = 0.5;
/// The surface begins where the plane is within this distance, pixels of the level. Chosen by hand, not varied.
const BEGIN_PX: f32 = 1.0;

/// A continuous surface, in pixels of the searched level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContinuedSurface {
    /// The plane of least squares through its pixels.
    pub plane: PlaneCoefficients,
    /// Share of the clear disparities that are on it.
    pub share: f64,
    /// Share of its pixels on the plane that it continues.
    pub near_share: f64,
    /// Root mean square distance of its pixels from its own plane.
    pub rms_px: f64,
    /// Steps between neighbours anywhere in the region, in units of the side of a square of as many pixels: the edge of a second surface
    /// that crosses the region has about one in each row.
    pub steps: f64,
}

/// Factors of a plane's coefficients at a pixel.
fn row_of(i: usize, width: usize) -> Vector3<f64> {
    Vector3::new(1.0, (i % width) as f64, (i / width) as f64)
}

/// Grows surfaces; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct Continuation {
    /// Distances from the plane, row by row; NaN without a clear disparity.
    distance: Vec<f32>,
    reached: Vec<bool>,
    open: Vec<usize>,
}

impl Continuation {
    /// The surface that continues a plane; the disparities come row by row, NaN where there is no clear one. `None` if the plane itself
    /// explains all of them, or none.
    pub fn of(
        &mut self,
        disparities: impl Iterator<Item = f32>,
        width: usize,
        plane: &PlaneCoefficients,
        choice: &SurfaceChoice,
    ) -> Option<ContinuedSurface> {
        let row_of = |i: usize| row_of(i, width);
        self.start(disparities, width, plane);
        let clear = self.distance.iter().filter(|distance| distance.is_finite()).count() as f64;
        let near = self.distance.iter().filter(|distance| distance.abs() < NEAR_PX).count() as f64;
        // Few divisions, no growth and no steps for the planes of most regions.
        if clear == 0.0 || near > choice.continued_near_max * clear {
            return None;
        }
        self.grow(width, choice.continued_jump_px as f32);
        let reached = || self.reached.iter().enumerate().filter(|(_, reached)| **reached).map(|(i, _)| i);
        let (mut squares, mut pull, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
        for i in reached() {
            let row = row_of(i);
            squares += row * row.transpose();
            pull += row * f64::from(self.distance[i]);
            count += 1.0;
        }
        let moved = squares.try_inverse()? * pull;
        let rest: f64 = reached().map(|i| (f64::from(self.distance[i]) - moved.dot(&row_of(i))).powi(2)).sum();
        Some(ContinuedSurface {
            plane: plane + moved,
            share: count / clear,
            near_share: near / count,
            rms_px: (rest / count).sqrt(),
            steps: self.steps(width) as f64 / clear.sqrt(),
        })
    }

    /// Whether the surface that continues a plane contains most of the pixels that are within a distance of another plane.
    pub fn reaches(
        &mut self,
        disparities: impl Iterator<Item = f32>,
        width: usize,
        [from, to]: [&PlaneCoefficients; 2],
        near_px: f32,
        choice: &SurfaceChoice,
    ) -> bool {
        self.start(disparities, width, from);
        self.grow(width, choice.continued_jump_px as f32);
        let apart = to - from;
        let (mut near, mut both) = (0, 0);
        for (i, (distance, reached)) in self.distance.iter().zip(&self.reached).enumerate() {
            // False without a clear disparity.
            if (distance - apart.dot(&row_of(i, width)) as f32).abs() < near_px {
                near += 1;
                both += usize::from(*reached);
            }
        }
        2 * both > near
    }

    /// Takes the distances from a plane.
    fn start(&mut self, disparities: impl Iterator<Item = f32>, width: usize, plane: &PlaneCoefficients) {
        self.distance.clear();
        self.distance.extend(disparities.enumerate().map(|(i, d)| d - plane.dot(&row_of(i, width)) as f32));
    }

    /// Marks all pixels that are reached from the plane without a jump.
    fn grow(&mut self, width: usize, jump_px: f32) {
        let height = self.distance.len() / width;
        self.reached.clear();
        self.reached.extend(self.distance.iter().map(|distance| distance.abs() < BEGIN_PX));
        self.open.clear();
        self.open.extend(self.reached.iter().enumerate().filter(|(_, reached)| **reached).map(|(i, _)| i));
        let around =
            |at: usize, end: usize| -> Range<usize> { at.saturating_sub(BRIDGED)..(at + BRIDGED + 1).min(end) };
        while let Some(i) = self.open.pop() {
            for y in around(i / width, height) {
                for x in around(i % width, width) {
                    let other = y * width + x;
                    // False without a clear disparity.
                    if !self.reached[other] && (self.distance[other] - self.distance[i]).abs() < jump_px {
                        self.reached[other] = true;
                        self.open.push(other);
                    }
                }
            }
        }
    }

    /// Number of steps between neighbours in all rows and columns.
    fn steps(&self, width: usize) -> usize {
        let height = self.distance.len() / width;
        let rows: usize = (0..height).map(|y| self.steps_along(y * width, 1, width)).sum();
        let columns: usize = (0..width).map(|x| self.steps_along(x, width, height)).sum();
        rows + columns
    }

    fn steps_along(&self, first: usize, stride: usize, count: usize) -> usize {
        let (mut before, mut steps) = (None, 0);
        for at in 0..count {
            let distance = self.distance[first + at * stride];
            if distance.is_nan() {
                continue;
            }
            let is_step = |(other_at, other): (usize, f32)| {
                let gap = at - other_at - 1;
                gap <= GAP_MAX && (distance - other).abs() > 1.0 + SLOPE_MAX * gap as f32
            };
            steps += usize::from(before.is_some_and(is_step));
            before = Some((at, distance));
        }
        steps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 60;
    const HEIGHT: usize = 50;

    /// The surface that continues the plane `20 + 0.02 x - 0.03 y` in a region with these distances from it.
    fn continued(distance: impl Fn(f64, f64) -> f64) -> Option<ContinuedSurface> {
        let plane = Vector3::new(20.0, 0.02, -0.03);
        let value = |i: usize| {
            let (x, y) = ((i % WIDTH) as f64, (i / WIDTH) as f64);
            // Errors of a tenth of a pixel.
            (plane.dot(&Vector3::new(1.0, x, y)) + distance(x, y) + 0.14 * (7.0 * x + 13.0 * y).sin()) as f32
        };
        Continuation::default().of((0..WIDTH * HEIGHT).map(value), WIDTH, &plane, &SurfaceChoice::default())
    }

    /// By hand: `(x - a)^2` over `a +- h` is on average `h^2 / 3`, and its rms about that is `h^2 sqrt(4 / 45)`.
    #[test]
    fn a_bowl_is_one_surface_with_its_plane_of_least_squares() {
        let bowl = |x: f64, _: f64| 3.0 * ((x - 29.5) / 30.0).powi(2) - 1.0;
        let found = continued(bowl).unwrap();
        assert!(found.share > 0.99 && found.steps < 0.1, "{found:?}");
        assert!((found.rms_px - 3.0 * (4.0_f64 / 45.0).sqrt()).abs() < 0.03, "{found:?}");
        let off = found.plane - Vector3::new(20.0, 0.02, -0.03);
        assert!(off.x.abs() < 0.03 && off.yz().norm() < 1e-3, "{off:?}");
        // Tilted, and of only some pixels.
        let bowl = |x: f64, y: f64| if (x + y) % 3.0 == 0.0 { f64::NAN } else { 0.03 * x + bowl(x, y) - 0.9 };
        let found = continued(bowl).unwrap();
        assert!(found.share > 0.99 && (found.plane.y - 0.05).abs() < 2e-3, "{found:?}");
    }

    #[test]
    fn a_second_surface_behind_a_step_is_not_reached() {
        let found = continued(|x, _| if x < 40.0 { 0.0 } else { -4.0 }).unwrap();
        assert!((found.share - 40.0 / 60.0).abs() < 0.01 && found.near_share > 0.99, "{found:?}");
        // By a bridge of a few rows it is; the steps of the other rows remain.
        let found = continued(|x, y| match (x < 40.0, y < 4.0) {
            (true, _) => 0.0,
            (_, true) => -0.5 * (x - 40.0).min(8.0),
            _ => -4.0,
        });
        let found = found.unwrap();
        assert!(found.share > 0.99 && found.steps > 0.7, "{found:?}");
    }

    #[test]
    fn a_curved_surface_reaches_its_other_planes_and_a_step_ends_it() {
        let plane = Vector3::new(20.0, 0.02, -0.03);
        let reaches = |off: &dyn Fn(f64) -> f64, to: Vector3<f64>| {
            let value = |i: usize| (plane.dot(&row_of(i, WIDTH)) + off((i % WIDTH) as f64)) as f32;
            let all = (0..WIDTH * HEIGHT).map(value);
            Continuation::default().reaches(all, WIDTH, [&plane, &(plane + to)], 1.0, &SurfaceChoice::default())
        };
        // A slope of 0.3 px per pixel beside the plane, and the plane in which it ends.
        assert!(reaches(&|x| 0.3 * (x - 20.0).clamp(0.0, 20.0), Vector3::new(6.0, 0.0, 0.0)));
        assert!(!reaches(&|x| if x < 30.0 { 0.0 } else { 6.0 }, Vector3::new(6.0, 0.0, 0.0)));
        assert!(!reaches(&|_| 0.0, Vector3::new(6.0, 0.0, 0.0)), "no pixel is on the other plane");
    }

    #[test]
    fn a_plane_continues_into_nothing_else() {
        assert_eq!(continued(|_, _| 0.0), None);
        assert_eq!(continued(|_, _| f64::NAN), None);
        assert_eq!(continued(|_, _| 9.0), None);
    }
}
