//! One target through a sequence of pairs: a tracker with the region that was marked for it.

use image::RgbImage;
use pb3dp_estimation::estimator::{FramePrior, Tracker};
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::EstimateRequest;
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;

/// A target that is in none of so many pairs after it was marked is given up: by then its region may show something else.
const TRIES_MAX: u32 = 15;

/// A tracker with its region.
///
/// A tracker that could take nothing from the first pair is given the same region in the pairs that follow, as long as it
/// may still show the target.
pub struct Follower {
    tracker: Tracker,
    range: SearchRange,
    /// The region, once it was marked, and in how many pairs nothing was taken from it.
    marked: Option<(Region, u32)>,
}

impl Follower {
    /// A follower that searches in `range`.
    pub fn new(tracker: Tracker, range: SearchRange) -> Self {
        Self { tracker, range, marked: None }
    }

    /// Whether a region was marked, and was not refused.
    pub fn is_started(&self) -> bool {
        self.marked.is_some()
    }

    /// Its tracker.
    pub fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    /// Looks at the next pair, for as long as `may_continue` says so. The first one needs a `region`; it is not used afterwards.
    ///
    /// # Errors
    /// Images that do not fit the calibration, a region that cannot serve, a bad range, or no region yet.
    pub fn look(
        &mut self,
        left: &RgbImage,
        right: &RgbImage,
        region: Option<&Region>,
        prior: &FramePrior,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Result<TrackEstimate, EstimationError> {
        let Some((region, tries)) = &mut self.marked else {
            let region = region.ok_or(EstimationError::NotStarted)?;
            let estimate = self
                .tracker
                .estimate(EstimateRequest::of_target(left, right, region, &self.range).until(may_continue))?;
            self.marked = Some((region.clone(), 1));
            return Ok(estimate);
        };
        if !self.tracker.wants_region() {
            return self.tracker.estimate(EstimateRequest::of_next(left, right, prior).until(may_continue));
        }
        if *tries == TRIES_MAX {
            return Ok(given_up());
        }
        *tries += 1;
        self.tracker.estimate(EstimateRequest::of_target(left, right, region, &self.range).until(may_continue))
    }
}

fn given_up() -> TrackEstimate {
    let reason =
        format!("no target was found in its region in {TRIES_MAX} pairs: mark it again where it is seen better");
    TrackEstimate::without_pose(Status::Lost, reason)
}
