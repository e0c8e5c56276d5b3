//! Plane hypotheses: golden projections, one-to-one parameters, and what is refused.

use nalgebra::Point3;
use pb3dp_estimation_test_support::scene::{self, Scene};
use proptest::prelude::*;

use super::*;

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
const CENTRE: Vector2<f64> = Vector2::new(352.25, 221.5);
const PSI: PlaneHypothesis = PlaneHypothesis { z_m: 0.47, theta_x_rad: 0.21, theta_y_rad: -0.33 };

fn general() -> PinholePair {
    PinholePair::from_rig(&scene::general_rig(SIZE)).expect("pair")
}

/// Golden values from an independent calculation (explicit rotation matrices in Python, ray-plane intersection, no homography).
#[test]
fn agrees_with_golden_projections() {
    let normal = PSI.normal();
    let expected = Vector3::new(-0.316_924_099_471_016_24, -0.208_459_899_846_099_56, 0.925_258_658_608_845_3);
    assert!((normal - expected).norm() < 1e-14);
    let golden = [
        ((352.25, 221.5), 0.47, (171.528_069_201_128_66, 197.016_792_039_694_45)),
        ((300.0, 180.0), 0.453_240_225_665_576_37, (115.878_598_645_647_83, 156.958_154_051_799_5)),
        ((411.0, 290.0), 0.493_784_131_267_558_4, (234.273_030_731_183_52, 262.063_672_936_133_8)),
        ((280.0, 301.0), 0.465_426_012_150_799_65, (99.502_265_405_507_5, 270.616_319_716_727_4)),
    ];
    let pair = general();
    let homography = PSI.homography(&pair, &CENTRE).expect("in front");
    for ((u, v), depth_m, (right_u, right_v)) in golden {
        let pixel = Vector2::new(u, v);
        assert!((PSI.depth_at_pixel(&pair, &CENTRE, &pixel).expect("in front") - depth_m).abs() < 1e-12);
        let right = PSI.right_pixel(&pair, &CENTRE, &pixel).expect("in front");
        assert!((right - Vector2::new(right_u, right_v)).norm() < 1e-9, "{pixel} lands on {right}");
        let mapped = homography * Vector3::new(u, v, 1.0);
        assert!((mapped.xy() / mapped.z - right).norm() < 1e-9);
    }
}

#[test]
fn distorted_cameras_are_refused() {
    let rig = scene::general_rig(SIZE);
    let distortion = Distortion::BrownConrady5 { coefficients: [0.1, 0.0, 0.0, 0.0, 0.0] };
    let bent = pb3dp_geometry::Camera::new(SIZE, *rig.right().pinhole(), distortion).expect("camera");
    let rig = StereoRig::new(*rig.left(), bent, *rig.cam_right_from_cam_left()).expect("rig");
    assert_eq!(PinholePair::from_rig(&rig), Err(EstimationError::Distorted { side: "right" }));
}

#[test]
fn planes_behind_the_camera_are_refused() {
    let pair = general();
    let ray = pair.left_ray(&CENTRE);
    assert_eq!(PlaneHypothesis { z_m: -0.4, ..PSI }.inverse_depth_plane(&ray), None);
    // The centre's ray is right of the optical axis. A tilt about y slightly above 90 degrees minus the ray's angle hides the
    // plane.
    let angle = (ray.x).atan();
    let hidden =
        PlaneHypothesis { theta_x_rad: 0.0, theta_y_rad: angle - std::f64::consts::FRAC_PI_2 - 0.01, z_m: 0.4 };
    assert_eq!(hidden.homography(&pair, &CENTRE), None);
    let edge_on = PlaneHypothesis { theta_y_rad: angle - std::f64::consts::FRAC_PI_2 + 0.01, ..hidden };
    assert!(edge_on.homography(&pair, &CENTRE).is_some());
    // Far from the centre, this pixel is beyond the horizon of the plane.
    assert_eq!(edge_on.right_pixel(&pair, &CENTRE, &Vector2::new(600.0, 240.0)), None);
}

#[test]
fn search_ranges_are_checked() {
    assert!(SearchRange::new(0.35, 0.65, 0.6).is_ok());
    for (near, far, tilt) in [(0.0, 0.5, 0.5), (0.5, 0.5, 0.5), (0.6, 0.5, 0.5), (0.3, f64::NAN, 0.5), (0.3, 0.5, 1.6)]
    {
        assert!(SearchRange::new(near, far, tilt).is_err(), "{near} {far} {tilt}");
    }
    let range = SearchRange::new(0.35, 0.65, 0.3).expect("range");
    assert!(range.contains(&PlaneHypothesis { z_m: 0.65, theta_x_rad: -0.3, theta_y_rad: 0.3 }));
    for psi in [
        PlaneHypothesis { z_m: 0.34, theta_x_rad: 0.0, theta_y_rad: 0.0 },
        PlaneHypothesis { z_m: 0.4, theta_x_rad: 0.31, theta_y_rad: 0.0 },
        PlaneHypothesis { z_m: 0.4, theta_x_rad: 0.0, theta_y_rad: -0.31 },
        PlaneHypothesis { z_m: f64::NAN, theta_x_rad: 0.0, theta_y_rad: 0.0 },
    ] {
        assert!(!range.contains(&psi), "{psi:?}");
    }
}

proptest! {
    /// Points of the plane, constructed in 3D and projected by both cameras, agree with the hypothesis.
    #[test]
    fn agrees_with_projection_in_space(
        z_m in 0.3..1.2, theta_x_rad in -0.8..0.8, theta_y_rad in -0.8..0.8,
        cu in 200.0..440.0, cv in 150.0..330.0, x in -0.06..0.06, y in -0.06..0.06, rectified: bool,
    ) {
        let rig = if rectified { scene::rectified_rig(SIZE) } else { scene::general_rig(SIZE) };
        let pair = PinholePair::from_rig(&rig).expect("pair");
        let centre_px = Vector2::new(cu, cv);
        let scene = Scene { centre_px, z_m, theta_x_rad, theta_y_rad, noise: 0.0 };
        let point_in_cam_left: Point3<f64> = scene.point_in_cam_left(&rig, x, y);
        let left = rig.left().project(&point_in_cam_left).expect("in front");
        let right = rig.right().project(&rig.cam_right_from_cam_left().transform_point(&point_in_cam_left)).expect("in front");
        let psi = PlaneHypothesis { z_m, theta_x_rad, theta_y_rad };
        prop_assert!((psi.depth_at_pixel(&pair, &centre_px, &left).expect("in front") - point_in_cam_left.z).abs() < 1e-10);
        prop_assert!((psi.right_pixel(&pair, &centre_px, &left).expect("in front") - right).norm() < 1e-7);
        let mapped = psi.homography(&pair, &centre_px).expect("in front") * left.push(1.0);
        prop_assert!((mapped.xy() / mapped.z - right).norm() < 1e-7);
    }

    #[test]
    fn inverse_depth_plane_and_psi_are_one_to_one(
        z_m in 0.2..3.0, theta_x_rad in -1.0..1.0, theta_y_rad in -1.0..1.0, cu in 250.0..400.0, cv in 180.0..300.0,
    ) {
        let ray = general().left_ray(&Vector2::new(cu, cv));
        let psi = PlaneHypothesis { z_m, theta_x_rad, theta_y_rad };
        let q = psi.inverse_depth_plane(&ray).expect("in front");
        let back = PlaneHypothesis::from_inverse_depth_plane(&q, &ray).expect("in front");
        prop_assert!((back.z_m - z_m).abs() < 1e-12);
        prop_assert!((back.theta_x_rad - theta_x_rad).abs() < 1e-12);
        prop_assert!((back.theta_y_rad - theta_y_rad).abs() < 1e-12);
        prop_assert_eq!(PlaneHypothesis::from_inverse_depth_plane(&-q, &ray), None);
    }
}
