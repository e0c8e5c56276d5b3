//! The published method on single rendered pairs: correct estimates, and inputs that it must reject.

#![allow(clippy::expect_used)]

use nalgebra::Vector2;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method};
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{PlaneEstimate, ReferenceOptimum};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::{Region, RegionError, RegionWarning};
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_published::estimator::{PublishedConfig, PublishedEstimator};
use pb3dp_estimation_published::photo_model::PhotoModelConfig;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use crate::common::{self, Look, Shot};

fn range() -> SearchRange {
    SearchRange::new(0.35, 0.70, 45.0_f64.to_radians()).expect("a range")
}

fn pose() -> Pose<CamLeft, Model> {
    common::target_at((14.0, -9.0, 485.0), (12.0, -17.0, 8.0))
}

fn polygon(rig: &StereoRig) -> Region {
    Region::Polygon { vertices_px: common::outline_px(rig, &pose()) }
}

fn estimate(rig: &StereoRig, look: Look, config: PublishedConfig) -> PlaneEstimate {
    let Shot { left, right } = common::render(rig, Some(&pose()), look);
    let mut estimator = PublishedEstimator::new(rig, config).expect("a config");
    estimator.estimate(EstimateRequest::new_target(&left, &right, &polygon(rig), &range())).expect("images that fit")
}

/// Checks the depth on the centroid's ray within `z_percent` and the normal within `normal_deg`; no uncertainty is claimed.
#[track_caller]
fn check_pose(rig: &StereoRig, estimate: &PlaneEstimate, (z_percent, normal_deg): (f64, f64)) {
    let truth_m = common::true_depth_m(rig, &pose(), &estimate.centroid_px);
    let z_m = estimate.z_m().expect("a pose");
    let normal = estimate.normal_in_cam_left().expect("a pose");
    let to_camera = -pose().transform_vector(&nalgebra::Vector3::z());
    let z_error = 100.0 * (z_m / truth_m - 1.0);
    let normal_error = common::angle_deg(&normal, &to_camera);
    assert!(z_error.abs() < z_percent, "depth error {z_error:.2} %: {estimate:?}");
    assert!(normal_error < normal_deg, "normal error {normal_error:.1} degrees: {estimate:?}");
    assert!((normal.norm() - 1.0).abs() < 1e-12 && normal.z < 0.0, "a unit normal towards the camera");
    assert_eq!((estimate.z_sigma_m, estimate.normal_sigma_rad), (None, None), "the method cannot say");
    // The depth elsewhere on the plane follows from the same three numbers.
    let away = estimate.centroid_px + Vector2::new(31.0, -22.0);
    let depth_m = estimate.depth_at_pixel(&away).expect("in front");
    assert!((depth_m / common::true_depth_m(rig, &pose(), &away) - 1.0).abs() < 0.03, "{depth_m}");
    let own_m = estimate.depth_at_pixel(&estimate.centroid_px).expect("in front");
    assert!((own_m - z_m).abs() < 1e-12);
}

#[test]
fn a_colourful_target_is_found_by_every_kind_of_rig() {
    for rig in [common::rectified_rig(), common::general_rig(), common::distorted_rig()] {
        let found = estimate(&rig, Look::Colourful, PublishedConfig::default());
        assert_eq!(found.status, Status::Ok, "{found:?}");
        check_pose(&rig, &found, (0.8, 4.0));
        assert!(found.fitness.expect("searched") > 0.7, "{found:?}");
    }
}

#[test]
fn a_target_of_one_hue_gives_its_depth() {
    let rig = common::rectified_rig();
    let found = estimate(&rig, Look::OneHue, PublishedConfig::default());
    assert!(matches!(found.status, Status::Ok | Status::WeakTilt), "{found:?}");
    let truth_m = common::true_depth_m(&rig, &pose(), &found.centroid_px);
    assert!((found.z_m().expect("a pose") / truth_m - 1.0).abs() < 0.015, "{found:?}");
}

#[test]
fn distortion_that_is_ignored_spoils_the_answer() {
    // Counter-test to the distorted rig above: the same images with a calibration without lens distortion.
    let rig = common::distorted_rig();
    let Shot { left, right } = common::render(&rig, Some(&pose()), Look::Colourful);
    let mut blind = PublishedEstimator::new(&rig.undistorted(), PublishedConfig::default()).expect("a config");
    let found =
        blind.estimate(EstimateRequest::new_target(&left, &right, &polygon(&rig), &range())).expect("images that fit");
    let right_fitness = estimate(&rig, Look::Colourful, PublishedConfig::default()).fitness.expect("searched");
    assert!(found.fitness.expect("searched") < right_fitness - 0.05, "{found:?}");
}

#[test]
fn a_grey_target_is_not_searched() {
    let found = estimate(&common::rectified_rig(), Look::Grey, PublishedConfig::default());
    assert_eq!(found.status, Status::NotObservable);
    assert_eq!((found.pose, found.psi, found.fitness), (None, None, None));
    assert!(found.reason.contains("have a hue"), "{}", found.reason);
    let grey =
        |w: &_| matches!(w, pb3dp_estimation_core::estimate::EstimateWarning::Region(RegionWarning::Grey { .. }));
    assert!(found.warnings.iter().any(grey), "{:?}", found.warnings);
}

#[test]
fn a_background_of_the_same_hue_is_not_observable() {
    for rig in [common::rectified_rig(), common::general_rig()] {
        let found = estimate(&rig, Look::SameHue, PublishedConfig::default());
        assert_eq!(found.status, Status::NotObservable, "{found:?}");
        assert_eq!(found.pose, None);
        assert!(found.fitness.expect("searched") > 0.95, "a high fitness proves nothing: {found:?}");
    }
}

#[test]
fn a_depth_outside_the_range_is_never_a_sure_answer() {
    let rig = common::rectified_rig();
    let Shot { left, right } = common::render(&rig, Some(&pose()), Look::Colourful);
    let mut estimator = PublishedEstimator::new(&rig, PublishedConfig::default()).expect("a config");
    let wrong = SearchRange::new(0.6, 1.2, 45.0_f64.to_radians()).expect("a range");
    let found = estimator
        .estimate(EstimateRequest::new_target(&left, &right, &polygon(&rig), &wrong))
        .expect("images that fit");
    assert!(!found.status.depth_is_sure(), "{found:?}");
}

#[test]
fn the_smallest_and_the_largest_range_of_tilts_serve() {
    let rig = common::rectified_rig();
    let facing = common::target_at((5.0, 10.0, 485.0), (0.0, 0.0, 12.0));
    let Shot { left, right } = common::render(&rig, Some(&facing), Look::Colourful);
    let region = Region::Polygon { vertices_px: common::outline_px(&rig, &facing) };
    for tilt_max_deg in [0.0_f64, 85.0] {
        let mut estimator = PublishedEstimator::new(&rig, PublishedConfig::default()).expect("a config");
        let range = SearchRange::new(0.35, 0.65, tilt_max_deg.to_radians()).expect("a range");
        let found =
            estimator.estimate(EstimateRequest::new_target(&left, &right, &region, &range)).expect("images that fit");
        assert!(found.status.depth_is_sure(), "{tilt_max_deg}: {found:?}");
        assert!((found.z_m().expect("a pose") / 0.485 - 1.0).abs() < 0.012, "{tilt_max_deg}: {found:?}");
    }
    assert!(SearchRange::new(0.35, 0.65, 85.01_f64.to_radians()).is_err());
}

#[test]
fn the_answer_depends_on_the_input_alone() {
    let rig = common::general_rig();
    let Shot { left, right } = common::render(&rig, Some(&pose()), Look::Colourful);
    let first = estimate(&rig, Look::Colourful, PublishedConfig::default());
    for kernels in pb3dp_estimation_test_support::every_kernel() {
        let mut estimator =
            PublishedEstimator::with_kernels(&rig, PublishedConfig::default(), kernels).expect("a config");
        let other = Region::Rectangle { x: 20, y: 30, width: 60, height: 50 };
        estimator.estimate(EstimateRequest::new_target(&left, &right, &other, &range())).expect("another region first");
        let again = estimator
            .estimate(EstimateRequest::new_target(&left, &right, &polygon(&rig), &range()))
            .expect("images that fit");
        assert_eq!(again, first, "{kernels:?}");
    }
    let mut seeded = PublishedConfig::default();
    seeded.rmga.seed = 77;
    assert_ne!(estimate(&rig, Look::Colourful, seeded).psi, first.psi, "another seed, another walk");
}

#[test]
fn the_reference_optimum_is_at_least_what_the_search_found() {
    let few = PhotoModelConfig { inner_points: 60, outer_points: 30, ..PhotoModelConfig::default() };
    let config = PublishedConfig { model: few, reference_optimum: true, ..PublishedConfig::default() };
    let found = estimate(&common::rectified_rig(), Look::Colourful, config);
    let ReferenceOptimum { psi, fitness, ties } = found.reference_optimum.expect("asked for");
    assert!(fitness >= found.fitness.expect("searched"));
    assert!((psi.z_m / 0.485 - 1.0).abs() < 0.03, "{psi:?}");
    assert!((1..10_000).contains(&ties), "a summit, not a plain: {ties}");
}

#[test]
fn the_reference_optimum_tells_how_wide_its_plateau_is() {
    let few = PhotoModelConfig { inner_points: 60, outer_points: 0, ..PhotoModelConfig::default() };
    let config = PublishedConfig { model: few, reference_optimum: true, ..PublishedConfig::default() };
    let found = estimate(&common::rectified_rig(), Look::SameHue, config);
    let ReferenceOptimum { psi, fitness, ties } = found.reference_optimum.expect("asked for");
    // Everything has one hue: all votes agree, wherever the plane projects the region in the image.
    assert_eq!((fitness, found.fitness), (1.0, Some(1.0)));
    assert_ne!(found.psi, Some(psi), "two of many that are equal");
    assert!(ties > 1 << 20 && ties <= 1 << 24, "{ties}");
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let rig = common::rectified_rig();
    let Shot { left, right } = common::render(&rig, None, Look::Colourful);
    let mut estimator =
        Estimator::new(Method::Published, &rig, &EstimatorConfig::default()).expect("the default configuration");
    let outside = Region::Rectangle { x: 400, y: 10, width: 50, height: 50 };
    assert_eq!(
        estimator.estimate(EstimateRequest::new_target(&left, &right, &outside, &range())),
        Err(EstimationError::Region(RegionError::OffImage {
            first_px: [400, 10],
            last_px: [449, 59],
            image_width: 320,
            image_height: 240
        }))
    );
    let region = Region::Rectangle { x: 100, y: 100, width: 50, height: 50 };
    let small = image::RgbImage::new(160, 120);
    let error =
        estimator.estimate(EstimateRequest::new_target(&left, &small, &region, &range())).expect_err("another size");
    assert!(matches!(error, EstimationError::ImageSize { side: "right", width: 160, .. }), "{error}");
    let error =
        estimator.estimate(EstimateRequest::new_target(&small, &right, &region, &range())).expect_err("another size");
    assert!(matches!(error, EstimationError::ImageSize { side: "left", .. }), "{error}");
    let backwards = SearchRange { z_min_m: 0.6, z_max_m: 0.4, tilt_max_rad: 0.5 };
    let error =
        estimator.estimate(EstimateRequest::new_target(&left, &right, &region, &backwards)).expect_err("a range");
    assert!(matches!(error, EstimationError::Parameter { name: "search range z_max_m", .. }), "{error}");
    let mut config = PublishedConfig::default();
    config.observability.resamples = 1;
    let error = PublishedEstimator::new(&rig, config).expect_err("too few resamples");
    assert!(matches!(error, EstimationError::Parameter { name: "probe resamples", .. }), "{error}");
}
