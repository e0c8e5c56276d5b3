//! The search range of a method: keys of the table `[estimator]`.

use pb3dp_estimation_core::plane_hypothesis::SearchRange;

use super::super::load::{Checker, ConfigFile};
use super::super::units::{in_deg, in_mm};

const KEYS: [&str; 3] = ["estimator.z_min_mm", "estimator.z_max_mm", "estimator.tilt_max_deg"];

/// The range with these values, checked.
pub(super) fn search_range([z_min_mm, z_max_mm, tilt_max_deg]: [f64; 3], check: &mut Checker) -> SearchRange {
    let range =
        SearchRange { z_min_m: z_min_mm * 1e-3, z_max_m: z_max_mm * 1e-3, tilt_max_rad: tilt_max_deg.to_radians() };
    check.number(KEYS[0], z_min_mm, in_mm(SearchRange::Z_M));
    check.number(KEYS[1], z_max_mm, in_mm(range.z_max_m_allowed()));
    check.number(KEYS[2], tilt_max_deg, in_deg(SearchRange::TILT_MAX_RAD));
    check.together("estimator", range.validate());
    range
}

/// The search range of a setup only; `None` if a key of it is missing.
pub(super) fn read_search_range(config: &ConfigFile, check: &mut Checker) -> Option<SearchRange> {
    let mut values = [0.0; 3];
    for (value, key) in values.iter_mut().zip(KEYS) {
        *value = config.at(key, "")?;
    }
    Some(search_range(values, check))
}
