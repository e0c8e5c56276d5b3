//! Estimates stopped by the deadline: with any time limit, the best estimate so far, with a warning.
#![allow(clippy::unwrap_used, reason = "inputs that are valid")]

use image::{GrayImage, Luma};
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, FramePrior, Method, Tracker};
use pb3dp_estimation_core::estimate::{EstimateWarning, PlaneEstimate};
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;

use crate::plane_pair::{Paint, Pair, SIZE, Setup, Texture, render};

fn pair(z_m: f64) -> Pair {
    let setup = Setup { tilt_x_rad: 0.21, tilt_y_rad: -0.33, z_m, ..Setup::default() };
    render(&setup, &Texture::new(Paint::Colour, 5), &Texture::new(Paint::Sand, 9))
}

fn region(pair: &Pair) -> Region {
    let at = |x: u32, y: u32| 255 * u8::from(pair.region[(y * SIZE.width + x) as usize]);
    Region::Mask(GrayImage::from_fn(SIZE.width, SIZE.height, |x, y| Luma([at(x, y)])))
}

fn range() -> SearchRange {
    SearchRange::new(0.4, 0.7, 0.7).unwrap()
}

/// The estimate after a number of steps.
fn after(method: Method, pair: &Pair, steps: usize) -> PlaneEstimate {
    let mut estimator = Estimator::new(method, &pair.rig, &EstimatorConfig::default()).unwrap();
    let mut left = steps;
    let mut may_continue = || {
        let may = left > 0;
        left = left.saturating_sub(1);
        may
    };
    estimator
        .estimate(
            EstimateRequest::new_target(&pair.left, &pair.right, &region(pair), &range()).until(&mut may_continue),
        )
        .unwrap()
}

fn error_mm(pair: &Pair, found: &PlaneEstimate) -> f64 {
    let ray = pair.rig.left().unproject(&found.centroid_px).unwrap();
    1e3 * (found.pose.unwrap().z_m - pair.plane.normal.dot(&pair.plane.point) / pair.plane.normal.dot(&ray)).abs()
}

#[test]
fn a_deadline_gives_the_best_answer_so_far() {
    let pair = pair(0.53);
    for method in Method::ALL {
        let whole = after(method, &pair, usize::MAX);
        assert!(!whole.warnings.contains(&EstimateWarning::CutShort));
        let mut estimator = Estimator::new(method, &pair.rig, &EstimatorConfig::default()).unwrap();
        assert_eq!(
            estimator.estimate(EstimateRequest::new_target(&pair.left, &pair.right, &region(&pair), &range())).unwrap(),
            whole
        );
        for steps in [0, 1, 3] {
            let cut = after(method, &pair, steps);
            if cut == whole {
                continue;
            }
            assert!(cut.warnings.contains(&EstimateWarning::CutShort), "{method} after {steps}: {cut:?}");
            assert!(!cut.reason.is_empty() && (cut.pose.is_some() || cut.status == Status::NotObservable), "{cut:?}");
            assert!(cut.pose.is_none() || error_mm(&pair, &cut) < 150.0, "{method} after {steps}: {cut:?}");
        }
        assert_ne!(after(method, &pair, 0), whole, "{method}");
        assert!(error_mm(&pair, &whole) < 3.0, "{method}");
    }
}

/// Without refinement the direct method is still within one chromosome step, but does not report the tilt as determined.
#[test]
fn the_direct_method_without_time_is_coarse_and_says_so() {
    let pair = pair(0.53);
    let (cut, whole) = (after(Method::Direct, &pair, 0), after(Method::Direct, &pair, usize::MAX));
    assert_eq!((cut.status, cut.z_sigma_m, whole.status), (Status::WeakTilt, None, Status::Ok), "{}", cut.reason);
    assert!(error_mm(&pair, &cut) < 2.0 && error_mm(&pair, &whole) < 0.1);
}

#[test]
fn tracking_within_a_deadline_gives_a_pose_or_says_lost() {
    let (first, second) = (pair(0.53), pair(0.531));
    for method in [Method::Direct, Method::Published] {
        let mut tracker = Tracker::new(method, &first.rig, &EstimatorConfig::default()).unwrap();
        tracker.estimate(EstimateRequest::new_target(&first.left, &first.right, &region(&first), &range())).unwrap();
        let cut = tracker
            .estimate(
                EstimateRequest::next_frame(&second.left, &second.right, &FramePrior::default()).until(&mut || false),
            )
            .unwrap();
        assert!(cut.reason.contains("cut short") && !cut.reason.contains("inf "), "{method}: {}", cut.reason);
        assert!(cut.cam_left_from_model.is_some() || cut.status == Status::Lost, "{method}: {cut:?}");
        // The published method evaluates its fitness landscape; the direct method evaluates the final step.
        let vouches = cut.covariance.is_some() || cut.status == Status::Ok;
        assert!(method == Method::Published || !vouches, "{}", cut.reason);
        let whole =
            tracker.estimate(EstimateRequest::next_frame(&second.left, &second.right, &FramePrior::default())).unwrap();
        assert!(whole.cam_left_from_model.is_some() && !whole.reason.contains("cut short"), "{method}: {whole:?}");
    }
}
