//! Targets with a direction that no image shows: rings (the spin), stripes (a shift along them), one edge, a grid and a chessboard (a shift
//! by a period).
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use nalgebra::{Point3, Vector3};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::frames::{CamLeft, Model, Target};
use pb3dp_geometry::{Pose, so3};
use pb3dp_test_support::{scenes, sweep};

use crate::moving_plane::{plane, rectified_rig, region};
use crate::painted::{Paint, chessboard, edge, grid, pair, rings, stripes, texture};

const FPS: f64 = 30.0;
const FRAMES: u32 = 40;
/// The target turns about its normal and shifts in its plane.
fn moved(t: f64) -> Pose<CamLeft, Target> {
    let first: Pose<CamLeft, Target> =
        Pose::from_parts(Vector3::new(0.03, -0.01, 0.45), so3::exp(&Vector3::new(0.15, -0.2, 0.0)));
    first * Pose::from_parts(Vector3::new(0.004 * t, 0.012 * t, 0.0), so3::exp(&Vector3::new(0.0, 0.0, 0.15 * t)))
}

/// A tracked frame: the estimate, and the pose that the target would have with the model where the first frame put it.
struct Tracked {
    estimate: TrackEstimate,
    cam_left_from_model: Pose<CamLeft, Model>,
    truth: Pose<CamLeft, Model>,
}

/// Tracks a region of the painted target, its whole outline or a rectangle around its centre.
fn track(paint: Paint, half_px: Option<u32>) -> Vec<Tracked> {
    track_along(paint, half_px, FRAMES, moved)
}

fn track_along(
    paint: Paint,
    half_px: Option<u32>,
    frames: u32,
    moved: impl Fn(f64) -> Pose<CamLeft, Target>,
) -> Vec<Tracked> {
    let rig = rectified_rig();
    let mut tracker =
        DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).expect("tracker");
    let centre = rig.left().project(&moved(0.0).transform_point(&Point3::origin())).expect("in front");
    let marked = half_px.map_or_else(
        || region(&rig, &moved(0.0)),
        |half| Region::Rectangle {
            x: centre.x as i32 - half as i32,
            y: centre.y as i32 - half as i32,
            width: 2 * half,
            height: 2 * half,
        },
    );
    let mut target_from_model = None;
    let mut tracked = Vec::new();
    for frame in 0..frames {
        let truth = moved(f64::from(frame) / FPS);
        let (left, right) = pair(&rig, &truth, paint, frame);
        let prior = FramePrior { dt_s: Some(1.0 / FPS), ..FramePrior::default() };
        let estimate = match frame {
            0 => tracker.start_from_plane(&left, &right, &marked, &plane(&truth)).expect("start"),
            _ => tracker.estimate(EstimateRequest::next_frame(&left, &right, &prior)).expect("update"),
        };
        let Some(cam_left_from_model) = estimate.cam_left_from_model else { continue };
        let fixed = *target_from_model.get_or_insert(truth.inverse() * cam_left_from_model);
        tracked.push(Tracked { estimate, cam_left_from_model, truth: truth * fixed });
    }
    tracked
}

/// Names of the directions that some frame calls unobserved.
fn unobserved(tracked: &[Tracked]) -> [bool; 6] {
    std::array::from_fn(|axis| tracked.iter().any(|t| t.estimate.observed.is_some_and(|observed| !observed[axis])))
}

#[test]
fn a_texture_a_grid_and_a_chessboard_are_observed_in_all_directions() {
    // The sharp edges of a chessboard move by up to half a pixel between the samples of a pixel.
    for (name, paint, half_px, (most_mm, most_deg)) in [
        ("texture", texture as Paint, None, (0.05, 0.1)),
        ("grid", grid, Some(25), (0.05, 0.3)),
        ("chessboard", chessboard, Some(25), (1.0, 3.0)),
    ] {
        let tracked = track(paint, half_px);
        assert_eq!(tracked.len(), FRAMES as usize, "{name}");
        for Tracked { estimate, cam_left_from_model, truth } in &tracked {
            assert_eq!(
                (estimate.status, estimate.observed),
                (Status::Ok, Some([true; 6])),
                "{name}: {}",
                estimate.reason
            );
            let error = (truth.inverse() * *cam_left_from_model).log();
            assert!(1e3 * error.fixed_rows::<3>(0).norm() < most_mm, "{name}: {error}");
            assert!(error.fixed_rows::<3>(3).norm().to_degrees() < most_deg, "{name}: {error}");
        }
    }
}

#[test]
fn the_spin_of_rings_is_not_observed_and_stays() {
    for half_px in [None, Some(20)] {
        let tracked = track(rings, half_px);
        assert_eq!(tracked.len(), FRAMES as usize);
        for Tracked { estimate, cam_left_from_model, truth } in &tracked {
            assert_eq!(estimate.status, Status::PartlyObserved, "{}", estimate.reason);
            assert!(!estimate.rotation_about_normal_observed && estimate.reason.contains("about the normal"));
            let covariance = estimate.covariance.expect("covariance");
            assert!(covariance[(5, 5)].sqrt() > 0.5, "the spin may be any: {}", covariance[(5, 5)].sqrt());
            // The target spins; without images that show it the model keeps its spin.
            let (first, axes) = (tracked[0].cam_left_from_model, cam_left_from_model.rotation());
            let spin = (first.rotation().inverse() * axes).scaled_axis().z;
            assert!(spin.abs() < 1.5_f64.to_radians(), "spin {:.2} degrees", spin.to_degrees());
            // What is observed is right: the plane, and the centre of the rings.
            let tilt = (truth.rotation() * Vector3::z()).angle(&(axes * Vector3::z()));
            let apart_m = (truth.translation_m() - cam_left_from_model.translation_m()).norm();
            assert!(
                tilt < 1.5_f64.to_radians() && apart_m < 1.5e-3,
                "{:.2} degrees, {:.2} mm",
                tilt.to_degrees(),
                1e3 * apart_m
            );
        }
        assert_eq!(unobserved(&tracked), [false, false, false, false, false, true]);
    }
}

#[test]
fn stripes_and_an_edge_are_never_ok() {
    for (name, paint) in [("stripes", stripes as Paint), ("edge", edge)] {
        let tracked = track(paint, Some(25));
        assert!(!tracked.is_empty(), "{name}");
        for Tracked { estimate, cam_left_from_model, .. } in &tracked {
            assert_ne!(estimate.status, Status::Ok, "{name}: {}", estimate.reason);
            assert!(estimate.observed.is_some_and(|observed| !observed[1]), "{name}: {}", estimate.reason);
            // The pose does not run along the stripes.
            let moved = tracked[0].cam_left_from_model.inverse() * *cam_left_from_model;
            assert!(moved.translation_m().y.abs() < 5e-3, "{name}: {:.2} mm", 1e3 * moved.translation_m().y);
        }
    }
}

/// The target swings in all directions, and turns about its normal.
fn swinging(t: f64) -> Pose<CamLeft, Target> {
    let swing = |period_s: f64, size: f64| size * (std::f64::consts::TAU * t / period_s).sin();
    let tilt = so3::exp(&Vector3::new(0.15 + swing(5.3, 0.1), -0.2 + swing(4.1, 0.1), 0.0));
    let at = Vector3::new(0.03 + swing(6.1, 0.012), -0.01 + swing(4.7, 0.01), 0.45 + swing(7.3, 0.02));
    Pose::from_parts(at, tilt * so3::exp(&Vector3::new(0.0, 0.0, swing(3.7, 0.2))))
}

/// In a long sequence, too, no frame is `ok` that misses a direction, and a frame that is `ok` is right. `hidden`: the direction that the
/// target never shows.
fn check_long(name: &str, paint: Paint, half_px: Option<u32>, hidden: Option<usize>) {
    let frames = sweep(40, scenes(0, 250).count() as u32);
    let tracked = track_along(paint, half_px, frames, swinging);
    let is_ok = |t: &&Tracked| t.estimate.status == Status::Ok;
    let misses = |t: &&Tracked| hidden.is_some() || t.estimate.observed != Some([true; 6]);
    let is_off = |t: &&Tracked| {
        let error = (t.truth.inverse() * t.cam_left_from_model).log();
        1e3 * error.fixed_rows::<3>(0).norm() > 1.0 || error.fixed_rows::<3>(3).norm().to_degrees() > 2.0
    };
    let ok = tracked.iter().filter(is_ok).count();
    let wrong = tracked.iter().filter(is_ok).filter(|t| misses(t) || is_off(t)).count();
    let claims = |t: &&Tracked| hidden.is_some_and(|axis| t.estimate.observed.is_some_and(|observed| observed[axis]));
    let claimed = tracked.iter().filter(claims).count();
    println!(
        "{name}: {} of {frames} frames with a pose, {ok} ok, {wrong} of them wrong, {claimed} claim what is hidden",
        tracked.len()
    );
    assert_eq!((wrong, claimed), (0, 0), "{name}");
    assert!(hidden.is_some() || ok as u32 >= frames - frames / 20, "{name}: {ok} ok");
}

#[test]
fn no_frame_is_ok_whose_spin_is_hidden() {
    check_long("rings", rings, None, Some(5));
}

#[test]
fn no_frame_is_ok_whose_shift_along_stripes_is_hidden() {
    check_long("stripes", stripes, Some(25), Some(1));
}

#[test]
fn no_frame_of_a_grid_is_ok_and_off_by_a_period() {
    check_long("grid", grid, Some(25), None);
}
