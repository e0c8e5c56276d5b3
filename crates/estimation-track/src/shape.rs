//! Surface shape from all frames: an information filter over the nodes of the relief.
//!
//! A frame has information about every patch's depth, and about its own pose, gains and row offset. The two are not
//! independent: a tilt error of the surface is a tilt error of the pose. Pose, gains and row offset are therefore marginalised
//! from each frame's equations (Schur complement). The remaining information about all nodes is accumulated. It corrects the
//! pose of a frame for the error shared with the surface, and the covariance of the pose includes the remaining uncertainty of
//! the surface.
//!
//! The unknowns are the disparities of the nodes in the first view relative to the initial plane, pixels. The smoothness of the
//! surface is estimated: differences between neighbours are normally distributed with a variance that maximises the evidence of
//! all frames. Planes are not penalised.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};

use super::dense::{cholesky, log_determinant, solve_lower, solve_upper};
use super::normal::{ALL, AllVector, Equations, PatchScore};

/// Range of the variance of the difference between neighbours, squared pixels, and the factor between tested values. Chosen
/// by hand, not varied: 0.001 px counts as flat, 1 px is no longer smooth; finer steps take time.
const ROUGHNESS_FLAT: f64 = 1e-6;
const ROUGHNESS_MAX: f64 = 1.0;
const ROUGHNESS_STEP: f64 = 2.0;
/// Initial value of the search. Chosen by hand, not varied: 0.14 px; the search climbs from it.
const ROUGHNESS_START: f64 = 0.02;
/// Largest number of search steps at the initialisation of a target. Chosen by hand, not varied: they reach from 0.02 to
/// the upper limit and to 0.009 px (0.02 / 2^8, squared pixels).
const STEPS_AT_START: usize = 8;
/// Log likelihood ratio that the data must give for a relief compared with none (150 times). Chosen by hand, not varied:
/// "very strong" in the scale of Kass and Raftery (1995).
const EVIDENCE_MIN: f64 = 5.0;
/// The roughness is estimated again when the information has grown by this factor. Chosen by hand, not varied: with
/// less, the search runs more often, which takes time.
const NEWS: f64 = 1.5;
/// Largest motion of a node in a frame, pixels. Chosen by hand, not varied: farther away, the linear equations are no
/// longer valid.
const MOVE_MAX_PX: f64 = 0.5;
/// Largest information about the relief per node on average, 1/px^2: the residual error is not noise. Chosen by hand, not
/// varied: 0.007 px; with more, errors of the model become permanent.
const INFORMATION_MAX: f64 = 2e4;

/// Weights of a frame's information.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shares {
    /// Weight of the information about the relief, for any plane.
    pub(super) relief: f64,
    /// Weight of the information about the plane.
    pub(super) plane: f64,
    /// Limit of the plane information from all frames, as a multiple of this frame's.
    pub(super) plane_in_all: f64,
}

/// The nodes of a relief that have points, and the relation between groups of points and nodes.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    /// Per group: nodes and their weights.
    pub(super) shares: Vec<Vec<(usize, f64)>>,
    /// Pairs of neighbours and their distance, in patches. The graph is connected.
    pub(super) edges: Vec<(usize, usize, f64)>,
    /// Disparity at a node per parameter of a plane (x, y, 1), up to a common factor.
    pub(super) plane: Vec<Vector3<f64>>,
}

/// Information filter of the surface shape; see the module documentation.
#[derive(Clone, Debug)]
pub(super) struct Shape {
    grid: Grid,
    /// Information of the data alone, 1/px^2 (row-major), and information times disparity.
    information: Vec<f64>,
    vector: Vec<f64>,
    prior: Vec<f64>,
    /// Information about the plane that [`Self::learn`] has used, with respect to the factors of [`Grid::plane`].
    plane_learnt: Matrix3<f64>,
    roughness: f64,
    may_be_rough: bool,
    /// Prior information that a node lies on the plane, 1/px^2.
    own: f64,
    evidence_of_prior: f64,
    known_at_roughness: f64,
    /// Disparities, pixels.
    pub(super) mean: Vec<f64>,
    /// Cholesky factor of information and prior.
    factor: Vec<f64>,
    frame: FrameShape,
    /// The means before the last frame, and rows of the prior.
    before: Vec<f64>,
    rows: Vec<f64>,
}

/// Information of a frame about the nodes.
#[derive(Clone, Debug, Default)]
struct FrameShape {
    /// Second derivatives with respect to node and the other unknowns, and their products with the covariance; [`ALL`] per
    /// node.
    cross: Vec<f64>,
    scaled: Vec<f64>,
    information: Vec<f64>,
    pull: Vec<f64>,
    column: Vec<f64>,
}

impl Shape {
    /// Creates a shape without information; `sigma_px` is the standard deviation of the surface about its plane, 0 for a flat
    /// one.
    pub(super) fn over(grid: Grid, sigma_px: f64) -> Self {
        let n = grid.plane.len();
        let is_flat = sigma_px <= 0.0;
        let mut shape = Self {
            information: vec![0.0; n * n],
            vector: vec![0.0; n],
            prior: vec![0.0; n * n],
            plane_learnt: Matrix3::zeros(),
            roughness: if is_flat { ROUGHNESS_FLAT } else { ROUGHNESS_START },
            may_be_rough: !is_flat,
            own: if is_flat { 1.0 / ROUGHNESS_FLAT } else { 1.0 / (sigma_px * sigma_px) },
            evidence_of_prior: 0.0,
            known_at_roughness: 0.0,
            mean: vec![0.0; n],
            factor: vec![0.0; n * n],
            frame: FrameShape {
                cross: vec![0.0; n * ALL],
                scaled: vec![0.0; n * ALL],
                information: vec![0.0; n * n],
                pull: vec![0.0; n],
                column: vec![0.0; n],
            },
            before: vec![0.0; n],
            rows: vec![0.0; 3 * n],
            grid,
        };
        shape.set_prior(shape.roughness);
        shape
    }

    fn count(&self) -> usize {
        self.mean.len()
    }

    /// Removes all information; the surface is at `mean`.
    pub(super) fn restart(&mut self, mean: &[f64]) {
        self.information.fill(0.0);
        self.vector.fill(0.0);
        self.plane_learnt = Matrix3::zeros();
        self.known_at_roughness = 0.0;
        self.mean.copy_from_slice(mean);
    }

    /// Reads a frame's equations: `equations` for pose, gains and row offset, `scores` of the groups, `px` the inverse depth
    /// per pixel of disparity.
    pub(super) fn read(&mut self, equations: &Equations, scores: &[PatchScore], px: f64) {
        let n = self.count();
        let frame = &mut self.frame;
        frame.cross.fill(0.0);
        frame.information.fill(0.0);
        frame.pull.fill(0.0);
        for (score, shares) in scores.iter().zip(&self.grid.shares) {
            let (cross, own, pull) = (score.cross() * px, score.depth_information() * px * px, score.depth_pull() * px);
            for &(node, share) in shares {
                let row = &mut frame.cross[node * ALL..(node + 1) * ALL];
                row.iter_mut().zip(cross.iter()).for_each(|(out, cross)| *out += share * cross);
                frame.pull[node] += share * pull;
                for &(other, with) in shares {
                    frame.information[node * n + other] += share * with * own;
                }
            }
        }
        for node in 0..n {
            let cross = AllVector::from_column_slice(&frame.cross[node * ALL..(node + 1) * ALL]);
            let scaled = equations.inverse * cross;
            frame.scaled[node * ALL..(node + 1) * ALL].copy_from_slice(scaled.as_slice());
            frame.pull[node] -= scaled.dot(&equations.rhs);
        }
        for i in 0..n {
            let left = &frame.scaled[i * ALL..(i + 1) * ALL];
            for j in 0..=i {
                let right = &frame.cross[j * ALL..(j + 1) * ALL];
                let taken: f64 = left.iter().zip(right).map(|(a, b)| a * b).sum();
                frame.information[i * n + j] -= taken;
                if i != j {
                    frame.information[j * n + i] = frame.information[i * n + j];
                }
            }
        }
    }

    /// Adds all information of the last frame read, and updates the surface; `false` if the system is singular.
    pub(super) fn learn_all(&mut self) -> bool {
        self.add()
    }

    /// Adds weighted information of the last frame read, and updates the surface; `false` if the system is singular.
    pub(super) fn learn(&mut self, shares: &Shares) -> bool {
        self.weigh_frame(shares);
        self.add()
    }

    fn add(&mut self) -> bool {
        let n = self.count();
        for i in 0..n {
            let line = &self.frame.information[i * n..(i + 1) * n];
            let at: f64 = line.iter().zip(&self.mean).map(|(a, b)| a * b).sum();
            self.vector[i] += at + self.frame.pull[i];
            let own = &mut self.information[i * n..(i + 1) * n];
            own.iter_mut().zip(line).for_each(|(own, new)| *own += new);
        }
        self.bound_relief();
        let known: f64 = (0..n).map(|i| self.information[i * n + i]).sum();
        if known > NEWS * self.known_at_roughness && self.may_be_rough {
            let steps = if self.known_at_roughness > 0.0 { 1 } else { STEPS_AT_START };
            self.known_at_roughness = known;
            self.find_roughness(steps);
        }
        if !self.solve() {
            return false;
        }
        self.before.copy_from_slice(&self.mean);
        for (mean, found) in self.mean.iter_mut().zip(&self.frame.column) {
            *mean += (found - *mean).clamp(-MOVE_MAX_PX, MOVE_MAX_PX);
        }
        true
    }

    /// Weights the information of the last frame read: one weight for the relief (for any plane), one for the plane.
    fn weigh_frame(&mut self, shares: &Shares) {
        let Self { grid, frame, rows, plane_learnt, .. } = self;
        let stiffness = plane_stiffness(&grid.plane, &frame.information, rows);
        // If rounding leaves no information about the plane, all information gets the weight of the relief.
        let beyond_relief = take_of_plane(plane_learnt, &stiffness, shares).unwrap_or_default();
        weigh(&mut frame.information, &mut frame.pull, shares.relief, &beyond_relief, &grid.plane, rows);
    }

    /// Reduces the information about the relief to [`INFORMATION_MAX`]. The information about the plane is kept: later frames
    /// contain less of it than the first pair, so the plane would follow their errors.
    fn bound_relief(&mut self) {
        let n = self.count();
        let known: f64 = (0..n).map(|i| self.information[i * n + i]).sum();
        if known <= INFORMATION_MAX * n as f64 {
            return;
        }
        let Self { grid, information, vector, rows, .. } = self;
        let stiffness = plane_stiffness(&grid.plane, information, rows);
        let Some(inverse) = stiffness.cholesky().map(|c| c.inverse()) else { return };
        let of_plane: f64 =
            rows.chunks_exact(3).map(Vector3::from_column_slice).map(|row| row.dot(&(inverse * row))).sum();
        let kept = (INFORMATION_MAX * n as f64 / (known - of_plane)).min(1.0);
        weigh(information, vector, kept, &(inverse * (1.0 - kept)), &grid.plane, rows);
    }

    /// Skips the information of the last frame read.
    pub(super) fn hold(&mut self) -> bool {
        self.before.copy_from_slice(&self.mean);
        self.solve()
    }

    /// Correction of the pose last read for a surface that has moved since, and the contribution of the surface to its
    /// covariance.
    pub(super) fn pose(&mut self) -> (Vector6<f64>, Matrix6<f64>) {
        let n = self.count();
        let (mut step, mut covariance) = (Vector6::zeros(), Matrix6::zeros());
        for node in 0..n {
            let scaled = Vector6::from_column_slice(&self.frame.scaled[node * ALL..node * ALL + 6]);
            step -= scaled * (self.mean[node] - self.before[node]);
        }
        // L^-1 of the six columns; their products are the covariance.
        let mut columns: [&mut [f64]; 6] = {
            let (used, _) = self.frame.cross.split_at_mut(6 * n);
            let mut parts = used.chunks_exact_mut(n);
            std::array::from_fn(|_| parts.next().unwrap_or_default())
        };
        for (axis, column) in columns.iter_mut().enumerate() {
            for (node, out) in column.iter_mut().enumerate() {
                *out = self.frame.scaled[node * ALL + axis];
            }
            solve_lower(&self.factor, n, column);
        }
        for i in 0..6 {
            for j in 0..6 {
                covariance[(i, j)] = columns[i].iter().zip(columns[j].iter()).map(|(a, b)| a * b).sum();
            }
        }
        (step, covariance)
    }

    /// Combines data and prior into the mean, in `frame.column`; the factor is kept for [`Self::pose`].
    fn solve(&mut self) -> bool {
        let n = self.count();
        self.factor.iter_mut().zip(self.information.iter().zip(&self.prior)).for_each(|(f, (a, b))| *f = a + b);
        if !cholesky(&mut self.factor, n) {
            return false;
        }
        self.frame.column.copy_from_slice(&self.vector);
        solve_lower(&self.factor, n, &mut self.frame.column);
        solve_upper(&self.factor, n, &mut self.frame.column);
        self.frame.column.iter().all(|x| x.is_finite())
    }

    /// Searches the roughness with the largest evidence, in at most `steps` steps from the last value. A flat surface stays
    /// flat unless the evidence against it is strong.
    fn find_roughness(&mut self, steps: usize) {
        let start = if self.is_flat() { ROUGHNESS_START } else { self.roughness };
        let (mut found, mut best) = (start, self.evidence(start).unwrap_or(f64::MIN));
        'directions: for factor in [ROUGHNESS_STEP, 1.0 / ROUGHNESS_STEP] {
            for step in 0..steps {
                let next = found * factor;
                match self.evidence(next) {
                    Some(evidence) if evidence > best => (found, best) = (next, evidence),
                    _ if step > 0 => break 'directions,
                    _ => break,
                }
            }
        }
        let flat = self.evidence(ROUGHNESS_FLAT).unwrap_or(f64::MIN);
        self.roughness = if best > flat + EVIDENCE_MIN { found } else { ROUGHNESS_FLAT };
        self.set_prior(self.roughness);
    }

    fn is_flat(&self) -> bool {
        self.roughness <= ROUGHNESS_FLAT
    }

    /// Log likelihood of the data for a roughness, up to a constant.
    fn evidence(&mut self, roughness: f64) -> Option<f64> {
        if !(ROUGHNESS_FLAT..=ROUGHNESS_MAX).contains(&roughness) {
            return None;
        }
        self.set_prior(roughness);
        let n = self.count();
        if !self.solve() {
            return None;
        }
        let explained: f64 = self.frame.column.iter().zip(&self.vector).map(|(a, b)| a * b).sum();
        Some(self.evidence_of_prior + 0.5 * (explained - log_determinant(&self.factor, n)))
    }

    /// Sets the prior for a roughness: small differences between neighbours, and small deviations of nodes from any plane.
    fn set_prior(&mut self, roughness: f64) {
        let n = self.count();
        let Self { prior, factor, grid, own, rows, .. } = self;
        prior.fill(0.0);
        for &(i, j, distance) in &grid.edges {
            for (row, column, sign) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
                prior[row * n + column] += sign / (roughness * distance);
            }
        }
        (0..n).for_each(|i| prior[i * n + i] += *own);
        factor.copy_from_slice(prior);
        if !cholesky(factor, n) {
            return;
        }
        let with_plane = |i: usize| -> Vector3<f64> {
            prior[i * n..(i + 1) * n].iter().zip(&grid.plane).map(|(weight, plane)| plane * *weight).sum()
        };
        let mut stiffness = Matrix3::zeros();
        for (i, plane) in grid.plane.iter().enumerate() {
            let row = with_plane(i);
            stiffness += plane * row.transpose();
            rows[3 * i..3 * i + 3].copy_from_slice(row.as_slice());
        }
        let Some(stiffness) = stiffness.cholesky() else { return };
        self.evidence_of_prior = 0.5 * log_determinant(factor, n) - stiffness.l().diagonal().map(f64::ln).sum();
        let inverse = stiffness.inverse();
        for i in 0..n {
            let row = inverse * Vector3::from_column_slice(&rows[3 * i..3 * i + 3]);
            for j in 0..n {
                prior[i * n + j] -= row.dot(&Vector3::from_column_slice(&rows[3 * j..3 * j + 3]));
            }
        }
    }

    /// The plane common to all nodes, weighted by their information, as factors of [`Grid::plane`].
    pub(super) fn common_plane(&self) -> Vector3<f64> {
        let n = self.count();
        let (mut matrix, mut rhs) = (Matrix3::identity() * 1e-9, Vector3::zeros());
        for (i, (plane, mean)) in self.grid.plane.iter().zip(&self.mean).enumerate() {
            let weight = self.information[i * n + i];
            matrix += plane * plane.transpose() * weight;
            rhs += plane * (weight * mean);
        }
        matrix.cholesky().map(|c| c.solve(&rhs)).unwrap_or_default()
    }

    /// Pairs of neighbours and their distance, in patches.
    pub(super) fn edges(&self) -> &[(usize, usize, f64)] {
        &self.grid.edges
    }

    /// Rays of the nodes in the first left camera; the third component is 1.
    pub(super) fn rays(&self) -> &[Vector3<f64>] {
        &self.grid.plane
    }

    /// Standard deviation of the disparity of each group of points, pixels.
    pub(super) fn sigmas_px(&self) -> Vec<f64> {
        let n = self.count();
        let sigma = |shares: &Vec<(usize, f64)>| {
            let mut weights = vec![0.0; n];
            shares.iter().for_each(|&(node, share)| weights[node] += share);
            // With L L' the information, |L^-1 w|^2 is the variance of w' d.
            solve_lower(&self.factor, n, &mut weights);
            weights.iter().map(|x| x * x).sum::<f64>().sqrt()
        };
        self.grid.shares.iter().map(sigma).collect()
    }

    /// Deviation of a node from a plane, pixels.
    pub(super) fn beyond(&self, node: usize, plane: &Vector3<f64>) -> f64 {
        self.mean[node] - self.grid.plane[node].dot(plane)
    }

    /// Root mean square of the last motion of the nodes, pixels.
    pub(super) fn moved_px(&self) -> f64 {
        let squares = self.mean.iter().zip(&self.before).map(|(now, before)| (now - before).powi(2));
        (squares.sum::<f64>() / self.count().max(1) as f64).sqrt()
    }
}

/// Information about the common plane that follows from the `information` about nodes. `rows`, with three numbers per node,
/// receives the product of information and planes.
fn plane_stiffness(planes: &[Vector3<f64>], information: &[f64], rows: &mut [f64]) -> Matrix3<f64> {
    let n = planes.len();
    let mut stiffness = Matrix3::zeros();
    for (i, plane) in planes.iter().enumerate() {
        let line = &information[i * n..(i + 1) * n];
        let row: Vector3<f64> = line.iter().zip(planes).map(|(weight, plane)| plane * *weight).sum();
        stiffness += plane * row.transpose();
        rows[3 * i..3 * i + 3].copy_from_slice(row.as_slice());
    }
    stiffness + Matrix3::identity() * (1e-9 * stiffness.trace().abs() + 1e-9)
}

/// Adds to `learnt` the part of a frame's plane information `stiffness` that is used. Returns the difference between this part
/// and the relief's weight, for [`weigh`]. `None` if `stiffness` is not positive definite.
fn take_of_plane(learnt: &mut Matrix3<f64>, stiffness: &Matrix3<f64>, shares: &Shares) -> Option<Matrix3<f64>> {
    let lower = stiffness.cholesky()?.l();
    let inverse = lower.solve_lower_triangular(&Matrix3::identity())?;
    // In these axes the frame's information about the plane is 1.
    let known = inverse * *learnt * inverse.transpose();
    let axes = (0.5 * (known + known.transpose())).symmetric_eigen();
    let taken = axes.eigenvalues.map(|known| shares.plane.min((shares.plane_in_all - known).max(0.0)));
    let taken = axes.eigenvectors * Matrix3::from_diagonal(&taken) * axes.eigenvectors.transpose();
    *learnt += lower * taken * lower.transpose();
    Some(inverse.transpose() * (taken - Matrix3::identity() * shares.relief) * inverse)
}

/// Scales information and vector by a share, and adds `by_plane` for the component along the plane.
fn weigh(
    information: &mut [f64],
    vector: &mut [f64],
    share: f64,
    by_plane: &Matrix3<f64>,
    planes: &[Vector3<f64>],
    rows: &[f64],
) {
    let n = planes.len();
    let along_plane: Vector3<f64> = planes.iter().zip(vector.iter()).map(|(plane, value)| plane * *value).sum();
    for i in 0..n {
        let row = by_plane * Vector3::from_column_slice(&rows[3 * i..3 * i + 3]);
        vector[i] = share * vector[i] + row.dot(&along_plane);
        for j in 0..n {
            let more = row.dot(&Vector3::from_column_slice(&rows[3 * j..3 * j + 3]));
            information[i * n + j] = share * information[i * n + j] + more;
        }
    }
}

#[cfg(test)]
#[path = "shape_tests.rs"]
mod tests;
