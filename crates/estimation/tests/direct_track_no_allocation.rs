//! Frames of the direct method do not allocate, unless the planes of the whole pair are searched for a lost target.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};

use crate::moving_plane::{Shot, moving, plane, rectified_rig, region, render};

#[test]
fn frames_do_not_allocate() {
    let (rig, first) = (rectified_rig(), moving(0.0));
    let shot = |pose, frame| render(&rig, &Shot { cam_left_from_target: pose, frame, right_gain: 0.9 });
    let mut tracker =
        DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).expect("tracker");
    let (left, right) = shot(Some(first), 0);
    tracker.start_from_plane(&left, &right, &region(&rig, &first), &plane(&first)).expect("start");
    // Visible, hidden, visible; with rotation, so that views are stored too.
    let frames: Vec<_> =
        (1..20).map(|frame| shot((frame % 10 < 8).then(|| moving(f64::from(frame) / 15.0)), frame)).collect();
    // The target is away for less than the time between two such searches.
    let prior = FramePrior { dt_s: Some(0.02), ..FramePrior::default() };
    let mut estimate =
        tracker.estimate(EstimateRequest::next_frame(&frames[0].0, &frames[0].1, &prior)).expect("update");
    // The first lost frame has the longest reason and the largest windows.
    estimate.reason.reserve(400);
    let mut counts = Vec::with_capacity(frames.len());
    for (left, right) in &frames[1..] {
        let before = pb3dp_allocation_count::requests();
        tracker.follow_into(&mut EstimateRequest::next_frame(left, right, &prior), &mut estimate).expect("update");
        counts.push((estimate.status, pb3dp_allocation_count::requests() - before));
    }
    assert!(counts.iter().any(|(status, _)| *status == Status::Ok));
    assert!(counts.iter().any(|(status, _)| *status == Status::Lost));
    assert!(counts.iter().all(|(_, count)| *count == 0), "{counts:?}");
}
