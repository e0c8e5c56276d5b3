//! Initial gain, offset and variance of a channel.

use super::kernel::{ChannelState, PointSet, TOUCHED, UNUSABLE, Warp};

/// Gain and offset from the spreads and medians of some points, variance from their residuals.
pub(super) fn first_state(points: &PointSet, right: &[f32], warp: &Warp, channel: usize, lowest: f64) -> ChannelState {
    /// Approximate number of sampled points. Chosen by hand, not varied: a median of 256 values is accurate to 8 % of their
    /// spread (1.25 / sqrt(256)); only the start depends on it.
    const COUNT: usize = 256;
    let (mut own, mut shown) = ([0.0_f32; COUNT], [0.0_f32; COUNT]);
    let step = (points.x.len() / COUNT).max(1);
    let mut count = 0;
    for i in (0..points.x.len()).step_by(step) {
        let column = warp.column + warp.per_x * points.x[i] + warp.per_y * points.y[i];
        if count == COUNT || points.unit[i] == 0.0 || !(column >= 1.0 && column < warp.width as f32 - 1.5) {
            continue;
        }
        let first = points.row_start[i] as usize + column.round() as usize - 1;
        let three: [f32; 3] = right.get(first..).and_then(|rest| rest.first_chunk().copied()).unwrap_or([UNUSABLE; 3]);
        let (value, mine) = ((three[0] + 4.0 * three[1] + three[2]) / 6.0, points.value[channel][i]);
        if value.max(mine) >= TOUCHED {
            continue;
        }
        (own[count], shown[count]) = (mine, value);
        count += 1;
    }
    if count < 16 {
        return ChannelState { gain_root: 1.0, offset: 0.0, variance: lowest };
    }
    let (own, shown) = (&own[..count], &shown[..count]);
    let mut scratch = [0.0_f32; COUNT];
    let scratch = &mut scratch[..count];
    scratch.copy_from_slice(own);
    let (own_middle, own_spread) = spread(scratch);
    scratch.copy_from_slice(shown);
    let (shown_middle, shown_spread) = spread(scratch);
    let ratio = (own_spread.max(0.5) / shown_spread.max(0.5)).clamp(0.5, 2.0);
    let root = ratio.sqrt();
    let offset = own_middle / root - shown_middle * root;
    for ((difference, own), shown) in scratch.iter_mut().zip(own).zip(shown) {
        *difference = (shown * root - own / root + offset).abs();
    }
    let sigma = 1.4826 * f64::from(*scratch.select_nth_unstable_by(count / 2, f32::total_cmp).1);
    ChannelState { gain_root: f64::from(root), offset: f64::from(offset), variance: (sigma * sigma).max(lowest) }
}

/// Median and 1.4826 times the median absolute deviation.
fn spread(values: &mut [f32]) -> (f32, f32) {
    let half = values.len() / 2;
    let middle = *values.select_nth_unstable_by(half, f32::total_cmp).1;
    for value in values.iter_mut() {
        *value = (*value - middle).abs();
    }
    (middle, 1.4826 * *values.select_nth_unstable_by(half, f32::total_cmp).1)
}
