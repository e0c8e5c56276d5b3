//! Model points in the memory layout of the kernels.

use crate::photo_model::ModelPoint;

/// Number of points per kernel step; the lists are padded to a multiple of it.
pub(super) const CHUNK: usize = 32;

/// A run of points in one image row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Row {
    /// Row relative to the origin.
    pub dv: i32,
    /// Index after the run's last point.
    pub end: usize,
}

/// The inner or the outer points, relative to an origin pixel.
#[derive(Clone, Debug, Default)]
pub(super) struct PointSet {
    count: usize,
    /// Pixel of each point.
    pub pixels: Vec<(i32, i32)>,
    /// Column relative to the origin.
    pub du: Vec<i32>,
    /// Runs of equal rows, in order.
    pub rows: Vec<Row>,
    /// `du` as floats, padded to whole chunks.
    pub du_real: Vec<f32>,
    /// Row relative to the origin, padded to whole chunks.
    pub dv_real: Vec<f32>,
    /// Stored hue, padded to whole chunks with invalid hues.
    pub hue: Vec<u16>,
}

impl PointSet {
    /// Copies a list of points.
    pub fn assign(&mut self, points: &[ModelPoint], origin: (i32, i32)) {
        self.count = points.len();
        let padded = points.len().next_multiple_of(CHUNK);
        self.pixels.clear();
        self.pixels.extend(points.iter().map(|p| (p.u, p.v)));
        self.du.clear();
        self.du.extend(points.iter().map(|p| p.u - origin.0));
        refill(&mut self.du_real, points.iter().map(|p| (p.u - origin.0) as f32), padded);
        refill(&mut self.dv_real, points.iter().map(|p| (p.v - origin.1) as f32), padded);
        refill(&mut self.hue, points.iter().map(|p| p.hue.bits()), padded);
        self.rows.clear();
        for (index, point) in points.iter().enumerate() {
            let dv = point.v - origin.1;
            match self.rows.last_mut() {
                Some(row) if row.dv == dv => row.end = index + 1,
                _ => self.rows.push(Row { dv, end: index + 1 }),
            }
        }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.count
    }
}

fn refill<T: Clone + Default>(list: &mut Vec<T>, values: impl Iterator<Item = T>, padded: usize) {
    list.clear();
    list.extend(values);
    list.resize(padded, T::default());
}
