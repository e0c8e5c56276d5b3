//! Cameras that do not expose at once: the target moves between the two exposures of a pair.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use nalgebra::Vector3;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Target};

use crate::moving_plane::{Shot, general_rig, moving, region, render};

const FPS: f64 = 30.0;
const FRAMES: u32 = 20;

/// Depth error of the plane where the origin of `model` is seen, millimetres, and its standard deviation.
fn depth_error_mm(estimate: &TrackEstimate, truth: &Pose<CamLeft, Target>) -> [f64; 2] {
    let at_m = estimate.cam_left_from_model.expect("a pose").translation_m();
    let normal = truth.rotation() * Vector3::z();
    let true_z_m = normal.dot(&truth.translation_m()) / normal.dot(&(at_m / at_m.z));
    [1e3 * (at_m.z - true_z_m), 1e3 * estimate.covariance.expect("a covariance")[(2, 2)].sqrt()]
}

/// Errors of all frames of a target that moves in six directions, seen by cameras that are not rectified.
fn errors_mm(skew_s: f64, known_s: f64) -> Vec<[f64; 2]> {
    let rig = general_rig();
    let mut tracker =
        DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).expect("tracker");
    let range = SearchRange { z_min_m: 0.3, z_max_m: 0.7, tilt_max_rad: 0.8 };
    let follow = |frame: u32| {
        let t_s = f64::from(frame) / FPS;
        let [now, later] = [t_s, t_s + skew_s]
            .map(|t_s| render(&rig, &Shot { cam_left_from_target: Some(moving(t_s)), frame, right_gain: 1.0 }));
        let prior = FramePrior { dt_s: Some(1.0 / FPS), ..FramePrior::of_skew(known_s) };
        let region = region(&rig, &moving(t_s));
        let mut request = match frame {
            0 => EstimateRequest::of_target(&now.0, &later.1, &region, &range).with_skew(known_s),
            _ => EstimateRequest::of_next(&now.0, &later.1, &prior),
        };
        let estimate = tracker.answer(&mut request).expect("valid images");
        assert_eq!(estimate.status, Status::Ok, "frame {frame}: {}", estimate.reason);
        depth_error_mm(&estimate, &moving(t_s))
    };
    (0..FRAMES).map(follow).collect()
}

fn median(errors_mm: &[[f64; 2]]) -> f64 {
    let mut sizes: Vec<f64> = errors_mm.iter().map(|[error, _]| error.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    sizes[sizes.len() / 2]
}

#[test]
fn the_motion_between_the_exposures_does_not_change_the_depth() {
    let unknown = errors_mm(5e-3, 0.0);
    for skew_s in [5e-3, -5e-3] {
        let known = errors_mm(skew_s, skew_s);
        // The first pair does not show the motion; its covariance contains what a motion may do.
        let [first_mm, sigma_mm] = known[0];
        assert!(first_mm.abs() > 0.3 && first_mm.abs() < 3.0 * sigma_mm, "{first_mm} +- {sigma_mm}");
        let [known_mm, unknown_mm] = [&known[1..], &unknown[1..]].map(median);
        assert!(known_mm < 0.1 && known_mm < 0.2 * unknown_mm, "{skew_s} s: {known_mm} mm, unknown {unknown_mm} mm");
        let beyond = known[1..].iter().filter(|[error, sigma]| error.abs() > 3.0 * sigma).count();
        assert!(beyond < 4, "{beyond} of {FRAMES} depths are off by more than three standard deviations");
    }
}
