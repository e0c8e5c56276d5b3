//! The cold start: from two images in memory to a pose with its covariance; on a rendered wall, rectified and through lenses, and on
//! real cases.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context;
use pb3dp_estimation::rig_watch::RigWatch;
use pb3dp_estimation_core::cpu::{KernelSet, Kernels};
use pb3dp_estimation_core::method::{EstimateRequest, EstimationMethod};
use pb3dp_estimation_core::plane_hypothesis::SearchRange;
use pb3dp_estimation_core::region::Region;
use pb3dp_estimation_direct::estimator::{DirectConfig, DirectEstimator};
use pb3dp_geometry::ImageSize;
use pb3dp_hal_platform::cpu_time::timed;
use pb3dp_record::metrics;
use serde_json::{Map, Value, json};

use super::clips::{Clip, Lenses, factor, search_of, wall_through};
use super::stages::{Problem, Stage, StageBench, run_in_turn};
use super::times::{Times, repeat};
use crate::real::cases;

/// Image size of the measurements that do not vary it.
pub const SIZE: ImageSize = ImageSize { width: 640, height: 480 };
const LARGE: ImageSize = ImageSize { width: 1920, height: 1200 };
/// Sides of the square regions, pixels at every image size: by size, and through lenses.
const SIDES_PX: [u32; 5] = [30, 60, 100, 160, 250];
const SIDES_RAW_PX: [u32; 3] = [60, 100, 250];
/// Side of the region for the comparison of kernels, pixels.
const SIDE_OF_KERNELS_PX: u32 = 100;
/// Position of the regions, pixels of an image with 640 columns.
const CENTRE: [u32; 2] = [430, 240];
/// Calls that do not count.
const WARM_UP: usize = 3;
/// The compared rigs. Rectified images of 640 x 480 are the reference, for the large ones also the small ones with the same lenses.
const RIGS: [(Lenses, ImageSize); 5] = [
    (Lenses::Rectified, SIZE),
    (Lenses::Brown, SIZE),
    (Lenses::Equidistant, SIZE),
    (Lenses::Rectified, LARGE),
    (Lenses::Brown, LARGE),
];

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
        let request = EstimateRequest::new_target(left, right, region, &self.range);
        let (found, ms) = timed(|| self.estimator.estimate(request));
        Ok((found?.status.as_str(), ms))
    }

    fn problem<'a>(&'a self, region: &'a Region) -> Problem<'a> {
        let (left, right) = &self.clip.pairs[0];
        Problem { rig: &self.clip.rig, left, right, region, range: &self.range }
    }
}

/// Rows of square regions of a rectified wall.
///
/// # Errors
/// If simulator or estimator rejects the setup.
pub fn sizes(rounds: usize) -> anyhow::Result<Vec<Value>> {
    rows(&[(Lenses::Rectified, SIZE)], &SIDES_PX, rounds)
}

/// Rows of raw images, beside rectified ones.
///
/// # Errors
/// If simulator or estimator rejects the setup.
pub fn raw(rounds: usize) -> anyhow::Result<Vec<Value>> {
    rows(&RIGS, &SIDES_RAW_PX, rounds)
}

fn rows(rigs: &[(Lenses, ImageSize)], sides_px: &[u32], rounds: usize) -> anyhow::Result<Vec<Value>> {
    let entries = rigs.iter().map(|(lenses, size)| Entry::new(*lenses, *size));
    let mut entries = entries.collect::<anyhow::Result<Vec<_>>>()?;
    let mut rows = Vec::new();
    for side_px in sides_px {
        rows.extend(of_side(&mut entries, *side_px, rounds)?);
    }
    Ok(rows)
}

/// Measures all rigs in turn, so that other load on the machine affects all of them alike.
fn of_side(entries: &mut [Entry], side_px: u32, rounds: usize) -> anyhow::Result<Vec<Value>> {
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
    let regions: Vec<Region> = entries.iter().map(|entry| square(entry.size, side_px)).collect();
    let problems = entries.iter().zip(&regions).map(|(entry, region)| entry.problem(region));
    let benches = problems.map(|problem| StageBench::new(problem, Kernels::best()));
    let mut benches = benches.collect::<anyhow::Result<Vec<_>>>()?;
    run_in_turn(&mut benches, rounds)?;
    let median_of = |lenses: Lenses| {
        let reference = entries.iter().position(|entry| (entry.lenses, entry.size) == (lenses, SIZE));
        reference.map_or(f64::NAN, |index| times[index].median_ms)
    };
    let row = |((i, entry), bench): ((usize, &Entry), &StageBench<'_>)| {
        let median_ms = times[i].median_ms;
        json!({
            "lenses": entry.lenses.name(),
            "width": entry.size.width,
            "height": entry.size.height,
            "side_px": side_px,
            "status": statuses[i],
            "times": times[i].to_json(),
            "ratio_to_rectified": median_ms / median_of(Lenses::Rectified),
            "ratio_to_small": median_ms / median_of(entry.lenses),
            "creation_ms": entry.creation_ms,
            "stages": bench.to_json(),
        })
    };
    Ok(entries.iter().enumerate().zip(&benches).map(row).collect())
}

/// A square of the same size at every image size, in the same direction.
fn square(size: ImageSize, side_px: u32) -> Region {
    let corner = |centre: u32| (factor(size) * f64::from(centre)) as i32 - side_px as i32 / 2;
    Region::Rectangle { x: corner(CENTRE[0]), y: corner(CENTRE[1]), width: side_px, height: side_px }
}

/// Every stage with every available family of kernels; the windows also on raw images.
///
/// # Errors
/// If simulator or estimator rejects the setup.
pub fn kernels(rounds: usize) -> anyhow::Result<Vec<Value>> {
    let mut rows = kernel_rows(Lenses::Rectified, &Stage::ALL.map(|stage| (stage.name(), stage)), rounds)?;
    rows.extend(kernel_rows(Lenses::Brown, &[("windows of raw images", Stage::Windows)], rounds)?);
    Ok(rows)
}

fn kernel_rows(lenses: Lenses, stages: &[(&str, Stage)], rounds: usize) -> anyhow::Result<Vec<Value>> {
    let (entry, region) = (Entry::new(lenses, SIZE)?, square(SIZE, SIDE_OF_KERNELS_PX));
    let benches = Kernels::available().map(|kernels| StageBench::new(entry.problem(&region), kernels));
    let mut benches = benches.collect::<anyhow::Result<Vec<_>>>()?;
    run_in_turn(&mut benches, rounds)?;
    let row = |(name, stage): &(&str, Stage)| {
        let ns = |bench: &StageBench<'_>| {
            let ms = bench.times(*stage).context("no round was counted")?.median_ms;
            anyhow::Ok((bench.set(), ms * 1e6 / bench.samples(*stage)? as f64))
        };
        Ok(kernel_row(name, stage.unit(), benches.iter().map(ns).collect::<anyhow::Result<Vec<_>>>()?))
    };
    stages.iter().map(row).collect()
}

/// A row from the nanoseconds per sample of the families; the scalar family comes first.
pub fn kernel_row(name: &str, unit: &str, ns: Vec<(KernelSet, f64)>) -> Value {
    let scalar_ns = ns.first().map_or(f64::NAN, |(_, ns)| *ns);
    let set = |(set, ns): (KernelSet, f64)| json!({ "kernels": set.name(), "ns_per_sample": ns, "ratio_to_scalar": scalar_ns / ns });
    json!({ "name": name, "sample": unit, "sets": ns.into_iter().map(set).collect::<Vec<_>>() })
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

/// Measures every case under `folder` with `rounds` calls each: rows of all cases and of each group, the measurement of the vertical
/// misalignment, which runs once before, and the first call of a new estimator, which also allocates its memory.
///
/// # Errors
/// A folder or case that cannot be used, by name.
pub fn real(folder: &Path, rounds: usize, every: usize) -> anyhow::Result<Value> {
    let mut times = Vec::new();
    for path in cases::find(folder, None)?.iter().step_by(every) {
        let Some(case) = cases::load(path)? else { continue };
        times.push(case_times(&case, rounds).with_context(|| format!("{}", path.display()))?);
    }
    let mut groups: BTreeMap<&'static str, Vec<&CaseTimes>> = BTreeMap::new();
    times.iter().for_each(|case| groups.entry(case.group).or_default().push(case));
    let whole = std::iter::once(("all", times.iter().collect::<Vec<_>>()));
    let rows = whole.chain(groups).map(|(name, cases)| group_row(name, &cases)).collect::<Option<Vec<_>>>();
    let over_cases = |of: fn(&CaseTimes) -> f64| Some(Times::of(&times.iter().map(of).collect::<Vec<_>>())?.to_json());
    let rows = rows.with_context(|| format!("no case in {} has a `truth`: nothing to measure", folder.display()))?;
    let (row_measurement, first_call) = (over_cases(|case| case.rows_ms), over_cases(|case| case.first_ms));
    Ok(json!({ "rows": rows, "row_measurement": row_measurement, "first_call": first_call }))
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
        timed(|| estimator.estimate(EstimateRequest::new_target(left, right, &case.region, &case.range)));
    first?;
    let whole = repeat(rounds, || {
        estimator.estimate(EstimateRequest::new_target(left, right, &case.region, &case.range))?;
        Ok(())
    })?;
    let problem = Problem { rig: &case.rig, left, right, region: &case.region, range: &case.range };
    let mut stages_ms = Vec::new();
    // A region without any comparable pixels has no stages.
    if let Ok(bench) = StageBench::new(problem, Kernels::best()) {
        let mut benches = [bench];
        run_in_turn(&mut benches, STAGE_ROUNDS)?;
        stages_ms =
            Stage::PARTS.iter().filter_map(|stage| Some((*stage, benches[0].times(*stage)?.median_ms))).collect();
    }
    Ok(CaseTimes { group: case.facts.group.name(), whole_ms: whole.median_ms, rows_ms, first_ms, stages_ms })
}

fn group_row(name: &str, cases: &[&CaseTimes]) -> Option<Value> {
    let whole: Vec<f64> = cases.iter().map(|case| case.whole_ms).collect();
    let median = |stage: &Stage| {
        let all = cases.iter().flat_map(|case| &case.stages_ms);
        let own: Vec<f64> = all.filter(|(other, _)| other == stage).map(|(_, ms)| *ms).collect();
        Some((stage.name().to_owned(), json!(metrics::median(&own)?)))
    };
    let stages: Map<String, Value> = Stage::PARTS.iter().filter_map(median).collect();
    Some(json!({ "group": name, "whole": Times::of(&whole)?.to_json(), "median_of_stages_ms": stages }))
}

#[cfg(test)]
mod tests {
    use pb3dp_benchmarks::table::number;

    use super::*;

    #[test]
    fn boards_of_this_repository_are_summarised_by_group() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases");
        let found = real(&folder, 1, 2).expect("measures");
        let count = |row: &str| number(&found, &format!("rows.{row}.whole.count"));
        assert_eq!((&found["rows"][0]["group"], count("0")), (&"all".into(), count("1")));
        assert_eq!(count("0"), number(&found, "row_measurement.count"));
        let stage = |stage: Stage| number(&found["rows"][0]["median_of_stages_ms"], stage.name()).expect("measured");
        assert!(stage(Stage::Search) > stage(Stage::Costs), "the search contains its costs: {found}");
    }

    #[test]
    fn ratios_are_to_the_scalar_family() {
        let row = kernel_row("a part", "pixel", vec![(KernelSet::Scalar, 6.0), (KernelSet::Avx2, 1.5)]);
        let ratios = ["sets.0.ratio_to_scalar", "sets.1.ratio_to_scalar"].map(|path| number(&row, path));
        assert_eq!(ratios, [Some(1.0), Some(4.0)]);
    }

    #[test]
    fn every_rig_is_measured_and_compared_with_its_references() {
        let mut entries = [Lenses::Rectified, Lenses::Brown].map(|lenses| Entry::new(lenses, SIZE).expect("a rig"));
        let rows = of_side(&mut entries, 60, 2).expect("measures");
        assert!(rows.iter().all(|row| row["status"] == "ok"), "{rows:?}");
        let [rectified, brown] = [&rows[0], &rows[1]].map(|row| number(row, "times.median_ms").expect("measured"));
        let ratio = |row: &Value, to: &str| number(row, &format!("ratio_to_{to}")).expect("measured");
        assert_eq!((ratio(&rows[0], "rectified"), ratio(&rows[1], "small")), (1.0, 1.0));
        assert!((ratio(&rows[1], "rectified") - brown / rectified).abs() < 1e-12);
    }

    #[test]
    fn regions_keep_their_size_in_pixels() {
        for size in [SIZE, LARGE] {
            let Region::Rectangle { x, y, width, height } = square(size, 60) else { panic!("a rectangle") };
            assert_eq!((width, height), (60, 60));
            assert_eq!([x, y], CENTRE.map(|c| (c * size.width / 640) as i32 - 30));
        }
    }
}
