//! Undistortion and rectification: first the geometry without pixels, then the pixels.
#![allow(clippy::unwrap_used, reason = "helpers of tests may fail loudly, as tests do")]

use nalgebra::{Point3, Vector2, Vector3};
use pb3dp_geometry::maps::{RemapError, RemapTable};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, Rectification, RectificationError, StereoRig, so3};
use proptest::prelude::*;

const SIZE: ImageSize = ImageSize { width: 320, height: 240 };

fn left_camera() -> Camera {
    let distortion = Distortion::BrownConrady5 { coefficients: [-0.21, 0.06, 0.0011, -0.0007, 0.003] };
    Camera::new(SIZE, Pinhole { fx: 372.5, fy: 368.25, cx: 166.0, cy: 114.5 }, distortion).unwrap()
}

fn right_camera() -> Camera {
    let distortion = Distortion::Equidistant { coefficients: [-0.012, 0.0043, -0.0021, 0.0004] };
    Camera::new(SIZE, Pinhole { fx: 355.0, fy: 361.5, cx: 151.5, cy: 126.0 }, distortion).unwrap()
}

fn rig(rotation_vector_rad: [f64; 3], right_centre_in_cam_left: [f64; 3]) -> StereoRig {
    let rotation = so3::exp(&Vector3::from(rotation_vector_rad));
    let translation_m = -(rotation * Vector3::from(right_centre_in_cam_left));
    StereoRig::new(left_camera(), right_camera(), Pose::from_parts(translation_m, rotation)).unwrap()
}

/// Verged and rolled, with the right camera lower and further ahead.
fn verged() -> StereoRig {
    rig([0.03, -0.09, 0.05], [0.098, 0.011, 0.017])
}

#[test]
fn rectified_rig_is_rectified_and_keeps_the_baseline() {
    let rectification = verged().rectify().unwrap();
    let rig = rectification.rig;
    assert!(rig.is_rectified());
    assert!((rig.baseline_m() - verged().baseline_m()).abs() < 1e-15);
    assert!((rig.left().pinhole().fx - 363.75).abs() < 1e-12, "the mean of both focal lengths");
    assert!((rig.left().pinhole().fy - 364.875).abs() < 1e-12);
    // The rotation moves the right camera's centre onto the x axis.
    let centre = rectification.cam_left_rect_from_cam_left.transform_vector(&verged().right_centre_in_cam_left());
    assert!((centre - Vector3::new(verged().baseline_m(), 0.0, 0.0)).norm() < 1e-15, "{centre}");
    // Each original centre stays at the centre of its rectified image, except for the row, which both share.
    let ray = verged().left().unproject(&Vector2::new(159.5, 119.5)).unwrap();
    let in_rect = rectification.cam_left_rect_from_cam_left.transform_vector(&ray);
    let pixel = rig.left().project(&Point3::from(in_rect)).unwrap();
    assert!((pixel.x - 159.5).abs() < 1e-9 && (pixel.y - 119.5).abs() < 15.0, "{pixel}");
}

#[test]
fn rectifying_a_rectified_rig_changes_nothing() {
    let pinhole = |cx| Pinhole { fx: 372.5, fy: 368.25, cx, cy: 114.5 };
    let camera = |cx| Camera::new(SIZE, pinhole(cx), Distortion::None).unwrap();
    let pose = Pose::from_translation(Vector3::new(-0.12, 0.0, 0.0));
    let before = StereoRig::new(camera(166.0), camera(171.5), pose).unwrap();
    let after = before.rectify().unwrap();
    for (a, b) in [(before.left(), after.rig.left()), (before.right(), after.rig.right())] {
        let (a, b) = (a.pinhole(), b.pinhole());
        let difference =
            Vector2::new(a.fx - b.fx, a.fy - b.fy).amax().max(Vector2::new(a.cx - b.cx, a.cy - b.cy).amax());
        assert!(difference < 1e-10, "{a:?} became {b:?}");
    }
    assert_eq!(after.rig.cam_right_from_cam_left(), before.cam_right_from_cam_left());
    let image: Vec<u8> = (0..320 * 240).map(|i| (i * 7 % 251) as u8).collect();
    let mut remapped = vec![0; image.len()];
    after.right.table().remap_gray(&image, SIZE, &mut remapped).unwrap();
    assert_eq!(remapped, image);
}

#[test]
fn rigs_without_a_common_image_plane_are_refused() {
    // The right camera is 31 degrees from the left axis and looks 62 degrees to the right.
    let along = rig([0.0, -1.08, 0.0], [0.06, 0.0, 0.1]);
    assert!(
        matches!(along.rectify(), Err(RectificationError::BaselineAlongView { .. })),
        "{:?}",
        along.rectify().err()
    );
    let turned = rig([1.3, 0.1, 0.0], [0.1, 0.0, 0.0]);
    assert!(turned.rectify().is_ok(), "37 degrees of pitch each are fine");
    match rig([2.4, 0.1, 0.0], [0.1, 0.0, 0.0]).rectify() {
        Err(RectificationError::Turn { camera: "left", angle_deg }) => assert!((60.0..75.0).contains(&angle_deg)),
        other => panic!("{:?}", other.err()),
    }
}

#[test]
fn undistorted_rig_keeps_pinholes_and_pose() {
    let rig = verged().undistorted();
    assert_eq!(rig.left().distortion(), &Distortion::None);
    assert_eq!(rig.right().distortion(), &Distortion::None);
    assert_eq!(rig.right().pinhole(), verged().right().pinhole());
    assert_eq!(rig.cam_right_from_cam_left(), verged().cam_right_from_cam_left());
}

proptest! {
    #[test]
    fn points_fall_on_equal_rows(
        turn in prop::array::uniform3(-0.25..0.25_f64),
        centre in (0.06..0.3_f64, -0.03..0.03_f64, -0.03..0.03_f64),
        point in (-0.2..0.2_f64, -0.15..0.15_f64, 0.6..3.0_f64),
    ) {
        let rig = rig(turn, [centre.0, centre.1, centre.2]);
        let rectification = rig.rectify().unwrap();
        let in_cam_left = Point3::new(point.0 * point.2, point.1 * point.2, point.2);
        let in_cam_right = rig.cam_right_from_cam_left().transform_point(&in_cam_left);
        // The same via the images: pixel of the original camera, its ray, rotated, pixel of the rectified camera.
        let (Some(left), Some(right)) = (rig.left().project(&in_cam_left), rig.right().project(&in_cam_right)) else {
            return Err(TestCaseError::reject("out of view"));
        };
        let (Ok(left), Ok(right)) = (rig.left().unproject(&left), rig.right().unproject(&right)) else {
            return Err(TestCaseError::reject("out of view"));
        };
        let left = rectification.cam_left_rect_from_cam_left.transform_vector(&left);
        let right = rectification.cam_right_rect_from_cam_right.transform_vector(&right);
        let left = rectification.rig.left().project(&Point3::from(left)).unwrap();
        let right = rectification.rig.right().project(&Point3::from(right)).unwrap();
        prop_assert!((left.y - right.y).abs() < 1e-9, "rows {} and {}", left.y, right.y);
        // The disparity gives the depth along the rectified axis.
        let depth_m = rectification.cam_left_rect_from_cam_left.transform_point(&in_cam_left).z;
        let (l, r) = (rectification.rig.left().pinhole(), rectification.rig.right().pinhole());
        let disparity = (left.x - l.cx) - (right.x - r.cx);
        prop_assert!((disparity * depth_m / (l.fx * rig.baseline_m()) - 1.0).abs() < 1e-9);
    }
}

/// Smooth colours as functions of the viewing ray, so that the image of any camera can be computed.
fn colour(ray: &Vector3<f64>) -> [f64; 3] {
    let (x, y) = (ray.x / ray.z, ray.y / ray.z);
    [
        128.0 + 100.0 * (9.0 * x + 2.0 * y).sin(),
        128.0 + 90.0 * (3.0 * x - 8.0 * y).cos(),
        100.0 + 80.0 * (6.0 * x).sin() * (5.0 * y).cos(),
    ]
}

/// The image of the colours in `camera`, rotated by `world_from_cam`.
fn image(camera: &Camera, turn: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Vec<u8> {
    let size = camera.size();
    let pixels = (0..size.height).flat_map(|v| (0..size.width).map(move |u| (u, v)));
    pixels
        .flat_map(|(u, v)| {
            let ray = camera.unproject(&Vector2::new(f64::from(u), f64::from(v))).unwrap();
            colour(&turn(ray)).map(|value| value.round() as u8)
        })
        .collect()
}

/// Compares two RGB images where `table` is valid; returns the share of valid pixels.
fn check_images(table: &RemapTable, got: &[u8], expected: &[u8]) -> f64 {
    let mask = table.valid_mask();
    for (i, valid) in mask.iter().enumerate() {
        for channel in 0..3 {
            let (a, b) = (got[3 * i + channel], expected[3 * i + channel]);
            if *valid == 0 {
                assert_eq!(a, 0);
            } else {
                assert!(a.abs_diff(b) <= 2, "pixel {i} channel {channel}: {a}, expected {b}");
            }
        }
    }
    mask.iter().filter(|valid| **valid == 255).count() as f64 / mask.len() as f64
}

#[test]
fn undistorted_image_is_the_image_of_the_ideal_camera() {
    for camera in [left_camera(), right_camera()] {
        let table = RemapTable::undistort(&camera);
        let mut got = vec![1; 3 * 320 * 240];
        table.remap_rgb(&image(&camera, |ray| ray), SIZE, &mut got).unwrap();
        let valid = check_images(&table, &got, &image(&camera.undistorted(), |ray| ray));
        assert!(valid > 0.98, "{valid}");
    }
}

#[test]
fn rectified_image_is_the_image_of_the_rectified_camera() {
    let rectification = verged().rectify().unwrap();
    let mut got = vec![1; 3 * 320 * 240];
    rectification.left.table().remap_rgb(&image(verged().left(), |ray| ray), SIZE, &mut got).unwrap();
    let back = rectification.cam_left_rect_from_cam_left.inverse();
    let expected = image(rectification.rig.left(), |ray| back.transform_vector(&ray));
    assert!(check_images(&rectification.left.table(), &got, &expected) > 0.8);
    rectification.right.table().remap_rgb(&image(verged().right(), |ray| ray), SIZE, &mut got).unwrap();
    let back = rectification.cam_right_rect_from_cam_right.inverse();
    let expected = image(rectification.rig.right(), |ray| back.transform_vector(&ray));
    assert!(check_images(&rectification.right.table(), &got, &expected) > 0.8);
}

#[test]
fn weights_corners_and_edges_by_hand() {
    let source_size = ImageSize { width: 3, height: 2 };
    let source = [10, 20, 40, 100, 200, 250];
    let at = |x: f64, y: f64| {
        let table = RemapTable::from_fn(ImageSize { width: 1, height: 1 }, source_size, |_| Some(Vector2::new(x, y)));
        let (mut bilinear, mut nearest) = ([7], [7]);
        table.remap_gray(&source, source_size, &mut bilinear).unwrap();
        table.remap_mask(&source, source_size, &mut nearest).unwrap();
        (bilinear[0], nearest[0], table.source(0, 0).is_some())
    };
    assert_eq!(at(0.25, 0.75), (97, 100, true), "0.25 * (0.75 * 10 + 0.25 * 20) + 0.75 * (0.75 * 100 + 0.25 * 200)");
    assert_eq!(at(2.0, 1.0), (250, 250, true));
    assert_eq!(at(1.5, 0.0), (30, 40, true));
    assert_eq!(at(0.0, 0.0), (10, 10, true));
    assert_eq!(at(-0.01, 0.0), (0, 0, false));
    assert_eq!(at(2.01, 1.0), (0, 0, false));
    assert_eq!(at(1.0, 1.01), (0, 0, false));
    assert_eq!(at(f64::NAN, 0.0), (0, 0, false));
}

#[test]
fn table_tells_its_source_to_a_256th() {
    let table = RemapTable::undistort(&left_camera());
    for (u, v) in [(160, 120), (40, 30), (300, 200)] {
        let ray = left_camera().undistorted().unproject(&Vector2::new(f64::from(u), f64::from(v))).unwrap();
        let expected = left_camera().project(&Point3::from(ray)).unwrap();
        assert!((table.source(u, v).unwrap() - expected).amax() <= 0.5 / 256.0 + 1e-12);
    }
    assert_eq!(table.source(320, 0), None);
}

#[test]
fn wrong_sizes_are_refused_and_leave_the_destination_alone() {
    let table = RemapTable::undistort(&left_camera());
    let mut destination = vec![9; 320 * 240];
    let other = ImageSize { width: 640, height: 480 };
    let error = table.remap_gray(&[0; 640 * 480], other, &mut destination).unwrap_err();
    assert_eq!(error, RemapError::SourceSize { actual: other, expected: SIZE });
    assert!(error.to_string().contains("640x480") && error.to_string().contains("320x240"), "{error}");
    let error = table.remap_mask(&[0; 5], SIZE, &mut destination).unwrap_err();
    assert_eq!(error, RemapError::Length { buffer: "source", actual: 5, expected: 76800 });
    let error = table.remap_rgb(&vec![0; 3 * 76800], SIZE, &mut destination).unwrap_err();
    assert_eq!(error, RemapError::Length { buffer: "destination", actual: 76800, expected: 3 * 76800 });
    assert!(destination.iter().all(|byte| *byte == 9));
}

fn inside(pixel: &Vector2<f64>, size: ImageSize) -> bool {
    pixel.min() >= -0.5 && pixel.x < f64::from(size.width) - 0.5 && pixel.y < f64::from(size.height) - 0.5
}

/// Checks that the covering images show every raw pixel up to 69 degrees from the axis, with the rays of the plain ones.
fn check_covering(rig: &StereoRig) -> Rectification {
    let plain = rig.rectify().unwrap();
    let covering = plain.covering_field().unwrap();
    for (map, plain) in [(&covering.left, &plain.left), (&covering.right, &plain.right)] {
        let first = map.destination(&Vector2::new(150.0, 110.0)).unwrap()
            - plain.destination(&Vector2::new(150.0, 110.0)).unwrap();
        let whole = first.map(|px| (px / 64.0).round() * 64.0);
        assert!((first - whole).norm() < 1e-9 && first.min() > -1e-9, "{first}");
        for (u, v) in
            (0..240).step_by(7).chain([239]).flat_map(|v| (0..320).step_by(9).chain([319]).map(move |u| (u, v)))
        {
            let raw = Vector2::new(f64::from(u), f64::from(v));
            let Some(pixel) = map.destination(&raw) else { continue };
            let camera = if std::ptr::eq(map, &covering.left) { covering.rig.left() } else { covering.rig.right() };
            // Images grow by at most their size, in steps of 64 pixels.
            let own = plain.destination(&raw).unwrap();
            let near = own.x.abs().max((own.x - 320.0).abs()) < 639.0 && own.y.abs().max((own.y - 240.0).abs()) < 431.0;
            if near && camera.unproject(&pixel).unwrap().xy().amax() < 69.0_f64.to_radians().tan() {
                assert!(inside(&pixel, map.size()), "{raw} {pixel} {:?}", map.size());
            }
            assert!((map.source(&pixel).unwrap() - raw).norm() < 1e-6);
        }
    }
    assert_eq!(covering.left.size(), covering.right.size());
    let (left, right) = (covering.rig.left().pinhole(), covering.rig.right().pinhole());
    assert_eq!((left.fx, left.fy, left.cy), (right.fx, right.fy, right.cy));
    covering
}

#[test]
fn covering_images_show_the_whole_field() {
    let camera = |fx: f64, distortion| {
        Camera::new(SIZE, Pinhole { fx, fy: 0.98 * fx, cx: 161.3, cy: 116.2 }, distortion).unwrap()
    };
    let fisheye = Distortion::Equidistant { coefficients: [-0.01, 0.004, -0.002, 4e-4] };
    let brown = Distortion::BrownConrady5 { coefficients: [-0.24, 0.09, 0.0011, -0.0007, -0.01] };
    let rotation = so3::exp(&Vector3::new(0.01, -0.03, 0.02));
    let beside = Pose::from_parts(Vector3::new(-0.1, 0.004, 0.003), rotation);
    let below = Pose::from_parts(Vector3::new(0.004, -0.1, 0.003), rotation);
    for (left, right) in [(camera(330.0, brown), camera(322.0, brown)), (camera(150.0, fisheye), camera(140.0, brown))]
    {
        for pose in [beside, below] {
            check_covering(&StereoRig::new(left, right, pose).unwrap());
        }
    }
    // The limits: three times the size, and nothing for rectified images.
    let wide = camera(80.0, fisheye);
    let size = check_covering(&StereoRig::new(wide, wide, beside).unwrap()).left.size();
    assert!(size.width <= 3 * SIZE.width && size.height <= 3 * SIZE.height, "{size:?}");
    let parallel = Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0));
    let rectified = StereoRig::new(camera(330.0, Distortion::None), camera(330.0, Distortion::None), parallel).unwrap();
    let rectified = rectified.rectify().unwrap();
    assert_eq!(rectified.covering_field().unwrap(), rectified);
}
