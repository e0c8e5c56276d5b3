//! Covariance of a refined plane.
//!
//! The residuals of neighbouring pixels are not independent: smoothing correlates them over a few pixels, and on real surfaces
//! relief, shading and lens errors correlate them over tens. The covariance is therefore a sandwich `H^-1 M H^-1`, where `M` is
//! the sum of the outer products of the scores of blocks of 8 x 8 pixels. If pixels were independent beyond a block, blocks of
//! twice the side would give the same `M` except for chance. If they give more, the same growth is assumed for each further
//! doubling, up to blocks of four and eight times the side. With pure noise this changes little; on real surfaces sigma grows
//! by a factor of two to three.

use nalgebra::{Matrix3, Matrix4, Vector2, Vector4};

pub(super) use super::super::cramer_rao::calibration_covariance as calibration;
use super::RefineConfig;
use super::kernel::Unmodelled;

/// Smallest number of large blocks for an estimate of long-range correlation. Chosen by hand, not varied: by chance, the
/// growth from 16 blocks scatters by 20 % (sqrt(2 / (3 x 16))).
const LARGE_BLOCKS_MIN: usize = 16;
/// Number of further doublings with the growth from small to large blocks. Chosen by hand: on ray-traced pairs it gave a
/// third of the NEES as 0.7 to 1.5.
const DOUBLINGS: f64 = 2.0;
/// Largest growth of the covariance per doubling. Chosen by hand, not varied: four small blocks with equal scores would
/// give 4.
const GROWTH_MAX: f64 = 3.0;
/// Number of fitted parameters and photometric states: three of the plane, a row offset, a gain and an offset.
const FITTED: f64 = 6.0;

/// Mean square over squared mean of the sizes of four-parameter scores that differ by chance alone. The sizes are chi-squared
/// with four degrees of freedom: mean square 24, mean 4, and 24 / 16 = 1.5.
const CHANCE_OF_SIZES: f64 = 1.5;

/// Scores of every block of points with respect to `(d0, du, dv, row)`.
#[derive(Clone, Debug, Default)]
pub(super) struct BlockPulls {
    small: Vec<((u32, u32), Vector4<f64>)>,
    large: Vec<Vector4<f64>>,
    used: Vec<bool>,
}

impl BlockPulls {
    /// Sums the scores of points by block; `ends` is one past the last point of every block.
    pub fn sum(&mut self, scores: &[Vec<f32>; 4], ends: &[usize], places: &[(u32, u32)]) {
        self.small.clear();
        let mut first = 0;
        for (&end, &place) in ends.iter().zip(places) {
            let pull: [f64; 4] = std::array::from_fn(|k| scores[k][first..end].iter().map(|s| f64::from(*s)).sum());
            self.small.push((place, Vector4::from(pull)));
            first = end;
        }
    }

    /// Covariance of `(d0, du, dv)`. `matrix` is the derivative of the summed scores with respect to the parameters, and
    /// `row_information` is the prior information on the row offset. `None` if the matrix has no inverse.
    pub fn covariance(&mut self, matrix: &Matrix4<f64>, row_information: f64) -> Option<Matrix3<f64>> {
        let inverse = matrix.try_inverse()?;
        let sum = products(self.small.iter().map(|(_, pull)| pull));
        let growth = self.growth(&inverse, &sum);
        let count = self.effective_count(&inverse);
        let mut middle = sum * (count / (count - FITTED).max(1.0)) * growth.powf(DOUBLINGS);
        middle[(3, 3)] += row_information;
        let full = inverse * middle * inverse.transpose();
        let covariance = full.fixed_view::<3, 3>(0, 0).into_owned();
        Some((covariance + covariance.transpose()) * 0.5)
    }

    /// Effective number of blocks, if all scores had equal size: a few edges in an otherwise blank region are few blocks.
    fn effective_count(&self, inverse: &Matrix4<f64>) -> f64 {
        let sizes = self.small.iter().map(|(_, pull)| pull.dot(&(inverse * pull)));
        let (sum, squares) = sizes.fold((0.0, 0.0), |(sum, squares), size| (sum + size, squares + size * size));
        let count = self.small.len() as f64;
        if squares > 0.0 { (CHANCE_OF_SIZES * sum * sum / squares).min(count) } else { count }
    }

    /// Growth of the covariance with blocks of twice the side, beyond chance, at least 1; `small` is the sum of the products of
    /// the small blocks.
    fn growth(&mut self, inverse: &Matrix4<f64>, small: &Matrix4<f64>) -> f64 {
        let columns = self.small.iter().map(|(place, _)| place.0 / 2 + 1).max().unwrap_or(0) as usize;
        let rows = self.small.iter().map(|(place, _)| place.1 / 2 + 1).max().unwrap_or(0) as usize;
        self.large.clear();
        self.large.resize(columns * rows, Vector4::zeros());
        self.used.clear();
        self.used.resize(columns * rows, false);
        for (place, pull) in &self.small {
            let at = (place.1 / 2) as usize * columns + (place.0 / 2) as usize;
            self.large[at] += pull;
            self.used[at] = true;
        }
        let used = self.large.iter().zip(&self.used).filter(|(_, used)| **used).map(|(pull, _)| pull);
        let count = used.clone().count();
        if count < LARGE_BLOCKS_MIN {
            return 1.0;
        }
        let size = |middle: &Matrix4<f64>| (inverse * middle).fixed_view::<3, 3>(0, 0).trace();
        // One standard deviation, by chance, of a sum of squares of three numbers per block.
        let chance = (2.0 / (3.0 * count as f64)).sqrt();
        let ratio = size(&products(used)) / size(small) - chance;
        if ratio.is_finite() { ratio.clamp(1.0, GROWTH_MAX) } else { 1.0 }
    }
}

/// Sum of the outer products.
fn products<'a>(pulls: impl Iterator<Item = &'a Vector4<f64>>) -> Matrix4<f64> {
    pulls.fold(Matrix4::zeros(), |sum, pull| sum + pull * pull.transpose())
}

/// Converts from pixels of a level to full-size pixels.
pub(super) fn at_full_size(covariance: &Matrix3<f64>, scale: f64) -> Matrix3<f64> {
    let s = Matrix3::from_diagonal(&nalgebra::Vector3::new(scale, 1.0, 1.0));
    s * covariance * s
}

/// The covariance of the same plane with its reference pixel moved by `by`.
pub(super) fn moved(covariance: &Matrix3<f64>, by: &Vector2<f64>) -> Matrix3<f64> {
    let m = Matrix3::new(1.0, by.x, by.y, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    m * covariance * m.transpose()
}

/// Covariance of `(d0, du, dv)` due to unmodelled differences between the images, in pixels of a level of this scale. They are:
/// a row offset that differs at the ends of the region (with these half sides) from its centre by the residual calibration
/// error, and edges with different blur. `inverse` is that of the normal equations.
pub(super) fn unmodelled(
    inverse: &Matrix4<f64>,
    scores: &Unmodelled,
    config: &RefineConfig,
    half: &Vector2<f64>,
    scale: f64,
) -> Matrix3<f64> {
    let by_half = half.map(|half| config.calibration_sigma_px / scale / half.max(1.0));
    let blur_px2 = config.blur_sigma_px2 / (scale * scale);
    let Unmodelled { row_by_column, row_by_row, blur } = *scores;
    let parts = [(row_by_column, by_half.x), (row_by_row, by_half.y), (blur, blur_px2)];
    parts.into_iter().fold(Matrix3::zeros(), |sum, (scores, sigma)| {
        let moved = (inverse * Vector4::from(scores) * sigma).xyz();
        sum + moved * moved.transpose()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a 96 x 96 region; every point has the score `pull(x, y)` for each parameter.
    fn covariance(pull: impl Fn(usize, usize) -> f64) -> f64 {
        let mut scores: [Vec<f32>; 4] = Default::default();
        let (mut ends, mut places) = (Vec::new(), Vec::new());
        for (by, bx) in (0..12).flat_map(|by| (0..12).map(move |bx| (by, bx))) {
            for (y, x) in (0..8).flat_map(|y| (0..8).map(move |x| (8 * by + y, 8 * bx + x))) {
                let (u, v) = ((x as f64 - 47.5) / 27.7, (y as f64 - 47.5) / 27.7);
                for (k, factor) in [1.0, u, v, 0.3].into_iter().enumerate() {
                    scores[k].push((factor * pull(x, y)) as f32);
                }
            }
            ends.push(scores[0].len());
            places.push((bx as u32, by as u32));
        }
        let mut pulls = BlockPulls::default();
        pulls.sum(&scores, &ends, &places);
        pulls.covariance(&(Matrix4::identity() * 9216.0), 0.0).unwrap().trace() / 3.0
    }

    fn noise(x: usize, y: usize) -> f64 {
        let mut z = (x as u64 * 7919 + y as u64 * 104_729).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64 - 0.5) * 12f64.sqrt()
    }

    #[test]
    fn independent_noise_gives_the_inverse_of_the_information() {
        let relative = covariance(noise) * 9216.0;
        assert!((0.8..1.5).contains(&relative), "{relative}");
    }

    #[test]
    fn noise_that_is_alike_over_many_pixels_counts_as_one() {
        // Squares of 4 pixels: 16 times the variance. Squares of 24 pixels: 576 times, of which small blocks detect 64.
        let near = covariance(|x, y| noise(x / 4, y / 4)) * 9216.0;
        assert!((12.0..26.0).contains(&near), "{near}");
        let far = covariance(|x, y| noise(x / 24, y / 24)) * 9216.0;
        assert!((290.0..1200.0).contains(&far), "{far}");
    }

    /// Nine of 144 blocks have non-zero scores: with six fitted parameters this is few, and the correction is significant.
    #[test]
    fn few_edges_are_few_blocks() {
        let is_edge = |x: usize, y: usize| (x / 8).is_multiple_of(4) && (y / 8).is_multiple_of(4);
        let blank = covariance(|x, y| if is_edge(x, y) { 4.0 * noise(x, y) } else { 0.0 }) * 9216.0;
        assert!((1.4..9.0).contains(&blank), "{blank}, evenly spread 1");
    }

    #[test]
    fn a_covariance_moves_with_the_plane() {
        let c = calibration(0.1, &Vector2::new(40.0, 20.0));
        let there = moved(&c, &Vector2::new(40.0, -20.0));
        assert!((there[(0, 0)] - 0.03).abs() < 1e-12 && (there[(1, 1)] - c[(1, 1)]).abs() < 1e-15);
        assert!((at_full_size(&c, 4.0)[(0, 0)] - 0.16).abs() < 1e-12);
    }
}
