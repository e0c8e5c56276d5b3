//! Lens models compared with OpenCV and with finite differences, and round trips over the whole image.
#![allow(clippy::unwrap_used, reason = "helpers of tests may fail loudly, as tests do")]

use nalgebra::{Point3, Vector2};
use pb3dp_geometry::{Camera, CameraError, Distortion, ImageSize, Pinhole};
use proptest::prelude::*;

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
const BROWN_5: Distortion = Distortion::BrownConrady5 { coefficients: [-0.31, 0.12, 0.0011, -0.0007, -0.018] };
const BROWN_8: Distortion =
    Distortion::BrownConrady8 { coefficients: [0.42, -0.21, -0.0009, 0.0013, 0.05, 0.71, -0.13, 0.02] };
const EQUIDISTANT: Distortion = Distortion::Equidistant { coefficients: [-0.012, 0.0043, -0.0021, 0.0004] };

fn camera(distortion: Distortion) -> Camera {
    Camera::new(SIZE, Pinhole { fx: 742.5, fy: 738.25, cx: 331.25, cy: 228.5 }, distortion).unwrap()
}

/// A short lens: the corners of the image are 79 degrees from the axis.
fn fisheye() -> Camera {
    Camera::new(SIZE, Pinhole { fx: 285.5, fy: 286.25, cx: 331.25, cy: 228.5 }, EQUIDISTANT).unwrap()
}

fn check_pixels(camera: &Camera, points_in_cam: &[[f64; 3]; 4], pixels: &[[f64; 2]; 4]) {
    for (point, expected) in points_in_cam.iter().zip(pixels) {
        let got = camera.project(&Point3::from(*point)).unwrap();
        let error = (got - Vector2::from(*expected)).norm();
        assert!(error < 1e-9, "{:?}: {point:?} at {got:?}, expected {expected:?}", camera.distortion());
    }
}

/// Found by fuzzing: the pixel was not a number.
#[test]
fn points_without_a_finite_pixel_are_not_imaged() {
    for distortion in [Distortion::None, EQUIDISTANT] {
        let camera = camera(distortion);
        for (x, z) in [(f64::INFINITY, 1.0), (f64::MAX, 1e-300), (f64::NAN, 1.0), (1.0, f64::NAN)] {
            let point = Point3::new(x, 0.1, z);
            assert_eq!(camera.project(&point), None, "{point} {distortion:?}");
            assert_eq!(camera.project_with_jacobian(&point), None, "{point} {distortion:?}");
        }
    }
}

/// Golden values: OpenCV 4.14.0 (PyPI `opencv-python-headless` 4.14.0.94), with `z = np.zeros(3)`, `K` and the
/// coefficients `D` as above: `cv2.projectPoints(points, z, z, K, D)[0]`, and for the fisheye
/// `cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), z, z, K, D)[0]`.
#[test]
fn projection_agrees_with_opencv() {
    let points = [[0.11, -0.07, 0.52], [-0.21, 0.13, 0.48], [0.003, 0.002, 0.9], [0.30, 0.22, 0.75]];
    let five = [
        [485.2042094852036, 131.12029522947768],
        [29.913636825730407, 414.10411640585176],
        [333.72497989452097, 230.1405607912064],
        [607.5720913349455, 430.2693794007145],
    ];
    check_pixels(&camera(BROWN_5), &points, &five);
    let eight = [
        [485.71333267372427, 130.76440684044934],
        [29.73148547203624, 414.06731186046875],
        [333.7250155223025, 230.1405449122514],
        [609.3634923058728, 430.9458606400105],
    ];
    check_pixels(&camera(BROWN_8), &points, &eight);
    let points = [[0.11, -0.07, 0.52], [-0.91, 0.53, 0.48], [0.003, 0.002, 0.9], [2.30, 1.22, 0.75]];
    let wide = [
        [390.38231327991696, 190.77149411411125],
        [52.576135718007095, 391.2309275606006],
        [332.2016613922149, 229.13610758557272],
        [651.9109937107737, 399.0365651848701],
    ];
    check_pixels(&fisheye(), &points, &wide);
}

#[test]
fn every_pixel_of_the_image_goes_there_and_back() {
    let cameras = [camera(Distortion::None), camera(BROWN_5), camera(BROWN_8), camera(EQUIDISTANT), fisheye()];
    for camera in cameras {
        for (u, v) in (0..=640).step_by(8).flat_map(|u| (0..=480).step_by(8).map(move |v| (u, v))) {
            let pixel = Vector2::new(f64::from(u) - 0.5, f64::from(v) - 0.5);
            let ray = camera.unproject(&pixel).unwrap();
            let back = camera.project(&Point3::from(ray * 0.7)).unwrap();
            assert!((back - pixel).norm() < 1e-9, "{:?}: {pixel:?} -> {ray:?} -> {back:?}", camera.distortion());
        }
    }
}

/// A strong barrel lens: the radial polynomial `r - 0.4 r^3` has its maximum at `r = sqrt(1 / 1.2)`, with the value `2 / 3 *
/// sqrt(1 / 1.2)` = 0.6086.
#[test]
fn pixels_past_the_fold_are_refused_by_name_and_points_past_it_are_not_imaged() {
    let distortion = Distortion::BrownConrady5 { coefficients: [-0.4, 0.0, 0.0, 0.0, 0.0] };
    let pinhole = Pinhole { fx: 400.0, fy: 400.0, cx: 320.0, cy: 240.0 };
    let camera = Camera::new(SIZE, pinhole, distortion).unwrap();
    let fold = (1.0_f64 / 1.2).sqrt();
    assert!(camera.project(&Point3::new(fold - 1e-6, 0.0, 1.0)).is_some());
    assert_eq!(camera.project(&Point3::new(fold + 1e-6, 0.0, 1.0)), None);
    let last_u = 320.0 + 400.0 * fold * 2.0 / 3.0;
    let ray = camera.unproject(&Vector2::new(last_u - 0.01, 240.0)).unwrap();
    assert!(ray.x < fold && ray.x > 0.98 * fold, "{ray:?}");
    let error = camera.unproject(&Vector2::new(last_u + 0.01, 240.0)).unwrap_err();
    assert_eq!(error, CameraError::NotInvertible { u: last_u + 0.01, v: 240.0 });
    assert!(error.to_string().contains(&format!("pixel ({}, 240)", last_u + 0.01)), "{error}");
}

#[test]
fn rays_of_ninety_degrees_and_pixels_that_are_no_numbers_are_refused() {
    let pinhole = Pinhole { fx: 285.5, fy: 286.25, cx: 331.25, cy: 228.5 };
    let ideal = Camera::new(SIZE, pinhole, Distortion::Equidistant { coefficients: [0.0; 4] }).unwrap();
    let limit_px = std::f64::consts::FRAC_PI_2 * pinhole.fx;
    assert!(ideal.unproject(&Vector2::new(pinhole.cx + limit_px - 0.1, pinhole.cy)).is_ok());
    assert!(ideal.unproject(&Vector2::new(pinhole.cx + limit_px + 0.1, pinhole.cy)).is_err());
    for camera in [ideal, camera(Distortion::None), camera(BROWN_5), camera(BROWN_8)] {
        assert!(camera.unproject(&Vector2::new(f64::NAN, 3.0)).is_err());
        assert_eq!(camera.project(&Point3::new(f64::NAN, 0.1, 1.0)), None);
        assert_eq!(camera.project(&Point3::new(0.1, 0.1, -1.0)), None);
    }
}

#[test]
fn bad_parameters_are_refused_by_name() {
    let good = Pinhole { fx: 742.5, fy: 738.25, cx: 331.25, cy: 228.5 };
    let name = |size, pinhole, distortion| match Camera::new(size, pinhole, distortion) {
        Err(CameraError::Parameter { name, .. }) => name,
        other => panic!("not refused: {other:?}"),
    };
    assert_eq!(name(SIZE, Pinhole { fx: -1.0, ..good }, BROWN_5), "fx");
    assert_eq!(name(SIZE, Pinhole { fy: f64::INFINITY, ..good }, BROWN_5), "fy");
    assert_eq!(name(SIZE, Pinhole { cy: f64::NAN, ..good }, BROWN_5), "cy");
    assert_eq!(name(ImageSize { width: 640, height: 0 }, good, BROWN_5), "height");
    assert_eq!(name(ImageSize { width: 1 << 20, height: 480 }, good, BROWN_5), "width");
    let bad = Distortion::BrownConrady8 { coefficients: [0.0, 0.0, 0.0, 0.0, 0.0, f64::NAN, 0.0, 0.0] };
    assert_eq!(name(SIZE, good, bad), "k4");
    assert_eq!(name(SIZE, good, Distortion::Equidistant { coefficients: [0.0, f64::INFINITY, 0.0, 0.0] }), "k2");
}

/// Coefficients typical of real lenses, up to a strong wide-angle barrel and a moderate pincushion: k2 is proportional to the
/// square of k1, and a rational model has a numerator and a divisor of similar size.
fn lens() -> impl Strategy<Value = Camera> {
    let pinhole = (600.0..900.0_f64, 0.97..1.03_f64, 290.0..350.0_f64, 210.0..270.0_f64);
    let brown = (-0.35..0.15_f64, 0.8..1.5_f64, -0.002..0.002_f64, -0.002..0.002_f64, -0.01..0.03_f64);
    let rational = prop::array::uniform3(-0.02..0.02_f64);
    let equidistant = (-0.05..0.05_f64, prop::array::uniform3(-0.003..0.003_f64));
    (pinhole, brown, rational, equidistant, 0..3).prop_map(|(p, (k1, ratio, p1, p2, k3), [k4, k5, k6], e, kind)| {
        let k2 = ratio * k1 * k1;
        let mut pinhole = Pinhole { fx: p.0, fy: p.0 * p.1, cx: p.2, cy: p.3 };
        let distortion = match kind {
            0 => Distortion::BrownConrady5 { coefficients: [k1, k2, p1, p2, k3] },
            1 => Distortion::BrownConrady8 { coefficients: [k1 + 0.4, k2, p1, p2, k3, k4 + 0.4, k5, k6] },
            _ => {
                pinhole.fx *= 0.6;
                pinhole.fy *= 0.6;
                Distortion::Equidistant { coefficients: [e.0, e.1[0], e.1[1], e.1[2]] }
            }
        };
        Camera::new(SIZE, pinhole, distortion).unwrap()
    })
}

/// The same lens with one coefficient changed.
fn moved(lens: &Distortion, index: usize, step: f64) -> Distortion {
    let mut lens = *lens;
    match &mut lens {
        Distortion::None => {}
        Distortion::BrownConrady5 { coefficients } => coefficients[index] += step,
        Distortion::BrownConrady8 { coefficients } => coefficients[index] += step,
        Distortion::Equidistant { coefficients } => coefficients[index] += step,
    }
    lens
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn unproject_then_project_returns_the_pixel(
        camera in lens(), u in -0.5..639.5_f64, v in -0.5..479.5_f64, z in 0.1..9.0_f64,
    ) {
        let pixel = Vector2::new(u, v);
        let ray = camera.unproject(&pixel).unwrap();
        let back = camera.project(&Point3::from(ray * z)).unwrap();
        prop_assert!((back - pixel).norm() < 1e-9, "{} px", (back - pixel).norm());
    }

    #[test]
    fn project_then_unproject_returns_the_ray(camera in lens(), x in -0.35..0.35_f64, y in -0.25..0.25_f64) {
        let pixel = camera.project(&Point3::new(x, y, 1.0)).unwrap();
        let ray = camera.unproject(&pixel).unwrap();
        prop_assert!((ray.xy() - Vector2::new(x, y)).norm() < 1e-11);
    }

    #[test]
    fn jacobian_agrees_with_finite_differences(
        camera in lens(), x in -0.3..0.3_f64, y in -0.2..0.2_f64, z in 0.4..2.0_f64,
    ) {
        let point = Point3::new(x * z, y * z, z);
        let (pixel, jacobian) = camera.project_with_jacobian(&point).unwrap();
        prop_assert_eq!(Some(pixel), camera.project(&point));
        for axis in 0..3 {
            let step = 1e-5;
            let (mut ahead, mut behind) = (point, point);
            ahead[axis] += step;
            behind[axis] -= step;
            let slope = (camera.project(&ahead).unwrap() - camera.project(&behind).unwrap()) / (2.0 * step);
            prop_assert!((slope - jacobian.column(axis)).amax() < 2e-5 * (1.0 + jacobian.amax()), "axis {}", axis);
        }
    }

    #[test]
    fn derivatives_by_coefficients_agree_with_finite_differences(
        camera in lens(), x in -0.5..0.5_f64, y in -0.4..0.4_f64,
    ) {
        let (xy, lens) = (Vector2::new(x, y), *camera.distortion());
        let derivatives = lens.distort_by_coefficients(&xy);
        prop_assert_eq!(derivatives.len(), lens.coefficients().len());
        for (index, derivative) in derivatives.iter().enumerate() {
            let step = 1e-5;
            let slope = (moved(&lens, index, step).distort(&xy) - moved(&lens, index, -step).distort(&xy)) / (2.0 * step);
            prop_assert!((slope - derivative).amax() < 1e-9, "{:?} {}: {} {}", lens, index, slope, derivative);
        }
    }

    #[test]
    fn whatever_the_coefficients_a_ray_is_right_or_refused(
        c in prop::array::uniform8(-5.0..5.0_f64), kind in 0..3, u in -100.0..740.0_f64, v in -100.0..580.0_f64,
    ) {
        let distortion = match kind {
            0 => Distortion::BrownConrady5 { coefficients: [c[0], c[1], c[2], c[3], c[4]] },
            1 => Distortion::BrownConrady8 { coefficients: c },
            _ => Distortion::Equidistant { coefficients: [c[0], c[1], c[2], c[3]] },
        };
        let camera = camera(distortion);
        if let Ok(ray) = camera.unproject(&Vector2::new(u, v)) {
            let back = camera.project(&Point3::from(ray)).unwrap();
            prop_assert!((back - Vector2::new(u, v)).norm() < 2e-9);
        }
    }
}
