//! Cameras that do not expose at once: the target moves between the two exposures of a pair.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use nalgebra::{Point3, Vector3};
use pb3dp_estimation::estimator::{EstimatorConfig, Method, Tracker};
use pb3dp_estimation::skew_watch::{Skew, SkewWatch};
use pb3dp_estimation_core::estimate::{EstimateWarning, TrackEstimate};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Pose, StereoRig};

use crate::moving_plane::{general_rig, moving, rectified_rig, region, render_skewed};
use crate::painted;

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
        let (left, right) = render_skewed(&rig, [moving(t_s), moving(t_s + skew_s)], frame);
        let prior = FramePrior { dt_s: Some(1.0 / FPS), ..FramePrior::of_skew(known_s) };
        let region = region(&rig, &moving(t_s));
        let mut request = match frame {
            0 => EstimateRequest::new_target(&left, &right, &region, &range).with_skew(known_s),
            _ => EstimateRequest::next_frame(&left, &right, &prior),
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

/// Grey waves on a disc of 60 mm, none a multiple of another.
fn paint(x: f64, y: f64) -> Option<f64> {
    let wave = |a: f64, b: f64, phase: f64| (a * x + b * y + phase).sin();
    (x * x + y * y < 0.06 * 0.06).then(|| {
        118.0 + 26.0 * wave(190.0, 230.0, 0.3) + 26.0 * wave(-310.0, 170.0, 1.1) + 22.0 * wave(420.0, -250.0, 0.7)
    })
}

/// Follows a target that moves by up to 120 mm/s, up and down as well. `taken_by`: the rig that took the images, which is stated to be
/// `rectified_rig`; `stated_s`: the skew that is stated.
fn follow(taken_by: &StereoRig, skew_s: f64, stated_s: f64) -> (Tracker, Vec<TrackEstimate>) {
    let at = |t_s: f64| -> Pose<CamLeft, Target> {
        let turn = pb3dp_geometry::so3::exp(&Vector3::new(0.12, -0.2, 0.05 + 0.1 * t_s));
        let swing = |size: f64, period_s: f64| size * (std::f64::consts::TAU * t_s / period_s).sin();
        Pose::from_parts(Vector3::new(0.03 + swing(0.012, 0.9), swing(0.014, 0.7), 0.45), turn)
    };
    let mut tracker = Tracker::new(Method::Direct, &rectified_rig(), &EstimatorConfig::default()).expect("tracker");
    if stated_s == 0.0 { tracker.watch_skew(true) } else { tracker.check_skew() }.expect("a rig");
    let range = SearchRange { z_min_m: 0.3, z_max_m: 0.7, tilt_max_rad: 0.8 };
    let estimates = (0..FRAMES).map(|frame| {
        let t_s = f64::from(frame) / FPS;
        let (left, right) = painted::skewed_pair(taken_by, [&at(t_s), &at(t_s + skew_s)], paint, frame);
        let centre = taken_by.left().project(&Point3::from(at(t_s).translation_m())).expect("in front");
        let [x, y] = [centre.x, centre.y].map(|px| px as i32 - 36);
        let region = Region::Rectangle { x, y, width: 72, height: 72 };
        let prior = FramePrior { dt_s: Some(1.0 / FPS), ..FramePrior::of_skew(stated_s) };
        let request = match frame {
            0 => EstimateRequest::new_target(&left, &right, &region, &range).with_skew(stated_s),
            _ => EstimateRequest::next_frame(&left, &right, &prior),
        };
        tracker.estimate(request).expect("valid images")
    });
    let estimates = estimates.collect();
    (tracker, estimates)
}

fn has_warning(estimate: &TrackEstimate, is_it: fn(&EstimateWarning) -> bool) -> bool {
    estimate.warnings.iter().any(is_it)
}

fn is_doubt(warning: &EstimateWarning) -> bool {
    matches!(warning, EstimateWarning::SkewUnknown { .. })
}

fn is_finding(warning: &EstimateWarning) -> bool {
    matches!(warning, EstimateWarning::Skewed { .. })
}

#[test]
fn a_skew_that_nobody_has_stated_is_found_in_the_rows() {
    for skew_s in [8e-3, -8e-3, 0.0] {
        let (tracker, estimates) = follow(&rectified_rig(), skew_s, 0.0);
        let Skew { skew_s: found_s, sigma_s } = tracker.skew().and_then(SkewWatch::skew).expect("a skew");
        assert!((found_s - skew_s).abs() < 1e-3 && sigma_s < 2e-3, "{skew_s} s: {found_s} +- {sigma_s}");
        // Before it is determined, every pair says what it may cost.
        let doubts: Vec<bool> = estimates.iter().map(|estimate| has_warning(estimate, is_doubt)).collect();
        let known_from = doubts.iter().rposition(|is_doubt| *is_doubt).map_or(0, |last| last + 1);
        assert!((2..10).contains(&known_from) && doubts[2..known_from].iter().all(|is_doubt| *is_doubt), "{doubts:?}");
        let is_reported = estimates[known_from..].iter().any(|estimate| has_warning(estimate, is_finding));
        assert_eq!(is_reported, skew_s != 0.0, "{skew_s} s");
    }
}

/// A sign is easily wrong.
#[test]
fn a_stated_skew_that_the_motion_contradicts_is_named() {
    for (stated_s, contradicts) in [(-1.5e-3, true), (8e-3, false)] {
        let (tracker, estimates) = follow(&rectified_rig(), 8e-3, stated_s);
        let found_skew = tracker.skew().and_then(SkewWatch::skew);
        let mut warnings = estimates.iter().flat_map(|estimate| &estimate.warnings);
        let is_reported = warnings.any(|warning| matches!(warning, EstimateWarning::SkewContradicted { .. }));
        assert_eq!(is_reported, contradicts, "{stated_s}: {found_skew:?}");
    }
}

/// The rows of the whole image belong to two moments; those of the target, whose motion is known, show the rig.
#[test]
fn a_wrong_rig_is_named_beside_a_skew() {
    let rig = rectified_rig();
    let rolled = |deg: f64| {
        let turn =
            Pose::from_parts(Vector3::zeros(), pb3dp_geometry::so3::exp(&Vector3::new(0.0, 0.0, deg.to_radians())));
        StereoRig::new(*rig.left(), *rig.right(), turn * *rig.cam_right_from_cam_left()).expect("a rig")
    };
    for (stated_s, deg) in [(20e-3, 1.0), (-20e-3, -1.0), (0.0, 1.0)] {
        let (_, estimates) = follow(&rolled(deg), if stated_s == 0.0 { 12e-3 } else { stated_s }, stated_s);
        let TrackEstimate { status, reason, .. } = estimates.last().expect("frames");
        assert_eq!(*status, Status::Miscalibrated, "{stated_s} s, {deg} degrees: {reason}");
    }
    let (tracker, estimates) = follow(&rig, 20e-3, 20e-3);
    assert!(tracker.watch().errors().is_some_and(|errors| errors.errors.norm() < 1e-3), "{:?}", tracker.watch());
    assert!(estimates.iter().all(|estimate| estimate.status == Status::Ok && estimate.warnings.is_empty()));
}

/// Turn of a target that is at rest and then moves along the rows without turning, in degrees, and its standard deviation; seen by cameras that
/// read their rows one after the other, in strips of images at their moments.
fn turn_deg(stated_millis: f64) -> [f64; 2] {
    const READOUT_S: f64 = 0.02;
    const STRIPS: u32 = 8;
    let rig = rectified_rig();
    let at = |t_s: f64| -> Pose<CamLeft, Target> {
        let turn = pb3dp_geometry::so3::exp(&Vector3::new(0.12, -0.2, 0.05));
        Pose::from_parts(Vector3::new(0.02 + 0.15 * (t_s - 1.5 / FPS).max(0.0), -0.01, 0.45), turn)
    };
    let shot = |t_s: f64, frame: u32| {
        let (mut left, mut right) = painted::pair(&rig, &at(t_s), paint, frame);
        let rows = left.height() / STRIPS;
        for strip in 0..STRIPS {
            let read_s = READOUT_S * ((f64::from(strip) + 0.5) / f64::from(STRIPS) - 0.5);
            let (from_left, from_right) = painted::pair(&rig, &at(t_s + read_s), paint, frame);
            for (whole, from) in [(&mut left, &from_left), (&mut right, &from_right)] {
                let part = image::imageops::crop_imm(from, 0, strip * rows, from.width(), rows).to_image();
                image::imageops::replace(whole, &part, 0, i64::from(strip * rows));
            }
        }
        (left, right)
    };
    let mut config = EstimatorConfig::default();
    config.track.rolling_shutter_millis = stated_millis;
    let mut tracker = Tracker::new(Method::Direct, &rig, &config).expect("tracker");
    let range = SearchRange { z_min_m: 0.3, z_max_m: 0.7, tilt_max_rad: 0.8 };
    let region = region(&rig, &at(0.0));
    let prior = FramePrior { dt_s: Some(1.0 / FPS), ..FramePrior::default() };
    let estimates: Vec<TrackEstimate> = (0..5)
        .map(|frame| {
            let (left, right) = shot(f64::from(frame) / FPS, frame);
            let request = match frame {
                0 => EstimateRequest::new_target(&left, &right, &region, &range),
                _ => EstimateRequest::next_frame(&left, &right, &prior),
            };
            tracker.estimate(request).expect("valid images")
        })
        .collect();
    let pose = |index: usize| estimates[index].cam_left_from_model.expect("a pose");
    let turned = (pose(0).inverse() * pose(4)).rotation_angle_rad();
    let covariance = estimates[4].covariance.expect("a covariance");
    [turned, covariance.fixed_view::<3, 3>(3, 3).trace().sqrt()].map(f64::to_degrees)
}

#[test]
fn the_shear_of_a_rolling_shutter_is_in_the_covariance() {
    let ([turned, unstated], [again, sigma]) = (turn_deg(0.0), turn_deg(20.0));
    assert!((turned - again).abs() < 1e-9 && turned > 3.0 * unstated, "{turned} +- {unstated} degrees, {again}");
    assert!(turned < 3.0 * sigma && sigma < 2.0, "{turned} +- {sigma} degrees");
}
