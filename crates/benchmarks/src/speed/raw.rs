//! The cold start on raw images: with lens distortion, not rectified. Compared with the rectified case in the same run.

use anyhow::Context;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_platform::cpu_time::timed;
use serde_json::{Value, json};

use super::clips::{Clip, Lenses, factor, search_of, wall_through};
use super::cold::{KernelRow, SIZE, stage_row};
use super::stages::{Problem, Stage, StageBench, run_in_turn};
use super::times::Times;

const LARGE: ImageSize = ImageSize { width: 1920, height: 1200 };
/// Sides of the square regions, pixels at every image size.
const SIDES_PX: [u32; 3] = [60, 100, 250];
/// Position of the regions, pixels of an image with 640 columns.
const CENTRE: [u32; 2] = [430, 240];
/// Calls that do not count.
const WARM_UP: usize = 3;
/// The compared rigs. The first one is the reference of the second and third, the second one of the last.
const RIGS: [(Lenses, ImageSize); 5] = [
    (Lenses::Rectified, SIZE),
    (Lenses::Brown, SIZE),
    (Lenses::Equidistant, SIZE),
    (Lenses::Rectified, LARGE),
    (Lenses::Brown, LARGE),
];

/// One rig and one size of region.
pub struct RawRow {
    /// Lenses of the rig.
    pub lenses: Lenses,
    /// Image size.
    pub size: ImageSize,
    /// Side of the square, pixels.
    pub side_px: u32,
    /// Status of the estimate.
    pub status: &'static str,
    /// Time of a cold start.
    pub times: Times,
    /// Median, as a multiple of the median on rectified images of 640 x 480.
    pub ratio: f64,
    /// Median, as a multiple of the median with the same lenses and images of 640 x 480.
    pub ratio_to_small: f64,
    /// Time to create the estimator.
    pub creation_ms: f64,
    /// Medians of the stages.
    pub stages: Vec<(Stage, f64)>,
}

impl RawRow {
    /// As saved.
    pub fn to_json(&self) -> Value {
        let stages = self.stages.iter().map(|(stage, ms)| (stage.name().to_owned(), json!(ms)));
        json!({
            "lenses": self.lenses.name(),
            "width": self.size.width,
            "height": self.size.height,
            "side_px": self.side_px,
            "status": self.status,
            "times": self.times.to_json(),
            "ratio_to_rectified": self.ratio,
            "ratio_to_small": self.ratio_to_small,
            "creation_ms": self.creation_ms,
            "median_of_stages_ms": stages.collect::<serde_json::Map<_, _>>(),
        })
    }
}

/// One rig in the measurement.
struct Entry {
    lenses: Lenses,
    size: ImageSize,
    clip: Clip,
    estimator: DirectEstimator,
    range: SearchRange,
    creation_ms: f64,
}

impl Entry {
    fn new(lenses: Lenses, size: ImageSize) -> anyhow::Result<Self> {
        let clip = wall_through(lenses, size)?;
        let (estimator, creation_ms) = timed(|| DirectEstimator::new(&clip.rig, DirectConfig::default()));
        Ok(Self { lenses, size, estimator: estimator?, range: search_of(size), clip, creation_ms })
    }

    /// Status and CPU time of one cold start.
    fn call(&mut self, region: &Region) -> anyhow::Result<(&'static str, f64)> {
        let (left, right) = &self.clip.pairs[0];
        let request = EstimateRequest::of_target(left, right, region, &self.range);
        let (found, ms) = timed(|| self.estimator.estimate(request));
        Ok((found?.status.as_str(), ms))
    }
}

/// Measures all rigs in turn, so that other load on the machine affects all of them alike.
///
/// # Errors
/// If simulator or estimator rejects the setup.
pub fn raw(rounds: usize) -> anyhow::Result<Vec<RawRow>> {
    let entries = RIGS.into_iter().map(|(lenses, size)| Entry::new(lenses, size));
    let mut entries = entries.collect::<anyhow::Result<Vec<_>>>()?;
    let mut rows = Vec::new();
    for side_px in SIDES_PX {
        rows.extend(of_side(&mut entries, side_px, rounds)?);
    }
    Ok(rows)
}

fn of_side(entries: &mut [Entry], side_px: u32, rounds: usize) -> anyhow::Result<Vec<RawRow>> {
    let mut samples_ms = vec![Vec::with_capacity(rounds); entries.len()];
    let mut statuses = vec![""; entries.len()];
    for round in 0..WARM_UP + rounds.max(1) {
        for (i, entry) in entries.iter_mut().enumerate() {
            let (status, ms) = entry.call(&square(entry.size, side_px))?;
            statuses[i] = status;
            if round >= WARM_UP {
                samples_ms[i].push(ms);
            }
        }
    }
    let times = samples_ms.iter().map(|samples| Times::of(samples).context("a measured time is NaN"));
    let times = times.collect::<anyhow::Result<Vec<_>>>()?;
    let median_of = |lenses: Lenses| {
        let index = RIGS.iter().position(|rig| *rig == (lenses, SIZE)).context("no reference")?;
        anyhow::Ok(times[index].median_ms)
    };
    let stages = stages(entries, side_px, rounds)?;
    let row = |((i, entry), stages): ((usize, &Entry), Vec<(Stage, f64)>)| {
        Ok(RawRow {
            stages,
            lenses: entry.lenses,
            size: entry.size,
            side_px,
            status: statuses[i],
            times: times[i],
            ratio: times[i].median_ms / median_of(Lenses::Rectified)?,
            ratio_to_small: times[i].median_ms / median_of(entry.lenses)?,
            creation_ms: entry.creation_ms,
        })
    };
    entries.iter().enumerate().zip(stages).map(row).collect()
}

/// Medians of the stages of every rig, measured in turn.
fn stages(entries: &[Entry], side_px: u32, rounds: usize) -> anyhow::Result<Vec<Vec<(Stage, f64)>>> {
    let regions: Vec<Region> = entries.iter().map(|entry| square(entry.size, side_px)).collect();
    let benches = entries.iter().zip(&regions).map(|(entry, region)| {
        let (left, right) = &entry.clip.pairs[0];
        let (rig, range) = (&entry.clip.rig, &entry.range);
        StageBench::new(Problem { rig, left, right, region, range }, Kernels::best())
    });
    let mut benches = benches.collect::<anyhow::Result<Vec<_>>>()?;
    run_in_turn(&mut benches, rounds)?;
    let parts = || Stage::ALL.into_iter().filter(|stage| *stage != Stage::Whole);
    let of =
        |bench: &StageBench<'_>| parts().filter_map(|stage| Some((stage, bench.times(stage)?.median_ms))).collect();
    Ok(benches.iter().map(of).collect())
}

/// The windows of a raw pair with every available family of kernels.
///
/// # Errors
/// If simulator or estimator rejects the setup.
pub fn kernels(rounds: usize) -> anyhow::Result<KernelRow> {
    let (clip, range, region) = (wall_through(Lenses::Brown, SIZE)?, search_of(SIZE), square(SIZE, SIDES_PX[1]));
    let (left, right) = &clip.pairs[0];
    let problem = Problem { rig: &clip.rig, left, right, region: &region, range: &range };
    let benches = Kernels::available().map(|kernels| StageBench::new(problem, kernels));
    let mut benches = benches.collect::<anyhow::Result<Vec<_>>>()?;
    run_in_turn(&mut benches, rounds)?;
    stage_row("windows of raw images", Stage::Windows, &benches)
}

/// A square of the same size at every image size, in the same direction.
fn square(size: ImageSize, side_px: u32) -> Region {
    let corner = |centre: u32| (factor(size) * f64::from(centre)) as i32 - side_px as i32 / 2;
    Region::Rectangle { x: corner(CENTRE[0]), y: corner(CENTRE[1]), width: side_px, height: side_px }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rig_is_measured_and_compared_with_its_references() {
        let mut entries = [Lenses::Rectified, Lenses::Brown].map(|lenses| Entry::new(lenses, SIZE).expect("a rig"));
        let rows = of_side(&mut entries, 60, 2).expect("measures");
        assert!(rows.iter().all(|row| row.status == "ok"), "{:?}", rows.iter().map(|r| r.status).collect::<Vec<_>>());
        assert_eq!((rows[0].ratio, rows[1].ratio_to_small), (1.0, 1.0));
        assert!((rows[1].ratio - rows[1].times.median_ms / rows[0].times.median_ms).abs() < 1e-12);
    }

    #[test]
    fn regions_keep_their_size_in_pixels() {
        for size in [SIZE, LARGE] {
            let Region::Rectangle { x, y, width, height } = square(size, 60) else { panic!("a rectangle") };
            assert_eq!((width, height), (60, 60));
            let expected = [430, 240].map(|c| (c * size.width / 640) as i32 - 30);
            assert_eq!([x, y], expected);
        }
    }
}
