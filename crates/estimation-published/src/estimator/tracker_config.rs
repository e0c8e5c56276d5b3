//! Parameters of the tracker.

use pb3dp_geometry::ranges;

/// Parameters of region tracking and of the loss criteria. The paper states none of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerConfig {
    /// Margin by which the region is enlarged to search the target's pixels, pixels, 1 to 200. Default 8.
    pub window_margin_px: u32,
    /// Largest number of mean-shift steps, 1 to 100. Default 8.
    pub shift_steps_max: usize,
    /// Largest motion of the region per frame (0 to 2), in addition to the known motion, as a share of the square root of its
    /// area. Default 0.3.
    pub shift_max_share: f64,
    /// Smallest mean weight of the region's pixels in the first frame for re-centring: the target's hues must differ from those
    /// around it. 0 to 1. Default 0.2.
    pub contrast_min: f64,
    /// Smallest share of the expected target pixels (from the first frame) that must be found, 0 to 1; below: `lost`. Default
    /// 0.35.
    pub mass_share_min: f64,
    /// Smallest share of the region inside the image, 0 to 1; below: `lost`. Default 0.5.
    pub visible_share_min: f64,
    /// Largest relative spread of the depth, 0 to 1; above: `ambiguous`. It is larger than for single pairs, because continuity
    /// rules out the other peaks, and downstream stages filter over time. Default 0.03.
    pub depth_spread_sure: f64,
    /// Smallest fitness, as a share of the height of the first frame's fitness above the median of the search range, 0 to 1;
    /// below: `lost`. Default 0.4.
    pub height_share_min: f64,
    /// Number of frames after the start, or after being found again, within which the depth must become confident (by a survey
    /// of the whole search range). Otherwise the target is dropped and stays lost until it is marked again, because the region
    /// may then show something else. 1 to 10000. Default 15.
    pub assure_frames_max: u32,
}

impl Default for TrackerConfig {
    fn default() -> Self {
        Self {
            window_margin_px: 8,
            shift_steps_max: 8,
            shift_max_share: 0.3,
            contrast_min: 0.2,
            mass_share_min: 0.35,
            visible_share_min: 0.5,
            depth_spread_sure: 0.03,
            height_share_min: 0.4,
            assure_frames_max: 15,
        }
    }
}

impl TrackerConfig {
    ranges! {
        pub(super) fn validate "tracker ";
        window_margin_px, WINDOW_MARGIN_PX: u32 = 1..=200;
        shift_steps_max, SHIFT_STEPS_MAX: usize = 1..=100;
        shift_max_share, SHIFT_MAX_SHARE: f64 = 0.0..=2.0;
        contrast_min, CONTRAST_MIN: f64 = 0.0..=1.0;
        mass_share_min, MASS_SHARE_MIN: f64 = 0.0..=1.0;
        visible_share_min, VISIBLE_SHARE_MIN: f64 = 0.0..=1.0;
        depth_spread_sure, DEPTH_SPREAD_SURE: f64 = 0.0..=1.0;
        height_share_min, HEIGHT_SHARE_MIN: f64 = 0.0..=1.0;
        assure_frames_max, ASSURE_FRAMES_MAX: u32 = 1..=10_000;
    }
}
