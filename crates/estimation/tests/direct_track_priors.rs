//! Priors that cannot be true: they must not cost the target.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Pose, so3};

use crate::moving_plane::{Shot, moving, plane, rectified_rig, region, render};

const FPS: f64 = 30.0;

fn camera_moved(shift_m: f64, turn_rad: f64) -> FramePrior {
    let turn = so3::exp(&Vector3::new(0.0, turn_rad, 0.0));
    let motion: Pose<CamLeft, CamLeft> = Pose::from_parts(Vector3::new(0.1 * shift_m, shift_m, 0.0), turn);
    FramePrior { cam_left_prev_from_cam_left_now: Some(motion), ..FramePrior::default() }
}

fn target_at(z_m: f64) -> FramePrior {
    let pose: Pose<CamLeft, Model> = Pose::from_parts(Vector3::new(0.01, 0.02, z_m), UnitQuaternion::identity());
    FramePrior { cam_left_from_model: Some(pose), ..FramePrior::default() }
}

fn after(dt_s: f64) -> FramePrior {
    FramePrior { dt_s: Some(dt_s), ..FramePrior::default() }
}

#[test]
fn a_prior_that_cannot_be_true_costs_at_most_its_frame() {
    let absurd = [
        ("NaN shift", camera_moved(f64::NAN, 0.0)),
        ("NaN turn", camera_moved(0.0, f64::NAN)),
        ("a far shift", camera_moved(1e12, 0.0)),
        ("an infinite shift", camera_moved(f64::INFINITY, 0.0)),
        ("a turn to the back", camera_moved(0.0, 3.0)),
        ("behind the camera", target_at(-0.4)),
        ("at the horizon", target_at(1e9)),
        ("NaN pose", target_at(f64::NAN)),
        ("NaN interval", after(f64::NAN)),
        ("an endless interval", after(1e300)),
        ("a negative interval", after(-1.0)),
        ("no interval", after(1e-300)),
        ("a skew in no interval", FramePrior { skew_s: 0.01, ..after(1e-300) }),
        ("a NaN skew", FramePrior::of_skew(f64::NAN)),
        ("an endless skew", FramePrior { skew_s: 1e9, ..after(1.0 / FPS) }),
    ];
    let rig = rectified_rig();
    let mut tracker =
        DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).expect("tracker");
    for frame in 0..3 * absurd.len() as u32 + 4 {
        let truth = moved(frame);
        let (left, right) = render(&rig, &Shot { cam_left_from_target: Some(truth), frame, right_gain: 1.0 });
        let (name, prior) = match (frame % 3, absurd.get(frame as usize / 3)) {
            (2, Some(absurd)) => *absurd,
            _ => ("a good prior", after(1.0 / FPS)),
        };
        let estimate = match frame {
            0 => tracker.start_from_plane(&left, &right, &region(&rig, &truth), &plane(&truth)).expect("start"),
            _ => tracker.estimate(EstimateRequest::next_frame(&left, &right, &prior)).expect("update"),
        };
        if frame % 3 != 2 {
            assert_eq!(estimate.status, Status::Ok, "frame {frame}, after an absurd one: {}", estimate.reason);
        } else if let Some(pose) = estimate.cam_left_from_model {
            assert!((pose.translation_m() - truth.translation_m()).norm() < 5e-3, "{name}: {pose:?}");
        }
    }
}

fn moved(frame: u32) -> Pose<CamLeft, pb3dp_geometry::frames::Target> {
    moving(f64::from(frame) / FPS)
}
