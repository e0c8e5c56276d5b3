//! The values that are interpolated: those of a raw image, or sums over squares of its pixels.

use nalgebra::Vector2;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::wide::wide;
use pb3dp_geometry::maps::PixelMap;

use super::super::colour_planes::SATURATED_FROM;
use super::super::image_plane::PixelWindow;
use super::cells::{CELL, CellPositions, PATCH, POSITION_MAX_PX, whole};

/// A value of an image.
pub trait Value: Copy + Default + Ord {
    /// The value without the mark of saturation.
    fn grey(self) -> f32;
    /// Whether the pixel may be saturated.
    fn is_saturated(self) -> bool;
}

impl Value for u8 {
    #[inline(always)]
    fn grey(self) -> f32 {
        f32::from(self)
    }

    #[inline(always)]
    fn is_saturated(self) -> bool {
        self >= SATURATED_FROM
    }
}

/// A sum of up to 64 bytes, and [`SATURATED_SUM`] if one of the pixels may be saturated.
impl Value for u16 {
    #[inline(always)]
    fn grey(self) -> f32 {
        f32::from(self & (SATURATED_SUM - 1))
    }

    #[inline(always)]
    fn is_saturated(self) -> bool {
        self >= SATURATED_SUM
    }
}

/// Above the sum of 64 bytes.
const SATURATED_SUM: u16 = 1 << 14;
/// Largest side of the squares of a [`ReducedImage`], pixels.
pub const REDUCTION_MAX: usize = 8;

/// A part of a raw image or of a reduced one: red, green and blue, interleaved.
#[derive(Clone, Copy)]
pub struct RawImage<'a, T> {
    pub(super) values: &'a [T],
    /// Values from one row to the next.
    pub(super) stride: usize,
    pub(super) width: usize,
    pub(super) height: usize,
    /// Position of the first pixel in the whole image.
    pub(super) first: [i32; 2],
    /// Factor from values to grey levels.
    pub(super) share: f32,
}

impl<'a> RawImage<'a, u8> {
    /// A whole image in its own memory; `None` if it is not 8-bit colour.
    pub fn borrowed(image: ImageView<'a>) -> Option<Self> {
        let (width, height) = (image.width() as usize, image.height() as usize);
        let rows = image.borrowed_rgb()?;
        Some(Self { values: rows.bytes(), stride: rows.stride(), width, height, first: [0; 2], share: 1.0 })
    }

    /// The part of an image that a cell shows, converted into `buffer`: the cell gets the same values as from the whole image.
    pub fn of_cell(image: ImageView<'_>, positions: &CellPositions, buffer: &'a mut Vec<u8>) -> Self {
        let [columns, rows] = positions.taps_box([image.width(), image.height()]);
        let size = (columns.len(), rows.len());
        let first = [columns.start as i32, rows.start as i32];
        image.rgb(columns, rows, buffer);
        // Room behind the last row, which is read to the full width of a patch.
        buffer.resize(buffer.len() + 3 * PATCH, 0);
        Self { values: buffer, stride: 3 * size.0, width: size.0, height: size.1, first, share: 1.0 }
    }
}

impl<'a, T: Value> RawImage<'a, T> {
    /// Column and row of pixel `i` of row `y` of a cell, and the rest of its position.
    #[inline(always)]
    pub(super) fn split(&self, positions: &CellPositions, y: usize, i: usize) -> [(i32, f32); 2] {
        [0, 1].map(|axis| {
            let at = positions.at[axis][y][i];
            let (number, floor) = whole(positions.base[axis] - self.first[axis], at);
            (number, at - floor)
        })
    }

    /// A pixel, if it is inside the part.
    #[inline(always)]
    pub(super) fn pixel(&self, column: i64, row: i64) -> Option<[T; 3]> {
        let is_inside = (0..self.width as i64).contains(&column) && (0..self.height as i64).contains(&row);
        let start = is_inside.then(|| row as usize * self.stride + 3 * column as usize)?;
        self.values.get(start..)?.first_chunk().copied()
    }

    /// The 4 x 4 neighbours of a pixel, if they are inside the part.
    #[inline(always)]
    pub(super) fn taps(&self, column: i32, row: i32) -> Option<[&'a [T; 12]; 4]> {
        if column < 1 || row < 1 || column > self.width as i32 - 3 || row > self.height as i32 - 3 {
            return None;
        }
        let start = (row as usize - 1) * self.stride + 3 * (column as usize - 1);
        let row = |j: usize| self.values.get(start + j * self.stride..)?.first_chunk();
        Some([row(0)?, row(1)?, row(2)?, row(3)?])
    }
}

/// Sums over squares of pixels of a part of a raw image; keeps its buffers.
#[derive(Clone, Debug, Default)]
pub struct ReducedImage {
    values: Vec<u16>,
    columns: Vec<u16>,
    /// Rows of an image that is not 8-bit colour.
    converted: Vec<u8>,
    size: (usize, usize),
    first: [i32; 2],
    scale: usize,
}

impl ReducedImage {
    /// Sums over squares of side `scale`, for the part of `raw` that the pixels of `window` show; `map` is between images
    /// reduced by `scale`.
    pub fn update(&mut self, map: &PixelMap, raw: ImageView<'_>, window: &PixelWindow, scale: usize, kernels: Kernels) {
        let part = source_box(map, window);
        (self.size, self.first, self.scale) = ((part.width, part.height), [part.x, part.y], scale);
        // Room behind the last row, which is read to the full width of a patch.
        self.values.resize(3 * part.width * part.height + 3 * PATCH, 0);
        self.columns.resize(3 * part.width * scale + 3 * REDUCTION_MAX + LANES, 0);
        let first = part.x as usize * scale;
        let columns = first..first + part.width * scale;
        for (y, row) in part.rows().enumerate() {
            let rows = raw.rgb(columns.clone(), row * scale..(row + 1) * scale, &mut self.converted);
            let out = &mut self.values[3 * part.width * y..][..3 * part.width];
            reduce_rows(kernels, rows.bytes(), rows.stride(), scale, &mut self.columns, out);
        }
    }

    pub(super) fn image(&self) -> RawImage<'_, u16> {
        let (width, height) = self.size;
        let share = 1.0 / (self.scale * self.scale).max(1) as f32;
        RawImage { values: &self.values, stride: 3 * width, width, height, first: self.first, share }
    }
}

/// Distance of the mapped points on the border of a window, pixels. Chosen by hand, not varied.
const BORDER_STEP: usize = CELL;
/// Margin around the mapped border, pixels: bending between its points, and the kernel. Chosen by hand, not varied.
const BORDER_MARGIN: f64 = 8.0;

/// The part of the source that the cells of a window show: all of it if a part of their border has no source.
fn source_box(map: &PixelMap, window: &PixelWindow) -> PixelWindow {
    let size = map.source_size();
    let whole = PixelWindow { x: 0, y: 0, width: size.width as usize, height: size.height as usize };
    let (mut low, mut high) = (Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN));
    let along = |length: usize| (0..=length).step_by(BORDER_STEP);
    // Cells at the border reach beyond the window.
    let [width, height] = [window.width, window.height].map(|length| length.next_multiple_of(CELL));
    let rows = along(width).flat_map(|x| [(x, 0), (x, height)]);
    let columns = along(height).flat_map(|y| [(0, y), (width, y)]);
    for (x, y) in rows.chain(columns) {
        let pixel = Vector2::new(f64::from(window.x) + x as f64, f64::from(window.y) + y as f64);
        let Some(source) = map.source(&pixel).filter(|px| px.amax() < POSITION_MAX_PX) else { return whole };
        (low, high) = (low.inf(&source), high.sup(&source));
    }
    let first = low.add_scalar(-BORDER_MARGIN).map(f64::floor);
    let count = (high.add_scalar(BORDER_MARGIN) - first).map(f64::ceil);
    let part = PixelWindow { x: first.x as i32, y: first.y as i32, width: count.x as usize, height: count.y as usize };
    part.clipped(size.width, size.height)
}

wide! {
    /// Sums over one row of squares: first along columns, then along rows.
    fn reduce_rows(rows: &[u8], stride: usize, scale: usize, columns: &mut [u16], out: &mut [u16]) = reduce_rows_kernel;
}

#[inline(always)]
fn reduce_rows_kernel(rows: &[u8], stride: usize, scale: usize, columns: &mut [u16], out: &mut [u16]) {
    let length = out.len() * scale;
    columns.fill(0);
    let mut highest = 0;
    for row in rows.chunks(stride.max(1)) {
        for (column, value) in columns.iter_mut().zip(&row[..length]) {
            *column += u16::from(*value);
            highest = highest.max(*value);
        }
    }
    add_neighbours(scale, columns, |a, b| a + b);
    take_squares(scale, columns, out, |_, sum| sum);
    if highest >= SATURATED_FROM {
        columns.fill(0);
        for row in rows.chunks(stride.max(1)) {
            for (column, value) in columns.iter_mut().zip(&row[..length]) {
                *column = (*column).max(u16::from(*value));
            }
        }
        add_neighbours(scale, columns, u16::max);
        let is_high = |highest: u16| highest >= u16::from(SATURATED_FROM);
        take_squares(scale, columns, out, |sum, highest| sum | if is_high(highest) { SATURATED_SUM } else { 0 });
    }
}

/// Values that are combined at once.
const LANES: usize = 32;

/// Combines the values of `scale` adjacent pixels, a power of two, from every pixel on; only those of squares are used.
#[inline(always)]
fn add_neighbours(scale: usize, columns: &mut [u16], combine: impl Fn(u16, u16) -> u16) {
    let mut span = 3;
    while span < 3 * scale {
        let mut first = 0;
        // Whole registers: the sums of the last squares are inside, the room behind them is not used.
        while first + span + LANES <= columns.len() {
            let mut next = [0; LANES];
            next.copy_from_slice(&columns[first + span..first + span + LANES]);
            for (column, next) in columns[first..first + LANES].iter_mut().zip(next) {
                *column = combine(*column, next);
            }
            first += LANES;
        }
        span *= 2;
    }
}

/// Writes the first pixel of every square.
#[inline(always)]
fn take_squares(scale: usize, columns: &[u16], out: &mut [u16], combine: impl Fn(u16, u16) -> u16) {
    let squares = columns.chunks_exact(3 * scale);
    for (out, square) in out.as_chunks_mut::<3>().0.iter_mut().zip(squares) {
        *out = [combine(out[0], square[0]), combine(out[1], square[1]), combine(out[2], square[2])];
    }
}
