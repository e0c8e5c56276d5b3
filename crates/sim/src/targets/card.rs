//! The card: flat, with colours of all hues.

use std::sync::Arc;

use nalgebra::{Point3, Vector2};

use super::Draft;
use super::mesh::{Face, Mesh, box_faces};
use super::texture::{Colour, Texture, colour_from_hsv, mix_colours, painted_once};
use crate::noise::{ScatteredPoints, ValueNoise, hash, smooth_step};

/// Thickness, metres.
const THICKNESS_M: f64 = 0.002;

/// Share of the texture on either side that lies beyond the edge, so that no colour of the other side bleeds in.
const MARGIN: f64 = 0.02;

pub(super) fn build(size_m: &[f64; 2], seed: u32) -> Draft {
    let paper = Texture::from_fn(0, 0, |_, _| [205.0, 202.0, 194.0]);
    build_with(size_m, painted_once(("card", [u64::from(seed), 0, 0, 0]), || paint(seed)), Arc::new(paper))
}

/// The card's shape with any textures, for the front and for the other sides.
pub(super) fn build_with(size_m: &[f64; 2], front: Arc<Texture>, paper: Arc<Texture>) -> Draft {
    let [half_x, half_y] = size_m.map(|size| size / 2.0);
    let faces = box_faces(&Point3::new(-half_x, -half_y, 0.0), &Point3::new(half_x, half_y, THICKNESS_M));
    let mut surfaces = vec![(whole_face(&faces[0]), front)];
    surfaces.extend(faces[1..].iter().map(|face| (whole_face(face), Arc::clone(&paper))));
    Draft { name: "card", surfaces, outline_m: faces[0].to_vec() }
}

/// A face that shows its whole texture, except for a margin.
pub(super) fn whole_face(face: &Face) -> Mesh {
    let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
        .map(|(u, v)| Vector2::new(u, v) * (1.0 - 2.0 * MARGIN) + Vector2::repeat(MARGIN));
    let mut mesh = Mesh::default();
    mesh.add_quad(std::array::from_fn(|k| (face[k], corners[k])));
    mesh
}

fn paint(seed: u32) -> Texture {
    Texture::from_fn(9, 9, colours(seed))
}

/// Patches of every hue, large and small, with grain; the arguments are shares of the card's width and height.
pub(super) fn colours(seed: u32) -> impl Fn(f64, f64) -> Colour {
    let warp = [1, 2].map(|k| ValueNoise::new(hash(&[seed, 0xCA2D, k])));
    let grain = ValueNoise::new(hash(&[seed, 0xCA2D, 3]));
    let patches = [(7.0, 5u32), (16.0, 6)].map(|(scale, k)| (scale, ScatteredPoints::new(hash(&[seed, 0xCA2D, k]))));
    move |u, v| {
        let (x, y) = (u * 1.33, v);
        let bend = |k: usize| 0.10 * (warp[k].fractal(x * 6.0, y * 6.0, 3) - 0.5);
        let (x, y) = (x + bend(0), y + bend(1));
        let layers = patches.map(|(scale, points)| patch(&points, x * scale, y * scale));
        let mixed = mix_colours(&layers[0].0, &layers[1].0, if layers[1].1 { 0.9 } else { 0.25 });
        let tone = 0.82 + 0.36 * (grain.fractal(u * 60.0, v * 45.0, 3) - 0.5);
        mixed.map(|channel| channel * tone)
    }
}

/// Colour of the patch at a position, and whether the patch stands out.
fn patch(points: &ScatteredPoints, x: f64, y: f64) -> (Colour, bool) {
    let nearest = points.nearest(x, y);
    let random = |shift: u32| f64::from((nearest.id >> shift) & 0xff) / 255.0;
    let colour = colour_from_hsv(360.0 * random(0), 0.55 + 0.4 * random(8), 0.55 + 0.45 * random(16));
    let border = smooth_step(0.0, 0.10, nearest.second_distance - nearest.distance);
    (mix_colours(&colour.map(|c| 0.45 * c), &colour, border), random(24) > 0.55)
}
