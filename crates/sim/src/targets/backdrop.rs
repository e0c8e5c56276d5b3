//! The panel behind the target: sea floor with sand, bluish patches, pebbles and shells.

use std::ops::RangeInclusive;
use std::sync::Arc;

use nalgebra::Point3;

use super::card::whole_face;
use super::mesh::box_faces;
use super::texture::{Colour, Texture, colour_from_hsv, mix_colours, painted_once};
use crate::noise::{ScatteredPoints, ValueNoise, hash, smooth_step};
use crate::targets::part::{Anchor, SceneError, SceneObject, ScenePart, check};

/// Thickness of the panel, metres.
const THICKNESS_M: f64 = 0.008;

/// Minimum distance behind the target, metres; nearer surfaces could not be distinguished.
const GAP_MIN_M: f64 = 1e-4;

/// The panel that carries the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BackdropConfig {
    /// Width and height, 0.05 to 2 m.
    pub size_m: [f64; 2],
    /// Distance behind the target's rearmost point, 0 (directly behind, in fact 0.1 mm) to 1 m.
    pub gap_m: f64,
}

impl BackdropConfig {
    /// Allowed widths and heights.
    pub const SIZE_M: RangeInclusive<f64> = 0.05..=2.0;
    /// Allowed values of `gap_m`.
    pub const GAP_M: RangeInclusive<f64> = 0.0..=1.0;
}

impl Default for BackdropConfig {
    fn default() -> Self {
        Self { size_m: [0.40, 0.30], gap_m: 0.03 }
    }
}

/// Creates the panel, centred behind the target whose rearmost point lies at `rear_z_m` in `target`.
///
/// # Errors
/// A number out of its range.
pub fn build(config: &BackdropConfig, rear_z_m: f64, seed: u32) -> Result<Vec<ScenePart>, SceneError> {
    check("backdrop.gap_m", config.gap_m, BackdropConfig::GAP_M)?;
    for size in config.size_m {
        check("backdrop.size_m", size, BackdropConfig::SIZE_M)?;
    }
    let [half_x, half_y] = config.size_m.map(|size| size / 2.0);
    let front = rear_z_m + config.gap_m.max(GAP_MIN_M);
    let faces = box_faces(&Point3::new(-half_x, -half_y, front), &Point3::new(half_x, half_y, front + THICKNESS_M));
    let board = Arc::new(Texture::from_fn(0, 0, |_, _| [96.0, 92.0, 86.0]));
    let sizes = config.size_m.map(f64::to_bits);
    let sand = painted_once(("sand", [u64::from(seed), sizes[0], sizes[1], 0]), || paint(config.size_m, seed));
    let textures = std::iter::once(sand).chain(std::iter::repeat(board));
    Ok(faces
        .iter()
        .zip(textures)
        .map(|(face, texture)| ScenePart {
            mesh: whole_face(face),
            texture,
            anchor: Anchor::Target,
            object: SceneObject::Backdrop,
        })
        .collect())
}

/// Sand with ripples, bluish patches, pebbles and shell fragments; features have their size in millimetres.
fn paint(size_m: [f64; 2], seed: u32) -> Texture {
    let noise = |k: u32| ValueNoise::new(hash(&[seed, 0x5EA0, k]));
    let (dunes, ripple_bend, grain, water, chips) = (noise(1), noise(2), noise(3), noise(4), noise(7));
    let pebbles = ScatteredPoints::new(hash(&[seed, 0x5EA0, 5]));
    let shells = ScatteredPoints::new(hash(&[seed, 0x5EA0, 6]));
    Texture::from_fn(10, 9, |u, v| {
        let (x, y) = (u * size_m[0] * 1e3, v * size_m[1] * 1e3);
        let dune = dunes.fractal(x / 45.0, y / 38.0, 3);
        let bend = 22.0 * ripple_bend.fractal(x / 60.0, y / 60.0, 2);
        let ripple = 1.0 - 2.0 * (((y + 0.25 * x + bend) / 11.0).rem_euclid(1.0) - 0.5).abs();
        let fine = grain.fractal(x / 2.2, y / 2.2, 2);
        let value = 0.50 + 0.30 * dune + 0.10 * (ripple - 0.5) + 0.22 * (fine - 0.5);
        let sand = colour_from_hsv(41.0 + 8.0 * (dune - 0.5), 0.32 + 0.12 * (0.5 - dune), value);
        let blue = colour_from_hsv(208.0 + 20.0 * (fine - 0.5), 0.42, value * 0.88);
        let depth = water.fractal(x / 62.0 + 7.0, y / 55.0, 3);
        let ground = mix_colours(&sand, &blue, 0.9 * smooth_step(0.52, 0.62, depth));
        // Warped coordinates make irregular stones and fragments.
        let bent = |k: f64| 2.6 * (chips.fractal(x / 5.0 + k, y / 5.0, 2) - 0.5);
        let (x, y) = (x + bent(0.0), y + bent(31.0));
        let ground = pebble(&ground, &pebbles, x / 17.0, y / 13.0);
        shell(&ground, &shells, x / 30.0, y / 30.0)
    })
}

/// Grey to brown stones with a shaded rim, in some of the cells.
fn pebble(ground: &Colour, pebbles: &ScatteredPoints, x: f64, y: f64) -> Colour {
    let stone = pebbles.nearest(x, y);
    let random = |shift: u32| f64::from((stone.id >> shift) & 0xff) / 255.0;
    if random(0) < 0.5 {
        return *ground;
    }
    let size = 0.10 + 0.20 * random(8);
    let tone = colour_from_hsv(25.0 + 30.0 * random(16), 0.12 + 0.15 * random(20), 0.30 + 0.45 * random(24));
    let rounded = tone.map(|channel| channel * (1.1 - 0.5 * (stone.distance / size).min(1.0)));
    mix_colours(ground, &rounded, smooth_step(size, 0.88 * size, stone.distance))
}

/// Pale ribbed fragments of shells, in some of the cells.
fn shell(ground: &Colour, shells: &ScatteredPoints, x: f64, y: f64) -> Colour {
    let piece = shells.nearest(x, y);
    let random = |shift: u32| f64::from((piece.id >> shift) & 0xff) / 255.0;
    if random(0) < 0.45 {
        return *ground;
    }
    let size = 0.06 + 0.06 * random(8);
    let pale = colour_from_hsv(20.0 + 25.0 * random(16), 0.08 + 0.14 * random(20), 0.90);
    let rib = 0.72 + 0.28 * (1.0 - 2.0 * ((piece.distance / size * 2.5).rem_euclid(1.0) - 0.5).abs());
    mix_colours(ground, &pale.map(|channel| channel * rib), smooth_step(size, 0.82 * size, piece.distance))
}
