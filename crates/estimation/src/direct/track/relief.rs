//! The relief: by how much the surface leaves its plane, per patch of the first view, in pixels of disparity.

use super::surface::Cells;

/// Offsets on a grid of patches, bilinear in between. Patches without points take the mean of their neighbours.
#[derive(Clone, Debug)]
pub(super) struct Relief {
    first_centre_px: [f64; 2],
    side_px: f64,
    columns: usize,
    rows: usize,
    /// Disparity that the surface has more than its plane, pixels.
    offset_px: Vec<f64>,
    /// What is known of it, 1/px^2; 0 for a patch without points.
    information: Vec<f64>,
    /// Patch of each group of the finest level.
    patch_of_group: Vec<usize>,
    /// Inverse depth of a pixel of disparity, 1/m.
    inverse_depth_per_px: f64,
}

impl Relief {
    /// No relief.
    pub(super) fn over(cells: &Cells, inverse_depth_per_px: f64) -> Self {
        let count = cells.columns * cells.rows;
        Self {
            first_centre_px: cells.first_centre_px,
            side_px: cells.side_px.max(1.0),
            columns: cells.columns.max(1),
            rows: cells.rows.max(1),
            offset_px: vec![0.0; count.max(1)],
            information: vec![0.0; count.max(1)],
            patch_of_group: cells.cells.iter().map(|cell| cell.row * cells.columns + cell.column).collect(),
            inverse_depth_per_px,
        }
    }

    /// What is added to the plane's inverse depth at a raw pixel of the first view, 1/m, and its slope by u and v.
    pub(super) fn at(&self, pixel: [f64; 2]) -> (f64, [f64; 2]) {
        let place = |axis: usize, count: usize| {
            let x = ((pixel[axis] - self.first_centre_px[axis]) / self.side_px).clamp(0.0, (count - 1) as f64);
            let first = (x as usize).min(count.saturating_sub(2));
            (first, (first + 1).min(count - 1), x - first as f64)
        };
        let ((left, right, a), (top, bottom, b)) = (place(0, self.columns), place(1, self.rows));
        let node = |column: usize, row: usize| self.offset_px[row * self.columns + column];
        let (tl, tr, bl, br) = (node(left, top), node(right, top), node(left, bottom), node(right, bottom));
        let upper = tl + a * (tr - tl);
        let lower = bl + a * (br - bl);
        let scale = self.inverse_depth_per_px;
        let by_u = ((1.0 - b) * (tr - tl) + b * (br - bl)) * scale / self.side_px;
        let by_v = (lower - upper) * scale / self.side_px;
        ((upper + b * (lower - upper)) * scale, [by_u, by_v])
    }
}
