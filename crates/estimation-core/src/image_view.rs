//! A borrowed image in the memory of the caller.

use std::ops::Range;

use image::{GrayImage, Rgb, RgbImage};
use pb3dp_geometry::ValueRange;

/// The values of an image, row by row: grey, or red, green and blue interleaved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pixels<'a> {
    /// Grey, 8 bits.
    Grey(&'a [u8]),
    /// Colour, 8 bits per channel.
    Rgb(&'a [u8]),
    /// Grey, up to 16 bits; the range becomes black to white.
    DeepGrey(&'a [u16], ValueRange),
    /// Colour, up to 16 bits per channel; the range becomes black to white.
    DeepRgb(&'a [u16], ValueRange),
}

/// An image that the estimators read and do not own, with any distance between its rows.
///
/// An [`RgbImage`] or [`GrayImage`] converts by `into()`; memory of another library by [`ImageView::new`]. Nothing is copied.
/// The estimators compute with 8 bits per channel. They read 8-bit colour where it is, and convert the parts that they need of all other
/// images: grey to three equal channels, deep values rounded to 8 bits of their range. The answers are those for the converted image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ImageView<'a> {
    width: u32,
    height: u32,
    /// Values from one row to the next.
    stride: usize,
    pixels: Pixels<'a>,
}

/// Rows of 8-bit colour: a part of an image.
#[derive(Clone, Copy, Debug)]
pub struct RgbRows<'a> {
    bytes: &'a [u8],
    stride: usize,
    length: usize,
}

impl<'a> ImageView<'a> {
    /// An image of this size with `stride` values from one row to the next; `pixels` begins with the first pixel and may end after the
    /// last one. `None` if rows overlap, values are missing, or there are more than 2^32 of them.
    pub fn new(width: u32, height: u32, stride: usize, pixels: Pixels<'a>) -> Option<Self> {
        let row = (width as usize).checked_mul(pixels.channels())?;
        let length = match (row, height as usize) {
            (0, _) | (_, 0) => 0,
            (row, height) => (height - 1).checked_mul(stride)?.checked_add(row)?,
        };
        let fits = stride >= row && length <= pixels.len() && u32::try_from(length).is_ok();
        fits.then(|| Self { width, height, stride, pixels: pixels.part(0..length) })
    }

    /// A part of the image, in the same memory; `None` if it is not inside.
    pub fn part(&self, columns: Range<u32>, rows: Range<u32>) -> Option<Self> {
        let (width, height) = (columns.end.checked_sub(columns.start)?, rows.end.checked_sub(rows.start)?);
        let is_inside = columns.end <= self.width && rows.end <= self.height;
        let range = is_inside.then(|| self.span(&as_usize(columns), &as_usize(rows)))?;
        Some(Self { width, height, stride: self.stride, pixels: self.pixels.part(range) })
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Width and height, pixels.
    pub fn dimensions(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// The pixel in column `x` and row `y`.
    ///
    /// # Panics
    /// A pixel outside the image.
    pub fn get_pixel(&self, x: u32, y: u32) -> Rgb<u8> {
        let mut pixel = [0; 3];
        self.copy_row(x as usize, y as usize, &mut pixel);
        Rgb(pixel)
    }

    /// A row: red, green and blue of its pixels. `buffer` is used if the image has other pixels.
    ///
    /// # Panics
    /// A row outside the image.
    pub fn row<'s>(&self, y: u32, buffer: &'s mut Vec<u8>) -> &'s [u8]
    where
        'a: 's,
    {
        let y = y as usize;
        self.rgb(0..self.width as usize, y..y + 1, buffer).row(0)
    }

    /// A part of the image in 8-bit colour: in its own memory if the image has such pixels, otherwise converted into `buffer`.
    ///
    /// # Panics
    /// A part that is not inside the image.
    pub fn rgb<'s>(&self, columns: Range<usize>, rows: Range<usize>, buffer: &'s mut Vec<u8>) -> RgbRows<'s>
    where
        'a: 's,
    {
        let length = 3 * columns.len();
        if let Pixels::Rgb(bytes) = self.pixels {
            return RgbRows { bytes: &bytes[self.span(&columns, &rows)], stride: self.stride, length };
        }
        buffer.resize(length * rows.len(), 0);
        for (y, row) in rows.zip(buffer.chunks_exact_mut(length.max(1))) {
            self.copy_row(columns.start, y, row);
        }
        RgbRows { bytes: buffer, stride: length, length }
    }

    /// The whole image if it is 8-bit colour.
    pub fn borrowed_rgb(&self) -> Option<RgbRows<'a>> {
        let Pixels::Rgb(bytes) = self.pixels else { return None };
        Some(RgbRows { bytes, stride: self.stride, length: 3 * self.width as usize })
    }

    /// The whole image in 8-bit colour without gaps: in its own memory if it is such an image, otherwise copied into `buffer`.
    pub fn contiguous_rgb<'s>(&self, buffer: &'s mut Vec<u8>) -> &'s [u8]
    where
        'a: 's,
    {
        let length = 3 * self.width as usize;
        match self.pixels {
            Pixels::Rgb(bytes) if self.stride == length => bytes,
            _ => {
                buffer.resize(length * self.height as usize, 0);
                for (y, row) in buffer.chunks_exact_mut(length.max(1)).enumerate() {
                    self.copy_row(0, y, row);
                }
                buffer
            }
        }
    }

    /// Writes red, green and blue of the pixels from column `x` of row `y` on, as many as `out` holds.
    ///
    /// # Panics
    /// Pixels outside the image.
    pub fn copy_row(&self, x: usize, y: usize, out: &mut [u8]) {
        let (out, _) = out.as_chunks_mut::<3>();
        let span = self.span(&(x..x + out.len()), &(y..y + 1));
        match self.pixels {
            Pixels::Rgb(bytes) => out.as_flattened_mut().copy_from_slice(&bytes[span]),
            Pixels::Grey(bytes) => out.iter_mut().zip(&bytes[span]).for_each(|(pixel, grey)| *pixel = [*grey; 3]),
            Pixels::DeepGrey(values, range) => {
                let shade = range.shades();
                out.iter_mut().zip(&values[span]).for_each(|(pixel, value)| *pixel = [shade(*value); 3]);
            }
            Pixels::DeepRgb(values, range) => {
                let shade = range.shades();
                out.as_flattened_mut().iter_mut().zip(&values[span]).for_each(|(byte, value)| *byte = shade(*value));
            }
        }
    }

    /// The values from the first pixel of a part to its last one.
    fn span(&self, columns: &Range<usize>, rows: &Range<usize>) -> Range<usize> {
        let (width, height) = (self.width as usize, self.height as usize);
        assert!(columns.end <= width, "column {} of an image with {width} columns", columns.end);
        assert!(rows.end <= height, "row {} of an image with {height} rows", rows.end);
        if columns.is_empty() || rows.is_empty() {
            return 0..0;
        }
        let at = |x: usize, y: usize| y * self.stride + x * self.pixels.channels();
        at(columns.start, rows.start)..at(columns.end, rows.end - 1)
    }
}

impl<'a> RgbRows<'a> {
    /// Row `y` of the part: red, green and blue of its pixels.
    #[inline]
    pub fn row(&self, y: usize) -> &'a [u8] {
        // Rows without columns are nowhere.
        if self.length == 0 {
            return &[];
        }
        &self.bytes[y * self.stride..][..self.length]
    }

    /// The bytes from the first pixel to the last one, with those of the image between the rows of the part.
    pub fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Bytes from one row to the next.
    pub fn stride(&self) -> usize {
        self.stride
    }
}

impl Pixels<'_> {
    /// Values per pixel.
    fn channels(&self) -> usize {
        match self {
            Self::Grey(_) | Self::DeepGrey(..) => 1,
            Self::Rgb(_) | Self::DeepRgb(..) => 3,
        }
    }

    /// Number of values.
    fn len(&self) -> usize {
        match self {
            Self::Grey(bytes) | Self::Rgb(bytes) => bytes.len(),
            Self::DeepGrey(values, _) | Self::DeepRgb(values, _) => values.len(),
        }
    }

    fn part(self, range: Range<usize>) -> Self {
        match self {
            Self::Grey(bytes) => Self::Grey(&bytes[range]),
            Self::Rgb(bytes) => Self::Rgb(&bytes[range]),
            Self::DeepGrey(values, levels) => Self::DeepGrey(&values[range], levels),
            Self::DeepRgb(values, levels) => Self::DeepRgb(&values[range], levels),
        }
    }
}

fn as_usize(range: Range<u32>) -> Range<usize> {
    range.start as usize..range.end as usize
}

impl<'a> From<&'a RgbImage> for ImageView<'a> {
    fn from(image: &'a RgbImage) -> Self {
        let (width, height) = image.dimensions();
        Self { width, height, stride: 3 * width as usize, pixels: Pixels::Rgb(image.as_raw()) }
    }
}

impl<'a> From<&'a GrayImage> for ImageView<'a> {
    fn from(image: &'a GrayImage) -> Self {
        let (width, height) = image.dimensions();
        Self { width, height, stride: width as usize, pixels: Pixels::Grey(image.as_raw()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All pixels of an image.
    fn pixels(view: ImageView<'_>) -> Vec<[u8; 3]> {
        let mut buffer = Vec::new();
        (0..view.height()).flat_map(|y| view.row(y, &mut buffer).as_chunks::<3>().0.to_vec()).collect()
    }

    #[test]
    fn a_view_shows_the_pixels_of_its_image_without_a_copy() {
        let image = RgbImage::from_fn(5, 3, |x, y| Rgb([x as u8, y as u8, 7]));
        let view = ImageView::from(&image);
        assert_eq!((view.dimensions(), view.get_pixel(4, 2)), ((5, 3), Rgb([4, 2, 7])));
        let mut buffer = Vec::new();
        assert_eq!(view.row(0, &mut buffer).as_ptr(), image.as_raw().as_ptr());
        assert_eq!(buffer.capacity(), 0);
        assert_eq!(ImageView::new(5, 3, 15, Pixels::Rgb(image.as_raw())), Some(view));
        assert_eq!(pixels(view), image.pixels().map(|pixel| pixel.0).collect::<Vec<_>>());
    }

    #[test]
    fn memory_that_does_not_hold_the_image_is_refused() {
        let bytes = [0; 45];
        for (width, height, stride) in
            [(5, 4, 15), (5, 3, 14), (5, 3, 16), (u32::MAX, u32::MAX, usize::MAX), (1, u32::MAX, usize::MAX)]
        {
            assert_eq!(ImageView::new(width, height, stride, Pixels::Rgb(&bytes)), None, "{width} {height} {stride}");
        }
        for (width, height, stride) in [(5, 3, 15), (4, 3, 16), (0, 9, 0), (9, 0, 27), (0, 0, 0)] {
            let view = ImageView::new(width, height, stride, Pixels::Rgb(&bytes)).unwrap();
            assert_eq!(pixels(view).len(), (width * height) as usize);
        }
    }

    #[test]
    fn a_part_has_the_rows_of_its_image() {
        let image = RgbImage::from_fn(7, 5, |x, y| Rgb([x as u8, y as u8, 7]));
        let whole = ImageView::from(&image);
        let part = whole.part(2..5, 1..4).unwrap();
        assert_eq!((part.dimensions(), part.get_pixel(2, 2), part.stride), ((3, 3), Rgb([4, 3, 7]), 21));
        assert_eq!(part.part(1..2, 0..3).unwrap().get_pixel(0, 0), Rgb([3, 1, 7]));
        assert_eq!(part.part(0..4, 0..3), None);
        assert_eq!(part.part(2..5, Range { start: 3, end: 1 }), None);
        assert_eq!(part.part(3..3, 0..3).unwrap().dimensions(), (0, 3));
        let mut buffer = Vec::new();
        let rows = part.rgb(1..3, 0..2, &mut buffer);
        assert_eq!((rows.row(1), rows.stride(), rows.bytes().len()), (&[3, 2, 7, 4, 2, 7][..], 21, 27));
        assert!(part.rgb(1..1, 0..2, &mut buffer).row(1).is_empty());
    }

    #[test]
    fn grey_and_deep_images_have_the_pixels_of_the_converted_image() {
        let range = ValueRange::new(100, 610).unwrap();
        let values: Vec<u16> = vec![0, 100, 355, 9, 610, 65535, 101, 9];
        let (grey, shades) = ([0, 0, 128, 9, 255, 255, 1, 9], [0, 0, 128, 255, 255, 1]);
        let expected: Vec<[u8; 3]> = shades.map(|shade| [shade; 3]).to_vec();
        // Rows of three values, and one between them.
        assert_eq!(pixels(ImageView::new(3, 2, 4, Pixels::Grey(&grey)).unwrap()), expected);
        let deep = ImageView::new(3, 2, 4, Pixels::DeepGrey(&values, range)).unwrap();
        assert_eq!(pixels(deep), expected);
        assert_eq!(pixels(deep.part(1..3, 1..2).unwrap()), expected[4..]);
        let colour = ImageView::new(1, 2, 4, Pixels::DeepRgb(&values, range)).unwrap();
        assert_eq!(pixels(colour), [[0, 0, 128], [255, 255, 1]]);
        let image = GrayImage::from_raw(4, 2, grey.to_vec()).unwrap();
        assert_eq!(ImageView::from(&image).get_pixel(2, 0), Rgb([128; 3]));
    }

    #[test]
    fn pixels_outside_are_a_bug() {
        let image = RgbImage::new(4, 4);
        let view = ImageView::from(&image).part(0..2, 0..2).unwrap();
        for (x, y) in [(2, 0), (0, 2)] {
            assert!(std::panic::catch_unwind(|| view.get_pixel(x, y)).is_err(), "({x}, {y})");
        }
    }
}
