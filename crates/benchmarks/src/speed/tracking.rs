//! Frames of the tracker: stereo pair in, six degrees of freedom with covariance out.

use anyhow::{Context, bail};
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::estimate::TrackEstimate;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod, FramePrior};
use pb3dp_estimation_core::status::Status;
use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_track::{DirectTracker, DirectTrackerConfig};
use serde_json::{Value, json};

use super::clips::{Clip, SEARCH, crab, empty_place};
use super::cold::{SIZE, kernel_row};
use super::times::Times;
use pb3dp_hal_platform::cpu_time::timed;

/// Points of the model.
pub const POINTS: usize = 1000;
/// Rendered frames of the moving target.
const FRAMES: usize = 45;
/// Rendered frames without the target.
const FRAMES_EMPTY: usize = 4;
/// Warm-up frames.
const WARM_UP: usize = 10;

/// A tracker running on a clip.
pub struct Follower {
    tracker: DirectTracker,
    estimate: TrackEstimate,
    frame: usize,
}

impl Follower {
    /// Starts on region `index` of the first pair. The status must be confident.
    ///
    /// # Errors
    /// If the target is not found: there is nothing to measure.
    pub fn start(clip: &Clip, index: usize, points: usize, kernels: Kernels) -> anyhow::Result<Self> {
        let track = DirectTrackerConfig { points, ..DirectTrackerConfig::default() };
        let mut tracker = DirectTracker::with_kernels(&clip.rig, DirectConfig::default(), track, kernels)?;
        let region = clip.regions.get(index).context("the clip has no such region")?;
        let (left, right) = clip.pair(0);
        let estimate = tracker.estimate(EstimateRequest::new_target(left, right, region, &SEARCH))?;
        if estimate.status != Status::Ok {
            bail!("the start of region {index} is {}: {}", estimate.status.as_str(), estimate.reason);
        }
        Ok(Self { tracker, estimate, frame: 0 })
    }

    /// Processes the next frame of the clip: the status, and the CPU time in milliseconds.
    ///
    /// # Errors
    /// Errors of the tracker.
    pub fn step(&mut self, clip: &Clip) -> anyhow::Result<(Status, f64)> {
        self.frame += 1;
        let (left, right) = clip.pair(self.frame);
        let prior = FramePrior { dt_s: Some(1.0 / 30.0), ..FramePrior::default() };
        let (outcome, ms) = timed(|| {
            self.tracker.follow_into(&mut EstimateRequest::next_frame(left, right, &prior), &mut self.estimate)
        });
        outcome?;
        Ok((self.estimate.status, ms))
    }

    /// Like [`Self::step`], but requires that the target is tracked.
    ///
    /// # Errors
    /// If the target was lost.
    pub fn follow(&mut self, clip: &Clip) -> anyhow::Result<f64> {
        let (status, ms) = self.step(clip)?;
        match status {
            Status::Ok => Ok(ms),
            _ => bail!("frame {} is {}: {}", self.frame, status.as_str(), self.estimate.reason),
        }
    }
}

/// Times of the frames of several trackers in turn, so that other load affects all of them alike.
///
/// # Errors
/// If a target was lost.
pub fn follow_in_turn(followers: &mut [Follower], clip: &Clip, rounds: usize) -> anyhow::Result<Vec<Vec<f64>>> {
    let mut samples = vec![Vec::with_capacity(rounds); followers.len()];
    for frame in 0..WARM_UP + rounds {
        for (follower, samples) in followers.iter_mut().zip(&mut samples) {
            let ms = follower.follow(clip)?;
            if frame >= WARM_UP {
                samples.push(ms);
            }
        }
    }
    Ok(samples)
}

/// Tracks the moving crab, then searches all stored views for it in images without the crab; also the time of the first frame, with cold
/// start and model.
///
/// # Errors
/// If simulator or tracker rejects the setup, or the target is lost.
pub fn tracking(rounds: usize) -> anyhow::Result<Value> {
    let clip = crab(SIZE, FRAMES)?;
    let (follower, start_ms) = timed(|| Follower::start(&clip, 0, POINTS, Kernels::best()));
    let mut followers = [follower?];
    let followed = follow_in_turn(&mut followers, &clip, rounds)?.concat();
    let empty = empty_place(SIZE, FRAMES_EMPTY)?;
    let mut lost = Vec::new();
    for frame in 0..WARM_UP + rounds / 4 {
        let (status, ms) = followers[0].step(&empty)?;
        if frame >= WARM_UP && status == Status::Lost {
            lost.push(ms);
        }
    }
    let times = Times::of(&followed).zip(Times::of(&lost));
    let (followed, lost) = times.context("the tracker never tracked the target, or never lost the absent target")?;
    Ok(json!({ "points": POINTS, "followed": followed.to_json(), "lost": lost.to_json(), "start_ms": start_ms }))
}

/// A tracking frame with every available family of kernels.
///
/// # Errors
/// Those of [`tracking`].
pub fn kernels(rounds: usize) -> anyhow::Result<Value> {
    let clip = crab(SIZE, FRAMES)?;
    let families: Vec<Kernels> = Kernels::available().collect();
    let followers = families.iter().map(|kernels| Follower::start(&clip, 0, POINTS, *kernels));
    let samples = follow_in_turn(&mut followers.collect::<anyhow::Result<Vec<_>>>()?, &clip, rounds)?;
    let ns = families.iter().zip(&samples).map(|(kernels, samples)| {
        let times = Times::of(samples).context("no frame was counted")?;
        Ok((kernels.set(), times.median_ms * 1e6 / POINTS as f64))
    });
    Ok(kernel_row("tracking frame", "point of the model", ns.collect::<anyhow::Result<Vec<_>>>()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_crab_is_followed_and_missed_where_it_is_not() {
        let row = tracking(20).expect("measures");
        assert_eq!((&row["followed"]["count"], &row["lost"]["count"]), (&20.into(), &5.into()));
        assert!(row["start_ms"].as_f64() > Some(0.0) && row["followed"]["min_ms"].as_f64() > Some(0.0));
    }
}
