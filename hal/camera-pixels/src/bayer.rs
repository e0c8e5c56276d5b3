//! Bayer images, one colour per pixel: the other two are the mean of the nearest pixels that have them (bilinear).

use image::RgbImage;
use pb3dp_camera_settings::BayerOrder;

/// Column and row, modulo 2, of red; blue is diagonal to it.
fn red(order: BayerOrder) -> (usize, usize) {
    match order {
        BayerOrder::Rggb => (0, 0),
        BayerOrder::Grbg => (1, 0),
        BayerOrder::Gbrg => (0, 1),
        BayerOrder::Bggr => (1, 1),
    }
}

/// Converts images, with reusable row memory.
#[derive(Debug)]
pub(super) struct Demosaic {
    rows: RowColours,
    /// Bit masks of the columns, without the outermost two, that have the non-green colour of their row: for rows in which column
    /// 1 has it, and for the others.
    masks: [Vec<u8>; 2],
}

/// The colours of a row, without its outermost pixels.
#[derive(Debug)]
struct RowColours {
    /// The non-green colour of the row.
    own: Vec<u8>,
    green: Vec<u8>,
    /// The colour of the rows above and below.
    other: Vec<u8>,
}

impl Demosaic {
    /// Creates a converter for this image width, in pixels.
    pub(super) fn new(width: u32) -> Self {
        let inner = (width as usize).saturating_sub(2);
        let row = || vec![0; inner];
        let columns = |parity| (0..inner).map(|column| if column % 2 == parity { u8::MAX } else { 0 }).collect();
        Self { rows: RowColours { own: row(), green: row(), other: row() }, masks: [columns(0), columns(1)] }
    }

    /// Converts an image of that width and at least 2x2 pixels. The border is mirrored at the outermost pixels, so that the
    /// colour pattern is preserved.
    pub(super) fn convert(&mut self, bytes: &[u8], stride: usize, order: BayerOrder, target: &mut RgbImage) {
        let (width, height) = (target.width() as usize, target.height() as usize);
        let (red_column, red_row) = red(order);
        let row_of = |row: usize| &bytes[row * stride..row * stride + width];
        for (row, out) in target.chunks_exact_mut(3 * width).enumerate() {
            let above = row_of(if row == 0 { 1 } else { row - 1 });
            let below = row_of(if row + 1 == height { height - 2 } else { row + 1 });
            let rows = [above, row_of(row), below];
            // In a row with red the colour of the other rows is blue, and vice versa.
            let has_red = row % 2 == red_row;
            let colour_column = if has_red { red_column } else { 1 - red_column };
            self.convert_row(rows, has_red, colour_column, out);
        }
    }

    /// Converts one row; `colour_column` (modulo 2) has the non-green colour of the row.
    fn convert_row(&mut self, rows: [&[u8]; 3], has_red: bool, colour_column: usize, out: &mut [u8]) {
        let width = rows[1].len();
        let columns = |columns: [usize; 3]| rows.map(|row| columns.map(|column| row[column]));
        let (rim, inner) = out.split_at_mut(3);
        rim.copy_from_slice(&pixel(columns([1, 0, 1]), has_red, colour_column == 0));
        let (inner, rim) = inner.split_at_mut(3 * (width - 2));
        rim.copy_from_slice(&pixel(
            columns([width - 2, width - 1, width - 2]),
            has_red,
            (width - 1) % 2 == colour_column,
        ));
        let RowColours { own, green, other } = &mut self.rows;
        // The first of the inner columns is column 1.
        inner_colours(rows, &self.masks[1 - colour_column], own, green, other);
        let (red, blue) = if has_red { (own, other) } else { (other, own) };
        let colours = red.iter().zip(green.iter()).zip(blue.iter());
        for (pixel, ((red, green), blue)) in inner.as_chunks_mut::<3>().0.iter_mut().zip(colours) {
            *pixel = [*red, *green, *blue];
        }
    }
}

/// The same as [`pixel`] for all columns except the outermost, without a branch and without arrays of pixels: compilers vectorise it.
fn inner_colours([above, row, below]: [&[u8]; 3], mask: &[u8], own: &mut [u8], green: &mut [u8], other: &mut [u8]) {
    let count = mask.len();
    let (own, green, other) = (&mut own[..count], &mut green[..count], &mut other[..count]);
    let (above_left, above, above_right) = (&above[..count], &above[1..][..count], &above[2..][..count]);
    let (left, centre, right) = (&row[..count], &row[1..][..count], &row[2..][..count]);
    let (below_left, below, below_right) = (&below[..count], &below[1..][..count], &below[2..][..count]);
    for column in 0..count {
        let beside = u16::from(left[column]) + u16::from(right[column]);
        let upright = u16::from(above[column]) + u16::from(below[column]);
        let corners_above = u16::from(above_left[column]) + u16::from(above_right[column]);
        let corners = corners_above + u16::from(below_left[column]) + u16::from(below_right[column]);
        let (centre, is_colour) = (centre[column], mask[column]);
        own[column] = (centre & is_colour) | (((beside + 1) >> 1) as u8 & !is_colour);
        green[column] = (((beside + upright + 2) >> 2) as u8 & is_colour) | (centre & !is_colour);
        other[column] = (((corners + 2) >> 2) as u8 & is_colour) | (((upright + 1) >> 1) as u8 & !is_colour);
    }
}

/// The centre pixel of a square, which has the non-green colour of the row, or green.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_as_their_pixels_are_one_by_one() {
        let value = |k: usize| (k.wrapping_mul(2_654_435_761) >> 11) as u8;
        for (width, order) in
            [(2, BayerOrder::Rggb), (3, BayerOrder::Grbg), (37, BayerOrder::Gbrg), (64, BayerOrder::Bggr)]
        {
            let (height, stride) = (7, width + 5);
            let bytes: Vec<u8> = (0..height * stride).map(value).collect();
            let mut found = RgbImage::new(width as u32, height as u32);
            Demosaic::new(width as u32).convert(&bytes, stride, order, &mut found);
            let mirrored = |k: isize, end: usize| if k < 0 { 1 } else { (k as usize).min(2 * (end - 1) - k as usize) };
            for (x, y, rgb) in found.enumerate_pixels() {
                let (x, y) = (x as isize, y as isize);
                let at = |dx: isize, dy: isize| bytes[mirrored(y + dy, height) * stride + mirrored(x + dx, width)];
                let square = [-1, 0, 1].map(|dy| [-1, 0, 1].map(|dx| at(dx, dy)));
                let (red_column, red_row) = red(order);
                let [is_red_row, is_red_column] = [y as usize % 2 == red_row, x as usize % 2 == red_column];
                assert_eq!(
                    rgb.0,
                    pixel(square, is_red_row, is_red_row == is_red_column),
                    "{order:?} {width}: {x}, {y}"
                );
            }
        }
    }
}
