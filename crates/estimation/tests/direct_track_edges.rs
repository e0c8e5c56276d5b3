//! Small rectangles across the edge of a disc that moves in front of a stationary disc: the tracker must follow one surface.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use nalgebra::{Isometry3, Point3, Vector3};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::Pose;

use crate::moving_plane::{RADIUS_M, Shot, moving, plane, rectified_rig, render_all};

/// Distance of the stationary disc behind the other one, and its lateral offset.
const BEHIND_M: f64 = 0.035;
const BESIDE_M: f64 = 0.06;
const FRAMES: u32 = 20;
const FPS: f64 = 15.0;

/// Number of confident and of wrong frames of a track from a rectangle around a pixel.
fn track(centre_px: [f64; 2], side_px: u32) -> (u32, u32) {
    let rig = rectified_rig();
    let mut tracker =
        DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).expect("tracker");
    let half = f64::from(side_px) / 2.0;
    let [x, y] = centre_px.map(|c| (c - half).round() as i32);
    let region = Region::Rectangle { x, y, width: side_px, height: side_px };
    let disc = |frame: u32| *moving(f64::from(frame) / FPS).isometry();
    let mut first: Option<Isometry3<f64>> = None;
    let (mut sure, mut wrong) = (0, 0);
    for frame in 0..FRAMES {
        let discs = [
            moving(f64::from(frame) / FPS),
            moving(0.0) * Pose::from_translation(Vector3::new(BESIDE_M, 0.0, BEHIND_M)),
        ];
        let (left, right) = render_all(&rig, &discs, &Shot { cam_left_from_target: None, frame, right_gain: 0.9 });
        let prior = FramePrior { dt_s: Some(1.0 / FPS), ..FramePrior::default() };
        let estimate = match frame {
            0 => tracker.start_from_plane(&left, &right, &region, &plane(&discs[0])).expect("start"),
            _ => tracker.estimate(EstimateRequest::next_frame(&left, &right, &prior)).expect("update"),
        };
        let Some(pose) = estimate.cam_left_from_model.map(|pose| *pose.isometry()) else { continue };
        if first.is_none() {
            // The origin is that of the region, also if only a part of it is followed.
            let px = rig.left().project(&Point3::from(pose.translation.vector)).expect("in front");
            let centroid_px = [x, y].map(|first| f64::from(first) + half - 0.5);
            assert!((px - nalgebra::Vector2::from(centroid_px)).norm() < 0.01, "{px} instead of {centroid_px:?}");
        }
        let first = *first.get_or_insert(pose);
        if estimate.status != Status::Ok {
            continue;
        }
        sure += 1;
        let motion = pose * first.inverse();
        let origin = Point3::from(first.translation.vector);
        // The surface moves with the disc, or it is stationary.
        let is_right = [disc(frame) * disc(0).inverse(), Isometry3::identity()].iter().any(|truth| {
            let way_m = (motion * origin - truth * origin).norm();
            let turn_deg = motion.rotation.angle_to(&truth.rotation).to_degrees();
            way_m <= 0.015 * origin.z && turn_deg <= 5.0
        });
        wrong += u32::from(!is_right);
    }
    (sure, wrong)
}

#[test]
fn a_rectangle_across_a_depth_edge_is_tracked_as_one_surface() {
    let rig = rectified_rig();
    let (mut sure, mut wrong) = (0, Vec::new());
    for step in 0..9_u32 {
        let angle = std::f64::consts::TAU * (f64::from(step) - 4.0) / 40.0;
        let edge = Point3::new(RADIUS_M * angle.cos(), RADIUS_M * angle.sin(), 0.0);
        let px = rig.left().project(&moving(0.0).transform_point(&edge)).expect("in front");
        let side_px = [56, 68, 80][step as usize % 3];
        let (own_sure, own_wrong) = track([px.x, px.y], side_px);
        sure += own_sure;
        if own_wrong > 0 {
            wrong.push((step, side_px, own_wrong));
        }
    }
    println!("{sure} sure frames; wrong (step, side, frames): {wrong:?}");
    assert!(wrong.is_empty(), "confident but wrong frames (position, side, frames): {wrong:?}");
    assert!(sure >= 100, "only {sure} confident frames of {}", 9 * FRAMES);
}
