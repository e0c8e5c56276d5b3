//! Semi-global matching: disparity of every pixel from path costs along four directions.
//!
//! Hirschmüller, "Stereo processing by semiglobal matching and mutual information" (2008), eq 13 for the directions right,
//! down, left and up, in saturating bytes.

use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::wide::wide;

use super::volume::{COST_IMPOSSIBLE, CostVolume, GROUP};

/// Costs of a disparity change between neighbours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Penalties {
    /// Cost of a change by one pixel.
    pub small: u8,
    /// Cost of a larger change.
    pub large: u8,
}

/// Summed path costs of all pixels and disparities, and the winning disparities.
#[derive(Clone, Debug, Default)]
pub struct Aggregation {
    /// Sums of the four directions; layout as in the volume.
    sums: Vec<u16>,
    /// Path costs of the previous row and their minima: per pixel with one impossible disparity before and after.
    down: Paths,
    /// The same for the previous column, for several rows at a time.
    across: Paths,
    /// Per pixel: sub-pixel disparity index; NaN if there is no clear one.
    pub disparity: Vec<f32>,
    /// Per right column: the lowest matching sum, and in the lower half its disparity.
    visible_from_right: Vec<u32>,
    /// Per lowest sum: the limit that no other sum may fall below.
    limits: Vec<u16>,
}

/// Number of rows whose horizontal paths are processed together: the costs of one step must have left the processor's store
/// buffer before the next step reads them with a different alignment.
const ROWS: usize = 8;

/// The ends of several paths: their costs with one impossible disparity before and after, and the minimum of each.
#[derive(Clone, Debug, Default)]
struct Paths {
    costs: Vec<u8>,
    /// Output of the next step. The costs are not updated in place, because a processor stalls when it reads data with a
    /// different alignment immediately after writing.
    next: Vec<u8>,
    lowest: Vec<u8>,
}

impl Paths {
    /// Starts new paths.
    fn start(&mut self, count: usize, stride: usize) {
        let padded = stride + 2;
        self.next.clear();
        self.next.resize(count * padded, COST_IMPOSSIBLE);
        self.costs.clone_from(&self.next);
        for path in self.costs.chunks_exact_mut(padded) {
            path[1..=stride].fill(0);
        }
        self.lowest.clear();
        self.lowest.resize(count, 0);
    }
}

/// Acceptance rules for a winning disparity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WinnerRules {
    /// The best sum plus this share of it must not exceed any other sum, except those of its neighbours.
    pub uniqueness: f32,
    /// Largest difference between a pixel's disparity and that of its corresponding right pixel, pixels.
    pub left_right_max: u16,
}

impl Aggregation {
    /// Aggregates a volume and selects the winning disparities.
    pub fn run(&mut self, volume: &CostVolume, penalties: Penalties, rules: WinnerRules, kernels: Kernels) {
        let (width, height, stride) = (volume.area.width, volume.area.height, volume.stride);
        self.sums.resize(volume.costs.len(), 0);
        self.disparity.resize(width * height, f32::NAN);
        if width == 0 || height == 0 {
            return;
        }
        let row = width * stride;
        for forward in [true, false] {
            self.down.start(width, stride);
            let blocks = height.div_ceil(ROWS);
            for i in 0..blocks {
                let block = if forward { i } else { blocks - 1 - i };
                let (first, end) = (block * ROWS, (block * ROWS + ROWS).min(height));
                let costs = &volume.costs[first * row..end * row];
                let sums = &mut self.sums[first * row..end * row];
                self.across.start(end - first, stride);
                let shape = BlockShape { width, rows: end - first, stride, penalties, forward };
                sweep_block(kernels, costs, shape, &mut self.across, &mut self.down, sums);
            }
        }
        self.limits.clear();
        self.limits.extend((0..=SUM_MAX).map(|lowest| lowest + (f32::from(lowest) * rules.uniqueness) as u16));
        for y in 0..height {
            self.pick_row(volume, y, rules, kernels);
        }
    }

    fn pick_row(&mut self, volume: &CostVolume, y: usize, rules: WinnerRules, kernels: Kernels) {
        let (width, stride) = (volume.area.width, volume.stride);
        let sums = &self.sums[y * width * stride..(y + 1) * width * stride];
        let out = &mut self.disparity[y * width..(y + 1) * width];
        // Right columns of this row: the box's columns minus all disparities.
        self.visible_from_right.clear();
        self.visible_from_right.resize(width + stride, u32::MAX << 16);
        pick(kernels, sums, stride, volume.count, &self.limits, out, &mut self.visible_from_right);
        for (x, value) in out.iter_mut().enumerate() {
            if *value >= 0.0 {
                let index = (*value + 0.5) as usize;
                let other = self.visible_from_right[x + stride - 1 - index] as u16;
                if other.abs_diff(index as u16) > rules.left_right_max {
                    *value = f32::NAN;
                }
            }
        }
    }
}

/// Dimensions and processing order of a block of rows.
#[derive(Clone, Copy, Debug)]
struct BlockShape {
    width: usize,
    rows: usize,
    stride: usize,
    penalties: Penalties,
    forward: bool,
}

wide! {
    fn sweep_block(costs: &[u8], shape: BlockShape, across: &mut Paths, down: &mut Paths, sums: &mut [u16]) = sweep_block_kernel;
}

#[inline(always)]
fn sweep_block_kernel(costs: &[u8], shape: BlockShape, across: &mut Paths, down: &mut Paths, sums: &mut [u16]) {
    match shape.stride / GROUP {
        1 => sweep_groups::<1>(costs, shape, across, down, sums),
        2 => sweep_groups::<2>(costs, shape, across, down, sums),
        3 => sweep_groups::<3>(costs, shape, across, down, sums),
        4 => sweep_groups::<4>(costs, shape, across, down, sums),
        _ => sweep_groups::<0>(costs, shape, across, down, sums),
    }
}

/// Specialised for `N` groups of disparities per pixel; 0: any number.
#[inline(always)]
fn sweep_groups<const N: usize>(
    costs: &[u8],
    shape: BlockShape,
    across: &mut Paths,
    down: &mut Paths,
    sums: &mut [u16],
) {
    let stride = if N == 0 { shape.stride } else { N * GROUP };
    let (padded, row) = (stride + 2, shape.width * stride);
    let turn = |i: usize, count: usize| if shape.forward { i } else { count - 1 - i };
    for x in (0..shape.width).map(|i| turn(i, shape.width)) {
        for y in 0..shape.rows {
            let at = y * row + x * stride;
            let (costs, sums) = (&costs[at..at + stride], &mut sums[at..at + stride]);
            let (path, next) = (&across.costs[y * padded..][..padded], &mut across.next[y * padded + 1..][..stride]);
            let lowest = across.lowest[y];
            across.lowest[y] = match shape.forward {
                true => step::<true>(costs, shape.penalties, lowest, path, next, sums),
                false => step::<false>(costs, shape.penalties, lowest, path, next, sums),
            };
        }
        std::mem::swap(&mut across.costs, &mut across.next);
    }
    for y in (0..shape.rows).map(|i| turn(i, shape.rows)) {
        for x in 0..shape.width {
            let at = y * row + x * stride;
            let (costs, sums) = (&costs[at..at + stride], &mut sums[at..at + stride]);
            let (path, next) = (&down.costs[x * padded..][..padded], &mut down.next[x * padded + 1..][..stride]);
            down.lowest[x] = step::<false>(costs, shape.penalties, down.lowest[x], path, next, sums);
        }
        std::mem::swap(&mut down.costs, &mut down.next);
    }
}

/// One step along a path: from the current costs (with an impossible disparity at both ends) to the next. They are written to
/// the sums if they are the `FIRST` of their pixel, otherwise added. Returns the new minimum cost.
#[inline(always)]
fn step<const FIRST: bool>(
    costs: &[u8],
    penalties: Penalties,
    lowest: u8,
    path: &[u8],
    next: &mut [u8],
    sums: &mut [u16],
) -> u8 {
    let jump = lowest.saturating_add(penalties.large);
    let mut least = [u8::MAX; GROUP];
    let outs = next.chunks_exact_mut(GROUP).zip(sums.chunks_exact_mut(GROUP));
    for (group, (costs, (out, sums))) in costs.chunks_exact(GROUP).zip(outs).enumerate() {
        let path = &path[group * GROUP..group * GROUP + GROUP + 2];
        for i in 0..GROUP {
            let beside = path[i].min(path[i + 2]).saturating_add(penalties.small);
            let best = path[i + 1].min(beside).min(jump);
            let cost = costs[i].saturating_add(best - lowest);
            least[i] = least[i].min(cost);
            out[i] = cost;
            sums[i] = if FIRST { u16::from(cost) } else { sums[i] + u16::from(cost) };
        }
    }
    let mut lowest = u8::MAX;
    for value in least {
        lowest = lowest.min(value);
    }
    lowest
}

wide! {
    fn pick(sums: &[u16], stride: usize, count: usize, limits: &[u16], out: &mut [f32], visible_from_right: &mut [u32])
        = pick_kernel;
}

#[inline(always)]
fn pick_kernel(
    sums: &[u16],
    stride: usize,
    count: usize,
    limits: &[u16],
    out: &mut [f32],
    visible_from_right: &mut [u32],
) {
    // Several pixels at a time: operations common to all of them become vector instructions.
    for (batch, (sums, out)) in sums.chunks(PICKED * stride).zip(out.chunks_mut(PICKED)).enumerate() {
        let (mut lowest, mut best, mut limit) = ([0_u16; PICKED], [0_u16; PICKED], [0_u16; PICKED]);
        let (mut three, mut below) = ([[0_u16; PICKED]; 3], [0_u16; PICKED]);
        for (k, sums) in sums.chunks_exact(stride).enumerate() {
            (lowest[k], best[k]) = if stride <= PACKED { lowest_packed(sums) } else { lowest_of(sums) };
            limit[k] = limits[usize::from(lowest[k])];
        }
        for (k, sums) in sums.chunks_exact(stride).enumerate() {
            below[k] = count_below(sums, limit[k]);
            let at = usize::from(best[k]).clamp(1, stride - 2);
            for (three, sum) in three.iter_mut().zip(&sums[at - 1..=at + 1]) {
                three[k] = *sum;
            }
            let matched = &mut visible_from_right[batch * PICKED + k + stride - 1 - usize::from(best[k])];
            // Of equal sums the lower disparity wins, which is that of the first column.
            *matched = (*matched).min(u32::from(lowest[k]) << 16 | u32::from(best[k]));
        }
        let mut places = [f32::NAN; PICKED];
        for k in 0..PICKED {
            let [before, at, after] = three.map(|three| three[k]);
            // The winner and its neighbours are not rivals.
            let near = u16::from(before < limit[k]) + u16::from(at < limit[k]) + u16::from(after < limit[k]);
            let is_clear = (below[k] == near) & (best[k] > 0) & (usize::from(best[k]) + 1 < count);
            places[k] = if is_clear { vertex([before, at, after], best[k]) } else { f32::NAN };
        }
        out.copy_from_slice(&places[..out.len()]);
    }
}

/// Four saturated path costs.
const SUM_MAX: u16 = 4 * COST_IMPOSSIBLE as u16;
/// Number of pixels whose winners are selected together.
const PICKED: usize = 16;

/// Number of sums below a limit.
#[inline(always)]
fn count_below(sums: &[u16], limit: u16) -> u16 {
    let mut below = [0_u16; GROUP];
    for group in sums.chunks_exact(GROUP) {
        for i in 0..GROUP {
            below[i] += u16::from(group[i] < limit);
        }
    }
    below.iter().sum()
}

/// Number of disparities whose index fits into 16 bits together with a sum of four saturated bytes.
const PACKED: usize = 64;

/// The lowest sum and its first position, for at most [`PACKED`] sums.
#[inline(always)]
fn lowest_packed(sums: &[u16]) -> (u16, u16) {
    let mut least = [u16::MAX; GROUP];
    for (group, sums) in sums.chunks_exact(GROUP).enumerate() {
        for i in 0..GROUP {
            least[i] = least[i].min(sums[i] * PACKED as u16 + (group * GROUP + i) as u16);
        }
    }
    let least = least.iter().fold(u16::MAX, |a, &b| a.min(b));
    (least / PACKED as u16, least % PACKED as u16)
}

/// The lowest sum and its first position.
#[inline(always)]
fn lowest_of(sums: &[u16]) -> (u16, u16) {
    let mut least = [u16::MAX; GROUP];
    for group in sums.chunks_exact(GROUP) {
        for i in 0..GROUP {
            least[i] = least[i].min(group[i]);
        }
    }
    let lowest = least.iter().fold(u16::MAX, |a, &b| a.min(b));
    let mut places = [u16::MAX; GROUP];
    for (group, sums) in sums.chunks_exact(GROUP).enumerate() {
        for i in 0..GROUP {
            let place = (group * GROUP + i) as u16;
            places[i] = places[i].min(if sums[i] == lowest { place } else { u16::MAX });
        }
    }
    (lowest, places.iter().fold(u16::MAX, |a, &b| a.min(b)))
}

/// Position of the minimum of the parabola through the sums around `best`.
#[inline(always)]
fn vertex(sums: [u16; 3], best: u16) -> f32 {
    let [before, at, after] = sums.map(f32::from);
    let curvature = before + after - 2.0 * at;
    let fraction = 0.5 * (before - after) / curvature;
    f32::from(best) + if curvature > 0.0 { fraction } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use pb3dp_estimation_test_support::every_kernel;

    use super::*;
    use crate::search::volume::{COST_NEUTRAL, LevelBox};

    const PENALTIES: Penalties = Penalties { small: 8, large: 40 };
    const RULES: WinnerRules = WinnerRules { uniqueness: 0.05, left_right_max: 1 };

    /// Random costs; the true disparity `12 + x / 8` is cheap at two of three pixels.
    fn volume(count: usize) -> CostVolume {
        let (width, height) = (40, 21);
        let stride = count.div_ceil(GROUP) * GROUP;
        let mut volume = CostVolume::default();
        volume.area = LevelBox { x: 0, y: 0, width, height };
        (volume.count, volume.stride) = (count, stride);
        volume.costs = vec![COST_IMPOSSIBLE; width * height * stride];
        for i in 0..width * height {
            let (x, y) = (i % width, i / width);
            for d in 0..count {
                let noise = ((i * 2_654_435 + d * 40_503) >> 7) as u8 % 20;
                let good = d == 12 + x / 8 && (x + 2 * y) % 3 != 0;
                volume.costs[i * stride + d] = if good { 10 } else { COST_NEUTRAL - 10 + noise };
            }
        }
        volume
    }

    /// Hirschmüller's recursion in whole numbers, as in the paper, for one direction.
    fn path_costs(volume: &CostVolume, (dx, dy): (i64, i64)) -> Vec<i64> {
        let LevelBox { width, height, .. } = volume.area;
        let mut costs = vec![0_i64; width * height * volume.count];
        let order = |length: usize, step: i64| -> Vec<usize> {
            if step < 0 { (0..length).rev().collect() } else { (0..length).collect() }
        };
        for y in order(height, dy) {
            for x in order(width, dx) {
                let (px, py) = (x as i64 - dx, y as i64 - dy);
                let inside = px >= 0 && py >= 0 && px < width as i64 && py < height as i64;
                let from = (py * width as i64 + px) * volume.count as i64;
                let before: Vec<i64> =
                    (0..volume.count as i64).map(|d| if inside { costs[(from + d) as usize] } else { 0 }).collect();
                let lowest = before.iter().copied().min().unwrap();
                for d in 0..volume.count {
                    let beside = |at: Option<usize>| {
                        at.and_then(|at| before.get(at)).map_or(i64::MAX, |cost| cost + i64::from(PENALTIES.small))
                    };
                    let best = before[d]
                        .min(beside(d.checked_sub(1)))
                        .min(beside(Some(d + 1)))
                        .min(lowest + i64::from(PENALTIES.large));
                    let own = i64::from(volume.costs[(y * width + x) * volume.stride + d]);
                    costs[(y * width + x) * volume.count + d] = own + best - lowest;
                }
            }
        }
        costs
    }

    #[test]
    fn sums_are_those_of_the_recursion_with_every_kernel() {
        for (count, kernels) in [20, 64, 150].into_iter().flat_map(|n| every_kernel().map(move |k| (n, k))) {
            let volume = volume(count);
            let mut aggregation = Aggregation::default();
            aggregation.run(&volume, PENALTIES, RULES, kernels);
            let paths = [(1, 0), (-1, 0), (0, 1), (0, -1)].map(|direction| path_costs(&volume, direction));
            for i in 0..volume.area.width * volume.area.height {
                for d in 0..count {
                    let expected: i64 = paths.iter().map(|path| path[i * count + d]).sum();
                    assert_eq!(i64::from(aggregation.sums[i * volume.stride + d]), expected, "{i} {d}");
                }
            }
        }
    }

    #[test]
    fn the_first_of_equal_sums_is_the_lowest() {
        for seed in 0..200_usize {
            let sums: Vec<u16> = (0..PACKED).map(|i| ((i * 7919 + seed * 104_729) >> 3) as u16 % 1021).collect();
            let sums: Vec<u16> = sums.iter().map(|&sum| if seed % 3 == 0 { sum / 100 } else { sum }).collect();
            let lowest = *sums.iter().min().unwrap();
            let expected = (lowest, sums.iter().position(|&sum| sum == lowest).unwrap() as u16);
            assert_eq!((lowest_packed(&sums), lowest_of(&sums)), (expected, expected));
        }
        let last = [vec![1020; PACKED - 1], vec![1019]].concat();
        assert_eq!((lowest_packed(&last), lowest_packed(&[1020; PACKED])), ((1019, PACKED as u16 - 1), (1020, 0)));
    }

    /// Direct implementation of the rules: lowest sum, no rival, the same winner from the right, vertex of the parabola.
    #[test]
    fn winners_are_those_of_a_plain_search_with_every_kernel() {
        for (count, kernels) in [20, 64, 150].into_iter().flat_map(|n| every_kernel().map(move |k| (n, k))) {
            let volume = volume(count);
            let mut aggregation = Aggregation::default();
            aggregation.run(&volume, PENALTIES, RULES, kernels);
            let LevelBox { width, height, .. } = volume.area;
            let sums = |x: usize, y: usize| &aggregation.sums[(y * width + x) * volume.stride..][..count];
            let winner = |x: usize, y: usize| (0..count).min_by_key(|&d| (sums(x, y)[d], d)).unwrap();
            for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
                let (sums_here, best) = (sums(x, y), winner(x, y));
                let lowest = sums_here[best];
                let limit = lowest + (f32::from(lowest) * RULES.uniqueness) as u16;
                let rival = (0..count).any(|d| d.abs_diff(best) > 1 && sums_here[d] < limit);
                let inside = best > 0 && best + 1 < count;
                // Columns whose winner corresponds to the same right column.
                let met = (0..width).filter(|&other| other as i64 - winner(other, y) as i64 == x as i64 - best as i64);
                let matched = met.min_by_key(|&other| (sums(other, y)[winner(other, y)], other)).unwrap();
                let agrees = winner(matched, y).abs_diff(best) <= usize::from(RULES.left_right_max);
                let found = aggregation.disparity[y * width + x];
                assert_eq!(found.is_finite(), inside && !rival && agrees, "{x} {y} of {count}");
                if found.is_finite() {
                    let [a, b, c] = [best - 1, best, best + 1].map(|d| f64::from(sums_here[d]));
                    let expected = best as f64 + if a + c > 2.0 * b { 0.5 * (a - c) / (a + c - 2.0 * b) } else { 0.0 };
                    assert!((f64::from(found) - expected).abs() < 1e-4, "{found} {expected}");
                }
            }
        }
    }

    #[test]
    fn winners_bridge_pixels_that_say_nothing() {
        let mut aggregation = Aggregation::default();
        aggregation.run(&volume(40), PENALTIES, RULES, Kernels::best());
        let clear = aggregation.disparity.iter().enumerate().filter(|(_, d)| d.is_finite());
        let right = clear.clone().filter(|(i, d)| (*d - (12 + i % 40 / 8) as f32).abs() <= 1.0).count();
        assert!(right > 700 && right as f64 > 0.99 * clear.count() as f64, "{right}");
    }
}
