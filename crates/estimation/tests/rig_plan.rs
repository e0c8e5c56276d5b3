//! Planned accuracy of a stereo rig compared with the accuracy of the direct method on ray-traced pairs.
#![allow(clippy::unwrap_used, reason = "inputs that are valid")]

use image::{GrayImage, Luma};
use nalgebra::Vector3;
use pb3dp_estimation::rig_plan::{Conditions, PixelNoise, StereoHead};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};

use crate::plane_pair::{self, Paint, Pair, SIZE, Setup, Texture, render};

/// Number of target pixels whose row neighbours are on the target as well, and the rms gradient there, all channels together.
fn texture_of(pair: &Pair) -> (usize, f64) {
    let inner: Vec<usize> =
        (2..pair.target.len() - 2).filter(|&i| pair.target[i - 2..=i + 2].iter().all(|on| *on)).collect();
    let slope = |i: usize, c: usize| f64::from(pair.clean_left[i + 1][c] - pair.clean_left[i - 1][c]) / 2.0;
    let squares: f64 = inner.iter().flat_map(|&i| (0..3).map(move |c| (i, c))).map(|(i, c)| slope(i, c).powi(2)).sum();
    (inner.len(), (squares / inner.len() as f64).sqrt())
}

/// Depth (mm) and normal (degrees), root mean squares: measured and planned; and the mean gradient.
fn reached_and_planned(paint: Paint, base: &Setup) -> ([[f64; 2]; 2], f64) {
    const POSES: u64 = 8;
    let (target, sand) = (Texture::new(paint, 5), Texture::new(Paint::Sand, 99));
    let (mut reached, mut planned, mut gradients) = ([0.0; 2], [0.0; 2], 0.0);
    for seed in 0..POSES {
        let mut random = plane_pair::random(300 + seed);
        let setup = Setup {
            seed,
            z_m: base.z_m + random.between(-0.02, 0.02),
            tilt_x_rad: random.between(-0.1, 0.1),
            tilt_y_rad: random.between(-0.1, 0.1),
            gain: [1.0; 3],
            bias: [0.0; 3],
            ..base.clone()
        };
        let pair = render(&setup, &target, &sand);
        let region = GrayImage::from_fn(SIZE.width, SIZE.height, |x, y| {
            Luma([255 * u8::from(pair.region[(y * SIZE.width + x) as usize])])
        });
        let mut estimator = DirectEstimator::new(&pair.rig, DirectConfig::default()).unwrap();
        let range = SearchRange::new(0.3, 0.9, 40f64.to_radians()).unwrap();
        let found = estimator
            .estimate(EstimateRequest::new_target(&pair.left, &pair.right, &Region::Mask(region), &range))
            .unwrap();
        let pose = found.pose.unwrap();
        let ray = pair.rig.left().unproject(&found.centroid_px).unwrap();
        let true_z_m = pair.plane.normal.dot(&pair.plane.point) / pair.plane.normal.dot(&ray);
        let normal: Vector3<f64> = pose.normal_in_cam_left;
        reached[0] += (1e3 * (pose.depth_on_ray(&ray).unwrap() - true_z_m)).powi(2);
        reached[1] += normal.angle(&-pair.plane.normal).to_degrees().powi(2);

        let (pixels, gradient_grey_per_px) = texture_of(&pair);
        let head = StereoHead { baseline_m: setup.baseline_m, focal_px: 740.0, size: SIZE };
        let conditions = Conditions {
            target_m: (pixels as f64).sqrt() * setup.z_m / 740.0,
            noise: PixelNoise::Image { noise_grey: setup.noise_sigma, gradient_grey_per_px },
            calibration_px: 0.0,
            speed_m_per_s: 0.0,
            exposure_s: 0.0,
            skew_s: 0.0,
        };
        let noise = head.at(setup.z_m, &conditions).errors.unwrap().noise;
        planned[0] += (1e3 * noise.depth_m).powi(2);
        planned[1] += noise.normal_rad.to_degrees().powi(2);
        gradients += gradient_grey_per_px;
    }
    let rms = |squares: [f64; 2]| squares.map(|sum| (sum / POSES as f64).sqrt());
    ([reached, planned].map(rms), gradients / POSES as f64)
}

/// Sampling error over all rigs and poses: 14 % for the rms depth and 10 % for the rms normal (one sigma), hence the lower
/// limit 0.6: a single target reaches 0.44 times the planned depth, because the plan takes one gradient for all of its pixels.
/// The finite image resolution and excluded points account for values above 1.
#[test]
fn the_direct_method_reaches_what_was_planned_and_no_more() {
    let far = Setup { z_m: 0.7, ..Setup::default() };
    let short = Setup { baseline_m: 0.06, ..Setup::default() };
    let noisy = Setup { noise_sigma: 6.0, ..Setup::default() };
    let heads = [(Paint::Grey, &far), (Paint::Crab, &short), (Paint::Colour, &noisy)];
    let mut squares = [0.0; 2];
    for (paint, setup) in heads {
        let ([reached, planned], gradient) = reached_and_planned(paint, setup);
        let ratios = [reached[0] / planned[0], reached[1] / planned[1]];
        let at = format!("{paint:?} at {} m, gradient {gradient:.1} grey/px", setup.z_m);
        println!("{at}: {reached:.4?} of {planned:.4?} planned: {ratios:.2?}");
        assert!(ratios.iter().all(|ratio| (0.4..2.0).contains(ratio)), "{at}: {reached:?} of {planned:?} planned");
        squares = [0, 1].map(|k| squares[k] + ratios[k].powi(2) / heads.len() as f64);
    }
    let together = squares.map(f64::sqrt);
    println!("together: {together:.2?}");
    assert!(together.iter().all(|ratio| (0.6..1.5).contains(ratio)), "{together:?}");
}
