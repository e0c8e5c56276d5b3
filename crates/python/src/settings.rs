//! What an estimator and a tracker are made with.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use pb3dp_cell::search_range::default_range;
use pb3dp_estimation::estimator::{EstimatorConfig, Method};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_geometry::StereoRig;
use pb3dp_record::value_range::ValueRange;
use pb3dp_setup::estimator::estimator_config;
use pb3dp_wiring::SkewMillis;

/// A range whose nearest depth has less disparity is given in other units, pixels.
const DISPARITY_MIN_PX: f64 = 1.0;

/// Arguments that an estimator and a tracker have in common.
pub struct Asked<'a> {
    pub method: &'a str,
    pub z_range_m: Option<(f64, f64)>,
    pub tilt_max_rad: Option<f64>,
    pub config: Option<PathBuf>,
    pub seed: Option<u64>,
    pub value_range: Option<(u16, u16)>,
}

/// The same, checked.
pub struct Settings {
    pub method: Method,
    pub range: SearchRange,
    pub config: EstimatorConfig,
    pub value_range: Option<ValueRange>,
}

impl Settings {
    /// Checks the arguments; the search range of the rig where none is given.
    ///
    /// # Errors
    /// An unknown method, a file that is refused, a range out of bounds.
    pub fn of(asked: Asked<'_>, rig: &StereoRig) -> Result<Self> {
        let mut range = default_range(rig);
        if let Some((z_min_m, z_max_m)) = asked.z_range_m {
            (range.z_min_m, range.z_max_m) = (z_min_m, z_max_m);
        }
        range.tilt_max_rad = asked.tilt_max_rad.unwrap_or(range.tilt_max_rad);
        range.validate().context("z_range_m is in metres and tilt_max_rad in radians")?;
        let disparity_px = rig.left().pinhole().fx * rig.baseline_m() / range.z_min_m;
        if disparity_px < DISPARITY_MIN_PX {
            let (z_min_m, z_max_m) = (range.z_min_m, range.z_max_m);
            bail!(
                "z_range_m is ({z_min_m}, {z_max_m}), in metres: at {z_min_m} m the views of this rig differ by {disparity_px:.2} px, too little \
                 for a depth; give metres, not millimetres"
            );
        }
        Ok(Self {
            method: Method::from_name(asked.method)?,
            range,
            config: estimator_config(asked.config.as_deref(), asked.seed)?,
            value_range: value_range_of(asked.value_range)?,
        })
    }
}

/// The argument `value_range`.
///
/// # Errors
/// An empty range.
pub fn value_range_of(given: Option<(u16, u16)>) -> Result<Option<ValueRange>> {
    given
        .map(|(low, high)| {
            ValueRange::new(low, high).with_context(|| {
                format!("value_range is ({low}, {high}): the first value must be less than the second")
            })
        })
        .transpose()
}

/// The argument `skew_s`, seconds.
///
/// # Errors
/// More than the program accepts, or not a number.
pub fn skew_of(given_s: Option<f64>) -> Result<Option<f64>> {
    let max_s = SkewMillis::MAX * 1e-3;
    match given_s {
        Some(skew_s) if !(-max_s..=max_s).contains(&skew_s) => {
            bail!("skew_s is {skew_s}: must be between -{max_s} and {max_s} seconds")
        }
        _ => Ok(given_s),
    }
}
