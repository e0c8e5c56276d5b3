//! Pixels inside a polygon.

use pb3dp_geometry::ImageSize;

/// Calls `visit(u, v)`, row by row, for each pixel of an image whose centre lies inside a polygon or on its outline
/// (even-odd rule; integer coordinates are pixel centres).
pub fn polygon_pixels(corners_px: &[[f64; 2]], size: ImageSize, mut visit: impl FnMut(u32, u32)) {
    let mut spans = Vec::new();
    for v in rows(corners_px, size) {
        row_spans(corners_px, f64::from(v), &mut spans);
        let mut next = 0;
        for &(from, to) in &spans {
            let first = (from - 1e-9).ceil().max(f64::from(next)) as u32;
            let last = (to + 1e-9).floor().min(f64::from(size.width) - 1.0);
            if last < f64::from(first) {
                continue;
            }
            let last = last as u32;
            (first..=last).for_each(|u| visit(u, v));
            next = last + 1;
        }
    }
}

fn rows(corners_px: &[[f64; 2]], size: ImageSize) -> std::ops::Range<u32> {
    let finite = corners_px.iter().flatten().all(|x| x.is_finite());
    if corners_px.len() < 3 || !finite {
        return 0..0;
    }
    let top = corners_px.iter().map(|c| c[1]).fold(f64::INFINITY, f64::min).ceil().max(0.0);
    let bottom = corners_px.iter().map(|c| c[1]).fold(f64::NEG_INFINITY, f64::max).floor();
    if bottom < 0.0 { 0..0 } else { top as u32..(bottom as u32 + 1).min(size.height) }
}

/// The parts of row `v` inside the polygon, sorted, as pairs of columns.
fn row_spans(corners_px: &[[f64; 2]], v: f64, spans: &mut Vec<(f64, f64)>) {
    spans.clear();
    let mut crossings = Vec::new();
    let edges = corners_px.iter().zip(corners_px.iter().cycle().skip(1));
    for (a, b) in edges {
        if a[1] == v && b[1] == v {
            // An edge along the row belongs to the polygon.
            spans.push((a[0].min(b[0]), a[0].max(b[0])));
        } else if (a[1] <= v) != (b[1] <= v) {
            crossings.push(a[0] + (v - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
        }
        if a[1] == v {
            spans.push((a[0], a[0]));
        }
    }
    crossings.sort_by(f64::total_cmp);
    spans.extend(crossings.chunks_exact(2).map(|pair| (pair[0], pair[1])));
    spans.sort_by(|a, b| a.0.total_cmp(&b.0));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(corners: &[[f64; 2]], width: u32, height: u32) -> Vec<(u32, u32)> {
        let mut found = Vec::new();
        polygon_pixels(corners, ImageSize { width, height }, |u, v| found.push((u, v)));
        found
    }

    #[test]
    fn the_outline_belongs_to_the_polygon() {
        assert_eq!(pixels(&[[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0]], 9, 9).len(), 6);
        assert_eq!(pixels(&[[2.0, 0.0], [4.0, 2.0], [2.0, 4.0], [0.0, 2.0]], 9, 9).len(), 13);
    }

    #[test]
    fn a_polygon_outside_or_degenerate_has_no_pixels_and_one_partly_outside_is_cut() {
        assert!(pixels(&[[-9.0, -9.0], [-2.0, -9.0], [-5.0, -2.0]], 9, 9).is_empty());
        assert!(pixels(&[[1.0, 1.0], [3.0, 1.0]], 9, 9).is_empty());
        assert!(pixels(&[[1.0, f64::NAN], [3.0, 1.0], [2.0, 5.0]], 9, 9).is_empty());
        assert_eq!(pixels(&[[-50.0, -50.0], [50.0, -50.0], [50.0, 50.0], [-50.0, 50.0]], 9, 7).len(), 63);
    }

    #[test]
    fn a_concave_polygon_keeps_its_notch() {
        // A letter U: 5 wide, 4 high, with a notch of 1 column from the top to row 2.
        let u = [[0.0, 0.0], [1.0, 0.0], [1.0, 2.5], [3.0, 2.5], [3.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]];
        let found = pixels(&u, 9, 9);
        assert_eq!(found.len(), 4 * 5 - 3, "{found:?}");
        assert!(!found.contains(&(2, 1)) && found.contains(&(2, 3)));
    }

    #[test]
    fn a_slanted_quad_has_as_many_pixels_as_area() {
        let quad = [[329.91, 335.76], [322.09, 93.26], [498.34, 73.24], [553.81, 323.86]];
        // Area by the shoelace formula, computed separately: 49835.55 square pixels.
        let found = pixels(&quad, 640, 480).len() as f64;
        assert!((found - 49835.55).abs() < 20.0, "{found}");
    }
}
