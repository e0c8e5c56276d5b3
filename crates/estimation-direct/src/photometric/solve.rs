//! Solution of the normal equations: eliminates the gain of every channel (its offsets are already eliminated) and adds the
//! channels.

use nalgebra::{Matrix4, Vector2, Vector4};

use super::kernel::{CHANNELS_MAX, ChannelState, ProductSums, Projection, Sums};

/// Prior standard deviation of the logarithm of the gain; it bounds channels without contrast. Chosen by hand, not varied:
/// about ln 2, a factor of two between the cameras.
const LOG_GAIN_SIGMA: f64 = 0.7;
/// Bounds of the square root of the gain. Chosen by hand, not varied: gains of 1/4 to 4.
const GAIN_ROOT_MIN: f64 = 0.5;
const GAIN_ROOT_MAX: f64 = 2.0;
/// Smallest share of the squared gradients that counts as texture and not as noise. Chosen by hand, not varied: a channel of noise
/// keeps 5 % of its information.
const RELIABILITY_MIN: f64 = 0.05;

/// The normal equations of `(d0, du, dv, row)` of one level.
#[derive(Clone, Copy, Debug)]
pub(super) struct Normal {
    /// Gauss-Newton matrix, corrected for the noise of the gradients.
    pub matrix: Matrix4<f64>,
    /// Derivative of half the cost.
    pub slope: Vector4<f64>,
    parts: [Part; CHANNELS_MAX],
}

/// One channel's gain, and the offset about which residuals are weighted.
#[derive(Clone, Copy, Debug, Default)]
struct Part {
    /// For the logarithm of the gain: cross terms with the parameters, inverse of its own term, and derivative.
    cross: Vector4<f64>,
    inverse: f64,
    slope: f64,
    offset: OffsetPart,
    weight: f64,
}

/// Terms that determine the change of the offset.
#[derive(Clone, Copy, Debug, Default)]
struct OffsetPart {
    /// Derivatives of the sum of weighted residuals with respect to the parameters and to the logarithm of the gain.
    by_step: Vector4<f64>,
    by_gain: f64,
    /// The sum of weighted residuals, and the sum of weights.
    residuals: f64,
    weights: f64,
}

/// Share of the squared gradients of a channel that is texture: the gradients of both images agree, their noise does not.
pub(super) fn reliability(sums: &ProductSums<f64>) -> f64 {
    let ratio = if sums.gg > 0.0 { sums.gs / sums.gg } else { 0.0 };
    ratio.clamp(RELIABILITY_MIN, 1.0)
}

impl Normal {
    /// Builds the normal equations from the sums of `channels` channels with their states and weights.
    pub fn of(
        sums: &Sums,
        channels: usize,
        states: &[ChannelState; CHANNELS_MAX],
        weights: &[f64; CHANNELS_MAX],
    ) -> Self {
        let mut normal = Self { matrix: Matrix4::zeros(), slope: Vector4::zeros(), parts: Default::default() };
        for c in 0..channels {
            let (p, s) = (&sums.channel[c].products, &sums.channel[c].singles);
            let own = Matrix4::new(
                p.gg, p.gg_x, p.gg_y, -p.gh, //
                p.gg_x, p.gg_xx, p.gg_xy, -p.gh_x, //
                p.gg_y, p.gg_xy, p.gg_yy, -p.gh_y, //
                -p.gh, -p.gh_x, -p.gh_y, p.hh,
            );
            let cross = Vector4::new(-p.gm, -p.gm_x, -p.gm_y, p.hm);
            let log_gain = 2.0 * states[c].gain_root.ln();
            let prior = LOG_GAIN_SIGMA.powi(-2);
            let inverse = 1.0 / (p.mm.max(0.0) + prior);
            let slope = p.mr + prior * log_gain;
            let taken = cross * inverse;
            normal.matrix += (own - taken * cross.transpose()) * (weights[c] * reliability(p));
            normal.slope += (Vector4::new(-p.gr, -p.gr_x, -p.gr_y, p.hr) - taken * slope) * weights[c];
            let by_step = Vector4::new(-s.g, -s.g_x, -s.g_y, s.h);
            let offset = OffsetPart { by_step, by_gain: s.m, residuals: s.r, weights: s.w + 1e-9 };
            normal.parts[c] = Part { cross, inverse, slope, offset, weight: weights[c] };
        }
        normal
    }

    /// Size of a step in standard deviations.
    pub fn sigmas(&self, step: &Vector4<f64>) -> f64 {
        step.dot(&(self.matrix * step)).max(0.0).sqrt()
    }

    /// Updates gains and offsets for a step of the plane and the row offset.
    pub fn move_states(&self, step: &Vector4<f64>, channels: usize, states: &mut [ChannelState; CHANNELS_MAX]) {
        for (part, state) in self.parts.iter().zip(states).take(channels) {
            let log_gain = -(part.inverse * (part.slope + part.cross.dot(step)));
            let OffsetPart { by_step, by_gain, residuals, weights } = &part.offset;
            let offset = -(residuals + by_step.dot(step) + by_gain * log_gain) / weights;
            if log_gain.is_finite() && offset.is_finite() {
                let root = state.gain_root * (0.5 * log_gain.clamp(-1.0, 1.0)).exp();
                state.gain_root = root.clamp(GAIN_ROOT_MIN, GAIN_ROOT_MAX);
                state.offset += offset;
            }
        }
    }

    /// Projections for the scores of single points.
    pub fn projections(&self) -> [Projection; CHANNELS_MAX] {
        self.parts.map(|part| {
            let taken = part.cross * part.inverse;
            Projection { weight: part.weight as f32, mean: std::array::from_fn(|k| taken[k] as f32) }
        })
    }
}

/// A bounded step in the parameters at the centre of the points; `None` if the equations have no solution.
pub(super) fn bounded_step(normal: &Normal, half: &Vector2<f64>) -> Option<Vector4<f64>> {
    let scale = Matrix4::from_diagonal(&Vector4::new(1.0, 1.0 / half.x, 1.0 / half.y, 1.0));
    let scaled = scale * normal.matrix * scale;
    let ridge = Matrix4::identity() * (1e-9 * scaled.trace());
    let step = -((scaled + ridge).cholesky()?.solve(&(scale * normal.slope)));
    let size = step.xyz().amax();
    let step = if size > 1.0 { step / size } else { step };
    step.iter().all(|value| value.is_finite()).then(|| scale * step)
}

/// Tukey's limit for the sum of squared normalised residuals of `channels` channels (95 % efficiency, Gaussian noise).
pub(super) fn tukey_limit(channels: usize) -> f64 {
    [4.685_f64, 5.123, 5.49][channels.clamp(1, 3) - 1].powi(2)
}

/// Moments of Gaussian residuals under Tukey's weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TukeyMoments {
    /// Mean weight.
    pub weight: f64,
    /// Mean of weight times squared normalised residual, over the mean weight.
    pub square: f64,
    /// Derivative of the sum of weighted residuals with respect to a common shift of all residuals, divided by the mean weight:
    /// residuals that are shifted outwards lose weight.
    pub response: f64,
}

/// Moments for `channels` channels of independent residuals.
pub(super) fn tukey_moments(channels: usize) -> TukeyMoments {
    let (n, k) = (channels as f64, tukey_limit(channels));
    let (m1, m2) = (n, n * (n + 2.0));
    let m3 = m2 * (n + 4.0);
    let weight = 1.0 - 2.0 * m1 / k + m2 / (k * k);
    TukeyMoments {
        weight,
        square: (m1 - 2.0 * m2 / k + m3 / (k * k)) / (n * weight),
        response: 1.0 - 4.0 * (m1 - m2 / k) / (n * k * weight),
    }
}
