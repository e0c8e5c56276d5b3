//! Every method on the real pairs of the repository, which have ground truth.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests may fail the test")]

use std::time::Duration;

use nalgebra::Vector2;
use pb3dp_camera_replay::{Recording, RecordingOptions, ReplayOptions};
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method};
use pb3dp_estimation_core::estimate::PlaneEstimate;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_hal_api::{CameraErrorKind, FramePair, StereoCamera};
use pb3dp_record::dataset::{Case, StereoImages, find_cases, load_case};
use pb3dp_record::metrics;
use system_tests::repository;

fn cases() -> Vec<Case> {
    let folders = find_cases(&repository().join("tests/data/cases")).unwrap();
    let cases: Vec<Case> = folders.iter().map(|folder| load_case(folder).unwrap()).collect();
    assert!(cases.len() >= 4 && cases.iter().all(|case| case.truth.is_some()), "there are real pairs with truth");
    cases
}

/// The published method with a seed and a gate for hues.
fn published(case: &Case, images: &StereoImages, seed: u64, saturation_min: f64) -> PlaneEstimate {
    let mut config = EstimatorConfig::default();
    config.published.rmga.seed = seed;
    config.published.hue.saturation_min = saturation_min;
    let rig = case.load_calibration().unwrap().rig;
    run(Estimator::new(Method::Published, &rig, &config).unwrap(), case, images)
}

/// The direct method, with the vertical misalignment measured beforehand or assumed to be zero.
fn direct(case: &Case, images: &StereoImages, measures_rows: bool) -> PlaneEstimate {
    let rig = case.load_calibration().unwrap().rig;
    let mut estimator = Estimator::new(Method::Direct, &rig, &EstimatorConfig::default()).unwrap();
    if measures_rows {
        estimator.look(&images.left, &images.right).unwrap();
        assert_eq!(estimator.watch().warning(), None, "these pairs are rectified");
    }
    run(estimator, case, images)
}

fn run(mut estimator: Estimator, case: &Case, images: &StereoImages) -> PlaneEstimate {
    let vertices_px = case.region_polygon_left_px.iter().map(|&[u, v]| Vector2::new(u, v)).collect();
    let range = SearchRange {
        z_min_m: case.search.z_min_m,
        z_max_m: case.search.z_max_m,
        tilt_max_rad: case.search.tilt_max_rad,
    };
    estimator
        .estimate(EstimateRequest::new_target(&images.left, &images.right, &Region::Polygon { vertices_px }, &range))
        .unwrap()
}

/// The relative error of the depth at the case's centroid and the angle between the normals, degrees.
fn errors(case: &Case, estimate: &PlaneEstimate) -> Option<(f64, f64)> {
    let [u, v] = case.region_centroid_px.unwrap();
    let z_m = estimate.depth_at_pixel(&Vector2::new(u, v))?;
    let plane = metrics::PlaneEstimate { z_m, normal_in_cam_left: estimate.normal_in_cam_left()? };
    let truth = case.truth.as_ref().unwrap();
    let normal_deg = plane.normal_in_cam_left.angle(&truth.normal_in_cam_left).to_degrees();
    Some(((z_m - truth.z_m) / truth.z_m, normal_deg))
}

#[test]
fn no_answer_of_the_published_method_is_sure_and_wrong() {
    let mut sure = 0;
    for case in cases() {
        let images = case.load_images().unwrap();
        // With a gate that lets noise through, the grey fields of the boards get meaningless hues.
        for (seed, saturation_min) in [(1, 0.08), (2, 0.08), (3, 0.08), (1, 0.04), (1, 0.02)] {
            let found = published(&case, &images, seed, saturation_min);
            let what =
                format!("{}, seed {seed}, saturation {saturation_min}: {}: {}", case.name, found.status, found.reason);
            match errors(&case, &found) {
                Some((depth, _)) if found.status.depth_is_sure() => {
                    sure += 1;
                    assert!(depth.abs() < 0.02, "{what}: the depth error is {:.1} %", depth * 100.0);
                }
                None => assert!(!found.status.depth_is_sure(), "{what}: confident without a pose"),
                Some(_) => assert!(!found.reason.is_empty(), "{what}: low confidence needs a reason"),
            }
        }
    }
    assert!(sure > 0, "at least one of the boards has enough colour for an answer");
}

#[test]
fn the_published_method_finds_the_coloured_board_where_it_is() {
    let case = cases().into_iter().find(|case| case.name == "bb201_c0").unwrap();
    let found = published(&case, &case.load_images().unwrap(), 1, 0.08);
    let (depth, normal_deg) = errors(&case, &found).expect("this board has coloured reflections");
    assert!(depth.abs() < 0.02 && normal_deg < 8.0, "depth {depth}, normal {normal_deg} degrees: {}", found.reason);
}

/// The truth comes from the corners of the boards; block matching with a plane fit reaches 0.06 % and 0.4 degrees.
#[test]
fn the_direct_method_finds_every_board_to_a_tenth_of_a_percent_and_half_a_degree() {
    for case in cases() {
        let images = case.load_images().unwrap();
        for measures_rows in [false, true] {
            let found = direct(&case, &images, measures_rows);
            let (depth, normal_deg) = errors(&case, &found).expect("a board has texture");
            let what = format!(
                "{}, rows measured {measures_rows}: depth {:+.3} %, normal {normal_deg:.3} degrees, sigma {:?} m, {:?} rad",
                case.name,
                1e2 * depth,
                found.z_sigma_m,
                found.normal_sigma_rad
            );
            assert_eq!(found.status.as_str(), "ok", "{what}: {}", found.reason);
            assert!(depth.abs() < 1e-3 && normal_deg < 0.5, "{what}");
            assert!(found.z_sigma_m.unwrap() < 1e-3 && found.normal_sigma_rad.unwrap() < 0.01, "{what}");
        }
    }
}

/// A board shifted by two squares looks like itself, so in a range without the truth its alias fits most of the overlap.
#[test]
fn a_board_outside_the_depth_range_is_not_sure_of_its_alias() {
    let mut case = cases().into_iter().find(|case| case.name == "bb204_c0").unwrap();
    let images = case.load_images().unwrap();
    let z_m = case.truth.as_ref().unwrap().z_m;
    for (z_min_m, z_max_m) in [(0.5, 1.0), (0.16, 0.32)] {
        (case.search.z_min_m, case.search.z_max_m) = (z_min_m, z_max_m);
        assert!(!(z_min_m..z_max_m).contains(&z_m), "the truth, {z_m} m, is outside");
        let found = direct(&case, &images, false);
        assert_eq!(found.status.as_str(), "ambiguous", "{z_min_m} to {z_max_m} m: {}", found.reason);
        assert!(found.reason.contains("widen it (SearchRange)"), "{}", found.reason);
    }
}

/// Parts of the boards, each with a depth range that excludes it; earlier versions answered all of them with `ok`.
#[test]
fn a_part_of_a_board_outside_the_depth_range_is_not_sure_of_anything() {
    let parts = [
        ("bb204_c0", [371, 283, 66, 45], [0.419, 1.243]),
        ("bb204_c0", [457, 273, 70, 45], [0.123, 0.344]),
        ("bb207_c0", [418, 222, 86, 62], [0.477, 1.161]),
        ("bb207_c0", [424, 201, 57, 88], [0.672, 1.793]),
        ("bb209_c0", [335, 194, 65, 49], [0.141, 0.343]),
        ("bb209_c0", [270, 170, 62, 55], [0.577, 1.540]),
    ];
    for (name, [x, y, width, height], [z_min_m, z_max_m]) in parts {
        let mut case = cases().into_iter().find(|case| case.name == name).unwrap();
        let (right, bottom) = (f64::from(x + width - 1), f64::from(y + height - 1));
        let (x, y) = (f64::from(x), f64::from(y));
        case.region_polygon_left_px = vec![[x, y], [right, y], [right, bottom], [x, bottom]];
        (case.search.z_min_m, case.search.z_max_m) = (z_min_m, z_max_m);
        let found = direct(&case, &case.load_images().unwrap(), true);
        let what = format!("{name} {x} {y}: {}: {}", found.status, found.reason);
        assert!(!found.status.depth_is_sure(), "{what}");
        assert!(found.reason.contains("(SearchRange)"), "{what}");
    }
}

#[test]
fn replayed_images_are_those_of_the_files() {
    for case in cases() {
        let images = case.load_images().unwrap();
        let mut camera =
            Recording::open(&case.folder, &[], &RecordingOptions::default(), ReplayOptions::default()).unwrap().camera;
        assert_eq!(*camera.rig(), case.load_calibration().unwrap().rig);
        let mut pair = FramePair::black(camera.info().size);
        camera.next_pair_into(&mut pair, Duration::from_secs(1)).unwrap();
        assert!(pair.left == images.left && pair.right == images.right, "{}: other pixels", case.name);
        assert!(pair.left != pair.right, "{}: left and right are two images", case.name);
        let replayed = StereoImages { left: pair.left.clone(), right: pair.right.clone() };
        let end = camera.next_pair_into(&mut pair, Duration::from_secs(1)).unwrap_err();
        assert_eq!(end.kind(), CameraErrorKind::EndOfStream, "{end}");
        assert_eq!(published(&case, &replayed, 1, 0.08), published(&case, &images, 1, 0.08));
        assert_eq!(direct(&case, &replayed, true), direct(&case, &images, true));
    }
}
