//! What the user states about a calibration whose file leaves it unstated.

use std::fmt;
use std::str::FromStr;

use pb3dp_geometry::{Camera, CameraError, ImageSize, Pinhole, StereoRig};

/// What the user states about a calibration. A file that states something else is refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StatedCalibration {
    /// Unit of length of an OpenCV file.
    pub unit: Option<LengthUnit>,
    /// Size of the images that the calibration was made with. Its cameras are scaled to images of another size and the same shape.
    pub size: Option<ImageSize>,
    /// Lens model of an OpenCV file with four coefficients.
    pub lens: Option<LensModel>,
    /// The images are rectified already: the rig has the projection matrices P of the file, or without them the rectified cameras of the rig.
    pub rectified: bool,
}

/// A unit of length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LengthUnit {
    /// `mm`.
    Millimetres,
    /// `cm`.
    Centimetres,
    /// `m`.
    Metres,
}

/// A lens model with four coefficients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LensModel {
    /// `brown` or, as in ROS, `plumb_bob`: Brown-Conrady, k1 k2 p1 p2.
    BrownConrady,
    /// `equidistant` or, as in OpenCV, `fisheye`: fisheye (Kannala-Brandt), k1 k2 k3 k4.
    Equidistant,
}

impl LengthUnit {
    pub(super) const ALL: [Self; 3] = [Self::Millimetres, Self::Centimetres, Self::Metres];

    /// Its abbreviation.
    pub fn name(self) -> &'static str {
        match self {
            Self::Millimetres => "mm",
            Self::Centimetres => "cm",
            Self::Metres => "m",
        }
    }

    /// Its length in metres.
    pub fn metres(self) -> f64 {
        match self {
            Self::Millimetres => 1e-3,
            Self::Centimetres => 1e-2,
            Self::Metres => 1.0,
        }
    }
}

impl FromStr for LengthUnit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "m" | "metre" | "metres" | "meter" | "meters" => Ok(Self::Metres),
            "cm" | "centimetre" | "centimetres" | "centimeter" | "centimeters" => Ok(Self::Centimetres),
            "mm" | "millimetre" | "millimetres" | "millimeter" | "millimeters" => Ok(Self::Millimetres),
            other => Err(format!("unknown unit {other:?}; use mm, cm or m")),
        }
    }
}

impl LensModel {
    /// Value of `--calib-lens`.
    pub fn name(self) -> &'static str {
        match self {
            Self::BrownConrady => "brown",
            Self::Equidistant => "equidistant",
        }
    }
}

impl fmt::Display for LensModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::BrownConrady => "Brown-Conrady (k1 k2 p1 p2)",
            Self::Equidistant => "equidistant (fisheye, k1 k2 k3 k4)",
        })
    }
}

impl FromStr for LensModel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "brown" | "plumb_bob" => Ok(Self::BrownConrady),
            "equidistant" | "fisheye" => Ok(Self::Equidistant),
            other => Err(format!("unknown lens model {other:?}; use brown or equidistant")),
        }
    }
}

/// The rig for images of another size that show the same field of view. Pixel centres have integer coordinates.
pub(super) fn scaled(rig: &StereoRig, images: ImageSize) -> Result<StereoRig, String> {
    let camera = |camera: &Camera| {
        let size = camera.size();
        let scale = [(images.width, size.width), (images.height, size.height)]
            .map(|(to, from)| f64::from(to) / f64::from(from));
        // The sides of a scaled image are rounded to pixels.
        if (scale[0] / scale[1] - 1.0).abs() > 1.0 / f64::from(images.width.min(images.height)) {
            return Err(format!(
                "the images have {}x{} pixels, another shape than {}x{}: an image is cut off; calibrate with images of this size",
                images.width, images.height, size.width, size.height
            ));
        }
        let Pinhole { fx, fy, cx, cy } = *camera.pinhole();
        let centre = |c: f64, scale: f64| (c + 0.5) * scale - 0.5;
        let pinhole =
            Pinhole { fx: fx * scale[0], fy: fy * scale[1], cx: centre(cx, scale[0]), cy: centre(cy, scale[1]) };
        let scaled: Result<Camera, CameraError> = Camera::new(images, pinhole, *camera.distortion());
        scaled.map_err(|error| error.to_string())
    };
    StereoRig::new(camera(rig.left())?, camera(rig.right())?, *rig.cam_right_from_cam_left())
        .map_err(|error| error.to_string())
}
