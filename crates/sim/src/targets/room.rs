//! The room around the workcell: painted block walls, floor and ceiling, in muted colours.

use std::sync::Arc;

use nalgebra::{Point3, Vector2};

use super::mesh::{Face, Mesh};
use super::texture::{Colour, Texture, colour_from_hsv, mix_colours, painted_once};
use crate::noise::{ValueNoise, hash, smooth_step};
use crate::targets::part::{Anchor, SceneObject, ScenePart};

/// Half the width of the room in x and y of `world`, metres.
const HALF_WIDTH_M: f64 = 3.2;

/// Height of the floor and of the ceiling in `world`, metres: the arms are mounted on a pedestal.
const FLOOR_M: f64 = -0.9;
const CEILING_M: f64 = 2.3;

/// Width of the area that one copy of a texture covers, metres.
const TILE_M: f64 = 1.6;

/// Creates the room, in `world`.
pub fn build(seed: u32) -> Vec<ScenePart> {
    let surface = |face: &Face, texture: &Arc<Texture>| ScenePart {
        mesh: tiled(face),
        texture: Arc::clone(texture),
        anchor: Anchor::World,
        object: SceneObject::Room,
    };
    let wall = painted_once(("blocks", [u64::from(seed), 0, 0, 0]), || blocks(seed));
    let floor = painted_once(("floor", [u64::from(seed), 0, 0, 0]), || plain(hash(&[seed, 1]), [92.0, 96.0, 94.0]));
    let ceiling =
        painted_once(("ceiling", [u64::from(seed), 0, 0, 0]), || plain(hash(&[seed, 2]), [178.0, 177.0, 172.0]));
    let faces = faces();
    let textures = [&wall, &wall, &wall, &wall, &floor, &ceiling];
    faces.iter().zip(textures).map(|(face, texture)| surface(face, texture)).collect()
}

/// The six faces as seen from within: walls at +x, -y, -x, +y, floor, ceiling.
fn faces() -> [Face; 6] {
    let wall = |from: (f64, f64), to: (f64, f64)| {
        let corner = |(x, y): (f64, f64), z| Point3::new(x * HALF_WIDTH_M, y * HALF_WIDTH_M, z);
        [corner(from, CEILING_M), corner(to, CEILING_M), corner(to, FLOOR_M), corner(from, FLOOR_M)]
    };
    let flat = |z: f64, side: f64| {
        [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
            .map(|(x, y)| Point3::new(x * HALF_WIDTH_M, side * y * HALF_WIDTH_M, z))
    };
    [
        wall((1.0, 1.0), (1.0, -1.0)),
        wall((1.0, -1.0), (-1.0, -1.0)),
        wall((-1.0, -1.0), (-1.0, 1.0)),
        wall((-1.0, 1.0), (1.0, 1.0)),
        flat(FLOOR_M, 1.0),
        flat(CEILING_M, -1.0),
    ]
}

fn tiled(face: &Face) -> Mesh {
    let (right, down) = (face[1] - face[0], face[3] - face[0]);
    let (u, v) = (right.norm() / TILE_M, down.norm() / TILE_M);
    let mut mesh = Mesh::default();
    mesh.add_quad([
        (face[0], Vector2::new(0.0, 0.0)),
        (face[1], Vector2::new(u, 0.0)),
        (face[2], Vector2::new(u, v)),
        (face[3], Vector2::new(0.0, v)),
    ]);
    mesh
}

/// Painted concrete blocks, 0.4 x 0.2 m, in running bond; repeats without a seam.
fn blocks(seed: u32) -> Texture {
    let noise = seamless(hash(&[seed, 3]));
    let paint: Colour = colour_from_hsv(196.0, 0.13, 0.62);
    let joint: Colour = colour_from_hsv(200.0, 0.10, 0.50);
    Texture::from_fn(9, 9, |u, v| {
        let row = (v * 8.0).floor();
        let along = u * 4.0 + 0.5 * (row - 2.0 * (row / 2.0).floor());
        let to_edge = |x: f64| (x - x.floor()).min(1.0 - (x - x.floor()));
        let edge_m = (0.4 * to_edge(along)).min(0.2 * to_edge(v * 8.0));
        let block = hash(&[seed, row as u32, along.floor() as u32 % 4]);
        let tone = 0.96 + 0.08 * f64::from(block & 0xff) / 255.0 + 0.14 * (noise(u, v) - 0.5);
        mix_colours(&joint, &paint, smooth_step(0.004, 0.010, edge_m)).map(|channel| channel * tone)
    })
}

fn plain(seed: u32, colour: Colour) -> Texture {
    let noise = seamless(seed);
    Texture::from_fn(8, 8, |u, v| colour.map(|channel| channel * (0.9 + 0.2 * noise(u, v))))
}

/// Noise over the unit square that continues on its opposite side: two shifted copies, cross-faded.
fn seamless(seed: u32) -> impl Fn(f64, f64) -> f64 {
    let noise = ValueNoise::new(seed);
    move |u, v| {
        let at = |u: f64, v: f64| noise.fractal(u * 24.0, v * 24.0, 4);
        let across = |v: f64| at(u, v) * (1.0 - u) + at(u - 1.0, v) * u;
        across(v) * (1.0 - v) + across(v - 1.0) * v
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_room_is_rendered_from_within_and_closed() {
        let mut area = 0.0;
        for part in build(1) {
            for triangle in &part.mesh.triangles {
                let [a, b, c] = part.mesh.corners_m(triangle);
                let normal = (b - a).cross(&(c - a));
                area += normal.norm() / 2.0;
                assert!(normal.dot(&(Point3::new(0.3, -0.2, 0.5) - a)) > 0.0, "{a} {b} {c}");
            }
        }
        assert!((area - (2.0 * 6.4 * 6.4 + 4.0 * 6.4 * 3.2)).abs() < 1e-9, "{area}");
    }

    #[test]
    fn noise_has_no_seam() {
        let noise = seamless(5);
        for k in 0..20 {
            let t = f64::from(k) / 20.0;
            assert!((noise(0.0, t) - noise(1.0, t)).abs() < 1e-9);
            assert!((noise(t, 0.0) - noise(t, 1.0)).abs() < 1e-9);
        }
    }
}
