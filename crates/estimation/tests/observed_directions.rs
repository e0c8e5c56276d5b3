//! Targets with a direction that no image shows: rings (the spin), stripes (a shift along them), one edge, a grid and a chessboard (a shift
//! by a period).
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use image::{Rgb, RgbImage};
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::frames::{CamLeft, Model, Target};
use pb3dp_geometry::{Camera, Pose, StereoRig, so3};

use crate::moving_plane::{RADIUS_M, SIZE, noise, plane, rectified_rig, region};

const FPS: f64 = 30.0;
const FRAMES: u32 = 40;
/// Noise of a channel, grey levels.
const NOISE: f64 = 1.5;
/// Samples of a pixel in a row and in a column: what a sensor integrates.
const SAMPLES: u32 = 4;

/// Grey level at a point of the target, metres; `None`: the wall behind.
type Paint = fn(f64, f64) -> Option<f64>;

fn image(
    camera: &Camera,
    cam_from_left: &Isometry3<f64>,
    pose: &Pose<CamLeft, Target>,
    paint: Paint,
    stream: u32,
) -> RgbImage {
    let left_from_cam = cam_from_left.inverse();
    let to_target = pose.inverse().isometry() * left_from_cam;
    let origin = to_target * Point3::origin();
    RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
        let mut sum = 0.0;
        for sample in 0..SAMPLES * SAMPLES {
            let [x, y] = [(u, sample % SAMPLES), (v, sample / SAMPLES)]
                .map(|(px, part)| f64::from(px) + (f64::from(part) + 0.5) / f64::from(SAMPLES) - 0.5);
            let ray = to_target * camera.unproject(&Vector2::new(x, y)).expect("ray");
            let at = origin - ray * (origin.z / ray.z);
            sum += paint(at.x, at.y).unwrap_or(60.0);
        }
        let grey = sum / f64::from(SAMPLES * SAMPLES);
        Rgb(std::array::from_fn(|c| {
            (grey + NOISE * noise(u, v, stream * 3 + c as u32)).round().clamp(0.0, 255.0) as u8
        }))
    })
}

fn pair(rig: &StereoRig, pose: &Pose<CamLeft, Target>, paint: Paint, frame: u32) -> (RgbImage, RgbImage) {
    let left = image(rig.left(), &Isometry3::identity(), pose, paint, 2 * frame);
    let right = image(rig.right(), rig.cam_right_from_cam_left().isometry(), pose, paint, 2 * frame + 1);
    (left, right)
}

fn wave(at: f64, period_m: f64) -> f64 {
    (std::f64::consts::TAU * at / period_m).sin()
}

fn rings(x: f64, y: f64) -> Option<f64> {
    let r = x.hypot(y);
    (r < RADIUS_M).then(|| 128.0 + 45.0 * wave(r, 0.017) + 40.0 * wave(r + 0.003, 0.029))
}

fn stripes(x: f64, _: f64) -> Option<f64> {
    Some(128.0 + 45.0 * wave(x, 0.017) + 40.0 * wave(x + 0.003, 0.029))
}

fn texture(x: f64, y: f64) -> Option<f64> {
    let (a, b) = (wave(x + 0.4 * y, 0.017), wave(y - 0.3 * x, 0.021));
    (x.hypot(y) < RADIUS_M).then(|| 128.0 + 40.0 * a + 40.0 * b + 20.0 * wave(x - y, 0.031))
}

fn chessboard(x: f64, y: f64) -> Option<f64> {
    let field = |at: f64| (at / 0.012).floor() as i64;
    Some(if (field(x) + field(y)).rem_euclid(2) == 0 { 60.0 } else { 200.0 })
}

fn grid(x: f64, y: f64) -> Option<f64> {
    Some(128.0 + 40.0 * wave(x, 0.015) + 40.0 * wave(y, 0.015))
}

fn edge(x: f64, _: f64) -> Option<f64> {
    Some(if x < 0.004 { 70.0 } else { 190.0 })
}

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
    for frame in 0..FRAMES {
        let truth = moved(f64::from(frame) / FPS);
        let (left, right) = pair(&rig, &truth, paint, frame);
        let prior = FramePrior { dt_s: Some(1.0 / FPS), ..FramePrior::default() };
        let estimate = match frame {
            0 => tracker.start_from_plane(&left, &right, &marked, &plane(&truth)).expect("start"),
            _ => tracker.estimate(EstimateRequest::of_next(&left, &right, &prior)).expect("update"),
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
