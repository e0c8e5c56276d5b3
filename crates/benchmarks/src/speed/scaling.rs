//! Scaling of the times: number of points, image size, number of targets, threads.

use anyhow::Context;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_geometry::ImageSize;
use serde_json::{Value, json};

use super::clips::{Clip, SEARCH, square, wall};
use super::cold::SIZE;
use super::times::{Times, repeat};
use super::tracking::{Follower, POINTS, follow_in_turn};

const LARGE: ImageSize = ImageSize { width: 1280, height: 1024 };
const POINTS_TRIED: [usize; 3] = [250, 1000, 4000];
const TARGETS_TRIED: [usize; 4] = [1, 2, 4, 8];
const THREADS_TRIED: [usize; 2] = [1, 2];
/// Side of a target on the wall, pixels of an image with 640 columns.
const SIDE_PX: u32 = 100;
/// Rendered frames of the small and the large wall.
const FRAMES: usize = 20;

/// Rows, and the medians by what was varied and called.
#[derive(Default)]
struct Table {
    rows: Vec<Value>,
    medians_ms: Vec<(&'static str, &'static str, f64)>,
}

impl Table {
    fn add(&mut self, varied: &'static str, value: String, what: &'static str, times: Times) {
        let first = self.medians_ms.iter().find(|row| (row.0, row.1) == (varied, what));
        let ratio = times.median_ms / first.map_or(times.median_ms, |row| row.2);
        self.medians_ms.push((varied, what, times.median_ms));
        self.rows.push(json!({
            "varied": varied, "value": value, "what": what, "times": times.to_json(), "ratio_to_first": ratio,
        }));
    }
}

const FRAME: &str = "tracking frame";
const COLD: &str = "cold start";

/// Runs all scaling measurements.
///
/// # Errors
/// If simulator, estimator or tracker rejects the setup, or a target is lost.
pub fn scaling(rounds: usize) -> anyhow::Result<Vec<Value>> {
    let mut table = Table::default();
    let mut clip = targets_on_wall(SIZE, 8)?;
    clip.regions.push(square(SIZE, (430, 240), 160));
    for points in POINTS_TRIED {
        table.add("points", points.to_string(), FRAME, frames(&clip, &[8], points, rounds)?);
    }
    for count in TARGETS_TRIED {
        let targets: Vec<usize> = (0..count).collect();
        table.add("targets", count.to_string(), FRAME, frames(&clip, &targets, POINTS, rounds)?);
        table.add("targets", count.to_string(), COLD, cold_starts(&clip, &targets, rounds)?);
    }
    for threads in THREADS_TRIED {
        table.add("threads", threads.to_string(), FRAME, on_threads(&clip, threads, rounds)?);
    }
    drop(clip);
    for size in [SIZE, LARGE] {
        let clip = targets_on_wall(size, 1)?;
        let name = format!("{} x {}", size.width, size.height);
        table.add("images", name.clone(), FRAME, frames(&clip, &[0], POINTS, rounds)?);
        table.add("images", name, COLD, cold_starts(&clip, &[0], rounds)?);
    }
    Ok(table.rows)
}

/// The wall with up to eight targets on it, which are visible in both images.
fn targets_on_wall(size: ImageSize, count: usize) -> anyhow::Result<Clip> {
    let mut clip = wall(size, FRAMES)?;
    let centre = |i: usize| (250 + 105 * (i % 4) as i32, 150 + 180 * (i / 4) as i32);
    clip.regions = (0..count).map(|i| square(size, centre(i), SIDE_PX)).collect();
    Ok(clip)
}

/// Frames in which all `targets` are tracked in sequence.
fn frames(clip: &Clip, targets: &[usize], points: usize, rounds: usize) -> anyhow::Result<Times> {
    let followers = targets.iter().map(|index| Follower::start(clip, *index, points, Kernels::best()));
    let samples = follow_in_turn(&mut followers.collect::<anyhow::Result<Vec<_>>>()?, clip, rounds)?;
    let sums: Vec<f64> = (0..rounds).map(|frame| samples.iter().map(|samples| samples[frame]).sum()).collect();
    Times::of(&sums).context("no frame was counted")
}

fn cold_starts(clip: &Clip, targets: &[usize], rounds: usize) -> anyhow::Result<Times> {
    let (left, right) = clip.pair(0);
    let mut estimator = DirectEstimator::new(&clip.rig, DirectConfig::default())?;
    repeat(rounds, || {
        for index in targets {
            estimator.estimate(EstimateRequest::new_target(left, right, &clip.regions[*index], &SEARCH))?;
        }
        Ok(())
    })
}

/// One target per thread, in parallel: time per frame and thread.
fn on_threads(clip: &Clip, threads: usize, rounds: usize) -> anyhow::Result<Times> {
    let one = |target: usize| -> anyhow::Result<Vec<f64>> {
        let follower = Follower::start(clip, target, POINTS, Kernels::best())?;
        Ok(follow_in_turn(&mut [follower], clip, rounds)?.concat())
    };
    let samples = std::thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|target| scope.spawn(move || one(target))).collect();
        let ended = running.into_iter().map(|thread| thread.join().map_err(|_| anyhow::anyhow!("a thread failed"))?);
        ended.collect::<anyhow::Result<Vec<_>>>()
    })?;
    Times::of(&samples.concat()).context("no frame was counted")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratios_are_to_the_first_row_of_a_kind() {
        let times = |ms: f64| Times::of(&[ms]).expect("not empty");
        let mut table = Table::default();
        table.add("targets", "1".into(), FRAME, times(2.0));
        table.add("targets", "1".into(), COLD, times(5.0));
        table.add("targets", "2".into(), FRAME, times(3.0));
        table.add("points", "250".into(), FRAME, times(1.0));
        assert_eq!(
            table.rows.iter().filter_map(|row| row["ratio_to_first"].as_f64()).collect::<Vec<_>>(),
            [1.0, 1.0, 1.5, 1.0]
        );
    }
}
