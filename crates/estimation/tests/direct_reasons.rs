//! Reasons of the direct method if no plane, or no allowed plane, fits the region.
#![allow(clippy::unwrap_used, reason = "inputs that are valid")]

use image::{Rgb, RgbImage};
use nalgebra::Vector2;
use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method};
use pb3dp_estimation::rig_watch::RowMeter;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::estimate::{EstimateWarning, PlaneEstimate};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_estimation_test_support::scene::{self, Scene};
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use pb3dp_geometry::{ImageSize, StereoRig};

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };

fn estimate(rig: &StereoRig, (left, right): (&RgbImage, &RgbImage), region: &Region, range: [f64; 3]) -> PlaneEstimate {
    let mut estimator = DirectEstimator::new(rig, DirectConfig::default()).unwrap();
    let range = SearchRange::new(range[0], range[1], range[2].to_radians()).unwrap();
    estimator.estimate(EstimateRequest::new_target(left, right, region, &range)).unwrap()
}

/// A smooth texture without symmetry.
fn texture(x: f64, y: f64) -> f64 {
    let waves =
        [(0.9, 0.4, 0.3), (0.35, -0.7, 1.1), (-0.6, 0.25, 2.0), (0.15, 0.9, 0.7), (1.1, 0.8, 0.2), (0.07, 0.1, 0.0)];
    128.0 + waves.iter().map(|(u, v, phase)| 16.0 * (u * x + v * y + phase).sin()).sum::<f64>()
}

/// A stereo pair: a texture in the right image, and the left image displaced by the given disparities.
fn pair(disparity_px: impl Fn(f64, f64) -> f64) -> (RgbImage, RgbImage) {
    let render = |at: &dyn Fn(f64, f64) -> f64| {
        RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
            let (u, v) = (f64::from(u), f64::from(v));
            Rgb([texture(at(u, v), v).round().clamp(0.0, 255.0) as u8; 3])
        })
    };
    (render(&|u, v| u - disparity_px(u, v)), render(&|u, _| u))
}

/// Disparities of a parabola. By hand: over `u0 +- h` the plane of least squares is level, `c h^2 / 3` above the lowest disparity.
#[test]
fn of_a_curved_surface_the_plane_of_least_squares_is_given_as_ambiguous() {
    const CURVATURE: f64 = 0.0015;
    let rig = scene::rectified_rig(SIZE);
    let disparity_px = |u: f64| 135.0 + CURVATURE * (u - 320.0).powi(2);
    let (left, right) = pair(|u, _| disparity_px(u));
    let region = Region::Rectangle { x: 250, y: 170, width: 140, height: 140 };
    let found = estimate(&rig, (&left, &right), &region, [0.4, 0.7, 60.0]);
    assert_eq!(found.status, Status::Ambiguous, "{}", found.reason);
    assert!(found.reason.contains("flat"), "{}", found.reason);
    let (fb, offset) = (rig.left().pinhole().fx * 0.1, rig.right().pinhole().cx - rig.left().pinhole().cx);
    let expected_px = 135.0 + CURVATURE * 70.0_f64.powi(2) / 3.0;
    for (u, v) in [(250.0, 170.0), (320.0, 240.0), (389.0, 170.0), (250.0, 309.0)] {
        let shown_px = fb / found.depth_at_pixel(&Vector2::new(u, v)).unwrap() - offset;
        assert!((shown_px - expected_px).abs() < 0.2, "{shown_px} at {u}, {v}, expected {expected_px}");
    }

    // Nevertheless it is clearly a surface.
    assert!(found.warnings.contains(&EstimateWarning::NoPlane), "{:?}", found.warnings);
    let mut tracker = DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).unwrap();
    let range = SearchRange::new(0.4, 0.7, 60_f64.to_radians()).unwrap();
    let started = tracker.estimate(EstimateRequest::new_target(&left, &right, &region, &range)).unwrap();
    assert_eq!(started.status, Status::Ok, "{}", started.reason);
}

/// If the range misses the target, planes without a surface remain. A relief can reach the target from some of them, but the
/// model would then be where no surface is.
#[test]
fn a_surface_outside_the_range_is_not_tracked() {
    let rig = scene::rectified_rig(SIZE);
    let scene =
        Scene { centre_px: Vector2::new(352.0, 236.0), z_m: 0.5, theta_x_rad: 0.2, theta_y_rad: -0.3, noise: 3.0 };
    let (left, right) = scene.render(&rig);
    let region = Region::Rectangle { x: 312, y: 196, width: 80, height: 80 };
    let started = |z_min_m: f64, z_max_m: f64| {
        let mut tracker = DirectTracker::new(&rig, DirectConfig::default(), DirectTrackerConfig::default()).unwrap();
        let range = SearchRange::new(z_min_m, z_max_m, 60_f64.to_radians()).unwrap();
        tracker.estimate(EstimateRequest::new_target(&left, &right, &region, &range)).unwrap()
    };
    let held = started(0.35, 0.8);
    assert_eq!(held.status, Status::Ok, "{}", held.reason);
    let mut reported = 0;
    for gap in [0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1] {
        for missed in [started(0.35, 0.5 * (1.0 - gap)), started(0.5 * (1.0 + gap), 0.8)] {
            assert!(!missed.status.depth_is_sure(), "{gap}: {} {}", missed.status, missed.reason);
            reported += usize::from(missed.reason.contains("the fitted surface is"));
        }
    }
    assert!(reported > 0, "no relief has reached the target");
}

/// A target that covers less than half of the region, in front of a farther surface and behind a nearer one.
#[test]
fn the_answer_is_not_another_surface_than_the_first() {
    let rig = scene::rectified_rig(SIZE);
    let disparity_px = |u: f64, v: f64| match u {
        ..297.0 => 160.0,
        ..363.0 => 135.0 + 0.03 * (u - 320.0) + 0.05 * (v - 240.0),
        _ => 112.0,
    };
    let (left, right) = pair(disparity_px);
    let region = Region::Rectangle { x: 262, y: 170, width: 140, height: 140 };
    let found = estimate(&rig, (&left, &right), &region, [0.35, 0.8, 60.0]);
    let (fb, offset) = (rig.left().pinhole().fx * 0.1, rig.right().pinhole().cx - rig.left().pinhole().cx);
    for at in [Vector2::new(320.0, 190.0), Vector2::new(340.0, 290.0)] {
        let off_px = fb / found.depth_at_pixel(&at).unwrap() - offset - disparity_px(at.x, at.y);
        assert!(off_px.abs() < 1.0, "{off_px} px off: {} {}", found.status, found.reason);
    }
}

#[test]
fn a_limit_of_the_tilt_that_is_too_small_is_named() {
    let rig = scene::rectified_rig(SIZE);
    let scene =
        Scene { centre_px: Vector2::new(352.0, 236.0), z_m: 0.5, theta_x_rad: 0.1, theta_y_rad: 0.95, noise: 3.0 };
    let (left, right) = scene.render(&rig);
    let region = Region::Rectangle { x: 322, y: 190, width: 60, height: 90 };
    let found = |tilt_deg: f64| estimate(&rig, (&left, &right), &region, [0.35, 0.8, tilt_deg]);
    assert_eq!(found(75.0).status, Status::Ok, "{}", found(75.0).reason);
    let limited = found(12.0);
    assert!(!limited.status.depth_is_sure(), "{:?} {}", limited.status, limited.reason);
    assert!(
        limited.reason.contains("the tilt limit is 12 degrees: raise it (SearchRange::tilt_max_rad)"),
        "{}",
        limited.reason
    );
}

#[test]
fn a_range_that_misses_the_target_is_named() {
    let rig = scene::rectified_rig(SIZE);
    let scene =
        Scene { centre_px: Vector2::new(352.0, 236.0), z_m: 0.5, theta_x_rad: 0.2, theta_y_rad: -0.3, noise: 3.0 };
    let (left, right) = scene.render(&rig);
    let region = Region::Rectangle { x: 312, y: 196, width: 80, height: 80 };
    let found = |range: [f64; 3]| estimate(&rig, (&left, &right), &region, range);
    assert_eq!(found([0.35, 0.8, 60.0]).status, Status::Ok, "{}", found([0.35, 0.8, 60.0]).reason);
    let missed = found([0.65, 0.95, 60.0]);
    assert!(!missed.status.depth_is_sure(), "{:?} {}", missed.status, missed.reason);
    assert!(missed.reason.contains("(SearchRange)"), "{}", missed.reason);
    let outside = found([0.05, 0.08, 60.0]);
    assert_eq!(outside.status, Status::NotObservable);
    assert!(outside.reason.contains("at 50 to 80 mm"), "{}", outside.reason);
}

/// The end of a range is measured in disparity. With 21 m of depth, a target 20 mm inside the range is not ambiguous; and 16 mm
/// from the far end of a narrow range are only half a pixel.
#[test]
fn the_end_of_a_range_is_half_a_pixel_of_disparity() {
    let rig = scene::rectified_rig(SIZE);
    let found = |z_m: f64, range: [f64; 3]| {
        let scene =
            Scene { centre_px: Vector2::new(352.0, 236.0), z_m, theta_x_rad: 0.2, theta_y_rad: -0.3, noise: 3.0 };
        let (left, right) = scene.render(&rig);
        let region = Region::Rectangle { x: 312, y: 196, width: 80, height: 80 };
        estimate(&rig, (&left, &right), &region, range)
    };
    let wide = found(0.42, [0.4, 21.0, 60.0]);
    assert_eq!(wide.status, Status::Ok, "{}", wide.reason);
    assert!(wide.warnings.is_empty(), "{:?}", wide.warnings);
    for (z_m, range) in [(1.6, [0.4, 1.605, 60.0]), (0.42, [0.4199, 0.7, 60.0])] {
        let at_end = found(z_m, range);
        assert!(matches!(at_end.warnings[..], [EstimateWarning::EndOfRange { .. }]), "{:?}", at_end.warnings);
        assert!(!at_end.status.depth_is_sure(), "{:?} {}", at_end.status, at_end.reason);
    }
}

#[test]
fn missing_texture_is_named() {
    let rig = scene::rectified_rig(SIZE);
    let blank = RgbImage::from_pixel(SIZE.width, SIZE.height, Rgb([120; 3]));
    let region = Region::Rectangle { x: 250, y: 180, width: 120, height: 100 };
    let found = estimate(&rig, (&blank, &blank), &region, [0.35, 0.8, 60.0]);
    assert_eq!(found.status, Status::NotObservable);
    assert!(found.reason.contains("choose a textured target"), "{}", found.reason);
}

/// Stripes across the rows, 40 px apart, at 112 px of disparity, on a background without texture.
fn stripes(at: impl Fn(f64) -> f64) -> RgbImage {
    let brightness = |x: f64, y: f64| match (x / 20.0).floor() + (y / 24.0).floor() {
        field if !(180.0..480.0).contains(&x) || !(60.0..420.0).contains(&y) => 120.0 + 0.0 * field,
        field if field % 2.0 == 0.0 => 200.0,
        _ => 60.0,
    };
    RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| Rgb([brightness(at(f64::from(u)), f64::from(v)) as u8; 3]))
}

#[test]
fn a_repetitive_target_outside_the_range_is_not_taken_for_its_alias() {
    let rig = scene::rectified_rig(SIZE);
    let (fb, offset) = (rig.left().pinhole().fx * 0.1, rig.right().pinhole().cx - rig.left().pinhole().cx);
    let (left, right) = (stripes(|u| u), stripes(|u| u + 112.0));
    let z_m = |disparity_px: f64| fb / (disparity_px + offset);
    // The range contains only positions one or two periods further on. Near the left end of the board these show only part of
    // the region.
    for (x, width, [low_px, high_px]) in [(190, 90, [130.0, 190.0]), (380, 90, [50.0, 95.0])] {
        let region = Region::Rectangle { x, y: 150, width, height: 110 };
        let missed = estimate(&rig, (&left, &right), &region, [z_m(high_px), z_m(low_px), 60.0]);
        assert!(!missed.status.depth_is_sure(), "{} to {} px: {:?} {}", low_px, high_px, missed.status, missed.reason);
        // Where the range contains only the right position, the others still explain the region as well.
        let held = estimate(&rig, (&left, &right), &region, [z_m(125.0), z_m(100.0), 60.0]);
        assert_eq!(held.status, Status::Ambiguous, "{}", held.reason);
        assert!(held.reason.contains("looks the same at"), "{}", held.reason);
        assert!((held.pose.unwrap().z_m - z_m(112.0)).abs() < 1e-3 * z_m(112.0));
    }
}

/// Parts of 60 x 45 mm with the same print every 90 mm before a wall, half a metre away: the marked one may be matched with its neighbour,
/// whose depth is in the range or not. A row that rises by 6 px to the next part has one explanation, and so has a part alone.
#[test]
fn identical_parts_side_by_side_are_ambiguous_with_both_depths() {
    let rig = scene::rectified_rig(SIZE);
    let (fb, offset) = (rig.left().pinhole().fx * 0.1, rig.right().pinhole().cx - rig.left().pinhole().cx);
    let (pitch_px, disparity_px) = (110.0, 112.0);
    let image = |by_px: f64, rise_px: f64, parts: std::ops::RangeInclusive<i32>| {
        RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
            let (u, v) = (f64::from(u) + by_px, f64::from(v));
            let number = ((u - 300.0) / pitch_px).floor();
            let (x, y) = (u - 300.0 - number * pitch_px, v - 200.0 - number * rise_px);
            let is_part = parts.contains(&(number as i32)) && x < 74.0 && (0.0..60.0).contains(&y);
            let grey = if is_part {
                texture(x + 70.0, y + 31.0)
            } else {
                texture(1.3 * u + 400.0 - 0.4 * by_px, 1.1 * v + 300.0)
            };
            Rgb([grey.round() as u8; 3])
        })
    };
    let region = Region::Rectangle { x: 302, y: 202, width: 70, height: 56 };
    let found = |rise_px: f64, parts: std::ops::RangeInclusive<i32>, [low_px, high_px]: [f64; 2]| {
        let pair = (&image(0.0, rise_px, parts.clone()), &image(disparity_px, rise_px, parts));
        estimate(&rig, pair, &region, [fb / (high_px + offset), fb / (low_px + offset), 60.0])
    };
    let z_mm = |px: f64| format!("{:.0} mm", 1e3 * fb / (px + offset));
    for range_px in [[60.0, 260.0], [60.0, 180.0]] {
        let row = found(0.0, -2..=4, range_px);
        assert_eq!(row.status, Status::Ambiguous, "{range_px:?} {}", row.reason);
        let depths = [disparity_px, disparity_px + pitch_px].map(z_mm);
        assert!(depths.iter().all(|depth| row.reason.contains(depth)), "{depths:?} {}", row.reason);
    }
    for (rise_px, parts) in [(6.0, -2..=4), (0.0, 0..=0)] {
        let sure = found(rise_px, parts, [60.0, 260.0]);
        assert_eq!(sure.status, Status::Ok, "{rise_px} {}", sure.reason);
        assert!((sure.pose.unwrap().z_m * (disparity_px + offset) / fb - 1.0).abs() < 2e-3);
    }
}

#[test]
fn the_same_image_twice_says_nothing() {
    let rig = scene::rectified_rig(SIZE);
    let scene =
        Scene { centre_px: Vector2::new(352.0, 236.0), z_m: 0.5, theta_x_rad: 0.2, theta_y_rad: -0.3, noise: 3.0 };
    let (left, _) = scene.render(&rig);
    let region = Region::Rectangle { x: 312, y: 196, width: 80, height: 80 };
    // With disparity zero inside the range and without.
    for z_max_m in [100.0, 0.8] {
        let found = estimate(&rig, (&left, &left), &region, [0.35, z_max_m, 60.0]);
        assert_eq!(found.status, Status::NotObservable, "{}", found.reason);
        assert!(found.pose.is_none() && found.reason.contains("the same image"), "{}", found.reason);
    }
}

/// One edge across the rows and one almost along them, as on a chessboard, with more blur in the right camera. The width of an
/// edge looks like a slope, and noise does not reveal the difference.
#[test]
fn the_width_of_an_edge_is_not_taken_for_a_sure_slope() {
    let rig = scene::rectified_rig(SIZE);
    let (fb, offset) = (rig.left().pinhole().fx * 0.1, rig.right().pinhole().cx - rig.left().pinhole().cx);
    let step = |distance: f64, blur_px: f64| (1.7 * distance / (2.0 * blur_px)).tanh();
    let render = |shift_px: f64, blur_px: f64| {
        RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
            let (x, y) = (f64::from(u) + shift_px - 322.3, f64::from(v) - 247.6);
            let noise = (f64::from((u * 7919 + v * 104_729 + u * v * 31) % 997) / 997.0 - 0.5) * 5.0;
            let value = 128.0 + 90.0 * step(x - 0.06 * y, blur_px) * step(y + 0.07 * x, blur_px) + noise;
            Rgb([value.round() as u8; 3])
        })
    };
    let depth = |disparity_px: f64| fb / (disparity_px + offset);
    let mut aware = DirectConfig::default();
    // Clear disparities of such a region contradict a wrong slope too; here the blur alone must suffice.
    aware.cold_start.choice.whole_support_min = 0.0;
    // So do the edges around the region.
    aware.cold_start.surroundings_px = 0;
    let mut unaware = aware.clone();
    unaware.cold_start.refine.blur_sigma_px2 = 0.0;
    let mut wrong = [0; 2];
    for blur_px in [0.75, 0.85, 0.95] {
        let (left, right) = (render(0.0, 0.85), render(112.0, blur_px));
        for (x, y, side) in [(304, 228, 36), (298, 226, 40), (308, 224, 44)] {
            let region = Region::Rectangle { x, y, width: side, height: side };
            let range = SearchRange::new(depth(150.0), depth(90.0), 1.0).unwrap();
            for (config, wrong) in [aware.clone(), unaware.clone()].into_iter().zip(&mut wrong) {
                let mut estimator = DirectEstimator::new(&rig, config).unwrap();
                let found = estimator.estimate(EstimateRequest::new_target(&left, &right, &region, &range)).unwrap();
                let (Some(pose), Some(sigma_rad)) = (found.pose, found.normal_sigma_rad) else { continue };
                let off_rad = pose.normal_in_cam_left.angle(&-nalgebra::Vector3::z());
                *wrong += u32::from(off_rad > 1.25 * sigma_rad);
            }
        }
    }
    assert!(wrong[0] == 0 && wrong[1] > 0, "off by more than 1.25 sigmas: {}, and {} without", wrong[0], wrong[1]);
}

/// Vertical misalignment is corrected and told; beyond a limit the calibration cannot be trusted.
#[test]
fn row_errors_that_no_calibrated_rig_has_are_reported() {
    let rig = scene::rectified_rig(SIZE);
    let scene =
        Scene { centre_px: Vector2::new(352.0, 236.0), z_m: 0.5, theta_x_rad: 0.2, theta_y_rad: -0.3, noise: 3.0 };
    let (left, right) = scene.render(&rig);
    let lowered =
        |rows: u32| RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| *right.get_pixel(u, v.saturating_sub(rows)));
    let region = Region::Rectangle { x: 312, y: 196, width: 80, height: 80 };
    let range = SearchRange::new(0.35, 0.8, 1.0).unwrap();
    let meter = RowMeter::new(&rig, Kernels::best()).unwrap();
    for (rows, status, is_reported) in
        [(0, Status::Ok, false), (1, Status::Ok, true), (4, Status::Miscalibrated, false)]
    {
        let right = lowered(rows);
        let measured = meter.measure(&left, &right, None).unwrap();
        assert!((meter.centre_px(&measured) - f64::from(rows)).abs() < 0.1, "{measured:?}");
        let mut estimator = Estimator::new(Method::Direct, &rig, &EstimatorConfig::default()).unwrap();
        let found = estimator.estimate(EstimateRequest::new_target(&left, &right, &region, &range)).unwrap();
        assert_eq!(found.status, status, "{}", found.reason);
        let reported = found.warnings.iter().any(|warning| matches!(warning, EstimateWarning::RowsOff { .. }));
        assert_eq!(reported, is_reported, "{rows}: {:?}", found.warnings);
    }
}

/// In the right image the target is out of range, and a similar object is within the range.
#[test]
fn what_resembles_a_target_outside_the_range_is_not_taken_for_it() {
    let rig = scene::rectified_rig(SIZE);
    let (fb, offset) = (rig.left().pinhole().fx * 0.1, rig.right().pinhole().cx - rig.left().pinhole().cx);
    let other = |x: f64, y: f64| texture(1.2 * y + 40.0, 1.1 * x - 17.0);
    let draw = |at: &dyn Fn(f64, f64) -> f64| {
        RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| Rgb([at(f64::from(u), f64::from(v)).round() as u8; 3]))
    };
    let left = draw(&texture);
    let right = draw(&|u, v| match u {
        180.0.. => texture(u + 112.0, v),
        _ => 0.62 * texture(u + 212.0, v) + 0.38 * other(u, v),
    });
    let region = Region::Rectangle { x: 300, y: 190, width: 80, height: 80 };
    let found = |low_px: f64, high_px: f64| {
        estimate(&rig, (&left, &right), &region, [fb / (high_px + offset), fb / (low_px + offset), 60.0])
    };
    let missed = found(190.0, 235.0);
    assert_eq!(missed.status, Status::Ambiguous, "{}", missed.reason);
    assert!(missed.reason.contains(&format!("{:.0} mm", 1e3 * fb / (112.0 + offset))), "{}", missed.reason);
    let held = found(95.0, 235.0);
    assert_eq!(held.status, Status::Ok, "{}", held.reason);
    assert!((held.pose.unwrap().z_m * (112.0 + offset) / fb - 1.0).abs() < 1e-3);
}

/// The tilt is part of the range, as the depth is: a tilt beyond it by more than its uncertainty was not searched.
#[test]
fn an_answer_tilted_beyond_the_range_is_not_sure() {
    let rig = scene::rectified_rig(SIZE);
    let scene =
        Scene { centre_px: Vector2::new(352.0, 236.0), z_m: 0.5, theta_x_rad: 0.05, theta_y_rad: 0.25, noise: 3.0 };
    let (left, right) = scene.render(&rig);
    let region = Region::Rectangle { x: 312, y: 196, width: 80, height: 80 };
    let found = |tilt_deg: f64| estimate(&rig, (&left, &right), &region, [0.35, 0.8, tilt_deg]);
    let tilt_deg = 0.25_f64.to_degrees();
    for beyond in [found(tilt_deg - 6.0), found(tilt_deg - 3.0)] {
        assert!(matches!(beyond.warnings[..], [EstimateWarning::BeyondTilt { .. }]), "{:?}", beyond.warnings);
        assert_eq!(beyond.status, Status::Ambiguous, "{}", beyond.reason);
        assert!(beyond.reason.contains("raise the limit (SearchRange::tilt_max_rad)"), "{}", beyond.reason);
    }
    for within in [found(tilt_deg - 0.02), found(tilt_deg + 3.0)] {
        assert_eq!(within.status, Status::Ok, "{}", within.reason);
    }
}

/// A flat part of a region that is mostly something else.
#[test]
fn a_plane_that_has_little_of_the_region_is_not_sure() {
    let rig = scene::rectified_rig(SIZE);
    let disparity_px = |u: f64, v: f64| match u {
        ..330.0 => 128.0 + 0.03 * (u - 320.0) + 0.02 * (v - 240.0),
        _ => 131.0 + 3.0 * (((u - 330.0) / 14.0).floor() + 2.0 * ((v - 160.0) / 20.0).floor()).rem_euclid(5.0),
    };
    let (left, right) = pair(disparity_px);
    let found = |width: u32| {
        let region = Region::Rectangle { x: 280, y: 170, width, height: 140 };
        estimate(&rig, (&left, &right), &region, [0.35, 0.8, 60.0])
    };
    let little = found(140);
    assert!(!little.status.depth_is_sure(), "{} {}", little.status, little.reason);
    assert!(little.reason.contains("mark a flat part"), "{}", little.reason);
    assert_eq!(found(50).status, Status::Ok, "{}", found(50).reason);
}

/// Two stripes of texture across a blank sheet, which says nothing of its plane: they have less than two fifths of the region. Such sheets
/// were called not flat.
#[test]
fn blank_parts_do_not_count_against_a_plane() {
    let rig = scene::rectified_rig(SIZE);
    let mut noise = SplitMix64::new(11);
    let mut sheet = |shift_px: &dyn Fn(f64, f64) -> f64| {
        RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
            let (x, v) = (f64::from(u) - shift_px(f64::from(u), f64::from(v)), f64::from(v));
            let printed = (0.0..1.0).contains(&((v + 0.2 * x - 150.0) / 10.0).rem_euclid(9.0));
            let grey = if printed { texture(x, v) } else { 150.0 };
            Rgb([(grey + 1.5 * noise.normal()).round().clamp(0.0, 255.0) as u8; 3])
        })
    };
    let disparity_px = |u: f64, v: f64| 128.0 + 0.03 * (u - 320.0) + 0.02 * (v - 240.0);
    let (left, right) = (sheet(&disparity_px), sheet(&|_, _| 0.0));
    let region = Region::Rectangle { x: 260, y: 190, width: 120, height: 110 };
    let found = estimate(&rig, (&left, &right), &region, [0.35, 0.8, 60.0]);
    assert_eq!(found.status, Status::Ok, "{}", found.reason);
    let (fb, offset) = (rig.left().pinhole().fx * 0.1, rig.right().pinhole().cx - rig.left().pinhole().cx);
    for (u, v) in [(260.0, 190.0), (379.0, 190.0), (260.0, 299.0), (379.0, 299.0)] {
        let shown_px = fb / found.depth_at_pixel(&Vector2::new(u, v)).unwrap() - offset;
        assert!((shown_px - disparity_px(u, v)).abs() < 0.1, "{shown_px} at {u} {v}");
    }
}

/// Three fifths of the region are flat, and the surface bends away from them: the answer is the flat part.
#[test]
fn a_surface_that_is_mostly_flat_is_not_taken_for_a_curved_one() {
    let rig = scene::rectified_rig(SIZE);
    let (left, right) = pair(|u, _| 128.0 + 0.2 * (u - 340.0).max(0.0));
    let region = Region::Rectangle { x: 280, y: 170, width: 100, height: 100 };
    let range = SearchRange::new(0.35, 0.8, 60_f64.to_radians()).unwrap();
    let normal_off_deg = |support_max: f64| {
        let mut config = DirectConfig::default();
        config.cold_start.choice.continued_support_max = support_max;
        let mut estimator = DirectEstimator::new(&rig, config).unwrap();
        let found = estimator.estimate(EstimateRequest::new_target(&left, &right, &region, &range)).unwrap();
        found.pose.unwrap().normal_in_cam_left.angle(&-nalgebra::Vector3::z()).to_degrees()
    };
    let choice = DirectConfig::default().cold_start.choice;
    assert!(normal_off_deg(choice.continued_support_max) < 1.0);
    assert!(normal_off_deg(2.0) > 5.0, "without the rule the plane of least squares is the answer");
}

/// Where pixels are binned, the region resembles another position in the range more than its own, because its shading differs.
/// Fine texture agrees at its own position only. On the coarse level the two are close to each other, or the other one scores
/// far higher.
#[test]
fn what_resembles_a_target_on_coarse_levels_alone_is_not_taken_for_it() {
    let rig = scene::rectified_rig(SIZE);
    let (fb, offset) = (rig.left().pinhole().fx * 0.1, rig.right().pinhole().cx - rig.left().pinhole().cx);
    let shading = |x: f64, y: f64| texture(0.6 * y + 40.0, 0.5 * x - 17.0);
    for (contrast, shaded) in [(40.0, 0.1), (60.0, 0.2)] {
        let fine =
            |x: f64, y: f64, k: f64| contrast * ((2.6 * k * x + 1.9 * y).sin() + (2.1 * x - 2.8 * k * y + k).sin());
        let draw = |at: &dyn Fn(f64, f64) -> f64| {
            RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
                Rgb([at(f64::from(u), f64::from(v)).round().clamp(0.0, 255.0) as u8; 3])
            })
        };
        let left = draw(&|u, v| texture(u, v) + fine(u, v, 1.0));
        let right = draw(&|u, v| match u {
            200.0.. => {
                let x = u + 112.0;
                (1.0 - shaded) * texture(x, v) + shaded * shading(x, v) + fine(x, v, 1.0)
            }
            _ => texture(u + 272.0, v) + fine(u + 272.0, v, 0.9),
        });
        let region = Region::Rectangle { x: 315, y: 150, width: 140, height: 140 };
        let found = estimate(&rig, (&left, &right), &region, [fb / (300.0 + offset), fb / (90.0 + offset), 60.0]);
        let pose = found.pose.unwrap_or_else(|| panic!("no pose: {}", found.reason));
        let off_px = fb / pose.z_m - offset - 112.0;
        assert!(off_px.abs() < 0.5, "{off_px} px off: {} {}", found.status, found.reason);
        assert_eq!(found.status, Status::Ambiguous, "{}", found.reason);
    }
}
