//! False claims that the published tracker must not make: rivals in depth, regions that cannot be re-centred, targets without
//! hue.

#![allow(clippy::expect_used)]

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_published::estimator::{PublishedConfig, PublishedTracker, TrackerConfig};
use pb3dp_estimation_published::photo_model::PhotoModelConfig;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, StereoRig};

use crate::common::{self, Look, Shot};

/// In these tests: number of frames without a confident pose after which the target is dropped.
const ASSURE_FRAMES_MAX: u32 = 4;

/// Backdrop rows above and below the target that belong to the region with two depths.
const BACKDROP_ROWS: u32 = 27;

fn range() -> SearchRange {
    SearchRange::new(0.35, 0.90, 45.0_f64.to_radians()).expect("a range")
}

fn tracker(rig: &StereoRig, outer_points: u32) -> PublishedTracker {
    let tracker = TrackerConfig { assure_frames_max: ASSURE_FRAMES_MAX, ..TrackerConfig::default() };
    let model = PhotoModelConfig { inner_points: 600, outer_points, ..PhotoModelConfig::default() };
    PublishedTracker::new(rig, PublishedConfig { tracker, model, ..PublishedConfig::default() }).expect("a config")
}

/// Pose of the target in frame `k`; it drifts slowly.
fn pose(k: u32) -> Pose<CamLeft, Model> {
    let k = f64::from(k);
    common::target_at((-20.0 + 1.5 * k, 8.0 - k, 495.0 + k), (-4.0, 6.0 - 0.5 * k, 5.0))
}

fn outline(rig: &StereoRig, target: &Pose<CamLeft, Model>) -> Region {
    Region::Polygon { vertices_px: common::outline_px(rig, target) }
}

fn start(tracker: &mut PublishedTracker, rig: &StereoRig, look: Look, region: &Region) -> TrackEstimate {
    let Shot { left, right } = common::render(rig, Some(&pose(0)), look);
    tracker.estimate(EstimateRequest::new_target(&left, &right, region, &range())).expect("images that fit")
}

fn update(
    tracker: &mut PublishedTracker,
    rig: &StereoRig,
    target: Option<&Pose<CamLeft, Model>>,
    look: Look,
) -> TrackEstimate {
    let Shot { left, right } = common::render(rig, target, look);
    tracker.estimate(EstimateRequest::next_frame(&left, &right, &FramePrior::of_motion(None))).expect("images that fit")
}

/// Checks that the tracker has dropped the target and does not accept it again.
#[track_caller]
fn check_given_up(tracker: &mut PublishedTracker, rig: &StereoRig, look: Look) {
    for k in 0..3 {
        let estimate = update(tracker, rig, Some(&pose(ASSURE_FRAMES_MAX + k)), look);
        assert_eq!((estimate.status, estimate.cam_left_from_model), (Status::Lost, None), "{estimate:?}");
        assert!(estimate.reason.contains("mark it again"), "{}", estimate.reason);
        assert!(estimate.reason.contains(&format!("{ASSURE_FRAMES_MAX} frames")), "{}", estimate.reason);
    }
}

/// The target with so much backdrop above and below that each plane explains about half of the region.
fn both_layers(rig: &StereoRig) -> Region {
    let corners = common::outline_px(rig, &pose(0));
    let (first, last) =
        corners.iter().fold((corners[0], corners[0]), |(first, last), corner| (first.inf(corner), last.sup(corner)));
    let (width, height) = ((last.x - first.x) as u32, (last.y - first.y) as u32 + 2 * BACKDROP_ROWS);
    Region::Rectangle { x: first.x as i32, y: first.y as i32 - BACKDROP_ROWS as i32, width, height }
}

#[test]
fn a_target_with_a_rival_depth_is_never_sure_and_is_given_up() {
    let rig = common::rectified_rig();
    // The band around the region would favour the backdrop alone.
    let mut tracker = tracker(&rig, 0);
    let first = start(&mut tracker, &rig, Look::TwoLayers, &both_layers(&rig));
    assert_eq!(first.status, Status::Ambiguous, "{first:?}");
    assert!(first.reason.contains("another depth"), "{}", first.reason);
    for k in 1..=ASSURE_FRAMES_MAX {
        let estimate = update(&mut tracker, &rig, Some(&pose(k)), Look::TwoLayers);
        assert!(matches!(estimate.status, Status::Ambiguous | Status::NotObservable), "{k}: {estimate:?}");
        assert!(estimate.fitness.is_some(), "still searched: {estimate:?}");
    }
    check_given_up(&mut tracker, &rig, Look::TwoLayers);
}

#[test]
fn a_region_that_can_not_be_recentred_is_never_sure_after_the_first_frame() {
    let rig = common::rectified_rig();
    let centre = common::outline_px(&rig, &pose(0)).iter().sum::<nalgebra::Vector2<f64>>() / 6.0;
    let (x, y) = (centre.x as i32 - 25, centre.y as i32 - 22);
    let inside = Region::Rectangle { x, y, width: 46, height: 40 };
    let mut tracker = tracker(&rig, 400);
    let first = start(&mut tracker, &rig, Look::Speckled, &inside);
    assert!(first.status.depth_is_sure(), "a single pair needs no re-centring: {first:?}");
    for k in 1..=2 * ASSURE_FRAMES_MAX {
        let estimate = update(&mut tracker, &rig, Some(&pose(k)), Look::Speckled);
        assert_eq!(estimate.status, Status::Ambiguous, "{k}: {estimate:?}");
        assert!(estimate.reason.contains("cannot be re-centred"), "{}", estimate.reason);
    }
}

#[test]
fn a_grey_target_is_given_up_until_it_is_marked_again() {
    let rig = common::general_rig();
    let region = outline(&rig, &pose(0));
    let mut tracker = tracker(&rig, 400);
    assert_eq!(start(&mut tracker, &rig, Look::Grey, &region).status, Status::NotObservable);
    for k in 1..=ASSURE_FRAMES_MAX {
        let estimate = update(&mut tracker, &rig, Some(&pose(k)), Look::Grey);
        assert_eq!((estimate.status, estimate.cam_left_from_model), (Status::NotObservable, None), "{estimate:?}");
    }
    // A coloured target is rejected from here on as well, because the region may show something else by now.
    check_given_up(&mut tracker, &rig, Look::Colourful);
    let again = start(&mut tracker, &rig, Look::Colourful, &region);
    assert!(again.status.depth_is_sure(), "{again:?}");
    let estimate = update(&mut tracker, &rig, Some(&pose(1)), Look::Colourful);
    assert!(estimate.status.depth_is_sure(), "{estimate:?}");
}

#[test]
fn a_target_found_again_at_another_depth_keeps_its_model_frame() {
    let rig = common::rectified_rig();
    let mut tracker = tracker(&rig, 400);
    let first = start(&mut tracker, &rig, Look::Colourful, &outline(&rig, &pose(0)));
    let in_target = |target: &Pose<CamLeft, Model>, estimate: &TrackEstimate| {
        target.inverse() * estimate.cam_left_from_model.expect("a pose")
    };
    let first_in_target = in_target(&pose(0), &first);
    // The camera rotates by 20 degrees about its axis: the model's x axis is no longer the image's.
    let motion: Pose<CamLeft, CamLeft> =
        Pose::from_parts(Vector3::new(0.004, -0.003, 0.002), UnitQuaternion::from_euler_angles(0.0, 0.01, 0.35));
    let turned = motion.inverse() * pose(0);
    let Shot { left, right } = common::render(&rig, Some(&turned), Look::Colourful);
    let estimate = tracker
        .estimate(EstimateRequest::next_frame(&left, &right, &FramePrior::of_motion(Some(&motion))))
        .expect("images that fit");
    assert!(estimate.status.depth_is_sure(), "{estimate:?}");
    for _ in 0..2 {
        assert_eq!(update(&mut tracker, &rig, None, Look::Colourful).status, Status::Lost);
    }
    // A fifth farther away with another tilt; there is no rotation about its normal.
    let tilt = UnitQuaternion::from_euler_angles(0.1, -0.12, 0.0);
    let back: Pose<CamLeft, Model> = Pose::from_parts(Vector3::new(0.004, -0.006, 0.590), tilt * turned.rotation());
    for _ in 0..3 {
        let estimate = update(&mut tracker, &rig, Some(&back), Look::Colourful);
        assert_ne!(estimate.status, Status::Lost, "{estimate:?}");
        let found_in_target = in_target(&back, &estimate);
        let strayed_m = found_in_target.translation_m() - first_in_target.translation_m();
        assert!(strayed_m.norm() < 0.010, "the origin has drifted by {strayed_m} m: {estimate:?}");
        let [x_first, x] = [first_in_target, found_in_target].map(|pose| pose.transform_vector(&Vector3::x()));
        assert!(common::angle_deg(&x_first, &x) < 6.0, "{estimate:?}");
    }
}
