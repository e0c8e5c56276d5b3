//! Outline of a mask: traces the pixel edges around the largest component, then simplifies the polygon.

use nalgebra::Vector2;

use super::RegionMask;

/// Tolerance of the simplification: largest distance of a removed point from the simplified outline, pixels.
const SIMPLIFY_TOLERANCE_PX: f64 = 0.4;

/// Directions of the edge tracing, clockwise in the image: right, down, left, up.
const STEPS: [(i32, i32); 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];

/// Outline of the largest component, see [`RegionMask::outline_px`].
pub(super) fn largest(mask: &RegionMask) -> Vec<Vector2<f64>> {
    let part = super::grow::largest_part(mask);
    let mut start = None;
    part.for_each_run(|y, first, _| {
        start.get_or_insert((first as i32, y as i32));
    });
    start.map(|start| simplify(&walk(&part, start))).unwrap_or_default()
}

/// Corners of the outline, traced with the region on the right, from the upper left corner of pixel `start` (the first pixel of
/// its component in reading order). Corner (i, j) is at (i - 0.5, j - 0.5).
fn walk(part: &RegionMask, start: (i32, i32)) -> Vec<Vector2<f64>> {
    let (mut x, mut y) = start;
    let mut heading = 0;
    let mut corners = Vec::new();
    let steps_max = 4 * part.area_px() + 4;
    for _ in 0..steps_max {
        // The two pixels ahead of corner (x, y), left and right of the direction.
        let (left, right) = match heading {
            0 => ((x, y - 1), (x, y)),
            1 => ((x, y), (x - 1, y)),
            2 => ((x - 1, y), (x - 1, y - 1)),
            _ => ((x - 1, y - 1), (x, y - 1)),
        };
        let turned = if !part.contains(right.0, right.1) {
            (heading + 1) % 4
        } else if part.contains(left.0, left.1) {
            (heading + 3) % 4
        } else {
            heading
        };
        if turned != heading {
            corners.push(Vector2::new(f64::from(x) - 0.5, f64::from(y) - 0.5));
            heading = turned;
        }
        x += STEPS[heading].0;
        y += STEPS[heading].1;
        if (x, y) == start {
            break;
        }
    }
    corners.push(Vector2::new(f64::from(start.0) - 0.5, f64::from(start.1) - 0.5));
    corners
}

/// Douglas-Peucker on the closed polygon, split at the point farthest from the last point.
fn simplify(corners: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
    let Some(anchor) = corners.last().copied() else { return Vec::new() };
    let distance = |p: &Vector2<f64>| (p - anchor).norm_squared();
    let far = (0..corners.len()).max_by(|a, b| distance(&corners[*a]).total_cmp(&distance(&corners[*b]))).unwrap_or(0);
    let mut kept = vec![false; corners.len()];
    kept[far] = true;
    kept[corners.len() - 1] = true;
    let mut open = vec![(far, corners.len() - 1)];
    // The part from the anchor (also the last corner) to the farthest point, as indices shifted by one.
    let mut from_anchor = vec![anchor];
    from_anchor.extend_from_slice(&corners[..=far]);
    mark(corners, &mut open, &mut kept);
    let mut kept_first = vec![false; from_anchor.len()];
    mark(&from_anchor, &mut vec![(0, far + 1)], &mut kept_first);
    for (index, keep) in kept_first.iter().enumerate().skip(1) {
        kept[index - 1] |= keep;
    }
    corners.iter().zip(&kept).filter(|(_, keep)| **keep).map(|(corner, _)| *corner).collect()
}

/// Marks the points to keep between the ends of each open interval.
fn mark(points: &[Vector2<f64>], open: &mut Vec<(usize, usize)>, kept: &mut [bool]) {
    while let Some((first, last)) = open.pop() {
        let farthest = (first + 1..last)
            .map(|i| (i, distance_to_chord(&points[i], &points[first], &points[last])))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((index, distance)) = farthest
            && distance > SIMPLIFY_TOLERANCE_PX
        {
            kept[index] = true;
            open.push((first, index));
            open.push((index, last));
        }
    }
}

fn distance_to_chord(point: &Vector2<f64>, a: &Vector2<f64>, b: &Vector2<f64>) -> f64 {
    let chord = b - a;
    let length_squared = chord.norm_squared();
    let along = if length_squared > 0.0 { ((point - a).dot(&chord) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
    (point - (a + chord * along)).norm()
}

#[cfg(test)]
mod tests {
    use pb3dp_geometry::ImageSize;

    use super::*;
    use crate::region::polygon;

    #[test]
    fn a_rectangle_has_four_corners_half_a_pixel_outside_its_centres() {
        let mask = RegionMask::from_fn(ImageSize { width: 90, height: 50 }, |x, y| {
            (10..74).contains(&x) && (7..31).contains(&y)
        });
        let mut corners: Vec<_> = mask.outline_px().iter().map(|p| (p.x, p.y)).collect();
        corners.sort_by(|a, b| a.partial_cmp(b).expect("finite"));
        assert_eq!(corners, vec![(9.5, 6.5), (9.5, 30.5), (73.5, 6.5), (73.5, 30.5)]);
    }

    #[test]
    fn an_outline_rasterised_again_gives_the_part_back() {
        let size = ImageSize { width: 120, height: 100 };
        let mask = RegionMask::from_fn(size, |x, y| {
            let (dx, dy) = (f64::from(x) - 61.0, f64::from(y) - 47.0);
            let angle = dy.atan2(dx);
            let far_speck = x < 4 && y < 4;
            dx.hypot(dy) < 26.0 + 9.0 * (3.0 * angle).sin() + 3.0 * (8.0 * angle).cos() || far_speck
        });
        let mut again = RegionMask::empty(size);
        polygon::fill(&mask.outline_px(), &mut again);
        let mut differing = 0;
        for y in 5..100 {
            for x in 5..120 {
                differing += usize::from(mask.contains(x, y) != again.contains(x, y));
            }
        }
        assert!(!again.contains(1, 1), "the small part is left out");
        assert!(differing < mask.area_px() / 50, "{differing} of {} pixels differ", mask.area_px());
    }
}
