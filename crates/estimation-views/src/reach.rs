//! Extent of the surroundings used around a region.

/// Larger regions have a sufficient lever, pixels: 95 x 95. Chosen with figures: of 191 windows of low texture in real scenes 180 pass, with
/// 2500 px 177; time grows with it.
pub const AREA_MAX_PX: usize = 9000;

/// Larger regions are extended only if most of their pixels support the plane: otherwise a second surface is near. Chosen with figures: with
/// the rule for all sizes 393 of 425 windows of 29 to 41 px pass instead of 395; without it two more of 425 windows across depth edges are
/// wrong and `ok`.
pub const SMALL_PX: usize = 2500;

/// Largest extent of the surroundings, pixels: the default of `direct.refine.surroundings_px`. Chosen with figures: 395 of the small windows
/// pass, with 16 px 391; their normals are off by 1.72 degrees in the median, with 16 px by 1.77, with 40 px by 1.71.
pub const REACH_MAX_PX: usize = 32;

/// Additional margin of the windows for filters and gradients. Chosen by hand, not varied: with less, the outermost
/// surroundings are left out.
pub const MARGIN_PX: usize = 8;
