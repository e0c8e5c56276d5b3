//! The published method on the real pairs of the repository, which carry their truth.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests may fail the test")]

use std::time::Duration;

use nalgebra::Vector2;
use pb3dp_camera_replay::{ReplayCamera, ReplayOptions};
use pb3dp_estimation::estimate::PlaneEstimate;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method};
use pb3dp_estimation::plane_hypothesis::SearchRange;
use pb3dp_estimation::region::Region;
use pb3dp_hal_api::{CameraErrorKind, FramePair, StereoCamera};
use pb3dp_record::dataset::{Case, StereoPictures, find_cases, load_case};
use pb3dp_record::metrics;
use system_tests::repository;

fn cases() -> Vec<Case> {
    let folders = find_cases(&repository().join("tests/data/cases")).unwrap();
    let cases: Vec<Case> = folders.iter().map(|folder| load_case(folder).unwrap()).collect();
    assert!(cases.len() >= 4 && cases.iter().all(|case| case.truth.is_some()), "real pairs with truth are there");
    cases
}

fn estimate(case: &Case, pictures: &StereoPictures, seed: u64, saturation_min: f64) -> PlaneEstimate {
    let mut config = EstimatorConfig::default();
    config.published.rmga.seed = seed;
    config.published.hue.saturation_min = saturation_min;
    let rig = case.load_calibration().unwrap().rig;
    let mut estimator = Estimator::new(Method::Published, &rig, &config).unwrap();
    let vertices_px = case.region_polygon_left_px.iter().map(|&[u, v]| Vector2::new(u, v)).collect();
    let range = SearchRange {
        z_min_m: case.search.z_min_m,
        z_max_m: case.search.z_max_m,
        tilt_max_rad: case.search.tilt_max_rad,
    };
    estimator.estimate(&pictures.left, &pictures.right, &Region::Polygon { vertices_px }, &range).unwrap()
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
fn no_answer_is_sure_and_wrong() {
    let mut sure = 0;
    for case in cases() {
        let pictures = case.load_pictures().unwrap();
        // With a gate that lets noise through, the grey fields of the boards get hues that mean nothing.
        for (seed, saturation_min) in [(1, 0.08), (2, 0.08), (3, 0.08), (1, 0.04), (1, 0.02)] {
            let found = estimate(&case, &pictures, seed, saturation_min);
            let what =
                format!("{}, seed {seed}, saturation {saturation_min}: {}: {}", case.name, found.status, found.reason);
            match errors(&case, &found) {
                Some((depth, _)) if found.status.depth_is_sure() => {
                    sure += 1;
                    assert!(depth.abs() < 0.02, "{what}: the depth is off by {:.1} %", depth * 100.0);
                }
                None => assert!(!found.status.depth_is_sure(), "{what}: sure of a pose that is not there"),
                Some(_) => assert!(!found.reason.is_empty(), "{what}: a doubt has its reason"),
            }
        }
    }
    assert!(sure > 0, "at least one of the boards has enough colour to be answered");
}

#[test]
fn the_coloured_board_is_found_where_it_is() {
    let case = cases().into_iter().find(|case| case.name == "bb201_c0").unwrap();
    let found = estimate(&case, &case.load_pictures().unwrap(), 1, 0.08);
    let (depth, normal_deg) = errors(&case, &found).expect("this board has coloured reflections");
    assert!(depth.abs() < 0.02 && normal_deg < 8.0, "depth {depth}, normal {normal_deg} degrees: {}", found.reason);
}

#[test]
fn replayed_pictures_are_those_of_the_files() {
    for case in cases() {
        let pictures = case.load_pictures().unwrap();
        let mut camera = ReplayCamera::open(&case.folder, ReplayOptions::default()).unwrap();
        assert_eq!(*camera.rig(), case.load_calibration().unwrap().rig);
        let mut pair = FramePair::black(camera.info().size);
        camera.next_pair_into(&mut pair, Duration::from_secs(1)).unwrap();
        assert!(pair.left == pictures.left && pair.right == pictures.right, "{}: other pixels", case.name);
        assert!(pair.left != pair.right, "{}: left and right are two pictures", case.name);
        let replayed = StereoPictures { left: pair.left.clone(), right: pair.right.clone() };
        let end = camera.next_pair_into(&mut pair, Duration::from_secs(1)).unwrap_err();
        assert_eq!(end.kind(), CameraErrorKind::EndOfStream, "{end}");
        assert_eq!(estimate(&case, &replayed, 1, 0.08), estimate(&case, &pictures, 1, 0.08));
    }
}
