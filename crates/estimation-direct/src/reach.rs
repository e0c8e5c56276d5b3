//! Extent of the surroundings used around a region.

/// Larger regions have a sufficient lever, pixels. Chosen, 50 x 50; no sweep is on record.
pub(super) const AREA_MAX_PX: usize = 2500;

/// Largest extent of the surroundings, pixels: the default of `direct.refine.surroundings_px`. Chosen; no sweep is on record.
pub(super) const REACH_MAX_PX: usize = 16;

/// Additional margin of the windows for filters and gradients. Chosen; no sweep is on record.
pub(super) const MARGIN_PX: usize = 8;
