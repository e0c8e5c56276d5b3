//! Synthetic stereo pairs for tests and benchmarks: a coloured disc on a tilted plane in front of a coloured panel.
//!
//! Both images are ray cast from the scene, pixel by pixel, without code of the estimators: neither the homography nor the
//! inverse-depth plane is used here.
#![allow(clippy::expect_used, reason = "support code of tests, with inputs that are valid")]

use image::{Rgb, RgbImage};
use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector2, Vector3};
use pb3dp_estimation_core::rng::SplitMix64;
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};

/// Radius of the disc, metres.
pub const DISC_RADIUS_M: f64 = 0.055;
/// Distance of the panel behind the disc's plane, metres.
const PANEL_BEHIND_M: f64 = 0.03;

/// Pose of the disc: depth on the ray of the centre pixel and tilts, as `normal = Ry Rx e_z`.
#[derive(Clone, Copy, Debug)]
pub struct Scene {
    /// Centre of the disc in the left image.
    pub centre_px: Vector2<f64>,
    /// Depth of the centre, metres.
    pub z_m: f64,
    /// Tilt about x, radians.
    pub theta_x_rad: f64,
    /// Tilt about y, radians.
    pub theta_y_rad: f64,
    /// Maximum noise of a channel, grey levels.
    pub noise: f64,
}

/// A rectified rig for images of `size`: equal focal lengths, unequal principal columns, baseline 100 mm.
pub fn rectified_rig(size: ImageSize) -> StereoRig {
    let (w, h) = (f64::from(size.width), f64::from(size.height));
    let f = 740.0 / 640.0 * w;
    let left = Pinhole { fx: f, fy: f, cx: 0.49 * w, cy: 0.51 * h };
    let right = Pinhole { cx: 0.51 * w, ..left };
    rig(size, left, right, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0)))
}

/// A rig with different cameras: rotated right camera, unequal intrinsics, baseline not along x.
pub fn general_rig(size: ImageSize) -> StereoRig {
    let (w, h) = (f64::from(size.width) / 640.0, f64::from(size.height) / 480.0);
    let left = Pinhole { fx: 740.0 * w, fy: 755.0 * h, cx: 310.0 * w, cy: 250.0 * h };
    let right = Pinhole { fx: 722.0 * w, fy: 731.0 * h, cx: 330.0 * w, cy: 236.0 * h };
    let turn = |axis, angle: f64| UnitQuaternion::from_axis_angle(&axis, angle);
    let rotation = turn(Vector3::z_axis(), 0.02) * turn(Vector3::y_axis(), -0.05) * turn(Vector3::x_axis(), 0.03);
    rig(size, left, right, Pose::from_parts(Vector3::new(-0.11, 0.006, 0.013), rotation))
}

fn rig(
    size: ImageSize,
    left: Pinhole,
    right: Pinhole,
    cam_right_from_cam_left: Pose<pb3dp_geometry::frames::CamRight, pb3dp_geometry::frames::CamLeft>,
) -> StereoRig {
    let camera = |pinhole| Camera::new(size, pinhole, Distortion::None).expect("camera");
    StereoRig::new(camera(left), camera(right), cam_right_from_cam_left).expect("rig")
}

impl Scene {
    /// Axes of the disc's plane in `cam_left`: two in the plane, the normal away from the camera.
    fn axes(&self) -> [Vector3<f64>; 3] {
        let about_x = Rotation3::from_axis_angle(&Vector3::x_axis(), self.theta_x_rad);
        let about_y = Rotation3::from_axis_angle(&Vector3::y_axis(), self.theta_y_rad);
        [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| about_y * (about_x * axis))
    }

    /// Centre of the disc in `cam_left`, metres.
    fn centre_in_cam_left(&self, rig: &StereoRig) -> Vector3<f64> {
        rig.left().unproject(&self.centre_px).expect("ray") * self.z_m
    }

    /// A point of the disc's plane, metres from its centre along its axes, in `cam_left`.
    #[allow(dead_code, reason = "the speed example needs images alone")]
    pub fn point_in_cam_left(&self, rig: &StereoRig, along_x_m: f64, along_y_m: f64) -> Point3<f64> {
        let [x, y, _] = self.axes();
        Point3::from(self.centre_in_cam_left(rig) + x * along_x_m + y * along_y_m)
    }

    /// Whether the disc is visible at a left pixel.
    pub fn sees_disc(&self, rig: &StereoRig, u: u32, v: u32) -> bool {
        let ray = rig.left().unproject(&Vector2::new(f64::from(u), f64::from(v))).expect("ray");
        self.disc_coordinates(rig, &Vector3::zeros(), &ray, 0.0).norm() <= DISC_RADIUS_M
    }

    /// Intersection of a ray (in `cam_left`) with the plane `behind_m` behind the disc, in the disc's coordinates.
    fn disc_coordinates(
        &self,
        rig: &StereoRig,
        origin: &Vector3<f64>,
        ray: &Vector3<f64>,
        behind_m: f64,
    ) -> Vector2<f64> {
        let [x, y, normal] = self.axes();
        let centre = self.centre_in_cam_left(rig) + normal * behind_m;
        let hit = origin + ray * (normal.dot(&(centre - origin)) / normal.dot(ray)) - centre;
        Vector2::new(x.dot(&hit), y.dot(&hit))
    }

    fn colour(&self, rig: &StereoRig, origin: &Vector3<f64>, ray: &Vector3<f64>) -> [f64; 3] {
        let on_disc = self.disc_coordinates(rig, origin, ray, 0.0);
        if on_disc.norm() <= DISC_RADIUS_M {
            disc_colour(&on_disc)
        } else {
            panel_colour(&self.disc_coordinates(rig, origin, ray, PANEL_BEHIND_M))
        }
    }

    /// Left and right image.
    pub fn render(&self, rig: &StereoRig) -> (RgbImage, RgbImage) {
        let cam_left_from_cam_right = rig.cam_right_from_cam_left().inverse();
        let left = self.render_camera(rig, rig.left(), 1, |ray| (Vector3::zeros(), ray));
        let right = self.render_camera(rig, rig.right(), 2, |ray| {
            (cam_left_from_cam_right.translation_m(), cam_left_from_cam_right.transform_vector(&ray))
        });
        (left, right)
    }

    fn render_camera(
        &self,
        rig: &StereoRig,
        camera: &Camera,
        seed: u64,
        in_cam_left: impl Fn(Vector3<f64>) -> (Vector3<f64>, Vector3<f64>),
    ) -> RgbImage {
        let size = camera.size();
        RgbImage::from_fn(size.width, size.height, |u, v| {
            let (origin, ray) = in_cam_left(camera.unproject(&Vector2::new(f64::from(u), f64::from(v))).expect("ray"));
            let colour = self.colour(rig, &origin, &ray);
            let pixel = u64::from(v) * u64::from(size.width) + u64::from(u);
            Rgb(std::array::from_fn(|channel| {
                let noise = self.noise * (2.0 * unit_hash(pixel * 8 + channel as u64 + (seed << 40)) - 1.0);
                (255.0 * colour[channel] + noise).round().clamp(0.0, 255.0) as u8
            }))
        })
    }
}

/// Every hue, in waves of 28 to 54 mm: steep enough to locate, and less than 20 degrees from one pixel to the next.
fn disc_colour(at: &Vector2<f64>) -> [f64; 3] {
    let wave = |kx: f64, ky: f64, phase: f64| (kx * at.x + ky * at.y + phase).sin();
    let hue = 0.3 * wave(110.0, 40.0, 0.3) + 0.25 * wave(-50.0, 130.0, 1.1) + 0.12 * wave(180.0, -140.0, 2.0);
    hsv(hue, 0.65 + 0.2 * wave(120.0, 150.0, 0.7), 0.75)
}

/// Sand and blue, in larger patches.
fn panel_colour(at: &Vector2<f64>) -> [f64; 3] {
    let wave = (60.0 * at.x).sin() + (75.0 * at.y + 0.4).sin();
    if wave > 0.7 { hsv(0.6, 0.6, 0.6) } else { hsv(0.11 + 0.02 * wave, 0.4, 0.7) }
}

/// Red, green and blue, 0 to 1, of a hue in turns.
fn hsv(hue: f64, saturation: f64, value: f64) -> [f64; 3] {
    let channel = |offset: f64| {
        let k = (offset + 6.0 * hue).rem_euclid(6.0);
        value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0)
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

/// A number in 0..1 that depends only on `n`: number `n`, from 1, of the sequence with the seed 0.
fn unit_hash(n: u64) -> f64 {
    SplitMix64::new(n.wrapping_sub(1).wrapping_mul(0x9E37_79B9_7F4A_7C15)).unit()
}

/// Bits that depend only on a lattice position and a seed.
pub fn lattice_hash(x: u32, y: u32, seed: u32) -> u32 {
    let h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ seed.wrapping_mul(0xC2B2_AE3D);
    let h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    let h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    h ^ (h >> 15)
}
