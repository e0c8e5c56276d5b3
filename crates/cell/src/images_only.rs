//! Estimation on a stream of pairs without arms: recorded images, or cameras that nothing carries.

use std::sync::Arc;
use std::time::Duration;

use anyhow::Result;
use pb3dp_estimation::estimator::FramePrior;
use pb3dp_estimation_core::error::EstimationError;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::status::Status;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraErrorKind, Clock, FramePair, StereoCamera};
use pb3dp_servo::supervisor::FrameInput;

use crate::capturing::Captured;
use crate::estimate_log::PairEstimate;
use crate::follower::Follower;
use crate::losses::Losses;
use crate::perception::{NOT_SELECTED, View};
use crate::selection::{Choice, Selection, Selections};
use crate::spectator::Spectator;

/// Longest wait for a pair, so that the end of the program is noticed.
const CALL_TIMEOUT: Duration = Duration::from_millis(250);

/// Estimation of the target that is selected, for a spectator.
pub struct ImagesOnly {
    /// The method.
    pub follower: Follower,
    /// Targets that a person selects.
    pub selections: Selections,
    /// Receives each pair with its estimate.
    pub spectator: Box<dyn Spectator>,
    /// The clock of the camera.
    pub clock: Arc<dyn Clock>,
}

/// Progress of the estimation.
struct Progress {
    target: u64,
    before: Option<MonotonicTime>,
}

impl ImagesOnly {
    /// Estimates until `is_over` returns true. Pairs that do not arrive or are damaged are counted and reported; the stream goes on.
    ///
    /// # Errors
    /// A camera that cannot go on.
    pub fn run(mut self, camera: &mut dyn StereoCamera, is_over: &mut dyn FnMut() -> bool) -> Result<()> {
        let mut progress = Progress { target: 0, before: None };
        let mut losses = Losses::default();
        while !is_over() {
            let mut pair = FramePair::black(camera.info().size);
            match camera.next_pair_into(&mut pair, CALL_TIMEOUT) {
                Ok(()) => {
                    if let Some(line) = losses.pair_has_come() {
                        tracing::info!("{line}");
                    }
                    let pair_estimate = self.look(Arc::new(pair), &mut progress);
                    self.spectator.estimated(&pair_estimate);
                }
                Err(error) if matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair) => {
                    if let Some(line) = losses.add(&error.to_string()) {
                        tracing::warn!("{line}");
                    }
                }
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    fn look(&mut self, pair: Arc<FramePair>, progress: &mut Progress) -> PairEstimate {
        let started = self.clock.now();
        let selection = match self.selections.take() {
            Some(Choice::Marked(selection)) => Some(selection),
            // There is no setup.
            Some(Choice::OfSetup) | None => None,
        };
        progress.target += u64::from(selection.is_some());
        let before = progress.before.replace(pair.exposed_at);
        let dt_s = before.map(|before| pair.exposed_at.seconds_since(before));
        let prior = FramePrior { dt_s, skew_s: pair.skew_s(), ..FramePrior::default() };
        let estimate = match &selection {
            Some(selection) => self.select(selection, &pair, &prior),
            None if self.follower.is_started() => self.track(&pair, &prior),
            None => Ok(TrackEstimate::without_pose(Status::Lost, NOT_SELECTED.to_owned())),
        };
        let estimate = estimate.unwrap_or_else(|refusal| {
            self.follower.forget();
            TrackEstimate::without_pose(Status::NotObservable, refusal.to_string())
        });
        let frame = FrameInput { sequence: pair.sequence, at: pair.exposed_at, skew_s: pair.skew_s() };
        let now = self.clock.now();
        let millis_since = |time: MonotonicTime| now.saturating_since(time).as_secs_f64() * 1e3;
        let (latency_millis, age_millis) = (millis_since(started), millis_since(pair.exposed_at));
        PairEstimate {
            captured: Captured { frame, cam_left_from_target: None, view: View::Images(pair) },
            steps: 0,
            chosen: None,
            target: progress.target,
            region: selection.map(|selection| selection.region),
            prior,
            estimate,
            target_from_plane: None,
            latency_millis,
            age_millis,
        }
    }

    fn select(
        &mut self,
        selection: &Selection,
        pair: &FramePair,
        prior: &FramePrior,
    ) -> Result<TrackEstimate, EstimationError> {
        let drawn_on = selection.drawn_on.as_deref().filter(|drawn_on| drawn_on.sequence != pair.sequence);
        self.follower.restore(selection.model.as_deref().filter(|_| selection.drawn_on.is_some()).copied());
        let (first, region) = (drawn_on.unwrap_or(pair), Some(&selection.region));
        let started = self.follower.look(&first.left, &first.right, region, &FramePrior::default(), &mut || true)?;
        if drawn_on.is_some() { self.track(pair, prior) } else { Ok(started) }
    }

    fn track(&mut self, pair: &FramePair, prior: &FramePrior) -> Result<TrackEstimate, EstimationError> {
        self.follower.look(&pair.left, &pair.right, None, prior, &mut || true)
    }
}
