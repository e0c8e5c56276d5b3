//! The cold start: from two images in memory to a pose with its covariance.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context;
use pb3dp_estimation::rig_watch::RigWatch;
use pb3dp_estimation_core::cpu::Kernels;
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_geometry::ImageSize;
use pb3dp_record::metrics;
use serde_json::{Value, json};

use super::clips::{Clip, SEARCH, square, wall};
use super::stages::{Problem, Stage, StageBench, run_in_turn};
use super::times::{Times, repeat};
use crate::real::cases;
use pb3dp_hal_platform::cpu_time::timed;

/// Image size of the measurements that do not vary it.
pub const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
/// Position of the regions.
const CENTRE: (i32, i32) = (430, 240);
/// Sides of the square regions, pixels.
pub const SIDES_PX: [u32; 5] = [30, 60, 100, 160, 250];
/// Side of the region for the comparison of kernels, pixels.
const SIDE_OF_KERNELS_PX: u32 = 100;

/// One size of region.
pub struct SizeRow {
    /// Side of the square, pixels.
    pub side_px: u32,
    /// Status of the estimate.
    pub status: &'static str,
    /// Time of the whole cold start.
    pub whole: Times,
    /// Times of each stage.
    pub stages: Vec<(Stage, Times)>,
}

/// One part with one family of kernels.
pub struct KernelRow {
    /// Name of the part.
    pub name: String,
    /// Unit of a sample.
    pub unit: &'static str,
    /// Family, ns per sample (median), and ratio to the scalar family in the same run.
    pub sets: Vec<(&'static str, f64, f64)>,
}

impl KernelRow {
    /// As saved.
    pub fn to_json(&self) -> Value {
        let sets = self
            .sets
            .iter()
            .map(|(name, ns, ratio)| json!({ "kernels": name, "ns_per_sample": ns, "ratio_to_scalar": ratio }));
        json!({ "name": self.name, "sample": self.unit, "sets": sets.collect::<Vec<_>>() })
    }
}

impl SizeRow {
    /// As saved.
    pub fn to_json(&self) -> Value {
        let stages = self.stages.iter().map(|(stage, times)| (stage.name().to_owned(), times.to_json()));
        json!({
            "side_px": self.side_px,
            "status": self.status,
            "whole": self.whole.to_json(),
            "stages": stages.collect::<serde_json::Map<_, _>>(),
        })
    }
}

fn problem<'a>(clip: &'a Clip, region: &'a pb3dp_estimation_core::region::Region) -> Problem<'a> {
    let (left, right) = &clip.pairs[0];
    Problem { rig: &clip.rig, left, right, region, range: &SEARCH }
}

/// Square regions of a textured wall, with a search range of 60 px of disparity.
///
/// # Errors
/// If simulator or estimator rejects the setup.
pub fn sizes(rounds: usize) -> anyhow::Result<Vec<SizeRow>> {
    let clip = wall(SIZE, 1)?;
    SIDES_PX.into_iter().map(|side| size_row(&clip, side, rounds)).collect()
}

fn size_row(clip: &Clip, side_px: u32, rounds: usize) -> anyhow::Result<SizeRow> {
    let region = square(SIZE, CENTRE, side_px);
    let (left, right) = &clip.pairs[0];
    let mut estimator = DirectEstimator::new(&clip.rig, DirectConfig::default())?;
    let status = estimator.estimate(EstimateRequest::of_target(left, right, &region, &SEARCH))?.status.as_str();
    let whole = repeat(rounds, || {
        estimator.estimate(EstimateRequest::of_target(left, right, &region, &SEARCH))?;
        Ok(())
    })?;
    let mut benches = [StageBench::new(problem(clip, &region), Kernels::best())?];
    run_in_turn(&mut benches, rounds)?;
    let parts = Stage::ALL.into_iter().filter(|stage| *stage != Stage::Whole);
    let stages = parts.filter_map(|stage| Some((stage, benches[0].times(stage)?))).collect();
    Ok(SizeRow { side_px, status, whole, stages })
}

/// Every stage with every available family of kernels.
///
/// # Errors
/// If simulator or estimator rejects the setup.
pub fn kernels(rounds: usize) -> anyhow::Result<Vec<KernelRow>> {
    let clip = wall(SIZE, 1)?;
    let region = square(SIZE, CENTRE, SIDE_OF_KERNELS_PX);
    let benches = Kernels::available().map(|kernels| StageBench::new(problem(&clip, &region), kernels));
    let mut benches = benches.collect::<anyhow::Result<Vec<_>>>()?;
    run_in_turn(&mut benches, rounds)?;
    Stage::ALL.into_iter().map(|stage| stage_row(stage.name(), stage, &benches)).collect()
}

/// A stage with every family of kernels.
///
/// # Errors
/// Without a counted round.
pub fn stage_row(name: &str, stage: Stage, benches: &[StageBench<'_>]) -> anyhow::Result<KernelRow> {
    let ns = |bench: &StageBench<'_>| {
        let ms = bench.times(stage).context("no round was counted")?.median_ms;
        anyhow::Ok(ms * 1e6 / bench.samples(stage)? as f64)
    };
    let times = benches.iter().map(ns).collect::<anyhow::Result<Vec<_>>>()?;
    Ok(kernel_row(name, stage.unit(), benches.iter().map(StageBench::set).zip(times)))
}

/// A row from the times of the families; the scalar family comes first.
pub fn kernel_row(
    name: &str,
    unit: &'static str,
    times: impl Iterator<Item = (pb3dp_estimation_core::cpu::KernelSet, f64)>,
) -> KernelRow {
    let mut scalar = None;
    let sets = times.map(|(set, ns)| (set.name(), ns, *scalar.get_or_insert(ns) / ns)).collect();
    KernelRow { name: name.to_owned(), unit, sets }
}

/// Times over a group of cases.
pub struct CasesRow {
    /// Group, or `all`.
    pub name: &'static str,
    /// Distribution over the cases of the median of each case's calls.
    pub whole: Times,
    /// Medians over the cases of each stage's median.
    pub stages: Vec<(Stage, f64)>,
}

impl CasesRow {
    /// As saved.
    pub fn to_json(&self) -> Value {
        let stages = self.stages.iter().map(|(stage, ms)| (stage.name().to_owned(), json!(ms)));
        json!({
            "group": self.name,
            "whole": self.whole.to_json(),
            "median_of_stages_ms": stages.collect::<serde_json::Map<_, _>>(),
        })
    }
}

/// Real cases, all and by group, and the measurement of the vertical misalignment, which runs once before.
pub struct RealRows {
    /// All cases, then each group that has cases.
    pub rows: Vec<CasesRow>,
    /// Time of the measurement of the vertical misalignment, over the cases.
    pub row_measurement: Times,
    /// The first call of a new estimator, which also allocates its memory; over the cases.
    pub first_call: Times,
}

/// Medians of one case.
struct CaseTimes {
    group: &'static str,
    whole_ms: f64,
    rows_ms: f64,
    first_ms: f64,
    stages_ms: Vec<(Stage, f64)>,
}

/// Calls of one case for its stages.
const STAGE_ROUNDS: usize = 3;

/// Measures every case under `folder` with `rounds` calls each.
///
/// # Errors
/// A folder or case that cannot be used, by name.
pub fn real(folder: &Path, rounds: usize, every: usize) -> anyhow::Result<RealRows> {
    let mut times = Vec::new();
    for path in cases::find(folder, None)?.iter().step_by(every) {
        let Some(case) = cases::load(path)? else { continue };
        times.push(case_times(&case, rounds).with_context(|| format!("{}", path.display()))?);
    }
    let mut groups: BTreeMap<&'static str, Vec<&CaseTimes>> = BTreeMap::new();
    times.iter().for_each(|case| groups.entry(case.group).or_default().push(case));
    let whole = std::iter::once(("all", times.iter().collect::<Vec<_>>()));
    let rows = whole.chain(groups).map(|(name, cases)| summary(name, &cases)).collect::<Option<Vec<_>>>();
    let rows_ms: Vec<f64> = times.iter().map(|case| case.rows_ms).collect();
    let first_ms: Vec<f64> = times.iter().map(|case| case.first_ms).collect();
    rows.zip(Times::of(&rows_ms).zip(Times::of(&first_ms)))
        .map(|(rows, (row_measurement, first_call))| RealRows { rows, row_measurement, first_call })
        .with_context(|| format!("no case in {} has a `truth`: nothing to measure", folder.display()))
}

fn case_times(case: &cases::Prepared, rounds: usize) -> anyhow::Result<CaseTimes> {
    let (left, right) = (&case.images.left, &case.images.right);
    let mut estimator = DirectEstimator::new(&case.rig, DirectConfig::default())?;
    let mut watch = RigWatch::new(&case.rig)?;
    let (measured, rows_ms) = timed(|| watch.look(left, right));
    let _ = measured?;
    if let Some(errors) = watch.errors() {
        estimator.correct_rig(watch.rig(), errors)?;
    }
    let (first, first_ms) =
        timed(|| estimator.estimate(EstimateRequest::of_target(left, right, &case.region, &case.range)));
    first?;
    let whole = repeat(rounds, || {
        estimator.estimate(EstimateRequest::of_target(left, right, &case.region, &case.range))?;
        Ok(())
    })?;
    let problem = Problem { rig: &case.rig, left, right, region: &case.region, range: &case.range };
    let mut stages_ms = Vec::new();
    // A region without any comparable pixels has no stages.
    if let Ok(bench) = StageBench::new(problem, Kernels::best()) {
        let mut benches = [bench];
        run_in_turn(&mut benches, STAGE_ROUNDS)?;
        let parts = Stage::ALL.into_iter().filter(|stage| *stage != Stage::Whole);
        stages_ms = parts.filter_map(|stage| Some((stage, benches[0].times(stage)?.median_ms))).collect();
    }
    Ok(CaseTimes { group: case.facts.group.name(), whole_ms: whole.median_ms, rows_ms, first_ms, stages_ms })
}

fn summary(name: &'static str, cases: &[&CaseTimes]) -> Option<CasesRow> {
    let whole: Vec<f64> = cases.iter().map(|case| case.whole_ms).collect();
    let median = |stage: Stage| {
        let all = cases.iter().flat_map(|case| &case.stages_ms);
        let own: Vec<f64> = all.filter(|(other, _)| *other == stage).map(|(_, ms)| *ms).collect();
        Some((stage, metrics::median(&own)?))
    };
    Some(CasesRow { name, whole: Times::of(&whole)?, stages: Stage::ALL.into_iter().filter_map(median).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_of_this_repository_are_summarised_by_group() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases");
        let found = real(&folder, 1, 2).expect("measures");
        assert_eq!(found.rows[0].name, "all");
        let of_groups: usize = found.rows[1..].iter().map(|row| row.whole.count).sum();
        assert_eq!((found.rows[0].whole.count, of_groups), (of_groups, found.row_measurement.count));
        for row in &found.rows {
            assert!(row.stages.len() == Stage::ALL.len() - 1 && row.whole.min_ms > 0.0, "{}", row.name);
            let search = row.stages.iter().find(|(stage, _)| *stage == Stage::Search).expect("measured");
            let costs = row.stages.iter().find(|(stage, _)| *stage == Stage::Costs).expect("measured");
            assert!(search.1 > costs.1, "the search contains its costs: {} {}", search.1, costs.1);
        }
    }

    #[test]
    fn ratios_are_to_the_scalar_family() {
        use pb3dp_estimation_core::cpu::KernelSet;
        let row = kernel_row("a part", "pixel", [(KernelSet::Scalar, 6.0), (KernelSet::Avx2, 1.5)].into_iter());
        assert_eq!(row.sets, [("scalar", 6.0, 1.0), ("AVX2", 1.5, 4.0)]);
    }
}
