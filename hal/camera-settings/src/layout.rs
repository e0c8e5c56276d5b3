//! Arrangement of the left and the right view: in one image, or in images of their own.

use std::fmt;
use std::str::FromStr;

use pb3dp_geometry::ImageSize;

use crate::pixels::PixelFormat;

/// Arrangement of both views in one image. Both views have the same size.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageLayout {
    /// Left half and right half.
    SideBySide,
    /// The left view above the right one.
    TopBottom,
}

impl ImageLayout {
    /// Every arrangement.
    pub const ALL: [Self; 2] = [Self::SideBySide, Self::TopBottom];

    /// Name in commands and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::SideBySide => "side-by-side",
            Self::TopBottom => "top-bottom",
        }
    }

    /// Size of one view in an image of this size, pixels; rounded down.
    pub fn half(self, ImageSize { width, height }: ImageSize) -> ImageSize {
        match self {
            Self::SideBySide => ImageSize { width: width / 2, height },
            Self::TopBottom => ImageSize { width, height: height / 2 },
        }
    }

    /// Size of an image with two views of this size, pixels.
    pub fn whole(self, ImageSize { width, height }: ImageSize) -> ImageSize {
        match self {
            Self::SideBySide => ImageSize { width: width.saturating_mul(2), height },
            Self::TopBottom => ImageSize { width, height: height.saturating_mul(2) },
        }
    }

    /// Column and row of the first pixel of the left and of the right view, for views of this size.
    pub fn origins(self, ImageSize { width, height }: ImageSize) -> [(u32, u32); 2] {
        match self {
            Self::SideBySide => [(0, 0), (width, 0)],
            Self::TopBottom => [(0, 0), (0, height)],
        }
    }
}

/// A text that is no arrangement.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{text:?} is no layout; use one of: {choices}")]
pub struct UnknownLayout {
    text: String,
    choices: String,
}

impl FromStr for ImageLayout {
    type Err = UnknownLayout;

    fn from_str(text: &str) -> Result<Self, UnknownLayout> {
        Self::ALL
            .into_iter()
            .find(|layout| layout.name() == text)
            .ok_or_else(|| UnknownLayout { text: text.to_owned(), choices: Self::ALL.map(Self::name).join(", ") })
    }
}

impl fmt::Display for ImageLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The devices that deliver both views.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceLayout {
    /// One device per view.
    #[default]
    TwoDevices,
    /// One device; each of its images has both views in this arrangement.
    OneImage(ImageLayout),
    /// One device; the pixels of both views alternate (format `Y8I`).
    Interleaved,
}

impl DeviceLayout {
    /// Every choice.
    pub const ALL: [Self; 4] = [
        Self::TwoDevices,
        Self::OneImage(ImageLayout::SideBySide),
        Self::OneImage(ImageLayout::TopBottom),
        Self::Interleaved,
    ];

    /// Name in commands and files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::TwoDevices => "two-devices",
            Self::OneImage(layout) => layout.name(),
            Self::Interleaved => "interleaved",
        }
    }

    /// Whether one device delivers both views.
    pub fn is_one_device(self) -> bool {
        self != Self::TwoDevices
    }

    /// Size of the images that a device is asked for, for views of this size, pixels. An interleaved image has the size of a view.
    pub fn device_size(self, view: ImageSize) -> ImageSize {
        match self {
            Self::TwoDevices | Self::Interleaved => view,
            Self::OneImage(layout) => layout.whole(view),
        }
    }

    /// Column and row of the first pixel of the left and of the right view in the images of the device, for views of this size.
    pub fn origins(self, view: ImageSize) -> [(u32, u32); 2] {
        match self {
            Self::TwoDevices | Self::Interleaved => [(0, 0); 2],
            Self::OneImage(layout) => layout.origins(view),
        }
    }

    /// Checks that images of this format have this layout.
    ///
    /// # Errors
    /// `Y8I` with another layout, or another format that is called interleaved.
    pub fn check_format(self, format: PixelFormat) -> Result<(), LayoutError> {
        match (self == Self::Interleaved, format == PixelFormat::Y8i) {
            (true, false) => Err(LayoutError::NotInterleaved { format }),
            (false, true) => Err(LayoutError::OnlyInterleaved { layout: self }),
            _ => Ok(()),
        }
    }

    /// Checks that both views of this size can be taken from the images of a device in this format.
    ///
    /// # Errors
    /// As [`Self::check_format`]; the right view would begin within a group of pixels that share their colour.
    pub fn check(self, format: PixelFormat, view: ImageSize) -> Result<(), LayoutError> {
        self.check_format(format)?;
        let [columns, rows] = format.pattern();
        let [_, (left, top)] = self.origins(view);
        if !left.is_multiple_of(columns) || !top.is_multiple_of(rows) {
            return Err(LayoutError::OddViews { layout: self, format, width: view.width, height: view.height });
        }
        Ok(())
    }
}

impl FromStr for DeviceLayout {
    type Err = UnknownLayout;

    fn from_str(text: &str) -> Result<Self, UnknownLayout> {
        Self::ALL
            .into_iter()
            .find(|layout| layout.name() == text)
            .ok_or_else(|| UnknownLayout { text: text.to_owned(), choices: Self::ALL.map(Self::name).join(", ") })
    }
}

impl fmt::Display for DeviceLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A part of a view, pixels: the image that is used of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crop {
    /// First column, from the left edge of the view.
    pub left: u32,
    /// First row, from the top edge of the view.
    pub top: u32,
    /// Width and height.
    pub size: ImageSize,
}

impl Crop {
    /// The whole of a view.
    pub fn whole(size: ImageSize) -> Self {
        Self { left: 0, top: 0, size }
    }

    /// Checks that the part is inside of a view, and that this format can be cut there.
    ///
    /// # Errors
    /// An empty part, a part that is not inside, or one that begins within a group of pixels that share their colour.
    pub fn check(self, view: ImageSize, format: PixelFormat) -> Result<(), LayoutError> {
        let is_inside = |first: u32, length: u32, end: u32| first.checked_add(length).is_some_and(|last| last <= end);
        if self.size.width == 0
            || self.size.height == 0
            || !is_inside(self.left, self.size.width, view.width)
            || !is_inside(self.top, self.size.height, view.height)
        {
            return Err(LayoutError::CropOutside { crop: self, width: view.width, height: view.height });
        }
        let [columns, rows] = format.pattern();
        if !self.left.is_multiple_of(columns) || !self.top.is_multiple_of(rows) {
            return Err(LayoutError::OddCrop { crop: self, format, columns, rows });
        }
        Ok(())
    }
}

impl FromStr for Crop {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Option<Vec<u32>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[left, top, width, height]) => Ok(Self { left, top, size: ImageSize { width, height } }),
            _ => Err(format!("{text:?} is no crop: write LEFT,TOP,WIDTH,HEIGHT in pixels, such as 16,0,640,480")),
        }
    }
}

impl fmt::Display for Crop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{},{},{}", self.left, self.top, self.size.width, self.size.height)
    }
}

/// Views that cannot be taken from the images of a device.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LayoutError {
    /// An interleaved layout of another format.
    #[error(
        "the layout interleaved needs the format Y8I, not {format}; use side-by-side or top-bottom, or ask for Y8I"
    )]
    NotInterleaved {
        /// The format.
        format: PixelFormat,
    },
    /// Y8I with another layout.
    #[error("the format Y8I has the pixels of both views alternately, which is the layout interleaved, not {layout}")]
    OnlyInterleaved {
        /// The layout.
        layout: DeviceLayout,
    },
    /// The right view would begin within a group of pixels.
    #[error(
        "{format} in the layout {layout} cannot have views of {width}x{height}: neighbouring pixels share their colour, so the right view \
         must begin at an even column and row; ask for another size"
    )]
    OddViews {
        /// The layout.
        layout: DeviceLayout,
        /// The format.
        format: PixelFormat,
        /// Width of a view.
        width: u32,
        /// Height of a view.
        height: u32,
    },
    /// A part that is empty or not inside.
    #[error("the crop {crop} (left, top, width, height) is empty or not inside of a view of {width}x{height} pixels")]
    CropOutside {
        /// The part.
        crop: Crop,
        /// Width of a view.
        width: u32,
        /// Height of a view.
        height: u32,
    },
    /// A part that begins within a group of pixels.
    #[error(
        "the crop {crop} (left, top, width, height) cannot begin there: {format} has groups of {columns}x{rows} pixels, so left must be a \
         multiple of {columns} and top one of {rows}"
    )]
    OddCrop {
        /// The part.
        crop: Crop,
        /// The format.
        format: PixelFormat,
        /// Columns of a group.
        columns: u32,
        /// Rows of a group.
        rows: u32,
    },
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BayerOrder;

    const VIEW: ImageSize = ImageSize { width: 640, height: 480 };

    #[test]
    fn names_lead_back_to_their_layouts() {
        for layout in DeviceLayout::ALL {
            assert_eq!(layout.name().parse(), Ok(layout));
        }
        let refusal = "sideways".parse::<DeviceLayout>().unwrap_err().to_string();
        assert_eq!(
            refusal,
            "\"sideways\" is no layout; use one of: two-devices, side-by-side, top-bottom, interleaved"
        );
        assert!("interleaved".parse::<ImageLayout>().is_err());
    }

    #[test]
    fn sizes_and_origins_are_those_of_the_arrangement() {
        for (layout, whole, right) in [
            (DeviceLayout::TwoDevices, (640, 480), (0, 0)),
            (DeviceLayout::OneImage(ImageLayout::SideBySide), (1280, 480), (640, 0)),
            (DeviceLayout::OneImage(ImageLayout::TopBottom), (640, 960), (0, 480)),
            (DeviceLayout::Interleaved, (640, 480), (0, 0)),
        ] {
            let size = layout.device_size(VIEW);
            assert_eq!(((size.width, size.height), layout.origins(VIEW)), (whole, [(0, 0), right]), "{layout}");
        }
    }

    #[test]
    fn views_and_crops_that_tear_a_group_of_pixels_are_refused() {
        let odd = |width, height| ImageSize { width, height };
        let side = DeviceLayout::OneImage(ImageLayout::SideBySide);
        let top = DeviceLayout::OneImage(ImageLayout::TopBottom);
        let bayer = PixelFormat::Bayer8(BayerOrder::Grbg);
        for (layout, format, view, is_fine) in [
            (side, PixelFormat::Yuyv, odd(641, 480), false),
            (side, PixelFormat::Grey, odd(641, 480), true),
            (top, PixelFormat::Yuyv, odd(641, 481), true),
            (top, PixelFormat::Nv12, odd(640, 481), false),
            (top, bayer, odd(640, 481), false),
            (DeviceLayout::Interleaved, PixelFormat::Y8i, odd(641, 481), true),
            (DeviceLayout::Interleaved, PixelFormat::Grey, VIEW, false),
            (DeviceLayout::TwoDevices, PixelFormat::Y8i, VIEW, false),
        ] {
            assert_eq!(layout.check(format, view).is_ok(), is_fine, "{layout} {format} {view:?}");
        }
        for (crop, format, is_fine) in [
            ("1,0,639,480", PixelFormat::Yuyv, false),
            ("2,1,637,479", PixelFormat::Yuyv, true),
            ("2,1,638,479", PixelFormat::Nv12, false),
            ("0,1,640,479", bayer, false),
            ("1,1,639,479", PixelFormat::Y12, true),
            ("1,0,640,480", PixelFormat::Grey, false),
            ("4294967295,0,640,480", PixelFormat::Grey, false),
            ("0,0,0,480", PixelFormat::Grey, false),
        ] {
            let result = crop.parse::<Crop>().unwrap().check(VIEW, format);
            assert_eq!(result.is_ok(), is_fine, "{crop} {format}: {result:?}");
            assert!(result.err().is_none_or(|error| error.to_string().contains(crop)));
        }
        assert!("1,2,3".parse::<Crop>().unwrap_err().contains("LEFT,TOP,WIDTH,HEIGHT"));
    }
}
