//! How far the surroundings of a region are used.

/// Regions with more pixels have lever enough.
pub(super) const AREA_MAX_PX: usize = 2500;

/// Farthest that the surroundings reach, pixels.
pub(super) const REACH_MAX_PX: usize = 16;

/// So much farther must the windows reach, for filters and gradients.
pub(super) const MARGIN_PX: usize = 8;
