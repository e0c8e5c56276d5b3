//! Bayer pictures, one colour per pixel: the two others are the mean of the nearest pixels that have them (bilinear).

use image::RgbImage;

/// The colours of the upper left square of 2x2 pixels, row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BayerOrder {
    /// Red, green; green, blue.
    Rggb,
    /// Green, red; blue, green.
    Grbg,
    /// Green, blue; red, green.
    Gbrg,
    /// Blue, green; green, red.
    Bggr,
}

impl BayerOrder {
    /// Column and row, modulo 2, of red; blue lies diagonally to it.
    fn red(self) -> (usize, usize) {
        match self {
            Self::Rggb => (0, 0),
            Self::Grbg => (1, 0),
            Self::Gbrg => (0, 1),
            Self::Bggr => (1, 1),
        }
    }
}

/// Converts a picture of at least 2x2 pixels. Beyond its rim lies what lies inside, mirrored at the outermost pixels, so that colours
/// stay where the pattern has them.
pub(super) fn convert(bytes: &[u8], stride: usize, order: BayerOrder, target: &mut RgbImage) {
    let (width, height) = (target.width() as usize, target.height() as usize);
    let (red_column, red_row) = order.red();
    let row_of = |row: usize| &bytes[row * stride..row * stride + width];
    for (row, out) in target.chunks_exact_mut(3 * width).enumerate() {
        let above = row_of(if row == 0 { 1 } else { row - 1 });
        let below = row_of(if row + 1 == height { height - 2 } else { row + 1 });
        let rows = [above, row_of(row), below];
        // In a row with red the colour of the other rows is blue, and the other way round.
        let has_red = row % 2 == red_row;
        let colour_column = if has_red { red_column } else { 1 - red_column };
        convert_row(rows, has_red, colour_column, out);
    }
}

/// One row; `colour_column` (modulo 2) has the row's colour that is not green.
fn convert_row(rows: [&[u8]; 3], has_red: bool, colour_column: usize, out: &mut [u8]) {
    let width = rows[1].len();
    let columns = |columns: [usize; 3]| rows.map(|row| columns.map(|column| row[column]));
    let (rim, inner) = out.split_at_mut(3);
    rim.copy_from_slice(&pixel(columns([1, 0, 1]), has_red, colour_column == 0));
    let (inner, rim) = inner.split_at_mut(3 * (width - 2));
    rim.copy_from_slice(&pixel(columns([width - 2, width - 1, width - 2]), has_red, (width - 1) % 2 == colour_column));
    let squares = rows[0].windows(3).zip(rows[1].windows(3)).zip(rows[2].windows(3));
    let mut is_colour = colour_column == 1;
    for (out, ((above, own), below)) in inner.chunks_exact_mut(3).zip(squares) {
        let square = [[above[0], above[1], above[2]], [own[0], own[1], own[2]], [below[0], below[1], below[2]]];
        out.copy_from_slice(&pixel(square, has_red, is_colour));
        is_colour = !is_colour;
    }
}

/// The pixel in the middle of a square, which has the row's colour that is not green, or green.
#[inline(always)]
fn pixel(square: [[u8; 3]; 3], has_red: bool, is_colour: bool) -> [u8; 3] {
    let [above, row, below] = square.map(|row| row.map(u16::from));
    let beside = row[0] + row[2];
    let upright = above[1] + below[1];
    let (own, green, other) = if is_colour {
        let corners = above[0] + above[2] + below[0] + below[2];
        (row[1], (beside + upright + 2) >> 2, (corners + 2) >> 2)
    } else {
        ((beside + 1) >> 1, row[1], (upright + 1) >> 1)
    };
    if has_red { [own as u8, green as u8, other as u8] } else { [other as u8, green as u8, own as u8] }
}
