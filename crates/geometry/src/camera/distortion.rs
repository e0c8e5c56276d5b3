//! Lens distortion models on normalised coordinates, with their Jacobians and inverses.

use std::f64::consts::FRAC_PI_2;

use nalgebra::{Matrix2, Vector2};

/// Lens distortion model, applied to normalised coordinates.
///
/// The formulas are those of OpenCV's `calib3d` and `fisheye` modules, which ROS and Kalibr also use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// An ideal or already undistorted image.
    None,
    /// Brown-Conrady with 5 coefficients (ROS `plumb_bob`, Kalibr `radtan` with k3 = 0), OpenCV order.
    BrownConrady5 {
        /// k1, k2, p1, p2, k3.
        coefficients: [f64; 5],
    },
    /// Brown-Conrady with a rational radial term (ROS `rational_polynomial`), OpenCV order.
    BrownConrady8 {
        /// k1, k2, p1, p2, k3, k4, k5, k6.
        coefficients: [f64; 8],
    },
    /// Kannala-Brandt equidistant fisheye.
    Equidistant {
        /// k1, k2, k3, k4.
        coefficients: [f64; 4],
    },
}

/// Names of the coefficients in the order of the Brown-Conrady models.
const BROWN_NAMES: [&str; 8] = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
/// Names of the coefficients of the equidistant model.
const EQUIDISTANT_NAMES: [&str; 4] = ["k1", "k2", "k3", "k4"];
/// Number of angles from the axis at which the search for the fold samples the radial function.
const FOLD_SAMPLES: u32 = 2000;
/// The largest angle from the axis for which `(x, y, 1)` is still accurate, radians.
const ANGLE_MAX_RAD: f64 = FRAC_PI_2 - 1e-6;
/// Largest number of Newton steps for one inversion; a well-behaved lens needs four or five.
const NEWTON_STEPS: usize = 50;
/// Largest number of halvings of one Newton step.
const HALVINGS: usize = 12;

impl Distortion {
    /// The coefficients with their names, in the model's order; empty for [`Distortion::None`].
    pub fn named_coefficients(&self) -> impl Iterator<Item = (&'static str, f64)> + '_ {
        let names: &'static [&'static str] = match self {
            Self::Equidistant { .. } => &EQUIDISTANT_NAMES,
            _ => &BROWN_NAMES,
        };
        names.iter().copied().zip(self.coefficients().iter().copied())
    }

    /// The coefficients in the model's order; empty for [`Distortion::None`].
    pub fn coefficients(&self) -> &[f64] {
        match self {
            Self::None => &[],
            Self::BrownConrady5 { coefficients } => coefficients,
            Self::BrownConrady8 { coefficients } => coefficients,
            Self::Equidistant { coefficients } => coefficients,
        }
    }

    /// Distorts undistorted normalised coordinates.
    #[inline]
    pub fn distort(&self, xy: &Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::None => *xy,
            Self::Equidistant { coefficients } => {
                let r = xy.norm();
                if r < 1e-8 { *xy } else { xy * (equidistant_angle(coefficients, r.atan()).0 / r) }
            }
            _ => self.brown().distort(xy),
        }
    }

    /// [`Self::distort`] and its derivative with respect to the undistorted coordinates.
    #[inline]
    pub fn distort_with_jacobian(&self, xy: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        match self {
            Self::None => (*xy, Matrix2::identity()),
            Self::Equidistant { coefficients } => equidistant_with_jacobian(coefficients, xy),
            _ => self.brown().distort_with_jacobian(xy),
        }
    }

    /// The derivative of [`Self::distort`] with respect to each coefficient, in the model's order; empty for [`Self::None`].
    pub fn distort_by_coefficients(&self, xy: &Vector2<f64>) -> Vec<Vector2<f64>> {
        match self {
            Self::None => Vec::new(),
            Self::Equidistant { .. } => {
                let r = xy.norm();
                let angle_rad = r.atan();
                let outwards = if r < 1e-8 { Vector2::zeros() } else { xy / r };
                (1..=4).map(|n| outwards * angle_rad.powi(2 * n + 1)).collect()
            }
            Self::BrownConrady5 { .. } => self.brown().by_coefficients(xy)[..5].to_vec(),
            Self::BrownConrady8 { .. } => self.brown().by_coefficients(xy).to_vec(),
        }
    }

    /// The undistorted normalised coordinates that map to `distorted`, within `tolerance` (normalised units); `None` if the
    /// model has no inverse inside `fold_radius` (see [`Self::fold_radius`]).
    pub(crate) fn undistort(&self, distorted: &Vector2<f64>, fold_radius: f64, tolerance: f64) -> Option<Vector2<f64>> {
        if !(distorted.x.is_finite() && distorted.y.is_finite()) {
            return None;
        }
        match self {
            Self::None => Some(*distorted),
            Self::Equidistant { coefficients } => {
                let radius = distorted.norm();
                if radius < 1e-8 {
                    return Some(*distorted);
                }
                let angle_rad = invert_equidistant(coefficients, radius, fold_radius.atan(), tolerance)?;
                Some(distorted * (angle_rad.tan() / radius))
            }
            _ => self.brown().undistort(distorted, fold_radius, tolerance),
        }
    }

    /// The undistorted radius up to which the radial function increases, so that one image radius corresponds to one ray;
    /// infinite if it increases everywhere.
    ///
    /// Beyond this radius the polynomial folds back, and points far outside the field of view would be imaged inside it.
    pub(crate) fn fold_radius(&self) -> f64 {
        let rises = |angle_rad: f64| match self {
            Self::None => true,
            Self::Equidistant { coefficients } => equidistant_angle(coefficients, angle_rad).1 > 0.0,
            _ => self.brown().radial_slope(angle_rad.tan()) > 0.0,
        };
        let angle_rad = |sample: u32| ANGLE_MAX_RAD * f64::from(sample) / f64::from(FOLD_SAMPLES);
        let Some(first) = (1..=FOLD_SAMPLES).find(|sample| !rises(angle_rad(*sample))) else {
            return f64::INFINITY;
        };
        let (mut low, mut high) = (angle_rad(first - 1), angle_rad(first));
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if rises(middle) { low = middle } else { high = middle }
        }
        low.tan()
    }

    /// The Brown-Conrady parameters; all zero for other models.
    #[inline]
    fn brown(&self) -> Brown {
        match self {
            Self::BrownConrady5 { coefficients: [k1, k2, p1, p2, k3] } => {
                Brown::rational(&[*k1, *k2, *p1, *p2, *k3, 0.0, 0.0, 0.0])
            }
            Self::BrownConrady8 { coefficients } => Brown::rational(coefficients),
            Self::None | Self::Equidistant { .. } => Brown::rational(&[0.0; 8]),
        }
    }
}

/// Brown-Conrady model; the polynomial model is the rational one with a divisor of 1.
struct Brown {
    radial: [f64; 3],
    divisor: [f64; 3],
    tangential: [f64; 2],
}

impl Brown {
    #[inline]
    fn rational([k1, k2, p1, p2, k3, k4, k5, k6]: &[f64; 8]) -> Self {
        Self { radial: [*k1, *k2, *k3], divisor: [*k4, *k5, *k6], tangential: [*p1, *p2] }
    }

    /// The radial factor at squared radius `s`, and its derivative by `s`.
    #[inline]
    fn radial_factor(&self, s: f64) -> (f64, f64) {
        let (above, above_slope) = cubic(&self.radial, s);
        let (below, below_slope) = cubic(&self.divisor, s);
        let factor = above / below;
        (factor, (above_slope - factor * below_slope) / below)
    }

    /// Derivative of the distorted radius with respect to the undistorted one; not positive beyond a pole of the rational term.
    fn radial_slope(&self, radius: f64) -> f64 {
        let s = radius * radius;
        if cubic(&self.divisor, s).0 <= 0.0 {
            return -1.0;
        }
        let (factor, slope) = self.radial_factor(s);
        factor + 2.0 * s * slope
    }

    #[inline]
    fn distort(&self, xy: &Vector2<f64>) -> Vector2<f64> {
        let (x, y, [p1, p2]) = (xy.x, xy.y, self.tangential);
        let s = x * x + y * y;
        let factor = cubic(&self.radial, s).0 / cubic(&self.divisor, s).0;
        Vector2::new(
            x * factor + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x),
            y * factor + p1 * (s + 2.0 * y * y) + 2.0 * p2 * x * y,
        )
    }

    /// The derivatives with respect to k1, k2, p1, p2, k3, k4, k5, k6.
    fn by_coefficients(&self, xy: &Vector2<f64>) -> [Vector2<f64>; 8] {
        let (x, y) = (xy.x, xy.y);
        let s = x * x + y * y;
        let (above, below) = (cubic(&self.radial, s).0, cubic(&self.divisor, s).0);
        let radial = |power: i32| xy * (s.powi(power) / below);
        let divisor = |power: i32| xy * (-above * s.powi(power) / (below * below));
        let p1 = Vector2::new(2.0 * x * y, s + 2.0 * y * y);
        let p2 = Vector2::new(s + 2.0 * x * x, 2.0 * x * y);
        [radial(1), radial(2), p1, p2, radial(3), divisor(1), divisor(2), divisor(3)]
    }

    #[inline]
    fn distort_with_jacobian(&self, xy: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let (x, y, [p1, p2]) = (xy.x, xy.y, self.tangential);
        let (factor, slope) = self.radial_factor(x * x + y * y);
        let off_diagonal = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let jacobian = Matrix2::new(
            factor + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            off_diagonal,
            off_diagonal,
            factor + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        );
        (self.distort(xy), jacobian)
    }

    /// Newton's method with the analytic Jacobian; a step is halved until it stays inside the fold and reduces the residual.
    fn undistort(&self, distorted: &Vector2<f64>, fold_radius: f64, tolerance: f64) -> Option<Vector2<f64>> {
        let mut xy = *distorted;
        if xy.norm() >= fold_radius {
            xy *= 0.9 * fold_radius / xy.norm();
        }
        let mut best = f64::INFINITY;
        for _ in 0..NEWTON_STEPS {
            let (image, jacobian) = self.distort_with_jacobian(&xy);
            let residual = distorted - image;
            let step = jacobian.try_inverse()? * residual;
            // Continues beyond the tolerance as long as the residual decreases, down to rounding.
            if residual.norm() >= best && best <= tolerance || residual.norm() == 0.0 {
                break;
            }
            best = residual.norm();
            let fits = |scale: &f64| {
                let next = xy + step * *scale;
                next.norm() < fold_radius && (distorted - self.distort(&next)).norm() < best
            };
            match (0..HALVINGS).map(|n| 0.5_f64.powi(n as i32)).find(fits) {
                Some(scale) => xy += step * scale,
                None => break,
            }
        }
        let (image, jacobian) = self.distort_with_jacobian(&xy);
        let inverted =
            (distorted - image).norm() <= tolerance && jacobian.determinant() > 0.0 && jacobian.trace() > 0.0;
        inverted.then_some(xy)
    }
}

/// `1 + a s + b s^2 + c s^3` and its derivative.
#[inline]
fn cubic([a, b, c]: &[f64; 3], s: f64) -> (f64, f64) {
    (1.0 + s * (a + s * (b + s * c)), a + s * (2.0 * b + s * 3.0 * c))
}

/// The distorted radius of a ray at `angle_rad` from the axis, and its derivative with respect to the angle.
fn equidistant_angle([k1, k2, k3, k4]: &[f64; 4], angle_rad: f64) -> (f64, f64) {
    let s = angle_rad * angle_rad;
    (
        angle_rad * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))),
        1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4))),
    )
}

fn equidistant_with_jacobian(coefficients: &[f64; 4], xy: &Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
    let r = xy.norm();
    if r < 1e-8 {
        return (*xy, Matrix2::identity());
    }
    let (distorted, by_angle) = equidistant_angle(coefficients, r.atan());
    let by_radius = by_angle / (1.0 + r * r);
    let outwards = xy / r;
    let along = outwards * outwards.transpose();
    (xy * (distorted / r), along * by_radius + (Matrix2::identity() - along) * (distorted / r))
}

/// The angle with the distorted radius `radius`: Newton's method inside a bracket on which the function increases.
fn invert_equidistant(coefficients: &[f64; 4], radius: f64, fold_rad: f64, tolerance: f64) -> Option<f64> {
    let (mut low, mut high) = (0.0, fold_rad.min(ANGLE_MAX_RAD));
    if equidistant_angle(coefficients, high).0 < radius {
        return None;
    }
    let mut angle_rad = radius.min(0.5 * (low + high));
    for _ in 0..NEWTON_STEPS {
        let (image, slope) = equidistant_angle(coefficients, angle_rad);
        if image < radius {
            low = angle_rad
        } else {
            high = angle_rad
        }
        let newton = angle_rad + (radius - image) / slope;
        let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
        if (next - angle_rad).abs() <= f64::EPSILON * angle_rad {
            break;
        }
        angle_rad = next;
    }
    ((equidistant_angle(coefficients, angle_rad).0 - radius).abs() <= tolerance).then_some(angle_rad)
}
