//! What images are like: brightness, sharpness, and by how much rows of both cameras are off.

use pb3dp_estimation::estimator::{Estimator, EstimatorConfig, Method, RowMeasurement};
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_geometry::{ImageSize, StereoRig};
use pb3dp_hal_api::FramePair;

pub use pb3dp_record::image_quality::{
    BRIGHT, DARK, EDGE_MIN_GREY, EDGES_MIN, Exposure, blur_of, brighter_by_percent, softer_by_px,
};

/// As many points must be found again in the other image; with fewer nothing is measured (`row_measurement.rs`).
pub const MATCHES_MIN: usize = 15;

/// What measures by how much rows of right images are off, somewhere in the images of a rig.
pub struct RowMeter {
    estimator: Estimator,
    size: ImageSize,
}

impl RowMeter {
    /// For images of this rig.
    ///
    /// # Errors
    /// A rig that the method `direct` cannot use.
    pub fn new(rig: &StereoRig) -> Result<Self, EstimationError> {
        let estimator = Estimator::new(Method::Direct, rig, &EstimatorConfig::default())?;
        Ok(Self { estimator, size: rig.right().size() })
    }

    /// What the rows of a pair are like; `matches` of it tells on how much that rests.
    ///
    /// # Errors
    /// Images that do not fit the calibration.
    pub fn measure(&mut self, pair: &FramePair) -> Result<RowMeasurement, EstimationError> {
        self.estimator.prepare(&pair.left, &pair.right).map(Option::unwrap_or_default)
    }

    /// By how much rows are off where they are off most, pixels.
    pub fn worst_px(&self, measured: &RowMeasurement) -> f64 {
        measured.rows.magnitude_max_px(self.size.width, self.size.height)
    }
}
