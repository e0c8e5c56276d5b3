//! Maps between the images of cameras with one optical centre: undistortion and rectification.
//!
//! [`PixelMap`] evaluates single pixels; [`RemapTable`] stores the map of a whole image.
//! Images are byte slices, rows from top to bottom without padding, with one byte per pixel or three (interleaved RGB).

use nalgebra::{Matrix3, Point3, Vector2};

use crate::camera::{Camera, ImageSize, Pinhole};
use crate::frames::Frame;
use crate::pose::Pose;

/// Steps per pixel of the stored source coordinates.
const STEPS: u32 = 256;
/// Marks destination pixels without a source.
const NO_SOURCE: u32 = u32::MAX;

/// Map from the image of a distortion-free camera to that of another camera. The other camera has the same optical centre, but may
/// look in another direction and have any lens. The map stores no table: its cost depends only on the number of pixels asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelMap {
    source: Camera,
    destination: Camera,
    source_from_destination: Matrix3<f64>,
}

impl PixelMap {
    /// For each pixel of `destination` the map gives the pixel of `source` that sees the same direction. The distortion of `destination`
    /// is ignored, and only the rotation of `destination_from_source` is used.
    pub fn rotate<To: Frame, From: Frame>(
        source: &Camera,
        destination: &Camera,
        destination_from_source: &Pose<To, From>,
    ) -> Self {
        let source_from_destination = destination_from_source.rotation_matrix().transpose();
        Self { source: *source, destination: destination.undistorted(), source_from_destination }
    }

    /// Size of the destination image.
    pub fn size(&self) -> ImageSize {
        self.destination.size()
    }

    /// Size of the source image.
    pub fn source_size(&self) -> ImageSize {
        self.source.size()
    }

    /// The intrinsics of the destination.
    pub(crate) fn destination_pinhole(&self) -> &Pinhole {
        self.destination.pinhole()
    }

    /// The map with another destination in the same direction, whose distortion is ignored.
    pub(crate) fn with_destination(&self, destination: &Camera) -> Self {
        Self { destination: destination.undistorted(), ..*self }
    }

    /// The source pixel of a destination pixel, which may be outside the source image; `None` if the source camera cannot
    /// image that direction.
    pub fn source(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let ray = self.destination.pinhole().normalized_from_pixel(pixel).push(1.0);
        let source = self.source.project(&Point3::from(self.source_from_destination * ray))?;
        (source.x.is_finite() && source.y.is_finite()).then_some(source)
    }

    /// The destination pixel of a source pixel: the inverse of [`Self::source`]. `None` if the lens model has no ray there, or
    /// if the ray does not meet the destination's image plane.
    pub fn destination(&self, source_px: &Vector2<f64>) -> Option<Vector2<f64>> {
        let ray = self.source_from_destination.transpose() * self.source.unproject(source_px).ok()?;
        let pixel = self.destination.project(&Point3::from(ray))?;
        (pixel.x.is_finite() && pixel.y.is_finite()).then_some(pixel)
    }

    /// The same map with both images reduced: each pixel is the mean of a square of `scale` x `scale` pixels; incomplete squares at the edges
    /// are left out.
    pub fn reduced(&self, scale: u32) -> Self {
        Self { source: self.source.reduced(scale), destination: self.destination.reduced(scale), ..*self }
    }

    /// The map of the whole image, in memory.
    pub fn table(&self) -> RemapTable {
        RemapTable::from_fn(self.size(), self.source_size(), |pixel| self.source(pixel))
    }
}

/// Remap table: for each pixel of a destination image its position in the source image, to 1/256 of a pixel.
///
/// Destination pixels whose source is outside the source image, or that the lens cannot image, are *invalid*: the remap
/// functions set them to 0, and [`RemapTable::valid_mask`] marks them.
#[derive(Clone, Debug, PartialEq)]
pub struct RemapTable {
    size: ImageSize,
    source_size: ImageSize,
    taps: Vec<Tap>,
}

/// Upper left of the four source pixels, and the weights of right and lower neighbours in 1/256.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Tap {
    index: u32,
    right: u16,
    below: u16,
}

/// Why an image could not be remapped.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RemapError {
    /// The size of the source image differs from that of the table.
    #[error(
        "the source image has {}x{} pixels, but the table was made for {}x{}: use the calibration of this camera mode",
        .actual.width, .actual.height, .expected.width, .expected.height
    )]
    SourceSize {
        /// Size of the image.
        actual: ImageSize,
        /// Size of the table's source.
        expected: ImageSize,
    },
    /// A buffer has the wrong length.
    #[error("the {buffer} buffer holds {actual} bytes, {expected} are needed")]
    Length {
        /// `source` or `destination`.
        buffer: &'static str,
        /// Its length.
        actual: usize,
        /// The required length.
        expected: usize,
    },
}

impl RemapTable {
    /// Creates a table from any map: `source_of` gives the source pixel of a destination pixel, or `None`.
    ///
    /// If source images have fewer than two columns or two rows, every pixel is invalid.
    pub fn from_fn(
        size: ImageSize,
        source_size: ImageSize,
        mut source_of: impl FnMut(&Vector2<f64>) -> Option<Vector2<f64>>,
    ) -> Self {
        let mut taps = Vec::with_capacity(pixels(size));
        for v in 0..size.height {
            for u in 0..size.width {
                let source = source_of(&Vector2::new(f64::from(u), f64::from(v)));
                taps.push(source.map_or(Tap::INVALID, |source| Tap::at(&source, source_size)));
            }
        }
        Self { size, source_size, taps }
    }

    /// The table that undistorts images of `camera`; the destination is the image of [`Camera::undistorted`].
    pub fn undistort(camera: &Camera) -> Self {
        let ideal = camera.undistorted();
        Self::from_fn(ideal.size(), camera.size(), |pixel| {
            let ray = ideal.pinhole().normalized_from_pixel(pixel);
            camera.project(&Point3::new(ray.x, ray.y, 1.0))
        })
    }

    /// The table of [`PixelMap::rotate`]. It converts an image of `source` into the image that the pinhole of `destination` would take
    /// from the same optical centre.
    pub fn rotate<To: Frame, From: Frame>(
        source: &Camera,
        destination: &Camera,
        destination_from_source: &Pose<To, From>,
    ) -> Self {
        PixelMap::rotate(source, destination, destination_from_source).table()
    }

    /// Size of the destination image.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Size of the source image.
    pub fn source_size(&self) -> ImageSize {
        self.source_size
    }

    /// The source pixel of destination pixel `(u, v)` as stored, to 1/256 pixel; `None` if it is invalid or outside.
    pub fn source(&self, u: u32, v: u32) -> Option<Vector2<f64>> {
        if u >= self.size.width || v >= self.size.height {
            return None;
        }
        let tap = self.taps.get(v as usize * self.size.width as usize + u as usize)?;
        let steps = f64::from(STEPS);
        (tap.index != NO_SOURCE).then(|| {
            let (column, row) = (tap.index % self.source_size.width, tap.index / self.source_size.width);
            Vector2::new(
                f64::from(column) + f64::from(tap.right) / steps,
                f64::from(row) + f64::from(tap.below) / steps,
            )
        })
    }

    /// Mask of the valid destination pixels: 255 if a pixel has a source, 0 otherwise; one byte per pixel.
    pub fn valid_mask(&self) -> Vec<u8> {
        self.taps.iter().map(|tap| if tap.index == NO_SOURCE { 0 } else { 255 }).collect()
    }

    /// Resamples an interleaved RGB image, bilinear.
    ///
    /// # Errors
    /// A source with a size other than the table's, or a buffer of the wrong length; `destination` is then unchanged.
    pub fn remap_rgb(&self, source: &[u8], source_size: ImageSize, destination: &mut [u8]) -> Result<(), RemapError> {
        self.remap_bilinear::<3>(source, source_size, destination)
    }

    /// Resamples an image of one byte per pixel, bilinear.
    ///
    /// # Errors
    /// As [`RemapTable::remap_rgb`].
    pub fn remap_gray(&self, source: &[u8], source_size: ImageSize, destination: &mut [u8]) -> Result<(), RemapError> {
        self.remap_bilinear::<1>(source, source_size, destination)
    }

    /// Resamples a mask (one byte per pixel): the nearest source pixel, no new values.
    ///
    /// # Errors
    /// As [`RemapTable::remap_rgb`].
    pub fn remap_mask(&self, source: &[u8], source_size: ImageSize, destination: &mut [u8]) -> Result<(), RemapError> {
        self.check::<1>(source, source_size, destination)?;
        let stride = self.source_size.width as usize;
        for (pixel, tap) in destination.iter_mut().zip(&self.taps) {
            *pixel = if tap.index == NO_SOURCE {
                0
            } else {
                let right = usize::from(u32::from(tap.right) >= STEPS / 2);
                let below = usize::from(u32::from(tap.below) >= STEPS / 2);
                source[tap.index as usize + right + below * stride]
            };
        }
        Ok(())
    }

    fn remap_bilinear<const CHANNELS: usize>(
        &self,
        source: &[u8],
        source_size: ImageSize,
        destination: &mut [u8],
    ) -> Result<(), RemapError> {
        self.check::<CHANNELS>(source, source_size, destination)?;
        let stride = self.source_size.width as usize * CHANNELS;
        let (pixels, _) = destination.as_chunks_mut::<CHANNELS>();
        for (pixel, tap) in pixels.iter_mut().zip(&self.taps) {
            if tap.index == NO_SOURCE {
                *pixel = [0; CHANNELS];
                continue;
            }
            let start = tap.index as usize * CHANNELS;
            // One bounds check per row; the two pixels of a row are adjacent.
            let above = &source[start..start + 2 * CHANNELS];
            let below = &source[start + stride..start + stride + 2 * CHANNELS];
            let (right, down) = (u32::from(tap.right), u32::from(tap.below));
            for channel in 0..CHANNELS {
                let row =
                    |row: &[u8]| u32::from(row[channel]) * (STEPS - right) + u32::from(row[channel + CHANNELS]) * right;
                let sum = row(above) * (STEPS - down) + row(below) * down;
                pixel[channel] = ((sum + STEPS * STEPS / 2) / (STEPS * STEPS)) as u8;
            }
        }
        Ok(())
    }

    fn check<const CHANNELS: usize>(
        &self,
        source: &[u8],
        source_size: ImageSize,
        destination: &[u8],
    ) -> Result<(), RemapError> {
        if source_size != self.source_size {
            return Err(RemapError::SourceSize { actual: source_size, expected: self.source_size });
        }
        let buffers = [("source", source.len(), self.source_size), ("destination", destination.len(), self.size)];
        for (buffer, actual, size) in buffers {
            let expected = pixels(size) * CHANNELS;
            if actual != expected {
                return Err(RemapError::Length { buffer, actual, expected });
            }
        }
        Ok(())
    }
}

impl Tap {
    const INVALID: Self = Self { index: NO_SOURCE, right: 0, below: 0 };

    /// The tap at a source position; invalid outside the centres of the outermost pixels.
    fn at(source: &Vector2<f64>, size: ImageSize) -> Self {
        match (split(source.x, size.width), split(source.y, size.height)) {
            (Some((column, right)), Some((row, below))) => Self { index: row * size.width + column, right, below },
            _ => Self::INVALID,
        }
    }
}

/// Integer pixel and 1/256 fraction of a coordinate, such that the next pixel exists too.
fn split(coordinate: f64, length: u32) -> Option<(u32, u16)> {
    let last = length.checked_sub(1)?;
    // Rounding to the grid may move a coordinate onto the edge, so the test follows it.
    let steps = (coordinate * f64::from(STEPS)).round();
    if last == 0 || !(steps >= 0.0 && steps <= f64::from(last) * f64::from(STEPS)) {
        return None;
    }
    let steps = steps as u32;
    let whole = (steps / STEPS).min(last - 1);
    Some((whole, (steps - whole * STEPS) as u16))
}

fn pixels(size: ImageSize) -> usize {
    size.width as usize * size.height as usize
}
