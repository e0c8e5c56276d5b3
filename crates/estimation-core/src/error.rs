//! Errors of the estimators.

use crate::image_view::ImageView;
use pb3dp_geometry::StereoRig;
use pb3dp_geometry::ranges::OutOfRange;
use pb3dp_message_codes::Argument;

/// Why an estimation request was rejected. A pose that cannot be determined is not an error but a [`crate::status::Status`].
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EstimationError {
    /// A parameter is out of its range.
    #[error("{name} is {value}: {expected}")]
    Parameter {
        /// Name of the parameter.
        name: &'static str,
        /// Its value.
        value: String,
        /// The allowed range.
        expected: String,
    },
    /// The image size differs from the image size of the calibration.
    #[error(
        "the {side} image is {width}x{height}, but its calibration is for {expected_width}x{expected_height}: use the calibration of this image size"
    )]
    ImageSize {
        /// Which camera.
        side: &'static str,
        /// Width of the image, pixels.
        width: usize,
        /// Height of the image, pixels.
        height: usize,
        /// Width in the calibration, pixels.
        expected_width: usize,
        /// Height in the calibration, pixels.
        expected_height: usize,
    },
    /// The images still carry lens distortion.
    #[error("the {side} camera has lens distortion: undistort or rectify the images and use the resulting rig")]
    Distorted {
        /// Which camera.
        side: &'static str,
    },
    /// The photo model has no point with a hue.
    #[error("the photo model has no usable point: {inner} inner and {outer} outer points have a hue")]
    EmptyModel {
        /// Inner points with a hue.
        inner: usize,
        /// Outer points with a hue.
        outer: usize,
    },
    /// The region was rejected.
    #[error(transparent)]
    Region(#[from] crate::region::RegionError),
    /// An image could not be undistorted.
    #[error("undistortion failed")]
    Remap(#[from] pb3dp_geometry::maps::RemapError),
    /// The rig has no common image plane.
    #[error("the pair cannot be rectified")]
    Rectification(#[from] pb3dp_geometry::RectificationError),
    /// A pixel has no ray, or a camera model is invalid.
    #[error(transparent)]
    Camera(#[from] pb3dp_geometry::CameraError),
    /// There is no method of this name.
    #[error("there is no method \"{name}\": known methods are {known}")]
    UnknownMethod {
        /// The requested name.
        name: String,
        /// The names of the existing methods.
        known: String,
    },
    /// A tracker received a frame before any target was marked.
    #[error("no target yet: mark a target in the first request")]
    NotStarted,
    /// Too few pixels of a region have a match for a visible surface.
    #[error(
        "{matched_percent:.0} % of the region's pixels have a match in the right image, by chance or not, a surface needs {needed_percent:.0} %: check the depth \
         range ({}), the calibration, whether left and right are exchanged, and the texture of the region",
        Argument::DepthRange
    )]
    NoSurface {
        /// Share of the pixels that have a match.
        matched_percent: f64,
        /// The share that is needed.
        needed_percent: f64,
    },
    /// A tracker was requested for a method that estimates single pairs only.
    #[error("the method {method} estimates single pairs only and cannot track: choose another method for sequences")]
    OnlyPairs {
        /// Name of the method.
        method: &'static str,
    },
}

impl From<OutOfRange> for EstimationError {
    fn from(OutOfRange { name, value, min, max }: OutOfRange) -> Self {
        Self::Parameter { name, value, expected: format!("must be between {min} and {max}") }
    }
}

/// Rejects raw images with a size other than the calibration's.
///
/// # Errors
/// [`EstimationError::ImageSize`] with the camera and both sizes.
pub fn check_image_sizes(rig: &StereoRig, left: ImageView<'_>, right: ImageView<'_>) -> Result<(), EstimationError> {
    for (side, image, camera) in [("left", left, rig.left()), ("right", right, rig.right())] {
        let expected = camera.size();
        if image.width() != expected.width || image.height() != expected.height {
            return Err(EstimationError::ImageSize {
                side,
                width: image.width() as usize,
                height: image.height() as usize,
                expected_width: expected.width as usize,
                expected_height: expected.height as usize,
            });
        }
    }
    Ok(())
}
