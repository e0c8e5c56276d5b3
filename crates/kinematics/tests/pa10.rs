//! The robot descriptions in `configs/robots` compared with independent values.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use nalgebra::{Matrix3, SMatrix, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Flange};
use pb3dp_kinematics::{
    Chain, DOF, Damping, Jacobian, JointVector, SingularForm, damped_pseudo_inverse, manipulability, reach,
    singular_values, smallest_singular_value,
};
use proptest::prelude::*;

const GEN1: &str = include_str!("../../../configs/robots/pa10_gen1.urdf");
const GEN2: &str = include_str!("../../../configs/robots/pa10_gen2.urdf");

fn chain(urdf: &str) -> Chain {
    Chain::from_urdf_str(urdf, "base_link", "flange").unwrap()
}

/// `digits` decimals are printed, so half a unit of the last one is the tolerance.
fn check_position(pose: &Pose<Base, Flange>, expected_m: [f64; 3], digits: i32) {
    let off = (pose.translation_m() - Vector3::from(expected_m)).amax();
    assert!(off <= 0.5001 * 10f64.powi(-digits), "{pose:?}, expected {expected_m:?}, off by {off}");
}

fn check_rotation(pose: &Pose<Base, Flange>, expected: Matrix3<f64>) {
    let off = (pose.rotation_matrix() - expected).amax();
    assert!(off <= 0.5001e-9, "{pose:?}, expected {expected}, off by {off}");
}

// Golden values: product of elementary rotations and translations of the published DH tables, computed in Python independently
// of this code; three conventions (standard DH, modified DH, joint chain) agreed to 3e-16.
#[test]
fn stands_straight_up_at_zero() {
    for (urdf, height_m) in [(GEN1, 1.345), (GEN2, 1.317)] {
        let pose = chain(urdf).forward(&JointVector::zeros());
        check_position(&pose, [0.0, 0.0, height_m], 12);
        check_rotation(&pose, Matrix3::identity());
    }
}

#[test]
fn all_joints_golden_vector() {
    let q = JointVector::from([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]);
    let rotation = Matrix3::new(
        -0.378465689,
        -0.593897943,
        -0.709964052,
        0.812521242,
        0.154235243,
        -0.562157203,
        0.443365485,
        -0.789618087,
        0.424181946,
    );
    let (gen1, gen2) = (chain(GEN1).forward(&q), chain(GEN2).forward(&q));
    check_position(&gen1, [-0.412437565, -0.138485044, 1.20436003], 8);
    check_position(&gen2, [-0.394670490, -0.129479982, 1.18554239], 8);
    check_rotation(&gen1, rotation);
    check_rotation(&gen2, rotation);
}

/// Far from singularities and from every symmetry; E2 and W2 beyond and near half a turn.
fn asymmetric() -> JointVector {
    JointVector::from([0.37, -0.81, 1.13, -1.42, 2.6, 0.93, -3.3])
}

// Pinocchio 4.1.0 (PyPI `pin`): buildModelFromUrdf on the same files, getFrameJacobian(.., LOCAL_WORLD_ALIGNED).
#[test]
fn forward_and_jacobian_agree_with_pinocchio() {
    let gen1 = chain(GEN1);
    check_position(&gen1.forward(&asymmetric()), [-0.318060492746, -0.641636566604, 0.452982035998], 12);
    check_position(&chain(GEN2).forward(&asymmetric()), [-0.318380824222, -0.617736366599, 0.467936240735], 12);
    #[rustfmt::skip]
    let expected = Jacobian::from_row_slice(&[
        6.416365666041919e-01, 1.286444253632650e-01, 4.062680603304760e-01, -3.727849723317690e-01, 6.275943479095514e-02, 1.270648052252871e-02, 0.0,
        -3.180604927460910e-01, 4.989643355079584e-02, -1.261267039874604e-01, -1.174577894372375e-01, -5.623100832443079e-03, 7.174236224654240e-02, 0.0,
        0.0, 5.285621791412003e-01, 3.499753703650055e-01, 3.877742386909661e-01, 1.192640227948466e-02, -3.303904980498795e-02, 0.0,
        0.0, -3.616154319649620e-01, -6.752727387370101e-01, -7.356775142324002e-01, -4.926591799825239e-02, 9.786345060503909e-01, 1.305649835586221e-01,
        0.0, 9.323273456060345e-01, -2.619134194265408e-01, 1.722865542785157e-01, -9.781586112324638e-01, -8.768339810514919e-02, -4.337027780752060e-01,
        1.0, 0.0, 6.894984329517470e-01, -6.550541491111040e-01, -2.019371204003042e-01, 1.859734531169467e-01, -8.915462328775695e-01,
    ]);
    let jacobian = gen1.jacobian(&asymmetric());
    assert!((jacobian - expected).amax() < 1e-14, "{jacobian}");
}

/// A path of 5000 steps through a singularity, its elbow.
#[test]
fn forms_along_a_path_stay_those_of_single_poses() {
    let (chain, damping) = (chain(GEN1), Damping::new(0.1, 0.05).unwrap());
    let mut form = SingularForm::new(&chain.jacobian(&asymmetric()));
    for step in 0..=5000 {
        let mut q = asymmetric();
        q[3] *= 1.0 - f64::from(step) / 2500.0;
        q[1] += 0.3 * (f64::from(step) / 400.0).sin();
        let jacobian = chain.jacobian(&q);
        form = form.near(&jacobian);
        let alone = SingularForm::new(&jacobian);
        let (values, inverse) =
            (form.values() - alone.values(), form.damped_inverse(&damping) - alone.damped_inverse(&damping));
        assert!(values.amax() < 1e-11 && inverse.amax() < 1e-9, "step {step}: {values} {inverse}");
    }
}

// NumPy's LAPACK on Pinocchio's Jacobian of the same pose: linalg.svd.
#[test]
fn singular_values_agree_with_lapack() {
    let jacobian = chain(GEN1).jacobian(&asymmetric());
    let expected =
        [1.837164885047219, 1.676413313584634, 1.3382970959964, 0.52031134672461, 0.361465261030518, 0.22452459317521];
    let values = singular_values(&jacobian);
    assert!((values - nalgebra::Vector6::from(expected)).amax() < 1e-13, "{values}");
    assert!((smallest_singular_value(&jacobian) - 0.22452459317521).abs() < 1e-13);
    assert!((manipulability(&jacobian) - 0.17405061134131775).abs() < 1e-13);
}

#[test]
fn limits_are_those_of_the_servo_tier() {
    let servo_deg = [177.0, 91.0, 174.0, 137.0, 255.0, 165.0, 255.0];
    let pi = std::f64::consts::PI;
    for urdf in [GEN1, GEN2] {
        let chain = chain(urdf);
        assert_eq!(chain.joint_names(), ["s1", "s2", "s3", "e1", "e2", "w1", "w2"]);
        let max_rad = JointVector::from(servo_deg).map(f64::to_radians);
        assert!((chain.limits().position_max_rad() - max_rad).amax() < 1e-14);
        assert!((chain.limits().position_min_rad() + max_rad).amax() < 1e-14);
        let speed = JointVector::from([1.0, 1.0, 2.0, 2.0, 2.0, 2.0 * pi, 2.0 * pi]);
        assert!((chain.limits().velocity_max_rad_per_s() - speed).amax() < 1e-14);
    }
}

#[test]
fn joint_origins_follow_the_arm() {
    let chain = chain(GEN2);
    let origins = chain.joint_frames(&asymmetric()).origins_in_base();
    let lengths: Vec<f64> = origins.windows(2).map(|pair| (pair[1] - pair[0]).norm()).collect();
    let expected = [0.2, 0.117, 0.317, 0.133, 0.285, 0.195, 0.0, 0.07];
    for (length, expected) in lengths.iter().zip(expected) {
        assert!((length - expected).abs() < 1e-12, "{lengths:?}");
    }
    // Shoulder, elbow and wrist are on straight links: S3 between S2 and E1, E2 between E1 and W1.
    let straight = |a: usize, b: usize, c: usize| (origins[b] - origins[a]).cross(&(origins[c] - origins[b])).norm();
    assert!(straight(2, 3, 4) < 1e-12 && straight(4, 5, 6) < 1e-12);
    assert!(straight(3, 4, 5) > 0.01, "the elbow is bent in this pose");
}

#[test]
fn known_singular_poses_are_recognised() {
    let q = asymmetric();
    let with = |changes: &[(usize, f64)]| {
        let mut q = q;
        changes.iter().for_each(|&(joint, angle)| q[joint] = angle);
        smallest_singular_value(&chain(GEN2).jacobian(&q))
    };
    // The singular sets of a spherical-revolute-spherical arm.
    let quarter = std::f64::consts::FRAC_PI_2;
    for lost in [&[(3, 0.0)][..], &[(1, 0.0), (5, 0.0)], &[(1, 0.0), (2, quarter)], &[(5, 0.0), (4, quarter)]] {
        assert!(with(lost) < 1e-12, "{lost:?}: {}", with(lost));
    }
    for regular in [&[(1, 0.0)][..], &[(5, 0.0)], &[]] {
        assert!(with(regular) > 0.02, "{regular:?}: {}", with(regular));
    }
}

/// Numerical derivative of the flange's pose with respect to joint `i`: `[linear; angular]`.
fn central_difference(chain: &Chain, q: &JointVector, i: usize) -> nalgebra::Vector6<f64> {
    let step_rad = 1e-5;
    let (mut ahead, mut behind) = (*q, *q);
    ahead[i] += step_rad;
    behind[i] -= step_rad;
    let (ahead, behind) = (chain.forward(&ahead), chain.forward(&behind));
    let linear = (ahead.translation_m() - behind.translation_m()) / (2.0 * step_rad);
    let angular = (ahead.rotation() * behind.rotation().inverse()).scaled_axis() / (2.0 * step_rad);
    nalgebra::Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z)
}

fn any_pose() -> impl Strategy<Value = JointVector> {
    prop::array::uniform7(-4.4..4.4f64).prop_map(JointVector::from)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

    #[test]
    fn jacobian_is_the_derivative_of_forward(q in any_pose(), second_generation in any::<bool>()) {
        let chain = chain(if second_generation { GEN2 } else { GEN1 });
        let jacobian = chain.jacobian(&q);
        for i in 0..DOF {
            let off = (jacobian.column(i) - central_difference(&chain, &q, i)).amax();
            prop_assert!(off < 1e-9, "joint {i} at {q}: off by {off}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]

    #[test]
    fn jacobian_of_a_point_is_that_of_a_longer_arm(q in any_pose(), x in -0.3..0.3f64, y in -0.3..0.3f64, z in -0.3..0.3f64) {
        let mount = r#"<joint name="tool_mount" type="fixed"><parent link="flange"/><child link="tool"/>"#;
        let tool = format!(r#"<link name="tool"/>{mount}<origin xyz="{x} {y} {z}" rpy="0.3 -0.2 1.1"/></joint></robot>"#);
        let longer = Chain::from_urdf_str(&GEN2.replace("</robot>", &tool), "base_link", "tool").unwrap();
        let chain = chain(GEN2);
        let frames = chain.joint_frames(&q);
        let point = frames.base_from_flange.transform_point(&[x, y, z].into());
        let off = (chain.jacobian_at(&frames, &point) - longer.jacobian(&q)).amax();
        prop_assert!(off < 1e-12, "off by {off}");
    }

    #[test]
    fn inverse_is_exact_above_and_bounded_below_the_threshold(q in any_pose(), ratio in 0.1..1.5f64) {
        let jacobian = chain(GEN1).jacobian(&q);
        let threshold = 0.1;
        let damping = Damping::new(threshold, ratio * threshold).unwrap();
        let inverse = damped_pseudo_inverse(&jacobian, &damping);
        if smallest_singular_value(&jacobian) > threshold {
            let off = (jacobian * inverse - SMatrix::<f64, 6, 6>::identity()).amax();
            prop_assert!(off < 1e-12, "off by {off}");
            // Of all inverses the one of Moore and Penrose, which moves the joints least.
            let projection = inverse * jacobian;
            prop_assert!((projection - projection.transpose()).amax() < 1e-12, "{projection}");
        }
        // The largest singular value of the inverse, from that of its transpose.
        let gain = singular_values(&inverse.transpose())[0];
        prop_assert!(gain <= damping.gain_max() * (1.0 + 1e-9), "gain {gain} beyond {}", damping.gain_max());
    }

    #[test]
    fn inverse_has_no_jump_near_a_singularity(q in any_pose()) {
        let damping = Damping::new(0.1, 0.05).unwrap();
        let (mut near, mut nearer) = (q, q);
        near[3] = 1e-7;
        nearer[3] = -1e-7;
        let chain = chain(GEN1);
        let jump = (damped_pseudo_inverse(&chain.jacobian(&near), &damping)
            - damped_pseudo_inverse(&chain.jacobian(&nearer), &damping)).amax();
        prop_assert!(jump < 1e-3, "jump {jump}");
    }
}

#[test]
fn poses_are_reached_near_the_start_and_unreachable_ones_are_reported() {
    let chain = chain(GEN2);
    let damping = Damping::new(0.04, 0.04).unwrap();
    let start_rad = JointVector::from([0.1, 0.8, -0.2, 1.6, 0.3, -0.9, 0.2]);
    let wanted_rad = start_rad + JointVector::from([0.2, -0.15, 0.1, 0.25, -0.2, 0.15, -0.3]);
    let wanted = chain.forward(&wanted_rad);
    let reached_rad = reach(&chain, &start_rad, &wanted, &damping).unwrap();
    let off = chain.forward(&reached_rad).inverse() * wanted;
    assert!(off.translation_m().norm() < 1e-8 && off.rotation_angle_rad() < 1e-8, "{off:?}");
    // With seven joints other solutions exist, but none far away is acceptable.
    assert!((reached_rad - start_rad).norm() <= (wanted_rad - start_rad).norm() * 1.1, "{reached_rad}");
    let far = Pose::from_parts(wanted.translation_m() * 3.0, wanted.rotation());
    let refused = reach(&chain, &start_rad, &far, &damping).unwrap_err();
    assert!(refused.position_error_m > 0.3 && refused.to_string().starts_with("out of reach"), "{refused}");
}
