//! Images with more than 8 bits per channel, and the range of their values that becomes black to white.
//!
//! A file with 16 bits per channel does not state which part of the range its camera uses: an image of a 12-bit camera would appear
//! black. The user states the range, or it is measured on the first images: both images of a pair, and all pairs of a recording, need
//! the same range, because the methods compare their values.

use image::RgbImage;
use pb3dp_geometry::ImageSize;

pub use pb3dp_geometry::{ValueRange, WrongRange};

/// Share of the values below the measured range, and share above it: some hot and dead pixels.
const OUTSIDE: f64 = 0.001;

/// The range of values, without the darkest and the brightest thousandth of them.
pub fn measured_range<'a>(values: impl IntoIterator<Item = &'a u16>) -> ValueRange {
    let mut counts = vec![0_u64; 1 << 16];
    for value in values {
        counts[usize::from(*value)] += 1;
    }
    let all: u64 = counts.iter().sum();
    let outside = (OUTSIDE * all as f64) as u64;
    let low = first_beyond(0..=u16::MAX, &counts, outside).unwrap_or(0);
    let high = first_beyond((0..=u16::MAX).rev(), &counts, outside).unwrap_or(u16::MAX);
    // An image of one value has no range: it becomes black.
    ValueRange::new(low.min(u16::MAX - 1), high.max(low.saturating_add(1))).unwrap_or(ValueRange::FULL)
}

/// The range for a pair with these deep images: the stated one; otherwise the one measured on the first pair with any, which is kept,
/// with a line for the user.
pub fn range_of_pair(range: &mut Option<ValueRange>, deep: &[&DeepImage]) -> (ValueRange, Option<String>) {
    match (*range, deep) {
        (Some(range), _) => (range, None),
        (None, []) => (ValueRange::FULL, None),
        (None, deep) => {
            let measured = *range.insert(measured_range(deep.iter().flat_map(|image| &image.values)));
            (measured, Some(note(measured)))
        }
    }
}

/// What the user should know of a measured range.
fn note(range: ValueRange) -> String {
    format!(
        "the images have more than 8 bits: {range} become black and white, which holds 99.8 % of the values of the first pair; state other values with --range LOW,HIGH"
    )
}

/// The first of these values at which more than `outside` counts have passed.
fn first_beyond(mut values: impl Iterator<Item = u16>, counts: &[u64], outside: u64) -> Option<u16> {
    let mut passed = 0;
    values.find(|value| {
        passed += counts[usize::from(*value)];
        passed > outside
    })
}

/// An image with 16 bits per channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeepImage {
    size: ImageSize,
    /// 1 for grey, 3 for red, green, blue.
    channels: usize,
    values: Vec<u16>,
}

impl DeepImage {
    /// An image of these values, row by row, with 1 or 3 channels; `None` if their number does not fit.
    pub fn new(size: ImageSize, channels: usize, values: Vec<u16>) -> Option<Self> {
        let pixels = u64::from(size.width) * u64::from(size.height);
        let fits = matches!(channels, 1 | 3) && pixels.checked_mul(channels as u64) == Some(values.len() as u64);
        fits.then_some(Self { size, channels, values })
    }

    /// All values, row by row.
    pub fn values(&self) -> &[u16] {
        &self.values
    }

    /// Whether it has one channel.
    pub fn is_grey(&self) -> bool {
        self.channels == 1
    }

    /// Size of the image.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// The part of the image with this size from this pixel on; black where the image has ended.
    #[must_use]
    pub fn part(&self, (x, y): (u32, u32), size: ImageSize) -> Self {
        let (columns, channels) = (self.size.width as usize, self.channels);
        let row = |row: u32| {
            let first = (row as usize * columns + x as usize) * channels;
            self.values.get(first..first + size.width as usize * channels).unwrap_or_default()
        };
        let mut values: Vec<u16> = (y..y + size.height).flat_map(row).copied().collect();
        values.resize(size.width as usize * size.height as usize * channels, 0);
        Self { size, channels, values }
    }

    /// The image with the first and the third of three channels exchanged; grey stays.
    #[must_use]
    pub fn with_red_and_blue_exchanged(mut self) -> Self {
        if self.channels == 3 {
            self.values.as_chunks_mut::<3>().0.iter_mut().for_each(|pixel| pixel.swap(0, 2));
        }
        self
    }

    /// The values in 8 bits, row by row.
    pub fn bytes(&self, range: ValueRange) -> Vec<u8> {
        let table = range.table();
        self.values.iter().map(|value| table[usize::from(*value)]).collect()
    }

    /// The image in 8 bits; grey has three equal channels.
    pub fn to_rgb(&self, range: ValueRange) -> RgbImage {
        let bytes = self.bytes(range);
        let rgb = match self.channels {
            1 => bytes.into_iter().flat_map(|grey| [grey; 3]).collect(),
            _ => bytes,
        };
        RgbImage::from_raw(self.size.width, self.size.height, rgb).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: &[u16]) -> DeepImage {
        DeepImage::new(ImageSize { width: values.len() as u32, height: 1 }, 1, values.to_vec()).unwrap()
    }

    #[test]
    fn both_ends_become_black_and_white() {
        let range: ValueRange = "100, 610".parse().unwrap();
        assert_eq!(grey(&[0, 100, 101, 102, 355, 610, 65535]).bytes(range), [0, 0, 1, 1, 128, 255, 255]);
        assert_eq!(grey(&[610]).to_rgb(range).into_raw(), [255; 3]);
        let colour = DeepImage::new(ImageSize { width: 1, height: 1 }, 3, vec![100, 355, 610]).unwrap();
        assert_eq!(colour.to_rgb(range).into_raw(), [0, 128, 255]);
        assert_eq!(range.to_string(), "100,610");
    }

    #[test]
    fn images_with_other_numbers_of_values_are_refused() {
        assert!(DeepImage::new(ImageSize { width: 2, height: 2 }, 3, vec![0; 4]).is_none());
        assert!(DeepImage::new(ImageSize { width: 2, height: 2 }, 2, vec![0; 8]).is_none());
    }

    #[test]
    fn the_measured_range_is_that_of_both_images_without_outliers() {
        let mut left: Vec<u16> = (0..3000).map(|k| 1000 + k % 500).collect();
        left[17] = 65535;
        let right: Vec<u16> = (0..3000).map(|k| 1200 + k % 500).collect();
        let range = measured_range(left.iter().chain(&right));
        assert!((1000..=1001).contains(&range.low()) && (1698..=1699).contains(&range.high()), "{range}");
        assert_eq!(grey(&[9; 4]).bytes(measured_range(&[9; 4])), [0; 4]);
        assert_eq!(measured_range(&[65535; 4]), ValueRange::new(65534, 65535).unwrap());
    }
}
