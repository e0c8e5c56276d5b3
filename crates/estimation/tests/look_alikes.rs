//! Another disc that looks the same as the target: beside it, passing in front of it, or on the next side of the same box.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use nalgebra::Vector3;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Pose, so3};

use crate::moving_plane::{Shot, plane, rectified_rig, region, render_all};

/// Largest error of a pose that is `ok`, millimetres and degrees.
const DISTANCE_MAX_MM: f64 = 0.6;
const ANGLE_MAX_DEG: f64 = 0.8;

/// Tracks the target at `own(0)`; `discs` are those to be seen in a frame, the nearest first. Every pose that is `ok` must be that of
/// `own`. Returns the statuses from the second frame on.
fn statuses(
    frames: u32,
    own: impl Fn(f64) -> Pose<CamLeft, Target>,
    discs: impl Fn(f64) -> Vec<Pose<CamLeft, Target>>,
) -> Vec<Status> {
    let rig = rectified_rig();
    let mut tracker =
        DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).expect("tracker");
    let shot = |frame: u32| Shot { cam_left_from_target: None, frame, right_gain: 0.9 };
    let (left, right) = render_all(&rig, &discs(0.0), &shot(0));
    let first = own(0.0);
    let estimate = tracker.start_from_plane(&left, &right, &region(&rig, &first), &plane(&first)).expect("start");
    let target_from_model = first.inverse() * estimate.cam_left_from_model.expect("pose");
    (1..frames)
        .map(|frame| {
            let (left, right) = render_all(&rig, &discs(frame.into()), &shot(frame));
            let prior = FramePrior { dt_s: Some(1.0 / 30.0), ..FramePrior::default() };
            let estimate = tracker.estimate(EstimateRequest::next_frame(&left, &right, &prior)).expect("update");
            if estimate.status == Status::Ok {
                let error =
                    (own(frame.into()) * target_from_model).inverse() * estimate.cam_left_from_model.expect("a pose");
                let (mm, deg) = (1e3 * error.translation_m().norm(), error.rotation_angle_rad().to_degrees());
                assert!(mm < DISTANCE_MAX_MM && deg < ANGLE_MAX_DEG, "frame {frame}: {mm} mm, {deg} degrees");
            }
            estimate.status
        })
        .collect()
}

fn at(x: f64, z: f64, turn: f64) -> Pose<CamLeft, Target> {
    Pose::from_parts(Vector3::new(x, 0.01, z), so3::exp(&Vector3::new(0.1, turn, 0.1)))
}

fn count_ok(statuses: &[Status]) -> usize {
    statuses.iter().filter(|status| **status == Status::Ok).count()
}

/// With a twin visible from the start, a lost target is found again next to it. The twin alone is not accepted as the target.
#[test]
fn a_twin_is_not_taken_for_a_hidden_target() {
    let own = |frame: f64| at(-0.02 + 0.0004 * frame, 0.45, -0.1 + 0.004 * frame);
    let twin = at(0.11, 0.47, 0.1);
    let is_hidden = |frame: f64| (5.0..14.0).contains(&frame);
    let found = statuses(20, own, |frame| if is_hidden(frame) { vec![twin] } else { vec![own(frame), twin] });
    assert!(found[4..13].iter().all(|status| *status != Status::Ok), "{found:?}");
    assert!(count_ok(&found) >= 8, "found again within two frames: {found:?}");
}

/// A disc that looks the same passes between the cameras and the target. It was seen only while it came.
#[test]
fn a_twin_that_passes_in_front_is_not_taken_for_the_target() {
    let own = |_: f64| at(-0.02, 0.45, -0.1);
    for (start_m, step_m, before_m) in [(0.30, -0.012, 0.02), (0.30, -0.018, 0.05), (-0.36, 0.015, 0.03)] {
        let twin = |frame: f64| at(start_m + step_m * frame, 0.45 - before_m, -0.07);
        let found = statuses(50, own, |frame| vec![twin(frame), own(frame)]);
        assert!(count_ok(&found[..10]) == 10, "not there yet: {found:?}");
        assert!(count_ok(&found) < 49, "hidden for some frames: {found:?}");
        assert_eq!(found.last(), Some(&Status::Ok), "{found:?}");
    }
}

/// A box with the same print on every side turns, and its next side comes into view.
#[test]
fn another_side_with_the_same_print_is_not_taken_for_the_marked_one() {
    let half_m = 0.05;
    for step_rad in [0.06, -0.09] {
        let side = |frame: f64, quarter: f64| {
            let turn = so3::exp(&Vector3::new(0.0, step_rad * frame + quarter, 0.0));
            let roll = so3::exp(&Vector3::new(0.0, 0.0, 0.2));
            let centre = Vector3::new(0.01, 0.02, 0.5);
            Pose::from_parts(centre + turn * Vector3::new(0.0, 0.0, -half_m), turn * roll)
        };
        let own = |frame: f64| side(frame, 0.0);
        let next = |frame: f64| side(frame, -std::f64::consts::FRAC_PI_2 * f64::signum(step_rad));
        let faces = |pose: &Pose<CamLeft, Target>| (pose.rotation() * Vector3::z()).dot(&pose.translation_m()) > 0.02;
        let found = statuses(40, own, |frame| [own(frame), next(frame)].into_iter().filter(faces).collect());
        assert!(count_ok(&found) >= 8, "until it turns away: {found:?}");
        assert_ne!(found.last(), Some(&Status::Ok), "{found:?}");
    }
}

/// What is found again far away alone, and looks as the target did, is believed.
#[test]
fn a_target_found_elsewhere_alone_is_believed() {
    let own = |frame: f64| if frame < 12.0 { at(-0.03, 0.45, -0.1) } else { at(0.05, 0.47, 0.1) };
    let found = statuses(20, own, |frame| if (4.0..12.0).contains(&frame) { Vec::new() } else { vec![own(frame)] });
    assert_eq!(found[11..14], [Status::Ok; 3], "{found:?}");
}
