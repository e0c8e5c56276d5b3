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
use super::cold::{KernelRow, SIZE, kernel_row};
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

/// Times of a tracker.
pub struct TrackingRow {
    /// Frames in which the target was tracked.
    pub followed: Times,
    /// Frames in which the target was lost: all stored views are searched.
    pub lost: Times,
    /// The first frame: cold start and model.
    pub start_ms: f64,
}

impl TrackingRow {
    /// As saved.
    pub fn to_json(&self) -> Value {
        json!({
            "points": POINTS,
            "followed": self.followed.to_json(),
            "lost": self.lost.to_json(),
            "start_ms": self.start_ms,
        })
    }
}

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
        let estimate = tracker.estimate(EstimateRequest::of_target(left, right, region, &SEARCH))?;
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
        let prior = FramePrior::default();
        let (outcome, ms) =
            timed(|| self.tracker.follow_into(&mut EstimateRequest::of_next(left, right, &prior), &mut self.estimate));
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

/// Tracks the moving crab, then searches for it in images without the crab.
///
/// # Errors
/// If simulator or tracker rejects the setup, or the target is lost.
pub fn tracking(rounds: usize) -> anyhow::Result<TrackingRow> {
    let clip = crab(SIZE, FRAMES)?;
    let (follower, start_ms) = timed(|| Follower::start(&clip, 0, POINTS, Kernels::best()));
    let mut follower = follower?;
    let mut followed = Vec::with_capacity(rounds);
    for frame in 0..WARM_UP + rounds {
        let ms = follower.follow(&clip)?;
        if frame >= WARM_UP {
            followed.push(ms);
        }
    }
    let empty = empty_place(SIZE, FRAMES_EMPTY)?;
    let mut lost = Vec::new();
    for frame in 0..WARM_UP + rounds / 4 {
        let (status, ms) = follower.step(&empty)?;
        if frame >= WARM_UP && status == Status::Lost {
            lost.push(ms);
        }
    }
    let times = Times::of(&followed).zip(Times::of(&lost));
    let (followed, lost) = times.context("the tracker never tracked the target, or never lost the absent target")?;
    Ok(TrackingRow { followed, lost, start_ms })
}

/// A tracking frame with every available family of kernels.
///
/// # Errors
/// Those of [`tracking`].
pub fn kernels(rounds: usize) -> anyhow::Result<KernelRow> {
    let clip = crab(SIZE, FRAMES)?;
    let families: Vec<Kernels> = Kernels::available().collect();
    let followers = families.iter().map(|kernels| Follower::start(&clip, 0, POINTS, *kernels));
    let mut followers = followers.collect::<anyhow::Result<Vec<_>>>()?;
    let mut samples = vec![Vec::with_capacity(rounds); followers.len()];
    for frame in 0..WARM_UP + rounds {
        for (follower, samples) in followers.iter_mut().zip(&mut samples) {
            let ms = follower.follow(&clip)?;
            if frame >= WARM_UP {
                samples.push(ms);
            }
        }
    }
    let medians = samples.iter().map(|samples| Times::of(samples).map(|times| times.median_ms));
    let medians = medians.collect::<Option<Vec<f64>>>().context("no frame was counted")?;
    let ns = medians.iter().map(|ms| ms * 1e6 / POINTS as f64);
    Ok(kernel_row("tracking frame", "point of the model", families.iter().map(|kernels| kernels.set()).zip(ns)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_crab_is_followed_and_missed_where_it_is_not() {
        let row = tracking(20).expect("measures");
        assert_eq!((row.followed.count, row.lost.count), (20, 5));
        assert!(row.start_ms > 0.0 && row.followed.min_ms > 0.0);
    }
}
