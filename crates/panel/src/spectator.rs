//! The panel as a spectator of a run: copies what the page shows, the newest only.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use pb3dp_cell::estimate_log::PairEstimate;
use pb3dp_cell::handover::LatestProducer;
use pb3dp_cell::journal::TruePoses;
use pb3dp_cell::moving::StepRecord;
use pb3dp_cell::perception::View;
use pb3dp_cell::selection::Choice;
use pb3dp_cell::spectator::Spectator;
use pb3dp_cell::true_surface::{true_model_frame, turned_as};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_geometry::frames::{CamLeft, Model, Target};
use pb3dp_geometry::{MonotonicTime, Pose};

use crate::pairs::Pairs;

/// The newest estimate, as the panel keeps it.
#[derive(Clone, Debug)]
pub struct NewestEstimate {
    /// Sequence number of the pair.
    pub sequence: u64,
    /// Middle of the left exposure.
    pub at: MonotonicTime,
    /// Number of the target; `None` before a target was selected.
    pub target: Option<u64>,
    /// The estimate.
    pub estimate: TrackEstimate,
    /// Wall time of the method, milliseconds.
    pub latency_millis: f64,
    /// True pose, in a simulation.
    pub cam_left_from_target: Option<Pose<CamLeft, Target>>,
    /// True pose of the model: without error in the first estimate on the ray of its origin, then fixed on the target.
    pub cam_left_from_model_true: Option<Pose<CamLeft, Model>>,
}

/// State shared by the spectator and the threads of the panel; the control thread of a live run does not touch it.
#[derive(Default)]
pub struct Watched {
    /// Kept pairs.
    pub pairs: Pairs,
    newest: Mutex<Option<Arc<NewestEstimate>>>,
    /// Number of the target plus one; 0: none.
    target_plus_one: AtomicU64,
    /// Number of marked targets so far.
    pub marked: AtomicU64,
}

impl Watched {
    /// The newest estimate.
    pub fn newest(&self) -> Option<Arc<NewestEstimate>> {
        self.newest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Number of the present target.
    pub fn target(&self) -> Option<u64> {
        self.target_plus_one.load(Ordering::SeqCst).checked_sub(1)
    }
}

/// Copies each step and each estimate.
pub struct PanelSpectator {
    watched: Arc<Watched>,
    steps: LatestProducer<StepRecord>,
    /// Pose of the model on the target, after the first estimate; in a simulation.
    target_from_model: Option<Pose<Target, Model>>,
}

impl PanelSpectator {
    pub(crate) fn new(watched: Arc<Watched>, steps: LatestProducer<StepRecord>) -> Self {
        Self { watched, steps, target_from_model: None }
    }
}

impl Spectator for PanelSpectator {
    fn moved(&mut self, step: &StepRecord, _poses: Option<TruePoses>) {
        self.steps.give(*step);
    }

    fn estimated(&mut self, pair_estimate: &PairEstimate) {
        let PairEstimate { captured, target, region, estimate, latency_millis, .. } = pair_estimate;
        // Without a selected target the number is 0 and there is no pose.
        let target = (*target > 0 || estimate.cam_left_from_model.is_some()).then_some(*target);
        if region.is_some() {
            self.target_from_model = None;
        }
        let poses = estimate.cam_left_from_model.zip(captured.cam_left_from_target);
        if let (None, Some((found, truth))) = (self.target_from_model, poses) {
            let restored =
                matches!(&pair_estimate.chosen, Some(Choice::Marked(selection)) if selection.model.is_some());
            let cam_left_from_model =
                pair_estimate.cam_left_from_plane().and_then(|plane| true_model_frame(&found, &plane));
            // The x axis of a model from before is that of another view.
            let cam_left_from_model =
                cam_left_from_model.map(|pose| if restored { turned_as(&pose, &found) } else { pose });
            self.target_from_model = cam_left_from_model.map(|pose| truth.inverse() * pose);
        }
        let cam_left_from_model_true =
            captured.cam_left_from_target.zip(self.target_from_model).map(|(truth, fixed)| truth * fixed);
        let newest = NewestEstimate {
            sequence: captured.frame.sequence,
            at: captured.frame.at,
            target,
            estimate: estimate.clone(),
            latency_millis: *latency_millis,
            cam_left_from_target: captured.cam_left_from_target,
            cam_left_from_model_true,
        };
        self.watched.target_plus_one.store(target.map_or(0, |target| target + 1), Ordering::SeqCst);
        self.watched.marked.fetch_add(u64::from(region.is_some()), Ordering::SeqCst);
        let newest = Some(Arc::new(newest));
        let before =
            std::mem::replace(&mut *self.watched.newest.lock().unwrap_or_else(PoisonError::into_inner), newest);
        drop(before);
        if let View::Images(pair) = &captured.view {
            self.watched.pairs.push(pair);
        }
    }
}
