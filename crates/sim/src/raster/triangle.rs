//! Triangles as seen by one camera.
//!
//! With the corners P0, P1, P2 in the camera frame and a ray m = (x, y, 1), the values e = [P0 P1 P2]^-1 m are the barycentric
//! coordinates divided by the depth. The ray meets the triangle where all three are positive, their sum is the inverse depth, and
//! any attribute divided by depth is a linear function of (x, y) too. Perspective is therefore exact, without clipping, and
//! without division before a pixel is shaded.

use nalgebra::{Isometry3, Point3, Vector3};

use super::view::{PixelBox, RayRange, View};
use crate::scene::Lighting;
use crate::targets::part::ScenePart;

/// A linear function of the ray: `a x + b y + c`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Plane {
    pub(crate) a: f32,
    pub(crate) b: f32,
    pub(crate) c: f32,
}

impl Plane {
    pub(crate) fn at(&self, x: f32, y: f32) -> f32 {
        self.a * x + self.b * y + self.c
    }

    /// Bounds of the values within a range of rays; valid despite rounding.
    pub(crate) fn bounds(&self, rays: &RayRange) -> (f32, f32) {
        let ordered = |slope: f32, (min, max): (f32, f32)| if slope >= 0.0 { (min, max) } else { (max, min) };
        let ((x_low, x_high), (y_low, y_high)) = (ordered(self.a, rays.x), ordered(self.b, rays.y));
        (self.at(x_low, y_low), self.at(x_high, y_high))
    }

    fn from_vector(v: &Vector3<f64>) -> Self {
        Self { a: v.x as f32, b: v.y as f32, c: v.z as f32 }
    }
}

/// A triangle that may be visible to the camera.
#[derive(Clone, Debug)]
pub(crate) struct ScreenTriangle {
    /// Barycentric coordinates over depth; enlarged slightly, so that neighbours leave no gap.
    pub(crate) edges: [Plane; 3],
    /// 1 / depth, 1/m.
    pub(crate) inv_z: Plane,
    /// Texel column over depth.
    pub(crate) u: Plane,
    /// Texel row over depth.
    pub(crate) v: Plane,
    /// Light over depth.
    pub(crate) light: Plane,
    /// Specular reflection of the lamp over depth, grey levels; `None` if there is none.
    pub(crate) shine: Option<Plane>,
    /// Index of the scene's part.
    pub(crate) part: u16,
    pub(crate) pixels: PixelBox,
}

/// Corners nearer than this count as behind the camera, metres.
const NEAR_M: f64 = 1e-3;

/// Largest rounding error of an edge function, relative to its largest term.
const EDGE_ROUNDING: f32 = 3e-7;

/// A vertex in the camera's frame.
struct ProjectedVertex {
    in_cam: Vector3<f64>,
    texel: [f64; 2],
    light: f64,
    shine: f64,
}

/// Collects the triangles of one part that face the camera.
pub(crate) fn collect_triangles(
    part: &ScenePart,
    part_index: u16,
    pose: &PartPose,
    lighting: &Lighting,
    view: &View,
    triangles: &mut Vec<ScreenTriangle>,
) {
    let size = [f64::from(part.texture.width()), f64::from(part.texture.height())];
    for corners in &part.mesh.triangles {
        let positions = corners.map(|i| pose.cam_from_part.transform_point(&part.mesh.vertices[i as usize].position_m));
        if faces_away(&positions) {
            continue;
        }
        let Some(pixels) = pixel_box(&positions, view) else { continue };
        let visible: [ProjectedVertex; 3] = std::array::from_fn(|k| {
            let vertex = &part.mesh.vertices[corners[k] as usize];
            ProjectedVertex {
                in_cam: positions[k].coords,
                texel: [vertex.texture.x * size[0], vertex.texture.y * size[1]],
                light: lighting.on(&pose.world_from_part.transform_vector(&vertex.normal)),
                shine: lighting.highlight.map_or(0.0, |highlight| {
                    let normal = pose.world_from_part.transform_vector(&vertex.normal);
                    let to_camera = pose.world_from_cam.transform_vector(&-positions[k].coords);
                    lighting.shine_on(&highlight, &normal, &to_camera)
                }),
            }
        });
        if let Some(triangle) = ScreenTriangle::new(&visible, part_index, pixels) {
            triangles.push(triangle);
        }
    }
}

/// Pose of a part.
pub(crate) struct PartPose {
    pub(crate) cam_from_part: Isometry3<f64>,
    pub(crate) world_from_part: Isometry3<f64>,
    pub(crate) world_from_cam: Isometry3<f64>,
}

impl ScreenTriangle {
    /// `None` for a triangle without area.
    fn new(corners: &[ProjectedVertex; 3], part: u16, pixels: PixelBox) -> Option<Self> {
        let [p0, p1, p2] = [&corners[0].in_cam, &corners[1].in_cam, &corners[2].in_cam];
        let determinant = p0.dot(&p1.cross(p2));
        if determinant.abs() < 1e-18 {
            return None;
        }
        let e = [p1.cross(p2) / determinant, p2.cross(p0) / determinant, p0.cross(p1) / determinant];
        let interpolate =
            |values: [f64; 3]| Plane::from_vector(&(e[0] * values[0] + e[1] * values[1] + e[2] * values[2]));
        let edges = e.map(|edge| {
            let plane = Plane::from_vector(&edge);
            let tolerance = EDGE_ROUNDING * (plane.a.abs() + plane.b.abs() + plane.c.abs());
            Plane { c: plane.c + tolerance, ..plane }
        });
        let attribute = |value: fn(&ProjectedVertex) -> f64| interpolate([0, 1, 2].map(|i| value(&corners[i])));
        Some(Self {
            edges,
            inv_z: interpolate([1.0; 3]),
            u: attribute(|vertex| vertex.texel[0]),
            v: attribute(|vertex| vertex.texel[1]),
            light: attribute(|vertex| vertex.light),
            shine: corners.iter().any(|corner| corner.shine > 0.0).then(|| attribute(|vertex| vertex.shine)),
            part,
            pixels,
        })
    }
}

fn faces_away(corners: &[Point3<f64>; 3]) -> bool {
    let [a, b, c] = corners;
    (b - a).cross(&(c - a)).dot(&a.coords) >= 0.0
}

/// `None` if the triangle is outside the image.
fn pixel_box(corners: &[Point3<f64>; 3], view: &View) -> Option<PixelBox> {
    let whole = PixelBox { x: (0, view.width), y: (0, view.height) };
    if corners.iter().all(|p| p.z < NEAR_M) {
        return None;
    }
    if corners.iter().any(|p| p.z < NEAR_M) {
        return Some(whole);
    }
    let range = |values: [f64; 3]| {
        let [a, b, c] = values;
        (a.min(b).min(c) as f32, a.max(b).max(c) as f32)
    };
    let found = view.pixel_box(range(corners.map(|p| p.x / p.z)), range(corners.map(|p| p.y / p.z)));
    (found.x.0 < found.x.1 && found.y.0 < found.y.1).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_hold_every_value() {
        let rays = RayRange { x: (-0.3, 0.2), y: (0.1, 0.4) };
        for (a, b) in [(2.0, 3.0), (-2.0, 3.0), (2.0, -3.0), (-2.0, -3.0)] {
            let plane = Plane { a, b, c: 0.7 };
            let (low, high) = plane.bounds(&rays);
            let corners = [(-0.3, 0.1), (-0.3, 0.4), (0.2, 0.1), (0.2, 0.4)].map(|(x, y)| plane.at(x, y));
            assert_eq!(low, corners.into_iter().fold(f32::INFINITY, f32::min));
            assert_eq!(high, corners.into_iter().fold(f32::NEG_INFINITY, f32::max));
        }
    }

    #[test]
    fn planes_give_depth_and_attributes_where_a_ray_meets_the_triangle() {
        let corner = |x: f64, y: f64, z: f64, u: f64, v: f64, light: f64| ProjectedVertex {
            in_cam: Vector3::new(x, y, z),
            texel: [u, v],
            light,
            shine: 100.0 * light,
        };
        let corners = [
            corner(-0.2, -0.1, 0.9, 3.0, 70.0, 0.4),
            corner(0.3, -0.2, 0.5, 90.0, 10.0, 0.8),
            corner(0.1, 0.4, 1.4, 40.0, 200.0, 1.1),
        ];
        let pixels = PixelBox { x: (0, 1), y: (0, 1) };
        let triangle = ScreenTriangle::new(&corners, 7, pixels).unwrap();
        let shares = [0.25, 0.35, 0.4];
        let mean =
            |value: &dyn Fn(&ProjectedVertex) -> f64| (0..3).map(|i| shares[i] * value(&corners[i])).sum::<f64>();
        let (x, y, z) = (mean(&|c| c.in_cam.x), mean(&|c| c.in_cam.y), mean(&|c| c.in_cam.z));
        let at = |plane: &Plane| f64::from(plane.at((x / z) as f32, (y / z) as f32)) * z;
        let check = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
        check(at(&triangle.inv_z), 1.0);
        check(at(&triangle.u), mean(&|c| c.texel[0]));
        check(at(&triangle.v), mean(&|c| c.texel[1]));
        check(at(&triangle.light), mean(&|c| c.light));
        check(at(&triangle.shine.unwrap()), 100.0 * mean(&|c| c.light));
        for (edge, share) in triangle.edges.iter().zip(shares) {
            check(at(edge), share);
        }
    }
}
