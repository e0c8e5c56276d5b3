//! Parameters of the tracker.

use pb3dp_estimation_core::error::{EstimationError, check_range};

/// How the region is carried along, and when the target counts as lost. None of this is stated in the paper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackerConfig {
    /// The window in which the target's pixels are looked for is the region grown by this much, pixels, 1 to 200.
    /// Default 8.
    pub window_margin_px: u32,
    /// Most steps of the mean shift, 1 to 100. Default 8.
    pub shift_steps_max: usize,
    /// The region moves by at most this share of the square root of its area per frame, beyond the known motion, 0 to 2.
    /// Default 0.3.
    pub shift_max_share: f64,
    /// The region is re-centred only if the mean weight of its pixels in the first frame reaches this: the target's hues
    /// must differ from those around it. 0 to 1. Default 0.2.
    pub contrast_min: f64,
    /// Lost if fewer of the target's pixels are found, as a share of what the first frame lets expect, 0 to 1. Default 0.35.
    pub mass_share_min: f64,
    /// Lost if less of the region lies inside the image, as a share, 0 to 1. Default 0.5.
    pub visible_share_min: f64,
    /// Ambiguous if the depth is determined worse than to this share, 0 to 1. Wider than for single pairs: the other peaks are
    /// ruled out by continuity, and what follows filters over time. Default 0.03.
    pub depth_spread_sure: f64,
    /// Lost if the fitness falls below the first frame's median of the search range plus this share of its height above
    /// that median, 0 to 1. Default 0.4.
    pub height_share_min: f64,
    /// The target is given up, and stays lost until it is marked again, if its depth is not sure (by a survey of the whole
    /// search range) within this many frames of its start or of being found again: what the region shows by then may be
    /// something else. 1 to 10000. Default 15.
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
    pub(super) fn validate(&self) -> Result<(), EstimationError> {
        let share = |name, value| check_range(name, value, (0.0, 1.0), "must be between 0 and 1");
        let margin = f64::from(self.window_margin_px);
        check_range("tracker window_margin_px", margin, (1.0, 200.0), "must be between 1 and 200")?;
        let steps = self.shift_steps_max as f64;
        check_range("tracker shift_steps_max", steps, (1.0, 100.0), "must be between 1 and 100")?;
        check_range("tracker shift_max_share", self.shift_max_share, (0.0, 2.0), "must be between 0 and 2")?;
        share("tracker contrast_min", self.contrast_min)?;
        share("tracker mass_share_min", self.mass_share_min)?;
        share("tracker visible_share_min", self.visible_share_min)?;
        share("tracker depth_spread_sure", self.depth_spread_sure)?;
        share("tracker height_share_min", self.height_share_min)?;
        let frames = f64::from(self.assure_frames_max);
        check_range("tracker assure_frames_max", frames, (1.0, 1e4), "must be between 1 and 10000")
    }
}
