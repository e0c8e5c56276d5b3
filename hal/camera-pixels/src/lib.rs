//! Pixel formats of cameras: the bytes of a driver buffer or of a recorded message, converted to an RGB image.

mod bayer;
mod jpeg;
mod nv12;
mod plain;
mod views;
mod yuyv;

use image::RgbImage;
use pb3dp_camera_settings::{Crop, LayoutError, PixelFormat, ValueRange};
use pb3dp_geometry::ImageSize;

pub use views::ViewsConverter;
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
    /// Colour matrix of `YUYV` and `NV12`; not used for other formats.
    pub matrix: YuvMatrix,
    /// Part of 0 to 255 used by `YUYV` and `NV12`; not used for other formats.
    pub range: YuvRange,
}

impl Layout {
    /// Minimum number of bytes of a complete image; the last row needs no padding.
    pub fn bytes_min(&self) -> usize {
        let rows = self.format.memory_rows(self.size.height);
        match self.format.row_bytes(self.size.width) {
            Some(row) if rows > 0 => (rows - 1) * self.stride + row,
            Some(_) => 0,
            None => jpeg::BYTES_MIN,
        }
    }
}

/// The part of a device image that becomes one image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct View {
    /// First column and row, and size, in the image of the device.
    pub part: Crop,
    /// Which of two interleaved images it is; not used for formats other than `Y8I`.
    pub lane: Lane,
}

/// One of two interleaved images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lane {
    /// The first one: of `Y8I` that of the left sensor.
    First,
    /// The second one.
    Second,
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
    /// A part of the image that is not inside, or that the format cannot be cut at.
    #[error("{0}")]
    Part(LayoutError),
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

/// Converts images of one device, or a part of them, with reusable memory and tables.
#[derive(Debug)]
pub struct Converter {
    layout: Layout,
    view: View,
    equations: yuyv::Equations,
    kernels: YuvKernels,
    bayer: bayer::Demosaic,
    nv12: nv12::Rows,
    jpeg: jpeg::Decoder,
    /// A decoded JPEG of which only a part is used.
    whole: RgbImage,
    /// The 8-bit value of each 16-bit value; empty for formats with 8 bits.
    shades: Vec<u8>,
}

impl Converter {
    /// A converter for images of this layout. Of `Y8I` it takes the left one.
    ///
    /// # Errors
    /// The rows would overlap, or a Bayer image is smaller than its pattern.
    pub fn new(layout: Layout) -> Result<Self, PixelError> {
        Self::of(layout, View { part: Crop::whole(layout.size), lane: Lane::First })
    }

    /// A converter for a part of images of this layout.
    ///
    /// # Errors
    /// As [`Self::new`]; the part is empty or not inside of the image, or begins within a group of pixels that share their colour.
    pub fn of_view(layout: Layout, view: View) -> Result<Self, PixelError> {
        view.part.check(layout.size, layout.format).map_err(PixelError::Part)?;
        Self::of(layout, view)
    }

    fn of(layout: Layout, view: View) -> Result<Self, PixelError> {
        let Layout { format, size: ImageSize { width, .. }, stride, .. } = layout;
        if let Some(row) = format.row_bytes(width).filter(|row| *row > stride) {
            return Err(PixelError::Stride { stride, row, width, format });
        }
        let ImageSize { width, height } = view.part.size;
        if matches!(format, PixelFormat::Bayer8(_)) && (width < 2 || height < 2) {
            return Err(PixelError::BayerSize { width, height });
        }
        Ok(Self {
            layout,
            view,
            equations: yuyv::Equations::of(layout.matrix, layout.range),
            kernels: YuvKernels::best(),
            bayer: bayer::Demosaic::new(width),
            nv12: nv12::Rows::new(width),
            jpeg: jpeg::Decoder::default(),
            whole: RgbImage::default(),
            shades: format.full_range().map(ValueRange::table).unwrap_or_default(),
        })
    }

    /// Memory layout of the images.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Size of the converted images, pixels.
    pub fn size(&self) -> ImageSize {
        self.view.part.size
    }

    /// Uses other kernels for `YUYV` and `NV12`; they give the same bytes.
    #[must_use]
    pub fn with_kernels(self, kernels: YuvKernels) -> Self {
        Self { kernels, ..self }
    }

    /// Uses these values as black and white for formats with more than 8 bits; values outside are black or white too. Not used for
    /// other formats.
    #[must_use]
    pub fn with_values(self, values: Option<ValueRange>) -> Self {
        let values = values.filter(|_| !self.shades.is_empty());
        Self { shades: values.map_or(self.shades, ValueRange::table), ..self }
    }

    /// Converts one image. A target of the right size keeps its memory, and no heap memory is allocated except by the `MJPG`
    /// decoder, which allocates its tables and rows of blocks for each image.
    ///
    /// # Errors
    /// Too few bytes, or not a JPEG of the right size where one is expected; the target may then contain anything.
    pub fn convert(&mut self, bytes: &[u8], target: &mut RgbImage) -> Result<(), PixelError> {
        self.check_length(bytes)?;
        if self.layout.format == PixelFormat::Mjpg {
            if self.is_whole() {
                resize(target, self.layout.size);
                return self.jpeg.decode(bytes, target);
            }
            let mut whole = std::mem::take(&mut self.whole);
            resize(&mut whole, self.layout.size);
            let decoded = self.jpeg.decode(bytes, &mut whole);
            self.copy_part(&whole, target);
            self.whole = whole;
            return decoded;
        }
        resize(target, self.size());
        if target.is_empty() {
            return Ok(());
        }
        self.convert_rows(bytes, target);
        Ok(())
    }

    /// Whether the whole image of the device is used.
    fn is_whole(&self) -> bool {
        self.view.part == Crop::whole(self.layout.size)
    }

    fn check_length(&self, bytes: &[u8]) -> Result<(), PixelError> {
        let Layout { format, size: ImageSize { width, height }, .. } = self.layout;
        let expected = self.layout.bytes_min();
        if bytes.len() < expected {
            return Err(PixelError::TooShort { found: bytes.len(), expected, format, width, height });
        }
        Ok(())
    }

    /// Copies the part from a decoded image of the device.
    fn copy_part(&self, whole: &RgbImage, target: &mut RgbImage) {
        let Crop { left, top, size } = self.view.part;
        resize(target, size);
        let (from, row) = (3 * left as usize, 3 * size.width as usize);
        if row == 0 {
            return;
        }
        let rows = whole.chunks_exact(3 * self.layout.size.width as usize).skip(top as usize);
        for (target, source) in target.chunks_exact_mut(row).zip(rows) {
            target.copy_from_slice(&source[from..from + row]);
        }
    }

    /// Position of the first byte of the part, and bytes of one of its rows. A part begins at a whole group of pixels.
    fn first_and_row(&self) -> (usize, usize) {
        let Crop { left, top, size } = self.view.part;
        let row = |width| self.layout.format.row_bytes(width).unwrap_or(0);
        (top as usize * self.layout.stride + row(left), row(size.width))
    }

    /// Converts an image that has rows, and enough of them.
    fn convert_rows(&mut self, bytes: &[u8], target: &mut RgbImage) {
        let Layout { format, stride, .. } = self.layout;
        let (first, row_bytes) = self.first_and_row();
        let part = &bytes[first..];
        if let PixelFormat::Bayer8(order) = format {
            self.bayer.convert(part, stride, order, target);
            return;
        }
        let lane = usize::from(self.view.lane == Lane::Second);
        let row_length = 3 * self.view.part.size.width as usize;
        for (number, (source, row)) in part.chunks(stride).zip(target.chunks_exact_mut(row_length)).enumerate() {
            let source = &source[..row_bytes];
            match format {
                PixelFormat::Yuyv => yuyv::convert_row(source, row, &self.equations, self.kernels),
                PixelFormat::Grey => plain::grey(source, row),
                PixelFormat::Y8i => plain::grey_of_two(&source[lane..], row),
                PixelFormat::Y10 | PixelFormat::Y12 | PixelFormat::Y16 => plain::deep_grey(source, row, &self.shades),
                PixelFormat::Rgb24 => row.copy_from_slice(source),
                PixelFormat::Bgr24 => plain::bgr(source, row),
                PixelFormat::Nv12 => {
                    let chroma = &bytes[self.chroma_at(number)..][..row_bytes];
                    let luma = &source[..self.view.part.size.width as usize];
                    self.nv12.convert((luma, chroma), row, &self.equations, self.kernels);
                }
                PixelFormat::Bayer8(_) | PixelFormat::Mjpg => {}
            }
        }
    }

    /// Position of the chroma of a row of the part: the plane begins after the rows of luminance, padded or not.
    fn chroma_at(&self, row: usize) -> usize {
        let Crop { left, top, .. } = self.view.part;
        let row = self.layout.size.height as usize + (top as usize + row) / 2;
        row * self.layout.stride + left as usize
    }

    /// Copies an image that was converted into `copy`, as the camera has delivered it: rows without padding, or a JPEG file that every decoder
    /// can read. Returns the name of its encoding in ROS 2; empty, with nothing copied, if the converted image has the same bytes, if no
    /// encoding says how its colours are meant, or if it is a part of a JPEG.
    pub fn copy_delivered(&self, bytes: &[u8], copy: &mut Vec<u8>) -> &'static str {
        copy.clear();
        let Layout { format, stride, matrix, range, .. } = self.layout;
        let (first, row) = self.first_and_row();
        let part = bytes.get(first..).unwrap_or_default();
        let rows = part.chunks(stride.max(1)).take(self.size().height as usize).map(|of| &of[..row]);
        match format {
            PixelFormat::Rgb24 | PixelFormat::Bgr24 | PixelFormat::Nv12 => return "",
            PixelFormat::Yuyv if (matrix, range) != (YuvMatrix::Bt601, YuvRange::Limited) => return "",
            PixelFormat::Mjpg if !self.is_whole() => return "",
            PixelFormat::Mjpg => jpeg::append_file(bytes, copy),
            PixelFormat::Y8i => {
                let lane = usize::from(self.view.lane == Lane::Second);
                rows.for_each(|row| copy.extend(row.as_chunks::<2>().0.iter().map(|pair| pair[lane])));
            }
            _ => rows.for_each(|row| copy.extend_from_slice(row)),
        }
        format.ros_encoding()
    }
}

/// Makes an image of this size; its content may be anything.
fn resize(image: &mut RgbImage, ImageSize { width, height }: ImageSize) {
    if image.dimensions() != (width, height) {
        *image = RgbImage::new(width, height);
    }
}
