//! Plane hypotheses in a set of disparities: drawn through three points, counted with a tight tolerance.
//!
//! Scoring by MSAC (Torr and Zisserman, 2000): a point contributes its squared residual, at most the squared tolerance. Summing
//! a score over the region would prefer a plane that bridges two surfaces; counting with a tight tolerance does not.
//!
//! All planes are counted on few points; the planes that may be the best are counted on more.

use nalgebra::{Matrix3, Vector2, Vector3};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::wide::{LANES, sum_lanes, wide};

use crate::named_sums::PlaneSums;

/// Points `(x, y, d)` in single precision, padded to whole groups with outliers.
#[derive(Clone, Debug, Default)]
pub struct DisparityPoints {
    x: Vec<f32>,
    y: Vec<f32>,
    d: Vec<f32>,
    count: usize,
}

/// Steps of [`DisparityPoints::nearby`]. Chosen by hand, not varied: each takes the points near the plane of the step before.
const NEARBY_STEPS: usize = 3;

/// A disparity that is an outlier for every plane.
const NOWHERE: f32 = 1e9;

impl DisparityPoints {
    /// Removes all points.
    pub fn clear(&mut self) {
        for values in [&mut self.x, &mut self.y, &mut self.d] {
            values.clear();
        }
        self.count = 0;
    }

    /// Adds a point.
    pub fn push(&mut self, x: f32, y: f32, d: f32) {
        self.x.push(x);
        self.y.push(y);
        self.d.push(d);
        self.count += 1;
    }

    /// Pads the last group; call it after the last point.
    pub fn finish(&mut self) {
        let padded = self.count.div_ceil(LANES) * LANES;
        self.x.resize(padded, 0.0);
        self.y.resize(padded, 0.0);
        self.d.resize(padded, NOWHERE);
    }

    /// All disparities.
    pub fn disparities(&self) -> &[f32] {
        &self.d[..self.count]
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The plane of least squares through the points within a distance of a plane; `None` if they determine none.
    pub fn nearby(&self, plane: &PlaneCoefficients, distance: f64) -> Option<PlaneCoefficients> {
        let mut found = *plane;
        for _ in 0..NEARBY_STEPS {
            let (mut squares, mut pull) = (Matrix3::zeros(), Vector3::zeros());
            for i in 0..self.count {
                let point = self.point(i);
                let row = Vector3::new(1.0, point.x, point.y);
                let residual = point.z - found.dot(&row);
                if residual.abs() < distance {
                    squares += row * row.transpose();
                    pull += row * residual;
                }
            }
            found += squares.try_inverse()? * pull;
        }
        found.iter().all(|value| value.is_finite()).then_some(found)
    }

    fn point(&self, i: usize) -> Vector3<f64> {
        Vector3::new(f64::from(self.x[i]), f64::from(self.y[i]), f64::from(self.d[i]))
    }
}

/// `d = p.x + p.y x + p.z y`.
pub type PlaneCoefficients = Vector3<f64>;

/// A plane and its inlier share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The plane.
    pub plane: PlaneCoefficients,
    /// Mean over all points of `1 - min(residual^2 / tolerance^2, 1)`: at most 1.
    pub share: f64,
}

/// Rules for drawing and counting planes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HypothesisRules {
    /// Number of three-point planes.
    pub draws: usize,
    /// Tolerance, pixels of the level.
    pub tolerance_px: f64,
    /// Planes that differ by less than this at the corners of the points' box are considered equal, pixels of the level.
    pub distinct_px: f64,
    /// Largest number of planes kept.
    pub kept: usize,
    /// Number of re-weighted steps for each kept plane.
    pub steps: usize,
}

/// Finds planes in points; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct HypothesisSearch {
    /// A subset of the points for counting; finally the points that no kept plane explains.
    sample: DisparityPoints,
    rest: DisparityPoints,
    /// A subset of the sample for the first count.
    few: DisparityPoints,
    drawn: Vec<Candidate>,
    /// The drawn planes, best first: sort key, and the index in the lower half.
    order: Vec<u64>,
    improved: Vec<Candidate>,
    /// The best planes, best first.
    pub kept: Vec<Candidate>,
}

/// Number of points on which planes are counted. Chosen by hand, not varied: a share of 1024 independent points is accurate
/// to 1.6 % (sqrt(0.25 / 1024)).
const SAMPLE_MAX: usize = 1024;
/// Number of points of the first count. Chosen for time: of 808 real cases and windows none changes its pass or status by it.
const FEW_MAX: usize = 256;
/// A plane may be the best if its first count is at most this many standard deviations below the best one. Chosen, see
/// [`FEW_MAX`].
const COUNT_SIGMAS: f64 = 3.0;
/// Number of planes with the highest counts that are refined, if they differ from those already refined. Chosen, as in the
/// prototype of ADR 7.
const IMPROVED_MAX: usize = 6;
/// Largest number of further surfaces searched among the points that the best planes do not explain. Chosen by hand, not
/// varied: time grows with it; a fourth surface is not found.
const SURFACES_MAX: usize = 3;
/// Smallest number of sample points of a surface. Chosen by hand, not varied: 3 % of [`SAMPLE_MAX`]; with less, chance
/// makes surfaces.
const REST_MIN: usize = 32;

impl HypothesisSearch {
    /// Finds the planes of `points` that `allowed` accepts; `seeds` are evaluated unchanged. `size` is the box of the points.
    pub fn run(
        &mut self,
        points: &DisparityPoints,
        seeds: &[PlaneCoefficients],
        size: Vector2<f64>,
        rules: &HypothesisRules,
        allowed: impl Fn(&PlaneCoefficients) -> bool,
        kernels: Kernels,
    ) {
        self.run_once(points, seeds, size, rules, &allowed, kernels);
        for _ in 0..SURFACES_MAX {
            if self.kept.len() >= rules.kept || !self.leave_explained_out(rules, kernels) {
                break;
            }
            let best = self.drawn.iter().copied().max_by(|a, b| a.share.total_cmp(&b.share));
            let Some(found) = best.filter(|best| best.share > 0.0) else { break };
            let improved = self.improve(found, points, rules, &allowed, kernels);
            self.push_distinct(improved, size, rules.distinct_px);
        }
        self.kept.sort_by(|a, b| b.share.total_cmp(&a.share));
    }

    /// The same without searching for further surfaces among the points that the best planes do not explain.
    pub fn run_once(
        &mut self,
        points: &DisparityPoints,
        seeds: &[PlaneCoefficients],
        size: Vector2<f64>,
        rules: &HypothesisRules,
        allowed: &impl Fn(&PlaneCoefficients) -> bool,
        kernels: Kernels,
    ) {
        self.kept.clear();
        take_every(points, SAMPLE_MAX, &mut self.sample);
        self.drawn.clear();
        self.drawn.extend(seeds.iter().map(|&plane| Candidate { plane, share: 0.0 }));
        self.draw_planes(points, size, rules, allowed);
        self.count_drawn(rules, kernels);
        self.keep_best(points, size, rules, allowed, kernels);
    }

    /// The share of the points on the best plane among some draws, refined; 0 if there is none.
    pub fn best_share(
        &mut self,
        points: &DisparityPoints,
        size: Vector2<f64>,
        rules: &HypothesisRules,
        allowed: impl Fn(&PlaneCoefficients) -> bool,
        kernels: Kernels,
    ) -> f64 {
        self.drawn.clear();
        take_every(points, SAMPLE_MAX, &mut self.sample);
        self.draw_planes(points, size, rules, &allowed);
        self.count_drawn(rules, kernels);
        let best = self.drawn.iter().copied().max_by(|a, b| a.share.total_cmp(&b.share));
        best.map_or(0.0, |best| self.improve(best, points, rules, &allowed, kernels).share)
    }

    /// Draws planes through three points.
    fn draw_planes(
        &mut self,
        points: &DisparityPoints,
        size: Vector2<f64>,
        rules: &HypothesisRules,
        allowed: &impl Fn(&PlaneCoefficients) -> bool,
    ) {
        let mut rng = SplitMix64::new(0x5eed_0001);
        for _ in 0..rules.draws * usize::from(points.len() >= 3) {
            if let Some(plane) = draw(points, size, &mut rng)
                && allowed(&plane)
            {
                self.drawn.push(Candidate { plane, share: 0.0 });
            }
        }
    }

    /// Counts all planes on a subset of the sample, and the planes that may be the best on the whole sample.
    fn count_drawn(&mut self, rules: &HypothesisRules, kernels: Kernels) {
        let tolerance_px = rules.tolerance_px;
        take_every(&self.sample, FEW_MAX, &mut self.few);
        let mut best = 0.0_f64;
        for drawn in &mut self.drawn {
            drawn.share = inlier_share(&self.few, &drawn.plane, tolerance_px, kernels);
            best = best.max(drawn.share);
        }
        if self.few.len() == self.sample.len() {
            return;
        }
        let limit = best - COUNT_SIGMAS * (best * (1.0 - best) / self.few.len() as f64).sqrt();
        for drawn in self.drawn.iter_mut().filter(|drawn| drawn.share >= limit) {
            drawn.share = inlier_share(&self.sample, &drawn.plane, tolerance_px, kernels);
        }
    }

    /// Refines the planes with the highest counts, and keeps the distinct ones.
    fn keep_best(
        &mut self,
        points: &DisparityPoints,
        size: Vector2<f64>,
        rules: &HypothesisRules,
        allowed: &impl Fn(&PlaneCoefficients) -> bool,
        kernels: Kernels,
    ) {
        let Self { drawn, order, .. } = self;
        order.clear();
        // The bit patterns of non-negative numbers have the order of the numbers. Of equal planes the earlier one is first.
        let key = |share: f64| u64::from(!(share as f32).to_bits()) << 32;
        order.extend(drawn.iter().enumerate().map(|(i, drawn)| key(drawn.share) | i as u64));
        order.sort_unstable();
        self.improved.clear();
        for i in 0..self.order.len() {
            if self.improved.len() == IMPROVED_MAX {
                break;
            }
            let drawn = self.drawn[self.order[i] as u32 as usize];
            let near = |known: &Candidate| difference(&known.plane, &drawn.plane, size) < rules.distinct_px;
            if !self.improved.iter().any(near) {
                let improved = self.improve(drawn, points, rules, allowed, kernels);
                self.improved.push(improved);
            }
        }
        self.improved.sort_by(|a, b| b.share.total_cmp(&a.share));
        for i in 0..self.improved.len() {
            self.push_distinct(self.improved[i], size, rules.distinct_px);
        }
        self.kept.truncate(rules.kept);
    }

    fn push_distinct(&mut self, candidate: Candidate, size: Vector2<f64>, distinct_px: f64) {
        match self.kept.iter_mut().find(|kept| difference(&kept.plane, &candidate.plane, size) < distinct_px) {
            Some(known) if candidate.share > known.share => *known = candidate,
            Some(_) => {}
            None => self.kept.push(candidate),
        }
    }

    /// Counts all planes again on the sample points that no kept plane explains; `false` if almost none remain.
    fn leave_explained_out(&mut self, rules: &HypothesisRules, kernels: Kernels) -> bool {
        let limit = 2.0 * rules.tolerance_px;
        let explained = |p: &Vector3<f64>| {
            self.kept.iter().any(|k| (p.z - (k.plane.x + k.plane.y * p.x + k.plane.z * p.y)).abs() < limit)
        };
        self.rest.clear();
        for i in 0..self.sample.len() {
            let point = self.sample.point(i);
            if !explained(&point) {
                self.rest.push(point.x as f32, point.y as f32, point.z as f32);
            }
        }
        self.rest.finish();
        std::mem::swap(&mut self.sample, &mut self.rest);
        let is_enough = self.sample.len() >= REST_MIN;
        if is_enough {
            self.count_drawn(rules, kernels);
        }
        is_enough
    }

    /// Least-squares steps over the points within the tolerance, as long as they improve the plane.
    fn improve(
        &self,
        start: Candidate,
        points: &DisparityPoints,
        rules: &HypothesisRules,
        allowed: &impl Fn(&PlaneCoefficients) -> bool,
        kernels: Kernels,
    ) -> Candidate {
        let mut best = Candidate { share: inlier_share(points, &start.plane, rules.tolerance_px, kernels), ..start };
        let mut plane = start.plane;
        for step in 0..rules.steps {
            let wide = rules.tolerance_px * if step == 0 { 1.5 } else { 1.0 };
            let Some(next) = fit(points, &plane, wide, kernels) else { break };
            if !allowed(&next) {
                break;
            }
            plane = next;
            let share = inlier_share(points, &plane, rules.tolerance_px, kernels);
            if share > best.share {
                best = Candidate { plane, share };
            }
        }
        best
    }
}

/// At most `count` points, evenly distributed.
fn take_every(points: &DisparityPoints, count: usize, out: &mut DisparityPoints) {
    out.clear();
    let step = points.len().div_ceil(count).max(1);
    for i in (0..points.len()).step_by(step) {
        out.push(points.x[i], points.y[i], points.d[i]);
    }
    out.finish();
}

/// The plane through three of the points; `None` if they are close to collinear.
fn draw(points: &DisparityPoints, size: Vector2<f64>, rng: &mut SplitMix64) -> Option<PlaneCoefficients> {
    let [p, q, r] = std::array::from_fn(|_| points.point(rng.below(points.len() as u32) as usize));
    let (u, v) = (q - p, r - p);
    let area = u.x * v.y - u.y * v.x;
    if area.abs() < 0.02 * size.x * size.y {
        return None;
    }
    let a = (u.z * v.y - u.y * v.z) / area;
    let b = (u.x * v.z - u.z * v.x) / area;
    Some(Vector3::new(p.z - a * p.x - b * p.y, a, b))
}

/// Largest difference of two planes at the corners of the box, pixels.
pub fn difference(p: &PlaneCoefficients, q: &PlaneCoefficients, size: Vector2<f64>) -> f64 {
    let d = p - q;
    let corners = [(0.0, 0.0), (size.x, 0.0), (0.0, size.y), (size.x, size.y)];
    corners.iter().map(|(x, y)| (d.x + d.y * x + d.z * y).abs()).fold(0.0, f64::max)
}

/// Mean over all points of `1 - min(residual^2 / tolerance^2, 1)`.
pub(super) fn inlier_share(
    points: &DisparityPoints,
    plane: &PlaneCoefficients,
    tolerance_px: f64,
    kernels: Kernels,
) -> f64 {
    if points.is_empty() {
        return 0.0;
    }
    let p = [plane.x as f32, plane.y as f32, plane.z as f32];
    let scale = (1.0 / (tolerance_px * tolerance_px)) as f32;
    f64::from(count_inliers(kernels, &points.x, &points.y, &points.d, p, scale)) / points.len() as f64
}

wide! {
    fn count_inliers(x: &[f32], y: &[f32], d: &[f32], plane: [f32; 3], scale: f32) -> f32 = count_inliers_kernel;
}

#[inline(always)]
fn count_inliers_kernel(x: &[f32], y: &[f32], d: &[f32], plane: [f32; 3], scale: f32) -> f32 {
    let mut sums = [0.0_f32; LANES];
    for ((x, y), d) in x.chunks_exact(LANES).zip(y.chunks_exact(LANES)).zip(d.chunks_exact(LANES)) {
        for i in 0..LANES {
            let residual = d[i] - (plane[0] + plane[1] * x[i] + plane[2] * y[i]);
            sums[i] += (1.0 - residual * residual * scale).max(0.0);
        }
    }
    sum_lanes(&sums)
}

/// Least squares over the points within `tolerance_px` of `plane`.
fn fit(
    points: &DisparityPoints,
    plane: &PlaneCoefficients,
    tolerance_px: f64,
    kernels: Kernels,
) -> Option<PlaneCoefficients> {
    let p = [plane.x as f32, plane.y as f32, plane.z as f32];
    let scale = (1.0 / (tolerance_px * tolerance_px)) as f32;
    let sums = normal_equations(kernels, &points.x, &points.y, &points.d, p, scale);
    if sums.w < 3.0 {
        return None;
    }
    let step = sums.step()?;
    step.iter().all(|v| v.is_finite()).then(|| plane + step)
}

wide! {
    fn normal_equations(x: &[f32], y: &[f32], d: &[f32], plane: [f32; 3], scale: f32) -> PlaneSums<f64> = normal_equations_kernel;
}

#[inline(always)]
fn normal_equations_kernel(x: &[f32], y: &[f32], d: &[f32], plane: [f32; 3], scale: f32) -> PlaneSums<f64> {
    let mut sums = PlaneSums::ZERO;
    for ((x, y), d) in x.chunks_exact(LANES).zip(y.chunks_exact(LANES)).zip(d.chunks_exact(LANES)) {
        for i in 0..LANES {
            let r = d[i] - (plane[0] + plane[1] * x[i] + plane[2] * y[i]);
            let w = if r * r * scale < 1.0 { 1.0 } else { 0.0 };
            sums.add(i, x[i], y[i], w, if w > 0.0 { r } else { 0.0 });
        }
    }
    sums.folded()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Box of the points.
    const SIZE: Vector2<f64> = Vector2::new(60.0, 40.0);

    /// Two thirds of the points on one plane, the rest on another, and some outliers.
    fn two_planes() -> DisparityPoints {
        let mut points = DisparityPoints::default();
        for y in 0..40 {
            for x in 0..60 {
                let (fx, fy) = (x as f32, y as f32);
                let d = match x {
                    0..40 => 20.0 + 0.05 * fx - 0.03 * fy + 0.1 * ((x * 7 + y * 3) % 5) as f32 - 0.2,
                    _ => 11.0 - 0.02 * fx + 0.04 * fy,
                };
                points.push(fx, fy, if (x + 11 * y) % 13 == 0 { ((x * y) % 40) as f32 } else { d });
            }
        }
        points.finish();
        points
    }

    const RULES: HypothesisRules =
        HypothesisRules { draws: 300, tolerance_px: 0.5, distinct_px: 1.0, kept: 6, steps: 3 };

    #[test]
    fn both_planes_are_found_the_larger_first_with_every_kernel() {
        let points = two_planes();
        for kernels in pb3dp_estimation_test_support::every_kernel() {
            let mut search = HypothesisSearch::default();
            search.run(&points, &[], SIZE, &RULES, |_| true, kernels);
            let expected = [Vector3::new(20.0, 0.05, -0.03), Vector3::new(11.0, -0.02, 0.04)];
            for (found, expected) in search.kept.iter().zip(expected) {
                assert!(difference(&found.plane, &expected, SIZE) < 0.15, "{found:?}");
            }
            assert!(search.kept[0].share > 0.5 && search.kept[1].share < 0.35);
        }
    }

    #[test]
    fn few_draws_tell_how_much_one_plane_explains() {
        let (points, rules) = (two_planes(), HypothesisRules { draws: 30, ..RULES });
        let mut search = HypothesisSearch::default();
        search.run(&points, &[], SIZE, &RULES, |_| true, Kernels::best());
        let best = search.kept[0].share;
        for kernels in pb3dp_estimation_test_support::every_kernel() {
            let mut search = HypothesisSearch::default();
            let share = search.best_share(&points, SIZE, &rules, |_| true, kernels);
            assert!((share - best).abs() < 0.01, "{share} of {best}");
            let second = search.best_share(&points, SIZE, &rules, |p| p.y < 0.0, kernels);
            assert!(second < 0.35 && second > 0.2, "{second}");
            assert_eq!(search.best_share(&points, SIZE, &rules, |_| false, kernels), 0.0);
        }
    }

    #[test]
    fn planes_that_are_not_allowed_are_not_found() {
        let mut search = HypothesisSearch::default();
        search.run(&two_planes(), &[], SIZE, &RULES, |p| p.y < 0.0, Kernels::best());
        assert!((search.kept[0].plane.x - 11.0).abs() < 0.2, "{:?}", search.kept[0]);
    }

    #[test]
    fn no_points_give_the_seeds_without_support() {
        let mut points = DisparityPoints::default();
        points.finish();
        let mut search = HypothesisSearch::default();
        search.run(&points, &[Vector3::new(5.0, 0.0, 0.0)], SIZE, &RULES, |_| true, Kernels::best());
        assert_eq!(search.kept.iter().map(|c| c.share).collect::<Vec<_>>(), [0.0]);
    }

    #[test]
    fn the_plane_nearby_is_that_of_least_squares() {
        let mut points = DisparityPoints::default();
        for (x, y) in (0..20).flat_map(|x| (0..15).map(move |y| (x as f32, y as f32))) {
            points.push(x, y, 5.0 + 0.1 * x - 0.05 * y + if (x + y) % 2.0 == 0.0 { 0.2 } else { -0.2 });
            points.push(x, y, 30.0);
        }
        points.finish();
        let start = Vector3::new(5.3, 0.08, -0.05);
        let found = points.nearby(&start, 1.0).expect("many points");
        assert!((found - Vector3::new(5.0, 0.1, -0.05)).norm() < 0.01, "{found}");
        assert_eq!(points.nearby(&Vector3::new(80.0, 0.0, 0.0), 1.0), None);
    }
}
