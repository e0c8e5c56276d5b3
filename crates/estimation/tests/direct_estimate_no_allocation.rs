//! After it has processed regions of all sizes, an estimate of the direct method allocates no memory except for the text of its
//! reason.
#![allow(clippy::unwrap_used, reason = "inputs that are valid")]

use nalgebra::Vector2;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};

use crate::plane_pair::{Paint, Setup, Texture, render};

/// Upper bound for the text of a reason, and for the crossings of a row with a polygon.
const WORDS_MAX: usize = 1500;

#[test]
fn a_later_estimate_asks_for_the_words_of_its_answer_only() {
    let pair = render(&Setup::default(), &Texture::new(Paint::Crab, 5), &Texture::new(Paint::Sand, 9));
    let range = SearchRange { z_min_m: 0.35, z_max_m: 0.9, tilt_max_rad: 60_f64.to_radians() };
    // The target with part of its background, so that both searches run; and a smaller region.
    let around = |half: f64| {
        let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
        Region::Polygon { vertices_px: corners.map(|(x, y)| Vector2::new(330.0 + x, 240.0 + y)).to_vec() }
    };
    let regions = [around(30.0), around(60.0), around(130.0)];
    let mut estimator = DirectEstimator::new(&pair.rig, DirectConfig::default()).unwrap();
    let first = regions.each_ref().map(|region| {
        estimator.estimate(EstimateRequest::new_target(&pair.left, &pair.right, region, &range)).unwrap()
    });
    assert!(first.iter().any(|estimate| estimate.status == Status::Ok), "{:?}", first.each_ref().map(|e| &e.reason));
    for region in &regions {
        estimator.estimate(EstimateRequest::new_target(&pair.left, &pair.right, region, &range)).unwrap();
    }
    for (region, first) in regions.iter().zip(&first) {
        let before = pb3dp_allocation_count::bytes();
        let second = estimator.estimate(EstimateRequest::new_target(&pair.left, &pair.right, region, &range)).unwrap();
        let bytes = pb3dp_allocation_count::bytes() - before;
        assert!(bytes < WORDS_MAX, "{bytes} bytes: {}", second.reason);
        assert_eq!(first, &second);
    }
}
