//! Pixel formats of cameras.

use pb3dp_geometry::ValueRange;

/// The pixel format of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// `YUYV`: two pixels in four bytes, Y0 U Y1 V.
    Yuyv,
    /// `GREY`: one byte of luminance.
    Grey,
    /// `Y10 `: 16 bits of luminance, low byte first, of which the low 10 are used.
    Y10,
    /// `Y12 `: 16 bits of luminance, low byte first, of which the low 12 are used.
    Y12,
    /// `Y16 `: 16 bits of luminance, low byte first.
    Y16,
    /// `NV12`: a plane of luminance, and after it one of chroma U, V for each 2x2 pixels, with rows of the same length.
    Nv12,
    /// `Y8I `: two images of one byte of luminance, pixel by pixel: left, right, left, right.
    Y8i,
    /// `RGB3`: red, green, blue.
    Rgb24,
    /// `BGR3`: blue, green, red.
    Bgr24,
    /// `RGGB`, `GRBG`, `GBRG`, `BA81`: one byte of one colour per pixel, the raw sensor data.
    Bayer8(BayerOrder),
    /// `MJPG`: each image is a separate JPEG, with or without its Huffman tables.
    Mjpg,
}

impl PixelFormat {
    /// Every format, fastest conversion first.
    pub const ALL: [Self; 14] = [
        Self::Yuyv,
        Self::Rgb24,
        Self::Bgr24,
        Self::Grey,
        Self::Y8i,
        Self::Y10,
        Self::Y12,
        Self::Y16,
        Self::Nv12,
        Self::Bayer8(BayerOrder::Rggb),
        Self::Bayer8(BayerOrder::Grbg),
        Self::Bayer8(BayerOrder::Gbrg),
        Self::Bayer8(BayerOrder::Bggr),
        Self::Mjpg,
    ];

    /// The four-character code in V4L2 (kernel documentation, "Image Formats").
    pub const fn fourcc(self) -> [u8; 4] {
        match self {
            Self::Yuyv => *b"YUYV",
            Self::Grey => *b"GREY",
            Self::Y10 => *b"Y10 ",
            Self::Y12 => *b"Y12 ",
            Self::Y16 => *b"Y16 ",
            Self::Nv12 => *b"NV12",
            Self::Y8i => *b"Y8I ",
            Self::Rgb24 => *b"RGB3",
            Self::Bgr24 => *b"BGR3",
            Self::Bayer8(BayerOrder::Rggb) => *b"RGGB",
            Self::Bayer8(BayerOrder::Grbg) => *b"GRBG",
            Self::Bayer8(BayerOrder::Gbrg) => *b"GBRG",
            Self::Bayer8(BayerOrder::Bggr) => *b"BA81",
            Self::Mjpg => *b"MJPG",
        }
    }

    /// Name of the encoding of one view in ROS 2 (`sensor_msgs/image_encodings.hpp`); `jpeg` for a file, empty if ROS 2 has none.
    pub const fn ros_encoding(self) -> &'static str {
        match self {
            Self::Yuyv => "yuv422_yuy2",
            Self::Grey | Self::Y8i => "mono8",
            Self::Y10 | Self::Y12 | Self::Y16 => "mono16",
            Self::Nv12 => "",
            Self::Rgb24 => "rgb8",
            Self::Bgr24 => "bgr8",
            Self::Bayer8(BayerOrder::Rggb) => "bayer_rggb8",
            Self::Bayer8(BayerOrder::Grbg) => "bayer_grbg8",
            Self::Bayer8(BayerOrder::Gbrg) => "bayer_gbrg8",
            Self::Bayer8(BayerOrder::Bggr) => "bayer_bggr8",
            Self::Mjpg => "jpeg",
        }
    }

    /// The format with that code, if it can be converted.
    pub fn of_fourcc(fourcc: [u8; 4]) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.fourcc() == fourcc)
    }

    /// Bytes of one row without padding; `None` for formats without rows of fixed length.
    pub fn row_bytes(self, width: u32) -> Option<usize> {
        let width = width as usize;
        match self {
            // Two pixels share their chroma: an odd last pixel has its own pair.
            Self::Yuyv => Some(width.div_ceil(2) * 4),
            Self::Grey | Self::Bayer8(_) => Some(width),
            Self::Y10 | Self::Y12 | Self::Y16 | Self::Y8i => Some(2 * width),
            // The chroma plane has a pair of bytes for an odd last pixel, in rows of the same length.
            Self::Nv12 => Some(width.next_multiple_of(2)),
            Self::Rgb24 | Self::Bgr24 => Some(3 * width),
            Self::Mjpg => None,
        }
    }

    /// Number of rows in memory, of all planes, for an image with this number of rows.
    pub fn memory_rows(self, height: u32) -> usize {
        let height = height as usize;
        height + if self == Self::Nv12 { height.div_ceil(2) } else { 0 }
    }

    /// The values that are black and white unless a range is stated; `None` for formats with 8 bits.
    pub fn full_range(self) -> Option<ValueRange> {
        let bits = match self {
            Self::Y10 => 10,
            Self::Y12 => 12,
            Self::Y16 => 16,
            _ => return None,
        };
        ValueRange::new(0, u16::MAX >> (16 - bits))
    }

    /// Columns and rows of the pattern that repeats: a part of an image begins at a multiple of both.
    pub const fn pattern(self) -> [u32; 2] {
        match self {
            Self::Yuyv => [2, 1],
            Self::Nv12 | Self::Bayer8(_) => [2, 2],
            _ => [1, 1],
        }
    }
}

/// Four letters that are not a supported format.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is not a supported pixel format; use one of: {}", PixelFormat::ALL.map(|format| format.to_string()).join(", "))]
pub struct UnknownFormat {
    text: String,
}

impl std::str::FromStr for PixelFormat {
    type Err = UnknownFormat;

    fn from_str(text: &str) -> Result<Self, UnknownFormat> {
        // V4L2 fills up shorter names with a space.
        let fourcc = <[u8; 4]>::try_from(format!("{text:<4}").as_bytes()).ok();
        fourcc.and_then(Self::of_fourcc).ok_or_else(|| UnknownFormat { text: text.to_owned() })
    }
}

impl std::fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(String::from_utf8_lossy(&self.fourcc()).trim_end())
    }
}

/// The colours of the upper left 2x2 pixels, row by row.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BayerOrder {
    /// Red, green; green, blue.
    Rggb,
    /// Green, red; blue, green.
    Grbg,
    /// Green, blue; red, green.
    Gbrg,
    /// Blue, green; green, red.
    Bggr,
}
