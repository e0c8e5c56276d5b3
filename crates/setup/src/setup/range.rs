//! The search range of a method: keys of the table `[estimator]`.

use pb3dp_estimation_core::plane_hypothesis::SearchRange;

use super::super::load::{Checker, ConfigFile, within};

const KEYS: [&str; 3] = ["estimator.z_min_mm", "estimator.z_max_mm", "estimator.tilt_max_deg"];

/// The range with these values, checked.
pub(super) fn search_range([z_min_mm, z_max_mm, tilt_max_deg]: [f64; 3], check: &mut Checker) -> SearchRange {
    check.number(KEYS[0], z_min_mm, 10.0..=100_000.0);
    check.number(KEYS[1], z_max_mm, within(z_min_mm, 10.0, 99_999.0) + 1.0..=100_000.0);
    check.number(KEYS[2], tilt_max_deg, 1.0..=85.0);
    let range =
        SearchRange { z_min_m: z_min_mm * 1e-3, z_max_m: z_max_mm * 1e-3, tilt_max_rad: tilt_max_deg.to_radians() };
    if let (true, Err(error)) = (check.is_clean(), range.validate()) {
        check.refuse(format!("estimator: {error}"));
    }
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
