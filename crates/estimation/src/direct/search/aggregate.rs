//! Semi-global matching: every pixel takes the disparity that it and its neighbours along four directions like best.
//!
//! Hirschmüller, "Stereo processing by semiglobal matching and mutual information" (2008), eq 13 for the directions right,
//! down, left and up, in saturating bytes.

use super::volume::{COST_IMPOSSIBLE, CostVolume, GROUP};
use crate::cpu::Kernels;
use crate::wide::wide;

/// What a change of disparity between neighbours costs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Penalties {
    /// By one pixel.
    pub small: u8,
    /// By more.
    pub large: u8,
}

/// Sums of path costs of all pixels and disparities, with the winners.
#[derive(Clone, Debug, Default)]
pub struct Aggregation {
    /// Sums of the four directions; layout as in the volume.
    sums: Vec<u16>,
    /// Path costs of the row before, per pixel with one impossible disparity before and after.
    vertical: Vec<u8>,
    horizontal: [Vec<u8>; 2],
    /// Per pixel: disparity index at a fraction of a pixel; NaN where there is no clear one.
    pub disparity: Vec<f32>,
    seen_from_right: Vec<(u16, u16)>,
}

/// When a winner counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WinnerRules {
    /// The best sum plus this share of it may not exceed any other that is not a neighbour.
    pub uniqueness: f32,
    /// Largest difference between a pixel's disparity and that of the pixel that it meets, pixels.
    pub left_right_max: u16,
}

impl Aggregation {
    /// Aggregates a volume and picks the winners.
    pub fn run(&mut self, volume: &CostVolume, penalties: Penalties, rules: WinnerRules, kernels: Kernels) {
        let (width, height, stride) = (volume.area.width, volume.area.height, volume.stride);
        self.sums.resize(volume.costs.len(), 0);
        self.disparity.resize(width * height, f32::NAN);
        let row = width * stride;
        let padded = stride + 2;
        for buffer in &mut self.horizontal {
            buffer.clear();
            buffer.resize(padded, COST_IMPOSSIBLE);
        }
        for forward in [true, false] {
            self.vertical.clear();
            self.vertical.resize(width * padded, COST_IMPOSSIBLE);
            for pixel in self.vertical.chunks_exact_mut(padded) {
                pixel[1..=stride].fill(0);
            }
            for i in 0..height {
                let y = if forward { i } else { height - 1 - i };
                let costs = &volume.costs[y * row..(y + 1) * row];
                let sums = &mut self.sums[y * row..(y + 1) * row];
                let [a, b] = &mut self.horizontal;
                sweep_row(kernels, costs, stride, penalties, forward, &mut self.vertical, a, b, sums);
            }
        }
        for y in 0..height {
            self.pick_row(volume, y, rules, kernels);
        }
    }

    fn pick_row(&mut self, volume: &CostVolume, y: usize, rules: WinnerRules, kernels: Kernels) {
        let (width, stride) = (volume.area.width, volume.stride);
        let sums = &self.sums[y * width * stride..(y + 1) * width * stride];
        let out = &mut self.disparity[y * width..(y + 1) * width];
        // Right columns of this row: the box's columns less all disparities.
        self.seen_from_right.clear();
        self.seen_from_right.resize(width + stride, (u16::MAX, 0));
        pick(kernels, sums, stride, volume.count, rules, out, &mut self.seen_from_right);
        for (x, value) in out.iter_mut().enumerate() {
            let index = value.round();
            if index >= 0.0 {
                let (_, other) = self.seen_from_right[x + stride - 1 - index as usize];
                if other.abs_diff(index as u16) > rules.left_right_max {
                    *value = f32::NAN;
                }
            }
        }
    }
}

wide! {
    fn sweep_row(costs: &[u8], stride: usize, penalties: Penalties, forward: bool, vertical: &mut [u8],
        horizontal: &mut Vec<u8>, scratch: &mut Vec<u8>, sums: &mut [u16]) = sweep_row_kernel;
}

#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "a kernel takes its buffers one by one")]
fn sweep_row_kernel(
    costs: &[u8],
    stride: usize,
    penalties: Penalties,
    forward: bool,
    vertical: &mut [u8],
    horizontal: &mut Vec<u8>,
    scratch: &mut Vec<u8>,
    sums: &mut [u16],
) {
    let (count, padded) = (costs.len() / stride, stride + 2);
    horizontal[1..=stride].fill(0);
    for i in 0..count {
        let x = if forward { i } else { count - 1 - i };
        let costs = &costs[x * stride..(x + 1) * stride];
        let sums = &mut sums[x * stride..(x + 1) * stride];
        step(costs, penalties, &horizontal[..padded], &mut scratch[1..=stride]);
        std::mem::swap(horizontal, scratch);
        let here = &mut vertical[x * padded..(x + 1) * padded];
        step(costs, penalties, here, &mut scratch[1..=stride]);
        here[1..=stride].copy_from_slice(&scratch[1..=stride]);
        let (a, b) = (&horizontal[1..=stride], &scratch[1..=stride]);
        for ((sums, a), b) in sums.chunks_exact_mut(GROUP).zip(a.chunks_exact(GROUP)).zip(b.chunks_exact(GROUP)) {
            for i in 0..GROUP {
                let sum = u16::from(a[i]) + u16::from(b[i]);
                sums[i] = if forward { sum } else { sums[i] + sum };
            }
        }
    }
}

/// One step along a path: `previous` has an impossible disparity at both ends.
#[inline(always)]
fn step(costs: &[u8], penalties: Penalties, previous: &[u8], out: &mut [u8]) {
    let mut least = [u8::MAX; GROUP];
    for group in previous[1..=costs.len()].chunks_exact(GROUP) {
        for i in 0..GROUP {
            least[i] = least[i].min(group[i]);
        }
    }
    let mut lowest = u8::MAX;
    for value in least {
        lowest = lowest.min(value);
    }
    let jump = lowest.saturating_add(penalties.large);
    for (group, (costs, out)) in costs.chunks_exact(GROUP).zip(out.chunks_exact_mut(GROUP)).enumerate() {
        let previous = &previous[group * GROUP..group * GROUP + GROUP + 2];
        for i in 0..GROUP {
            let beside = previous[i].min(previous[i + 2]).saturating_add(penalties.small);
            let best = previous[i + 1].min(beside).min(jump);
            out[i] = costs[i].saturating_add(best - lowest);
        }
    }
}

wide! {
    fn pick(sums: &[u16], stride: usize, count: usize, rules: WinnerRules, out: &mut [f32],
        seen_from_right: &mut [(u16, u16)]) = pick_kernel;
}

#[inline(always)]
fn pick_kernel(
    sums: &[u16],
    stride: usize,
    count: usize,
    rules: WinnerRules,
    out: &mut [f32],
    seen_from_right: &mut [(u16, u16)],
) {
    for (x, (sums, out)) in sums.chunks_exact(stride).zip(out.iter_mut()).enumerate() {
        let mut least = [u16::MAX; GROUP];
        for group in sums.chunks_exact(GROUP) {
            for i in 0..GROUP {
                least[i] = least[i].min(group[i]);
            }
        }
        let mut lowest = u16::MAX;
        for value in least {
            lowest = lowest.min(value);
        }
        let best = sums.iter().position(|&s| s == lowest).unwrap_or(0);
        let limit = lowest + (f32::from(lowest) * rules.uniqueness) as u16;
        let mut rivals = 0_u32;
        for group in sums.chunks_exact(GROUP) {
            let mut found = 0_u16;
            for i in 0..GROUP {
                found += u16::from(group[i] < limit);
            }
            rivals += u32::from(found);
        }
        for near in best.saturating_sub(1)..(best + 2).min(stride) {
            rivals -= u32::from(sums[near] < limit);
        }
        let seen = &mut seen_from_right[x + stride - 1 - best];
        if lowest < seen.0 {
            *seen = (lowest, best as u16);
        }
        *out = if rivals == 0 && best > 0 && best + 1 < count { vertex(sums, best) } else { f32::NAN };
    }
}

/// Where the parabola through three sums has its lowest point.
#[inline(always)]
fn vertex(sums: &[u16], best: usize) -> f32 {
    let [before, at, after] = [sums[best - 1], sums[best], sums[best + 1]].map(f32::from);
    let curvature = before + after - 2.0 * at;
    best as f32 + if curvature > 0.0 { 0.5 * (before - after) / curvature } else { 0.0 }
}
