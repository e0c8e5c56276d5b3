//! The crab: shell, claws and legs cut out along a smooth outline, with a relief and a spotted texture of one hue.

use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

use nalgebra::{Point2, Point3, Vector2, Vector3};

use super::Draft;
use super::mesh::{Mesh, Vertex};
use super::outline::{CutGrid, GridArea, cut_grid};
use super::texture::{Colour, Texture, colour_from_hsv, mix_colours, painted_once};
use crate::noise::{ScatteredPoints, ValueNoise, hash, smooth_step};

/// The texture and the grid reach from minus this to plus this, metres.
const HALF_SIZE_M: f64 = 0.064;

/// Thickness of the rim, metres.
const RIM_M: f64 = 0.003;

/// Depth inside the outline at which the relief reaches its full height, millimetres.
const SLOPE_MM: f64 = 15.0;

/// A tapered limb between two points, millimetres: x, y, radius at either end.
type Limb = [[f64; 3]; 2];

/// Limbs of the right side; the left side mirrors them.
const LIMBS: [Limb; 11] = [
    // Arm of the claw.
    [[22.0, -10.0, 5.5], [41.0, -16.0, 4.8]],
    [[41.0, -16.0, 4.8], [42.0, -27.0, 5.6]],
    // Four legs, two pieces each.
    [[24.0, -1.0, 4.0], [46.0, -4.0, 3.2]],
    [[46.0, -4.0, 3.2], [54.0, 5.0, 1.4]],
    [[24.0, 7.0, 4.0], [45.0, 9.0, 3.2]],
    [[45.0, 9.0, 3.2], [53.0, 19.0, 1.4]],
    [[21.0, 13.0, 4.0], [41.0, 21.0, 3.1]],
    [[41.0, 21.0, 3.1], [47.0, 32.0, 1.4]],
    [[15.0, 18.0, 3.8], [31.0, 31.0, 3.0]],
    [[31.0, 31.0, 3.0], [34.0, 42.0, 1.4]],
    // Eye stalk.
    [[8.0, -20.0, 2.4], [9.5, -27.0, 2.6]],
];

/// The two fingers of the right claw.
const FINGERS: [Limb; 2] = [[[42.5, -35.0, 5.8], [37.0, -48.0, 1.6]], [[45.5, -34.0, 5.8], [51.0, -47.0, 1.8]]];

/// The crab, relief in metres, in its own colours.
pub(super) fn build(relief_m: f64, seed: u32) -> Draft {
    build_with(
        relief_m,
        seed,
        painted_once(("crab", [u64::from(seed), HUE_DEG.to_bits(), 0, 0]), || paint(seed, HUE_DEG)),
    )
}

/// The crab's shape with any texture, whose centre lies at the origin; see [`place_mm`].
pub(super) fn build_with(relief_m: f64, seed: u32, texture: Arc<Texture>) -> Draft {
    let shape = Shape { relief_m, bumps: ValueNoise::new(hash(&[seed, 0xC2AB])) };
    let cut = cut();
    // About six triangles share a point, and the distance function dominates the cost of building a crab.
    let mut known = HashMap::new();
    let mut vertex = |p: &Point2<f64>| *known.entry([p.x, p.y].map(f64::to_bits)).or_insert_with(|| shape.vertex(p));
    let mut front = Mesh::default();
    for triangle in &cut.triangles {
        front.add_triangle(triangle.each_ref().map(&mut vertex));
    }
    let mut rim = Mesh::default();
    for (a, b) in cut.outline.iter().zip(cut.outline.iter().cycle().skip(1)) {
        let (a, b) = (vertex(b), vertex(a));
        let behind = |v: &Vertex| (v.position_m + Vector3::new(0.0, 0.0, RIM_M), v.texture);
        rim.add_quad([(a.position_m, a.texture), (b.position_m, b.texture), behind(&b), behind(&a)]);
    }
    let outline_m = cut.outline.iter().map(|p| shape.surface(p)).collect();
    Draft { name: "crab", surfaces: vec![(front, Arc::clone(&texture)), (rim, texture)], outline_m }
}

/// The grid cut by the outline: the same for every crab, computed once.
fn cut() -> &'static CutGrid {
    static CUT: OnceLock<CutGrid> = OnceLock::new();
    CUT.get_or_init(|| cut_grid(GridArea { half_size_m: HALF_SIZE_M, cells: 60 }, |p| distance_mm(&(p * 1e3)) * 1e-3))
}

struct Shape {
    relief_m: f64,
    bumps: ValueNoise,
}

impl Shape {
    fn surface(&self, p: &Point2<f64>) -> Point3<f64> {
        Point3::new(p.x, p.y, -self.height_m(p))
    }

    /// Height over the rim plane: rises from the outline inward, with low bumps.
    fn height_m(&self, p: &Point2<f64>) -> f64 {
        let inside = (-distance_mm(&(p * 1e3)) / SLOPE_MM).clamp(0.0, 1.0);
        let bump = self.bumps.fractal(p.x * 130.0, p.y * 130.0, 2) - 0.5;
        self.relief_m * inside * (1.7 - 0.7 * inside + 0.35 * bump)
    }

    fn vertex(&self, p: &Point2<f64>) -> Vertex {
        let step = 4e-4;
        let slope = |d: Vector2<f64>| (self.height_m(&(p + d)) - self.height_m(&(p - d))) / (2.0 * step);
        let (along_x, along_y) = (slope(Vector2::new(step, 0.0)), slope(Vector2::new(0.0, step)));
        Vertex {
            position_m: self.surface(p),
            texture: Vector2::new(texture_coordinate(p.x), texture_coordinate(p.y)),
            normal: Vector3::new(-along_x, -along_y, -1.0).normalize(),
        }
    }
}

fn texture_coordinate(metres: f64) -> f64 {
    0.5 + metres / (2.0 * HALF_SIZE_M)
}

/// Signed distance to the crab's outline in millimetres, negative inside.
fn distance_mm(p: &Point2<f64>) -> f64 {
    let p = Point2::new(p.x.abs(), p.y);
    let limbs = LIMBS.iter().map(|limb| limb_distance(&p, limb)).fold(f64::MAX, f64::min);
    let claw = FINGERS.iter().map(|limb| limb_distance(&p, limb)).fold(f64::MAX, f64::min);
    smooth_min(smooth_min(shell_distance(&p), limbs, 3.0), claw, 1.5)
}

/// The shell: wider at the front, narrower at the back.
fn shell_distance(p: &Point2<f64>) -> f64 {
    let front = ellipse_distance(p, &Point2::new(0.0, -4.0), [36.0, 18.5]);
    let back = ellipse_distance(p, &Point2::new(0.0, 6.0), [26.0, 20.0]);
    smooth_min(front, back, 8.0)
}

fn limb_distance(p: &Point2<f64>, [[ax, ay, ar], [bx, by, br]]: &Limb) -> f64 {
    let (a, b) = (Point2::new(*ax, *ay), Point2::new(*bx, *by));
    let axis = b - a;
    let share = ((p - a).dot(&axis) / axis.norm_squared()).clamp(0.0, 1.0);
    (p - (a + axis * share)).norm() - (ar + (br - ar) * share)
}

/// Distance to an ellipse, first order: function value divided by its gradient.
fn ellipse_distance(p: &Point2<f64>, centre: &Point2<f64>, radii: [f64; 2]) -> f64 {
    let d = Vector2::new((p.x - centre.x) / radii[0], (p.y - centre.y) / radii[1]);
    let gradient = Vector2::new(d.x / radii[0], d.y / radii[1]).norm();
    let value = d.norm();
    if gradient < 1e-9 { -radii[0].min(radii[1]) } else { (value - 1.0) * value / gradient }
}

/// The smaller of two distances, smoothed where they differ by less than `width`.
fn smooth_min(a: f64, b: f64, width: f64) -> f64 {
    let overlap = (width - (a - b).abs()).max(0.0) / width;
    a.min(b) - overlap * overlap * width * 0.25
}

/// Position on the crab of texture coordinates, millimetres.
pub(super) fn place_mm(u: f64, v: f64) -> Point2<f64> {
    Point2::new((u - 0.5) * 2e3 * HALF_SIZE_M, (v - 0.5) * 2e3 * HALF_SIZE_M)
}

/// The crab's own hue.
pub(super) const HUE_DEG: f64 = 14.0;

/// A hue (degrees) +- 8 with dark spots, pale joints, dark claw tips and eyes.
pub(super) fn paint(seed: u32, middle_hue_deg: f64) -> Texture {
    let noise = |k: u32| ValueNoise::new(hash(&[seed, 0x9A11, k]));
    let (tone, grain, light) = (noise(1), noise(2), noise(3));
    let spots =
        [(0.22, 0.30), (0.55, 0.24)].map(|(density, radius)| (density, radius, hash(&[seed, (density * 1e3) as u32])));
    Texture::from_fn(9, 9, |u, v| {
        let p = place_mm(u, v);
        let inside = -distance_mm(&p);
        let hue = middle_hue_deg + 16.0 * (tone.fractal(p.x * 0.11, p.y * 0.11, 3) - 0.5).clamp(-0.5, 0.5);
        let mottle = light.fractal(p.x * 0.16 + 40.0, p.y * 0.16, 4);
        let speckle = grain.fractal(p.x * 0.8, p.y * 0.8, 2);
        let saturation = 0.86 - 0.22 * mottle + 0.06 * speckle;
        let value = 0.50 + 0.42 * mottle + 0.16 * (speckle - 0.5) + 0.10 * smooth_step(0.0, 12.0, inside);
        let mut colour = colour_from_hsv(hue, saturation, value);
        for (density, radius, spot_seed) in spots {
            colour = spotted(&colour, &p, hue, density, radius, spot_seed);
        }
        features(&colour, &p, hue, inside)
    })
}

/// Dark round spots of varying size.
fn spotted(colour: &Colour, p: &Point2<f64>, hue: f64, density: f64, radius: f64, seed: u32) -> Colour {
    let spot = ScatteredPoints::new(seed).nearest(p.x * density, p.y * density);
    let size = radius * (0.5 + f64::from(spot.id & 0xff) / 340.0);
    let dark = colour_from_hsv(hue - 4.0, 0.80, 0.20 + 0.1 * f64::from((spot.id >> 8) & 1));
    mix_colours(colour, &dark, 0.85 * smooth_step(size, 0.65 * size, spot.distance))
}

/// Groove of the shell, dark rim, claw tips and eyes.
fn features(colour: &Colour, p: &Point2<f64>, hue: f64, inside: f64) -> Colour {
    let right = Point2::new(p.x.abs(), p.y);
    let groove = (ellipse_distance(&right, &Point2::new(0.0, 3.0), [13.0, 10.0]).abs() - 0.5).max(0.0);
    let mut colour = mix_colours(colour, &colour_from_hsv(hue, 0.85, 0.30), 0.7 * smooth_step(1.0, 0.0, groove));
    colour = mix_colours(&colour, &colour_from_hsv(hue - 2.0, 0.80, 0.34), 0.7 * smooth_step(1.6, 0.0, inside));
    let tips = smooth_step(-41.0, -47.0, p.y);
    colour = mix_colours(&colour, &colour_from_hsv(hue + 2.0, 0.55, 0.17), 0.9 * tips);
    let eye = (right - Point2::new(9.7, -27.5)).norm();
    colour = mix_colours(&colour, &[22.0, 18.0, 16.0], smooth_step(2.4, 1.7, eye));
    let glint = (p - Point2::new(9.7 * p.x.signum() - 0.7, -28.3)).norm();
    mix_colours(&colour, &[235.0, 230.0, 220.0], smooth_step(0.7, 0.3, glint))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limbs_hang_together() {
        let cut = cut();
        let total: f64 = cut.triangles.iter().map(|[a, b, c]| -(b - a).perp(&(c - a)) / 2.0).sum();
        let outlined: f64 = cut
            .outline
            .iter()
            .zip(cut.outline.iter().cycle().skip(1))
            .map(|(p, q)| p.coords.perp(&q.coords) / 2.0)
            .sum();
        // The area within the longest curve is the whole area, except for holes between the legs.
        assert!((outlined.abs() / total - 1.0).abs() < 0.03, "{outlined} of {total}");
    }

    #[test]
    fn relief_rises_from_the_outline_to_its_height() {
        let shape = Shape { relief_m: 0.02, bumps: ValueNoise::new(4) };
        assert_eq!(shape.height_m(&Point2::new(0.06, 0.06)), 0.0);
        let top = shape.height_m(&Point2::new(0.0, 0.0));
        assert!((0.016..0.024).contains(&top), "{top}");
        let normal = shape.vertex(&Point2::new(0.024, -0.003)).normal;
        assert!(normal.x > 0.1 && normal.z < 0.0, "{normal}");
    }
}
