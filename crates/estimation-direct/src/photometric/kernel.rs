//! The inner loop: compares points of the left image with the right image and accumulates the normal equations.
//!
//! The unknowns are the plane `(d0, du, dv)` and a row offset, shared by all channels, and per channel a gain, and an offset
//! for every 128 points: light that does not rotate with the surface, and highlights, differ between the cameras, but smoothly.
//! The sums contain values, gradients and residuals after elimination of these offsets.
//! With the gain split between the images, `r = s R(x - d, y + row) - L / s + offset`, the derivative with respect to the
//! logarithm of the gain is the mean of both values. The derivative with respect to the disparity uses the gradient of the left
//! image alone. At a pixel, the noise of a value is independent of the noise of the slope, so noisy gradients do not move the
//! point at which the sums of `gradient x residual` vanish. Between pixels they are not independent, because interpolation
//! smooths noise more the farther a pixel is. With the right gradients, a plane that faces the cameras, where all points have
//! the same sub-pixel fraction, would be drawn to whole pixels.
#![allow(clippy::needless_range_loop, reason = "several arrays are walked in step")]

mod compare;
mod scores;
mod sums;
#[cfg(test)]
mod tests;

use pb3dp_estimation_core::wide::LANES;
pub(crate) use scores::{Projection, Unmodelled, scores};
pub(crate) use sums::{ProductSums, SharpnessSums, Sums, accumulate};

/// Largest number of channels: red, green and blue.
pub(crate) const CHANNELS_MAX: usize = 3;
/// Number of points that share an offset: ordered by blocks of 8 x 8 pixels, these 128 are neighbours. Chosen by hand, not
/// varied: with more points, shading inside a group tilts the plane; with fewer, offsets take information from the plane.
pub(crate) const SHARING: usize = 8 * LANES;
/// Value of unusable pixels in a channel; every point whose kernel touches one is excluded. Far above any interpolated grey
/// level.
pub(crate) const UNUSABLE: f32 = 1e6;
/// Values from here on were touched: a weight of 1 % of an unusable pixel is enough. Chosen by hand: grey levels stay far
/// below.
pub(crate) const TOUCHED: f32 = 0.01 * UNUSABLE;

/// Points of the left image, in groups of [`SHARING`]; the last group is padded with points of no weight.
#[derive(Clone, Debug, Default)]
pub(crate) struct PointSet {
    /// Column and row relative to the centre of the points, pixels of the level.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    /// 1, or 0 for a padding point.
    pub unit: Vec<f32>,
    /// 1 for a point well inside the region, otherwise 0.
    pub inner: Vec<f32>,
    /// Index of the point in the planes of the left part.
    pub at: Vec<u32>,
    /// First index of the point's row in the right planes.
    pub row_start: Vec<u32>,
    /// Value (or [`UNUSABLE`]), gradients along columns and rows, and second derivative along columns, per channel.
    pub value: [Vec<f32>; CHANNELS_MAX],
    pub gradient_x: [Vec<f32>; CHANNELS_MAX],
    pub gradient_y: [Vec<f32>; CHANNELS_MAX],
    pub curvature: [Vec<f32>; CHANNELS_MAX],
}

/// Photometric state of a channel.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ChannelState {
    /// Square root of the gain: the right values are multiplied by it, the left ones divided.
    pub gain_root: f64,
    /// Added to the difference, grey levels.
    pub offset: f64,
    /// Variance of the residuals of inliers, squared grey levels.
    pub variance: f64,
}

/// A [`ChannelState`] in the form used by the inner loop.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Shade {
    /// Factors of the right values and of the left values.
    pub right: f32,
    pub left: f32,
    pub offset: f32,
    pub variance: f32,
}

impl From<&ChannelState> for Shade {
    fn from(state: &ChannelState) -> Self {
        Self {
            right: state.gain_root as f32,
            left: (1.0 / state.gain_root) as f32,
            offset: state.offset as f32,
            variance: state.variance as f32,
        }
    }
}

/// Mapping of the points into the right planes, and their weighting.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warp {
    /// Right column of the centre.
    pub column: f32,
    /// Change of the right column per left column and per left row.
    pub per_x: f32,
    pub per_y: f32,
    /// Row offset not yet applied to the right planes, pixels.
    pub row: f32,
    /// Columns of the right planes.
    pub width: usize,
    /// Number of channels.
    pub channels: usize,
    pub shades: [Shade; CHANNELS_MAX],
    /// Variance of the sampling position of a pixel, squared pixels: gradient times this is noise.
    pub place_variance: f32,
    /// Tukey's limit for the sum over the channels of squared residuals divided by variances.
    pub limit: f32,
}

/// Selection of the groups of points: every `step`th, starting with the first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Thinning {
    pub step: usize,
}

impl Thinning {
    /// All points.
    pub const NONE: Self = Self { step: 1 };
}
