//! Contents of the simulated workcell, and their poses at one time.

use nalgebra::Vector3;
use pb3dp_geometry::frames::{CamLeft, Target, World};
use pb3dp_geometry::{MonotonicTime, Pose};

use crate::targets::part::{SceneError, ScenePart, check};
use crate::targets::{self, BackdropConfig, TargetConfig, TargetModel};

/// Poses of the moving parts of the workcell at one time. Metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScenePoses {
    /// Pose of the left camera in `world`; the right camera follows from the rig.
    pub world_from_cam_left: Pose<World, CamLeft>,
    /// Pose of the carried target in `world`.
    pub world_from_target: Pose<World, Target>,
}

/// Provides all poses at a given time: a script, or the simulated arms.
///
/// Requested times never decrease. With a running clock they lie in the past, by up to one period and one exposure of the camera
/// (an image shows the past), so a source fed by live arms stores that much history.
pub trait PoseSource: Send {
    /// Poses at time `at`.
    fn poses_at(&mut self, at: MonotonicTime) -> ScenePoses;
}

/// A constant scene.
impl PoseSource for ScenePoses {
    fn poses_at(&mut self, _at: MonotonicTime) -> ScenePoses {
        *self
    }
}

/// Light in the workcell: uniform ambient light and one wide lamp, without shadows.
///
/// A surface receives `ambient + lamp (1 + cos a) / 2`, where a is the angle between its normal and the direction to the lamp. It
/// is brightest towards the lamp, decreases smoothly, and never gets black.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lighting {
    /// Ambient light.
    pub ambient: f64,
    /// Light of the lamp on a surface that faces it.
    pub lamp: f64,
    /// Direction to the lamp in `world`; any length but zero.
    pub towards_lamp_in_world: Vector3<f64>,
    /// Specular reflection of the lamp; `None`: all surfaces are matt.
    pub highlight: Option<Highlight>,
}

/// Specular reflection of the lamp, Phong model: `strength (r . v)^exponent`, where r is the mirrored direction to the lamp and v
/// the direction to the camera. White, added to the surface colour, and different for the two cameras.
///
/// It is computed at the corners of the triangles and interpolated: triangles must be small compared with the highlight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Highlight {
    /// Light in the middle of the reflection, grey levels, 0 to 255.
    pub strength_grey: f64,
    /// Sharpness, 1 to 200: at 40 the reflection has dropped to a half at 11 degrees from its centre.
    pub exponent: i32,
}

impl Default for Lighting {
    /// Half of the light from a lamp under the ceiling, off to one side.
    fn default() -> Self {
        Self { ambient: 0.5, lamp: 0.62, towards_lamp_in_world: Vector3::new(-0.40, 0.35, 0.85), highlight: None }
    }
}

impl Lighting {
    /// Uniform light of 1.
    pub const EVEN: Self =
        Self { ambient: 1.0, lamp: 0.0, towards_lamp_in_world: Vector3::new(0.0, 0.0, 1.0), highlight: None };

    /// Light on a surface with the given unit normal.
    pub fn on(&self, normal_in_world: &Vector3<f64>) -> f64 {
        let length = self.towards_lamp_in_world.norm();
        let cosine = if length > 0.0 { normal_in_world.dot(&self.towards_lamp_in_world) / length } else { 0.0 };
        self.ambient + self.lamp * (0.5 + 0.5 * cosine)
    }

    /// The specular reflection towards a camera at `towards_camera_in_world` (any length) on a surface with the given unit
    /// normal, grey levels.
    pub fn shine_on(
        &self,
        highlight: &Highlight,
        normal_in_world: &Vector3<f64>,
        towards_camera_in_world: &Vector3<f64>,
    ) -> f64 {
        let lengths = self.towards_lamp_in_world.norm() * towards_camera_in_world.norm();
        let to_lamp = &self.towards_lamp_in_world;
        let facing = normal_in_world.dot(to_lamp);
        let mirrored = normal_in_world * (2.0 * facing) - to_lamp;
        let cosine = mirrored.dot(towards_camera_in_world) / lengths;
        if facing > 0.0 && cosine > 0.0 { highlight.strength_grey * cosine.powi(highlight.exponent) } else { 0.0 }
    }
}

/// Contents of the workcell.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneConfig {
    /// The target and its shape.
    pub target: TargetConfig,
    /// The panel behind it, if any.
    pub backdrop: Option<BackdropConfig>,
    /// Lighting.
    pub lighting: Lighting,
    /// Seed of textures and bumps.
    pub seed: u32,
}

impl SceneConfig {
    /// `target` in front of the default backdrop with the default lighting.
    pub fn new(target: TargetConfig) -> Self {
        Self { target, backdrop: Some(BackdropConfig::default()), lighting: Lighting::default(), seed: 1 }
    }
}

/// All visible objects.
#[derive(Clone, Debug)]
pub struct Scene {
    parts: Vec<ScenePart>,
    target: TargetModel,
    lighting: Lighting,
}

impl Scene {
    /// Creates the target, its backdrop and the room, with their textures. Takes some tenths of a second.
    ///
    /// # Errors
    /// A number out of its range.
    pub fn build(config: &SceneConfig) -> Result<Self, SceneError> {
        let lighting = &config.lighting;
        check("lighting.ambient", lighting.ambient, 0.0..=4.0)?;
        check("lighting.lamp", lighting.lamp, 0.0..=4.0)?;
        if let Some(highlight) = &lighting.highlight {
            check("lighting.highlight.strength_grey", highlight.strength_grey, 0.0..=255.0)?;
            check("lighting.highlight.exponent", f64::from(highlight.exponent), 1.0..=200.0)?;
        }
        let (target, mut parts) = targets::build(&config.target, config.seed)?;
        if let Some(backdrop) = &config.backdrop {
            parts.extend(targets::backdrop::build(backdrop, target.rear_z_m, config.seed)?);
        }
        parts.extend(targets::room::build(config.seed));
        Self::from_parts(parts, target, *lighting)
    }

    /// A scene of given parts, for tests and other targets; parts that are listed first are drawn first.
    ///
    /// # Errors
    /// There are too many surfaces.
    pub fn from_parts(parts: Vec<ScenePart>, target: TargetModel, lighting: Lighting) -> Result<Self, SceneError> {
        let triangles = parts.iter().map(|part| part.mesh.triangles.len()).sum();
        if parts.len() > 4000 || triangles > 500_000 {
            return Err(SceneError::TooLarge { parts: parts.len(), triangles });
        }
        Ok(Self { parts, target, lighting })
    }

    /// The surfaces.
    pub fn parts(&self) -> &[ScenePart] {
        &self.parts
    }

    /// The target.
    pub fn target(&self) -> &TargetModel {
        &self.target
    }

    /// The light.
    pub fn lighting(&self) -> &Lighting {
        &self.lighting
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_falls_smoothly_from_the_lamp() {
        let light =
            Lighting { ambient: 0.3, lamp: 0.6, towards_lamp_in_world: Vector3::new(0.0, 4.0, 0.0), highlight: None };
        assert!((light.on(&Vector3::y()) - 0.9).abs() < 1e-12);
        assert!((light.on(&Vector3::x()) - 0.6).abs() < 1e-12);
        assert!((light.on(&-Vector3::y()) - 0.3).abs() < 1e-12);
        assert_eq!(Lighting::EVEN.on(&Vector3::x()), 1.0);
    }

    #[test]
    fn the_reflection_is_brightest_in_the_mirrored_direction() {
        let highlight = Highlight { strength_grey: 64.0, exponent: 40 };
        let light = Lighting { towards_lamp_in_world: Vector3::new(3.0, 0.0, 3.0), ..Lighting::EVEN };
        let shine = |x: f64, y: f64, z: f64| light.shine_on(&highlight, &Vector3::z(), &Vector3::new(x, y, z));
        assert!((shine(-2.0, 0.0, 2.0) - 64.0).abs() < 1e-9);
        // 10 degrees from the mirrored direction: cos(10 deg)^40 = 0.5420.
        let (sin, cos) = 55.0f64.to_radians().sin_cos();
        assert!((shine(-sin, 0.0, cos) - 64.0 * 0.5420).abs() < 0.02, "{}", shine(-sin, 0.0, cos));
        assert_eq!(shine(1.0, 0.0, 1.0), 0.0);
        let from_behind = Lighting { towards_lamp_in_world: Vector3::new(3.0, 0.0, -3.0), ..Lighting::EVEN };
        assert_eq!(from_behind.shine_on(&highlight, &Vector3::z(), &Vector3::new(-1.0, 0.0, -1.0)), 0.0);
    }

    #[test]
    fn numbers_out_of_range_are_named() {
        let mut config = SceneConfig::new(TargetConfig::crab(0.010));
        config.lighting.ambient = -1.0;
        let message = Scene::build(&config).unwrap_err().to_string();
        assert_eq!(message, "scene parameter lighting.ambient is -1; set it between 0 and 4");
    }
}
