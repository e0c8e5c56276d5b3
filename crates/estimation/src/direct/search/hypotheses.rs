//! Planes through clouds of disparities: three points at a time, counted with a tight tolerance.
//!
//! Torr and Zisserman's MSAC (2000): a point counts by its squared residual, at most the tolerance's square. Sums of a score
//! over the region would prefer a plane that bridges two surfaces; counts with a tight tolerance do not.

use nalgebra::{Matrix3, Vector3};

use crate::cpu::Kernels;
use crate::search::rng::SplitMix64;
use crate::wide::{LANES, sum_lanes, wide};

/// Points `(x, y, d)` in single precision, padded to whole groups with points that count as outliers.
#[derive(Clone, Debug, Default)]
pub struct DisparityPoints {
    x: Vec<f32>,
    y: Vec<f32>,
    d: Vec<f32>,
    count: usize,
}

/// A disparity so far off that it is nobody's inlier.
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

    /// To be called after the last point.
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

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    fn point(&self, i: usize) -> Vector3<f64> {
        Vector3::new(f64::from(self.x[i]), f64::from(self.y[i]), f64::from(self.d[i]))
    }
}

/// `d = p.x + p.y x + p.z y`.
pub type PlaneCoefficients = Vector3<f64>;

/// A plane and how many points speak for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The plane.
    pub plane: PlaneCoefficients,
    /// Mean over all points of `1 - min(residual^2 / tolerance^2, 1)`: at most 1.
    pub share: f64,
}

/// How planes are drawn and counted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HypothesisRules {
    /// Number of three-point planes.
    pub draws: usize,
    /// Tolerance, pixels of the level.
    pub tolerance_px: f64,
    /// Planes that differ by less than this at the corners of the points' box are one, pixels of the level.
    pub distinct_px: f64,
    /// Most planes kept.
    pub kept: usize,
    /// Re-weighted steps of each kept plane.
    pub steps: usize,
}

/// Finds planes in points; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct HypothesisSearch {
    /// A part of the points, for counting.
    sample: DisparityPoints,
    drawn: Vec<Candidate>,
    /// The best planes, best first.
    pub kept: Vec<Candidate>,
}

/// Points that planes are counted on.
const SAMPLE_MAX: usize = 1024;

impl HypothesisSearch {
    /// Finds the planes of `points` that `allowed` lets pass; `seeds` are taken into account as they are. `size` is the box
    /// of the points.
    pub fn run(
        &mut self,
        points: &DisparityPoints,
        seeds: &[PlaneCoefficients],
        size: (f64, f64),
        rules: &HypothesisRules,
        allowed: impl Fn(&PlaneCoefficients) -> bool,
        kernels: Kernels,
    ) {
        self.drawn.clear();
        self.kept.clear();
        self.take_sample(points);
        for plane in seeds {
            self.count(plane, rules, kernels);
        }
        let mut rng = SplitMix64::new(0x5eed_0001);
        for _ in 0..rules.draws * usize::from(points.len() >= 3) {
            if let Some(plane) = draw(points, size, &mut rng)
                && allowed(&plane)
            {
                self.count(&plane, rules, kernels);
            }
        }
        // Stable, so that of equal planes the earlier is first.
        self.drawn.sort_by(|a, b| b.share.total_cmp(&a.share));
        for i in 0..self.drawn.len() {
            if self.kept.len() == rules.kept {
                break;
            }
            let drawn = self.drawn[i];
            let known = self.kept.iter().any(|k| difference(&k.plane, &drawn.plane, size) < rules.distinct_px);
            if !known {
                let improved = self.improve(drawn, points, rules, &allowed, kernels);
                self.kept.push(improved);
            }
        }
        self.kept.sort_by(|a, b| b.share.total_cmp(&a.share));
        self.unite(size, rules.distinct_px);
    }

    fn take_sample(&mut self, points: &DisparityPoints) {
        self.sample.clear();
        let step = points.len().div_ceil(SAMPLE_MAX).max(1);
        for i in (0..points.len()).step_by(step) {
            self.sample.push(points.x[i], points.y[i], points.d[i]);
        }
        self.sample.finish();
    }

    fn count(&mut self, plane: &PlaneCoefficients, rules: &HypothesisRules, kernels: Kernels) {
        let share = inlier_share(&self.sample, plane, rules.tolerance_px, kernels);
        self.drawn.push(Candidate { plane: *plane, share });
    }

    /// Steps of least squares over what lies within the tolerance, as long as they help.
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

    fn unite(&mut self, size: (f64, f64), distinct_px: f64) {
        let mut i = 0;
        while i < self.kept.len() {
            let plane = self.kept[i].plane;
            let mut j = i + 1;
            while j < self.kept.len() {
                if difference(&self.kept[j].plane, &plane, size) < distinct_px {
                    self.kept.remove(j);
                } else {
                    j += 1;
                }
            }
            i += 1;
        }
    }
}

/// The plane through three points of the cloud; `None` if they lie too close to a line.
fn draw(points: &DisparityPoints, size: (f64, f64), rng: &mut SplitMix64) -> Option<PlaneCoefficients> {
    let [p, q, r] = std::array::from_fn(|_| points.point(rng.below(points.len() as u32) as usize));
    let (u, v) = (q - p, r - p);
    let area = u.x * v.y - u.y * v.x;
    if area.abs() < 0.02 * size.0 * size.1 {
        return None;
    }
    let a = (u.z * v.y - u.y * v.z) / area;
    let b = (u.x * v.z - u.z * v.x) / area;
    Some(Vector3::new(p.z - a * p.x - b * p.y, a, b))
}

/// Largest difference of two planes at the corners of the box, pixels.
pub fn difference(p: &PlaneCoefficients, q: &PlaneCoefficients, (width, height): (f64, f64)) -> f64 {
    let d = p - q;
    let corners = [(0.0, 0.0), (width, 0.0), (0.0, height), (width, height)];
    corners.iter().map(|(x, y)| (d.x + d.y * x + d.z * y).abs()).fold(0.0, f64::max)
}

/// Mean over all points of `1 - min(residual^2 / tolerance^2, 1)`.
fn inlier_share(points: &DisparityPoints, plane: &PlaneCoefficients, tolerance_px: f64, kernels: Kernels) -> f64 {
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
    let s = normal_equations(kernels, &points.x, &points.y, &points.d, p, scale).map(f64::from);
    let h = Matrix3::new(s[0], s[1], s[2], s[1], s[3], s[4], s[2], s[4], s[5]);
    if s[0] < 3.0 {
        return None;
    }
    let step = h.cholesky()?.solve(&Vector3::new(s[6], s[7], s[8]));
    step.iter().all(|v| v.is_finite()).then(|| plane + step)
}

wide! {
    fn normal_equations(x: &[f32], y: &[f32], d: &[f32], plane: [f32; 3], scale: f32) -> [f32; 9] = normal_equations_kernel;
}

#[inline(always)]
fn normal_equations_kernel(x: &[f32], y: &[f32], d: &[f32], plane: [f32; 3], scale: f32) -> [f32; 9] {
    let mut sums = [[0.0_f32; LANES]; 9];
    for ((x, y), d) in x.chunks_exact(LANES).zip(y.chunks_exact(LANES)).zip(d.chunks_exact(LANES)) {
        for i in 0..LANES {
            let r = d[i] - (plane[0] + plane[1] * x[i] + plane[2] * y[i]);
            let w = if r * r * scale < 1.0 { 1.0 } else { 0.0 };
            let (wx, wy, wr) = (w * x[i], w * y[i], if w > 0.0 { r } else { 0.0 });
            sums[0][i] += w;
            sums[1][i] += wx;
            sums[2][i] += wy;
            sums[3][i] += wx * x[i];
            sums[4][i] += wx * y[i];
            sums[5][i] += wy * y[i];
            sums[6][i] += wr;
            sums[7][i] += wr * x[i];
            sums[8][i] += wr * y[i];
        }
    }
    std::array::from_fn(|k| sum_lanes(&sums[k]))
}
