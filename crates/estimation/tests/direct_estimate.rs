//! The direct method on single pairs: rendered discs of known depth and tilt, and inputs that must not be estimated.
#![allow(clippy::unwrap_used, reason = "inputs that are valid")]

use image::RgbImage;
use nalgebra::Vector2;
use pb3dp_estimation_core::estimate::PlaneEstimate;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::{PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::region::{Region, RegionMask};
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_estimation_test_support::scene::{self, Scene};
use pb3dp_geometry::{ImageSize, StereoRig};

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };

fn range() -> SearchRange {
    SearchRange::new(0.35, 0.8, 60f64.to_radians()).unwrap()
}

fn region_of(mask: &RegionMask) -> Region {
    let mut image = image::GrayImage::new(SIZE.width, SIZE.height);
    mask.for_each(|x, y| image.put_pixel(x, y, image::Luma([255])));
    Region::Mask(image)
}

fn estimate(rig: &StereoRig, left: &RgbImage, right: &RgbImage, region: &Region) -> PlaneEstimate {
    let mut estimator = DirectEstimator::new(rig, DirectConfig::default()).unwrap();
    estimator.estimate(EstimateRequest::new_target(left, right, region, &range())).unwrap()
}

fn check(rig: &StereoRig, scene: &Scene) {
    let (left, right) = scene.render(rig);
    let mask = RegionMask::from_fn(SIZE, |u, v| scene.sees_disc(rig, u, v));
    let found = estimate(rig, &left, &right, &region_of(&mask));
    assert_eq!((found.status, found.observed), (Status::Ok, Some([true; 6])), "{}", found.reason);
    let truth = PlaneHypothesis { z_m: scene.z_m, theta_x_rad: scene.theta_x_rad, theta_y_rad: scene.theta_y_rad };
    let centre_ray = rig.left().unproject(&scene.centre_px).unwrap();
    let z_m = found.pose.unwrap().depth_on_ray(&centre_ray).unwrap();
    assert!((z_m - scene.z_m).abs() < 0.5e-3, "{z_m} for {}", scene.z_m);
    let turn_deg = found.normal_in_cam_left().unwrap().angle(&-truth.normal()).to_degrees();
    assert!(turn_deg < 0.8, "{turn_deg} degrees off");
    let covariance = found.plane_covariance.unwrap();
    assert!((covariance[(0, 0)].sqrt() - found.z_sigma_m.unwrap()).abs() < 1e-9 && covariance.determinant() > 0.0);
}

#[test]
fn discs_are_found_where_they_are() {
    let centre_px = Vector2::new(352.0, 236.0);
    for (z_m, theta_x_rad, theta_y_rad) in [(0.5, 0.2, -0.3), (0.42, -0.35, 0.1), (0.65, 0.05, 0.45)] {
        let scene = Scene { centre_px, z_m, theta_x_rad, theta_y_rad, noise: 3.0 };
        check(&scene::rectified_rig(SIZE), &scene);
    }
}

#[test]
fn cameras_that_are_not_rectified_serve_as_well() {
    let scene =
        Scene { centre_px: Vector2::new(340.0, 250.0), z_m: 0.52, theta_x_rad: -0.15, theta_y_rad: 0.25, noise: 3.0 };
    check(&scene::general_rig(SIZE), &scene);
}

#[test]
fn blank_walls_and_noise_are_refused_with_a_reason() {
    let rig = scene::rectified_rig(SIZE);
    let region = Region::Rectangle { x: 250, y: 180, width: 120, height: 100 };
    let mut random = SplitMix64::new(1);
    let mut noise = |amplitude: u32| {
        RgbImage::from_fn(SIZE.width, SIZE.height, |_, _| {
            image::Rgb([(120 + random.below(2 * amplitude + 1)) as u8; 3])
        })
    };
    for amplitude in [0, 2, 20] {
        let found = estimate(&rig, &noise(amplitude), &noise(amplitude), &region);
        assert_eq!((found.status, found.pose), (Status::NotObservable, None), "{amplitude}: {}", found.reason);
        assert!(!found.reason.is_empty());
    }
}

#[test]
fn the_same_pair_gives_the_same_answer_after_another() {
    let rig = scene::rectified_rig(SIZE);
    let scene =
        Scene { centre_px: Vector2::new(352.0, 236.0), z_m: 0.5, theta_x_rad: 0.2, theta_y_rad: -0.3, noise: 3.0 };
    let (left, right) = scene.render(&rig);
    let mut estimator = DirectEstimator::new(&rig, DirectConfig::default()).unwrap();
    let region = Region::Rectangle { x: 300, y: 190, width: 100, height: 90 };
    let other = Region::Rectangle { x: 100, y: 60, width: 400, height: 330 };
    let first = estimator.estimate(EstimateRequest::new_target(&left, &right, &region, &range())).unwrap();
    estimator.estimate(EstimateRequest::new_target(&left, &right, &other, &range())).unwrap();
    assert_eq!(estimator.estimate(EstimateRequest::new_target(&left, &right, &region, &range())).unwrap(), first);
}

/// A target at the end of the range may be beyond it.
#[test]
fn an_answer_at_the_end_of_the_range_is_ambiguous() {
    let rig = scene::rectified_rig(SIZE);
    let scene =
        Scene { centre_px: Vector2::new(352.0, 236.0), z_m: 0.5, theta_x_rad: 0.2, theta_y_rad: -0.3, noise: 3.0 };
    let (left, right) = scene.render(&rig);
    let region = region_of(&RegionMask::from_fn(SIZE, |u, v| scene.sees_disc(&rig, u, v)));
    let found = |z_max_m: f64| {
        let mut estimator = DirectEstimator::new(&rig, DirectConfig::default()).unwrap();
        estimator
            .estimate(EstimateRequest::new_target(
                &left,
                &right,
                &region,
                &SearchRange::new(0.35, z_max_m, 1.0).unwrap(),
            ))
            .unwrap()
    };
    let within = found(0.8);
    assert_eq!(within.status, Status::Ok, "{}", within.reason);
    let near_the_end = found(within.pose.unwrap().z_m + 1e-4);
    assert_eq!(near_the_end.status, Status::Ambiguous, "{}", near_the_end.reason);
    assert!(near_the_end.reason.ends_with("the target may be beyond it"), "{}", near_the_end.reason);
}

/// Unsuitable regions are reported, and estimates outside the range are reported too.
#[test]
fn warnings_tell_of_the_region_and_of_tilts_beyond_the_range() {
    let rig = scene::rectified_rig(SIZE);
    let scene =
        Scene { centre_px: Vector2::new(352.0, 236.0), z_m: 0.5, theta_x_rad: 0.05, theta_y_rad: 0.405, noise: 3.0 };
    let (left, right) = scene.render(&rig);
    let crossed = [(300.0, 190.0), (400.0, 280.0), (400.0, 190.0), (300.0, 280.0)];
    let region = Region::Polygon { vertices_px: crossed.map(|(u, v)| Vector2::new(u, v)).to_vec() };
    let warnings = |tilt_max_rad: f64| {
        let mut estimator = DirectEstimator::new(&rig, DirectConfig::default()).unwrap();
        let range = SearchRange::new(0.35, 0.8, tilt_max_rad).unwrap();
        let found = estimator.estimate(EstimateRequest::new_target(&left, &right, &region, &range)).unwrap();
        let texts: Vec<String> = found.warnings.iter().map(ToString::to_string).collect();
        assert!(texts.iter().any(|text| text.contains("of the region polygon cross")), "{texts:?}");
        texts.iter().any(|text| text.contains("beyond the 23 degrees"))
    };
    assert!(warnings(0.4014) && !warnings(0.7));
}

/// Depth and tilts of a pair are observed or not; the region fixes the rest. A depth that is not makes the answer `ambiguous`.
#[test]
fn a_direction_that_a_pair_does_not_determine_is_named_and_not_ok() {
    let rig = scene::rectified_rig(SIZE);
    let centre_px = Vector2::new(352.0, 236.0);
    let scene = Scene { centre_px, z_m: 0.7, theta_x_rad: 0.2, theta_y_rad: -0.3, noise: 3.0 };
    let (left, right) = scene.render(&rig);
    let region = region_of(&RegionMask::from_fn(SIZE, |u, v| scene.sees_disc(&rig, u, v)));
    let found = |calibration_sigma_px: f64, normal_sigma_max_deg: f64| {
        let mut config = DirectConfig::default();
        config.cold_start.refine.calibration_sigma_px = calibration_sigma_px;
        config.verdict.normal_sigma_max_deg = normal_sigma_max_deg;
        let mut estimator = DirectEstimator::new(&rig, config).unwrap();
        estimator.estimate(EstimateRequest::new_target(&left, &right, &region, &range())).unwrap()
    };
    let tilted = found(0.3, 0.5);
    assert_eq!(tilted.status, Status::WeakTilt, "{}", tilted.reason);
    assert_eq!(tilted.observed, Some([true, true, true, false, false, true]));
    let far = found(1.0, 90.0);
    assert_eq!(far.status, Status::WeakDepth, "{}", far.reason);
    assert_eq!(far.observed, Some([true, true, false, true, true, true]));
    assert!(far.reason.contains("depth has a standard deviation") && far.pose.is_some());
}
