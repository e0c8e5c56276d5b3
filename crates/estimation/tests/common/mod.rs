//! A small renderer for tests: casts rays from each camera and intersects them with a textured target and a backdrop.
//!
//! It shares no formula with the estimator: no homography, no disparity, no hue arithmetic.

// Every test binary compiles this module separately and uses a part of it.
#![allow(dead_code, clippy::expect_used)]

use image::{Rgb, RgbImage};
use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation_test_support::scene::lattice_hash;
use pb3dp_geometry::frames::{CamLeft, CamRight, Model};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};

/// Corners of the target on its plane, metres; the outline has no symmetry.
pub const TARGET_OUTLINE_M: [(f64, f64); 6] =
    [(-0.060, -0.050), (0.055, -0.045), (0.065, 0.020), (0.020, 0.055), (0.010, 0.030), (-0.055, 0.045)];

/// Distance of the backdrop from the left camera, metres.
pub const BACKDROP_Z_M: f64 = 0.75;

/// Appearance of target and backdrop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// Many hues on the target, a blue backdrop.
    Colourful,
    /// A target of one hue (orange) with spots, a blue backdrop.
    OneHue,
    /// A grey target on the blue backdrop.
    Grey,
    /// Target and backdrop of one hue, with texture in brightness only.
    SameHue,
    /// Many warm hues on the target, many cold hues on the backdrop.
    TwoLayers,
    /// Speckles of many hues on the target, the same hues everywhere, a blue backdrop.
    Speckled,
}

/// A pair of raw images with the target at a known pose.
#[derive(Clone, Debug)]
pub struct Shot {
    pub left: RgbImage,
    pub right: RgbImage,
}

/// A rectified pair, 320x240.
pub fn rectified_rig() -> StereoRig {
    let left = camera((400.0, 400.0, 158.3, 118.9), Distortion::None);
    let right = camera((400.0, 400.0, 161.7, 118.9), Distortion::None);
    StereoRig::new(left, right, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).expect("a rig")
}

/// An unrectified pair: rotated, shifted along all axes, with unequal intrinsics.
pub fn general_rig() -> StereoRig {
    let left = camera((402.0, 398.5, 157.2, 121.4), Distortion::None);
    let right = camera((391.0, 393.5, 163.1, 117.2), Distortion::None);
    StereoRig::new(left, right, toed_in()).expect("a rig")
}

/// As [`general_rig`], with different lens distortion in each camera.
pub fn distorted_rig() -> StereoRig {
    let brown = Distortion::BrownConrady5 { coefficients: [-0.24, 0.09, 0.0011, -0.0007, -0.01] };
    let fisheye = Distortion::Equidistant { coefficients: [0.02, -0.011, 0.004, -0.001] };
    let left = camera((402.0, 398.5, 157.2, 121.4), brown);
    let right = camera((391.0, 393.5, 163.1, 117.2), fisheye);
    StereoRig::new(left, right, toed_in()).expect("a rig")
}

fn toed_in() -> Pose<CamRight, CamLeft> {
    let rotation = UnitQuaternion::from_euler_angles(0.013, -0.055, 0.021);
    Pose::from_parts(Vector3::new(-0.097, 0.004, 0.006), rotation)
}

fn camera((fx, fy, cx, cy): (f64, f64, f64, f64), distortion: Distortion) -> Camera {
    Camera::new(ImageSize { width: 320, height: 240 }, Pinhole { fx, fy, cx, cy }, distortion).expect("a camera")
}

/// The target with its origin at `(x, y, z)` millimetres, rotated by `rotation_deg` about x, then y, then its normal.
pub fn target_at(origin_mm: (f64, f64, f64), rotation_deg: (f64, f64, f64)) -> Pose<CamLeft, Model> {
    let about = |axis, degrees: f64| UnitQuaternion::from_axis_angle(&axis, degrees.to_radians());
    let rotation = about(Vector3::y_axis(), rotation_deg.1)
        * about(Vector3::x_axis(), rotation_deg.0)
        * about(Vector3::z_axis(), rotation_deg.2);
    Pose::from_parts(Vector3::new(origin_mm.0, origin_mm.1, origin_mm.2) * 1e-3, rotation)
}

/// Renders both raw images; `None` for the target renders the backdrop only. The backdrop is stationary in the left camera.
pub fn render(rig: &StereoRig, cam_left_from_target: Option<&Pose<CamLeft, Model>>, look: Look) -> Shot {
    let cam_left_from_cam_right = rig.cam_right_from_cam_left().inverse();
    let left = render_camera(rig.left(), &Pose::<CamLeft, CamLeft>::coincident(), cam_left_from_target, look, 1);
    let right = render_camera(rig.right(), &cam_left_from_cam_right, cam_left_from_target, look, 2);
    Shot { left, right }
}

/// The target's outline in the raw left image.
pub fn outline_px(rig: &StereoRig, cam_left_from_target: &Pose<CamLeft, Model>) -> Vec<Vector2<f64>> {
    let project = |&(x, y): &(f64, f64)| {
        let corner_in_cam_left = cam_left_from_target.transform_point(&Point3::new(x, y, 0.0));
        rig.left().project(&corner_in_cam_left).expect("in front of the camera")
    };
    TARGET_OUTLINE_M.iter().map(project).collect()
}

/// True depth of the target's plane on the ray of a raw left pixel, metres.
pub fn true_depth_m(rig: &StereoRig, cam_left_from_target: &Pose<CamLeft, Model>, pixel: &Vector2<f64>) -> f64 {
    let ray = rig.left().unproject(pixel).expect("a ray");
    let normal = cam_left_from_target.transform_vector(&Vector3::z());
    normal.dot(&cam_left_from_target.translation_m()) / normal.dot(&ray)
}

/// Angle between two directions, degrees.
pub fn angle_deg(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.angle(b).to_degrees()
}

fn render_camera<F: pb3dp_geometry::Frame>(
    camera: &Camera,
    cam_left_from_cam: &Pose<CamLeft, F>,
    cam_left_from_target: Option<&Pose<CamLeft, Model>>,
    look: Look,
    noise_seed: u32,
) -> RgbImage {
    let target_from_cam_left = cam_left_from_target.map(Pose::inverse);
    let size = camera.size();
    RgbImage::from_fn(size.width, size.height, |u, v| {
        let mut sum = [0.0; 3];
        for (du, dv) in [(-0.25, 0.25), (0.25, -0.25)] {
            let pixel = Vector2::new(f64::from(u) + du, f64::from(v) + dv);
            let Ok(ray) = camera.unproject(&pixel) else { continue };
            let direction = cam_left_from_cam.transform_vector(&ray);
            let colour = trace(&cam_left_from_cam.translation_m(), &direction, target_from_cam_left.as_ref(), look);
            (0..3).for_each(|c| sum[c] += 0.5 * colour[c]);
        }
        let noise =
            |c: u32| 3.0 * (lattice(u as i32, v as i32, 100 * noise_seed + c) + lattice(v as i32, u as i32, c) - 1.0);
        Rgb([0, 1, 2].map(|c| (sum[c] + noise(c as u32)).round().clamp(0.0, 255.0) as u8))
    })
}

fn trace(
    origin: &Vector3<f64>,
    direction: &Vector3<f64>,
    target_from_cam_left: Option<&Pose<Model, CamLeft>>,
    look: Look,
) -> [f64; 3] {
    if let Some(target_from_cam_left) = target_from_cam_left {
        let start = target_from_cam_left.transform_point(&Point3::from(*origin));
        let along = target_from_cam_left.transform_vector(direction);
        let hit = start - along * (start.z / along.z);
        if start.z / along.z < 0.0 && inside_target(hit.x, hit.y) {
            return target_colour(hit.x, hit.y, look);
        }
    }
    let hit = origin + direction * ((BACKDROP_Z_M - origin.z) / direction.z);
    let brightness = 0.55 + 0.35 * smooth_noise(hit.x / 0.012, hit.y / 0.012, 7);
    match look {
        Look::SameHue => hsv(24.0, 0.8, brightness),
        Look::TwoLayers => hsv(180.0 + 150.0 * smooth_noise(hit.x / 0.0135, hit.y / 0.0135, 9), 0.85, brightness),
        _ => hsv(214.0 + 14.0 * smooth_noise(hit.x / 0.02, hit.y / 0.02, 8), 0.7, brightness),
    }
}

fn target_colour(x: f64, y: f64, look: Look) -> [f64; 3] {
    let brightness = 0.6 + 0.35 * smooth_noise(x / 0.005, y / 0.005, 3);
    match look {
        Look::Colourful => hsv(720.0 * smooth_noise(x / 0.011, y / 0.011, 4), 0.85, brightness),
        Look::OneHue => {
            let spot = smooth_noise(x / 0.009, y / 0.009, 5) > 0.78;
            hsv(26.0, 0.85, if spot { 0.05 } else { brightness })
        }
        Look::Grey => hsv(0.0, 0.02, brightness),
        Look::Speckled => hsv(220.0 * smooth_noise(x / 0.005, y / 0.005, 6), 0.85, brightness),
        Look::TwoLayers => hsv(150.0 * smooth_noise(x / 0.009, y / 0.009, 6), 0.85, brightness),
        Look::SameHue => hsv(24.0, 0.8, brightness),
    }
}

/// Even-odd crossing test for the target's outline.
fn inside_target(x: f64, y: f64) -> bool {
    let n = TARGET_OUTLINE_M.len();
    (0..n).fold(false, |inside, i| {
        let ((ax, ay), (bx, by)) = (TARGET_OUTLINE_M[i], TARGET_OUTLINE_M[(i + 1) % n]);
        let crosses = (ay > y) != (by > y) && x < ax + (y - ay) * (bx - ax) / (by - ay);
        inside != crosses
    })
}

/// RGB, 0 to 255, by the three shifted ramps of the hue circle.
fn hsv(hue_deg: f64, saturation: f64, value: f64) -> [f64; 3] {
    [5.0, 3.0, 1.0].map(|shift| {
        let k = (shift + hue_deg / 60.0).rem_euclid(6.0);
        255.0 * value * (1.0 - saturation * k.min(4.0 - k).clamp(0.0, 1.0))
    })
}

/// Smooth noise between 0 and 1 on a lattice of unit spacing.
fn smooth_noise(x: f64, y: f64, seed: u32) -> f64 {
    let (i, j) = (x.floor(), y.floor());
    let blend = |t: f64| t * t * (3.0 - 2.0 * t);
    let (tx, ty) = (blend(x - i), blend(y - j));
    let corner = |di: f64, dj: f64| lattice((i + di) as i32, (j + dj) as i32, seed);
    let top = corner(0.0, 0.0) * (1.0 - tx) + corner(1.0, 0.0) * tx;
    let bottom = corner(0.0, 1.0) * (1.0 - tx) + corner(1.0, 1.0) * tx;
    top * (1.0 - ty) + bottom * ty
}

/// A pseudo-random number between 0 and 1 for a lattice point.
fn lattice(i: i32, j: i32, seed: u32) -> f64 {
    f64::from(lattice_hash(i as u32, j as u32, seed)) / f64::from(u32::MAX)
}
