//! A borrowed RGB image in the memory of the caller.

use image::{Rgb, RgbImage};

/// An RGB image that the estimators read and do not own: one byte per channel, red, green, blue, row after row without gaps.
///
/// An [`RgbImage`] converts by `into()`; memory of another library by [`RgbView::new`]. Nothing is copied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RgbView<'a> {
    width: u32,
    height: u32,
    raw: &'a [u8],
}

impl<'a> RgbView<'a> {
    /// An image of this size in `raw`; `None` if the number of bytes does not fit.
    pub fn new(width: u32, height: u32, raw: &'a [u8]) -> Option<Self> {
        let bytes = u64::from(width).checked_mul(u64::from(height))?.checked_mul(3)?;
        (bytes == raw.len() as u64).then_some(Self { width, height, raw })
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

    /// All bytes, row after row.
    pub fn as_raw(&self) -> &'a [u8] {
        self.raw
    }

    /// The pixel in column `x` and row `y`.
    ///
    /// # Panics
    /// A pixel outside the image.
    pub fn get_pixel(&self, x: u32, y: u32) -> Rgb<u8> {
        assert!(x < self.width, "column {x} of an image with {} columns", self.width);
        let first = (y as usize * self.width as usize + x as usize) * 3;
        Rgb([self.raw[first], self.raw[first + 1], self.raw[first + 2]])
    }
}

impl<'a> From<&'a RgbImage> for RgbView<'a> {
    fn from(image: &'a RgbImage) -> Self {
        Self { width: image.width(), height: image.height(), raw: image.as_raw() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_view_shows_the_pixels_of_its_image_without_a_copy() {
        let image = RgbImage::from_fn(5, 3, |x, y| Rgb([x as u8, y as u8, 7]));
        let view = RgbView::from(&image);
        assert_eq!((view.dimensions(), view.get_pixel(4, 2)), ((5, 3), Rgb([4, 2, 7])));
        assert_eq!(view.as_raw().as_ptr(), image.as_raw().as_ptr());
        assert_eq!(RgbView::new(5, 3, image.as_raw()), Some(view));
        assert_eq!(RgbView::new(5, 4, image.as_raw()), None);
        assert_eq!(RgbView::new(u32::MAX, u32::MAX, image.as_raw()), None);
    }
}
