//! Directions of motion that the images show.
//!
//! The noise of a stored view has gradients, too. The normal equations take them for texture, so that even the spin of a disc with rings
//! seems to be known to a twentieth of a degree. This module computes the information that noise alone would give, and compares.

use nalgebra::{Matrix6, Vector6};

use super::kernels::{CHANNELS, PairWeights, ResidualGroup, SampledGroup, SurfaceGroup, TERMS, derivatives};
use super::lanes::Lanes;
use pb3dp_estimation_core::wide::wide;

/// Number of unknowns of the motion.
const MOTION: usize = 6;
/// Entries of the upper triangle.
const TRIANGLE: usize = MOTION * (MOTION + 1) / 2;

/// Variance of a gradient of a stored view, relative to that of a value. Values are smoothed by cubic B-splines, whose squared weights at
/// a pixel, 1/6, 4/6 and 1/6, have the sum 1/2; a gradient is half of the difference of two values that are 2 px apart, which share one
/// pixel with the weight 1/6 in both: (1/2 + 1/2 - 2/36) / 4 / (1/2).
const GRADIENT_VARIANCE: f32 = 17.0 / 36.0;
/// Smallest ratio of the information about an observed direction to that of noise alone. Interpolation and the limits of the sensor leave
/// patterns beside the noise. Chosen with the rendered targets of `observed_directions.rs` with noise of 0.3, 1.5 and 5 grey levels:
/// directions that rings and stripes do not show have 0.2 to 1.0, all directions of the textured targets at least 15; most of one edge is
/// between 0.3 and 2.4.
const RATIO_MIN: f64 = 3.0;

/// The noise of a view is at most this many times what its smoothest quarter shows, in variance. Compressed images have more noise where they
/// have texture. Chosen with figures: with 4, the targets of `observed_directions.rs` have the same answers with noise of 0.3, 1.5 and 5 grey
/// levels, and as JPEG of quality 95, 80 and 60, as without this limit; with 1, stripes as JPEG of quality 95 become `ok`.
const VIEW_NOISE_MAX: f32 = 4.0;

wide! {
    /// Upper triangle of the information about the motion that a gradient of variance 1 in both directions of the view gives, with these
    /// weights of the three differences.
    pub(super) fn noise_information(surface: &[SurfaceGroup], sampled: &[[SampledGroup; 2]], residuals: &[ResidualGroup], weights: &[f32; TERMS]) -> [f32; TRIANGLE] = noise_kernel;
}

#[inline(always)]
fn noise_kernel(
    surface: &[SurfaceGroup],
    sampled: &[[SampledGroup; 2]],
    residuals: &[ResidualGroup],
    weights: &[f32; TERMS],
) -> [f32; TRIANGLE] {
    let mut sums = [Lanes::ZERO; TRIANGLE];
    let along = [[Lanes::splat(1.0), Lanes::ZERO], [Lanes::ZERO, Lanes::splat(1.0)]];
    for ((surface, sampled), residual) in surface.iter().zip(sampled).zip(residuals) {
        let pair = residual.weight[2].scale(weights[2]);
        let left = residual.weight[0].scale(weights[0]) + pair;
        let right = residual.weight[1].scale(weights[1]) + pair;
        for gradient in &along {
            let in_left = derivatives(surface, &sampled[0], gradient, 0);
            let in_right = derivatives(surface, &sampled[1], gradient, 1);
            let mut entry = 0;
            for i in 0..MOTION {
                let by_left = left * in_left[i] - pair * in_right[i];
                let by_right = right * in_right[i] - pair * in_left[i];
                for j in i..MOTION {
                    sums[entry] = sums[entry].plus(by_left, in_left[j]).plus(by_right, in_right[j]);
                    entry += 1;
                }
            }
        }
    }
    sums.map(|lanes| lanes.sum())
}

/// Weights of the three differences for the noise of the view's gradients. The noise of a view is that of one image: half of the
/// variance of the difference between left and right, or less if the view itself shows less, because sharp edges differ by more than noise
/// when they are a fraction of a pixel off. (The difference from the view contains it only times the gain of the channel:
/// a grey target has colours of noise alone, which have the gain 0.)
pub(super) fn noise_weights(
    weights: &PairWeights,
    pair_variance: &[f32; CHANNELS],
    view_variance: &[f32; CHANNELS],
) -> [f32; TERMS] {
    let noise: [f32; CHANNELS] =
        std::array::from_fn(|c| GRADIENT_VARIANCE * (0.5 * pair_variance[c]).min(VIEW_NOISE_MAX * view_variance[c]));
    weights.by_term.map(|by_channel| by_channel.iter().zip(noise).map(|(weight, noise)| weight * noise).sum())
}

/// The symmetric matrix of an upper triangle.
pub(super) fn symmetric(triangle: &[f32; TRIANGLE]) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    let mut entries = triangle.iter();
    for i in 0..MOTION {
        for j in i..MOTION {
            let entry = f64::from(entries.next().copied().unwrap_or_default());
            (matrix[(i, j)], matrix[(j, i)]) = (entry, entry);
        }
    }
    matrix
}

/// What the images show of a motion `xi = [rho; phi]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shown {
    /// Covariance without the information that noise seems to give.
    pub(super) covariance: Matrix6<f64>,
    /// Takes the directions that the images do not show out of a motion.
    pub(super) keep: Matrix6<f64>,
    /// Whether there are such directions.
    pub(super) is_partial: bool,
}

impl Shown {
    /// Divides the information of a covariance into what the images show and what noise explains. `prior` is the information of a
    /// motion without images. `None` for matrices that are not positive definite.
    pub(super) fn of(covariance: &Matrix6<f64>, noise: &Matrix6<f64>, prior: &Vector6<f64>) -> Option<Self> {
        let prior = Matrix6::from_diagonal(prior);
        let information = covariance.try_inverse()? - prior;
        let lower = noise.cholesky()?.l();
        let lower_inverse = lower.try_inverse()?;
        let relative = lower_inverse * information * lower_inverse.transpose();
        let eigen = (0.5 * (relative + relative.transpose())).symmetric_eigen();
        let ratio = eigen.eigenvalues;
        let is_shown = ratio.map(|ratio| if ratio >= RATIO_MIN { 1.0 } else { 0.0 });
        let basis = lower * eigen.eigenvectors;
        let shown =
            basis * Matrix6::from_diagonal(&ratio.add_scalar(-1.0).component_mul(&is_shown)) * basis.transpose();
        let back = lower_inverse.transpose() * eigen.eigenvectors;
        let keep = back * Matrix6::from_diagonal(&is_shown) * basis.transpose();
        let covariance = (shown + prior).cholesky()?.inverse();
        let is_finite = covariance.iter().chain(keep.iter()).all(|x| x.is_finite());
        is_finite.then_some(Self { covariance, keep, is_partial: is_shown.min() < 1.0 })
    }
}
