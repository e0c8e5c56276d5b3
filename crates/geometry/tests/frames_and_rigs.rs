//! Poses, twists, times, and invalid stereo rigs.

#![allow(clippy::unwrap_used, reason = "helpers of tests may fail loudly, as tests do")]

use std::time::Duration;

use nalgebra::{Matrix3, Point3, Quaternion, UnitQuaternion, Vector3, Vector6};
use pb3dp_geometry::frames::{Base, CamLeft, CamRight, Flange};
use pb3dp_geometry::{
    Camera, Distortion, ImageSize, MonotonicTime, Pinhole, Pose, StereoRig, StereoRigError, Twist, so3,
};
use proptest::prelude::*;

/// A quarter turn about z, then a shift: by hand, `(1, 2, 3)` goes to `(-2 + 10, 1 + 20, 3 + 30)`.
fn base_from_flange() -> Pose<Base, Flange> {
    let quarter_turn = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    Pose::from_rotation_matrix(&quarter_turn, Vector3::new(10.0, 20.0, 30.0))
}

#[test]
fn poses_map_points_and_vectors_as_by_hand() {
    let point = base_from_flange().transform_point(&Point3::new(1.0, 2.0, 3.0));
    assert!((point - Point3::new(8.0, 21.0, 33.0)).norm() < 1e-14, "{point}");
    let vector = base_from_flange().transform_vector(&Vector3::new(1.0, 2.0, 3.0));
    assert!((vector - Vector3::new(-2.0, 1.0, 3.0)).norm() < 1e-14, "{vector}");
    let back = base_from_flange().inverse().transform_point(&point);
    assert!((back - Point3::new(1.0, 2.0, 3.0)).norm() < 1e-14);
    assert!((base_from_flange().rotation_angle_rad() - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
}

#[test]
fn composition_applies_the_right_factor_first() {
    let flange_from_cam_left =
        Pose::<Flange, CamLeft>::from_parts(Vector3::new(0.1, -0.2, 0.3), so3::exp(&Vector3::new(0.3, -0.7, 1.1)));
    let base_from_cam_left: Pose<Base, CamLeft> = base_from_flange() * flange_from_cam_left;
    let point = Point3::new(0.5, -0.25, 2.0);
    let expected = base_from_flange().transform_point(&flange_from_cam_left.transform_point(&point));
    assert!((base_from_cam_left.transform_point(&point) - expected).norm() < 1e-14);
    let text = format!("{base_from_cam_left:?}");
    assert!(text.starts_with("base_from_cam_left { translation_m: ["), "{text}");
}

#[test]
fn twists_turn_with_their_frame_and_keep_their_order() {
    let twist = Twist::<Flange>::from_vector(&Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0));
    assert_eq!(twist.linear_m_per_s, Vector3::new(1.0, 2.0, 3.0));
    let in_base = twist.expressed_in(&base_from_flange()).to_vector();
    assert!((in_base - Vector6::new(-2.0, 1.0, 3.0, -5.0, 4.0, 6.0)).amax() < 1e-14, "{in_base}");
}

#[test]
fn times_neither_wrap_nor_lose_their_sign() {
    let early = MonotonicTime::from_secs_f64(1.25);
    let late = early + Duration::from_millis(500);
    assert_eq!(late.as_nanos(), 1_750_000_000);
    assert_eq!(early.seconds_since(late), -0.5);
    assert_eq!(early.saturating_since(late), Duration::ZERO);
    assert_eq!(late.saturating_since(early), Duration::from_millis(500));
    assert_eq!(early - Duration::from_secs(9), MonotonicTime::ZERO);
    assert_eq!(MonotonicTime::from_secs_f64(-3.0), MonotonicTime::ZERO);
    assert_eq!(MonotonicTime::from_secs_f64(f64::NAN), MonotonicTime::ZERO);
    assert_eq!(MonotonicTime::from_nanos(u64::MAX) + Duration::from_secs(1), MonotonicTime::from_nanos(u64::MAX));
}

#[test]
fn rotation_matrices_with_few_digits_become_the_nearest_rotation() {
    // Half a turn about a skew axis, where conversions are most sensitive, written with four digits.
    let exact = so3::exp(&(Vector3::new(0.36, -0.48, 0.8) * std::f64::consts::PI)).to_rotation_matrix().into_inner();
    let pose = Pose::<Base, Flange>::from_rotation_matrix(&exact, Vector3::zeros());
    assert!((pose.rotation_matrix() - exact).amax() < 1e-15);
    let written = exact.map(|element| (element * 1e4).round() / 1e4);
    let rounded = Pose::<Base, Flange>::from_rotation_matrix(&written, Vector3::zeros()).rotation_matrix();
    assert!((rounded - exact).amax() < 1e-4);
    assert!((rounded * rounded.transpose() - Matrix3::identity()).amax() < 1e-15);
    // It is the nearest rotation if R^T M is symmetric, as for the factors of a polar decomposition.
    let stretch = rounded.transpose() * written;
    assert!((stretch - stretch.transpose()).amax() < 1e-15, "{stretch}");
    // The result is meaningless, but the function returns.
    for bad in [Matrix3::zeros(), Matrix3::from_element(f64::NAN), -Matrix3::identity()] {
        let _ = Pose::<Base, Flange>::from_rotation_matrix(&bad, Vector3::zeros());
    }
}

proptest! {
    #[test]
    fn rotation_matrices_go_there_and_back(phi in prop::array::uniform3(-4.0..4.0_f64)) {
        let matrix = so3::exp(&Vector3::from(phi)).to_rotation_matrix().into_inner();
        let back = Pose::<Base, Flange>::from_rotation_matrix(&matrix, Vector3::zeros()).rotation_matrix();
        prop_assert!((back - matrix).amax() < 2e-15);
    }
}

fn rig(translation_m: [f64; 3]) -> Result<StereoRig, StereoRigError> {
    let size = ImageSize { width: 640, height: 480 };
    let camera = |fx| {
        let pinhole = Pinhole { fx, fy: 738.25, cx: 331.25, cy: 228.5 };
        Camera::new(size, pinhole, Distortion::None).unwrap()
    };
    let cam_right_from_cam_left = Pose::<CamRight, CamLeft>::from_translation(Vector3::from(translation_m));
    StereoRig::new(camera(742.5), camera(742.5), cam_right_from_cam_left)
}

#[test]
fn rigs_with_an_impossible_baseline_or_swapped_cameras_are_refused() {
    let good = rig([-0.1, 0.0, 0.0]).unwrap();
    assert!(good.is_rectified());
    assert_eq!(good.right_centre_in_cam_left(), Vector3::new(0.1, 0.0, 0.0));
    assert!(!rig([-0.1, 0.001, 0.0]).unwrap().is_rectified());
    assert!(matches!(rig([-120.0, 0.0, 0.0]), Err(StereoRigError::Baseline { .. })));
    assert!(matches!(rig([0.0; 3]), Err(StereoRigError::Baseline { .. })));
    assert!(matches!(rig([f64::NAN, 0.0, 0.0]), Err(StereoRigError::Baseline { .. })));
    assert!(matches!(rig([0.06, 0.05, 0.0]), Err(StereoRigError::Swapped { .. })));
    assert!(matches!(rig([-0.03, 0.01, 0.1]), Err(StereoRigError::Swapped { .. })));
    match rig([0.1, 0.0, 0.0]) {
        Err(error @ StereoRigError::Swapped { .. }) => {
            assert!(error.to_string().contains("exchange left and right"), "{error}")
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn vertical_baselines_are_accepted_in_both_directions() {
    for translation_m in [[0.004, -0.09, 0.006], [-0.01, 0.08, -0.003]] {
        let rig = rig(translation_m).unwrap();
        assert!(!rig.is_rectified());
        let rectified = rig.rectify().unwrap();
        // The image's columns become rows: rolled by a quarter turn.
        let turn = rectified.cam_left_rect_from_cam_left.rotation_matrix();
        assert!(turn[(0, 1)].abs() > 0.99 && turn[(2, 2)] > 0.99, "{turn}");
        assert!((rectified.rig.right_centre_in_cam_left().x - rig.baseline_m()).abs() < 1e-12);
    }
}

#[test]
fn a_rotation_that_is_not_finite_is_refused() {
    let size = ImageSize { width: 640, height: 480 };
    let camera = Camera::new(size, Pinhole { fx: 742.5, fy: 738.25, cx: 331.25, cy: 228.5 }, Distortion::None).unwrap();
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(f64::NAN, 0.0, 0.0, 0.0));
    let pose = Pose::<CamRight, CamLeft>::from_parts(Vector3::new(-0.1, 0.0, 0.0), rotation);
    assert_eq!(StereoRig::new(camera, camera, pose), Err(StereoRigError::Rotation));
}
