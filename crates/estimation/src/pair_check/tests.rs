//! Check of a pair: exchanged, mirrored, shifted and unrelated images are named.

#![allow(clippy::expect_used, reason = "tests")]

use std::path::Path;

use image::{Rgb, RgbImage};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation_test_support::scene::lattice_hash;
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};

use super::{Exchanged, PairCheck, PairVerdict, check_pair};

const SIZE: ImageSize = ImageSize { width: 320, height: 240 };

/// A rectified rig with principal columns that differ by `doffs_px`.
fn rectified(doffs_px: f64) -> StereoRig {
    let left = Pinhole { fx: 370.0, fy: 370.0, cx: 157.0, cy: 122.0 };
    let right = Pinhole { cx: left.cx + doffs_px, ..left };
    let camera = |pinhole| Camera::new(SIZE, pinhole, Distortion::None).expect("camera");
    StereoRig::new(camera(left), camera(right), Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).expect("rig")
}

/// A rig with rotated cameras, unequal intrinsics and lens distortion; `roll_rad` rotates the right camera about its axis.
fn general(roll_rad: f64) -> StereoRig {
    let camera = |pinhole, k1: f64| {
        let coefficients = [k1, 0.05, 0.001, -0.0008, 0.0];
        Camera::new(SIZE, pinhole, Distortion::BrownConrady5 { coefficients }).expect("camera")
    };
    let left = camera(Pinhole { fx: 370.0, fy: 377.0, cx: 155.0, cy: 125.0 }, -0.22);
    let right = camera(Pinhole { fx: 361.0, fy: 365.0, cx: 165.0, cy: 118.0 }, -0.18);
    let turn = |axis, angle: f64| UnitQuaternion::from_axis_angle(&axis, angle);
    let rotation = turn(Vector3::z_axis(), roll_rad) * turn(Vector3::y_axis(), -0.04) * turn(Vector3::x_axis(), 0.03);
    StereoRig::new(left, right, Pose::from_parts(Vector3::new(-0.11, 0.006, 0.008), rotation)).expect("rig")
}

/// A wall at `1 / (0.9 + 0.5 x / z)` metres with random patches of 14 mm, blended; another `seed` gives another wall.
fn render(rig: &StereoRig, seed: u32) -> (RgbImage, RgbImage) {
    let cam_left_from_cam_right = rig.cam_right_from_cam_left().inverse();
    let normal = Vector3::new(0.5, 0.1, 0.9);
    let side = |camera: &Camera, centre: Vector3<f64>, turn: &dyn Fn(Vector3<f64>) -> Vector3<f64>| {
        RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
            let ray = turn(camera.unproject(&Vector2::new(f64::from(u), f64::from(v))).expect("ray"));
            let hit = centre + ray * ((1.0 - normal.dot(&centre)) / normal.dot(&ray));
            let value = blended(hit.x / 0.014, hit.y / 0.014, seed);
            Rgb([value, value / 2, 255 - value])
        })
    };
    let left = side(rig.left(), Vector3::zeros(), &|ray| ray);
    let right = side(rig.right(), cam_left_from_cam_right.translation_m(), &|ray| {
        cam_left_from_cam_right.transform_vector(&ray)
    });
    (left, right)
}

/// Random values at integer coordinates, interpolated in between.
fn blended(x: f64, y: f64, seed: u32) -> u8 {
    let node = |i: i64, j: i64| f64::from(lattice_hash(i as u32, j as u32, seed) & 0xFF);
    let (i, j) = (x.floor() as i64, y.floor() as i64);
    let (s, t) = (x - x.floor(), y - y.floor());
    let row = |j: i64| node(i, j) * (1.0 - s) + node(i + 1, j) * s;
    (row(j) * (1.0 - t) + row(j + 1) * t).round() as u8
}

fn moved_down(image: &RgbImage, rows: u32) -> RgbImage {
    RgbImage::from_fn(image.width(), image.height(), |u, v| *image.get_pixel(u, v.saturating_sub(rows)))
}

fn check_verdict(rig: &StereoRig, left: &RgbImage, right: &RgbImage, expected: PairVerdict) -> PairCheck {
    let check = check_pair(rig, left, right);
    assert_eq!(check.verdict, expected, "{check:?}");
    check
}

#[test]
fn images_that_fit_are_consistent() {
    for rig in [rectified(0.0), rectified(15.0), general(0.02)] {
        let (left, right) = render(&rig, 1);
        let check = check_verdict(&rig, &left, &right, PairVerdict::Consistent);
        assert!(check.agreeing * 2 > check.patches, "{check:?}");
        assert!(check.share_in_front().is_some_and(|share| share > 0.98), "{check:?}");
        assert!(check.row_offset_px.is_some_and(|offset| offset.abs() < 0.2), "{check:?}");
        assert!(check.row_spread_px.is_some_and(|spread| spread < 0.4), "{check:?}");
    }
}

#[test]
fn exchanged_images_are_swapped() {
    for rig in [rectified(0.0), rectified(10.0), rectified(-30.0), general(0.02)] {
        let (left, right) = render(&rig, 2);
        let check = check_verdict(&rig, &right, &left, PairVerdict::Swapped);
        assert!(check.fitting_exchanged * 2 > check.patches, "{check:?}");
        // On a general rig, swapped matches are also far from their curves.
        let is_behind = check.share_in_front().is_some_and(|share| share < 0.1);
        assert!(is_behind || !rig.is_rectified(), "{check:?}");
    }
}

/// A driver may mirror or turn both images: they look exchanged, and exchanging them would give a mirrored world.
#[test]
fn mirrored_and_turned_images_are_named_beside_exchanged_ones() {
    for rig in [rectified(0.0), rectified(-8.0)] {
        let (left, right) = render(&rig, 6);
        let mirrored = [&left, &right].map(image::imageops::flip_horizontal);
        let turned = [&left, &right].map(image::imageops::rotate180);
        for ([left, right], named, both) in [(mirrored, "mirrored", 0), (turned, "turned by 180 degrees", 1)] {
            let check = check_pair(&rig, &left, &right);
            assert!(
                check.verdict == PairVerdict::Swapped && [check.fits_mirrored, check.fits_turned][both],
                "{check:?}"
            );
            let message = check.accepted().expect_err("exchanged").to_string();
            assert!(message.contains("left and right look exchanged") && message.contains(named), "{message}");
        }
    }
}

/// Principal columns that differ much put the matches in front of the cameras in either order. If the calibration is also wrong, the rows can
/// disagree in one order and agree in the other one by a hair: this is no evidence for an exchange.
#[test]
fn a_wrong_calibration_does_not_look_exchanged() {
    let taken_by = rectified(90.0);
    let (left, right) = render(&taken_by, 3);
    let Pinhole { fx, fy, cx, cy } = *taken_by.left().pinhole();
    for shift_px in [-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5] {
        let wrong = Pinhole { fx: 1.01 * fx, fy: 1.01 * fy, cx, cy: cy + shift_px };
        let camera = Camera::new(SIZE, wrong, Distortion::None).expect("camera");
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.01);
        let pose = Pose::from_parts(taken_by.cam_right_from_cam_left().translation_m(), roll);
        let rig = StereoRig::new(camera, *taken_by.right(), pose).expect("rig");
        let [check, exchanged] = [(&left, &right), (&right, &left)].map(|(left, right)| check_pair(&rig, left, right));
        assert!(check.verdict != PairVerdict::Swapped && exchanged.verdict != PairVerdict::Swapped, "{check:?}");
    }
}

/// A lens or a calibration that is far off leaves hardly a match in the wrong order: the message then counts those.
#[test]
fn exchanged_images_are_reported_with_evidence() {
    let exchanged = |agreeing, behind| Exchanged {
        patches: 90,
        agreeing,
        behind,
        fitting_exchanged: 60,
        fits_mirrored: false,
        fits_turned: false,
    };
    let start = "left and right look exchanged: ";
    let end = ", and once exchanged 60 match in front";
    for ((agreeing, behind), evidence) in [
        ((40, 38), "38 of 40 patches match only behind the cameras"),
        ((3, 0), "only 3 of 90 patches match in this order"),
        ((0, 0), "only 0 of 90 patches match in this order"),
    ] {
        assert_eq!(exchanged(agreeing, behind).to_string(), format!("{start}{evidence}{end}"));
    }
}

/// `u_left - u_right` is negative everywhere although the scene is in front: the sign of the disparity has no meaning.
#[test]
fn depth_is_judged_by_inverse_depth() {
    let rig = rectified(90.0);
    let (left, right) = render(&rig, 3);
    check_verdict(&rig, &left, &right, PairVerdict::Consistent);
}

#[test]
fn principal_columns_of_another_rig_put_matches_behind() {
    let (left, right) = render(&rectified(60.0), 4);
    check_verdict(&rectified(0.0), &left, &right, PairVerdict::Swapped);
    check_verdict(&rectified(-60.0), &left, &right, PairVerdict::BehindCameras);
}

#[test]
fn shifted_rows_are_measured() {
    for (rig, rows) in [(rectified(8.0), 5), (general(0.02), 4)] {
        let (left, right) = render(&rig, 5);
        let check = check_pair(&rig, &left, &moved_down(&right, rows));
        let PairVerdict::RowsDisagree { offset_px } = check.verdict else { unreachable!("{check:?}") };
        assert!((offset_px - f64::from(rows)).abs() < 0.3, "{check:?}");
    }
}

#[test]
fn images_of_two_scenes_are_unrelated() {
    for rig in [rectified(0.0), general(0.02)] {
        check_verdict(&rig, &render(&rig, 6).0, &render(&rig, 7).1, PairVerdict::Unrelated);
    }
}

#[test]
fn without_texture_nothing_is_known() {
    let grey = RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| Rgb([((u + v) / 4) as u8; 3]));
    check_verdict(&rectified(0.0), &grey, &grey, PairVerdict::Unknown);
}

/// Stripes and squares repeat: every patch has rivals, in front of and behind the cameras.
#[test]
fn repeated_texture_is_no_alarm() {
    let squares =
        RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| Rgb([if (u / 12 + v / 12) % 2 == 0 { 40 } else { 200 }; 3]));
    check_verdict(&rectified(0.0), &squares, &squares, PairVerdict::Unknown);
    check_verdict(&rectified(6.0), &squares, &squares, PairVerdict::Unknown);
}

#[test]
fn eyes_with_much_roll_and_wrong_sizes_are_unknown() {
    let rolled = general(0.12);
    let (left, right) = render(&rolled, 8);
    check_verdict(&rolled, &left, &right, PairVerdict::Unknown);
    let cropped = RgbImage::from_pixel(SIZE.width - 1, SIZE.height, Rgb([9; 3]));
    check_verdict(&rectified(0.0), &left, &cropped, PairVerdict::Unknown);
    check_verdict(&rectified(0.0), &cropped, &right, PairVerdict::Unknown);
}

/// Real pairs with chessboards, which repeat, in a room, which does not.
#[test]
fn real_boards_are_consistent_and_exchanged_boards_are_not() {
    let cases = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases");
    // From the calib.json of the cases, which all have the same calibration.
    let (fx, cx, cy, baseline_m) = (493.1571115495963, 314.2452850341797, 247.86862182617188, 0.1203767534844838);
    for case in ["bb201_c0", "bb204_c0", "bb207_c0", "bb209_c0"] {
        let open = |name: &str| image::open(cases.join(case).join(name)).expect("image").to_rgb8();
        let (left, right) = (open("left.png"), open("right.png"));
        let size = ImageSize { width: left.width(), height: left.height() };
        let camera = Camera::new(size, Pinhole { fx, fy: fx, cx, cy }, Distortion::None).expect("camera");
        let pose = Pose::from_translation(Vector3::new(-baseline_m, 0.0, 0.0));
        let rig = StereoRig::new(camera, camera, pose).expect("rig");
        check_verdict(&rig, &left, &right, PairVerdict::Consistent);
        check_verdict(&rig, &right, &left, PairVerdict::Swapped);
    }
}
