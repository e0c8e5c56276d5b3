//! Grid cells of an image, which group the points of a surface.

/// Grid of cells over a region.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    /// Centre of cell (0, 0), raw pixels.
    pub(super) first_centre_px: [f64; 2],
    /// Side of a cell, raw pixels.
    pub(super) side_px: f64,
    pub(super) columns: usize,
    pub(super) rows: usize,
    pub(super) cells: Vec<Cell>,
}

/// A cell and its selected pixels, raw pixels.
#[derive(Clone, Debug, Default)]
pub(super) struct Cell {
    pub(super) column: usize,
    pub(super) row: usize,
    pub(super) pixels: Vec<[f64; 2]>,
}
