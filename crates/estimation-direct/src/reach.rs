//! How far the surroundings of a region are used.

/// Regions with more pixels have lever enough. Chosen, 50 x 50; no sweep is on record.
pub(super) const AREA_MAX_PX: usize = 2500;

/// Farthest that the surroundings reach, pixels: the default of `direct.refine.surroundings_px`. Chosen; no sweep is on record.
pub(super) const REACH_MAX_PX: usize = 16;

/// So much farther must the windows reach, for filters and gradients. Chosen; no sweep is on record.
pub(super) const MARGIN_PX: usize = 8;
