//! Acceptance test: whether an alignment has found the target.

use std::fmt;

use pb3dp_estimation_core::wide::LANES;

use super::distinct::beyond_chance;
use super::kernels::{CHANNELS, ResidualGroup, SampledGroup, TERMS, ViewGroup};
use crate::kernels::{Correlation, Moments};

/// Smallest robust weight of an inlier. Chosen by hand, not varied: the weight at 2 standard deviations is 0.31, (1 - (2 /
/// `kernels::TUKEY`)^2)^2.
pub(super) const FITS_FROM: f32 = 0.3;

/// Inlier share of plane and relief required in the first pair if the plane search found no plane. Chosen by hand, not
/// varied: with less, a relief bent to fit other texture is followed.
const SURFACE_INLIERS_MIN: f64 = 0.7;
/// Correlation required in this case. Chosen by hand, not varied: as for the inliers.
const SURFACE_CORRELATION_MIN: f64 = 0.85;
/// Share of the points that the right image must show in this case. Chosen by hand, not varied: as for the inliers.
const SURFACE_VISIBLE_MIN: f64 = 0.8;
/// Number of standard deviations by which the correlation must exceed chance in this case: each patch of the relief is
/// tested at many disparities. Chosen by hand: without such a limit 8 of 15 regions in pairs of unrelated soft images were
/// tracked with `ok`.
const SURFACE_BEYOND_CHANCE_MIN: f64 = 8.0;
/// Images disagree if the smallest of the inlier shares is below this ratio of the largest. Chosen by hand, not varied:
/// with less, a mirrored tilt may stay; with more, the mirrored pose is tried more often, which takes time.
const AGREEMENT_MIN: f64 = 0.85;

/// Quality of the fit of a stored view to both images.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Fit {
    /// Share of the model's points visible in the view and in each image, left and right, 0 to 1.
    pub visible_share: [f64; 2],
    /// Share of these points that fit within the noise: view against left image, view against right image, left against right.
    pub inlier_share: [f64; TERMS],
    /// Correlation of the view with each image over the inliers, -1 to 1.
    pub correlation: [f64; 2],
    /// Expected correlation if noise were the only disturbance.
    pub correlation_expected: [f64; 2],
}

/// Limits for a fit.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    pub(super) inlier_share_min: f64,
    /// As a share of the expected correlation.
    pub(super) correlation_min: f64,
    pub(super) visible_share_min: f64,
}

impl Limits {
    /// The limits, scaled by a factor for a stricter test.
    pub(super) fn stricter(self, factor: f64) -> Self {
        Self {
            inlier_share_min: (self.inlier_share_min * factor).min(0.95),
            correlation_min: (self.correlation_min * factor).min(0.95),
            ..self
        }
    }
}

/// The first limit that a fit misses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Misfit {
    what: &'static str,
    percent: f64,
    limit_percent: f64,
}

impl fmt::Display for Misfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} is {:.0} % (limit {:.0} %)", self.what, self.percent, self.limit_percent)
    }
}

impl Fit {
    /// Measures the fit on one level; `correlations` are weighted, `reference` are the residual variances of a fitting target.
    pub(super) fn measure(
        sampled: &[[SampledGroup; 2]],
        view: &[ViewGroup],
        residuals: &[ResidualGroup],
        correlations: &[Correlation; 2],
        points: f64,
        reference: &[[f32; CHANNELS]; TERMS],
    ) -> Self {
        let (mut visible, mut inliers) = ([0_u32; TERMS], [0_u32; TERMS]);
        for ((sampled, view), residual) in sampled.iter().zip(view).zip(residuals) {
            let valid = [0, 1].map(|side| sampled[side].valid * view.valid);
            let valid = [valid[0], valid[1], valid[0] * valid[1]];
            for term in 0..TERMS {
                for i in 0..LANES {
                    visible[term] += u32::from(valid[term].0[i] > 0.0);
                    inliers[term] += u32::from(residual.weight[term].0[i] >= FITS_FROM);
                }
            }
        }
        let (visible, inliers) = (visible.map(f64::from), inliers.map(f64::from));
        let expected = |side: usize| {
            let Moments { view: kept, image: now, .. } = correlations[side].moments();
            let noise: f64 = reference[side].iter().map(|&v| f64::from(v)).sum();
            (1.0 - 0.5 * noise / (kept * now).sqrt().max(1e-9)).max(0.05)
        };
        Self {
            visible_share: [0, 1].map(|side| visible[side] / points.max(1.0)),
            inlier_share: std::array::from_fn(|term| inliers[term] / visible[term].max(1.0)),
            correlation: [0, 1].map(|side| correlations[side].value()),
            correlation_expected: [0, 1].map(expected),
        }
    }

    /// The first limit that the fit misses.
    pub(super) fn misfit(&self, limits: &Limits) -> Option<Misfit> {
        const SIDES: [&str; 2] = ["left", "right"];
        const VISIBLE: [&str; 2] =
            ["the visible share of the target in the left image", "the visible share of the target in the right image"];
        const INLIERS: [&str; TERMS] = [
            "the inlier share of the target's points in the left image",
            "the inlier share of the target's points in the right image",
            "the inlier share of the target's points between left and right image",
        ];
        const CORRELATION: [&str; 2] = [
            "the correlation with the left image, relative to its noise limit,",
            "the correlation with the right image, relative to its noise limit,",
        ];
        let short = |what, value: f64, limit: f64| {
            (value.is_nan() || value < limit).then_some(Misfit {
                what,
                percent: 100.0 * value,
                limit_percent: 100.0 * limit,
            })
        };
        for side in 0..SIDES.len() {
            let relative = self.correlation[side] / self.correlation_expected[side];
            let misfit = short(VISIBLE[side], self.visible_share[side], limits.visible_share_min)
                .or_else(|| short(INLIERS[side], self.inlier_share[side], limits.inlier_share_min))
                .or_else(|| short(CORRELATION[side], relative, limits.correlation_min));
            if misfit.is_some() {
                return misfit;
            }
        }
        short(INLIERS[2], self.inlier_share[2], limits.inlier_share_min)
    }

    /// Whether the first pair certainly shows one surface; used if no plane was found. Its texture has this many `independent`
    /// points. The test is needed because a relief can be deformed until soft texture fits any other.
    pub(super) fn is_a_surface(&self, independent: f64) -> bool {
        let (share, correlation) = (self.inlier_share[1], self.correlation[1]);
        share >= SURFACE_INLIERS_MIN
            && correlation >= SURFACE_CORRELATION_MIN
            && self.visible_share[1] >= SURFACE_VISIBLE_MIN
            && beyond_chance(correlation, share * self.visible_share[1], independent) >= SURFACE_BEYOND_CHANCE_MIN
    }

    /// Whether the view fits one image clearly better than the other, or better than the images fit each other.
    pub(super) fn images_disagree(&self) -> bool {
        let (low, high) = self.inlier_share.iter().fold((1.0_f64, 0.0_f64), |(a, b), &x| (a.min(x), b.max(x)));
        low < AGREEMENT_MIN * high
    }

    /// Scalar quality for comparing fits of the same surface.
    pub(super) fn goodness(&self) -> f64 {
        self.inlier_share[0] * self.inlier_share[1] * self.correlation[0].max(0.0) * self.correlation[1].max(0.0)
    }
}
