//! Requests for previews and their answers.

use std::sync::Arc;

use pb3dp_cell::handover::Newest;
use pb3dp_estimation_core::region::Region;
use pb3dp_hal_api::FramePair;
use serde::Serialize;
use tokio::sync::oneshot;

use crate::messages::{Pixel, Triple};
use crate::refusal::Refusal;

/// A preview, in the units of the messages.
#[derive(Clone, Debug, Serialize)]
pub struct Preview {
    /// Whether the region can be tracked.
    pub will_work: bool,
    /// Why not, or what will be weak; empty if all is well.
    pub why: String,
    /// Status of the estimate.
    pub status: &'static str,
    /// Outline of the segmented region in the left image.
    pub outline_px: Vec<Pixel>,
    /// The same in the right image.
    pub outline_right_px: Vec<Pixel>,
    /// Origin and ends of the axes in the left image.
    pub axes_px: Option<[Pixel; 4]>,
    /// Distance.
    pub depth_mm: Option<f64>,
    /// Expected standard deviation of the position.
    pub sigma_mm: Option<Triple>,
    /// Expected standard deviation of the orientation.
    pub sigma_deg: Option<Triple>,
    /// Processor time of the preview.
    pub ms: f64,
    /// The pair.
    pub sequence: u64,
}

/// A request for a preview.
pub struct PreviewJob {
    /// The region.
    pub region: Region,
    /// The pair on which it was drawn.
    pub pair: Arc<FramePair>,
    /// Takes the answer; dropped if a newer request replaces this one.
    pub answer: oneshot::Sender<Result<Preview, Refusal>>,
}

/// The newest request.
pub type PreviewJobs = Newest<PreviewJob>;
