//! The renderer is the ground truth for sub-pixel stereo: positions in its images are compared with the camera model.
#![allow(clippy::unwrap_used, clippy::panic)] // clippy allows them in #[test] functions only, not in their helpers.

use crate::support::{distorted_rig, poses, rectified_rig, render, square_scene, turned};
use image::RgbImage;
use nalgebra::{Point3, Vector2};
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Camera, Pose};
use pb3dp_sim::noise::ValueNoise;
use pb3dp_sim::sensor::SensorConfig;

/// Spacing of the marks, metres.
const MARK_SPACING_M: f64 = 0.025;

/// A square lattice of soft bright marks on black.
fn marks(x: f64, y: f64) -> [f64; 3] {
    let offset = |value: f64| value - (value / MARK_SPACING_M).round() * MARK_SPACING_M;
    let squared = (offset(x).powi(2) + offset(y).powi(2)) / 0.0016f64.powi(2);
    [250.0 * (-0.5 * squared).exp(); 3]
}

/// Centroid of the light within 8 px of a position.
fn centre_of_light(image: &RgbImage, near: &Vector2<f64>) -> Vector2<f64> {
    let (mut sum, mut light) = (Vector2::zeros(), 0.0);
    for row in (near.y - 8.0).round() as u32..=(near.y + 8.0).round() as u32 {
        for column in (near.x - 8.0).round() as u32..=(near.x + 8.0).round() as u32 {
            let grey = f64::from(image.get_pixel(column, row)[1]);
            sum += Vector2::new(f64::from(column), f64::from(row)) * grey;
            light += grey;
        }
    }
    sum / light
}

/// Expected centroid of the light of a mark: the light of the plane projected piece by piece. (The centroid of a tilted mark is
/// not the projection of its centre: its nearer half appears larger. The image area of a piece is proportional to depth^-3.)
fn expected_centre(
    mark: &Point3<f64>,
    camera: &Camera,
    to_cam: &impl Fn(&Point3<f64>) -> Point3<f64>,
) -> Option<Vector2<f64>> {
    let (mut sum, mut light) = (Vector2::zeros(), 0.0);
    for (i, j) in (-12..=12).flat_map(|j| (-12..=12).map(move |i| (i, j))) {
        let (dx, dy) = (f64::from(i) * 0.0004, f64::from(j) * 0.0004);
        let in_cam = to_cam(&Point3::new(mark.x + dx, mark.y + dy, 0.0));
        let weight = marks(dx, dy)[0] / in_cam.z.powi(3);
        sum += camera.project(&in_cam)? * weight;
        light += weight;
    }
    Some(sum / light)
}

/// Compares all marks in the image with their projections; returns the number of marks.
fn check_marks(image: &RgbImage, camera: &Camera, to_cam: impl Fn(&Point3<f64>) -> Point3<f64>) -> usize {
    let (mut count, mut mean_error) = (0, Vector2::zeros());
    for (i, j) in (-8..=8).flat_map(|j| (-8..=8).map(move |i| (i, j))) {
        let mark = Point3::new(f64::from(i) * MARK_SPACING_M, f64::from(j) * MARK_SPACING_M, 0.0);
        let Some(expected) = expected_centre(&mark, camera, &to_cam) else { continue };
        let inside = |value: f64, size: u32| value > 10.0 && value < f64::from(size) - 11.0;
        if !(inside(expected.x, 640) && inside(expected.y, 480)) {
            continue;
        }
        let error = centre_of_light(image, &expected) - expected;
        assert!(error.norm() < 0.02, "mark {i}, {j} at {expected}: error {error}");
        mean_error += error;
        count += 1;
    }
    mean_error /= count as f64;
    assert!(mean_error.norm() < 0.002, "mean error of all marks {mean_error}");
    count
}

#[test]
fn marks_lie_where_the_cameras_project_them() {
    for rig in [rectified_rig(), distorted_rig()] {
        let cam_left_from_target = turned([0.03, -0.02, 0.55], [0.06, -0.09, 0.13]);
        let scene = square_scene(0.45, 10, marks);
        let [left, right] = render(scene, rig, &SensorConfig::IDEAL, &poses(cam_left_from_target));
        let in_left = |p: &Point3<f64>| cam_left_from_target.transform_point(p);
        let checked = check_marks(&left, rig.left(), in_left);
        assert!(checked > 150, "{checked}");
        let in_right = |p: &Point3<f64>| rig.cam_right_from_cam_left().transform_point(&in_left(p));
        let checked = check_marks(&right, rig.right(), in_right);
        assert!(checked > 120, "{checked}");
    }
}

/// Area and centroid of a polygon.
fn area_and_centroid(corners: &[Vector2<f64>]) -> (f64, Vector2<f64>) {
    let (mut area, mut moments) = (0.0, Vector2::zeros());
    for (p, q) in corners.iter().zip(corners.iter().cycle().skip(1)) {
        let cross = p.perp(q);
        area += cross / 2.0;
        moments += (p + q) * (cross / 6.0);
    }
    (area.abs(), moments / area)
}

#[test]
fn edges_cover_their_exact_share_of_the_pixels() {
    let rig = rectified_rig();
    for step in 0..12 {
        let shift = f64::from(step) * 0.731e-4;
        let turn = if step % 2 == 0 { [0.0; 3] } else { [0.05, 0.08, 0.02 * f64::from(step)] };
        let cam_left_from_target: Pose<CamLeft, Target> = turned([0.01 + shift, -0.02 + 1.3 * shift, 0.5], turn);
        let scene = square_scene(0.1, 3, |_, _| [240.0; 3]);
        let [left, _] = render(scene, rig, &SensorConfig::IDEAL, &poses(cam_left_from_target));
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| {
            let corner = cam_left_from_target.transform_point(&Point3::new(0.05 * x, 0.05 * y, 0.0));
            rig.left().project(&corner).unwrap()
        });
        let (area, centroid) = area_and_centroid(&corners);
        let (mut covered, mut moments) = (0.0, Vector2::zeros());
        for (column, row, pixel) in left.enumerate_pixels() {
            let share = (f64::from(pixel[0]) - 96.0) / (240.0 - 96.0);
            covered += share;
            moments += Vector2::new(f64::from(column), f64::from(row)) * share;
        }
        // 0.03 px along a perimeter of 590 px.
        assert!((covered - area).abs() < 0.03 * 592.0, "step {step}: {covered} px for {area}");
        let error = moments / covered - centroid;
        // Sixteen samples locate an edge along a row or column to 1/32 px, and slanted edges much more accurately.
        let limit = if step % 2 == 0 { 0.032 } else { 0.01 };
        assert!(error.amax() < limit, "step {step}: position error of the square {error}");
    }
}

/// Zero-mean normalised correlation of two square windows (side 2 `HALF` + 1) of the green channel.
fn correlation(a: &RgbImage, b: &RgbImage, in_a: (i64, i64), in_b: (i64, i64)) -> f64 {
    const HALF: i64 = 12;
    let window = |image: &RgbImage, centre: (i64, i64)| {
        let mut values = Vec::new();
        for (dx, dy) in (-HALF..=HALF).flat_map(|dy| (-HALF..=HALF).map(move |dx| (dx, dy))) {
            values.push(f64::from(image.get_pixel((centre.0 + dx) as u32, (centre.1 + dy) as u32)[1]));
        }
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter_mut().for_each(|value| *value -= mean);
        values
    };
    let (a, b) = (window(a, in_a), window(b, in_b));
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    dot(&a, &b) / (dot(&a, &a) * dot(&b, &b)).sqrt()
}

/// Disparity at a left pixel: best whole-pixel correlation, refined by a parabola through its neighbours.
///
/// Computed from left to right and back, because the parabola is biased towards the side on which the window gains contrast, and
/// that side depends on the direction.
fn measured_disparity(left: &RgbImage, right: &RgbImage, pixel: (i64, i64), around: f64) -> f64 {
    let refine = |score: &dyn Fn(i64) -> f64| {
        let first = around.round() as i64 - 6;
        let best = (first..first + 13).max_by(|&a, &b| score(a).total_cmp(&score(b))).unwrap();
        let (before, peak, after) = (score(best - 1), score(best), score(best + 1));
        best as f64 + 0.5 * (before - after) / (before - 2.0 * peak + after)
    };
    let there = refine(&|disparity| correlation(left, right, pixel, (pixel.0 - disparity, pixel.1)));
    let column = pixel.0 - there.round() as i64;
    let back = refine(&|disparity| correlation(right, left, (column, pixel.1), (column + disparity, pixel.1)));
    (there + back) / 2.0
}

#[test]
fn disparity_is_focal_length_times_baseline_over_depth() {
    let noise = ValueNoise::new(77);
    let textured = |x: f64, y: f64| [128.0 + 240.0 * (noise.fractal(x / 0.006, y / 0.006, 2) - 0.5); 3];
    let rig = rectified_rig();
    let mut errors = Vec::new();
    // Parallel planes: a correlation window has one disparity.
    for depth in [0.402, 0.455, 0.5, 0.617] {
        let cam_left_from_target = turned([0.02, 0.01, depth], [0.0, 0.0, 0.1]);
        let scene = square_scene(0.5, 10, textured);
        let [left, right] = render(scene, rig, &SensorConfig::IDEAL, &poses(cam_left_from_target));
        for pixel in [(260, 100), (330, 150), (391, 240), (430, 310), (300, 355), (473, 131)] {
            let expected = 740.0 * 0.1 / depth;
            let error = measured_disparity(&left, &right, pixel, expected) - expected;
            assert!(error.abs() < 0.02, "depth {depth}, pixel {pixel:?}: {expected} px, error {error}");
            errors.push(error);
        }
    }
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    assert!(mean.abs() < 0.005, "mean disparity error {mean} px");
}
