//! Stereo pairs for the measurements: rendered once and kept in memory.

use std::sync::Arc;

use image::RgbImage;
use nalgebra::{Point3, UnitQuaternion, Vector3};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_geometry::frames::{CamLeft, Target, World};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Lighting, Scene, ScenePoses};
use pb3dp_sim::sensor::SensorConfig;
use pb3dp_sim::targets::part::{Anchor, SceneObject, ScenePart};
use pb3dp_sim::targets::{BackdropConfig, Paint, TargetModel, backdrop, build_painted};

use crate::accuracy::scenes::panel;

/// Seed of textures and noise.
const SEED: u32 = 11;
/// Columns of the images of nominal size.
const WIDTH: f64 = 640.0;
/// Half width and height of the textured wall, metres, and copies of its texture along each side.
const WALL_M: [f64; 2] = [0.48, 0.36];
const COPIES: f64 = 8.0;
/// Frames per second of the moving targets.
const RATE_HZ: f64 = 30.0;

/// Consecutive stereo pairs of one rig.
pub struct Clip {
    /// The cameras.
    pub rig: StereoRig,
    /// Left and right images.
    pub pairs: Vec<(RgbImage, RgbImage)>,
    /// The marked regions in the first left image.
    pub regions: Vec<Region>,
}

/// 60 px of disparity in images of 640 columns: 118 to 178 px.
pub const SEARCH: SearchRange = SearchRange { z_min_m: 74.0 / 178.0, z_max_m: 74.0 / 118.0, tilt_max_rad: 0.785 };

impl Clip {
    /// The frames forwards and backwards, endlessly: consecutive frames stay neighbours.
    pub fn pair(&self, frame: usize) -> &(RgbImage, RgbImage) {
        let last = self.pairs.len() - 1;
        let place = if last == 0 { 0 } else { frame % (2 * last) };
        &self.pairs[place.min(2 * last - place)]
    }
}

/// A textured wall that fills images of `size`, with a small motion; the caller marks `regions`.
///
/// # Errors
/// If the simulator rejects the setup.
pub fn wall(size: ImageSize, frames: usize) -> anyhow::Result<Clip> {
    wall_of(rig(size)?, frames)
}

/// One pair of images of the textured wall through the given lenses.
///
/// # Errors
/// If the simulator rejects the setup.
pub fn wall_through(lenses: Lenses, size: ImageSize) -> anyhow::Result<Clip> {
    wall_of(rig_with(lenses, size)?, 1)
}

fn wall_of(rig: StereoRig, frames: usize) -> anyhow::Result<Clip> {
    let texture = Arc::new(Paint::Colourful.texture(SEED));
    let part = panel(WALL_M, 0.0, COPIES, texture, SceneObject::Target, Anchor::Target);
    let [x, y] = WALL_M;
    let outline_m = [(-x, -y), (x, -y), (x, y), (-x, y)].map(|(x, y)| Point3::new(x, y, 0.0)).to_vec();
    let target = TargetModel { name: "wall", outline_m, rear_z_m: 0.0 };
    render(vec![part], target, rig, (0.0, 0.25), frames)
}

/// A square of the wall, `side_px` wide in images of 640 columns, marked in images of `size`.
pub fn square(size: ImageSize, centre: (i32, i32), side_px: u32) -> Region {
    let factor = size.width / WIDTH as u32;
    let side = side_px * factor;
    let corner = |centre: i32| centre * factor as i32 - side as i32 / 2;
    Region::Rectangle { x: corner(centre.0), y: corner(centre.1), width: side, height: side }
}

/// The flat crab in front of sand, moving along and about all axes; its outline is marked.
///
/// # Errors
/// If the simulator rejects the setup.
pub fn crab(size: ImageSize, frames: usize) -> anyhow::Result<Clip> {
    crab_scene(size, frames, true)
}

/// The same scene without the crab: the images of a tracker whose target is hidden.
///
/// # Errors
/// If the simulator rejects the setup.
pub fn empty_place(size: ImageSize, frames: usize) -> anyhow::Result<Clip> {
    crab_scene(size, frames, false)
}

fn crab_scene(size: ImageSize, frames: usize, is_shown: bool) -> anyhow::Result<Clip> {
    let (target, mut parts) = build_painted(Paint::Crab, 0.0, SEED)?;
    if !is_shown {
        parts.clear();
    }
    let config = BackdropConfig { size_m: [0.6, 0.45], gap_m: 0.03 };
    parts.extend(backdrop::build(&config, target.rear_z_m, SEED)?);
    render(parts, target, rig(size)?, (0.05, 1.0), frames)
}

fn render(
    parts: Vec<ScenePart>,
    target: TargetModel,
    rig: StereoRig,
    (x_m, motion): (f64, f64),
    frames: usize,
) -> anyhow::Result<Clip> {
    let scene = Scene::from_parts(parts, target, Lighting::EVEN)?;
    let mut renderer = StereoRenderer::new(scene, rig, &SensorConfig::default(), SEED)?;
    let world_from_cam_left = Pose::<World, CamLeft>::coincident();
    let poses = |frame: usize| ScenePoses {
        world_from_cam_left,
        world_from_target: world_from_cam_left * pose(frame, x_m, motion),
    };
    let outline = renderer.target_outline_px(&poses(0));
    let pairs = (0..frames.max(1)).map(|frame| {
        let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
        renderer.render_pair(&poses(frame), frame as u64, &mut left, &mut right);
        (left, right)
    });
    let pairs = pairs.collect();
    let regions = outline.map(|vertices_px| Region::Polygon { vertices_px }).into_iter().collect();
    Ok(Clip { rig, pairs, regions })
}

/// Two equal cameras, baseline 100 mm, with the same field of view at every size.
fn rig(size: ImageSize) -> anyhow::Result<StereoRig> {
    let factor = f64::from(size.width) / WIDTH;
    let centre = |length: u32| (f64::from(length) - 1.0) / 2.0;
    let f = 740.0 * factor;
    let pinhole = Pinhole { fx: f, fy: f, cx: centre(size.width), cy: centre(size.height) };
    let camera = Camera::new(size, pinhole, Distortion::None)?;
    Ok(StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0)))?)
}

/// Lenses and mounting of a rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lenses {
    /// Parallel cameras without distortion.
    Rectified,
    /// Rotated cameras of unequal focal length with radial and tangential distortion.
    Brown,
    /// The same with equidistant lenses.
    Equidistant,
}

impl Lenses {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rectified => "rectified",
            Self::Brown => "raw, Brown-Conrady",
            Self::Equidistant => "raw, equidistant",
        }
    }
}

/// Columns of an image size as a multiple of those of the nominal one.
pub fn factor(size: ImageSize) -> f64 {
    f64::from(size.width) / WIDTH
}

/// As [`SEARCH`], for images of any size: 60 px of disparity around the wall.
pub fn search_of(size: ImageSize) -> SearchRange {
    let px_m = 74.0 * factor(size);
    let z_m = |away_px: f64| px_m / (2.0 * px_m + away_px);
    SearchRange { z_min_m: z_m(30.0), z_max_m: z_m(-30.0), ..SEARCH }
}

fn rig_with(lenses: Lenses, size: ImageSize) -> anyhow::Result<StereoRig> {
    let distortions = match lenses {
        Lenses::Rectified => return rig(size),
        Lenses::Brown => [[-0.28, 0.09, 0.0011, -0.0007, 0.004], [-0.27, 0.10, -0.0006, 0.0009, -0.01]]
            .map(|coefficients| Distortion::BrownConrady5 { coefficients }),
        Lenses::Equidistant => [[0.02, -0.011, 0.004, -0.001], [-0.012, 0.0043, -0.0021, 0.0004]]
            .map(|coefficients| Distortion::Equidistant { coefficients }),
    };
    let nominal = *rig(size)?.left().pinhole();
    let scale = factor(size);
    let left = Pinhole { fx: 1.004 * nominal.fx, cx: nominal.cx + 6.3 * scale, ..nominal };
    let right = Pinhole { fy: 0.993 * nominal.fy, cy: nominal.cy - 4.1 * scale, ..nominal };
    let left = Camera::new(size, left, distortions[0])?;
    let right = Camera::new(size, right, distortions[1])?;
    let rotation = UnitQuaternion::from_euler_angles(0.007, -0.021, 0.012);
    Ok(StereoRig::new(left, right, Pose::from_parts(rotation * Vector3::new(-0.1, 0.0012, -0.0008), rotation))?)
}

/// `motion` times 50 mm and 20 degrees along and about all axes, periods of 4 to 7 s, half a metre away.
fn pose(frame: usize, x_m: f64, motion: f64) -> Pose<CamLeft, Target> {
    let t = frame as f64 / RATE_HZ;
    let wave = |size: f64, period_s: f64| motion * size * (std::f64::consts::TAU * t / period_s).sin();
    let shift = Vector3::new(x_m + wave(0.05, 4.0), wave(0.035, 5.6), 0.5 + wave(0.04, 7.0));
    let turn =
        |axis: Vector3<f64>, period_s: f64| UnitQuaternion::from_scaled_axis(axis * wave(20f64.to_radians(), period_s));
    let start = UnitQuaternion::from_scaled_axis(Vector3::new(0.12, -0.15, 0.0));
    Pose::from_parts(shift, turn(Vector3::y(), 5.0) * turn(Vector3::x(), 6.0) * turn(Vector3::z(), 4.5) * start)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clips_run_forwards_and_backwards() {
        let pair = |grey: u8| (RgbImage::from_pixel(1, 1, image::Rgb([grey; 3])), RgbImage::new(1, 1));
        let rig = rig(ImageSize { width: 1280, height: 1024 }).expect("a rig");
        let mut clip = Clip { rig, pairs: (0..3).map(pair).collect(), regions: Vec::new() };
        let order: Vec<_> = (0..7).map(|frame| clip.pair(frame).0.get_pixel(0, 0)[0]).collect();
        assert_eq!(order, [0, 1, 2, 1, 0, 1, 2]);
        clip.pairs.truncate(1);
        assert_eq!(clip.pair(5).0.get_pixel(0, 0)[0], 0);
    }

    #[test]
    fn the_range_has_sixty_pixels_of_disparity_and_holds_the_wall() {
        let rig = rig(ImageSize { width: 640, height: 480 }).expect("a rig");
        let disparity = |z_m: f64| rig.left().pinhole().fx * rig.baseline_m() / z_m;
        assert!((disparity(SEARCH.z_min_m) - disparity(SEARCH.z_max_m) - 60.0).abs() < 1e-9);
        for frame in 0..300 {
            let z_m = pose(frame, 0.0, 0.25).translation_m().z;
            assert!(z_m > SEARCH.z_min_m && z_m < SEARCH.z_max_m, "{frame}: {z_m}");
        }
    }
}
