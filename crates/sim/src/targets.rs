//! Targets, backdrop and room: meshes and textures generated from a seed. All are original; this crate contains no image files.
//!
//! The frame `target` has its origin at the target centre on its front plane, x right, y down and z away from the cameras when
//! seen frontally: the axes of the `model` frame.

pub mod backdrop;
pub mod board;
pub mod box_target;
pub mod card;
pub mod crab;
pub mod mesh;
pub mod outline;
pub mod paint;
pub mod part;
pub mod potato;
pub mod room;
pub mod texture;

use std::ops::RangeInclusive;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};

pub use backdrop::BackdropConfig;
pub use paint::Paint;

use mesh::Mesh;
use texture::Texture;

use crate::targets::part::{Anchor, SceneError, SceneObject, ScenePart, check};

/// The target and its shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TargetConfig {
    /// A crab, about 110 mm wide, mostly of one hue (14 degrees +- 8) with dark spots.
    Crab {
        /// Height of the shell over the rim, 0 (flat) to 0.04 m.
        relief_m: f64,
    },
    /// A flat card with all hues.
    Card {
        /// Width and height, 0.02 to 0.4 m.
        size_m: [f64; 2],
    },
    /// A grey textured box.
    GreyBox {
        /// Width, height, depth, 0.02 to 0.4 m.
        size_m: [f64; 3],
    },
    /// A lumpy, rounded solid.
    Potato {
        /// Length, height, thickness, 0.02 to 0.4 m.
        size_m: [f64; 3],
    },
    /// A chessboard, for calibrations.
    Chessboard {
        /// Inner corners along its width and its height, 3 to 20.
        corners: [u32; 2],
        /// Side of a square, 0.005 to 0.05 m.
        square_m: f64,
    },
}

impl TargetConfig {
    /// Allowed reliefs, metres.
    pub const RELIEF_M: RangeInclusive<f64> = 0.0..=0.04;

    /// The crab with a relief of the given height, metres.
    pub const fn crab(relief_m: f64) -> Self {
        Self::Crab { relief_m }
    }

    /// The card in its default size.
    pub const fn card() -> Self {
        Self::Card { size_m: [0.12, 0.09] }
    }

    /// The box in its default size.
    pub const fn grey_box() -> Self {
        Self::GreyBox { size_m: [0.11, 0.085, 0.06] }
    }

    /// The potato in its default size.
    pub const fn potato() -> Self {
        Self::Potato { size_m: [0.115, 0.08, 0.07] }
    }

    /// Name in configurations: `crab`, `card`, `box`, `potato`; `chessboard` for a board, which no configuration uses.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Crab { .. } => "crab",
            Self::Card { .. } => "card",
            Self::GreyBox { .. } => "box",
            Self::Potato { .. } => "potato",
            Self::Chessboard { .. } => "chessboard",
        }
    }
}

/// Geometry of a target.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetModel {
    /// `crab`, `card`, `box`, `potato`, `chessboard`.
    pub name: &'static str,
    /// The target's outline seen frontally from half a metre, as points on its surface in `target`, metres; the polygon is
    /// closed. Projected into the left image it is the region that an operator would draw.
    ///
    /// The front plane is z = 0: the front face of a flat target, the mean over the visible front of a relief or solid.
    pub outline_m: Vec<Point3<f64>>,
    /// z of the target's rearmost point in `target`, metres.
    pub rear_z_m: f64,
}

/// A target under construction, with any origin.
pub(crate) struct Draft {
    pub(crate) name: &'static str,
    pub(crate) surfaces: Vec<(Mesh, Arc<Texture>)>,
    pub(crate) outline_m: Vec<Point3<f64>>,
}

/// Creates a target.
///
/// # Errors
/// A number out of its range.
pub fn build(config: &TargetConfig, seed: u32) -> Result<(TargetModel, Vec<ScenePart>), SceneError> {
    check_config(config)?;
    let draft = match config {
        TargetConfig::Crab { relief_m } => crab::build(*relief_m, seed),
        TargetConfig::Card { size_m } => card::build(size_m, seed),
        TargetConfig::GreyBox { size_m } => box_target::build(size_m, seed),
        TargetConfig::Potato { size_m } => potato::build(size_m, seed),
        TargetConfig::Chessboard { corners, square_m } => board::build(*corners, *square_m),
    };
    Ok(finish(draft))
}

/// The geometry of [`build`], without textures: for simulations that render nothing.
///
/// # Errors
/// A number out of its range.
pub fn model(config: &TargetConfig, seed: u32) -> Result<TargetModel, SceneError> {
    check_config(config)?;
    let plain = Arc::new(Texture::from_fn(0, 0, |_, _| [0.0; 3]));
    let draft = match config {
        TargetConfig::Crab { relief_m } => crab::build_with(*relief_m, seed, plain),
        TargetConfig::Card { size_m } => card::build_with(size_m, Arc::clone(&plain), plain),
        TargetConfig::GreyBox { size_m } => box_target::build_with(size_m, |_| Arc::clone(&plain)),
        TargetConfig::Potato { size_m } => potato::build_with(size_m, seed, |_| Arc::clone(&plain)),
        TargetConfig::Chessboard { corners, square_m } => {
            board::build_with(*corners, *square_m, Arc::clone(&plain), plain)
        }
    };
    Ok(finish(draft).0)
}

fn check_config(config: &TargetConfig) -> Result<(), SceneError> {
    let sizes: &[f64] = match config {
        TargetConfig::Crab { relief_m } => {
            check("target.relief_m", *relief_m, TargetConfig::RELIEF_M)?;
            &[]
        }
        TargetConfig::Card { size_m } => size_m,
        TargetConfig::GreyBox { size_m } | TargetConfig::Potato { size_m } => size_m,
        TargetConfig::Chessboard { corners, square_m } => {
            for count in corners {
                check("target.corners", f64::from(*count), 3.0..=20.0)?;
            }
            check("target.square_m", *square_m, 0.005..=0.05)?;
            &[]
        }
    };
    sizes.iter().try_for_each(|&size| check("target.size_m", size, 0.02..=0.4))
}

/// Width and height of a chessboard with these inner corners, including the white border, metres.
pub fn board_size_m(corners: [u32; 2], square_m: f64) -> [f64; 2] {
    corners.map(|corners| f64::from(corners + 3) * square_m)
}

/// Creates a target with the crab's outline and relief (metres, 0 to 0.04) in any paint: for measurements in which only the
/// texture differs.
///
/// # Errors
/// A relief out of its range.
pub fn build_painted(paint: Paint, relief_m: f64, seed: u32) -> Result<(TargetModel, Vec<ScenePart>), SceneError> {
    check("target.relief_m", relief_m, TargetConfig::RELIEF_M)?;
    let texture = texture::painted_once((paint.name(), [u64::from(seed), 0, 0, 0]), || paint.texture(seed));
    Ok(finish(Draft { name: paint.name(), ..crab::build_with(relief_m, seed, texture) }))
}

/// Moves the origin to the centroid of the outline on the front plane.
fn finish(mut draft: Draft) -> (TargetModel, Vec<ScenePart>) {
    let (area, moments) = draft
        .surfaces
        .iter()
        .map(|(mesh, _)| mesh.frontal_moments())
        .fold((0.0, Vector3::zeros()), |(area, moments), (more_area, more_moments)| {
            (area + more_area, moments + more_moments)
        });
    let centre = outline::centroid(&draft.outline_m);
    let depth = if area > 0.0 { moments.z / area } else { 0.0 };
    let offset = Vector3::new(-centre.x, -centre.y, -depth);
    for point in &mut draft.outline_m {
        *point += offset;
    }
    let mut rear_z_m = f64::NEG_INFINITY;
    let mut parts = Vec::new();
    for (mut mesh, texture) in draft.surfaces {
        mesh.translate(&offset);
        rear_z_m = mesh.vertices.iter().fold(rear_z_m, |rear, vertex| rear.max(vertex.position_m.z));
        parts.push(ScenePart { mesh, texture, anchor: Anchor::Target, object: SceneObject::Target });
    }
    (TargetModel { name: draft.name, outline_m: draft.outline_m, rear_z_m }, parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [TargetConfig; 6] = [
        TargetConfig::crab(0.0),
        TargetConfig::crab(0.025),
        TargetConfig::card(),
        TargetConfig::grey_box(),
        TargetConfig::potato(),
        TargetConfig::Chessboard { corners: [8, 5], square_m: 0.0115 },
    ];

    #[test]
    fn every_target_is_centred_on_its_front_plane() {
        for config in ALL {
            let (model, parts) = build(&config, 3).unwrap();
            let centre = outline::centroid(&model.outline_m);
            assert!(centre.x.abs() < 1e-9 && centre.y.abs() < 1e-9, "{}: {centre}", model.name);
            let (area, moments) = parts
                .iter()
                .map(|part| part.mesh.frontal_moments())
                .fold((0.0, 0.0), |(area, z), (more, moments)| (area + more, z + moments.z));
            assert!((moments / area).abs() < 1e-9, "{}", model.name);
            let width = model.outline_m.iter().map(|p| p.x).fold(f64::MIN, f64::max)
                - model.outline_m.iter().map(|p| p.x).fold(f64::MAX, f64::min);
            assert!((0.1..0.13).contains(&width), "{} is {width} m wide", model.name);
            assert!(model.outline_m.len() >= 4 && model.outline_m.len() < 800, "{}", model.outline_m.len());
            assert_eq!(model.name, config.name());
        }
    }

    #[test]
    fn the_model_without_textures_is_the_same() {
        for config in ALL {
            assert_eq!(super::model(&config, 3).unwrap(), build(&config, 3).unwrap().0);
        }
        assert!(super::model(&TargetConfig::crab(f64::NAN), 1).is_err());
    }

    #[test]
    fn flat_targets_are_flat() {
        for config in [TargetConfig::crab(0.0), TargetConfig::card(), TargetConfig::grey_box()] {
            let (model, _) = build(&config, 3).unwrap();
            assert!(model.outline_m.iter().all(|p| p.z.abs() < 1e-9), "{}", model.name);
        }
    }

    #[test]
    fn sizes_out_of_range_are_refused() {
        let error = build(&TargetConfig::Card { size_m: [0.12, 4.0] }, 1).unwrap_err().to_string();
        assert_eq!(error, "scene parameter target.size_m is 4; set it between 0.02 and 0.4");
        assert!(build(&TargetConfig::crab(f64::NAN), 1).is_err());
    }
}
