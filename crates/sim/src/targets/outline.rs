//! Flat shapes given by a signed distance: meshes cut exactly along their outline, and outline polygons.

use std::collections::BTreeMap;

use nalgebra::{Point2, Point3};

/// The part of a regular grid of triangles that lies inside a shape.
#[derive(Clone, Debug, Default)]
pub struct CutGrid {
    /// Triangles inside, corners in the order in which they are seen from -z with y down (see `Mesh`).
    pub triangles: Vec<[Point2<f64>; 3]>,
    /// The outline as a closed polygon, with the inside on its left when y points up.
    pub outline: Vec<Point2<f64>>,
}

/// A square area for the grid.
#[derive(Clone, Copy, Debug)]
pub struct GridArea {
    /// The area reaches from minus this to plus this in x and y.
    pub half_size_m: f64,
    /// Cells along each side.
    pub cells: usize,
}

/// Cuts a grid along the zero of `distance` (negative inside).
///
/// The outline is the longest of the shape's closed curves.
pub fn cut_grid(area: GridArea, distance: impl Fn(&Point2<f64>) -> f64) -> CutGrid {
    let step = 2.0 * area.half_size_m / area.cells as f64;
    let node = |i: usize, j: usize| {
        let p = Point2::new(i as f64 * step - area.half_size_m, j as f64 * step - area.half_size_m);
        (p, distance(&p))
    };
    let row = |j: usize| (0..=area.cells).map(|i| node(i, j)).collect::<Vec<_>>();
    let mut cut = CutGrid::default();
    let mut segments = Vec::new();
    let mut upper = row(0);
    for j in 0..area.cells {
        let lower = row(j + 1);
        for i in 0..area.cells {
            let [a, b, c, d] = [upper[i], upper[i + 1], lower[i + 1], lower[i]];
            for triangle in [[a, d, b], [b, d, c]] {
                cut_triangle(&triangle, &mut cut.triangles, &mut segments);
            }
        }
        upper = lower;
    }
    cut.outline = longest_loop(&segments);
    cut
}

type Node = (Point2<f64>, f64);

/// Keeps the inner part of a triangle and records the piece of outline across it.
fn cut_triangle(corners: &[Node; 3], kept: &mut Vec<[Point2<f64>; 3]>, segments: &mut Vec<[Point2<f64>; 2]>) {
    let mut polygon: Vec<Point2<f64>> = Vec::with_capacity(4);
    let (mut entry, mut exit) = (None, None);
    for k in 0..3 {
        let (from, to) = (&corners[k], &corners[(k + 1) % 3]);
        if from.1 < 0.0 {
            polygon.push(from.0);
        }
        if (from.1 < 0.0) != (to.1 < 0.0) {
            let place = crossing(from, to);
            polygon.push(place);
            *(if from.1 < 0.0 { &mut exit } else { &mut entry }) = Some(place);
        }
    }
    for k in 2..polygon.len() {
        kept.push([polygon[0], polygon[k - 1], polygon[k]]);
    }
    if let (Some(entry), Some(exit)) = (entry, exit) {
        segments.push([exit, entry]);
    }
}

/// The zero crossing between two nodes; identical from either side.
fn crossing(a: &Node, b: &Node) -> Point2<f64> {
    let (a, b) = if (a.0.x, a.0.y) < (b.0.x, b.0.y) { (a, b) } else { (b, a) };
    let share = (a.1 / (a.1 - b.1)).clamp(0.0, 1.0);
    a.0 + (b.0 - a.0) * share
}

/// Joins segments end to start and returns the longest closed curve.
fn longest_loop(segments: &[[Point2<f64>; 2]]) -> Vec<Point2<f64>> {
    let key = |p: &Point2<f64>| ((p.x * 1e9).round() as i64, (p.y * 1e9).round() as i64);
    let mut next: BTreeMap<(i64, i64), &[Point2<f64>; 2]> =
        segments.iter().filter(|[a, b]| key(a) != key(b)).map(|segment| (key(&segment[0]), segment)).collect();
    let (mut best, mut best_length) = (Vec::new(), 0.0);
    while let Some((_, segment)) = next.pop_first() {
        let (mut curve, mut length, mut end) = (vec![segment[0]], (segment[1] - segment[0]).norm(), segment[1]);
        while let Some(segment) = next.remove(&key(&end)) {
            curve.push(segment[0]);
            length += (segment[1] - segment[0]).norm();
            end = segment[1];
        }
        if length > best_length {
            (best, best_length) = (curve, length);
        }
    }
    best
}

/// Centroid of the area inside a polygon, projected along z; z is the mean of the corners.
pub fn centroid(polygon: &[Point3<f64>]) -> Point3<f64> {
    let (mut area, mut x, mut y) = (0.0, 0.0, 0.0);
    for (p, q) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
        let cross = p.x * q.y - q.x * p.y;
        area += cross / 2.0;
        x += (p.x + q.x) * cross / 6.0;
        y += (p.y + q.y) * cross / 6.0;
    }
    let z = polygon.iter().map(|p| p.z).sum::<f64>() / polygon.len().max(1) as f64;
    if area == 0.0 { Point3::new(0.0, 0.0, z) } else { Point3::new(x / area, y / area, z) }
}

/// Corners of the convex hull of points of the plane, as indices, in order around it.
pub fn convex_hull(points: &[Point2<f64>]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| points[a].x.total_cmp(&points[b].x).then(points[a].y.total_cmp(&points[b].y)));
    let turn = |a: usize, b: usize, c: usize| (points[b] - points[a]).perp(&(points[c] - points[a]));
    let chain = |order: &mut dyn Iterator<Item = usize>| {
        let mut hull: Vec<usize> = Vec::new();
        for index in order {
            while hull.len() >= 2 && turn(hull[hull.len() - 2], hull[hull.len() - 1], index) <= 0.0 {
                hull.pop();
            }
            hull.push(index);
        }
        hull.pop();
        hull
    };
    let mut hull = chain(&mut order.iter().copied());
    hull.extend(chain(&mut order.iter().rev().copied()));
    hull
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_is_cut_exactly() {
        let (centre, radius) = (Point2::new(0.1, -0.2), 0.5);
        let area = GridArea { half_size_m: 1.0, cells: 64 };
        let cut = cut_grid(area, |p| (p - centre).norm() - radius);
        let inside: f64 = cut.triangles.iter().map(|[a, b, c]| (b - a).perp(&(c - a)) / 2.0).sum();
        assert!((inside.abs() - std::f64::consts::PI * 0.25).abs() < 2e-3, "{inside}");
        assert!(cut.triangles.iter().all(|[a, b, c]| (b - a).perp(&(c - a)) <= 0.0));
        assert!(cut.outline.len() > 60);
        assert!(cut.outline.iter().all(|p| ((p - centre).norm() - radius).abs() < 1e-3));
        let outline: Vec<_> = cut.outline.iter().map(|p| Point3::new(p.x, p.y, 0.3)).collect();
        assert!((centroid(&outline) - Point3::new(0.1, -0.2, 0.3)).norm() < 1e-4);
    }

    #[test]
    fn of_two_discs_the_larger_is_outlined() {
        let area = GridArea { half_size_m: 1.0, cells: 50 };
        let cut = cut_grid(area, |p| {
            ((p - Point2::new(-0.5, 0.0)).norm() - 0.2).min((p - Point2::new(0.5, 0.1)).norm() - 0.3)
        });
        assert!(cut.outline.iter().all(|p| p.x > 0.15));
    }

    #[test]
    fn hull_leaves_out_inner_points() {
        let points =
            [(0.0, 0.0), (4.0, 0.0), (2.0, 1.0), (4.0, 3.0), (0.0, 3.0), (1.0, 1.0)].map(|(x, y)| Point2::new(x, y));
        assert_eq!(convex_hull(&points), vec![0, 1, 3, 4]);
    }
}
