//! The relief: by how much the surface leaves its plane, per patch of the first view, in pixels of disparity.

use nalgebra::{Matrix3, Vector3};

use super::kernels::CHANNELS;
use super::normal::PatchScore;
use super::surface::Cells;

/// Most that a patch moves at a time, pixels.
const MOVE_MAX_PX: f64 = 0.5;
/// What is known of a patch is never held for surer than this, 1/px^2.
const INFORMATION_MAX: f64 = 1e5;
/// Neighbours differ by about this much, pixels; much larger steps cost no more.
const NEIGHBOUR_SIGMA_PX: f64 = 0.7;
const NEIGHBOUR_COST_MAX: f64 = 6.0;
/// Least information of a patch with points, 1/px^2.
const INFORMATION_MIN: f64 = 1e-3;
/// Differences between neighbours are tried this many standard deviations of chance before they count as a relief.
const CHANCE_SIGMAS: f64 = 3.0;
/// A single pair of neighbours counts for at most this, in variances of their noise.
const CHI_SQUARE_MAX: f64 = 400.0;
/// Variance of the difference between neighbours on a flat surface, pixels squared.
const ROUGHNESS_MIN: f64 = 1e-5;
/// Sweeps over all patches until they agree.
const SWEEPS: usize = 80;
/// Share of the bend at a patch that its offset may be wrong by.
const BEND_SHARE: f64 = 0.45;
/// Rounds in which neighbours tell each other what they believe.
const ROUNDS: usize = 12;

/// Offsets on a grid of patches, bilinear in between. Patches without points take the mean of their neighbours.
#[derive(Clone, Debug)]
pub(super) struct Relief {
    first_centre_px: [f64; 2],
    side_px: f64,
    columns: usize,
    rows: usize,
    /// Disparity that the surface has more than its plane, pixels.
    offset_px: Vec<f64>,
    /// What is known of it, 1/px^2; 0 for a patch without points.
    information: Vec<f64>,
    /// Patch of each group of the finest level.
    patch_of_group: Vec<usize>,
    /// Inverse depth of a pixel of disparity, 1/m.
    inverse_depth_per_px: f64,
    /// Of the last refinement: patch, move, information.
    moves: Vec<(usize, f64, f64)>,
}

impl Relief {
    /// No relief.
    pub(super) fn over(cells: &Cells, inverse_depth_per_px: f64) -> Self {
        let count = cells.columns * cells.rows;
        Self {
            first_centre_px: cells.first_centre_px,
            side_px: cells.side_px.max(1.0),
            columns: cells.columns.max(1),
            rows: cells.rows.max(1),
            offset_px: vec![0.0; count.max(1)],
            information: vec![0.0; count.max(1)],
            patch_of_group: cells.cells.iter().map(|cell| cell.row * cells.columns + cell.column).collect(),
            inverse_depth_per_px,
            moves: Vec::with_capacity(cells.cells.len()),
        }
    }

    /// Number of patches with points.
    pub(super) fn patches(&self) -> usize {
        self.patch_of_group.len()
    }

    /// Holds that there is no relief.
    pub(super) fn hold_flat(&mut self) {
        self.offset_px.fill(0.0);
        self.patch_of_group.iter().for_each(|&patch| self.information[patch] = INFORMATION_MAX);
    }

    /// Puts the whole surface off its plane by this disparity, pixels.
    pub(super) fn set_all(&mut self, offset_px: f64) {
        self.offset_px.fill(offset_px);
    }

    /// Patch of a raw pixel of the first view.
    fn patch_at(&self, pixel: [f64; 2]) -> usize {
        let place = |axis: usize, count: usize| {
            let x = (pixel[axis] - self.first_centre_px[axis]) / self.side_px;
            (x.round().max(0.0) as usize).min(count - 1)
        };
        place(1, self.rows) * self.columns + place(0, self.columns)
    }

    /// Takes the offsets of the candidates that explain the pair best, `costs` (negative log likelihoods) by patch and
    /// candidate, between neighbours that differ little.
    pub(super) fn take_best(&mut self, candidates_px: &[f64], costs: &[Vec<f64>], sigma_px: f64) {
        let labels = beliefs(self, candidates_px, costs, sigma_px);
        for &patch in &self.patch_of_group {
            self.offset_px[patch] = lowest(candidates_px, &labels[patch]);
            self.information[patch] = 1.0 / (sigma_px * sigma_px);
        }
        self.fill();
    }

    /// Takes the offsets that residuals ask for, as smooth as the surface shows itself to be: how much neighbours differ
    /// beyond what noise explains is measured first, and where that is nothing the surface stays flat.
    pub(super) fn settle(&mut self, scores: &[PatchScore], sigma_px: f64) {
        let scale = self.inverse_depth_per_px;
        self.moves.clear();
        for (score, &patch) in scores.iter().zip(&self.patch_of_group) {
            let information = (f64::from(score.depth_information()) * scale * scale).max(INFORMATION_MIN);
            let step = f64::from(score.depth_pull()) * scale / information;
            let wanted = self.offset_px[patch] + step.clamp(-MOVE_MAX_PX, MOVE_MAX_PX);
            self.moves.push((patch, wanted, information));
        }
        let plane = self.plane_of_moves();
        let count = self.offset_px.len();
        let (mut wanted, mut known) = (vec![0.0; count], vec![0.0; count]);
        for &(patch, offset, information) in &self.moves {
            (wanted[patch], known[patch]) = (offset - plane.dot(&self.column_and_row(patch)), information);
        }
        let stiffness = 1.0 / self.roughness(&wanted, &known);
        let own = 1.0 / (sigma_px * sigma_px);
        self.offset_px.copy_from_slice(&wanted);
        for _ in 0..SWEEPS {
            for patch in (0..count).filter(|&patch| known[patch] > 0.0) {
                let (mut sum, mut weight) = (known[patch] * wanted[patch], known[patch] + own);
                for neighbour in neighbours(patch, self.columns, self.rows).filter(|&n| known[n] > 0.0) {
                    sum += stiffness * self.offset_px[neighbour];
                    weight += stiffness;
                }
                self.offset_px[patch] = sum / weight;
            }
        }
        for patch in (0..count).filter(|&patch| known[patch] > 0.0) {
            self.information[patch] = known[patch] + own + stiffness;
            self.offset_px[patch] += plane.dot(&self.column_and_row(patch));
        }
        self.fill();
    }

    /// Variance of the difference between neighbours beyond their noise, pixels squared; as good as nothing where chance
    /// alone may explain the differences.
    fn roughness(&self, offset_px: &[f64], information: &[f64]) -> f64 {
        let (mut excess, mut weights, mut count) = (0.0, 0.0, 0.0_f64);
        for patch in (0..offset_px.len()).filter(|&patch| information[patch] > 0.0) {
            let after = neighbours(patch, self.columns, self.rows).filter(|&n| n > patch && information[n] > 0.0);
            for neighbour in after {
                let weight = 1.0 / (1.0 / information[patch] + 1.0 / information[neighbour]);
                let square = (offset_px[patch] - offset_px[neighbour]).powi(2);
                excess += (weight * square).min(CHI_SQUARE_MAX) - 1.0;
                (weights, count) = (weights + weight, count + 1.0);
            }
        }
        let by_chance = CHANCE_SIGMAS * (2.0 * count).sqrt();
        ((excess - by_chance).max(0.0) / weights.max(1e-9)).max(ROUGHNESS_MIN)
    }

    /// Moves each patch by what its residuals ask for, taken as `share` of what they know, and `keeps` that knowledge or
    /// not. Whatever a plane could do is left to the plane.
    pub(super) fn refine(&mut self, scores: &[PatchScore], share: f64, keeps: bool) {
        let scale = self.inverse_depth_per_px;
        self.moves.clear();
        for (score, &patch) in scores.iter().zip(&self.patch_of_group) {
            let gained = share * f64::from(score.depth_information()).max(0.0) * scale * scale;
            let information = self.information[patch] + gained;
            let step = share * f64::from(score.depth_pull()) * scale / information.max(1e-9);
            self.moves.push((patch, step.clamp(-MOVE_MAX_PX, MOVE_MAX_PX), information));
            if keeps {
                self.information[patch] = information.min(INFORMATION_MAX);
            }
        }
        let plane = self.plane_of_moves();
        for &(patch, step, _) in &self.moves {
            let step = step - plane.dot(&self.column_and_row(patch));
            self.offset_px[patch] += step;
        }
        self.fill();
    }

    /// Standard deviation of each patch's inverse depth, 1/m: what is not known of it, and what a grid of patches can not say
    /// of a bent surface.
    pub(super) fn depth_sigma(&self) -> impl Iterator<Item = f64> + '_ {
        self.patch_of_group.iter().map(|&patch| {
            let (mut sum, mut count) = (0.0, 0.0);
            for neighbour in neighbours(patch, self.columns, self.rows) {
                (sum, count) = (sum + self.offset_px[neighbour], count + 1.0);
            }
            let bend_px = if count > 0.0 { self.offset_px[patch] - sum / count } else { 0.0 };
            let unknown = 1.0 / self.information[patch].max(1e-6);
            (unknown + (BEND_SHARE * bend_px).powi(2)).sqrt() * self.inverse_depth_per_px
        })
    }

    fn column_and_row(&self, patch: usize) -> Vector3<f64> {
        Vector3::new((patch % self.columns) as f64, (patch / self.columns) as f64, 1.0)
    }

    /// The plane that the moves of all patches have in common.
    fn plane_of_moves(&self) -> Vector3<f64> {
        let (mut matrix, mut rhs) = (Matrix3::identity() * 1e-6, Vector3::zeros());
        for &(patch, step, information) in &self.moves {
            let place = self.column_and_row(patch);
            matrix += place * place.transpose() * information;
            rhs += place * (information * step);
        }
        matrix.cholesky().map(|c| c.solve(&rhs)).unwrap_or_default()
    }

    /// Patches without points take the mean of their neighbours.
    fn fill(&mut self) {
        for _ in 0..3 {
            for patch in 0..self.offset_px.len() {
                if self.information[patch] > 0.0 {
                    continue;
                }
                let (mut sum, mut count) = (0.0, 0.0);
                for neighbour in neighbours(patch, self.columns, self.rows) {
                    if self.information[neighbour] > 0.0 || self.offset_px[neighbour] != 0.0 {
                        (sum, count) = (sum + self.offset_px[neighbour], count + 1.0);
                    }
                }
                if count > 0.0 {
                    self.offset_px[patch] = sum / count;
                }
            }
        }
    }

    /// What is added to the plane's inverse depth at a raw pixel of the first view, 1/m, and its slope by u and v.
    pub(super) fn at(&self, pixel: [f64; 2]) -> (f64, [f64; 2]) {
        let place = |axis: usize, count: usize| {
            let x = ((pixel[axis] - self.first_centre_px[axis]) / self.side_px).clamp(0.0, (count - 1) as f64);
            let first = (x as usize).min(count.saturating_sub(2));
            (first, (first + 1).min(count - 1), x - first as f64)
        };
        let ((left, right, a), (top, bottom, b)) = (place(0, self.columns), place(1, self.rows));
        let node = |column: usize, row: usize| self.offset_px[row * self.columns + column];
        let (tl, tr, bl, br) = (node(left, top), node(right, top), node(left, bottom), node(right, bottom));
        let upper = tl + a * (tr - tl);
        let lower = bl + a * (br - bl);
        let scale = self.inverse_depth_per_px;
        let by_u = ((1.0 - b) * (tr - tl) + b * (br - bl)) * scale / self.side_px;
        let by_v = (lower - upper) * scale / self.side_px;
        ((upper + b * (lower - upper)) * scale, [by_u, by_v])
    }
}

/// Patches above, below, left and right.
fn neighbours(patch: usize, columns: usize, rows: usize) -> impl Iterator<Item = usize> {
    let (x, y) = (patch % columns, patch / columns);
    let left = (x > 0).then(|| patch - 1);
    let right = (x + 1 < columns).then_some(patch + 1);
    let up = (y > 0).then(|| patch - columns);
    let down = (y + 1 < rows).then_some(patch + columns);
    [left, right, up, down].into_iter().flatten()
}

/// Lowest cost of each candidate at each patch together with all other patches: min-sum messages between neighbours.
fn beliefs(relief: &Relief, candidates_px: &[f64], costs: &[Vec<f64>], sigma_px: f64) -> Vec<Vec<f64>> {
    let (count, labels) = (relief.offset_px.len(), candidates_px.len());
    let mut own = vec![vec![0.0; labels]; count];
    for (cost, &patch) in costs.iter().zip(&relief.patch_of_group) {
        own[patch].copy_from_slice(cost);
    }
    for own in &mut own {
        for (cost, candidate) in own.iter_mut().zip(candidates_px) {
            *cost += 0.5 * (candidate / sigma_px).powi(2);
        }
    }
    // Message to a patch from each side: left, right, up, down.
    let mut belief = own.clone();
    let mut messages = vec![vec![[0.0; 4]; labels]; count];
    for _ in 0..ROUNDS {
        let mut next = vec![vec![[0.0; 4]; labels]; count];
        for (patch, next) in next.iter_mut().enumerate() {
            for from in neighbours(patch, relief.columns, relief.rows) {
                let (side, back) = sides(patch, from, relief.columns);
                for (to_label, to) in candidates_px.iter().enumerate() {
                    let mut least = f64::MAX;
                    for (from_label, at) in candidates_px.iter().enumerate() {
                        let bend = (0.5 * ((to - at) / NEIGHBOUR_SIGMA_PX).powi(2)).min(NEIGHBOUR_COST_MAX);
                        least = least.min(belief[from][from_label] - messages[from][from_label][back] + bend);
                    }
                    next[to_label][side] = least;
                }
                let lowest = next.iter().map(|m| m[side]).fold(f64::MAX, f64::min);
                next.iter_mut().for_each(|m| m[side] -= lowest);
            }
        }
        messages = next;
        for patch in 0..count {
            for label in 0..labels {
                belief[patch][label] = own[patch][label] + messages[patch][label].iter().sum::<f64>();
            }
        }
    }
    belief
}

/// On which side of `patch` its neighbour lies, and on which side of the neighbour the patch.
fn sides(patch: usize, neighbour: usize, columns: usize) -> (usize, usize) {
    match neighbour {
        n if n + 1 == patch && columns > 1 => (0, 1),
        n if n == patch + 1 && columns > 1 => (1, 0),
        n if n < patch => (2, 3),
        _ => (3, 2),
    }
}

/// Place of the minimum between candidates at equal distances.
fn lowest(candidates_px: &[f64], costs: &[f64]) -> f64 {
    let best = (0..costs.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b])).unwrap_or(0);
    if best == 0 || best + 1 >= costs.len() {
        return candidates_px[best];
    }
    let (before, at, after) = (costs[best - 1], costs[best], costs[best + 1]);
    let bend = before - 2.0 * at + after;
    let shift = if bend > 1e-12 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    candidates_px[best] + shift * (candidates_px[best + 1] - candidates_px[best])
}

/// Sums for a correlation between a view and an image.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Correlation {
    count: f64,
    sums: [[f64; 5]; CHANNELS],
}

impl Correlation {
    /// Of sums by channel: view, image, view squared, image squared, view times image.
    pub(super) fn of_sums(count: f64, sums: [[f64; 5]; CHANNELS]) -> Self {
        Self { count, sums }
    }

    /// Adds a point with a weight.
    pub(super) fn add(&mut self, weight: f64, view: [f32; CHANNELS], image: [f32; CHANNELS]) {
        self.count += weight;
        for ((sums, a), b) in self.sums.iter_mut().zip(view).zip(image) {
            let (a, b) = (f64::from(a), f64::from(b));
            for (sum, term) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                *sum += weight * term;
            }
        }
    }

    /// The number of points, by weight.
    pub(super) fn count(&self) -> f64 {
        self.count
    }

    /// Variances of view and image and their covariance, summed over the channels, grey levels squared.
    pub(super) fn moments(&self) -> [f64; 3] {
        let n = self.count.max(1e-9);
        let mut moments = [0.0; 3];
        for [a, b, aa, bb, ab] in self.sums {
            moments[0] += aa / n - a * a / (n * n);
            moments[1] += bb / n - b * b / (n * n);
            moments[2] += ab / n - a * b / (n * n);
        }
        moments
    }

    /// Normalised cross-correlation over all channels, -1 to 1; 0 where nothing varies.
    pub(super) fn value(&self) -> f64 {
        let [a, b, ab] = self.moments();
        if a > 1e-9 && b > 1e-9 { (ab / (a * b).sqrt()).clamp(-1.0, 1.0) } else { 0.0 }
    }

    /// Negative log likelihood of the image given the view, for unknown gain, offset and noise.
    pub(super) fn cost(&self) -> f64 {
        let value = self.value().max(0.0);
        0.5 * self.count * (1.0 - value * value + 0.01).ln()
    }
}

/// Patch of each group of a level, for levels whose groups are not the patches.
pub(super) fn patches_of(relief: &Relief, pixels: impl Iterator<Item = [f64; 2]>) -> Vec<usize> {
    let mut group_of_patch = vec![usize::MAX; relief.offset_px.len()];
    for (group, &patch) in relief.patch_of_group.iter().enumerate() {
        group_of_patch[patch] = group;
    }
    pixels.map(|pixel| group_of_patch[relief.patch_at(pixel)]).collect()
}
