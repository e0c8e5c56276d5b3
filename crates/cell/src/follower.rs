//! Tracks one target through a sequence of pairs, with the region that was marked for it.

use pb3dp_estimation::estimator::{FramePrior, Method, Tracker};
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::image_view::ImageView;
use pb3dp_estimation_core::method::{EstimateRequest, KnownModel};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_core::status::Status;
use pb3dp_setup::setup::Setup;

use crate::calibration_share::term_of_setup;

/// Number of pairs without initialisation after which the target is given up: its region may show something else by then.
const TRIES_MAX: u32 = 15;

/// A tracker with its region.
///
/// If the first pair does not initialise the tracker, the following pairs are tried with the same region while it may still show the
/// target.
pub struct Follower {
    tracker: Tracker,
    range: SearchRange,
    /// The marked region, and the number of pairs in which initialisation failed.
    marked: Option<(Region, u32)>,
    /// The frame `model` of the next target, in the pair in which it is initialised.
    model: Option<KnownModel>,
    /// Why the target was not found in the pair in which its frame is known.
    gone: Option<String>,
}

impl Follower {
    /// A follower with the search range `range`.
    pub fn new(tracker: Tracker, range: SearchRange) -> Self {
        Self { tracker, range, marked: None, model: None, gone: None }
    }

    /// A follower with the cameras and the parameters of a setup.
    ///
    /// # Errors
    /// A parameter out of its range.
    pub fn of_setup(setup: &Setup, method: Method) -> Result<Self, EstimationError> {
        let tracker = Tracker::new(method, &setup.rig.stereo, &setup.estimator)?;
        Ok(Self::new(tracker.with_calibration(term_of_setup(setup)), setup.range))
    }

    /// Whether a region was marked and accepted.
    pub fn is_started(&self) -> bool {
        self.marked.is_some()
    }

    /// Drops the target.
    pub fn forget(&mut self) {
        self.marked = None;
    }

    /// The next target had this frame `model` in the pair in which it will be initialised.
    pub fn restore(&mut self, model: Option<KnownModel>) {
        self.model = model;
    }

    /// For pairs whose skew is stated, see [`Tracker::check_skew`].
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn check_skew(&mut self) -> Result<(), EstimationError> {
        self.tracker.check_skew()
    }

    /// For pairs whose skew nobody has stated, see [`Tracker::watch_skew`].
    ///
    /// # Errors
    /// A rig that cannot be rectified.
    pub fn watch_skew(&mut self, is_wanted: bool) -> Result<(), EstimationError> {
        self.tracker.watch_skew(is_wanted)
    }

    /// Its tracker.
    pub fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    /// Processes the next pair while `may_continue` returns true. The first pair needs a `region`; a later region marks another target.
    ///
    /// # Errors
    /// Images that do not match the calibration, an unsuitable region, a bad range, or no region yet.
    pub fn look<'a>(
        &mut self,
        left: impl Into<ImageView<'a>>,
        right: impl Into<ImageView<'a>>,
        region: Option<&Region>,
        prior: &FramePrior,
        may_continue: &mut dyn FnMut() -> bool,
    ) -> Result<TrackEstimate, EstimationError> {
        let (left, right) = (left.into(), right.into());
        if let Some(region) = region {
            let model = self.model.take();
            let estimate = self.tracker.estimate(
                EstimateRequest::new_target(left, right, region, &self.range)
                    .with_model(model.as_ref())
                    .with_skew(prior.skew_s)
                    .until(may_continue),
            )?;
            self.marked = Some((region.clone(), 1));
            // In a later pair nobody knows where its frame is.
            self.gone = (model.is_some() && self.tracker.needs_new_region()).then(|| estimate.reason.clone());
            return Ok(estimate);
        }
        let Some((region, tries)) = &mut self.marked else { return Err(EstimationError::NotStarted) };
        if !self.tracker.needs_new_region() {
            return self.tracker.estimate(EstimateRequest::next_frame(left, right, prior).until(may_continue));
        }
        if let Some(reason) = &self.gone {
            return Ok(TrackEstimate::without_pose(Status::Lost, reason.clone()));
        }
        if *tries == TRIES_MAX {
            return Ok(given_up());
        }
        *tries += 1;
        self.tracker.estimate(
            EstimateRequest::new_target(left, right, region, &self.range).with_skew(prior.skew_s).until(may_continue),
        )
    }
}

fn given_up() -> TrackEstimate {
    let reason = format!("no target found in its region in {TRIES_MAX} pairs: mark it again in a clearer view");
    TrackEstimate::without_pose(Status::Lost, reason)
}
