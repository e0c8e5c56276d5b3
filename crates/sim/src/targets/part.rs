//! Parts of a scene, and the errors of scenes.

use std::ops::RangeInclusive;
use std::sync::Arc;

use crate::targets::mesh::Mesh;
use crate::targets::texture::Texture;

/// What a part of the scene is fixed to; determines the frame of its mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// The workcell.
    World,
    /// The carried target.
    Target,
}

/// The object visible at a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SceneObject {
    /// Nothing at all.
    Nothing,
    /// Walls, floor, ceiling.
    Room,
    /// The panel behind the target.
    Backdrop,
    /// The target.
    Target,
}

/// One textured surface.
#[derive(Clone, Debug)]
pub struct ScenePart {
    /// The surface, in the frame of its anchor.
    pub mesh: Mesh,
    /// Its colours.
    pub texture: Arc<Texture>,
    /// Anchor of the part.
    pub anchor: Anchor,
    /// Object that the part belongs to.
    pub object: SceneObject,
}

/// Why a scene was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// A number is out of its range.
    #[error("scene parameter {name} is {value}; set it between {min} and {max}")]
    Parameter {
        /// Name of the parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Smallest allowed.
        min: f64,
        /// Largest allowed.
        max: f64,
    },
    /// More surfaces than the renderer supports.
    #[error("the scene has {parts} surfaces with up to {triangles} triangles; at most 4000 and 500000 are possible")]
    TooLarge {
        /// Number of parts.
        parts: usize,
        /// Number of triangles in all parts.
        triangles: usize,
    },
}

pub(crate) fn check(name: &'static str, value: f64, allowed: RangeInclusive<f64>) -> Result<(), SceneError> {
    if allowed.contains(&value) {
        return Ok(());
    }
    let (min, max) = allowed.into_inner();
    Err(SceneError::Parameter { name, value, min, max })
}
