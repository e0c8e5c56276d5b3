//! The plane of least squares through the largest connected surface of a region: the frame of a target that is no plane.
//!
//! A plane that is fitted to patches follows those with texture. Here every pixel of the visible surface ([`super::shape`]) counts alike, so
//! that the plane depends on the shape of the object alone.

use std::collections::VecDeque;

use nalgebra::{Matrix3, Vector2, Vector3};
use pb3dp_estimation_views::disparity_plane::DisparityPlane;

use super::shape::{EDGE_PX, REACH, ShapePixel};

/// Side of the squares whose errors count as independent, pixels of the level: twice the reach of the median.
const SQUARE: usize = 2 * REACH + 1;

/// Factors of the three parts of the standard deviation, see [`surface_plane`]. Fitted on rendered crabs with reliefs of 5 and 10 mm and potatoes,
/// 8 regions of each in 5 views: two standard deviations contain 100, 100 and 93 % of the tilts, and 100, 93 and 92 % of the depths; of other scenes,
/// regions and views (`bench accuracy --only first-pose --seed 2`) 90, 98, 90 and 96, 96, 96 %.
const OF_SQUARES: f64 = 0.6;
const OF_EDGES: f64 = 0.7;
const OF_REST: f64 = 2.0;
/// Share of the change without the pixels near a depth edge that is taken out: the median there is rather that of the other side. Chosen with the
/// same figures: 0.5 to 0.8 of it is error.
const EDGES_TAKEN_OUT: f64 = 0.5;
/// Rounds of the robust fit, and residual without weight in standard deviations by their median (Tukey).
const ROUNDS: usize = 10;
const TUKEY: f64 = 4.685 * 1.4826;

/// The plane of a visible surface, in `cam_left`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePlane {
    /// The inverse-depth plane: 1/depth on a ray `d` (third component 1) is `q . d`, 1/m.
    pub inverse_depth_plane: Vector3<f64>,
    /// Its covariance, 1/m².
    pub covariance: Matrix3<f64>,
}

/// The pixels on their grid.
struct Grid {
    width: usize,
    height: usize,
    /// Index of the pixel at a place.
    at: Vec<Option<usize>>,
    /// Place of each pixel.
    place: Vec<usize>,
}

impl Grid {
    fn of(pixels: &[ShapePixel], spacing_px: f64) -> Option<Self> {
        let first = pixels.first()?.at_px;
        let (low, high) =
            pixels.iter().fold((first, first), |(low, high), pixel| (low.inf(&pixel.at_px), high.sup(&pixel.at_px)));
        let count = |x: f64| (x / spacing_px).round() as usize;
        let size = (high - low).map(|side| count(side) + 1);
        let places = pixels.iter().map(|pixel| (pixel.at_px - low).map(count)).map(|at| at.y * size.x + at.x);
        let place: Vec<usize> = places.collect();
        let mut at = vec![None; size.x * size.y];
        place.iter().enumerate().for_each(|(index, place)| at[*place] = Some(index));
        Some(Self { width: size.x, height: size.y, at, place })
    }

    /// Indices of the pixels beside one, at most `reach` columns and rows away.
    fn around(&self, index: usize, reach: usize) -> impl Iterator<Item = usize> + '_ {
        let (x, y) = (self.place[index] % self.width, self.place[index] / self.width);
        let rows = y.saturating_sub(reach)..=(y + reach).min(self.height - 1);
        let columns = move || x.saturating_sub(reach)..=(x + reach).min(self.width - 1);
        rows.flat_map(move |row| columns().filter_map(move |column| self.at[row * self.width + column]))
    }

    /// Number of the connected surface of each pixel, and the size of each surface.
    fn surfaces(&self, pixels: &[ShapePixel], edge_px: f64) -> (Vec<usize>, Vec<usize>) {
        let (mut number, mut sizes, mut todo) = (vec![usize::MAX; pixels.len()], Vec::new(), VecDeque::new());
        for first in 0..pixels.len() {
            if number[first] != usize::MAX {
                continue;
            }
            let own = sizes.len();
            sizes.push(0);
            number[first] = own;
            todo.push_back(first);
            while let Some(index) = todo.pop_front() {
                sizes[own] += 1;
                for beside in self.around(index, 1) {
                    let (here, there) = (self.place[index], self.place[beside]);
                    let is_straight =
                        here % self.width == there % self.width || here / self.width == there / self.width;
                    let step_px = (pixels[index].disparity_px - pixels[beside].disparity_px).abs();
                    if is_straight && number[beside] == usize::MAX && step_px < edge_px {
                        number[beside] = own;
                        todo.push_back(beside);
                    }
                }
            }
        }
        (number, sizes)
    }
}

/// Sums of a fit of weighted least squares.
#[derive(Clone, Copy, Default)]
struct Sums {
    information: Matrix3<f64>,
    pull: Vector3<f64>,
}

impl Sums {
    fn add(&mut self, by: Vector3<f64>, disparity_px: f64, weight: f64) {
        self.information += by * by.transpose() * weight;
        self.pull += by * (disparity_px * weight);
    }

    fn solved(&self) -> Option<Vector3<f64>> {
        Some(self.information.try_inverse()? * self.pull)
    }
}

/// The plane of robust least squares through the largest surface, and its covariance (disparity at the centre, slopes); `spacing_px` is the distance
/// of neighbouring pixels. `None` if they do not span a plane.
///
/// The covariance has three parts: the residuals of squares whose errors count as independent, since the disparity of a pixel is wrong by a share of
/// the relief; what the plane changes without the pixels near a depth edge; and what it changes with other pixels that are as near to it.
pub(super) fn surface_plane(pixels: &[ShapePixel], spacing_px: f64) -> Option<(DisparityPlane, Matrix3<f64>)> {
    let grid = Grid::of(pixels, spacing_px)?;
    let (number, sizes) = grid.surfaces(pixels, f64::from(EDGE_PX) * spacing_px);
    let largest = (0..sizes.len()).max_by_key(|number| sizes[*number])?;
    let own = || (0..pixels.len()).filter(|index| number[*index] == largest);
    let centre_px = own().map(|index| pixels[index].at_px).sum::<Vector2<f64>>() / sizes[largest] as f64;
    let by = |index: usize| {
        let at = pixels[index].at_px - centre_px;
        Vector3::new(1.0, at.x, at.y)
    };
    let sums = |chosen: &mut dyn Iterator<Item = usize>, weight: &dyn Fn(usize) -> f64| {
        let mut sums = Sums::default();
        chosen.for_each(|index| sums.add(by(index), pixels[index].disparity_px, weight(index)));
        sums
    };
    let residual = |index: usize, plane: &Vector3<f64>| pixels[index].disparity_px - by(index).dot(plane);
    let mut found = sums(&mut own(), &|_| 1.0).solved()?;
    let mut limit_px = f64::INFINITY;
    for _ in 0..ROUNDS {
        let mut residuals: Vec<f64> = own().map(|index| residual(index, &found).abs()).collect();
        let middle = residuals.len() / 2;
        limit_px = (TUKEY * *residuals.select_nth_unstable_by(middle, f64::total_cmp).1).max(f64::EPSILON);
        found = sums(&mut own(), &|index| tukey(residual(index, &found) / limit_px)).solved()?;
    }
    let weight = |index: usize| tukey(residual(index, &found) / limit_px);
    let inverse = sums(&mut own(), &weight).information.try_inverse()?;
    let changed = |other: Sums| other.solved().map_or(Vector3::zeros(), |other| found - other);
    // At a depth edge, a pixel may have the disparity of the other side.
    let is_inner = |index: &usize| grid.around(*index, REACH).all(|beside| number[beside] == largest);
    let of_edges = changed(sums(&mut own().filter(is_inner), &weight));
    // What lies as near to the plane may belong to the surface as well.
    let of_rest = changed(sums(&mut (0..pixels.len()), &weight));
    let across = grid.width.div_ceil(SQUARE);
    let mut squares = vec![Vector3::zeros(); across * grid.height.div_ceil(SQUARE)];
    for index in own() {
        let (x, y) = (grid.place[index] % grid.width, grid.place[index] / grid.width);
        squares[y / SQUARE * across + x / SQUARE] += by(index) * (weight(index) * residual(index, &found));
    }
    let of_squares: Matrix3<f64> = squares.iter().map(|pull| inverse * pull).map(|step| step * step.transpose()).sum();
    let of_change = |factor: f64, change: Vector3<f64>| change * change.transpose() * factor.powi(2);
    let covariance = of_squares * OF_SQUARES.powi(2) + of_change(OF_EDGES, of_edges) + of_change(OF_REST, of_rest);
    let found = found - of_edges * EDGES_TAKEN_OUT;
    Some((DisparityPlane { centre_px, d0_px: found.x, slope: Vector2::new(found.y, found.z) }, covariance))
}

/// Tukey's weight.
fn tukey(share: f64) -> f64 {
    (1.0 - share * share).max(0.0).powi(2)
}
