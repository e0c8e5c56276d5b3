//! What the estimators refuse.

/// Why an estimation part was refused; no pose found is a value, not an error.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EstimationError {
    /// A parameter is out of its range.
    #[error("{name} is {value}: {expected}")]
    Parameter {
        /// Which parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        expected: &'static str,
    },
    /// An image has another size than the calibration says.
    #[error(
        "the {eye} image is {width}x{height}, its calibration is for {expected_width}x{expected_height}: use the calibration of this image size"
    )]
    ImageSize {
        /// Which camera.
        eye: &'static str,
        /// Columns found.
        width: usize,
        /// Rows found.
        height: usize,
        /// Columns of the calibration.
        expected_width: usize,
        /// Rows of the calibration.
        expected_height: usize,
    },
    /// The images still carry lens distortion.
    #[error("the {eye} camera has lens distortion: undistort or rectify the images and use the resulting rig")]
    Distorted {
        /// Which camera.
        eye: &'static str,
    },
    /// The model has no point that can vote.
    #[error("the photo model has no usable point: {inner} inner and {outer} outer points have a hue")]
    EmptyModel {
        /// Inner points with a hue.
        inner: usize,
        /// Outer points with a hue.
        outer: usize,
    },
    /// The region was refused.
    #[error(transparent)]
    Region(#[from] crate::region::RegionError),
    /// An image could not be undistorted.
    #[error("undistortion failed")]
    Remap(#[from] pb3dp_geometry::maps::RemapError),
    /// The rig has no common image plane.
    #[error("the pair cannot be rectified")]
    Rectification(#[from] pb3dp_geometry::RectificationError),
    /// A pixel has no ray, or a camera is malformed.
    #[error(transparent)]
    Camera(#[from] pb3dp_geometry::CameraError),
    /// No method of that name.
    #[error("there is no method \"{name}\": known methods are {known}")]
    UnknownMethod {
        /// The name asked for.
        name: String,
        /// The names that exist.
        known: String,
    },
    /// A tracker was asked for the next frame before the first.
    #[error("there is no target yet: the first request has to mark one")]
    NotStarted,
    /// A method for single pairs was asked for a tracker.
    #[error("the method {method} answers for single pairs only: choose another one for sequences")]
    OnlyPairs {
        /// Its name.
        method: &'static str,
    },
}

/// Refuses a parameter that is not finite or outside `[min, max]`.
pub fn check_range(
    name: &'static str,
    value: f64,
    (min, max): (f64, f64),
    expected: &'static str,
) -> Result<(), EstimationError> {
    if value.is_finite() && value >= min && value <= max {
        Ok(())
    } else {
        Err(EstimationError::Parameter { name, value, expected })
    }
}
