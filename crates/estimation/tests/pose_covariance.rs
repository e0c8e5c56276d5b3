//! The two covariances of a pose: of the first one, which defines `model`, and since then.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use nalgebra::Matrix6;
use pb3dp_estimation::calibration_term::CalibrationTerm;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method, Tracker};
use pb3dp_estimation_core::estimate::{SurfaceEstimate, TrackEstimate};
use pb3dp_estimation_core::method::{EstimateRequest, FramePrior, KnownModel};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::Pose;

use crate::moving_plane::{Shot, general_rig, moving, region, render, render_skewed};

const FPS: f64 = 30.0;
const FRAMES: u32 = 5;

/// A target that was followed to the last frame, marked there again after another one, and followed to the next frame, beside the same target
/// that was never left.
#[test]
fn a_target_that_is_marked_again_has_its_model_from_before() {
    let rig = general_rig();
    let range = SearchRange { z_min_m: 0.3, z_max_m: 0.7, tilt_max_rad: 0.8 };
    let images = |frame: u32| {
        let t_s = f64::from(frame) / FPS;
        render(&rig, &Shot { cam_left_from_target: Some(moving(t_s)), frame, right_gain: 1.0 })
    };
    let prior = FramePrior { dt_s: Some(1.0 / FPS), ..FramePrior::default() };
    let mut tracker = Tracker::new(Method::Direct, &rig, &EstimatorConfig::default()).expect("tracker");
    let mut estimate = |frame: u32, marked: Option<(&Region, Option<&KnownModel>)>| {
        let (left, right) = images(frame);
        tracker
            .estimate(match marked {
                Some((region, model)) => EstimateRequest::new_target(&left, &right, region, &range).with_model(model),
                None => EstimateRequest::next_frame(&left, &right, &prior),
            })
            .expect("valid images")
    };
    let first = estimate(0, Some((&region(&rig, &moving(0.0)), None)));
    let estimates: Vec<TrackEstimate> = (1..=8).map(|frame| estimate(frame, None)).collect();
    let known = KnownModel {
        cam_left_from_model: estimates[6].cam_left_from_model.expect("a pose"),
        first_pose_covariance: first.first_pose_covariance.expect("a covariance"),
    };
    // A part of the target: its own model would have another origin.
    let Region::Polygon { mut vertices_px } = region(&rig, &moving(7.0 / FPS)) else { panic!("a polygon") };
    let middle = vertices_px.iter().sum::<nalgebra::Vector2<f64>>() / vertices_px.len() as f64;
    vertices_px.iter_mut().for_each(|vertex| *vertex += (middle - *vertex) * 0.25 + nalgebra::Vector2::new(6.0, 4.0));
    let part = Region::Polygon { vertices_px };
    let anew = estimate(7, Some((&part, None))).cam_left_from_model.expect("a pose");
    assert!((anew.translation_m() - known.cam_left_from_model.translation_m()).norm() > 2e-3, "{anew:?}");
    let again = estimate(7, Some((&part, Some(&known))));
    assert_eq!(again.cam_left_from_model, Some(known.cam_left_from_model));
    assert_eq!(again.first_pose_covariance, Some(known.first_pose_covariance));
    let next = estimate(8, None);
    let [one, other] = [&next, &estimates[7]].map(|estimate| estimate.cam_left_from_model.expect("a pose"));
    let apart = one.inverse() * other;
    assert!(apart.translation_m().norm() < 2e-4 && apart.rotation_angle_rad() < 4e-3, "{apart:?}");
    assert_eq!(next.first_pose_covariance, Some(known.first_pose_covariance));
    // Another object at another distance is not the target of before.
    let far = KnownModel {
        cam_left_from_model: Pose::from_parts(
            known.cam_left_from_model.translation_m() * 1.3,
            known.cam_left_from_model.rotation(),
        ),
        ..known
    };
    let other = estimate(7, Some((&part, Some(&far))));
    assert!(other.cam_left_from_model.is_none() && other.reason.contains("another surface"), "{}", other.reason);
}

/// What real surfaces do to a plane is in the covariance of a single pair, and so in that of the first pair of a track.
#[test]
fn the_first_pose_is_no_more_certain_than_the_plane_that_defines_it() {
    let rig = general_rig();
    let range = SearchRange { z_min_m: 0.3, z_max_m: 0.7, tilt_max_rad: 0.8 };
    let shot = Shot { cam_left_from_target: Some(moving(0.0)), frame: 0, right_gain: 1.0 };
    let ((left, right), region) = (render(&rig, &shot), region(&rig, &moving(0.0)));
    let request = || EstimateRequest::new_target(&left, &right, &region, &range);
    let mut estimator = Estimator::new(Method::Direct, &rig, &EstimatorConfig::default()).expect("estimator");
    let alone = estimator.estimate(request()).expect("valid images").plane_covariance.expect("a covariance");
    let mut tracker = Tracker::new(Method::Direct, &rig, &EstimatorConfig::default()).expect("tracker");
    let tracked = tracker.estimate(request()).expect("valid images").first_pose_covariance.expect("a covariance");
    for (own, of_plane) in [(2, 0), (3, 1), (4, 2)] {
        let ratio = (tracked[(own, own)] / alone[(of_plane, of_plane)]).sqrt();
        assert!(ratio > 0.99, "{ratio}");
    }
}

/// Frames of a target that moves in six directions, whose right image is exposed later by a skew that is known.
fn tracked(term: Option<CalibrationTerm>, skew_s: f64) -> Vec<TrackEstimate> {
    let rig = general_rig();
    let tracker = Tracker::new(Method::Direct, &rig, &EstimatorConfig::default()).expect("tracker");
    let mut tracker = tracker.with_calibration(term);
    let range = SearchRange { z_min_m: 0.3, z_max_m: 0.7, tilt_max_rad: 0.8 };
    let follow = |frame: u32| {
        let t_s = f64::from(frame) / FPS;
        let (left, right) = render_skewed(&rig, [moving(t_s), moving(t_s + skew_s)], frame);
        let prior = FramePrior { dt_s: Some(1.0 / FPS), ..FramePrior::of_skew(skew_s) };
        let region = region(&rig, &moving(t_s));
        tracker
            .estimate(match frame {
                0 => EstimateRequest::new_target(&left, &right, &region, &range).with_skew(skew_s),
                _ => EstimateRequest::next_frame(&left, &right, &prior),
            })
            .expect("valid images")
    };
    (0..FRAMES).map(follow).collect()
}

fn far(one: &Matrix6<f64>, other: &Matrix6<f64>) -> f64 {
    (one - other).norm() / other.norm()
}

#[test]
fn every_frame_has_the_error_of_the_first_pose_and_the_sum() {
    let frames = tracked(None, 0.0);
    let first = frames[0].covariance.expect("a covariance");
    assert_eq!(frames[0].surface.map(|known| (known.covariance, known.version)), Some((first, 0)));
    assert_eq!((frames[0].first_pose_covariance, frames[0].pose_covariance), (Some(first), Some(first)));
    for later in &frames[1..] {
        let own = later.covariance.expect("a covariance");
        assert_eq!(later.first_pose_covariance, Some(first));
        assert_eq!(later.pose_covariance, Some(first + own));
        assert_eq!(later.calibration, None);
        let first_deg = (first[(3, 3)] + first[(4, 4)]).sqrt().to_degrees();
        let says = later.reason.contains(&format!("that of the first pair is {first_deg:.2} degrees"));
        assert_eq!(says, own[(3, 3)] + own[(4, 4)] < first[(3, 3)] + first[(4, 4)], "{}", later.reason);
        let plane = SurfaceEstimate { surface_from_model: Pose::coincident(), covariance: first, version: 0 };
        assert_eq!(later.surface, Some(plane), "of a plane, later pairs show nothing else");
    }
}

#[test]
fn the_calibration_is_in_the_first_pose_and_in_the_sum() {
    let names = ["left.fx".to_owned(), "cam_right_from_cam_left.ry_rad".to_owned()];
    let rows = [vec![4.0, 1e-4], vec![1e-4, 1e-6]];
    let term = CalibrationTerm::new(&general_rig(), &names, &rows).expect("a term");
    let (exact, uncertain) = (tracked(None, 0.0), tracked(Some(term), 0.0));
    let share_of_first = uncertain[0].calibration.expect("a share").pose;
    for (exact, uncertain) in exact.iter().zip(&uncertain) {
        let same = |estimate: &TrackEstimate| (estimate.cam_left_from_model, estimate.covariance);
        assert_eq!(same(exact), same(uncertain));
        let share = uncertain.calibration.expect("a share").pose;
        for (known, without, share) in [
            (uncertain.pose_covariance, exact.pose_covariance, share),
            (uncertain.first_pose_covariance, exact.first_pose_covariance, share_of_first),
        ] {
            let [known, without] = [known, without].map(|covariance| covariance.expect("a covariance"));
            assert!(far(&known, &(without + share)) < 1e-9, "{known} {without} {share}");
            // 2 px of 700: 1.4 mm of half a metre.
            assert!(share[(2, 2)] > 100.0 * without[(2, 2)], "{share} {without}");
        }
    }
}

/// The first pair does not show the motion between its exposures, and the second one does.
#[test]
fn the_second_frame_makes_the_first_pose_of_a_moving_target_surer() {
    let depth_mm = |covariance: Option<Matrix6<f64>>| 1e3 * covariance.expect("a covariance")[(2, 2)].sqrt();
    let frames = tracked(None, 5e-3);
    let [at_first, since] = [0, 1].map(|frame| depth_mm(frames[frame].first_pose_covariance));
    assert!(at_first > 1.0 && since < 0.3 * at_first, "{at_first} {since}");
    for later in &frames[1..] {
        let [first, whole, own] = [later.first_pose_covariance, later.pose_covariance, later.covariance].map(depth_mm);
        assert!((first - since).abs() < 1e-9 && (whole - first.hypot(own)).abs() < 1e-9, "{first} {whole} {own}");
    }
}
