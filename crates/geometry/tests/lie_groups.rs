//! SO(3) and SE(3) compared with Pinocchio, power series and finite differences.

use std::f64::consts::PI;

use nalgebra::{DMatrix, Isometry3, Matrix4, Matrix6, SMatrix, Vector3, Vector6};
use pb3dp_geometry::frames::{Base, CamLeft};
use pb3dp_geometry::{Pose, se3, so3};
use proptest::prelude::*;

/// Values of Pinocchio (PyPI `pin`) 4.1.0, which fix the conventions; the other tests compare with power series and finite
/// differences. Its spatial vectors are `[linear; angular]` like ours. With `import pinocchio as pin`, `xi` as numpy array:
/// `EXP = pin.exp6(pin.Motion(XI)).homogeneous[:3]`, row by row, and
/// `INTERPOLATED = pin.SE3.Interpolate(pin.exp6(pin.Motion(XI)), pin.exp6(pin.Motion(SECOND)), 0.3).homogeneous[:3]`.
const XI: [f64; 6] = [0.4, -0.2, 0.9, 0.3, -0.7, 1.1];
const SECOND: [f64; 6] = [-1.2, 0.5, 0.25, -1.7, 2.1, 1.3];
const EXP: [f64; 12] = [
    0.26946350302809197,
    -0.8902258527560323,
    -0.3672701343978637,
    0.17185355350702416,
    0.709740365268855,
    0.4413544434920703,
    -0.5490672719420066,
    -0.2057217350872514,
    0.650890186163428,
    -0.1127128488443101,
    0.7507581363272314,
    0.9585806539880153,
];
const INTERPOLATED: [f64; 12] = [
    0.15272598671697474,
    -0.7876040522350579,
    -0.5969544621528873,
    -0.16640892426775253,
    -0.10998749964523197,
    0.5867420941486585,
    -0.8022695712014989,
    -0.14517777014769384,
    0.9821290764981538,
    0.18818494056901355,
    0.002984164861451255,
    0.7551527393369368,
];

fn assert_close<const R: usize, const C: usize>(
    what: &str,
    got: &SMatrix<f64, R, C>,
    expected: &SMatrix<f64, R, C>,
    tolerance: f64,
) {
    let error = (got - expected).amax();
    assert!(error <= tolerance, "{what}: off by {error:e}, {tolerance:e} allowed\ngot {got}expected {expected}");
}

fn matrix_of(isometry: &Isometry3<f64>) -> SMatrix<f64, 3, 4> {
    isometry.to_homogeneous().fixed_rows::<3>(0).into_owned()
}

#[test]
fn the_exponential_agrees_with_pinocchio() {
    let xi = Vector6::from(XI);
    let motion = se3::exp(&xi);
    assert_close("exp", &matrix_of(&motion), &SMatrix::<f64, 3, 4>::from_row_slice(&EXP), 2e-13);
    assert_close("log", &se3::log(&motion), &xi, 1e-13);
}

#[test]
fn interpolation_agrees_with_pinocchio_and_with_its_typed_wrapper() {
    let [a, b] = [XI, SECOND].map(|xi| se3::exp(&Vector6::from(xi)));
    let expected = SMatrix::<f64, 3, 4>::from_row_slice(&INTERPOLATED);
    assert_close("interpolate", &matrix_of(&se3::interpolate(&a, &b, 0.3)), &expected, 2e-14);
    assert_close("start", &matrix_of(&se3::interpolate(&a, &b, 0.0)), &matrix_of(&a), 1e-15);
    assert_close("end", &matrix_of(&se3::interpolate(&a, &b, 1.0)), &matrix_of(&b), 1e-13);
    let (start, end) = (Pose::<Base, CamLeft>::from_isometry(a), Pose::from_isometry(b));
    assert_close("Pose", &matrix_of(start.interpolate(&end, 0.3).isometry()), &expected, 2e-14);
}

#[test]
fn rotations_close_to_pi_and_to_zero_keep_their_digits() {
    let axis = Vector3::new(0.36, -0.48, 0.8);
    for angle_rad in [PI, PI - 1e-12, PI - 1e-7, 1.0, 1e-7, 1e-12, 1e-15, 1e-200, 0.0] {
        let phi = axis * angle_rad;
        let back = so3::log(&so3::exp(&phi));
        // At pi itself both signs are the same rotation.
        let error =
            if angle_rad > PI - 1e-14 { (back - phi).norm().min((back + phi).norm()) } else { (back - phi).norm() };
        assert!(error <= 1e-15 * (1.0 + angle_rad), "log(exp({angle_rad} * axis)) is off by {error:e}");
        if angle_rad < 1e-6 {
            assert!(error <= 1e-15 * angle_rad, "relative error at {angle_rad:e}: {error:e}");
        }
    }
    let past_pi = so3::log(&so3::exp(&(axis * (PI + 0.25))));
    assert_close("past pi", &past_pi, &(-axis * (PI - 0.25)), 1e-14);
}

#[test]
fn wrappers_of_pose_respect_the_side() {
    let base_from_cam_left = Pose::<Base, CamLeft>::exp(&Vector6::new(0.4, -0.2, 0.9, 0.3, -0.7, 1.1));
    let xi = Vector6::new(0.02, -0.01, 0.03, -0.05, 0.04, 0.06);
    let in_from = base_from_cam_left.perturbed_in_from(&xi);
    let in_to = base_from_cam_left.perturbed_in_to(&(base_from_cam_left.adjoint() * xi));
    assert_close("both sides", &matrix_of(in_to.isometry()), &matrix_of(in_from.isometry()), 1e-14);
    let wrong_side = base_from_cam_left.perturbed_in_to(&xi);
    assert!((wrong_side.translation_m() - in_from.translation_m()).norm() > 1e-3);
    assert_close("log", &(base_from_cam_left.inverse() * in_from).log(), &xi, 1e-14);
}

/// `ad(xi)`: the commutator with `xi`, `[hat(phi), hat(rho); 0, hat(phi)]`.
fn commutator(xi: &Vector6<f64>) -> Matrix6<f64> {
    let (rho, phi) = se3::split(xi);
    let mut ad = Matrix6::zeros();
    ad.fixed_view_mut::<3, 3>(0, 0).copy_from(&so3::hat(&phi));
    ad.fixed_view_mut::<3, 3>(3, 3).copy_from(&so3::hat(&phi));
    ad.fixed_view_mut::<3, 3>(0, 3).copy_from(&so3::hat(&rho));
    ad
}

/// Sum of `matrix^k / (k + shift)!`: the exponential for `shift` = 0, the left Jacobian (of `ad`) for 1.
fn power_series(matrix: &DMatrix<f64>, shift: u32) -> DMatrix<f64> {
    let mut term = DMatrix::identity(matrix.nrows(), matrix.ncols());
    let mut sum = term.clone();
    for k in 1..60 {
        term = &term * matrix / f64::from(k + shift);
        sum += &term;
    }
    sum
}

/// Tangent vectors with angles over all magnitudes, from far below the series' threshold to pi.
fn tangent() -> impl Strategy<Value = Vector6<f64>> {
    (prop::array::uniform6(-1.0..1.0_f64), -12.0..0.0_f64, prop::bool::ANY).prop_filter_map(
        "no direction",
        |(v, exponent, large)| {
            let (rho, phi) = se3::split(&Vector6::from(v));
            let angle_rad = if large { 0.9999 * PI * (1.0 + exponent / 12.0) } else { 10.0_f64.powf(exponent) };
            Some(se3::join(&(rho * 2.0), &(phi.try_normalize(0.05)? * angle_rad)))
        },
    )
}

proptest! {
    #[test]
    fn exponential_is_the_matrix_exponential(xi in tangent()) {
        let mut algebra = Matrix4::zeros();
        algebra.fixed_view_mut::<3, 3>(0, 0).copy_from(&so3::hat(&se3::split(&xi).1));
        algebra.fixed_view_mut::<3, 1>(0, 3).copy_from(&se3::split(&xi).0);
        let series = power_series(&DMatrix::from_column_slice(4, 4, algebra.as_slice()), 0);
        let got = se3::exp(&xi).to_homogeneous();
        prop_assert!((DMatrix::from_column_slice(4, 4, got.as_slice()) - series).amax() < 1e-13);
    }

    #[test]
    fn jacobian_is_the_series_of_the_commutator(xi in tangent()) {
        let ad = commutator(&xi);
        let series = power_series(&DMatrix::from_column_slice(6, 6, ad.as_slice()), 1);
        let got = se3::left_jacobian(&xi);
        prop_assert!((DMatrix::from_column_slice(6, 6, got.as_slice()) - series).amax() < 1e-13);
        let inverse = se3::left_jacobian_inverse(&xi);
        prop_assert!((got * inverse - Matrix6::identity()).amax() < 1e-12);
    }

    #[test]
    fn jacobians_of_both_sides_and_of_rotations_are_parts_of_one(xi in tangent()) {
        let back = -xi;
        let (right, inverse) = (se3::right_jacobian(&xi), se3::right_jacobian_inverse(&xi));
        prop_assert!((right - se3::left_jacobian(&back)).amax() < 1e-14);
        prop_assert!((inverse - se3::left_jacobian_inverse(&back)).amax() < 1e-14);
        let phi = se3::split(&xi).1;
        prop_assert!((right.fixed_view::<3, 3>(0, 0) - so3::right_jacobian(&phi)).amax() < 1e-14);
        prop_assert!((inverse.fixed_view::<3, 3>(0, 0) - so3::right_jacobian_inverse(&phi)).amax() < 1e-12);
        prop_assert!((se3::exp(&xi).rotation.to_rotation_matrix().into_inner()
            - so3::exp(&phi).to_rotation_matrix().into_inner()).amax() < 1e-15);
        prop_assert!((so3::log(&so3::exp(&phi)) - phi).amax() < 1e-12);
    }

    #[test]
    fn logarithm_undoes_the_exponential(xi in tangent()) {
        prop_assert!((se3::log(&se3::exp(&xi)) - xi).amax() < 1e-12);
    }

    #[test]
    fn jacobians_agree_with_finite_differences(xi in tangent(), column in 0_usize..6) {
        let step = 1e-6;
        let mut d = Vector6::zeros();
        d[column] = step;
        let (ahead, behind) = (se3::exp(&(xi + d)), se3::exp(&(xi - d)));
        let at = se3::exp(&xi);
        let difference = |f: &dyn Fn(&Isometry3<f64>) -> Isometry3<f64>| {
            (se3::log(&f(&ahead)) - se3::log(&f(&behind))) / (2.0 * step)
        };
        let left = difference(&|a| a * at.inverse());
        let right = difference(&|a| at.inverse() * a);
        prop_assert!((left - se3::left_jacobian(&xi).column(column)).amax() < 2e-8);
        prop_assert!((right - se3::right_jacobian(&xi).column(column)).amax() < 2e-8);
    }

    #[test]
    fn derivative_of_the_logarithm_is_the_inverse_jacobian(xi in tangent(), column in 0_usize..6) {
        // Avoids pi, where the logarithm is discontinuous.
        prop_assume!(se3::split(&xi).1.norm() < 3.1);
        let step = 1e-6;
        let mut d = Vector6::zeros();
        d[column] = step;
        let at = se3::exp(&xi);
        let left = (se3::log(&(se3::exp(&d) * at)) - se3::log(&(se3::exp(&-d) * at))) / (2.0 * step);
        let inverse = se3::left_jacobian_inverse(&xi);
        prop_assert!((left - inverse.column(column)).amax() < 1e-6);
    }

    #[test]
    fn adjoint_moves_a_twist_through_a_transform(a in tangent(), xi in tangent()) {
        let a = se3::exp(&a);
        let conjugate = (a * se3::exp(&xi) * a.inverse()).to_homogeneous();
        prop_assert!((conjugate - se3::exp(&(se3::adjoint(&a) * xi)).to_homogeneous()).amax() < 1e-12);
    }

    #[test]
    fn interpolation_composes_at_constant_twist(a in tangent(), b in tangent(), s in 0.0..1.0_f64) {
        let (a, b) = (se3::exp(&a), se3::exp(&b));
        let whole = se3::log(&(a.inverse() * b));
        let part = se3::log(&(a.inverse() * se3::interpolate(&a, &b, s)));
        prop_assert!((part - whole * s).amax() < 1e-9 * (1.0 + whole.amax()));
    }
}
