//! A painted plane that moves: ray-cast images with nine samples per pixel, and paints that repeat or lack a direction.
#![allow(dead_code, clippy::expect_used, reason = "shared by tests that use different parts")]

use image::{Rgb, RgbImage};
use nalgebra::{Isometry3, Point3, Vector2};
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Camera, Distortion, Pose, StereoRig};

use crate::moving_plane::{RADIUS_M, SIZE, noise};

/// Noise of a channel, grey levels.
const NOISE: f64 = 1.5;
/// Samples of a pixel in a row and in a column: what a sensor integrates.
const SAMPLES: u32 = 3;
/// Farther from the centre of the target, pixels, one sample is enough: nothing there is compared.
const FINE_PX: f64 = 80.0;

/// Grey level at a point of the target, metres; `None`: the wall behind.
pub type Paint = fn(f64, f64) -> Option<f64>;

fn image(
    camera: &Camera,
    cam_from_left: &Isometry3<f64>,
    pose: &Pose<CamLeft, Target>,
    paint: Paint,
    stream: u32,
) -> RgbImage {
    let left_from_cam = cam_from_left.inverse();
    let to_target = pose.inverse().isometry() * left_from_cam;
    let origin = to_target * Point3::origin();
    let centre = camera.project(&(cam_from_left * pose.transform_point(&Point3::origin()))).expect("in front");
    // Without distortion a ray of depth 1 is linear in its pixel.
    assert_eq!(*camera.distortion(), Distortion::None);
    let ray_at = |u: f64, v: f64| to_target * camera.unproject(&Vector2::new(u, v)).expect("ray");
    let first = ray_at(0.0, 0.0);
    let (across, down) = (ray_at(1.0, 0.0) - first, ray_at(0.0, 1.0) - first);
    RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| {
        let is_near = (Vector2::new(f64::from(u), f64::from(v)) - centre).norm() < FINE_PX;
        let samples = if is_near { SAMPLES } else { 1 };
        let mut sum = 0.0;
        for sample in 0..samples * samples {
            let [x, y] = [(u, sample % samples), (v, sample / samples)]
                .map(|(px, part)| f64::from(px) + (f64::from(part) + 0.5) / f64::from(samples) - 0.5);
            let ray = first + across * x + down * y;
            let at = origin - ray * (origin.z / ray.z);
            sum += paint(at.x, at.y).unwrap_or(60.0);
        }
        let grey = sum / f64::from(samples * samples);
        Rgb(std::array::from_fn(|c| {
            (grey + NOISE * noise(u, v, stream * 3 + c as u32)).round().clamp(0.0, 255.0) as u8
        }))
    })
}

/// Both images of the plane at a pose; the frame selects the noise.
pub fn pair(rig: &StereoRig, pose: &Pose<CamLeft, Target>, paint: Paint, frame: u32) -> (RgbImage, RgbImage) {
    skewed_pair(rig, [pose, pose], paint, frame)
}

/// Images that show the plane at one pose each: left and right.
pub fn skewed_pair(
    rig: &StereoRig,
    [left, right]: [&Pose<CamLeft, Target>; 2],
    paint: Paint,
    frame: u32,
) -> (RgbImage, RgbImage) {
    let left = image(rig.left(), &Isometry3::identity(), left, paint, 2 * frame);
    let right = image(rig.right(), rig.cam_right_from_cam_left().isometry(), right, paint, 2 * frame + 1);
    (left, right)
}

pub fn wave(at: f64, period_m: f64) -> f64 {
    (std::f64::consts::TAU * at / period_m).sin()
}

pub fn rings(x: f64, y: f64) -> Option<f64> {
    let r = (x * x + y * y).sqrt();
    (r < RADIUS_M).then(|| 128.0 + 45.0 * wave(r, 0.017) + 40.0 * wave(r + 0.003, 0.029))
}

pub fn stripes(x: f64, _: f64) -> Option<f64> {
    Some(128.0 + 45.0 * wave(x, 0.017) + 40.0 * wave(x + 0.003, 0.029))
}

pub fn texture(x: f64, y: f64) -> Option<f64> {
    (x * x + y * y < RADIUS_M * RADIUS_M).then(|| {
        let (a, b) = (wave(x + 0.4 * y, 0.017), wave(y - 0.3 * x, 0.021));
        128.0 + 40.0 * a + 40.0 * b + 20.0 * wave(x - y, 0.031)
    })
}

/// Squares of 12 mm, without an end.
pub fn chessboard(x: f64, y: f64) -> Option<f64> {
    let field = |at: f64| (at / 0.012).floor() as i64;
    Some(if (field(x) + field(y)).rem_euclid(2) == 0 { 60.0 } else { 200.0 })
}

pub fn grid(x: f64, y: f64) -> Option<f64> {
    Some(128.0 + 40.0 * wave(x, 0.015) + 40.0 * wave(y, 0.015))
}

pub fn edge(x: f64, _: f64) -> Option<f64> {
    Some(if x < 0.004 { 70.0 } else { 190.0 })
}

/// Squares of 12 mm, seven by six, with a white border of 6 mm.
pub fn board(x: f64, y: f64) -> Option<f64> {
    let (along, across) = (x.abs(), y.abs());
    match (along < 0.042 && across < 0.036, along < 0.048 && across < 0.042) {
        (true, _) => chessboard(x + 0.006, y),
        (false, true) => Some(220.0),
        (false, false) => None,
    }
}
