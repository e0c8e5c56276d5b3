//! The normal equations of one step: from sums to a step, a covariance, and the information about the surface.

use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

use super::kernels::{CHANNELS, GroupScore, NormalSums, PATCH, PATCH_GAINS, PATCH_OWN, PATCH_RESIDUAL, PairWeights};
use super::kernels::{ROW, SHAPE, TERMS, UNKNOWNS};
use super::observed::Shown;

/// Number of gains and offsets of both images in all channels.
const GAINS: usize = 4 * CHANNELS;
/// Number of all unknowns of a step.
pub(super) const ALL: usize = UNKNOWNS + GAINS;

pub(super) type Unknowns = SVector<f64, UNKNOWNS>;
pub(super) type UnknownsMatrix = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
pub(super) type AllMatrix = SMatrix<f64, ALL, ALL>;
pub(super) type AllVector = SVector<f64, ALL>;

/// Standard deviation of a gain from its last value, and of an offset in grey levels. Chosen by hand, not varied: weak, so
/// that a change of exposure is followed within a frame.
const GAIN_SIGMA: f64 = 0.3;
const OFFSET_SIGMA: f64 = 40.0;
/// Largest inflation of a covariance. Chosen by hand, not varied: a standard deviation grows by at most 5.
const INFLATION_MAX: f64 = 25.0;
/// Correction of the variance. Gradients come from the same noisy view as the residuals, and both are smoothed, as are the
/// samples of neighbouring points; robust weights underrate fitting points. Fitted on rendered sequences (as `bench accuracy --
/// --only track/`), eight kinds, six starts each: NEES 0.83 to 1.65, about inversely to it.
const SHARED_NOISE: f64 = 1.25;

/// Selection of the free unknowns of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Free {
    /// The motion and the row offset.
    Motion,
    /// Everything.
    Everything,
    /// The surface and the row offset: for the first pair, where the motion is zero by definition.
    Surface,
    /// The row offset only, with the gains.
    Row,
}

impl Free {
    fn holds(self, unknown: usize) -> bool {
        match self {
            Self::Motion => unknown >= SHAPE,
            Self::Everything => false,
            Self::Surface => unknown < 6,
            Self::Row => unknown != ROW,
        }
    }
}

/// Prior knowledge: information, and information times deviation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prior {
    pub(super) information: UnknownsMatrix,
    pub(super) pull: Unknowns,
}

/// A step.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) unknowns: Unknowns,
    pub(super) gain: [[f64; CHANNELS]; 2],
    pub(super) offset: [[f64; CHANNELS]; 2],
}

/// The normal equations of all points.
#[derive(Clone, Debug)]
pub(super) struct NormalEquations {
    matrix: AllMatrix,
    rhs: AllVector,
    /// Information about the motion that the noise of the view's gradients alone would give.
    pub(super) noise: Matrix6<f64>,
}

impl NormalEquations {
    /// Equations without observations.
    pub(super) fn empty() -> Self {
        Self { matrix: AllMatrix::zeros(), rhs: AllVector::zeros(), noise: Matrix6::zeros() }
    }

    /// Adds sums over points.
    pub(super) fn add(&mut self, sums: &NormalSums) {
        let mut entry = 0;
        for i in 0..UNKNOWNS {
            for j in i..UNKNOWNS {
                self.matrix[(i, j)] += f64::from(sums.hessian[entry].sum());
                entry += 1;
            }
            self.rhs[i] -= f64::from(sums.slope[i].sum());
        }
        for c in 0..CHANNELS {
            let at = |k: usize| UNKNOWNS + 4 * c + k;
            for i in 0..UNKNOWNS {
                for k in 0..4 {
                    self.matrix[(i, at(k))] -= f64::from(sums.cross[c][i][k].sum());
                }
            }
            let blocks = [(0, 0), (0, 2), (2, 2)];
            for ((row, column), sums) in blocks.into_iter().zip(&sums.gains[c]) {
                let [square, value, one] =
                    [sums.value_squared, sums.value, sums.one].map(|lanes| f64::from(lanes.sum()));
                self.matrix[(at(row), at(column))] += square;
                self.matrix[(at(row), at(column + 1))] += value;
                self.matrix[(at(row + 1), at(column + 1))] += one;
                if row != column {
                    self.matrix[(at(row + 1), at(column))] += value;
                }
            }
            for k in 0..4 {
                self.rhs[at(k)] += f64::from(sums.gain_slope[c][k].sum());
            }
        }
    }

    /// Eliminates an offset of each patch, common to both images, with standard deviation `sigma` grey levels: shading that
    /// does not rotate with the target.
    pub(super) fn remove_patch_offsets(&mut self, patches: &[[f32; PATCH]], sigma: f64) {
        let prior = 1.0 / (sigma * sigma);
        const TOUCHED: usize = PATCH_OWN;
        for patch in patches {
            let factor = 1.0 / (f64::from(patch[PATCH_OWN]) + prior);
            let line: [f64; TOUCHED] =
                std::array::from_fn(|i| if i < UNKNOWNS { -f64::from(patch[i]) } else { f64::from(patch[i]) });
            let residual = f64::from(patch[PATCH_RESIDUAL]);
            for i in 0..TOUCHED {
                let scaled = line[i] * factor;
                for (j, other) in line.iter().enumerate().skip(i) {
                    self.matrix[(i, j)] -= scaled * other;
                }
                self.rhs[i] -= scaled * residual;
            }
        }
    }

    /// The complete matrix with priors, without the fixed unknowns.
    fn closed(&self, prior: &Prior, free: Free) -> (AllMatrix, AllVector) {
        let (mut matrix, mut rhs) = (self.matrix, self.rhs);
        matrix.fill_lower_triangle_with_upper_triangle();
        for i in 0..UNKNOWNS {
            for j in 0..UNKNOWNS {
                matrix[(i, j)] += prior.information[(i, j)];
            }
            rhs[i] += prior.pull[i];
        }
        for k in 0..GAINS {
            let sigma = if k % 2 == 0 { GAIN_SIGMA } else { OFFSET_SIGMA };
            matrix[(UNKNOWNS + k, UNKNOWNS + k)] += 1.0 / (sigma * sigma);
        }
        for i in (0..UNKNOWNS).filter(|&i| free.holds(i)) {
            matrix.row_mut(i).fill(0.0);
            matrix.column_mut(i).fill(0.0);
            (matrix[(i, i)], rhs[i]) = (1.0, 0.0);
        }
        (matrix, rhs)
    }

    /// The step to the minimum; `None` if the equations are singular.
    pub(super) fn solve(&self, prior: &Prior, free: Free) -> Option<Step> {
        let (matrix, rhs) = self.closed(prior, free);
        let solution = matrix.cholesky()?.solve(&rhs);
        let gains =
            |k: usize| std::array::from_fn(|side| std::array::from_fn(|c| solution[UNKNOWNS + 4 * c + 2 * side + k]));
        let step = Step { unknowns: solution.fixed_rows::<UNKNOWNS>(0).into_owned(), gain: gains(0), offset: gains(1) };
        solution.iter().all(|x| x.is_finite()).then_some(step)
    }

    /// Solves the equations without the surface; `None` if they are singular.
    pub(super) fn inverse(&self, prior: &Prior, free: Free) -> Option<Equations> {
        let (matrix, rhs) = self.closed(prior, free);
        let inverse = matrix.cholesky()?.inverse();
        let held = |i: usize| i < UNKNOWNS && free.holds(i);
        inverse.iter().all(|x| x.is_finite()).then(|| Equations {
            inverse: AllMatrix::from_fn(|i, j| if held(i) || held(j) { 0.0 } else { inverse[(i, j)] }),
            rhs,
            noise: self.noise,
            prior: prior.information.diagonal().fixed_rows::<6>(0).into_owned(),
        })
    }
}

/// Covariance of pose, row offset and gains for independent noise of the assumed size and a known surface (zero for fixed
/// unknowns), and the right-hand side.
#[derive(Clone, Debug)]
pub(super) struct Equations {
    pub(super) inverse: AllMatrix,
    pub(super) rhs: AllVector,
    noise: Matrix6<f64>,
    /// Information about the motion without images.
    prior: Vector6<f64>,
}

impl Equations {
    /// Covariance of the pose on a known surface. It is the covariance of independent noise, without what the noise of the view itself
    /// seems to tell, inflated by the factor by which the scores of whole patches vary more than expected. Added to it is the effect of independent depth errors of the
    /// patches with standard deviations `depth_sigma` (1/m).
    pub(super) fn pose_covariance(
        &self,
        patches: &[PatchScore],
        depth_sigma: impl Iterator<Item = f64>,
    ) -> Option<Shown> {
        let shown = Shown::of(&self.inverse.fixed_view::<6, 6>(0, 0).into_owned(), &self.noise, &self.prior)?;
        let rows = self.inverse.fixed_view::<6, ALL>(0, 0);
        let (mut spread, mut relief) = (0.0, Matrix6::zeros());
        for (patch, sigma) in patches.iter().zip(depth_sigma) {
            let moved = rows * patch.score();
            for i in 0..6 {
                spread += moved[i] * moved[i] / self.inverse[(i, i)];
            }
            let moved: Vector6<f64> = rows * patch.cross() * sigma;
            relief += moved * moved.transpose();
        }
        let count = patches.len() as f64;
        let inflation = (spread / 6.0 * count / (count - 2.0).max(1.0)).clamp(1.0, INFLATION_MAX);
        let covariance = shown.covariance * (inflation * SHARED_NOISE) + relief;
        covariance.iter().all(|x| x.is_finite()).then_some(Shown { covariance, ..shown })
    }
}

/// The right-hand side of one patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct PatchScore {
    slope: [f32; UNKNOWNS],
    gain_slope: [f32; GAINS],
    /// Second derivatives with respect to the inverse depth of the patch and each unknown; the last one is with respect to the
    /// inverse depth twice.
    by_depth: [f32; UNKNOWNS],
    gain_by_depth: [f32; GAINS],
}

impl PatchScore {
    /// The score of a group, after eliminating its own offset.
    pub(super) fn of(group: &GroupScore, patch: &[f32; PATCH], sigma: f64) -> Self {
        let own = 1.0 / (patch[PATCH_OWN] + 1.0 / (sigma * sigma) as f32);
        let factor = patch[PATCH_RESIDUAL] * own;
        let slope = std::array::from_fn(|i| group.slope[i] - patch[i] * factor);
        let mut gain_slope: [f32; GAINS] = std::array::from_fn(|k| group.gain_slope[k / 4][k % 4]);
        for (k, gain) in gain_slope.iter_mut().take(4).enumerate() {
            *gain -= patch[PATCH_GAINS + k] * factor;
        }
        let common = patch[UNKNOWNS - 1];
        let by_depth = std::array::from_fn(|i| group.by_depth[i] - patch[i] * common * own);
        let mut gain_by_depth: [f32; GAINS] = std::array::from_fn(|k| group.gain_by_depth[k / 4][k % 4]);
        for (k, gain) in gain_by_depth.iter_mut().take(4).enumerate() {
            *gain -= patch[PATCH_GAINS + k] * common * own;
        }
        Self { slope, gain_slope, by_depth, gain_by_depth }
    }

    fn score(&self) -> AllVector {
        AllVector::from_fn(|i, _| match i {
            i if i < UNKNOWNS => -f64::from(self.slope[i]),
            i => f64::from(self.gain_slope[i - UNKNOWNS]),
        })
    }

    /// Second derivatives with respect to the inverse depth of the patch and all other unknowns.
    pub(super) fn cross(&self) -> AllVector {
        AllVector::from_fn(|i, _| match i {
            i if i < UNKNOWNS => f64::from(self.by_depth[i]),
            i => -f64::from(self.gain_by_depth[i - UNKNOWNS]),
        })
    }

    /// Information of the patch about its own inverse depth.
    pub(super) fn depth_information(&self) -> f64 {
        f64::from(self.by_depth[UNKNOWNS - 1])
    }

    /// Gradient of the residuals with respect to the inverse depth of the patch.
    pub(super) fn depth_pull(&self) -> f64 {
        -f64::from(self.slope[UNKNOWNS - 1])
    }
}

impl PairWeights {
    /// Weights for the variances of the three differences between a stored view, a left and a right image with independent
    /// noise: the inverse of the joint covariance, expressed as weights of the three differences.
    pub(super) fn of(variance: &[[f32; CHANNELS]; TERMS]) -> Self {
        let mut by_term = [[0.0; CHANNELS]; TERMS];
        for c in 0..CHANNELS {
            let [left, right, pair] = [variance[0][c], variance[1][c], variance[2][c]];
            let floor = 0.1 * left.min(right);
            let kept = (0.5 * (left + right - pair)).max(floor);
            let (a, b) = ((left - kept).max(floor), (right - kept).max(floor));
            let determinant = a * b + kept * (a + b);
            (by_term[0][c], by_term[1][c], by_term[2][c]) = (b / determinant, a / determinant, kept / determinant);
        }
        Self { by_term }
    }
}
