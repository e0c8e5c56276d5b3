//! Extent of the surroundings used around a region.

/// Larger regions have a sufficient lever, pixels. Chosen by hand, not varied: 50 x 50; with more, more regions take the
/// time of a second refinement.
pub(super) const AREA_MAX_PX: usize = 2500;

/// Largest extent of the surroundings, pixels: the default of `direct.refine.surroundings_px`. Chosen by hand, not varied:
/// time grows with it, and neighbouring surfaces come nearer.
pub(super) const REACH_MAX_PX: usize = 16;

/// Additional margin of the windows for filters and gradients. Chosen by hand, not varied: with less, the outermost
/// surroundings are left out.
pub(super) const MARGIN_PX: usize = 8;
