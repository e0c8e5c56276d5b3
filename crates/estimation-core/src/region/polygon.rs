//! Polygon rasterisation.
//!
//! A pixel is inside if its centre is inside the polygon by the even-odd rule, or on the outline. Spans are computed row by
//! row; rows outside the image are counted but not stored.

use nalgebra::Vector2;

use super::RegionMask;

/// A pixel centre closer to the outline than this counts as on the outline, pixels.
const ON_OUTLINE_PX: f64 = 1e-9;

/// Adds the pixels inside the polygon to `mask`; returns the number of pixels that it covers, inside and outside the image.
///
/// The vertices must be finite. Rows far outside the image cost time, so callers limit the coordinates.
pub fn fill(vertices: &[Vector2<f64>], mask: &mut RegionMask) -> usize {
    for_each_span(vertices, |y, first, last| mask.insert_span(y, first, last))
}

/// Number of pixels that the polygon covers, inside and outside the image; as in [`fill`].
pub fn covered_px(vertices: &[Vector2<f64>]) -> usize {
    for_each_span(vertices, |_, _, _| {})
}

/// Calls `visit(y, first, last)` for every span of pixels; returns their total number of pixels.
fn for_each_span(vertices: &[Vector2<f64>], mut visit: impl FnMut(i64, i64, i64)) -> usize {
    let mut crossings = Vec::new();
    let mut spans = Vec::new();
    let Some((first_row, last_row)) = rows(vertices) else { return 0 };
    let mut covered = 0;
    for y in first_row..=last_row {
        row_spans(vertices, y as f64, &mut crossings, &mut spans);
        for (first, last) in &spans {
            covered += (last - first + 1) as usize;
            visit(y, *first, *last);
        }
    }
    covered
}

/// First pair of edges that cross each other, by index of their first vertex.
pub fn first_self_intersection(vertices: &[Vector2<f64>]) -> Option<(usize, usize)> {
    let n = vertices.len();
    let edge = |i: usize| (vertices[i], vertices[(i + 1) % n]);
    (0..n).find_map(|i| {
        let later = (i + 2..n).filter(|j| (j + 1) % n != i);
        later.into_iter().find(|j| edges_cross(edge(i), edge(*j))).map(|j| (i, j))
    })
}

fn rows(vertices: &[Vector2<f64>]) -> Option<(i64, i64)> {
    let low = vertices.iter().map(|v| v.y).min_by(f64::total_cmp)?;
    let high = vertices.iter().map(|v| v.y).max_by(f64::total_cmp)?;
    Some(((low - ON_OUTLINE_PX).ceil() as i64, (high + ON_OUTLINE_PX).floor() as i64))
}

/// The disjoint spans of columns inside the polygon in row `y`, in order.
fn row_spans(vertices: &[Vector2<f64>], y: f64, crossings: &mut Vec<f64>, spans: &mut Vec<(i64, i64)>) {
    crossings.clear();
    spans.clear();
    let mut push = |from: f64, to: f64| {
        let span = ((from - ON_OUTLINE_PX).ceil() as i64, (to + ON_OUTLINE_PX).floor() as i64);
        if span.0 <= span.1 {
            spans.push(span);
        }
    };
    for (i, a) in vertices.iter().enumerate() {
        let b = vertices[(i + 1) % vertices.len()];
        // Half-open in y, so that a vertex on the row counts as one crossing.
        if (a.y <= y) != (b.y <= y) {
            crossings.push(a.x + (y - a.y) / (b.y - a.y) * (b.x - a.x));
        }
        // The half-open rule can miss vertices and horizontal edges on the row itself.
        if (a.y - y).abs() <= ON_OUTLINE_PX {
            let level = (b.y - y).abs() <= ON_OUTLINE_PX;
            push(if level { a.x.min(b.x) } else { a.x }, if level { a.x.max(b.x) } else { a.x });
        }
    }
    crossings.sort_by(f64::total_cmp);
    crossings.chunks_exact(2).for_each(|pair| push(pair[0], pair[1]));
    merge(spans);
}

fn merge(spans: &mut Vec<(i64, i64)>) {
    spans.sort_unstable();
    spans.dedup_by(|next, previous| {
        let touches = next.0 <= previous.1 + 1;
        if touches {
            previous.1 = previous.1.max(next.1);
        }
        touches
    });
}

fn edges_cross(p: (Vector2<f64>, Vector2<f64>), q: (Vector2<f64>, Vector2<f64>)) -> bool {
    let side = |a: Vector2<f64>, b: Vector2<f64>, c: Vector2<f64>| (b - a).perp(&(c - a));
    side(p.0, p.1, q.0) * side(p.0, p.1, q.1) < 0.0 && side(q.0, q.1, p.0) * side(q.0, q.1, p.1) < 0.0
}

#[cfg(test)]
mod tests {
    use pb3dp_geometry::ImageSize;

    use super::*;

    const SIZE: ImageSize = ImageSize { width: 64, height: 48 };

    fn polygon(points: &[(f64, f64)]) -> Vec<Vector2<f64>> {
        points.iter().map(|p| Vector2::new(p.0, p.1)).collect()
    }

    /// Winding number by angles: an independent inside test for simple polygons.
    fn inside_by_angle(vertices: &[Vector2<f64>], x: f64, y: f64) -> bool {
        let turn: f64 = (0..vertices.len())
            .map(|i| {
                let a = vertices[i] - Vector2::new(x, y);
                let b = vertices[(i + 1) % vertices.len()] - Vector2::new(x, y);
                a.perp(&b).atan2(a.dot(&b))
            })
            .sum();
        turn.abs() > std::f64::consts::PI
    }

    #[test]
    fn a_concave_polygon_holds_the_centres_inside_it() {
        let vertices = polygon(&[(5.3, 4.1), (50.2, 9.7), (30.6, 20.2), (58.9, 40.4), (22.1, 31.3), (7.83, 44.9)]);
        let mut mask = RegionMask::empty(SIZE);
        let covered = fill(&vertices, &mut mask);
        for y in 0..48 {
            for x in 0..64 {
                let expected = inside_by_angle(&vertices, f64::from(x), f64::from(y));
                assert_eq!(mask.contains(x, y), expected, "({x}, {y})");
            }
        }
        assert_eq!(covered, mask.area_px());
    }

    #[test]
    fn centres_on_the_outline_count_as_inside() {
        let mut mask = RegionMask::empty(SIZE);
        let covered = fill(&polygon(&[(10.0, 5.0), (38.0, 5.0), (38.0, 33.0), (10.0, 33.0)]), &mut mask);
        assert_eq!(covered, 29 * 29);
        assert_eq!(mask.centroid_px(), Some(Vector2::new(24.0, 19.0)));
    }

    #[test]
    fn pixels_outside_the_image_are_counted_only() {
        let mut mask = RegionMask::empty(SIZE);
        let covered = fill(&polygon(&[(-10.5, -2.5), (9.5, -2.5), (9.5, 3.5), (-10.5, 3.5)]), &mut mask);
        assert_eq!(covered, 20 * 6);
        assert_eq!(mask.area_px(), 10 * 4);
    }

    #[test]
    fn crossing_edges_are_named() {
        let bow = polygon(&[(0.0, 0.0), (10.0, 10.0), (10.0, 0.0), (0.0, 10.0)]);
        assert_eq!(first_self_intersection(&bow), Some((0, 2)));
        let plain = polygon(&[(0.0, 0.0), (10.0, 1.0), (11.0, 9.0), (2.0, 8.0)]);
        assert_eq!(first_self_intersection(&plain), None);
    }
}
