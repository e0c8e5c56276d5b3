//! The relief: deviation of the surface from its plane, per patch of the first view, in pixels of disparity.

use nalgebra::{Vector2, Vector3};
use pb3dp_geometry::Camera;

use super::shape::Grid;
use crate::cells::Cells;

/// Typical difference between neighbours, pixels. Chosen by hand, not varied: with less, reliefs are flattened at the
/// start; with more, noise bends them.
const NEIGHBOUR_SIGMA_PX: f64 = 0.7;
/// Largest cost of a step between neighbours. Chosen by hand, not varied: reached at 3.5 standard deviations (sqrt(2 x 6));
/// farther steps cost no more.
const NEIGHBOUR_COST_MAX: f64 = 6.0;
/// Largest number of nodes: a frame's time grows with their third power. Chosen by hand, not varied: 11 x 11.
const NODES_MAX: usize = 121;
/// Expected error of a patch's offset as a share of the surface's curvature at the patch: about the error of bilinear
/// interpolation on a parabola. Fitted on eleven rendered sequences, six starts each: NEES of reliefs of 10 mm 0.7 and of 25 mm
/// 1.6, with 0.45 it was 0.3 and 0.45.
const BEND_SHARE: f64 = 0.18;
/// Number of message-passing rounds between neighbours. Chosen by hand, not varied: messages reach twelve patches; the
/// default of 1024 points makes about 8 x 8.
const ROUNDS: usize = 12;

/// Offsets on a grid of patches, bilinear in between. A patch without points has the mean offset of the adjacent patches with
/// points.
#[derive(Clone, Debug)]
pub(super) struct Relief {
    first_centre_px: [f64; 2],
    side_px: f64,
    columns: usize,
    rows: usize,
    /// Disparity of the surface relative to its plane, pixels.
    offset_px: Vec<f64>,
    /// Patches without points, and the patches with points that replace each of them.
    stand_ins: Vec<(usize, Vec<usize>)>,
    /// Patch of each group of the finest level.
    patch_of_group: Vec<usize>,
    /// Node of each group, see [`Self::grid`].
    node_of_group: Vec<usize>,
    /// Inverse depth per pixel of disparity, 1/m.
    inverse_depth_per_px: f64,
}

impl Relief {
    /// Creates a flat relief.
    pub(super) fn over(cells: &Cells, inverse_depth_per_px: f64) -> Self {
        let (columns, rows) = (cells.columns.max(1), cells.rows.max(1));
        let patch_of_group: Vec<usize> = cells.cells.iter().map(|cell| cell.row * columns + cell.column).collect();
        Self {
            first_centre_px: cells.first_centre_px,
            side_px: cells.side_px.max(1.0),
            columns,
            rows,
            offset_px: vec![0.0; columns * rows],
            stand_ins: stand_ins(&patch_of_group, columns, rows),
            patch_of_group,
            node_of_group: Vec::new(),
            inverse_depth_per_px,
        }
    }

    /// Number of patches with points.
    pub(super) fn patches(&self) -> usize {
        self.patch_of_group.len()
    }

    /// Node of each group.
    pub(super) fn node_of_group(&self) -> &[usize] {
        &self.node_of_group
    }

    /// Per patch: whether its node is among those `kept`; for a patch without points, whether all nodes that replace it are.
    pub(super) fn patches_of(&self, kept: &[bool]) -> Vec<bool> {
        let mut patches = vec![false; self.offset_px.len()];
        for (&node, &patch) in self.node_of_group.iter().zip(&self.patch_of_group) {
            patches[patch] = kept[node];
        }
        for (patch, known) in &self.stand_ins {
            patches[*patch] = known.iter().all(|&other| patches[other]);
        }
        patches
    }

    /// Sets the relief to zero permanently.
    pub(super) fn hold_flat(&mut self) {
        self.offset_px.fill(0.0);
    }

    /// Sets the offset of the whole surface from its plane, pixels of disparity.
    pub(super) fn set_all(&mut self, offset_px: f64) {
        self.offset_px.fill(offset_px);
    }

    /// Patch of a raw pixel of the first view.
    pub(super) fn patch_at(&self, pixel: [f64; 2]) -> usize {
        let place = |axis: usize, count: usize| {
            let x = (pixel[axis] - self.first_centre_px[axis]) / self.side_px;
            (x.round().max(0.0) as usize).min(count - 1)
        };
        place(1, self.rows) * self.columns + place(0, self.columns)
    }

    /// Selects the candidate offsets that explain the pair best while neighbours differ little; `costs` are negative log
    /// likelihoods by patch and candidate.
    pub(super) fn take_best(&mut self, candidates_px: &[f64], costs: &[Vec<f64>], sigma_px: f64) {
        let labels = beliefs(self, candidates_px, costs, sigma_px);
        for &patch in &self.patch_of_group {
            self.offset_px[patch] = lowest(candidates_px, &labels[patch]);
        }
        self.fill();
    }

    /// Standard deviation of each group's inverse depth, 1/m, due to the limited resolution of the patch grid on a curved
    /// surface.
    pub(super) fn depth_sigma(&self) -> impl Iterator<Item = f64> + '_ {
        self.patch_of_group.iter().map(|&patch| {
            let (mut sum, mut count) = (0.0, 0.0);
            for neighbour in neighbours(patch, self.columns, self.rows) {
                (sum, count) = (sum + self.offset_px[neighbour], count + 1.0);
            }
            let bend_px = if count > 0.0 { self.offset_px[patch] - sum / count } else { 0.0 };
            (BEND_SHARE * bend_px).abs() * self.inverse_depth_per_px
        })
    }

    /// Builds nodes from the patches with points; with many patches, several share a node. `pixels` are those of each group,
    /// raw pixels of the first view.
    pub(super) fn grid(&mut self, pixels: impl Iterator<Item = Vec<[f64; 2]>>, camera: &Camera) -> Grid {
        let side = (self.patch_of_group.len() as f64 / NODES_MAX as f64).sqrt().ceil().max(1.0) as usize;
        let across = self.columns.div_ceil(side);
        let place = |patch: usize| patch / self.columns / side * across + patch % self.columns / side;
        let mut places: Vec<usize> = self.patch_of_group.iter().map(|&patch| place(patch)).collect();
        let every_place = places.clone();
        places.sort_unstable();
        places.dedup();
        let node_at = |place: &usize| places.binary_search(place).unwrap_or(0);
        self.node_of_group = every_place.iter().map(node_at).collect();
        let mut node_of_patch = vec![usize::MAX; self.offset_px.len()];
        for (&node, &patch) in self.node_of_group.iter().zip(&self.patch_of_group) {
            node_of_patch[patch] = node;
        }
        let known = |patch: usize| Some(node_of_patch[patch]).filter(|&node| node != usize::MAX);
        let instead = |patch: usize| self.stand_ins.iter().find(|(without, _)| *without == patch);
        let shares = pixels.map(|pixels| {
            let mut shares: Vec<(usize, f64)> = Vec::new();
            let mut add = |node: usize, share: f64| match shares.iter_mut().find(|(at, _)| *at == node) {
                Some((_, sum)) => *sum += share,
                None => shares.push((node, share)),
            };
            let each = 1.0 / pixels.len().max(1) as f64;
            for pixel in &pixels {
                for (patch, share) in self.corners(*pixel) {
                    let own = std::slice::from_ref(&patch);
                    let patches = instead(patch).map_or(own, |(_, known)| known.as_slice());
                    for node in patches.iter().copied().filter_map(known) {
                        add(node, each * share / patches.len() as f64);
                    }
                }
            }
            shares
        });
        let after = |patch: usize| neighbours(patch, self.columns, self.rows).filter(move |&n| n > patch);
        let mut neighbours: Vec<(usize, usize)> = Vec::new();
        for (&node, &patch) in self.node_of_group.iter().zip(&self.patch_of_group) {
            let others = after(patch).filter_map(known).filter(|&other| other != node);
            neighbours.extend(others.map(|other| (node.min(other), node.max(other))));
        }
        neighbours.sort_unstable();
        neighbours.dedup();
        let centres: Vec<[f64; 2]> = places.iter().map(|&at| [(at % across) as f64, (at / across) as f64]).collect();
        let edges = hang_together(&neighbours, &centres);
        let mut plane = vec![(Vector3::zeros(), 0.0); places.len()];
        for (&node, &patch) in self.node_of_group.iter().zip(&self.patch_of_group) {
            let place = |axis: usize, index: usize| self.first_centre_px[axis] + self.side_px * index as f64;
            let centre = Vector2::new(place(0, patch % self.columns), place(1, patch / self.columns));
            plane[node].0 += camera.unproject(&centre).unwrap_or_else(|_| Vector3::z());
            plane[node].1 += 1.0;
        }
        let plane = plane.into_iter().map(|(sum, count): (Vector3<f64>, f64)| sum / count.max(1.0)).collect();
        Grid { shares: shares.collect(), edges, plane }
    }

    /// Mean offset of the patches of each node, pixels.
    pub(super) fn nodes(&self, count: usize) -> Vec<f64> {
        let mut sums = vec![(0.0, 0.0); count];
        for (&node, &patch) in self.node_of_group.iter().zip(&self.patch_of_group) {
            sums[node].0 += self.offset_px[patch];
            sums[node].1 += 1.0;
        }
        sums.into_iter().map(|(sum, count): (f64, f64)| sum / count.max(1.0)).collect()
    }

    /// Sets the offsets of the patches with points to those of their nodes, pixels.
    pub(super) fn set_nodes(&mut self, offset_px: impl Fn(usize) -> f64) {
        for (&patch, &node) in self.patch_of_group.iter().zip(&self.node_of_group) {
            self.offset_px[patch] = offset_px(node);
        }
        self.fill();
    }

    /// Inverse depth per pixel of disparity, 1/m.
    pub(super) fn inverse_depth_per_px(&self) -> f64 {
        self.inverse_depth_per_px
    }

    /// Fills the patches without points from their replacements.
    fn fill(&mut self) {
        for (patch, known) in &self.stand_ins {
            let sum: f64 = known.iter().map(|&other| self.offset_px[other]).sum();
            self.offset_px[*patch] = sum / known.len().max(1) as f64;
        }
    }

    /// The patches around a raw pixel of the first view, with their interpolation weights.
    fn corners(&self, pixel: [f64; 2]) -> [(usize, f64); 4] {
        let ((left, right, a), (top, bottom, b)) = self.place(pixel);
        let at = |column: usize, row: usize| row * self.columns + column;
        [
            (at(left, top), (1.0 - a) * (1.0 - b)),
            (at(right, top), a * (1.0 - b)),
            (at(left, bottom), (1.0 - a) * b),
            (at(right, bottom), a * b),
        ]
    }

    /// Columns and rows on either side of a pixel, and its fractional position between them, 0 to 1.
    fn place(&self, pixel: [f64; 2]) -> ((usize, usize, f64), (usize, usize, f64)) {
        let place = |axis: usize, count: usize| {
            let x = ((pixel[axis] - self.first_centre_px[axis]) / self.side_px).clamp(0.0, (count - 1) as f64);
            let first = (x as usize).min(count.saturating_sub(2));
            (first, (first + 1).min(count - 1), x - first as f64)
        };
        (place(0, self.columns), place(1, self.rows))
    }

    /// Correction of the plane's inverse depth at a raw pixel of the first view, 1/m, and its derivatives by u and v.
    pub(super) fn at(&self, pixel: [f64; 2]) -> (f64, [f64; 2]) {
        let ((left, right, a), (top, bottom, b)) = self.place(pixel);
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

/// For each patch without points, the horizontally or vertically adjacent patches with points, or otherwise the diagonal ones.
fn stand_ins(patch_of_group: &[usize], columns: usize, rows: usize) -> Vec<(usize, Vec<usize>)> {
    let mut has_points = vec![false; columns * rows];
    patch_of_group.iter().for_each(|&patch| has_points[patch] = true);
    let without = (0..columns * rows).filter(|&patch| !has_points[patch]);
    let known =
        |patches: &mut dyn Iterator<Item = usize>| -> Vec<usize> { patches.filter(|&p| has_points[p]).collect() };
    without
        .map(|patch| {
            let beside = known(&mut neighbours(patch, columns, rows));
            if !beside.is_empty() {
                return (patch, beside);
            }
            let (x, y) = (patch % columns, patch / columns);
            let across = (y.saturating_sub(1)..(y + 2).min(rows))
                .flat_map(|row| (x.saturating_sub(1)..(x + 2).min(columns)).map(move |column| row * columns + column));
            (patch, known(&mut { across }))
        })
        .collect()
}

/// The edges between neighbours, and the shortest edges that connect otherwise separate parts. A target is one surface even if
/// the region between its parts is too narrow for a patch.
fn hang_together(neighbours: &[(usize, usize)], centres: &[[f64; 2]]) -> Vec<(usize, usize, f64)> {
    let mut part: Vec<usize> = (0..centres.len()).collect();
    let mut edges = Vec::with_capacity(neighbours.len());
    let mut join = |(i, j, distance): (usize, usize, f64), only_apart: bool| {
        let (from, to) = (part[i], part[j]);
        if from != to || !only_apart {
            edges.push((i, j, distance));
            part.iter_mut().filter(|part| **part == from).for_each(|part| *part = to);
        }
    };
    neighbours.iter().for_each(|&(i, j)| join((i, j, 1.0), false));
    let distance = |i: usize, j: usize| (centres[i][0] - centres[j][0]).hypot(centres[i][1] - centres[j][1]);
    let pairs = (0..centres.len()).flat_map(|j| (0..j).map(move |i| (i, j)));
    let mut pairs: Vec<(usize, usize, f64)> = pairs.map(|(i, j)| (i, j, distance(i, j))).collect();
    pairs.sort_by(|a, b| a.2.total_cmp(&b.2));
    pairs.into_iter().for_each(|pair| join(pair, true));
    edges
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

/// Lowest total cost of each candidate at each patch, over all other patches: min-sum messages between neighbours.
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

/// Side of `patch` on which the neighbour is, and side of the neighbour on which the patch is.
fn sides(patch: usize, neighbour: usize, columns: usize) -> (usize, usize) {
    match neighbour {
        n if n + 1 == patch && columns > 1 => (0, 1),
        n if n == patch + 1 && columns > 1 => (1, 0),
        n if n < patch => (2, 3),
        _ => (3, 2),
    }
}

/// Sub-candidate position of the minimum; the candidates are equidistant.
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

/// Patch of each group of a level, for levels with other groups than the patches.
pub(super) fn patches_of(relief: &Relief, pixels: impl Iterator<Item = [f64; 2]>) -> Vec<usize> {
    let mut group_of_patch = vec![usize::MAX; relief.offset_px.len()];
    for (group, &patch) in relief.patch_of_group.iter().enumerate() {
        group_of_patch[patch] = group;
    }
    pixels.map(|pixel| group_of_patch[relief.patch_at(pixel)]).collect()
}

#[cfg(test)]
#[path = "relief_tests.rs"]
mod tests;
