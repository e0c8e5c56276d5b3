//! Images of a part of the sensor: `binning_x`, `binning_y` and `roi` of a `camera_info`.
//!
//! By the definition of `sensor_msgs/CameraInfo`, size and camera matrix are those of the whole sensor; `roi` is the part that is read
//! out, in pixels of the sensor, and `binning_x` times `binning_y` of its pixels give one of the image. Some drivers state the size, or
//! size and camera matrix, of the images instead. [`camera_matrices`] decides by the sizes, then by the principal points.

use std::fmt;

use pb3dp_geometry::{ImageSize, Pinhole};

use super::document::Node;
use super::error::CalibrationFileError;

/// Largest distance of a plausible principal point from the middle of the image, in image sides. Chosen: lenses are centred to some
/// percent, and half the size of an image puts the principal point into its corner.
const OFF_CENTRE_MAX: f64 = 0.2;

/// The part of the sensor that the images show. Zero stands for the whole side, and for a binning of 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SensorWindow {
    binning: [u32; 2],
    offset: [u32; 2],
    size: [u32; 2],
}

/// The camera of one file: size and camera matrix as the file states them.
pub(super) struct StatedCamera<'a> {
    pub(super) root: Node<'a>,
    pub(super) size: ImageSize,
    pub(super) pinhole: Pinhole,
    pub(super) window: SensorWindow,
}

/// Cameras of the images.
pub(super) struct ImageCameras {
    pub(super) sizes: [ImageSize; 2],
    pub(super) pinholes: [Pinhole; 2],
    /// What was applied, for the user.
    pub(super) note: Option<String>,
    /// What was assumed, for the user.
    pub(super) warning: Option<String>,
}

impl SensorWindow {
    pub(super) fn read(root: &Node<'_>) -> Result<Self, CalibrationFileError> {
        let pixels = |parent: &Node<'_>, key: &str| {
            let Some(node) = parent.find(key) else { return Ok(0) };
            let number = node.number()?;
            if number.fract() != 0.0 || !(0.0..=65_535.0).contains(&number) {
                return Err(node.refuse(format!("{number} is not a number of pixels")));
            }
            Ok(number as u32)
        };
        let in_roi = |key: &str| root.find("roi").map_or(Ok(0), |roi| pixels(&roi, key));
        Ok(Self {
            binning: [pixels(root, "binning_x")?, pixels(root, "binning_y")?],
            offset: [in_roi("x_offset")?, in_roi("y_offset")?],
            size: [in_roi("width")?, in_roi("height")?],
        })
    }

    fn factor(&self, axis: usize) -> u32 {
        self.binning[axis].max(1)
    }

    /// Whether the images show the whole sensor of this size, pixel by pixel.
    pub(super) fn is_whole(&self, sensor: ImageSize) -> bool {
        let is_side = |axis: usize, side| [0, side].contains(&self.size[axis]) && self.factor(axis) == 1;
        self.offset == [0, 0] && is_side(0, sensor.width) && is_side(1, sensor.height)
    }

    /// Size of the images of a sensor of this size; `None` if the part does not lie in it.
    fn image_size(&self, sensor: ImageSize) -> Option<ImageSize> {
        let side = |axis: usize, side: u32| {
            let rest = side.checked_sub(self.offset[axis])?;
            let part = if self.size[axis] == 0 { rest } else { self.size[axis] };
            Some(part / self.factor(axis)).filter(|pixels| part <= rest && *pixels > 0)
        };
        Some(ImageSize { width: side(0, sensor.width)?, height: side(1, sensor.height)? })
    }

    /// Whether images of this size can show the part, whatever the size of the sensor.
    fn has_size(&self, images: ImageSize) -> bool {
        let fits = |axis: usize, side| self.size[axis] == 0 || self.size[axis] / self.factor(axis) == side;
        fits(0, images.width) && fits(1, images.height)
    }

    /// The camera matrix of the images from that of the sensor. Pixel centres have integer coordinates.
    fn of_image(&self, Pinhole { fx, fy, cx, cy }: Pinhole) -> Pinhole {
        let factor = [0, 1].map(|axis| f64::from(self.factor(axis)));
        let centre = |axis: usize, c: f64| (c - f64::from(self.offset[axis]) + 0.5) / factor[axis] - 0.5;
        Pinhole { fx: fx / factor[0], fy: fy / factor[1], cx: centre(0, cx), cy: centre(1, cy) }
    }
}

impl fmt::Display for SensorWindow {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { binning, offset: [x, y], size: [width, height] } = self;
        let roi = format!("roi of {width}x{height} at ({x}, {y})");
        match (binning.iter().any(|factor| *factor > 1), [*x, *y, *width, *height] != [0; 4]) {
            (true, false) => write!(f, "binning {}x{}", self.factor(0), self.factor(1)),
            (true, true) => write!(f, "binning {}x{} and {roi}", self.factor(0), self.factor(1)),
            (false, _) => f.write_str(&roi),
        }
    }
}

/// The cameras of the images. `images`: their size, if it is known.
///
/// # Errors
/// Sizes that do not fit together, and numbers that can be read in two ways.
pub(super) fn camera_matrices(
    stated: [&StatedCamera<'_>; 2],
    images: Option<ImageSize>,
) -> Result<ImageCameras, CalibrationFileError> {
    let sizes = stated.map(|camera| camera.size);
    let as_stated = stated.map(|camera| camera.pinhole);
    let Some(with_window) = stated.into_iter().find(|camera| !camera.window.is_whole(camera.size)) else {
        return Ok(ImageCameras { sizes, pinholes: as_stated, note: None, warning: None });
    };
    let window = with_window.window;
    let key = if window.binning.iter().any(|factor| *factor > 1) { "binning_x" } else { "roi" };
    let sensor = format!("{}x{}", with_window.size.width, with_window.size.height);
    let refuse = |reason: String| Err(with_window.root.error(key, reason));
    let of_sensor = stated.map(|camera| camera.window.of_image(camera.pinhole));
    if let [Some(left), Some(right)] = stated.map(|camera| camera.window.image_size(camera.size))
        && images.is_none_or(|images| [left, right] == [images; 2])
    {
        let note = format!(
            "applied from camera_info: {window}; the sensor has {sensor} pixels, the images have {}x{}",
            left.width, left.height
        );
        return Ok(ImageCameras { sizes: [left, right], pinholes: of_sensor, note: Some(note), warning: None });
    }
    let images = images.unwrap_or(with_window.size);
    if sizes != [images; 2] {
        return refuse(format!(
            "the images have {}x{} pixels, which is neither the stated size {sensor} nor {window} of it; correct image_width, image_height, binning and roi, or give a calibration of these images with --calib",
            images.width, images.height
        ));
    }
    let centre = |Pinhole { cx, cy, .. }| format!("({cx:.1}, {cy:.1})");
    let [in_sensor, in_images] = [centre(window.of_image(with_window.pinhole)), centre(with_window.pinhole)];
    let can_be_of_sensor = stated.iter().all(|camera| camera.window.has_size(images)) && is_centred(of_sensor, images);
    let stated_too = format!("{window} of camera_info: image_width and image_height are those of the images, {sensor}");
    let (pinholes, whose, here, otherwise) = match (can_be_of_sensor, is_centred(as_stated, images)) {
        (true, false) => (of_sensor, "whole sensor", in_sensor, in_images),
        (false, true) => (as_stated, "images", in_images, in_sensor),
        (is_either, _) => {
            let which = if is_either { "both are" } else { "neither is" };
            return refuse(format!(
                "{stated_too}, so that the camera matrix can be that of the whole sensor (principal point of the images {in_sensor}) or that of the images ({in_images}), and {which} near the middle; state the size of the sensor, or leave binning and roi out; files with such a correction are given with --calib"
            ));
        }
    };
    let warning = format!(
        "{stated_too}; the camera matrix is taken as that of the {whose}, because the principal point is then {here}, near the middle of the images, and otherwise {otherwise}; if this is wrong, give a calibration of these images with --calib"
    );
    Ok(ImageCameras { sizes, pinholes, note: None, warning: Some(warning) })
}

/// Whether both principal points are near the middle of images of this size.
pub(super) fn is_centred(pinholes: [Pinhole; 2], images: ImageSize) -> bool {
    let near =
        |centre: f64, side: u32| (centre - (f64::from(side) - 1.0) / 2.0).abs() <= OFF_CENTRE_MAX * f64::from(side);
    pinholes.iter().all(|Pinhole { cx, cy, .. }| near(*cx, images.width) && near(*cy, images.height))
}
