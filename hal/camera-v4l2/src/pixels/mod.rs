//! From the bytes of a driver's buffer to the image of a [`FramePair`](pb3dp_hal_api::FramePair).

mod bayer;
mod jpeg;
mod plain;
mod yuyv;

use image::RgbImage;
use pb3dp_camera_settings::PixelFormat;
use pb3dp_geometry::ImageSize;

pub use yuyv::{YuvKernels, YuvMatrix, YuvRange};

/// What an image of a device looks like in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// How pixels are laid out.
    pub format: PixelFormat,
    /// Of the image.
    pub size: ImageSize,
    /// Bytes from the begin of one row to the begin of the next; not used for `MJPG`.
    pub stride: usize,
    /// What the bytes of `YUYV` mean; not used for the others.
    pub matrix: YuvMatrix,
    /// Which part of 0 to 255 the bytes of `YUYV` use; not used for the others.
    pub range: YuvRange,
}

impl Layout {
    /// Bytes that a whole image has at least; the last row needs no padding behind it.
    pub fn bytes_min(&self) -> usize {
        let rows = self.size.height as usize;
        match self.format.row_bytes(self.size.width) {
            Some(row) if rows > 0 => (rows - 1) * self.stride + row,
            Some(_) => 0,
            None => jpeg::BYTES_MIN,
        }
    }
}

/// Why the bytes of a buffer are no image.
#[derive(Debug, thiserror::Error)]
pub enum PixelError {
    /// Fewer bytes than the image has.
    #[error("{found} bytes are too few: {format} of {width}x{height} pixels has {expected} or more")]
    TooShort {
        /// Bytes that there are.
        found: usize,
        /// Bytes that there should be.
        expected: usize,
        /// Format of the image.
        format: PixelFormat,
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// Rows would overlap.
    #[error("rows that are {stride} bytes apart cannot hold {width} pixels of {format}, which have {row} bytes")]
    Stride {
        /// Bytes from row to row.
        stride: usize,
        /// Bytes of a row.
        row: usize,
        /// Pixels in a row.
        width: u32,
        /// Format of the image.
        format: PixelFormat,
    },
    /// Colour is known for squares of 2x2 pixels only.
    #[error("a Bayer image needs at least 2x2 pixels, this one has {width}x{height}")]
    BayerSize {
        /// Pixels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// The JPEG is of another size.
    #[error("the JPEG has {}x{} pixels, expected are {}x{}", found.0, found.1, expected.0, expected.1)]
    JpegSize {
        /// Width and height that it has.
        found: (usize, usize),
        /// Width and height that it should have.
        expected: (u32, u32),
    },
    /// The JPEG ends before its end marker, or is no JPEG.
    #[error("the JPEG of {bytes} bytes is cut off or damaged: {what}")]
    JpegDamaged {
        /// Bytes that there are.
        bytes: usize,
        /// What was missed.
        what: &'static str,
    },
    /// The JPEG cannot be decoded.
    #[error("the JPEG of {bytes} bytes cannot be decoded: {why}")]
    Jpeg {
        /// Bytes that there are.
        bytes: usize,
        /// What the decoder says.
        why: String,
    },
}

/// Converts images of one device, with memory and tables that are used again and again.
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
    /// If rows would overlap, or a Bayer image is smaller than its pattern.
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

    /// What the images look like in memory.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// The same with other kernels for `YUYV`; they give the same bytes.
    #[must_use]
    pub fn with_kernels(self, kernels: YuvKernels) -> Self {
        Self { kernels, ..self }
    }

    /// Converts one image. A target of the right size keeps its memory, and nothing is taken from the heap for it but by
    /// the decoder of `MJPG`, which makes its tables and rows of blocks anew for each image and has no way to be given them.
    ///
    /// # Errors
    /// If the bytes are too few, or no JPEG of the right size where one is expected; the target may then hold anything.
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
}
