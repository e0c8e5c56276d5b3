//! Image files: loading with errors that name the file, and encoding.
//!
//! PNG, JPEG, TIFF, BMP, PGM and PPM, WebP. All images in memory are 8-bit sRGB without alpha. Grey images are expanded to three equal
//! channels. Images with 16 bits per channel need a [`ValueRange`]. Transparent pixels are refused, because they have no colour.

use std::fmt;
use std::io::{BufReader, Cursor};
use std::path::{Path, PathBuf};

use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{DynamicImage, ImageEncoder, ImageFormat, ImageReader, RgbImage};
use pb3dp_geometry::ImageSize;

use crate::regular_file::{RefusedFile, open_regular, read_regular};
use crate::value_range::{DeepImage, ValueRange, range_of_pair};

/// Largest number of pixels of an image that is read. Chosen: 300 MB in memory; sensors of machine vision have up to 65 million pixels.
pub const PIXELS_MAX: u64 = 100_000_000;

/// Largest image file that is read, bytes. Chosen: [`PIXELS_MAX`] pixels of four channels with 16 bits need 0.8 GB without compression.
pub const FILE_MAX_BYTES: u64 = 1 << 30;

/// Formats of images that are read.
const FORMATS: [ImageFormat; 6] =
    [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::Tiff, ImageFormat::Bmp, ImageFormat::Pnm, ImageFormat::WebP];
/// Extensions of their file names, in lower case.
pub const EXTENSIONS: [&str; 10] = ["png", "jpg", "jpeg", "tif", "tiff", "bmp", "pgm", "ppm", "pnm", "webp"];

/// Why an image file cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("image {}: {problem}", file.display())]
pub struct ImageFileError {
    /// The file.
    pub file: PathBuf,
    /// The failed check, and what to do.
    pub problem: ImageProblem,
    #[source]
    source: Option<Box<dyn std::error::Error + Send + Sync>>,
}

/// The check that an image file failed.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ImageProblem {
    /// The file does not exist.
    Missing,
    /// The path is a folder.
    Folder,
    /// The file is a named pipe, for example, or too large.
    Refused(RefusedFile),
    /// The file cannot be read or written.
    Io,
    /// No image in a known format.
    UnknownFormat,
    /// The content ends early or is damaged.
    Damaged,
    /// The size is not the expected one.
    Size {
        /// Size of the image.
        found: ImageSize,
        /// Required size.
        expected: ImageSize,
        /// Source of the requirement: `the calibration`, `left.png`.
        because_of: String,
    },
    /// More pixels than [`PIXELS_MAX`].
    TooLarge {
        /// Size of the image.
        found: ImageSize,
    },
    /// More than 8 bits per channel.
    Depth {
        /// The pixel format found.
        found: String,
    },
    /// Some pixels are not opaque.
    Transparent,
    /// Not the 16-bit grey image that a disparity map must be.
    NotDisparity {
        /// The pixel format found.
        found: String,
    },
}

impl fmt::Display for ImageProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing => write!(f, "no such file; check the name and the folder"),
            Self::Folder => write!(f, "is a folder; name the image file in it"),
            Self::Refused(refused) => refused.fmt(f),
            Self::Io => write!(f, "cannot be read or written; check permissions and free space"),
            Self::UnknownFormat => write!(f, "not PNG, JPEG, TIFF, BMP, PGM, PPM or WebP; convert it"),
            Self::Damaged => write!(f, "truncated or damaged; copy or record it again"),
            Self::Size { found, expected, because_of } => write!(
                f,
                "is {}x{} pixels, but {because_of} has {}x{}; use images of one size, or the calibration of this size",
                found.width, found.height, expected.width, expected.height
            ),
            Self::TooLarge { found } => write!(
                f,
                "too large: {}x{} pixels, at most {} million are read; scale the images and the calibration by the same factor",
                found.width,
                found.height,
                PIXELS_MAX / 1_000_000
            ),
            Self::Depth { found } => {
                write!(f, "has pixels of type {found}; images with 8 bits per channel are needed here")
            }
            Self::Transparent => write!(f, "has transparent pixels, which have no colour; remove the alpha channel"),
            Self::NotDisparity { found } => {
                write!(f, "has pixels of type {found}; a disparity map is a 16-bit grey PNG of 64 times the disparity")
            }
        }
    }
}

impl ImageFileError {
    fn new(file: &Path, problem: ImageProblem) -> Self {
        Self { file: file.to_owned(), problem, source: None }
    }

    fn caused_by(
        file: &Path,
        problem: ImageProblem,
        source: impl Into<Box<dyn std::error::Error + Send + Sync>>,
    ) -> Self {
        Self { file: file.to_owned(), problem, source: Some(source.into()) }
    }

    fn io(file: &Path, source: std::io::Error) -> Self {
        match source.kind() {
            // The system error would only repeat the message.
            std::io::ErrorKind::NotFound => Self::new(file, ImageProblem::Missing),
            std::io::ErrorKind::IsADirectory => Self::new(file, ImageProblem::Folder),
            _ => match RefusedFile::of(&source) {
                Some(refused) => Self::new(file, ImageProblem::Refused(refused.clone())),
                None => Self::caused_by(file, ImageProblem::Io, source),
            },
        }
    }
}

/// Size of an image.
pub fn size_of(image: &RgbImage) -> ImageSize {
    ImageSize { width: image.width(), height: image.height() }
}

/// An image as its file has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StoredImage {
    /// 8 bits per channel.
    Rgb(RgbImage),
    /// 16 bits per channel.
    Deep(DeepImage),
}

impl StoredImage {
    /// Loads an image file.
    ///
    /// # Errors
    /// A missing, unreadable, damaged or truncated file, transparent pixels, numbers that are no integers.
    pub fn load(file: &Path) -> Result<Self, ImageFileError> {
        Self::of_pixels(file, decode(file)?)
    }

    /// Reads an image file in memory; `name` stands for it in messages.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn parse(name: &Path, bytes: &[u8]) -> Result<Self, ImageFileError> {
        Self::of_pixels(name, decode_bytes(name, bytes)?)
    }

    fn of_pixels(file: &Path, image: DynamicImage) -> Result<Self, ImageFileError> {
        let is_opaque = match &image {
            DynamicImage::ImageLumaA8(pixels) => pixels.pixels().all(|p| p.0[1] == u8::MAX),
            DynamicImage::ImageRgba8(pixels) => pixels.pixels().all(|p| p.0[3] == u8::MAX),
            DynamicImage::ImageLumaA16(pixels) => pixels.pixels().all(|p| p.0[1] == u16::MAX),
            DynamicImage::ImageRgba16(pixels) => pixels.pixels().all(|p| p.0[3] == u16::MAX),
            _ => true,
        };
        if !is_opaque {
            return Err(ImageFileError::new(file, ImageProblem::Transparent));
        }
        let size = ImageSize { width: image.width(), height: image.height() };
        let deep = |channels, values| DeepImage::new(size, channels, values).map(Self::Deep);
        let stored = match image {
            DynamicImage::ImageRgb8(rgb) => Some(Self::Rgb(rgb)),
            DynamicImage::ImageLuma8(_) | DynamicImage::ImageLumaA8(_) | DynamicImage::ImageRgba8(_) => {
                Some(Self::Rgb(image.into_rgb8()))
            }
            DynamicImage::ImageLuma16(_) | DynamicImage::ImageLumaA16(_) => deep(1, image.into_luma16().into_raw()),
            DynamicImage::ImageRgb16(_) | DynamicImage::ImageRgba16(_) => deep(3, image.into_rgb16().into_raw()),
            other => {
                let found = format!("{:?}", other.color());
                return Err(ImageFileError::new(file, ImageProblem::Depth { found }));
            }
        };
        stored.ok_or_else(|| ImageFileError::new(file, ImageProblem::Damaged))
    }

    /// Size of the image.
    pub fn size(&self) -> ImageSize {
        match self {
            Self::Rgb(image) => size_of(image),
            Self::Deep(image) => image.size(),
        }
    }

    /// The part of the image with this size from this pixel on; black where the image has ended.
    #[must_use]
    pub fn part(&self, (x, y): (u32, u32), size: ImageSize) -> Self {
        match self {
            Self::Rgb(image) => Self::Rgb(image::imageops::crop_imm(image, x, y, size.width, size.height).to_image()),
            Self::Deep(image) => Self::Deep(image.part((x, y), size)),
        }
    }

    /// Both images of a pair in 8 bits. Images with more bits need a range: without one it is measured on this pair and kept for the next
    /// ones, with a line for the user.
    pub fn to_rgb_pair(pair: [Self; 2], range: &mut Option<ValueRange>) -> ([RgbImage; 2], Option<String>) {
        let deep: Vec<&DeepImage> = pair.iter().filter_map(Self::deep).collect();
        let (range, note) = range_of_pair(range, &deep);
        let shallow = |image: Self| match image {
            Self::Rgb(image) => image,
            Self::Deep(image) => image.to_rgb(range),
        };
        (pair.map(shallow), note)
    }

    /// Whether it has more than 8 bits per channel.
    pub fn is_deep(&self) -> bool {
        self.deep().is_some()
    }

    fn deep(&self) -> Option<&DeepImage> {
        match self {
            Self::Deep(image) => Some(image),
            Self::Rgb(_) => None,
        }
    }
}

/// Loads an image file as 8-bit RGB.
///
/// # Errors
/// As [`StoredImage::load`], and more than 8 bits per channel.
pub fn load_rgb(file: &Path) -> Result<RgbImage, ImageFileError> {
    match StoredImage::load(file)? {
        StoredImage::Rgb(image) => Ok(image),
        StoredImage::Deep(image) => {
            let found = if image.is_grey() { "L16" } else { "Rgb16" }.to_owned();
            Err(ImageFileError::new(file, ImageProblem::Depth { found }))
        }
    }
}

/// As [`load_rgb`], with a check of the size; `because_of` names the source of the requirement in the message.
///
/// # Errors
/// As [`load_rgb`], and [`ImageProblem::Size`].
pub fn load_rgb_of_size(file: &Path, expected: ImageSize, because_of: &str) -> Result<RgbImage, ImageFileError> {
    let image = load_rgb(file)?;
    check_size(file, size_of(&image), (expected, because_of))?;
    Ok(image)
}

/// Checks the size of the image in a file before it is decoded: a large image costs no time.
///
/// # Errors
/// A file that is not regular or has no such image, and [`ImageProblem::Size`], with `because_of` as the source of the requirement.
pub fn check_header(file: &Path, expected: ImageSize, because_of: &str) -> Result<(), ImageFileError> {
    let header = open_regular(file).and_then(|opened| ImageReader::new(BufReader::new(opened)).with_guessed_format());
    let header = header.map_err(|error| ImageFileError::io(file, error))?;
    // Every other problem of the header is found when the image is decoded.
    let Ok((width, height)) = header.into_dimensions() else { return Ok(()) };
    check_size(file, ImageSize { width, height }, (expected, because_of))
}

/// Checks the size of the image in a file.
///
/// # Errors
/// [`ImageProblem::Size`], with `because_of` as the source of the requirement.
pub fn check_size(
    file: &Path,
    found: ImageSize,
    (expected, because_of): (ImageSize, &str),
) -> Result<(), ImageFileError> {
    if found == expected {
        return Ok(());
    }
    Err(ImageFileError::new(file, ImageProblem::Size { found, expected, because_of: because_of.to_owned() }))
}

/// Size of the image in an image file in memory, from its header; `None` if it has none.
pub fn size_in_header(bytes: &[u8]) -> Option<ImageSize> {
    let header = ImageReader::new(Cursor::new(bytes)).with_guessed_format().ok()?;
    header.into_dimensions().ok().map(|(width, height)| ImageSize { width, height })
}

fn decode(file: &Path) -> Result<DynamicImage, ImageFileError> {
    let bytes = read_regular(file, FILE_MAX_BYTES).map_err(|e| ImageFileError::io(file, e))?;
    decode_bytes(file, &bytes)
}

fn decode_bytes(file: &Path, bytes: &[u8]) -> Result<DynamicImage, ImageFileError> {
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| ImageFileError::io(file, e))?;
    match reader.format() {
        None if bytes.is_empty() => return Err(ImageFileError::new(file, ImageProblem::Damaged)),
        // The decoder fills missing parts of a JPEG with grey; such an image must be refused.
        Some(ImageFormat::Jpeg) if !jpeg_is_complete(bytes) => {
            return Err(ImageFileError::new(file, ImageProblem::Damaged));
        }
        Some(format) if FORMATS.contains(&format) => {}
        _ => return Err(ImageFileError::new(file, ImageProblem::UnknownFormat)),
    }
    // Every other problem of the header is found by the decoder.
    match size_in_header(bytes) {
        Some(found) if u64::from(found.width) * u64::from(found.height) > PIXELS_MAX => {
            return Err(ImageFileError::new(file, ImageProblem::TooLarge { found }));
        }
        _ => {}
    }
    reader.decode().map_err(|e| ImageFileError::caused_by(file, ImageProblem::Damaged, e))
}

/// Whether the markers of a JPEG file lead from its start (SOI) through at least one scan to its end (EOI); ITU-T T.81, annex B.
fn jpeg_is_complete(bytes: &[u8]) -> bool {
    let mut at = 2;
    let mut scans = 0;
    while at + 1 < bytes.len() {
        if bytes[at] != 0xFF {
            // Entropy-coded data of a scan; between other segments it means damage.
            if scans == 0 {
                return false;
            }
            at += 1;
            continue;
        }
        match bytes[at + 1] {
            0xD9 => return scans > 0,
            // A stuffed zero byte and restart markers belong to the scan; fill bytes may precede any marker.
            0x00 | 0xD0..=0xD7 => at += 2,
            0xFF => at += 1,
            marker => {
                scans += usize::from(marker == 0xDA);
                let Some(length) = bytes.get(at + 2..at + 4) else { return false };
                at += 2 + usize::from(u16::from_be_bytes([length[0], length[1]]));
            }
        }
    }
    false
}

/// A disparity map: ground truth for the left image, pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct DisparityMap {
    size: ImageSize,
    scaled: Vec<u16>,
}

impl DisparityMap {
    /// Stored units per pixel of disparity.
    pub const UNITS_PER_PX: f64 = 64.0;

    /// Loads a 16-bit grey PNG of 64 times the disparity `u_left - u_right`; 0 means unknown.
    ///
    /// # Errors
    /// A missing or damaged file, or one that is not 16-bit grey.
    pub fn load(file: &Path) -> Result<Self, ImageFileError> {
        match decode(file)? {
            DynamicImage::ImageLuma16(grey) => {
                Ok(Self { size: ImageSize { width: grey.width(), height: grey.height() }, scaled: grey.into_raw() })
            }
            other => {
                let found = format!("{:?}", other.color());
                Err(ImageFileError::new(file, ImageProblem::NotDisparity { found }))
            }
        }
    }

    /// A map from its stored units, row by row; `None` if their number does not match the size.
    pub fn from_scaled(size: ImageSize, scaled: Vec<u16>) -> Option<Self> {
        let pixels = u64::from(size.width) * u64::from(size.height);
        (scaled.len() as u64 == pixels).then_some(Self { size, scaled })
    }

    /// Size of the map.
    pub fn size(&self) -> ImageSize {
        self.size
    }

    /// Disparity at a pixel, pixels; `None` where it is unknown or outside.
    pub fn at(&self, u: u32, v: u32) -> Option<f64> {
        if u >= self.size.width || v >= self.size.height {
            return None;
        }
        let scaled = *self.scaled.get(v as usize * self.size.width as usize + u as usize)?;
        (scaled > 0).then(|| f64::from(scaled) / Self::UNITS_PER_PX)
    }
}

/// Storage format of recorded images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoredFormat {
    /// Lossless. Compressed quickly: a smaller file by a tenth would take thirty times as long.
    Png,
    /// Smaller, lossy.
    Jpeg {
        /// 1 to 100.
        quality: u8,
    },
}

impl StoredFormat {
    /// The file name extension.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg { .. } => "jpg",
        }
    }
}

/// Encodes an image in memory.
///
/// # Errors
/// The image is empty or too large for the format.
pub fn encode(image: &RgbImage, format: StoredFormat) -> Result<Vec<u8>, image::ImageError> {
    let mut bytes = Vec::new();
    let (width, height) = image.dimensions();
    match format {
        StoredFormat::Png => PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive)
            .write_image(image.as_raw(), width, height, image::ExtendedColorType::Rgb8)?,
        StoredFormat::Jpeg { quality } => JpegEncoder::new_with_quality(&mut bytes, quality.clamp(1, 100))
            .write_image(image.as_raw(), width, height, image::ExtendedColorType::Rgb8)?,
    }
    Ok(bytes)
}

/// Writes an image file.
///
/// # Errors
/// The image cannot be encoded or the file cannot be written.
pub fn save(image: &RgbImage, file: &Path, format: StoredFormat) -> Result<(), ImageFileError> {
    let bytes = encode(image, format).map_err(|e| ImageFileError::caused_by(file, ImageProblem::Io, e))?;
    std::fs::write(file, bytes).map_err(|e| ImageFileError::io(file, e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{GrayImage, ImageBuffer, Luma, Rgb, Rgba, RgbaImage};

    fn gradient() -> RgbImage {
        RgbImage::from_fn(37, 23, |x, y| Rgb([(x * 6) as u8, (y * 11) as u8, (x ^ y) as u8]))
    }

    fn problem(result: Result<RgbImage, ImageFileError>, file: &str) -> ImageProblem {
        let error = result.unwrap_err();
        assert!(error.to_string().contains(file), "{error} must name {file}");
        error.problem
    }

    #[test]
    fn the_size_is_checked_before_an_image_is_decoded() {
        let folder = tempfile::tempdir().unwrap();
        let size = ImageSize { width: 64, height: 48 };
        let message_of = |file: &Path| check_header(file, size, "the left image").unwrap_err().to_string();
        let large = folder.path().join("large.png");
        RgbImage::new(100, 80).save(&large).unwrap();
        // Only the header is left.
        std::fs::File::options().write(true).open(&large).unwrap().set_len(64).unwrap();
        assert!(message_of(&large).contains("100x80 pixels, but the left image has 64x48"), "{}", message_of(&large));
    }

    #[test]
    fn only_regular_files_are_loaded_and_nothing_blocks() {
        let folder = tempfile::tempdir().unwrap();
        let (pipe, device) = (folder.path().join("pipe.png"), folder.path().join("zero.png"));
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR).unwrap();
        std::os::unix::fs::symlink("/dev/zero", &device).unwrap();
        for (file, what) in [(&pipe, "pipe.png: it is a named pipe (FIFO)"), (&device, "zero.png: it is a device")] {
            let error = StoredImage::load(file).unwrap_err();
            assert!(matches!(error.problem, ImageProblem::Refused(_)) && error.to_string().contains(what), "{error}");
        }
    }

    #[test]
    fn png_survives_a_round_trip_and_jpeg_comes_close() {
        let dir = tempfile::tempdir().unwrap();
        let (png, jpg) = (dir.path().join("a.png"), dir.path().join("b.jpg"));
        save(&gradient(), &png, StoredFormat::Png).unwrap();
        assert_eq!(load_rgb(&png).unwrap(), gradient());
        save(&gradient(), &jpg, StoredFormat::Jpeg { quality: 95 }).unwrap();
        let difference: u64 =
            load_rgb(&jpg).unwrap().iter().zip(gradient().iter()).map(|(a, b)| u64::from(a.abs_diff(*b))).sum();
        assert!(difference / (37 * 23 * 3) < 20);
    }

    #[test]
    fn grey_is_expanded_and_opaque_alpha_dropped() {
        let dir = tempfile::tempdir().unwrap();
        let grey = dir.path().join("grey.png");
        GrayImage::from_fn(5, 4, |x, y| Luma([(10 * x + y) as u8])).save(&grey).unwrap();
        assert_eq!(*load_rgb(&grey).unwrap().get_pixel(3, 2), Rgb([32, 32, 32]));
        let alpha = dir.path().join("alpha.png");
        RgbaImage::from_pixel(5, 4, Rgba([1, 2, 3, 255])).save(&alpha).unwrap();
        assert_eq!(*load_rgb(&alpha).unwrap().get_pixel(4, 3), Rgb([1, 2, 3]));
        RgbaImage::from_pixel(5, 4, Rgba([1, 2, 3, 254])).save(&alpha).unwrap();
        assert_eq!(problem(load_rgb(&alpha), "alpha.png"), ImageProblem::Transparent);
    }

    #[test]
    fn an_image_that_is_too_large_is_called_so_from_its_header() {
        let dir = tempfile::tempdir().unwrap();
        let large = dir.path().join("large.png");
        let file = std::fs::File::create(&large).unwrap();
        let mut header = png::Encoder::new(file, 20_000, 5_001).write_header().unwrap();
        header.write_chunk(png::chunk::IDAT, &[0; 100]).unwrap();
        drop(header);
        let in_memory = StoredImage::parse(Path::new("/left/compressed"), &std::fs::read(&large).unwrap());
        for error in [load_rgb(&large).unwrap_err(), in_memory.unwrap_err()] {
            assert_eq!(error.problem, ImageProblem::TooLarge { found: ImageSize { width: 20_000, height: 5_001 } });
            let text = error.to_string();
            assert!(text.contains("too large: 20000x5001 pixels, at most 100 million"), "{text}");
        }
    }

    #[test]
    fn sixteen_bits_are_refused_for_images_and_required_for_disparity() {
        let dir = tempfile::tempdir().unwrap();
        let deep = dir.path().join("deep.png");
        ImageBuffer::<Luma<u16>, _>::from_raw(3, 2, vec![0_u16, 64, 96, 6400, 1, 65535]).unwrap().save(&deep).unwrap();
        assert_eq!(problem(load_rgb(&deep), "deep.png"), ImageProblem::Depth { found: "L16".into() });
        let map = DisparityMap::load(&deep).unwrap();
        assert_eq!(
            [(0, 0), (1, 0), (2, 0), (0, 1), (3, 0)].map(|(u, v)| map.at(u, v)),
            [None, Some(1.0), Some(1.5), Some(100.0), None]
        );
        let flat = dir.path().join("flat.png");
        save(&gradient(), &flat, StoredFormat::Png).unwrap();
        let error = DisparityMap::load(&flat).unwrap_err();
        assert_eq!(error.problem, ImageProblem::NotDisparity { found: "Rgb8".into() });
    }

    #[test]
    fn a_file_cut_at_any_place_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        for format in [StoredFormat::Png, StoredFormat::Jpeg { quality: 90 }] {
            let whole = encode(&gradient(), format).unwrap();
            let file = dir.path().join(format!("cut.{}", format.extension()));
            for length in (0..whole.len()).step_by(7) {
                std::fs::write(&file, &whole[..length]).unwrap();
                let found = problem(load_rgb(&file), "cut.");
                assert!(
                    found == ImageProblem::Damaged || (length < 16 && found == ImageProblem::UnknownFormat),
                    "{length} of {}: {found:?}",
                    whole.len()
                );
            }
        }
    }

    #[test]
    fn wrong_things_are_named() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(problem(load_rgb(&dir.path().join("none.png")), "none.png"), ImageProblem::Missing);
        let text = dir.path().join("text.png");
        std::fs::write(&text, "this is no image").unwrap();
        assert_eq!(problem(load_rgb(&text), "text.png"), ImageProblem::UnknownFormat);
        let file = dir.path().join("small.png");
        save(&gradient(), &file, StoredFormat::Png).unwrap();
        let error = load_rgb_of_size(&file, ImageSize { width: 640, height: 480 }, "the calibration").unwrap_err();
        let message = error.to_string();
        for part in ["small.png", "37x23", "640x480", "the calibration"] {
            assert!(message.contains(part), "{message} must contain {part}");
        }
    }
}
