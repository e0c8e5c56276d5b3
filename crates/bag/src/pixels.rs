//! Images of messages as images in memory.

use image::RgbImage;
use pb3dp_camera_pixels::{Converter, Layout, YuvMatrix, YuvRange};
use pb3dp_camera_settings::{BayerOrder, PixelFormat};
use pb3dp_geometry::ImageSize;
use pb3dp_record::images::{PIXELS_MAX, StoredImage};
use pb3dp_record::value_range::{DeepImage, ValueRange};

use crate::messages::Image;

/// What an encoding of `sensor_msgs/Image` means (`sensor_msgs/image_encodings.hpp`, ROS 2 Jazzy).
#[derive(Clone, Copy)]
enum Encoding {
    /// A format of cameras.
    Camera(PixelFormat),
    /// As YUYV, with luminance and chroma exchanged.
    Uyvy,
    /// Three colours and an opacity that is ignored; with red first or last.
    FourChannels { is_bgr: bool },
    /// 16 bits of grey.
    DeepGrey,
    /// 16 bits of three colours; with red first or last.
    DeepColour { is_bgr: bool },
    /// 16 bits of one colour per pixel.
    DeepBayer(BayerOrder),
}

/// Names of the encodings that are read.
const ENCODINGS: [(&str, Encoding); 25] = [
    ("rgb8", Encoding::Camera(PixelFormat::Rgb24)),
    ("bgr8", Encoding::Camera(PixelFormat::Bgr24)),
    ("8UC3", Encoding::Camera(PixelFormat::Bgr24)),
    ("mono8", Encoding::Camera(PixelFormat::Grey)),
    ("8UC1", Encoding::Camera(PixelFormat::Grey)),
    ("rgba8", Encoding::FourChannels { is_bgr: false }),
    ("bgra8", Encoding::FourChannels { is_bgr: true }),
    ("8UC4", Encoding::FourChannels { is_bgr: true }),
    ("mono16", Encoding::DeepGrey),
    ("16UC1", Encoding::DeepGrey),
    ("rgb16", Encoding::DeepColour { is_bgr: false }),
    ("bgr16", Encoding::DeepColour { is_bgr: true }),
    ("16UC3", Encoding::DeepColour { is_bgr: true }),
    ("yuv422_yuy2", Encoding::Camera(PixelFormat::Yuyv)),
    ("yuyv", Encoding::Camera(PixelFormat::Yuyv)),
    ("yuv422", Encoding::Uyvy),
    ("uyvy", Encoding::Uyvy),
    ("bayer_rggb8", Encoding::Camera(PixelFormat::Bayer8(BayerOrder::Rggb))),
    ("bayer_bggr8", Encoding::Camera(PixelFormat::Bayer8(BayerOrder::Bggr))),
    ("bayer_gbrg8", Encoding::Camera(PixelFormat::Bayer8(BayerOrder::Gbrg))),
    ("bayer_grbg8", Encoding::Camera(PixelFormat::Bayer8(BayerOrder::Grbg))),
    ("bayer_rggb16", Encoding::DeepBayer(BayerOrder::Rggb)),
    ("bayer_bggr16", Encoding::DeepBayer(BayerOrder::Bggr)),
    ("bayer_gbrg16", Encoding::DeepBayer(BayerOrder::Gbrg)),
    ("bayer_grbg16", Encoding::DeepBayer(BayerOrder::Grbg)),
];

/// An image of a message before its range of values is known.
#[derive(Debug)]
pub(crate) enum Pixels {
    Ready(StoredImage),
    /// 16 bits of one colour per pixel: converted once the range is known.
    Bayer(DeepImage, BayerOrder),
}

impl Pixels {
    /// The image with its values for the measurement of a range, if it has more than 8 bits.
    pub fn deep(&self) -> Option<&DeepImage> {
        match self {
            Self::Ready(StoredImage::Deep(image)) | Self::Bayer(image, _) => Some(image),
            Self::Ready(StoredImage::Rgb(_)) => None,
        }
    }

    /// The image in 8 bits; `range` counts only if it has more.
    pub fn into_rgb(self, range: ValueRange) -> Result<RgbImage, String> {
        match self {
            Self::Ready(StoredImage::Rgb(image)) => Ok(image),
            Self::Ready(StoredImage::Deep(image)) => Ok(image.to_rgb(range)),
            Self::Bayer(image, order) => {
                let width = image.size().width as usize;
                converted(PixelFormat::Bayer8(order), image.size(), width, &image.bytes(range))
            }
        }
    }
}

/// The image of a message.
///
/// # Errors
/// What is wrong with it, and what to do.
pub(crate) fn pixels(image: &Image) -> Result<Pixels, String> {
    let Image { width, height, ref encoding, step, ref data, .. } = *image;
    let size = ImageSize { width, height };
    if u64::from(width) * u64::from(height) > PIXELS_MAX || width == 0 || height == 0 {
        return Err(format!("its size is {width}x{height}; 1 to {} million pixels are read", PIXELS_MAX / 1_000_000));
    }
    let Some((_, encoding)) = ENCODINGS.iter().find(|(name, _)| name == encoding) else {
        let known = ENCODINGS.map(|(name, _)| name).join(", ");
        return Err(format!("the encoding {encoding:?} is not read; record one of: {known}"));
    };
    let (stride, bytes) = (step as usize, &data.0[..]);
    let is_big_endian = image.is_bigendian != 0;
    let deep = |channels: usize| deep(size, channels, (stride, bytes), is_big_endian);
    match *encoding {
        Encoding::Camera(format) => ready(converted(format, size, stride, bytes)?),
        Encoding::Uyvy => {
            let exchanged: Vec<u8> =
                bytes.as_chunks::<2>().0.iter().flat_map(|[chroma, grey]| [*grey, *chroma]).collect();
            ready(converted(PixelFormat::Yuyv, size, stride, &exchanged)?)
        }
        Encoding::FourChannels { is_bgr } => {
            let rows = rows(size, 4, (stride, bytes))?;
            let colours = rows.flat_map(|row| row.as_chunks::<4>().0.iter().map(|[a, b, c, _]| [*a, *b, *c]));
            let rgb = colours.flat_map(|[a, b, c]| if is_bgr { [c, b, a] } else { [a, b, c] }).collect();
            ready(RgbImage::from_raw(width, height, rgb).ok_or("its rows are not complete")?)
        }
        Encoding::DeepGrey => Ok(Pixels::Ready(StoredImage::Deep(deep(1)?))),
        Encoding::DeepColour { is_bgr: false } => Ok(Pixels::Ready(StoredImage::Deep(deep(3)?))),
        Encoding::DeepColour { is_bgr: true } => {
            Ok(Pixels::Ready(StoredImage::Deep(deep(3)?.with_red_and_blue_exchanged())))
        }
        Encoding::DeepBayer(order) => Ok(Pixels::Bayer(deep(1)?, order)),
    }
}

fn ready(image: RgbImage) -> Result<Pixels, String> {
    Ok(Pixels::Ready(StoredImage::Rgb(image)))
}

/// An image in a format of cameras.
///
/// # Errors
/// What is wrong with it.
pub(crate) fn converted(format: PixelFormat, size: ImageSize, stride: usize, bytes: &[u8]) -> Result<RgbImage, String> {
    let layout = Layout { format, size, stride, matrix: YuvMatrix::Bt601, range: YuvRange::Limited };
    let mut image = RgbImage::default();
    let mut converter = Converter::new(layout).map_err(|error| error.to_string())?;
    converter.convert(bytes, &mut image).map_err(|error| error.to_string())?;
    Ok(image)
}

/// The rows without their padding; `unit` is the number of bytes per pixel.
fn rows(
    ImageSize { width, height }: ImageSize,
    unit: usize,
    (stride, bytes): (usize, &[u8]),
) -> Result<impl Iterator<Item = &[u8]>, String> {
    let (row, rows) = (width as usize * unit, height as usize);
    let needed = stride.saturating_mul(rows - 1).saturating_add(row);
    if stride < row || bytes.len() < needed {
        return Err(format!(
            "{} bytes in rows of {stride} are too few for {width}x{height} pixels of {unit} bytes",
            bytes.len()
        ));
    }
    Ok(bytes.chunks(stride).take(rows).map(move |bytes| &bytes[..row]))
}

fn deep(size: ImageSize, channels: usize, rows_of: (usize, &[u8]), is_big_endian: bool) -> Result<DeepImage, String> {
    let value = |bytes: &[u8; 2]| if is_big_endian { u16::from_be_bytes(*bytes) } else { u16::from_le_bytes(*bytes) };
    let values = rows(size, 2 * channels, rows_of)?.flat_map(|row| row.as_chunks::<2>().0.iter().map(value)).collect();
    DeepImage::new(size, channels, values).ok_or_else(|| "its rows are not complete".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cdr::Bytes;
    use crate::messages::Header;

    fn image(encoding: &str, (width, height): (u32, u32), step: u32, data: Vec<u8>) -> Image {
        let (header, encoding) = (Header::default(), encoding.to_owned());
        Image { header, width, height, encoding, is_bigendian: 0, step, data: Bytes(data) }
    }

    fn rgb(image: &Image, range: &str) -> Vec<u8> {
        pixels(image).unwrap().into_rgb(range.parse().unwrap()).unwrap().into_raw()
    }

    #[test]
    fn each_encoding_gives_its_colours() {
        // Two pixels and one byte of padding per row, for all but the deep ones.
        let check = |encoding: &str, row: &[u8], expected: [u8; 6]| {
            let padded = [row, &[99, 98]].concat();
            let found = rgb(&image(encoding, (2, 1), padded.len() as u32, padded), "0,65535");
            assert_eq!(found, expected, "{encoding}");
        };
        for encoding in ["mono8", "8UC1"] {
            check(encoding, &[7, 200], [7, 7, 7, 200, 200, 200]);
        }
        check("rgb8", &[1, 2, 3, 4, 5, 6], [1, 2, 3, 4, 5, 6]);
        for encoding in ["bgr8", "8UC3"] {
            check(encoding, &[1, 2, 3, 4, 5, 6], [3, 2, 1, 6, 5, 4]);
        }
        check("rgba8", &[1, 2, 3, 77, 4, 5, 6, 77], [1, 2, 3, 4, 5, 6]);
        for encoding in ["bgra8", "8UC4"] {
            check(encoding, &[1, 2, 3, 77, 4, 5, 6, 77], [3, 2, 1, 6, 5, 4]);
        }
        for encoding in ["mono16", "16UC1"] {
            check(encoding, &[0xFF, 0xFF, 0, 0], [255, 255, 255, 0, 0, 0]);
        }
        check("rgb16", &[255, 255, 0, 0, 0, 0, 0, 0, 0, 0, 255, 255], [255, 0, 0, 0, 0, 255]);
        for encoding in ["bgr16", "16UC3"] {
            check(encoding, &[255, 255, 0, 0, 0, 0, 0, 0, 0, 0, 255, 255], [0, 0, 255, 255, 0, 0]);
        }
        // Luminance 16 and 235 without colour are black and white.
        for encoding in ["yuv422_yuy2", "yuyv"] {
            check(encoding, &[16, 128, 235, 128], [0, 0, 0, 255, 255, 255]);
        }
        for encoding in ["yuv422", "uyvy"] {
            check(encoding, &[128, 16, 128, 235], [0, 0, 0, 255, 255, 255]);
        }
    }

    /// A plain red area: every pixel is red, whatever the order.
    #[test]
    fn bayer_images_have_colours() {
        for (order, red_at) in [("rggb", 0), ("grbg", 1), ("gbrg", 2), ("bggr", 3)] {
            let value = |k: usize| (k % 4 % 2 + 2 * (k / 4 % 2) == red_at) as u8;
            let shallow: Vec<u8> = (0..16).map(|k| 200 * value(k)).collect();
            let found = rgb(&image(&format!("bayer_{order}8"), (4, 4), 4, shallow), "0,65535");
            assert!(found.chunks(3).all(|pixel| pixel == [200, 0, 0]), "{order}: {found:?}");
            let deep: Vec<u8> = (0..16).flat_map(|k| (4000 * u16::from(value(k))).to_be_bytes()).collect();
            let deep = Image { is_bigendian: 1, ..image(&format!("bayer_{order}16"), (4, 4), 8, deep) };
            let found = rgb(&deep, "0,4000");
            assert!(found.chunks(3).all(|pixel| pixel == [255, 0, 0]), "{order}: {found:?}");
        }
    }

    #[test]
    fn what_cannot_be_an_image_is_refused() {
        let refused = |image: &Image, parts: &[&str]| {
            let message = pixels(image).unwrap_err();
            assert!(parts.iter().all(|part| message.contains(part)), "{message}");
        };
        refused(&image("yuv444", (2, 2), 6, vec![0; 12]), &["\"yuv444\"", "rgb8", "bayer_rggb16"]);
        refused(&image("rgb8", (2, 2), 6, vec![0; 11]), &["11 bytes", "12"]);
        refused(&image("rgb8", (2, 2), 5, vec![0; 12]), &["stride of 5"]);
        refused(&image("mono16", (2, 2), 4, vec![0; 7]), &["7 bytes", "2x2"]);
        refused(&image("rgba8", (2, 2), 7, vec![0; 99]), &["rows of 7"]);
        refused(&image("mono8", (0, 2), 0, Vec::new()), &["0x2"]);
        refused(&image("mono8", (100_000, 100_000), 100_000, Vec::new()), &["100 million"]);
    }
}
