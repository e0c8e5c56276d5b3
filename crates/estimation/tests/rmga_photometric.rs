//! RM-GA with a photometric score on ray-traced pairs.
#![allow(clippy::unwrap_used, reason = "inputs that are valid")]

use crate::common::every_kernel;
use crate::plane_pair;
use crate::plane_pair::{Paint, Pair, SIZE, Setup, Texture, render};
use image::{GrayImage, Luma};
use nalgebra::Vector3;
use pb3dp_estimation::cpu::Kernels;
use pb3dp_estimation::estimate::PlaneEstimate;
use pb3dp_estimation::plane_hypothesis::SearchRange;
use pb3dp_estimation::region::Region;
use pb3dp_estimation::rmga_photometric::{RmgaPhotometricConfig, RmgaPhotometricEstimator};
use pb3dp_estimation::status::Status;

fn estimate(pair: &Pair, config: RmgaPhotometricConfig, kernels: Kernels) -> PlaneEstimate {
    let mask = GrayImage::from_fn(SIZE.width, SIZE.height, |x, y| {
        Luma([255 * u8::from(pair.region[(y * SIZE.width + x) as usize])])
    });
    let range = SearchRange::new(0.4, 0.7, 0.7).unwrap();
    let mut estimator = RmgaPhotometricEstimator::with_kernels(&pair.rig, config, kernels).unwrap();
    estimator.estimate(&pair.left, &pair.right, &Region::Mask(mask), &range).unwrap()
}

fn check(paint: Paint, setup: Setup, (z_mm, normal_deg): (f64, f64)) {
    let pair = render(&setup, &Texture::new(paint, 5), &Texture::new(Paint::Sand, 9));
    let found = estimate(&pair, RmgaPhotometricConfig::default(), Kernels::best());
    assert!(found.pose.is_some(), "{paint:?}: {:?}, {}", found.status, found.reason);
    let pose = found.pose.unwrap();
    let ray = pair.rig.left().unproject(&found.centroid_px).unwrap();
    let z_m = pair.plane.normal.dot(&pair.plane.point) / pair.plane.normal.dot(&ray);
    let angle_deg = pose.normal_in_cam_left.angle(&-pair.plane.normal).to_degrees();
    let off_mm = 1e3 * (pose.z_m - z_m).abs();
    assert!(off_mm < z_mm && angle_deg < normal_deg, "{paint:?}: {off_mm:.2} mm, {angle_deg:.2} deg");
    assert_eq!(found.status, Status::Ok, "{paint:?}: {}", found.reason);
    assert!(found.fitness.unwrap() > 0.6, "{found:?}");
}

fn tilted() -> Setup {
    Setup { tilt_x_rad: 0.21, tilt_y_rad: -0.33, z_m: 0.53, ..Setup::default() }
}

#[test]
fn colour_and_grey_are_found_within_the_steps_of_the_chromosome() {
    check(Paint::Crab, tilted(), (1.0, 1.5));
    check(Paint::Grey, tilted(), (1.0, 1.5));
    check(Paint::EqualLuminance, tilted(), (1.0, 2.0));
}

#[test]
fn gain_and_white_balance_cost_nothing_and_occlusion_is_survived() {
    check(Paint::Crab, Setup { gain: [0.9, 0.75, 0.7], bias: [9.0, 4.0, 0.0], ..tilted() }, (1.0, 1.5));
    check(Paint::Grey, Setup { occluded: 0.15, ..tilted() }, (3.0, 7.0));
}

#[test]
fn a_blank_target_is_refused_with_its_reason() {
    let plain = Texture::new(Paint::Plain, 1);
    let pair = render(&Setup { background_m: 0.0, ..tilted() }, &plain, &plain);
    let found = estimate(&pair, RmgaPhotometricConfig::default(), Kernels::best());
    assert_eq!((found.status, found.pose), (Status::NotObservable, None));
    assert!(found.reason.ends_with("it is blank"), "{}", found.reason);
}

#[test]
fn every_kernel_gives_the_same_answer() {
    let pair = render(&tilted(), &Texture::new(Paint::Colour, 5), &Texture::new(Paint::Sand, 9));
    let config = || RmgaPhotometricConfig { points: 400, ..RmgaPhotometricConfig::default() };
    let kernels = every_kernel("rmga_photometric::every_kernel_gives_the_same_answer");
    let answers: Vec<_> = kernels.map(|kernels| estimate(&pair, config(), kernels)).collect();
    assert!(answers.iter().all(|answer| *answer == answers[0]));
    assert!(answers[0].pose.is_some_and(|pose| pose.normal_in_cam_left.dot(&Vector3::z()) < 0.0));
}

#[test]
fn parameters_out_of_range_are_named() {
    let config = RmgaPhotometricConfig { blocks_per_side: 1, ..RmgaPhotometricConfig::default() };
    let error = RmgaPhotometricEstimator::new(&plane_pair::rig(0.1), config).unwrap_err().to_string();
    assert_eq!(error, "rmga-photometric blocks_per_side is 1: must be between 2 and 8");
}
