//! The depths and tilts that a search covers if nobody states others.

use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::StereoRig;
use pb3dp_record::dataset;

/// Default tilt range, degrees.
const TILT_MAX_DEFAULT_DEG: f64 = 60.0;

/// Shares of the width of the image: disparities at the nearest and at the farthest depth of the default range.
const DISPARITY_SHARES: [f64; 2] = [0.35, 0.05];

/// Depths at which the disparity is 5 to 35 % of the image's width.
pub fn default_range(rig: &StereoRig) -> SearchRange {
    let focal_baseline = rig.left().pinhole().fx * rig.baseline_m();
    let width = f64::from(rig.left().size().width);
    let [z_min_m, z_max_m] = DISPARITY_SHARES.map(|share| focal_baseline / (share * width));
    SearchRange { z_min_m, z_max_m, tilt_max_rad: TILT_MAX_DEFAULT_DEG.to_radians() }
}

/// Search range of a case or sequence, in the units of the estimator.
pub fn range_of_dataset(range: &dataset::SearchRange) -> SearchRange {
    SearchRange { z_min_m: range.z_min_m, z_max_m: range.z_max_m, tilt_max_rad: range.tilt_max_rad }
}
