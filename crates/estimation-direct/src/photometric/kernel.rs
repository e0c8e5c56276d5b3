//! The inner loop: compares points of the left eye with the right eye and sums up the normal equations.
//!
//! Unknown are the plane `(d0, du, dv)` and a row offset, shared by all channels, and of each channel a gain, and an offset for
//! every 128 points: light that does not turn with the surface, and highlights, differ between the eyes, but smoothly. What is
//! summed up is what these offsets leave of values, gradients and residuals.
//! With the gain split between the eyes, `r = s R(x - d, y + row) - L / s + offset`, the derivative by the logarithm of the
//! gain is the mean of both values. The derivative by the disparity is the gradient of the left eye alone: at a pixel, noise
//! of a value is independent of the noise of the slope, so noisy gradients do not move the place where the sums of `gradient x
//! residual` vanish. Between pixels it is not, because interpolation smooths noise by more the farther a pixel is: with the
//! right gradients a plane that faces the cameras, where all points lie at one fraction of a pixel, would be drawn to whole
//! pixels.
#![allow(clippy::needless_range_loop, reason = "several arrays are walked in step")]

mod compare;
mod scores;
mod sums;
#[cfg(test)]
mod tests;

use pb3dp_estimation_core::wide::LANES;
pub(crate) use scores::{Projection, Unmodelled, scores};
pub(crate) use sums::{ProductSums, SharpnessSums, Sums, accumulate};

/// Most channels: red, green and blue.
pub(crate) const CHANNELS_MAX: usize = 3;
/// Points that share an offset: ordered by blocks of 8 x 8 pixels, these 128 are neighbours. Chosen; no sweep is on record.
pub(crate) const SHARING: usize = 8 * LANES;
/// Value of pixels that must not be used in a channel; whatever touches one is left out. Far above what interpolation makes of grey levels.
pub(crate) const UNUSABLE: f32 = 1e6;
/// Values from here on have been touched: a weight of 1 % of an unusable pixel is enough, and grey levels stay far below. Chosen.
pub(crate) const TOUCHED: f32 = 0.01 * UNUSABLE;

/// Points of the left eye, in groups of [`SHARING`]; the last group is filled up with points of no weight.
#[derive(Clone, Debug, Default)]
pub(crate) struct PointSet {
    /// Column and row relative to the centre of the points, pixels of the level.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    /// 1, or 0 for a point that only fills up a group.
    pub unit: Vec<f32>,
    /// 1 for a point well inside the region, else 0.
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

/// What a channel is compared with.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ChannelState {
    /// Square root of the gain: the right values are multiplied, the left ones divided by it.
    pub gain_root: f64,
    /// Added to the difference, grey levels.
    pub offset: f64,
    /// Variance of the residuals of good points, squared grey levels.
    pub variance: f64,
}

/// A [`ChannelState`] for the inner loop.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Shade {
    /// Right values and left values are multiplied by these.
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

/// Where the points are looked up and how they are weighted.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warp {
    /// Right column of the centre.
    pub column: f32,
    /// Right columns per left column and per left row.
    pub per_x: f32,
    pub per_y: f32,
    /// Row offset not yet in the right planes, pixels.
    pub row: f32,
    /// Columns of the right planes.
    pub width: usize,
    /// Number of channels.
    pub channels: usize,
    pub shades: [Shade; CHANNELS_MAX],
    /// Variance of the place at which a pixel samples the scene, squared pixels: gradient times this is noise.
    pub place_variance: f32,
    /// Tukey's limit of the sum over the channels of squared residuals over variances.
    pub limit: f32,
}

/// Which groups of points take part: every `step`th, from the first on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Thinning {
    pub step: usize,
}

impl Thinning {
    /// All points.
    pub const NONE: Self = Self { step: 1 };
}
