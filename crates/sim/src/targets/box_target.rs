//! The box: grey, textured, seen from its front.

use std::sync::Arc;

use nalgebra::Point3;

use super::Draft;
use super::card::whole_face;
use super::mesh::box_faces;
use super::texture::{Texture, colour_from_hsv, painted_once};
use crate::noise::{ScatteredPoints, ValueNoise, hash, smooth_step};

pub(super) fn build(size_m: &[f64; 3], seed: u32) -> Draft {
    build_with(size_m, |side| {
        painted_once(("box", [u64::from(seed), u64::from(side), 0, 0]), || paint(hash(&[seed, 0xB0C5, side])))
    })
}

/// The box's shape with a texture for each of its sides.
pub(super) fn build_with(size_m: &[f64; 3], texture: impl Fn(u32) -> Arc<Texture>) -> Draft {
    let [half_x, half_y, _] = size_m.map(|size| size / 2.0);
    let faces = box_faces(&Point3::new(-half_x, -half_y, 0.0), &Point3::new(half_x, half_y, size_m[2]));
    let surfaces = (0u32..).zip(&faces).map(|(side, face)| (whole_face(face), texture(side))).collect();
    Draft { name: "box", surfaces, outline_m: faces[0].to_vec() }
}

/// Grey concrete: clouds, pores, scratches; saturation 0.03.
fn paint(seed: u32) -> Texture {
    let noise = |k: u32| ValueNoise::new(hash(&[seed, k]));
    let (clouds, grain, scratches) = (noise(1), noise(2), noise(3));
    let pores = ScatteredPoints::new(hash(&[seed, 4]));
    Texture::from_fn(8, 8, |u, v| {
        let cloud = clouds.fractal(u * 5.0, v * 4.0, 4);
        let fine = grain.fractal(u * 38.0, v * 30.0, 2);
        let pore = pores.nearest(u * 13.0, v * 10.0);
        let size = 0.10 + 0.22 * f64::from(pore.id & 0xff) / 255.0;
        let scratch = (scratches.at(u * 3.0 + v * 22.0, v * 5.0 - u * 9.0) - 0.5).abs();
        let value = 0.22 + 0.62 * cloud + 0.24 * (fine - 0.5) - 0.26 * smooth_step(size, 0.6 * size, pore.distance)
            + 0.13 * smooth_step(0.03, 0.0, scratch);
        // A rim of worn paint makes the edges of the box visible.
        let edge = u.min(v).min(1.0 - u).min(1.0 - v);
        colour_from_hsv(40.0, 0.03, (value + 0.12 * smooth_step(0.05, 0.02, edge)).clamp(0.06, 0.92))
    })
}
