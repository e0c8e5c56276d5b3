//! Patches with and without points.
#![allow(clippy::expect_used, reason = "inputs that are valid")]

use pb3dp_geometry::{Distortion, ImageSize, Pinhole};

use super::*;
use crate::cells::Cell;

const SIDE_PX: f64 = 16.0;

/// Cells with four points each, at these columns and rows.
fn cells(places: &[(usize, usize)]) -> Cells {
    let centre = |(column, row): (usize, usize)| [SIDE_PX * column as f64 + 8.0, SIDE_PX * row as f64 + 8.0];
    let cell = |&(column, row): &(usize, usize)| {
        let [x, y] = centre((column, row));
        let pixels = vec![[x - 5.0, y - 4.0], [x + 5.0, y - 5.0], [x - 4.0, y + 5.0], [x + 5.0, y + 4.0]];
        Cell { column, row, pixels }
    };
    Cells {
        first_centre_px: centre((0, 0)),
        side_px: SIDE_PX,
        columns: places.iter().map(|place| place.0 + 1).max().unwrap_or(0),
        rows: places.iter().map(|place| place.1 + 1).max().unwrap_or(0),
        cells: places.iter().map(cell).collect(),
    }
}

/// A body with a separate claw, and a leg that touches it at a corner.
fn crab() -> Cells {
    let body = (3..8).flat_map(|column| (2..6).map(move |row| (column, row)));
    let claw = [(0, 0), (1, 0), (0, 1)];
    let leg = [(8, 6), (9, 6), (9, 7)];
    let mut places: Vec<(usize, usize)> = body.chain(claw).chain(leg).collect();
    places.sort_by_key(|&(column, row)| (row, column));
    cells(&places)
}

fn grid(relief: &mut Relief, cells: &Cells) -> Grid {
    let size = ImageSize { width: 320, height: 240 };
    let pinhole = Pinhole { fx: 400.0, fy: 400.0, cx: 160.0, cy: 120.0 };
    let camera = Camera::new(size, pinhole, Distortion::None).expect("camera");
    relief.grid(cells.cells.iter().map(|cell| cell.pixels.clone()), &camera)
}

/// The last tested offset must not remain in patches without points: it would bend the surface along its border.
#[test]
fn patches_without_points_follow_those_with_points() {
    let cells = crab();
    let mut relief = Relief::over(&cells, 1e-2);
    relief.set_all(7.5);
    grid(&mut relief, &cells);
    relief.set_nodes(|_| 0.0);
    for pixel in cells.cells.iter().flat_map(|cell| &cell.pixels) {
        let (offset, slope) = relief.at(*pixel);
        assert!(offset == 0.0 && slope == [0.0; 2], "{offset} and {slope:?} at {pixel:?}");
    }
    assert!(relief.depth_sigma().all(|sigma| sigma == 0.0));
}

/// The offset of a point equals the weighted sum over its group's nodes, also between patches with and without points.
#[test]
fn the_shares_of_nodes_are_what_the_surface_does() {
    let cells = crab();
    let mut relief = Relief::over(&cells, 1.0);
    let grid = grid(&mut relief, &cells);
    let nodes: Vec<f64> = (0..grid.plane.len()).map(|node| (node as f64 * 1.7).sin()).collect();
    relief.set_nodes(|node| nodes[node]);
    for (cell, shares) in cells.cells.iter().zip(&grid.shares) {
        let mean = cell.pixels.iter().map(|pixel| relief.at(*pixel).0).sum::<f64>() / cell.pixels.len() as f64;
        let shared: f64 = shares.iter().map(|&(node, share)| share * nodes[node]).sum();
        assert!((mean - shared).abs() < 1e-12, "{mean} and {shared} in column {} row {}", cell.column, cell.row);
    }
}

/// Separate parts are connected: otherwise each would be a surface of its own, and a flat target would not be flat.
#[test]
fn all_nodes_hang_together() {
    let cells = crab();
    let grid = grid(&mut Relief::over(&cells, 1.0), &cells);
    let mut reached = vec![false; grid.plane.len()];
    reached[0] = true;
    for _ in 0..reached.len() {
        for &(i, j, distance) in &grid.edges {
            assert!(i != j && distance >= 1.0);
            let either = reached[i] || reached[j];
            (reached[i], reached[j]) = (either, either);
        }
    }
    assert!(reached.iter().all(|&is_reached| is_reached));
    let long: Vec<f64> = grid.edges.iter().map(|edge| edge.2).filter(|&distance| distance > 1.0).collect();
    assert_eq!(long.len(), 2, "{long:?}");
    assert!((long[0] - 2_f64.sqrt()).abs() < 1e-12, "{long:?}");
}
