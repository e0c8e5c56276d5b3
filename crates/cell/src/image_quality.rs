//! Image quality: brightness, sharpness, and vertical misalignment between the cameras.

use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method, RowMeasurement};
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_geometry::{ImageSize, StereoRig};
use pb3dp_hal_api::FramePair;

pub use pb3dp_record::image_quality::{
    BRIGHT, DARK, EDGE_MIN_GREY, EDGES_MIN, Exposure, blur_of, brighter_by_percent, softer_by_px,
};

/// Least number of matched points for a measurement (`row_measurement.rs`).
pub const MATCHES_MIN: usize = 15;

/// Measures the vertical misalignment of the right images of a rig.
pub struct RowMeter {
    estimator: Estimator,
    size: ImageSize,
}

impl RowMeter {
    /// A meter for images of this rig.
    ///
    /// # Errors
    /// A rig that the method `direct` cannot use.
    pub fn new(rig: &StereoRig) -> Result<Self, EstimationError> {
        let estimator = Estimator::new(Method::Direct, rig, &EstimatorConfig::default())?;
        Ok(Self { estimator, size: rig.right().size() })
    }

    /// Measures the vertical misalignment of a pair; `matches` is the number of points it is based on.
    ///
    /// # Errors
    /// Images that do not match the calibration.
    pub fn measure(&mut self, pair: &FramePair) -> Result<RowMeasurement, EstimationError> {
        self.estimator.prepare(&pair.left, &pair.right).map(Option::unwrap_or_default)
    }

    /// Largest vertical misalignment in the image, pixels.
    pub fn worst_px(&self, measured: &RowMeasurement) -> f64 {
        measured.rows.magnitude_max_px(self.size.width, self.size.height)
    }
}
