//! A painted disc that moves in six degrees of freedom in front of a painted wall: ray-cast images, one sample per pixel.
#![allow(dead_code, clippy::expect_used, reason = "shared by tests that use different parts")]

use std::sync::{Arc, Mutex, PoisonError};

use image::RgbImage;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};
use pb3dp_estimation_core::estimate::PlanePose;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_test_support::scene::lattice_hash;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig, so3};

pub const SIZE: ImageSize = ImageSize { width: 320, height: 240 };
pub const VGA: ImageSize = ImageSize { width: 640, height: 480 };
/// Radius of the disc, metres.
pub const RADIUS_M: f64 = 0.055;
const WALL_Z_M: f64 = 0.75;

/// Equal cameras side by side, 640 x 480 pixels; the baseline is this many times that of [`rectified_rig`].
pub fn vga_rig(baseline: f64) -> StereoRig {
    let camera = |cx| {
        let pinhole = Pinhole { fx: 600.0, fy: 600.0, cx, cy: 241.0 };
        Camera::new(VGA, pinhole, Distortion::None).expect("camera")
    };
    let pose = Pose::from_translation(Vector3::new(-0.1 * baseline, 0.0, 0.0));
    StereoRig::new(camera(318.0), camera(323.0), pose).expect("rig")
}

/// Equal cameras side by side.
pub fn rectified_rig() -> StereoRig {
    let camera = |cx| {
        let pinhole = Pinhole { fx: 390.0, fy: 390.0, cx, cy: 121.0 };
        Camera::new(SIZE, pinhole, Distortion::None).expect("camera")
    };
    StereoRig::new(camera(158.0), camera(163.0), Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).expect("rig")
}

/// Unequal cameras with lens distortion, turned towards each other.
pub fn general_rig() -> StereoRig {
    let camera = |f, cx, k1| {
        let pinhole = Pinhole { fx: f, fy: f * 0.995, cx, cy: 118.0 };
        let distortion = Distortion::BrownConrady5 { coefficients: [k1, 0.05, 0.0006, -0.0004, 0.0] };
        Camera::new(SIZE, pinhole, distortion).expect("camera")
    };
    let turn = so3::exp(&Vector3::new(0.012, 0.06, -0.008));
    let pose = Pose::from_parts(turn * Vector3::new(-0.1, 0.002, 0.004), turn);
    StereoRig::new(camera(390.0, 158.0, -0.10), camera(402.0, 163.0, -0.13), pose).expect("rig")
}

/// Pose of the disc at a time in seconds; all axes move at once.
pub fn moving(t: f64) -> Pose<CamLeft, Target> {
    let swing = |period: f64, size: f64| size * (std::f64::consts::TAU * t / period).sin();
    let turn = so3::exp(&Vector3::new(swing(4.1, 0.25), swing(5.3, 0.3), swing(3.7, 0.3)));
    let first = so3::exp(&Vector3::new(0.1, -0.15, 0.05));
    Pose::from_parts(Vector3::new(0.03 + swing(4.7, 0.03), swing(5.9, 0.02), 0.45 + swing(6.1, 0.04)), turn * first)
}

/// Colour at a point of a surface, metres: waves of several lengths, none a multiple of another.
fn paint(x: f64, y: f64, seed: f64) -> [f64; 3] {
    let wave = |a: f64, b: f64, phase: f64| (a * x + b * y + phase + seed).sin();
    let (coarse, middle) = (wave(90.0, 130.0, 0.3), wave(-310.0, 170.0, 1.1));
    let (fine, cross) = (wave(420.0, 520.0, 2.0), wave(230.0, -460.0, 0.7) * wave(610.0, 90.0, 1.9));
    let grey = 118.0 + 22.0 * coarse + 24.0 * middle + 18.0 * fine + 20.0 * cross;
    [grey + 20.0 * wave(70.0, -50.0, 0.1), grey, grey - 25.0 * wave(40.0, 110.0, 0.9)]
}

/// A painted disc.
#[derive(Clone, Copy)]
pub struct Disc {
    pub radius_m: f64,
    /// Factor by which its paint is finer.
    pub fineness: f64,
}

/// The disc of most tests.
pub const USUAL: Disc = Disc { radius_m: RADIUS_M, fineness: 1.0 };

/// Content of an image.
#[derive(Clone, Copy)]
pub struct Shot {
    /// Pose of the disc; `None`: hidden behind a board.
    pub cam_left_from_target: Option<Pose<CamLeft, Target>>,
    /// Selects the noise.
    pub frame: u32,
    /// Gain of the right camera.
    pub right_gain: f64,
}

/// Renders the images of a pair.
pub fn render(rig: &StereoRig, shot: &Shot) -> (RgbImage, RgbImage) {
    render_all(rig, shot.cam_left_from_target.as_slice(), shot)
}

/// Renders a pair with several equal discs that occlude each other in this order; ignores the pose in `shot`.
pub fn render_all(rig: &StereoRig, discs: &[Pose<CamLeft, Target>], shot: &Shot) -> (RgbImage, RgbImage) {
    render_discs(rig, &USUAL, discs, shot)
}

/// As [`render_all`], with discs of another size.
pub fn render_discs(
    rig: &StereoRig,
    disc: &Disc,
    discs: &[Pose<CamLeft, Target>],
    shot: &Shot,
) -> (RgbImage, RgbImage) {
    let left = image(rig.left(), &Isometry3::identity(), (disc, discs, shot), 1.0, 0);
    let right = image(rig.right(), rig.cam_right_from_cam_left().isometry(), (disc, discs, shot), shot.right_gain, 1);
    (left, right)
}

/// Images that show the usual disc at one pose each: left and right.
pub fn render_skewed(rig: &StereoRig, [left, right]: [Pose<CamLeft, Target>; 2], frame: u32) -> (RgbImage, RgbImage) {
    let shot = Shot { cam_left_from_target: None, frame, right_gain: 1.0 };
    let left = image(rig.left(), &Isometry3::identity(), (&USUAL, &[left], &shot), 1.0, 0);
    let right = image(rig.right(), rig.cam_right_from_cam_left().isometry(), (&USUAL, &[right], &shot), 1.0, 1);
    (left, right)
}

fn image(
    camera: &Camera,
    cam_from_left: &Isometry3<f64>,
    (own, discs, shot): (&Disc, &[Pose<CamLeft, Target>], &Shot),
    gain: f64,
    side: u32,
) -> RgbImage {
    let origin = cam_from_left.inverse() * Point3::origin();
    let discs_from_left: Vec<Isometry3<f64>> = discs.iter().map(|pose| *pose.inverse().isometry()).collect();
    let background = background(camera, cam_from_left, discs.is_empty());
    RgbImage::from_fn(camera.size().width, camera.size().height, |x, y| {
        let (ray, behind) = background[(y * camera.size().width + x) as usize];
        let disc = discs_from_left.iter().find_map(|to_target| {
            let (from, along) = (to_target * origin, to_target * ray);
            let at = from - along * (from.z / along.z);
            (at.x * at.x + at.y * at.y < own.radius_m * own.radius_m)
                .then(|| paint(at.x * own.fineness, at.y * own.fineness, 0.0))
        });
        let colour = disc.unwrap_or(behind);
        let noise = |c: u32| noise(x, y, shot.frame * 6 + side * 3 + c);
        image::Rgb(std::array::from_fn(|c| (colour[c] * gain + 1.5 * noise(c as u32)).round().clamp(0.0, 255.0) as u8))
    })
}

/// Of each pixel its ray, in `cam_left`, and the colour of the wall there.
type Background = Arc<Vec<(Vector3<f64>, [f64; 3])>>;

/// A camera, its place, and whether a board hides the discs.
type View = (Camera, Isometry3<f64>, bool);

/// The wall stands still before the left camera: each camera sees it once. A board in front of everything hides the discs.
fn background(camera: &Camera, cam_from_left: &Isometry3<f64>, is_hidden: bool) -> Background {
    static RENDERED: Mutex<Vec<(View, Background)>> = Mutex::new(Vec::new());
    let key = (*camera, *cam_from_left, is_hidden);
    let mut rendered = RENDERED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, background)) = rendered.iter().find(|(other, _)| *other == key) {
        return Arc::clone(background);
    }
    let left_from_cam = cam_from_left.inverse();
    let origin = left_from_cam * Point3::origin();
    let (scale, seed) = if is_hidden { (0.21, 9.0) } else { (0.5, 5.0) };
    let size = camera.size();
    let pixels = (0..size.height).flat_map(|y| (0..size.width).map(move |x| Vector2::new(f64::from(x), f64::from(y))));
    let background = pixels.map(|pixel| {
        let ray = left_from_cam * camera.unproject(&pixel).expect("ray");
        let wall = origin + ray * ((WALL_Z_M - origin.z) / ray.z);
        (ray, paint(wall.x * scale, wall.y * scale, seed))
    });
    let background = Arc::new(background.collect());
    rendered.push((key, Arc::clone(&background)));
    background
}

/// Approximately normal, unit variance.
pub fn noise(x: u32, y: u32, stream: u32) -> f64 {
    let sum: u32 = lattice_hash(x, y, stream).to_le_bytes().iter().map(|&b| u32::from(b)).sum();
    (f64::from(sum) - 510.0) / 147.8
}

/// The region that an operator would draw.
pub fn region(rig: &StereoRig, pose: &Pose<CamLeft, Target>) -> Region {
    region_of(&USUAL, rig, pose)
}

/// As [`region`], for a disc of another size.
pub fn region_of(disc: &Disc, rig: &StereoRig, pose: &Pose<CamLeft, Target>) -> Region {
    let vertices_px = (0..40).map(|i| {
        let angle = std::f64::consts::TAU * f64::from(i) / 40.0;
        let point = Point3::new(disc.radius_m * angle.cos(), disc.radius_m * angle.sin(), 0.0);
        rig.left().project(&pose.transform_point(&point)).expect("in front")
    });
    Region::Polygon { vertices_px: vertices_px.collect() }
}

/// The disc's plane, with a small error.
pub fn plane(pose: &Pose<CamLeft, Target>) -> PlanePose {
    let normal = so3::exp(&Vector3::new(0.004, -0.003, 0.0)) * (pose.rotation() * Vector3::z());
    let ray = pose.translation_m() / pose.translation_m().z;
    let q = normal / (normal.dot(&pose.translation_m()) + 1e-4);
    PlanePose::from_inverse_depth_plane(q, &ray).expect("in front")
}
