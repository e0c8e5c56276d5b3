//! Pixel formats of cameras: the bytes of a driver buffer or of a recorded message, converted to an RGB image.

mod bayer;
mod jpeg;
mod plain;
mod yuyv;

use image::RgbImage;
use pb3dp_camera_settings::PixelFormat;
use pb3dp_geometry::ImageSize;

pub use yuyv::{YuvKernels, YuvMatrix, YuvRange};

/// Memory layout of a device image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Pixel format.
    pub format: PixelFormat,
    /// Image size.
    pub size: ImageSize,
    /// Bytes from the start of one row to the start of the next; not used for `MJPG`.
    pub stride: usize,
    /// Colour matrix of `YUYV`; not used for other formats.
    pub matrix: YuvMatrix,
    /// Part of 0 to 255 used by `YUYV`; not used for other formats.
    pub range: YuvRange,
}

impl Layout {
    /// Minimum number of bytes of a complete image; the last row needs no padding.
    pub fn bytes_min(&self) -> usize {
        let rows = self.size.height as usize;
        match self.format.row_bytes(self.size.width) {
            Some(row) if rows > 0 => (rows - 1) * self.stride + row,
            Some(_) => 0,
            None => jpeg::BYTES_MIN,
        }
    }
}

/// Why the bytes of a buffer are not a valid image.
#[derive(Debug, thiserror::Error)]
pub enum PixelError {
    /// Fewer bytes than the image needs.
    #[error("{found} bytes are too few; {format} of {width}x{height} pixels needs at least {expected}")]
    TooShort {
        /// Number of bytes found.
        found: usize,
        /// Minimum number of bytes.
        expected: usize,
        /// Format of the image.
        format: PixelFormat,
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Rows would overlap.
    #[error("a stride of {stride} bytes is too short for {width} pixels of {format}, which need {row} bytes")]
    Stride {
        /// Stride, bytes.
        stride: usize,
        /// Bytes of a row.
        row: usize,
        /// Pixels in a row.
        width: u32,
        /// Format of the image.
        format: PixelFormat,
    },
    /// The image is smaller than the Bayer pattern of 2x2 pixels.
    #[error("a Bayer image needs at least 2x2 pixels, this one has {width}x{height}")]
    BayerSize {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The JPEG has another size.
    #[error("the JPEG has {}x{} pixels, expected are {}x{}", found.0, found.1, expected.0, expected.1)]
    JpegSize {
        /// Actual width and height.
        found: (usize, usize),
        /// Expected width and height.
        expected: (u32, u32),
    },
    /// The JPEG ends before its end marker, or is not a JPEG.
    #[error("the JPEG of {bytes} bytes is truncated or damaged; missing or wrong: {what}")]
    JpegDamaged {
        /// Number of bytes.
        bytes: usize,
        /// The missing or wrong part.
        what: &'static str,
    },
    /// The JPEG cannot be decoded.
    #[error("the JPEG of {bytes} bytes cannot be decoded: {why}")]
    Jpeg {
        /// Number of bytes.
        bytes: usize,
        /// The message of the decoder.
        why: String,
    },
}

/// Converts images of one device, with reusable memory and tables.
#[derive(Debug)]
pub struct Converter {
    layout: Layout,
    equations: yuyv::Equations,
    kernels: YuvKernels,
    bayer: bayer::Demosaic,
    jpeg: jpeg::Decoder,
}

impl Converter {
    /// A converter for images of this layout.
    ///
    /// # Errors
    /// The rows would overlap, or a Bayer image is smaller than its pattern.
    pub fn new(layout: Layout) -> Result<Self, PixelError> {
        let Layout { format, size: ImageSize { width, height }, stride, .. } = layout;
        if let Some(row) = format.row_bytes(width).filter(|row| *row > stride) {
            return Err(PixelError::Stride { stride, row, width, format });
        }
        if matches!(format, PixelFormat::Bayer8(_)) && (width < 2 || height < 2) {
            return Err(PixelError::BayerSize { width, height });
        }
        let equations = yuyv::Equations::of(layout.matrix, layout.range);
        Ok(Self {
            layout,
            equations,
            kernels: YuvKernels::best(),
            bayer: bayer::Demosaic::new(width),
            jpeg: jpeg::Decoder::default(),
        })
    }

    /// Memory layout of the images.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Uses other kernels for `YUYV`; they give the same bytes.
    #[must_use]
    pub fn with_kernels(self, kernels: YuvKernels) -> Self {
        Self { kernels, ..self }
    }

    /// Converts one image. A target of the right size keeps its memory, and no heap memory is allocated except by the `MJPG`
    /// decoder, which allocates its tables and rows of blocks for each image.
    ///
    /// # Errors
    /// Too few bytes, or not a JPEG of the right size where one is expected; the target may then contain anything.
    pub fn convert(&mut self, bytes: &[u8], target: &mut RgbImage) -> Result<(), PixelError> {
        let Layout { format, size: ImageSize { width, height }, stride, .. } = self.layout;
        let expected = self.layout.bytes_min();
        if bytes.len() < expected {
            return Err(PixelError::TooShort { found: bytes.len(), expected, format, width, height });
        }
        if target.dimensions() != (width, height) {
            *target = RgbImage::new(width, height);
        }
        let row_bytes = match format.row_bytes(width) {
            Some(row) => row,
            None => return self.jpeg.decode(bytes, target),
        };
        if width == 0 || height == 0 {
            return Ok(());
        }
        if let PixelFormat::Bayer8(order) = format {
            self.bayer.convert(bytes, stride, order, target);
            return Ok(());
        }
        for (source, row) in bytes.chunks(stride).zip(target.chunks_exact_mut(3 * width as usize)) {
            let source = &source[..row_bytes];
            match format {
                PixelFormat::Yuyv => yuyv::convert_row(source, row, &self.equations, self.kernels),
                PixelFormat::Grey => plain::grey(source, row),
                PixelFormat::Rgb24 => row.copy_from_slice(source),
                PixelFormat::Bgr24 => plain::bgr(source, row),
                PixelFormat::Bayer8(_) | PixelFormat::Mjpg => {}
            }
        }
        Ok(())
    }

    /// Copies an image that was converted into `copy`, as the camera has delivered it: rows without padding, or a JPEG file that every decoder
    /// can read. Returns the name of its encoding in ROS 2; empty, with nothing copied, if the converted image has the same bytes, or if no
    /// encoding says how its colours are meant.
    pub fn copy_delivered(&self, bytes: &[u8], copy: &mut Vec<u8>) -> &'static str {
        copy.clear();
        let Layout { format, size, stride, matrix, range } = self.layout;
        match (format, format.row_bytes(size.width)) {
            (PixelFormat::Rgb24 | PixelFormat::Bgr24, _) => return "",
            (PixelFormat::Yuyv, _) if (matrix, range) != (YuvMatrix::Bt601, YuvRange::Limited) => return "",
            (_, Some(row)) => {
                bytes.chunks(stride).take(size.height as usize).for_each(|of| copy.extend_from_slice(&of[..row]))
            }
            (_, None) => jpeg::append_file(bytes, copy),
        }
        format.ros_encoding()
    }
}
