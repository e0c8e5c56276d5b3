//! Accuracy of the estimators on rendered scenes with known truth, compared with the Cramér-Rao bound.
//!
//! [`cells`] lists the configurations for single pairs, [`sequences`] those for moving targets, and [`ensembles`] those of
//! many short sequences each, also with disturbed cameras; [`bound`] computes the Cramér-Rao bound, [`limits`] checks the required accuracy, and [`page`] writes the document.

mod bound;
mod cell;
mod cells;
mod chi_square;
mod conditions;
pub mod dump;
mod ensemble_summary;
mod ensembles;
pub mod figures;
mod first_pose;
mod limits;
mod measure;
mod page;
mod plot;
mod random;
mod scenes;
mod score_curve;
mod sequence_summary;
mod sequences;
mod summary;
mod table;
mod track;
mod trial;

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Context, bail};
use pb3dp_estimation::estimator::Method;
use pb3dp_sim::targets::TargetConfig;
use serde_json::json;

use crate::common::circumstances::Circumstances;
use ensemble_summary::EnsembleSummary;
use ensembles::EnsembleSpec;
use first_pose::FirstPoses;
use limits::{Check, Standing};
use measure::Options;
use page::Findings;
use scenes::SceneStore;
use sequence_summary::SequenceSummary;
use sequences::SequenceSpec;
use summary::Summary;

const KEPT: &str = "out/bench/accuracy.json";
const PAGE: &str = "docs/benchmarks/accuracy.md";

/// The sequence of the second figure.
const DRAWN_SEQUENCE: &str = "track/crab-30fps";

/// Options.
#[derive(clap::Args)]
pub struct Args {
    /// Fewer poses and sequences, and without --only no others than those with limits, for a check in minutes; does not change
    /// docs/benchmarks.
    #[arg(long)]
    quick: bool,
    /// Only configurations and sequences whose name contains one of these texts, separated by commas.
    #[arg(long, value_delimiter = ',', value_name = "TEXTS")]
    only: Vec<String>,
    /// Methods, separated by commas.
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    methods: Vec<Method>,
    /// Poses per configuration.
    #[arg(long, value_name = "NUMBER")]
    poses: Option<usize>,
    /// Also the sequence of 10000 frames.
    #[arg(long)]
    long: bool,
    /// Number of threads.
    #[arg(long, default_value_t = 2, value_name = "NUMBER")]
    threads: usize,
    /// Seed of poses and noise.
    #[arg(long, default_value_t = 1, value_name = "NUMBER")]
    seed: u32,
    /// One JSON line per row instead of the tables.
    #[arg(long)]
    json: bool,
    /// Does not change docs/benchmarks.
    #[arg(long)]
    no_docs: bool,
    /// Root folder of the workspace.
    #[arg(long, default_value = ".", value_name = "DIR")]
    root: PathBuf,
}

impl Args {
    fn wants(&self, name: &str) -> bool {
        match self.only.as_slice() {
            [] => !self.quick || limits::has_limit(name),
            only => only.iter().any(|only| name.contains(only.as_str())),
        }
    }

    fn methods(&self) -> Vec<Method> {
        if self.methods.is_empty() { vec![Method::Published, Method::Direct] } else { self.methods.clone() }
    }

    fn is_full(&self) -> bool {
        !self.quick && self.only.is_empty() && self.methods.is_empty()
    }

    fn ensembles(&self) -> Vec<EnsembleSpec> {
        // The published method has no covariance, and does not follow these motions.
        let wanted = ensembles::all().into_iter().filter(|spec| self.wants(&spec.name));
        let wanted = wanted.filter(|_| self.methods().contains(&Method::Direct));
        if self.quick { wanted.map(EnsembleSpec::quick).collect() } else { wanted.collect() }
    }

    fn sequences(&self) -> Vec<SequenceSpec> {
        let all = sequences::all().into_iter().chain(self.long.then(sequences::long));
        let wanted = all.filter(|sequence| self.wants(&sequence.name));
        if self.quick { wanted.filter_map(SequenceSpec::quick).collect() } else { wanted.collect() }
    }
}

/// # Errors
/// If a part fails, or a limit is not met.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let options = Options {
        methods: args.methods(),
        seed: args.seed,
        threads: args.threads,
        poses: args.poses,
        quick: args.quick,
    };
    let cells: Vec<_> = cells::all().into_iter().filter(|cell| args.wants(&cell.name)).collect();
    let (specs, ensembles) = (args.sequences(), args.ensembles());
    let objects: Vec<_> = first_pose::OBJECTS.into_iter().filter(|(name, _)| args.wants(name)).collect();
    if cells.is_empty() && specs.is_empty() && ensembles.is_empty() && objects.is_empty() {
        bail!("no configuration, sequence or ensemble has a name with {}", args.only.join(" or "));
    }
    let summaries = measure_cells(&cells, &options, args.json)?;
    let sequences = measure_sequences(&specs, &options, args.json)?;
    let ensembles = measure_ensembles(&ensembles, &options, args.json)?;
    let first_poses = measure_first_poses(&objects, &options, args.json)?;
    let mut checks = limits::checks(&summaries, &sequences, &ensembles);
    checks.extend(first_poses.iter().flat_map(limits::checks_of_first_poses));
    let (seed, quick) = (args.seed, args.quick);
    let findings = Findings { cells, summaries, sequences, ensembles, first_poses, checks, seed, quick };
    let circumstances = Circumstances::of(&args.root);
    keep(&args.root, &findings, &circumstances)?;
    if args.is_full() && !args.no_docs {
        document(&args.root, &findings, &circumstances)?;
    }
    conclude(&findings.checks, args.quick)
}

fn measure_cells(cells: &[cell::Cell], options: &Options, as_json: bool) -> anyhow::Result<Vec<Summary>> {
    let mut scenes = SceneStore::default();
    let mut summaries = Vec::new();
    if !cells.is_empty() && !as_json {
        println!("{}", table::line(&table::HEADINGS.map(str::to_owned)));
    }
    for cell in cells {
        let measured = measure::measure_cell(cell, options, &mut scenes)?;
        for (index, method) in options.methods.iter().enumerate() {
            let summary = Summary::of(cell, method.name(), index, &measured);
            if as_json {
                println!("{}", summary.to_json());
            } else {
                println!("{}", table::line(&table::row(&summary)));
            }
            summaries.push(summary);
        }
    }
    Ok(summaries)
}

/// Runs the sequences, one per thread.
fn measure_sequences(specs: &[SequenceSpec], options: &Options, as_json: bool) -> anyhow::Result<Vec<SequenceSummary>> {
    if !specs.is_empty() && !as_json {
        println!("\n{}", sequence_summary::line(&sequence_summary::HEADINGS.map(str::to_owned)));
    }
    let queue = Mutex::new(specs.iter().enumerate());
    let found = Mutex::new(Vec::new());
    let work = || -> anyhow::Result<()> {
        let mut scenes = SceneStore::default();
        loop {
            let next = queue.lock().ok().and_then(|mut queue| queue.next());
            let Some((index, spec)) = next else { return Ok(()) };
            let rows = track::run_sequence(spec, &options.methods, options.seed, &mut scenes)
                .with_context(|| format!("sequence {}", spec.name))?;
            for row in &rows {
                if as_json {
                    println!("{}", row.to_json());
                } else {
                    println!("{}", sequence_summary::line(&sequence_summary::row(row)));
                }
            }
            if let Ok(mut found) = found.lock() {
                found.push((index, rows));
            }
        }
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..options.threads.max(1)).map(|_| scope.spawn(work)).collect();
        threads.into_iter().try_for_each(|thread| match thread.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        })
    })?;
    let mut found = found.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    found.sort_by_key(|(index, _)| *index);
    Ok(found.into_iter().flat_map(|(_, rows)| rows).collect())
}

/// Runs the ensembles one after the other, and the sequences of each on all threads.
fn measure_ensembles(specs: &[EnsembleSpec], options: &Options, as_json: bool) -> anyhow::Result<Vec<EnsembleSummary>> {
    if !specs.is_empty() && !as_json {
        println!("\n{}", ensemble_summary::line(&ensemble_summary::HEADINGS.map(str::to_owned)));
    }
    let mut found = Vec::new();
    for spec in specs {
        let runs = in_parallel(spec.sequences, options.threads, |index| {
            let scenes = &mut SceneStore::default();
            track::follow(&spec.member(options.seed, index), &[Method::Direct], options.seed, scenes)
        });
        let summary = EnsembleSummary::of(spec, Method::Direct.name(), &runs.with_context(|| spec.name.clone())?);
        if as_json {
            println!("{}", summary.to_json());
        } else {
            println!("{}", ensemble_summary::line(&ensemble_summary::row(&summary)));
        }
        found.push(summary);
    }
    Ok(found)
}

/// The first poses of all objects.
fn measure_first_poses(
    objects: &[(&str, TargetConfig)],
    options: &Options,
    as_json: bool,
) -> anyhow::Result<Vec<FirstPoses>> {
    let moved_s = (!options.quick).then_some(first_pose::MOVED_S);
    let found = in_parallel(objects.len(), options.threads, |index| {
        let (name, target) = objects[index];
        first_pose::measure(name, target, options.seed, first_pose::STARTS, moved_s)
    })?;
    if as_json {
        found.iter().for_each(|row| println!("{}", row.to_json()));
    } else if !found.is_empty() {
        println!("\n{}", table::markdown(&FirstPoses::HEADINGS, found.iter().map(FirstPoses::row)));
    }
    Ok(found)
}

/// Results of `work` for the numbers below `count`, in their order; the first error of any thread.
fn in_parallel<T: Send>(
    count: usize,
    threads: usize,
    work: impl Fn(usize) -> anyhow::Result<T> + Sync,
) -> anyhow::Result<Vec<T>> {
    let (next, results) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    let run = || -> anyhow::Result<()> {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= count {
                return Ok(());
            }
            let result = work(index)?;
            if let Ok(mut results) = results.lock() {
                results.push((index, result));
            }
        }
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(run)).collect();
        threads.into_iter().try_for_each(|thread| match thread.join() {
            Ok(result) => result,
            Err(panic) => std::panic::resume_unwind(panic),
        })
    })?;
    let mut results = results.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    results.sort_by_key(|(index, _)| *index);
    Ok(results.into_iter().map(|(_, result)| result).collect())
}

/// Saves the results as JSON.
fn keep(root: &Path, findings: &Findings, circumstances: &Circumstances) -> anyhow::Result<()> {
    let checks: Vec<_> = findings
        .checks
        .iter()
        .map(|check| {
            json!({
                "name": check.name, "method": check.method, "figure": check.figure,
                "measured": check.measured.is_finite().then_some(check.measured), "max": check.max,
                "kept": check.holds(findings.quick), "open": matches!(check.standing(findings.quick), Standing::Open(_)),
            })
        })
        .collect();
    let kept = json!({
        "bench": "accuracy", "where": circumstances.to_json(), "seed": findings.seed, "quick": findings.quick,
        "pairs": findings.summaries.iter().map(Summary::to_json).collect::<Vec<_>>(),
        "sequences": findings.sequences.iter().map(SequenceSummary::to_json).collect::<Vec<_>>(),
        "ensembles": findings.ensembles.iter().map(EnsembleSummary::to_json).collect::<Vec<_>>(),
        "first_poses": findings.first_poses.iter().map(FirstPoses::to_json).collect::<Vec<_>>(),
        "limits": checks,
    });
    write(&root.join(KEPT), &format!("{kept:#}\n"))
}

fn document(root: &Path, findings: &Findings, circumstances: &Circumstances) -> anyhow::Result<()> {
    let page = root.join(PAGE);
    write(&page, &page::page(findings, circumstances))?;
    write(&page.with_extension("svg"), &page::accuracy_figure(findings))?;
    write(&page.with_file_name("accuracy_sequence.svg"), &page::sequence_figure(findings, DRAWN_SEQUENCE))
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// Reports the limits that are not met.
fn conclude(checks: &[Check], quick: bool) -> anyhow::Result<()> {
    let (mut open, mut broken) = (0, 0);
    for check in checks {
        let known = match check.standing(quick) {
            Standing::Kept => continue,
            Standing::Open(ceiling) => {
                open += 1;
                format!(" (open goal, at most {ceiling:.3})")
            }
            Standing::Broken => {
                broken += 1;
                String::new()
            }
        };
        eprintln!(
            "{} {}: {} is {:.3}, the limit is {:.3}{known}",
            check.method, check.name, check.figure, check.measured, check.max
        );
    }
    println!("{} limits: {} met, {open} open, {broken} not met", checks.len(), checks.len() - open - broken);
    if broken > 0 {
        bail!("{broken} of {} limits are not met", checks.len());
    }
    Ok(())
}
