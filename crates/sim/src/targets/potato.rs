//! The potato: a lumpy rounded solid with a 3-D procedural texture, so that it has no seams.

use std::sync::Arc;

use nalgebra::{Point2, Point3, Vector2, Vector3};

use super::Draft;
use super::mesh::{Mesh, Vertex};
use super::outline::convex_hull;
use super::texture::{Colour, Texture, colour_from_hsv, mix_colours, painted_once};
use crate::noise::{ValueNoise, hash, smooth_step};

/// Cells along each side of the six patches of the surface.
const CELLS: usize = 18;

/// Size of a patch's texture relative to the half side of the patch.
const MARGIN: f64 = 1.06;

/// Viewing distance for the outline, metres.
const VIEWING_DISTANCE_M: f64 = 0.5;

/// Directions of a patch's centre, right and down as seen from outside.
type Side = [Vector3<f64>; 3];

pub(super) fn build(size_m: &[f64; 3], seed: u32) -> Draft {
    build_with(size_m, seed, |side| {
        let [x, y, z] = side[0].map(f64::to_bits).into();
        painted_once(("potato", [u64::from(seed), x, y, z]), || paint(side, seed))
    })
}

/// The potato's shape with a texture for each of its sides.
pub(super) fn build_with(size_m: &[f64; 3], seed: u32, texture: impl Fn(&Side) -> Arc<Texture>) -> Draft {
    let solid =
        Solid { radii_m: Vector3::from(size_m.map(|size| size / 2.0)), lumps: ValueNoise::new(hash(&[seed, 0x907A])) };
    let surfaces: Vec<_> = sides().iter().map(|side| (patch(&solid, side), texture(side))).collect();
    let outline_m = silhouette(surfaces.iter().flat_map(|(mesh, _)| mesh.vertices.iter().map(|v| v.position_m)));
    Draft { name: "potato", surfaces, outline_m }
}

/// The six sides of a cube.
fn sides() -> [Side; 6] {
    let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
    [[-z, x, y], [z, -x, y], [x, z, y], [-x, -z, y], [-y, x, -z], [y, x, z]]
}

struct Solid {
    radii_m: Vector3<f64>,
    lumps: ValueNoise,
}

impl Solid {
    /// Surface point in the direction of `d`.
    fn point(&self, d: &Vector3<f64>) -> Point3<f64> {
        let d = d.normalize();
        let lump = self.lumps.fractal_3d(&(d * 1.3 + Vector3::repeat(9.0)), 2) - 0.5;
        Point3::from(d.component_mul(&self.radii_m) * (1.0 + 0.30 * lump))
    }
}

/// Direction of a position on a patch, `a` and `b` from -1 to 1.
fn direction(side: &Side, a: f64, b: f64) -> Vector3<f64> {
    (side[0] + side[1] * a + side[2] * b).normalize()
}

fn patch(solid: &Solid, side: &Side) -> Mesh {
    let place = |i: usize| 2.0 * i as f64 / CELLS as f64 - 1.0;
    let mut mesh = Mesh::default();
    for j in 0..=CELLS {
        for i in 0..=CELLS {
            mesh.vertices.push(vertex(solid, side, place(i), place(j)));
        }
    }
    let index = |i: usize, j: usize| (j * (CELLS + 1) + i) as u32;
    for (i, j) in (0..CELLS).flat_map(|j| (0..CELLS).map(move |i| (i, j))) {
        let [a, b, c, d] = [index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)];
        mesh.triangles.push([a, d, b]);
        mesh.triangles.push([b, d, c]);
    }
    mesh
}

fn vertex(solid: &Solid, side: &Side, a: f64, b: f64) -> Vertex {
    let step = 0.01;
    let along = |da: f64, db: f64| {
        solid.point(&direction(side, a + da, b + db)) - solid.point(&direction(side, a - da, b - db))
    };
    Vertex {
        position_m: solid.point(&direction(side, a, b)),
        texture: Vector2::new(a, b) / (2.0 * MARGIN) + Vector2::repeat(0.5),
        normal: along(0.0, step).cross(&along(step, 0.0)).normalize(),
    }
}

/// Outermost points as seen from the front.
fn silhouette(points: impl Iterator<Item = Point3<f64>>) -> Vec<Point3<f64>> {
    let points: Vec<_> = points.collect();
    let projected: Vec<_> = points.iter().map(|p| Point2::new(p.x, p.y) / (p.z + VIEWING_DISTANCE_M)).collect();
    convex_hull(&projected).into_iter().map(|index| points[index]).collect()
}

/// Skin: earthy yellow, darker blotches, eyes and grain.
fn paint(side: &Side, seed: u32) -> Texture {
    let noise = |k: u32| ValueNoise::new(hash(&[seed, 0x907A, k]));
    let (tone, blotches, grain, eyes) = (noise(1), noise(2), noise(3), noise(4));
    Texture::from_fn(8, 8, |u, v| {
        let d = direction(side, (2.0 * u - 1.0) * MARGIN, (2.0 * v - 1.0) * MARGIN);
        let blotch = blotches.fractal_3d(&(d * 4.0 + Vector3::repeat(20.0)), 3);
        let speckle = grain.fractal_3d(&(d * 22.0), 3);
        let hue = 38.0 + 14.0 * (tone.fractal_3d(&(d * 2.5), 2) - 0.5);
        let skin = colour_from_hsv(hue, 0.48 + 0.25 * blotch, 0.86 - 0.42 * blotch + 0.42 * (speckle - 0.5));
        let earth: Colour = colour_from_hsv(hue - 8.0, 0.55, 0.30);
        let eye = eyes.at_3d(&(d * 5.5 + Vector3::repeat(3.0)));
        let earthy = 0.75 * smooth_step(0.74, 0.86, eye) + 0.5 * smooth_step(0.62, 0.75, speckle);
        mix_colours(&skin, &earth, earthy.min(1.0))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_surface_is_closed_and_looks_outward() {
        let draft = build(&[0.115, 0.08, 0.07], 2);
        let mut volume = 0.0;
        for (mesh, _) in &draft.surfaces {
            for triangle in &mesh.triangles {
                let [a, b, c] = mesh.corners_m(triangle);
                let normal = (b - a).cross(&(c - a));
                assert!(normal.dot(&a.coords) > 0.0);
                assert!(normal.dot(&mesh.vertices[triangle[0] as usize].normal) > 0.0);
                volume += a.coords.dot(&b.coords.cross(&c.coords)) / 6.0;
            }
        }
        let ellipsoid = 4.0 / 3.0 * std::f64::consts::PI * 0.0575 * 0.04 * 0.035;
        assert!((volume / ellipsoid - 1.0).abs() < 0.2, "{volume} against {ellipsoid}");
    }
}
