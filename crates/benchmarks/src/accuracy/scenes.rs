//! Scenes and cameras of the setups.

use std::collections::BTreeMap;
use std::sync::Arc;

use anyhow::Context;
use nalgebra::{Point3, UnitQuaternion, Vector2, Vector3};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};
use pb3dp_sim::scene::{Highlight, Lighting, Scene};
use pb3dp_sim::sensor::{CameraResponse, SensorConfig};
use pb3dp_sim::targets::mesh::Mesh;
use pb3dp_sim::targets::part::{Anchor, SceneObject, ScenePart};
use pb3dp_sim::targets::texture::{Colour, Texture, colour_from_hsv};
use pb3dp_sim::targets::{BackdropConfig, Paint, TargetModel, backdrop, build_painted};

use super::cell::{Backdrop, LENS_BLUR_PX, Light, OFFSET_GREY, RegionKind, RigKind, Setup, Shape};

/// Size of all images.
const SIZE: ImageSize = ImageSize { width: 640, height: 480 };

/// Half axes of the region of [`RegionKind::Interior`], metres: it lies within the crab's shell.
const INTERIOR_M: [f64; 2] = [0.022, 0.013];

/// Half size of the region on a wall, metres.
const ON_WALL_M: [f64; 2] = [0.055, 0.04];

/// Half size of the wall, metres.
const WALL_M: f64 = 1.5;

/// Size of the occluder, metres; one edge lies on the y axis of `world`, the rest at x > 0.
const OCCLUDER_M: f64 = 0.5;

/// Seed of all textures and bumps.
const SCENE_SEED: u32 = 7;

/// Cache of scenes by their content.
#[derive(Default)]
pub struct SceneStore {
    scenes: BTreeMap<String, Scene>,
}

impl SceneStore {
    /// The scene of a setup. `world` is the frame of the occluder (see [`OCCLUDER_M`]), if there is one.
    ///
    /// # Errors
    /// If the simulator rejects the setup.
    pub fn scene(&mut self, setup: &Setup) -> anyhow::Result<Scene> {
        let interior = setup.region == RegionKind::Interior;
        let hidden = setup.occluded_share > 0.0;
        let key = format!("{:?}", (setup.paint, setup.shape, setup.backdrop, setup.light, interior, hidden));
        if let Some(scene) = self.scenes.get(&key) {
            return Ok(scene.clone());
        }
        let scene = build(setup).with_context(|| format!("the scene {key}"))?;
        self.scenes.insert(key, scene.clone());
        Ok(scene)
    }
}

fn build(setup: &Setup) -> anyhow::Result<Scene> {
    let (mut target, mut parts) = match setup.shape {
        Shape::Crab { relief_m } => build_painted(setup.paint, relief_m, SCENE_SEED)?,
        Shape::Wall => wall(setup.paint),
    };
    if setup.region == RegionKind::Interior {
        target.outline_m = ellipse(INTERIOR_M);
    }
    match setup.backdrop {
        Backdrop::Sand { gap_m } => {
            let config = BackdropConfig { size_m: [0.6, 0.45], gap_m };
            parts.extend(backdrop::build(&config, target.rear_z_m, SCENE_SEED)?);
        }
        Backdrop::SameHue => {
            let z = target.rear_z_m + 0.03;
            let texture = Arc::new(Paint::Crab.texture(SCENE_SEED + 1));
            parts.push(panel([0.3, 0.225], z, 4.0, texture, SceneObject::Backdrop, Anchor::Target));
        }
        Backdrop::Nothing => {}
    }
    if setup.occluded_share > 0.0 {
        parts.push(occluder());
    }
    Ok(Scene::from_parts(parts, target, lighting(setup.light))?)
}

/// Light in `world`, which is `cam_left` (or its first pose) if there is no occluder.
fn lighting(light: Light) -> Lighting {
    let shaded =
        Lighting { ambient: 0.4, lamp: 0.6, towards_lamp_in_world: Vector3::new(-0.25, -0.30, -1.0), highlight: None };
    match light {
        Light::Even => Lighting::EVEN,
        Light::Shaded => shaded,
        // A quarter of white, as strong as the reflection on moist skin.
        Light::Glossy => Lighting { highlight: Some(Highlight { strength_grey: 64.0, exponent: 40 }), ..shaded },
    }
}

fn wall(paint: Paint) -> (TargetModel, Vec<ScenePart>) {
    let texture = Arc::new(paint.texture(SCENE_SEED));
    let part = panel([WALL_M; 2], 0.0, 1.0, texture, SceneObject::Target, Anchor::Target);
    let [x, y] = ON_WALL_M;
    let outline_m = [(-x, -y), (x, -y), (x, y), (-x, y)].map(|(x, y)| Point3::new(x, y, 0.0)).to_vec();
    (TargetModel { name: "wall", outline_m, rear_z_m: 0.0 }, vec![part])
}

fn ellipse([a, b]: [f64; 2]) -> Vec<Point3<f64>> {
    let place = |k: u32| {
        let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 40.0).sin_cos();
        Point3::new(a * cos, b * sin, 0.0)
    };
    (0..40).map(place).collect()
}

/// A flat panel that faces the cameras, with `repeats` copies of its texture along each side.
pub fn panel(
    half_size_m: [f64; 2],
    z_m: f64,
    repeats: f64,
    texture: Arc<Texture>,
    object: SceneObject,
    anchor: Anchor,
) -> ScenePart {
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| {
        let place = Point3::new(x * half_size_m[0], y * half_size_m[1], z_m);
        (place, Vector2::new(x + 1.0, y + 1.0) * (0.5 * repeats))
    });
    let mut mesh = Mesh::default();
    mesh.add_quad(corners);
    ScenePart { mesh, texture, anchor, object }
}

/// The occluder: greenish weed with a strong texture.
fn occluder() -> ScenePart {
    let noise = pb3dp_sim::noise::ValueNoise::new(SCENE_SEED + 2);
    let texture = Texture::from_fn(9, 9, |u, v| -> Colour {
        let (blade, grain) = (noise.fractal(u * 90.0, v * 12.0, 3), noise.fractal(u * 140.0 + 50.0, v * 140.0, 2));
        colour_from_hsv(95.0 + 40.0 * (blade - 0.5), 0.55, 0.15 + 0.55 * blade + 0.25 * (grain - 0.5))
    });
    let half = OCCLUDER_M / 2.0;
    let mut part = panel([half; 2], 0.0, 1.0, Arc::new(texture), SceneObject::Room, Anchor::World);
    part.mesh.translate(&Vector3::new(half, 0.0, 0.0));
    part
}

/// The true cameras, and those that the estimators receive.
pub struct Rigs {
    /// The rig that renders.
    pub real: StereoRig,
    /// The rig that the estimators use.
    pub stated: StereoRig,
}

/// Cameras of a setup.
///
/// # Errors
/// If the geometry rejects them.
pub fn rigs(setup: &Setup) -> anyhow::Result<Rigs> {
    let stated = match setup.rig {
        RigKind::Parallel { baseline_m } => {
            let camera = Camera::new(SIZE, PINHOLE, Distortion::None)?;
            StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-baseline_m, 0.0, 0.0)))?
        }
        RigKind::Unequal => unequal()?,
    };
    let real = shifted(&stated, &stated, Vector2::new(0.0, setup.rows_off_px))?;
    Ok(Rigs { real, stated })
}

const PINHOLE: Pinhole = Pinhole { fx: 740.0, fy: 740.0, cx: 319.5, cy: 239.5 };

fn unequal() -> anyhow::Result<StereoRig> {
    let left = Pinhole { fx: 742.0, fy: 738.5, cx: 325.2, cy: 233.9 };
    let right = Pinhole { fx: 691.0, fy: 694.0, cx: 311.0, cy: 246.4 };
    let five = Distortion::BrownConrady5 { coefficients: [-0.21, 0.13, 0.0011, -0.0008, -0.02] };
    let eight = Distortion::BrownConrady8 { coefficients: [0.11, -0.07, -0.0009, 0.0013, 0.01, 0.02, -0.01, 0.004] };
    // 5 degrees about y: both cameras point at the target.
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.009, 5f64.to_radians(), -0.014));
    let cam_right_from_cam_left = Pose::from_parts(turn * Vector3::new(-0.0995, 0.004, -0.007), turn);
    Ok(StereoRig::new(Camera::new(SIZE, left, five)?, Camera::new(SIZE, right, eight)?, cam_right_from_cam_left)?)
}

/// A rig with the left camera of one rig and the right camera of another; the right image is moved by `right_by_px`.
fn shifted(left_of: &StereoRig, right_of: &StereoRig, right_by_px: Vector2<f64>) -> anyhow::Result<StereoRig> {
    let right = moved(right_of.right(), right_by_px)?;
    Ok(StereoRig::new(*left_of.left(), right, *right_of.cam_right_from_cam_left())?)
}

/// The camera whose image is moved by `by_px`.
///
/// # Errors
/// If the geometry rejects it.
pub fn moved(camera: &Camera, by_px: Vector2<f64>) -> anyhow::Result<Camera> {
    let pinhole = *camera.pinhole();
    let pinhole = Pinhole { cx: pinhole.cx + by_px.x, cy: pinhole.cy + by_px.y, ..pinhole };
    Ok(Camera::new(camera.size(), pinhole, *camera.distortion())?)
}

/// Sensor model of a setup.
pub fn sensor(setup: &Setup) -> SensorConfig {
    SensorConfig {
        lens_blur_px: LENS_BLUR_PX,
        read_noise_grey: setup.noise_grey,
        shot_noise_grey: 0.0,
        left: CameraResponse::NEUTRAL,
        right: CameraResponse { exposure: 1.0, gain: setup.gain, offset_grey: OFFSET_GREY },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unequal_cameras_see_the_same_place() {
        let rig = unequal().unwrap();
        assert!((rig.baseline_m() - 0.0998).abs() < 5e-4, "{}", rig.baseline_m());
        let target = Point3::new(0.05, 0.0, 0.5);
        for pixel in [
            rig.left().project(&target).unwrap(),
            rig.right().project(&rig.cam_right_from_cam_left().transform_point(&target)).unwrap(),
        ] {
            assert!((200.0..440.0).contains(&pixel.x) && (180.0..300.0).contains(&pixel.y), "{pixel}");
        }
    }

    #[test]
    fn misaligned_rows_are_not_reported() {
        let setup = Setup { rows_off_px: 0.5, ..Setup::default() };
        let rigs = rigs(&setup).unwrap();
        let point = Point3::new(0.02, 0.01, 0.5);
        let row =
            |rig: &StereoRig| rig.right().project(&rig.cam_right_from_cam_left().transform_point(&point)).unwrap().y;
        assert!((row(&rigs.real) - row(&rigs.stated) - 0.5).abs() < 1e-12);
        assert_eq!(rigs.real.left(), rigs.stated.left());
    }
}
