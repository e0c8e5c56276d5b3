//! The direct method on small regions: a plane that continues around the region improves the tilt; other surroundings do no
//! harm.
#![allow(clippy::unwrap_used, reason = "helpers of tests, with inputs that are valid")]

use nalgebra::Vector2;
use pb3dp_estimation_core::estimate::PlaneEstimate;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::{PlaneHypothesis, SearchRange};
use pb3dp_estimation_core::region::{Region, RegionMask};
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_estimation_test_support::scene::{self, Scene};
use pb3dp_geometry::ImageSize;

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };

/// The estimates without and with the surroundings.
fn both(scene: &Scene, region: &Region, range: &SearchRange) -> [PlaneEstimate; 2] {
    let rig = scene::rectified_rig(SIZE);
    let (left, right) = scene.render(&rig);
    [0, 32].map(|surroundings_px| {
        let mut config = DirectConfig::default();
        config.cold_start.surroundings_px = surroundings_px;
        let mut estimator = DirectEstimator::new(&rig, config).unwrap();
        estimator.estimate(EstimateRequest::new_target(&left, &right, region, range)).unwrap()
    })
}

fn normal_error_deg(scene: &Scene, found: &PlaneEstimate) -> f64 {
    let truth = PlaneHypothesis { z_m: scene.z_m, theta_x_rad: scene.theta_x_rad, theta_y_rad: scene.theta_y_rad };
    found.normal_in_cam_left().unwrap().angle(&-truth.normal()).to_degrees()
}

/// 32 x 32 pixels in the middle of a disc whose radius is some 70 pixels.
#[test]
fn a_surface_that_goes_on_around_a_small_region_lowers_the_error_of_its_normal() {
    let range = SearchRange::new(0.35, 0.9, 60f64.to_radians()).unwrap();
    let region = Region::Rectangle { x: 336, y: 220, width: 32, height: 32 };
    let (mut squares, mut claimed) = ([0.0; 2], [0.0; 2]);
    let mut count = 0.0;
    for (theta_x_rad, theta_y_rad) in [(0.2, -0.3), (-0.35, 0.1), (0.05, 0.4), (-0.1, -0.2), (0.3, 0.25), (0.0, 0.0)] {
        for (z_m, du) in [(0.55, 0.0), (0.6, 9.0)] {
            let centre_px = Vector2::new(352.0 + du, 236.0 - du);
            let scene = Scene { centre_px, z_m, theta_x_rad, theta_y_rad, noise: 12.0 };
            let found = both(&scene, &region, &range);
            for (k, found) in found.iter().enumerate() {
                squares[k] += normal_error_deg(&scene, found).powi(2);
                claimed[k] += found.normal_sigma_rad.unwrap().to_degrees().powi(2);
            }
            count += 1.0;
        }
    }
    let rms = squares.map(|sum| f64::sqrt(sum / count));
    assert!(rms[1] < 0.85 * rms[0], "{rms:?}");
    // The claimed variance follows: neither much larger nor smaller than the error.
    let ratio = squares[1] / claimed[1];
    assert!((0.05..2.0).contains(&ratio), "squared error over claimed variance {ratio}");
}

/// The whole disc, with a radius of about 20 pixels; around it is the panel, half a pixel of disparity behind.
#[test]
fn a_background_behind_a_small_region_changes_nothing() {
    let range = SearchRange::new(1.0, 4.0, 60f64.to_radians()).unwrap();
    let rig = scene::rectified_rig(SIZE);
    for (theta_x_rad, theta_y_rad) in [(0.2, -0.3), (-0.35, 0.1), (0.05, 0.4), (-0.1, -0.2)] {
        let scene = Scene { centre_px: Vector2::new(340.0, 250.0), z_m: 1.6, theta_x_rad, theta_y_rad, noise: 3.0 };
        let mask = RegionMask::from_fn(SIZE, |u, v| scene.sees_disc(&rig, u, v));
        let mut image = image::GrayImage::new(SIZE.width, SIZE.height);
        mask.for_each(|x, y| image.put_pixel(x, y, image::Luma([255])));
        let [alone, with] = both(&scene, &Region::Mask(image), &range);
        assert!(alone.pose.is_some(), "{}", alone.reason);
        let (before, after) = (normal_error_deg(&scene, &alone), normal_error_deg(&scene, &with));
        assert!(after < before + 0.5, "{before} became {after} degrees: {}", with.reason);
    }
}
