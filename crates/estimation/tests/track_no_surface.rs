//! Two unrelated images of soft texture: no surface may be tracked.
#![allow(clippy::unwrap_used, reason = "inputs that are valid")]

use image::{Rgb, RgbImage};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_test_support::scene;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::ImageSize;

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };

/// Waves of 60 to 200 px without symmetry; other waves for every seed.
fn soft_image(seed: u32) -> RgbImage {
    let mut random = SplitMix64::new(u64::from(seed));
    let waves: Vec<[f64; 3]> = (0..12)
        .map(|_| {
            let (turn, length) = (random.between(0.0, std::f64::consts::TAU), random.between(60.0, 200.0));
            let speed = std::f64::consts::TAU / length;
            [speed * turn.cos(), speed * turn.sin(), random.between(0.0, std::f64::consts::TAU)]
        })
        .collect();
    RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
        let wave = |w: &[f64; 3]| 9.0 * (w[0] * f64::from(u) + w[1] * f64::from(v) + w[2]).sin();
        Rgb([(120.0 + waves.iter().map(wave).sum::<f64>()).round().clamp(0.0, 255.0) as u8; 3])
    })
}

#[test]
fn soft_texture_of_another_scene_is_not_taken_for_a_surface() {
    let rig = scene::rectified_rig(SIZE);
    let range = SearchRange::new(0.35, 0.8, 45_f64.to_radians()).unwrap();
    let mut tracker = DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).unwrap();
    let mut taken = Vec::new();
    for seed in 0..5 {
        let (left, right) = (soft_image(seed), soft_image(seed + 100));
        for x in [72, 330, 480] {
            let region = Region::Rectangle { x, y: 120 + 20 * seed as i32, width: 40, height: 90 };
            let found = tracker.estimate(EstimateRequest::new_target(&left, &right, &region, &range)).unwrap();
            if found.status == Status::Ok || found.status == Status::WeakTilt {
                taken.push((seed, x, found.reason));
            }
        }
    }
    assert!(taken.is_empty(), "{} of 15 were taken: {taken:?}", taken.len());
}
