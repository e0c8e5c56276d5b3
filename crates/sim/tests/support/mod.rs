//! Rigs, poses and planes for the renderer's tests.
#![allow(dead_code)]

use std::sync::Arc;

use image::RgbImage;
use nalgebra::{Matrix3, Point3, Quaternion, UnitQuaternion, Vector2, Vector3};
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig};
use pb3dp_sim::raster::StereoRenderer;
use pb3dp_sim::scene::{Lighting, Scene, ScenePoses};
use pb3dp_sim::sensor::SensorConfig;
use pb3dp_sim::targets::TargetModel;
use pb3dp_sim::targets::mesh::Mesh;
use pb3dp_sim::targets::part::{Anchor, SceneObject, ScenePart};
use pb3dp_sim::targets::texture::{Colour, Texture};

pub const SIZE: ImageSize = ImageSize { width: 640, height: 480 };

/// fx 740 px, baseline 100 mm, rectified.
pub fn rectified_rig() -> StereoRig {
    let pinhole = Pinhole { fx: 740.0, fy: 740.0, cx: 319.5, cy: 239.5 };
    let camera = Camera::new(SIZE, pinhole, Distortion::None).unwrap();
    StereoRig::new(camera, camera, Pose::from_translation(Vector3::new(-0.1, 0.0, 0.0))).unwrap()
}

/// Different cameras with lens distortion, the right camera rotated and shifted in every direction.
pub fn distorted_rig() -> StereoRig {
    let left = Pinhole { fx: 742.0, fy: 738.5, cx: 325.2, cy: 233.9 };
    let right = Pinhole { fx: 729.0, fy: 733.0, cx: 311.0, cy: 246.4 };
    let five = Distortion::BrownConrady5 { coefficients: [-0.21, 0.13, 0.0011, -0.0008, -0.02] };
    let eight = Distortion::BrownConrady8 { coefficients: [0.11, -0.07, -0.0009, 0.0013, 0.01, 0.02, -0.01, 0.004] };
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.011, -0.03, 0.017));
    StereoRig::new(
        Camera::new(SIZE, left, five).unwrap(),
        Camera::new(SIZE, right, eight).unwrap(),
        Pose::from_parts(Vector3::new(-0.098, 0.004, -0.006), turn),
    )
    .unwrap()
}

/// The camera points along +x of the world; the target pose in `cam_left` is given.
pub fn poses(cam_left_from_target: Pose<CamLeft, Target>) -> ScenePoses {
    let axes = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
    let world_from_cam_left = Pose::from_rotation_matrix(&axes, Vector3::new(0.3, 0.1, 0.5));
    ScenePoses { world_from_cam_left, world_from_target: world_from_cam_left * cam_left_from_target }
}

/// A target pose whose rotation is the normalised quaternion (1, x, y, z), made without trigonometry.
pub fn turned(translation_m: [f64; 3], xyz: [f64; 3]) -> Pose<CamLeft, Target> {
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(1.0, xyz[0], xyz[1], xyz[2]));
    Pose::from_parts(Vector3::from(translation_m), rotation)
}

/// A square with its centre at the origin of `target`, plane z = 0, evenly lit; colours by position in metres.
pub fn square_scene(side_m: f64, texels_log2: u32, mut colour: impl FnMut(f64, f64) -> Colour) -> Scene {
    let texture = Texture::from_fn(texels_log2, texels_log2, |u, v| colour((u - 0.5) * side_m, (v - 0.5) * side_m));
    let mut mesh = Mesh::default();
    mesh.add_quad([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| {
        let position = Point3::new(x * side_m / 2.0, y * side_m / 2.0, 0.0);
        (position, Vector2::new(x, y) / 2.0 + Vector2::repeat(0.5))
    }));
    let outline_m = mesh.vertices.iter().map(|vertex| vertex.position_m).collect();
    let part = ScenePart { mesh, texture: Arc::new(texture), anchor: Anchor::Target, object: SceneObject::Target };
    let target = TargetModel { name: "square", outline_m, rear_z_m: 0.0 };
    Scene::from_parts(vec![part], target, Lighting::EVEN).unwrap()
}

pub fn render(scene: Scene, rig: StereoRig, sensor: &SensorConfig, poses: &ScenePoses) -> [RgbImage; 2] {
    let mut renderer = StereoRenderer::new(scene, rig, sensor, 1).unwrap();
    let (mut left, mut right) = (RgbImage::new(1, 1), RgbImage::new(1, 1));
    renderer.render_pair(poses, 0, &mut left, &mut right);
    [left, right]
}
