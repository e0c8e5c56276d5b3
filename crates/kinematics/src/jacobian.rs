//! Singular values of a Jacobian and its damped inverse.
//!
//! A Jacobian mixes metres and radians, so its singular values depend on the unit of length. Here the unit is always the metre:
//! for an arm with a reach of one metre both halves then have about the same weight.

use nalgebra::{SMatrix, SVector};

use crate::DOF;

/// Rows `[linear; angular]` (m/s, rad/s), one column per joint (rad/s).
pub type Jacobian = SMatrix<f64, 6, DOF>;

/// Maps a twist `[linear; angular]` to joint velocities.
pub type PseudoInverse = SMatrix<f64, DOF, 6>;

/// More sweeps than a 7x6 matrix ever needs (5 to 8); the limit exists for numbers that are not finite.
const SWEEPS_MAX: usize = 30;

/// Columns with a cosine below this are orthogonal.
const ORTHOGONAL: f64 = 1e-14;

/// Damping of motion along nearly singular directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Damping {
    threshold: f64,
    factor_max: f64,
}

/// Why numbers are not a valid damping.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("damping {name} is {value}; it must be a positive, finite number")]
pub struct DampingError {
    /// `threshold` or `factor_max`.
    pub name: &'static str,
    /// The value given.
    pub value: f64,
}

impl Damping {
    /// Damping that starts when a singular value falls below `threshold` and grows to `factor_max` at zero.
    ///
    /// # Errors
    /// If a number is not positive and finite.
    pub fn new(threshold: f64, factor_max: f64) -> Result<Self, DampingError> {
        for (name, value) in [("threshold", threshold), ("factor_max", factor_max)] {
            if !(value.is_finite() && value > 0.0) {
                return Err(DampingError { name, value });
            }
        }
        Ok(Self { threshold, factor_max })
    }

    /// Singular value below which damping is active.
    pub fn threshold(&self) -> f64 {
        self.threshold
    }

    /// Damping factor at a singular value of zero.
    pub fn factor_max(&self) -> f64 {
        self.factor_max
    }

    /// Largest gain of a [`damped_pseudo_inverse`]: joint speed (rad/s) per unit of twist (m/s and rad/s).
    pub fn gain_max(&self) -> f64 {
        let ratio_squared = (self.factor_max / self.threshold).powi(2);
        // Up to a ratio of 1/sqrt(2) the peak is below the threshold, above it on the threshold.
        if ratio_squared <= 0.5 { 0.5 / (self.factor_max * (1.0 - ratio_squared).sqrt()) } else { 1.0 / self.threshold }
    }

    /// Square of the damping factor for a singular value.
    fn factor_squared(&self, singular_value: f64) -> f64 {
        let depth = 1.0 - (singular_value / self.threshold).powi(2);
        depth.max(0.0) * self.factor_max.powi(2)
    }
}

/// Singular value decomposition of a Jacobian, stored so that repeated queries cost only one decomposition.
///
/// `jacobian = left * columns^T`, with orthonormal `left` and orthogonal `columns` whose lengths are the singular values.
#[derive(Clone, Copy, Debug)]
pub struct SingularForm {
    columns: SMatrix<f64, DOF, 6>,
    left: SMatrix<f64, 6, 6>,
}

impl SingularForm {
    /// Decomposes a Jacobian.
    pub fn new(jacobian: &Jacobian) -> Self {
        orthogonalise(jacobian.transpose(), SMatrix::identity())
    }

    /// Decomposes a Jacobian near the one of this form, as in the next step along a path, in less time than [`Self::new`]. Each step
    /// adds its rounding, 1e-15 of the values: a loop that never ends begins anew.
    pub fn near(&self, jacobian: &Jacobian) -> Self {
        orthogonalise(jacobian.transpose() * self.left, self.left)
    }

    /// The six singular values, largest first.
    pub fn values(&self) -> SVector<f64, 6> {
        let mut values: [f64; 6] = std::array::from_fn(|i| self.columns.column(i).norm());
        values.sort_by(|a, b| b.total_cmp(a));
        values.into()
    }

    /// Smallest singular value: 0 if the arm cannot move in some direction. For units see the module documentation.
    pub fn smallest_value(&self) -> f64 {
        self.values()[5]
    }

    /// Damped least-squares inverse of the Jacobian, with a bounded gain at singularities.
    ///
    /// Each singular value sigma is inverted as sigma / (sigma^2 + lambda^2) with lambda^2 = (1 - (sigma/threshold)^2)
    /// factor_max^2 below the threshold and 0 above it. Damped least squares after Nakamura and Hanafusa (1986), with the
    /// variable factor limited to the singular directions after Chiaverini (1997). Away from singularities it is exactly the
    /// Moore-Penrose inverse, the result is continuous in the Jacobian, and directions in which the arm can still move are not
    /// slowed. The gain never exceeds [`Damping::gain_max`].
    pub fn damped_inverse(&self, damping: &Damping) -> PseudoInverse {
        let mut inverse = PseudoInverse::zeros();
        for i in 0..6 {
            let squared = self.columns.column(i).norm_squared();
            let denominator = squared + damping.factor_squared(squared.sqrt());
            inverse += self.columns.column(i) * self.left.column(i).transpose() / denominator;
        }
        inverse
    }
}

/// See [`SingularForm::damped_inverse`].
pub fn damped_pseudo_inverse(jacobian: &Jacobian, damping: &Damping) -> PseudoInverse {
    SingularForm::new(jacobian).damped_inverse(damping)
}

/// The six singular values, largest first.
pub fn singular_values(jacobian: &Jacobian) -> SVector<f64, 6> {
    SingularForm::new(jacobian).values()
}

/// See [`SingularForm::smallest_value`].
pub fn smallest_singular_value(jacobian: &Jacobian) -> f64 {
    SingularForm::new(jacobian).smallest_value()
}

/// Yoshikawa's manipulability sqrt(det(J J^T)), the product of the singular values.
pub fn manipulability(jacobian: &Jacobian) -> f64 {
    singular_values(jacobian).iter().product()
}

/// One-sided Jacobi iteration (Hestenes 1958) on the transposed Jacobian: always terminates, and is accurate for small singular
/// values, unlike an eigendecomposition of `J J^T`.
///
/// `jacobian = left * columns^T` holds before and after.
fn orthogonalise(mut columns: SMatrix<f64, DOF, 6>, mut left: SMatrix<f64, 6, 6>) -> SingularForm {
    // Values below this count as zero, so that two singular directions do not rotate about each other forever.
    let negligible = columns.norm_squared() * f64::EPSILON * f64::EPSILON;
    for _ in 0..SWEEPS_MAX {
        let mut turned = false;
        for a in 0..6 {
            for b in a + 1..6 {
                let (aa, bb) = (columns.column(a).norm_squared(), columns.column(b).norm_squared());
                let ab = columns.column(a).dot(&columns.column(b));
                if ab * ab > ORTHOGONAL * ORTHOGONAL * aa * bb && ab.abs() > negligible {
                    let (cosine, sine) = orthogonalising_turn(aa, bb, ab);
                    turn_columns(&mut columns, a, b, cosine, sine);
                    turn_columns(&mut left, a, b, cosine, sine);
                    turned = true;
                }
            }
        }
        if !turned {
            break;
        }
    }
    SingularForm { columns, left }
}

/// Cosine and sine of the smaller of the rotations that make two columns with these products orthogonal.
fn orthogonalising_turn(aa: f64, bb: f64, ab: f64) -> (f64, f64) {
    // At most 1e32, because `ab` is not negligible: no square overflows, and `hypot` is not needed.
    let zeta = (bb - aa) / (2.0 * ab);
    let tangent = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
    let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
    (cosine, cosine * tangent)
}

fn turn_columns<const ROWS: usize>(matrix: &mut SMatrix<f64, ROWS, 6>, a: usize, b: usize, cosine: f64, sine: f64) {
    for row in 0..ROWS {
        let (x, y) = (matrix[(row, a)], matrix[(row, b)]);
        matrix[(row, a)] = cosine * x - sine * y;
        matrix[(row, b)] = sine * x + cosine * y;
    }
}
