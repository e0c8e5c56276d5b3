//! Previews: what a region would give as a target, before it is selected. One at a time; the newest request wins.

use std::time::{Duration, Instant};

use nalgebra::Vector2;
use pb3dp_estimation::estimator::{EstimateRequest, Method, Tracker};
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::region::{Region, RegionConfig};
use pb3dp_estimation_core::status::Status;
use pb3dp_hal_api::FramePair;

use crate::about::About;
use crate::drawing::{axes, outline_right};
use crate::hub::Hub;
use crate::messages::{pixels, sigmas};
use crate::preview_job::{Preview, PreviewJob};
use crate::refusal::Refusal;

/// Time between two checks whether the panel ends.
const LOOK: Duration = Duration::from_millis(50);
/// Computing time of one preview; while somebody drags, a late one is worth nothing.
const TIME_MAX: Duration = Duration::from_millis(400);

/// Answers previews until the panel ends.
pub fn run(hub: &Hub) {
    let mut tracker = None;
    while !hub.is_over() {
        let Some(PreviewJob { region, pair, answer }) = hub.previews.wait(LOOK) else { continue };
        if answer.is_closed() {
            continue;
        }
        // Who asked may be gone.
        let _ = answer.send(preview(&hub.about, &mut tracker, &region, &pair));
    }
}

fn preview(
    about: &About,
    tracker: &mut Option<Tracker>,
    region: &Region,
    pair: &FramePair,
) -> Result<Preview, Refusal> {
    let started = Instant::now();
    let unusable = |error: &dyn std::error::Error| Refusal::Region { why: in_words(error) };
    let mut result = Preview {
        will_work: false,
        why: String::new(),
        status: Status::Error.as_str(),
        outline_px: Vec::new(),
        outline_right_px: Vec::new(),
        axes_px: None,
        depth_mm: None,
        sigma_mm: None,
        sigma_deg: None,
        ms: 0.0,
        sequence: pair.sequence,
    };
    let outline_px = match region.rasterize(&pair.left, &RegionConfig::default()) {
        Ok(mask) => region.outline_px(&mask),
        Err(error) => {
            result.why = in_words(&error);
            return Ok(result);
        }
    };
    result.outline_px = pixels(&outline_px);
    // The method of a run: it also accepts surfaces that are not flat.
    let tracker = match tracker {
        Some(tracker) => tracker,
        None => {
            let new = Tracker::new(Method::Direct, &about.stereo, &about.estimator);
            tracker.insert(new.map_err(|error| unusable(&error))?)
        }
    };
    let mut may_continue = || started.elapsed() < TIME_MAX;
    let request = EstimateRequest::of_target(&pair.left, &pair.right, region, &about.range).until(&mut may_continue);
    match tracker.estimate(request) {
        Ok(estimate) => fill(&mut result, about, &estimate, &outline_px),
        Err(error) => result.why = in_words(&error),
    }
    result.ms = started.elapsed().as_secs_f64() * 1e3;
    Ok(result)
}

fn fill(result: &mut Preview, about: &About, estimate: &TrackEstimate, outline_px: &[Vector2<f64>]) {
    result.status = estimate.status.as_str();
    result.will_work = estimate.status.depth_is_sure();
    result.why = why(estimate);
    let Some(cam_left_from_model) = &estimate.cam_left_from_model else { return };
    result.depth_mm = Some(cam_left_from_model.translation_m().z * 1e3);
    result.outline_right_px = outline_right(outline_px, &about.stereo, cam_left_from_model);
    [result.axes_px, _] = axes(&about.stereo, cam_left_from_model);
    if let Some((sigma_mm, sigma_deg)) = estimate.covariance.as_ref().and_then(sigmas) {
        (result.sigma_mm, result.sigma_deg) = (Some(sigma_mm), Some(sigma_deg));
    }
}

/// One plain line: what is wrong, the measured reason, the remedy.
fn why(estimate: &TrackEstimate) -> String {
    let reason = &estimate.reason;
    let line = match estimate.status {
        Status::Ok => String::new(),
        Status::WeakTilt => format!("the tilt is not determined: {reason}; choose a larger part with more texture"),
        Status::PartlyObserved => {
            format!("{reason}; choose a part with texture in all directions if the hand is to follow these, too")
        }
        Status::WeakDepth => format!("the depth is not determined: {reason}; choose a larger part with more texture"),
        Status::Ambiguous => format!(
            "two or more poses explain the images equally well: {reason}; choose a larger part, or one without a repeated pattern"
        ),
        Status::NotObservable => {
            format!("the pose cannot be determined: {reason}; choose a part with more texture that both cameras see")
        }
        Status::Miscalibrated | Status::Lost | Status::Error => reason.clone(),
    };
    let warnings = estimate.warnings.iter().map(ToString::to_string);
    let lines = std::iter::once(line).filter(|line| !line.is_empty()).chain(warnings);
    lines.collect::<Vec<_>>().join("; ")
}

/// An error with its causes.
fn in_words(error: &dyn std::error::Error) -> String {
    let mut words = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let text = cause.to_string();
        if !words.ends_with(&text) {
            words = format!("{words}: {text}");
        }
        source = cause.source();
    }
    words
}
