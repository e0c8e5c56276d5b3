//! The published tracker on rendered sequences: moving targets, a moving camera, loss and recovery.

#![allow(clippy::expect_used)]

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_estimation::estimator::{EstimatorConfig, FramePrior, Method, Tracker};
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::{EstimateWarning, TrackEstimate};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::{Region, RegionWarning};
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_published::estimator::{PublishedConfig, PublishedTracker};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use crate::common::{self, Look, Shot};

fn range() -> SearchRange {
    SearchRange::new(0.35, 0.70, 45.0_f64.to_radians()).expect("a range")
}

fn start_pose() -> Pose<CamLeft, Model> {
    common::target_at((-20.0, 8.0, 495.0), (-9.0, 14.0, 5.0))
}

/// A tracker after the first frame, and its estimate.
fn started(rig: &StereoRig, look: Look) -> (PublishedTracker, TrackEstimate) {
    let mut tracker = PublishedTracker::new(rig, PublishedConfig::default()).expect("a config");
    let Shot { left, right } = common::render(rig, Some(&start_pose()), look);
    let region = Region::Polygon { vertices_px: common::outline_px(rig, &start_pose()) };
    let estimate =
        tracker.estimate(EstimateRequest::new_target(&left, &right, &region, &range())).expect("images that fit");
    (tracker, estimate)
}

fn follow(
    tracker: &mut PublishedTracker,
    rig: &StereoRig,
    target: Option<&Pose<CamLeft, Model>>,
    motion: Option<&Pose<CamLeft, CamLeft>>,
) -> TrackEstimate {
    let Shot { left, right } = common::render(rig, target, Look::Colourful);
    tracker
        .estimate(EstimateRequest::next_frame(&left, &right, &FramePrior::of_motion(motion)))
        .expect("images that fit")
}

/// The target point that the tracker uses as the origin, in the frame of `target`.
fn origin_on(target: &Pose<CamLeft, Model>, estimate: &TrackEstimate) -> Vector3<f64> {
    let origin = estimate.cam_left_from_model.expect("a pose").translation_m();
    target.inverse().transform_point(&origin.into()).coords
}

/// The origin stays on the same point of the target within `origin_mm`; the normal is within `normal_deg` of the truth.
#[track_caller]
fn check(target: &Pose<CamLeft, Model>, first: Vector3<f64>, estimate: &TrackEstimate, (mm, degrees): (f64, f64)) {
    let strayed_mm = 1000.0 * (origin_on(target, estimate) - first).norm();
    assert!(strayed_mm < mm, "the origin has drifted by {strayed_mm:.2} mm: {estimate:?}");
    let normal = estimate.cam_left_from_model.expect("a pose").transform_vector(&Vector3::z());
    let error_deg = common::angle_deg(&normal, &target.transform_vector(&Vector3::z()));
    assert!(error_deg < degrees, "normal error {error_deg:.1} degrees: {estimate:?}");
    assert!(!estimate.rotation_about_normal_observed && estimate.covariance.is_none());
}

#[test]
fn the_first_frame_defines_the_model() {
    let rig = common::distorted_rig();
    let (_, estimate) = started(&rig, Look::Colourful);
    assert!(estimate.status.depth_is_sure(), "{estimate:?}");
    let pose = estimate.cam_left_from_model.expect("a pose");
    let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| pose.transform_vector(&axis));
    assert!(z.z > 0.8, "z points away from the camera");
    assert!(x.x > 0.0 && x.dot(&Vector3::x().cross(&z)).abs() < 1e-9, "x is the image's x axis in the plane");
    assert!((x.cross(&y) - z).norm() < 1e-12, "right-handed");
    // The origin is at the region's centroid, and the outline is the one given.
    let outline = common::outline_px(&rig, &start_pose());
    for (given, found) in outline.iter().zip(&estimate.outline_px) {
        assert!((given - found).norm() < 1e-3, "{given} {found}");
    }
    assert!(origin_on(&start_pose(), &estimate).xy().norm() < 0.012, "near the target's middle");
}

#[test]
fn a_moving_target_is_followed_by_every_kind_of_rig() {
    for rig in [common::rectified_rig(), common::distorted_rig()] {
        let (mut tracker, first) = started(&rig, Look::Colourful);
        let origin = origin_on(&start_pose(), &first);
        for step in 1..=5 {
            let k = f64::from(step);
            let target = common::target_at(
                (-20.0 + 3.0 * k, 8.0 - 2.0 * k, 495.0 + 2.5 * k),
                (-9.0 + k, 14.0 - 1.2 * k, 5.0 + 0.8 * k),
            );
            let estimate = follow(&mut tracker, &rig, Some(&target), None);
            assert!(estimate.status.depth_is_sure(), "{step}: {estimate:?}");
            check(&target, origin, &estimate, (6.0, 6.0));
            for (truth, found) in common::outline_px(&rig, &target).iter().zip(&estimate.outline_px) {
                assert!((truth - found).norm() < 4.0, "{step}: the region is at {found} instead of {truth}");
            }
        }
    }
}

#[test]
fn the_known_motion_of_the_camera_carries_pose_region_and_population() {
    let rig = common::general_rig();
    // Per frame 14 mm and 5 degrees, most of it about the optical axis.
    let turn = UnitQuaternion::from_euler_angles(0.02, -0.03, 0.08);
    let motion: Pose<CamLeft, CamLeft> = Pose::from_parts(Vector3::new(0.011, -0.006, 0.008), turn);
    let (mut tracker, first) = started(&rig, Look::Colourful);
    let (mut blind, _) = started(&rig, Look::Colourful);
    let origin = origin_on(&start_pose(), &first);
    let (mut target, mut axes) = (start_pose(), first.cam_left_from_model.expect("a pose"));
    let x_of = |estimate: &TrackEstimate| estimate.cam_left_from_model.map(|pose| pose.transform_vector(&Vector3::x()));
    for step in 1..=4 {
        target = motion.inverse() * target;
        axes = motion.inverse() * axes;
        let x_true = axes.transform_vector(&Vector3::x());
        let estimate = follow(&mut tracker, &rig, Some(&target), Some(&motion));
        assert!(estimate.status.depth_is_sure(), "{estimate:?}");
        check(&target, origin, &estimate, (6.0, 6.0));
        // The target is stationary, so its x axis is too, up to the error of the normal.
        let x = x_of(&estimate).expect("a pose");
        assert!(common::angle_deg(&x, &x_true) < 7.0, "{estimate:?}");
        // Without the camera motion the tracker keeps the rotation about the normal constant in the camera frame.
        let blind_x = x_of(&follow(&mut blind, &rig, Some(&target), None));
        if step == 4 {
            let x = blind_x.expect("without the camera motion the target is still tracked");
            assert!(common::angle_deg(&x, &x_true) > 10.0, "{x}");
        }
    }
}

#[test]
fn a_target_that_disappears_is_lost_and_found_again() {
    let rig = common::rectified_rig();
    let (mut tracker, first) = started(&rig, Look::Colourful);
    let origin = origin_on(&start_pose(), &first);
    for _ in 0..2 {
        let estimate = follow(&mut tracker, &rig, None, None);
        assert_eq!(estimate.status, Status::Lost, "{estimate:?}");
        assert_eq!(estimate.cam_left_from_model, None);
        assert!(estimate.reason.contains("hue"), "{}", estimate.reason);
    }
    // The target reappears 35 mm farther right.
    let back = common::target_at((15.0, 8.0, 500.0), (-9.0, 14.0, 5.0));
    let estimate = follow(&mut tracker, &rig, Some(&back), None);
    assert!(estimate.status.depth_is_sure(), "{estimate:?}");
    check(&back, origin, &estimate, (8.0, 8.0));
}

#[test]
fn a_target_that_leaves_the_image_is_lost() {
    let rig = common::rectified_rig();
    let (mut tracker, _) = started(&rig, Look::Colourful);
    let sideways: Pose<CamLeft, CamLeft> = Pose::from_translation(Vector3::new(0.26, 0.0, 0.0));
    let target = sideways.inverse() * start_pose();
    let estimate = follow(&mut tracker, &rig, Some(&target), Some(&sideways));
    assert_eq!(estimate.status, Status::Lost, "{estimate:?}");
    let behind: Pose<CamLeft, CamLeft> = Pose::from_translation(Vector3::new(0.0, 0.0, 2.0));
    let estimate = follow(&mut tracker, &rig, None, Some(&behind));
    assert_eq!(estimate.status, Status::Lost);
    assert!(estimate.reason.contains("outside the image"), "{}", estimate.reason);
}

#[test]
fn what_can_not_be_observed_is_tried_again_in_the_next_frame() {
    let rig = common::rectified_rig();
    let (mut tracker, first) = started(&rig, Look::Grey);
    assert_eq!((first.status, first.cam_left_from_model), (Status::NotObservable, None));
    let Shot { left, right } = common::render(&rig, Some(&start_pose()), Look::Grey);
    let estimate = tracker
        .estimate(EstimateRequest::next_frame(&left, &right, &FramePrior::of_motion(None)))
        .expect("images that fit");
    assert_eq!(estimate.status, Status::NotObservable);
    assert_eq!(estimate.warnings, [], "a warning is reported once");
    let estimate = follow(&mut tracker, &rig, Some(&start_pose()), None);
    assert!(estimate.status.depth_is_sure(), "a coloured target in the same region: {estimate:?}");
    let mut unused = PublishedTracker::new(&rig, PublishedConfig::default()).expect("a config");
    let Shot { left, right } = common::render(&rig, None, Look::Grey);
    assert_eq!(
        unused.estimate(EstimateRequest::next_frame(&left, &right, &FramePrior::of_motion(None))),
        Err(EstimationError::NotStarted)
    );
}

#[test]
fn the_start_tells_why_a_region_may_serve_badly() {
    let rig = common::rectified_rig();
    let (mut tracker, fine) = started(&rig, Look::Colourful);
    assert_eq!(fine.warnings, []);
    let (_, grey) = started(&rig, Look::Grey);
    assert!(matches!(grey.warnings[..], [EstimateWarning::Region(RegionWarning::Grey { .. })]), "{:?}", grey.warnings);
    let Shot { left, right } = common::render(&rig, Some(&start_pose()), Look::Colourful);
    let outside = Region::Rectangle { x: -20, y: 80, width: 200, height: 70 };
    let estimate =
        tracker.estimate(EstimateRequest::new_target(&left, &right, &outside, &range())).expect("images that fit");
    let warning = RegionWarning::PartlyOffImage { outside_px: 20 * 70, covered_px: 200 * 70 };
    assert_eq!(estimate.warnings, [EstimateWarning::Region(warning)]);
    assert_eq!(follow(&mut tracker, &rig, Some(&start_pose()), None).warnings, []);
}

#[test]
fn a_tracker_by_name_gives_the_same_track() {
    let rig = common::rectified_rig();
    let (mut tracker, first) = started(&rig, Look::Colourful);
    let method = Method::from_name("published").expect("a known name");
    let mut named = Tracker::new(method, &rig, &EstimatorConfig::default()).expect("a config");
    assert_eq!(named.method(), method);
    let Shot { left, right } = common::render(&rig, Some(&start_pose()), Look::Colourful);
    let region = Region::Polygon { vertices_px: common::outline_px(&rig, &start_pose()) };
    assert_eq!(named.estimate(EstimateRequest::new_target(&left, &right, &region, &range())), Ok(first));
    assert_eq!(
        named.estimate(EstimateRequest::next_frame(&left, &right, &FramePrior::default())),
        tracker.estimate(EstimateRequest::next_frame(&left, &right, &FramePrior::of_motion(None)))
    );
}

#[test]
fn the_same_frames_give_the_same_track() {
    let run = || {
        let rig = common::rectified_rig();
        let (mut tracker, first) = started(&rig, Look::Colourful);
        let target = common::target_at((-18.0, 9.0, 497.0), (-8.0, 13.0, 5.0));
        let second = follow(&mut tracker, &rig, Some(&target), None);
        (first, second)
    };
    assert_eq!(run(), run());
}
