//! Triangle meshes with texture coordinates.

use nalgebra::{Point3, Vector2, Vector3};

/// A corner of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vertex {
    /// Position in the frame of the object, metres.
    pub position_m: Point3<f64>,
    /// Texture coordinates: (0, 0) is the upper left corner, (1, 1) the lower right one; textures repeat beyond.
    pub texture: Vector2<f64>,
    /// Outward unit normal for shading.
    pub normal: Vector3<f64>,
}

/// Triangles of one smooth surface. A triangle is visible from the side to which `(b - a) x (c - a)` points.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// The corners.
    pub vertices: Vec<Vertex>,
    /// Three indices into `vertices` each.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Adds one triangle with corners of its own.
    pub fn add_triangle(&mut self, corners: [Vertex; 3]) {
        let first = self.vertices.len() as u32;
        self.vertices.extend(corners);
        self.triangles.push([first, first + 1, first + 2]);
    }

    /// Adds a flat quadrilateral: upper left, upper right, lower right, lower left corner as seen from its visible side.
    ///
    /// `corners` are positions in metres with their texture coordinates.
    pub fn add_quad(&mut self, corners: [(Point3<f64>, Vector2<f64>); 4]) {
        let normal = (corners[3].0 - corners[0].0).cross(&(corners[1].0 - corners[0].0)).normalize();
        let first = self.vertices.len() as u32;
        self.vertices.extend(corners.map(|(position_m, texture)| Vertex { position_m, texture, normal }));
        self.triangles.push([first, first + 2, first + 1]);
        self.triangles.push([first, first + 3, first + 2]);
    }

    /// Moves every vertex by `offset_m`.
    pub fn translate(&mut self, offset_m: &Vector3<f64>) {
        for vertex in &mut self.vertices {
            vertex.position_m += offset_m;
        }
    }

    /// Positions of a triangle's corners, metres.
    pub fn corners_m(&self, triangle: &[u32; 3]) -> [Point3<f64>; 3] {
        triangle.map(|index| self.vertices[index as usize].position_m)
    }

    /// Integral over the surface seen along +z: projected area (m^2), and first moments (m^3).
    ///
    /// Triangles that face away from -z do not count. Returns `(area, [x, y, z] moments)`.
    pub fn frontal_moments(&self) -> (f64, Vector3<f64>) {
        self.triangles.iter().map(|triangle| self.corners_m(triangle)).fold(
            (0.0, Vector3::zeros()),
            |(area, moments), [a, b, c]| {
                let projected = (-(b - a).cross(&(c - a)).z / 2.0).max(0.0);
                (area + projected, moments + (a.coords + b.coords + c.coords) * (projected / 3.0))
            },
        )
    }
}

/// One face of a box: `(upper left, upper right, lower right, lower left)` as seen from outside.
pub(crate) type Face = [Point3<f64>; 4];

/// Faces of the axis-parallel box between `min` and `max` (metres): front (-z), right (+x), back, left, top (-y), bottom.
pub(crate) fn box_faces(min: &Point3<f64>, max: &Point3<f64>) -> [Face; 6] {
    let p = |x: bool, y: bool, z: bool| {
        Point3::new(if x { max.x } else { min.x }, if y { max.y } else { min.y }, if z { max.z } else { min.z })
    };
    let (f, t) = (false, true);
    [
        [p(f, f, f), p(t, f, f), p(t, t, f), p(f, t, f)],
        [p(t, f, f), p(t, f, t), p(t, t, t), p(t, t, f)],
        [p(t, f, t), p(f, f, t), p(f, t, t), p(t, t, t)],
        [p(f, f, t), p(f, f, f), p(f, t, f), p(f, t, t)],
        [p(f, f, t), p(t, f, t), p(t, f, f), p(f, f, f)],
        [p(f, t, f), p(t, t, f), p(t, t, t), p(f, t, t)],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_of_a_box_look_outward() {
        let (min, max) = (Point3::new(-1.0, -2.0, 3.0), Point3::new(2.0, 5.0, 4.0));
        let centre = nalgebra::center(&min, &max);
        for face in box_faces(&min, &max) {
            let mut mesh = Mesh::default();
            mesh.add_quad(face.map(|p| (p, Vector2::zeros())));
            for triangle in &mesh.triangles {
                let [a, b, c] = mesh.corners_m(triangle);
                let normal = (b - a).cross(&(c - a));
                assert!(normal.dot(&(a - centre)) > 0.0);
                assert!(normal.dot(&mesh.vertices[0].normal) > 0.0);
            }
        }
    }

    #[test]
    fn frontal_moments_of_a_box_are_those_of_its_front() {
        let mut mesh = Mesh::default();
        for face in box_faces(&Point3::new(1.0, 2.0, 5.0), &Point3::new(3.0, 7.0, 9.0)) {
            mesh.add_quad(face.map(|p| (p, Vector2::zeros())));
        }
        let (area, moments) = mesh.frontal_moments();
        assert!((area - 10.0).abs() < 1e-12);
        assert!((moments / area - Vector3::new(2.0, 4.5, 5.0)).norm() < 1e-12);
    }
}
