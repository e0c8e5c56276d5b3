//! Accuracy of the estimators on rendered scenes with known truth, compared with the Cramér-Rao bound.
//!
//! [`cells`] lists the configurations for single pairs, [`sequences`] those for moving targets, and [`ensembles`] those of
//! many short sequences each, also with disturbed cameras; [`bound`] computes the Cramér-Rao bound, [`limits`] checks the required accuracy, and [`page`] has tables and figures.

mod bound;
mod cell;
mod cells;
mod chi_square;
mod conditions;
pub mod dump;
mod ensembles;
pub mod figures;
mod first_pose;
mod limits;
mod measure;
mod page;
mod random;
pub mod scenes;
mod score_curve;
mod sequence_summary;
mod sequences;
mod summary;
mod track;
mod trial;

use std::path::PathBuf;

use anyhow::{Context, bail};
use pb3dp_benchmarks::circumstances::Circumstances;
use pb3dp_benchmarks::figure::panels;
use pb3dp_benchmarks::page::{save, update};
use pb3dp_benchmarks::parallel::in_parallel;
use pb3dp_benchmarks::table::{Column, head, row};
use pb3dp_estimation::estimator::Method;
use pb3dp_sim::targets::TargetConfig;
use serde_json::{Value, json};

use ensembles::EnsembleSpec;
use limits::{Check, Standing};
use measure::Options;
use scenes::SceneStore;
use sequence_summary::{SequenceRow, ensemble_row};
use sequences::SequenceSpec;

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
        let wanted = ensembles::all().into_iter().filter(|spec| self.wants(&spec.common.name));
        let wanted = wanted.filter(|_| self.methods().contains(&Method::Direct));
        if self.quick { wanted.map(EnsembleSpec::quick).collect() } else { wanted.collect() }
    }

    fn sequences(&self) -> Vec<SequenceSpec> {
        let all = sequences::all().into_iter().chain(self.long.then(sequences::long));
        let wanted = all.filter(|sequence| self.wants(&sequence.name));
        if self.quick { wanted.filter_map(SequenceSpec::quick).collect() } else { wanted.collect() }
    }
}

/// Prints rows as they are measured: lines of JSON, or of a table.
#[derive(Clone, Copy)]
struct Printer<'a> {
    columns: &'a [Column<'a>],
    as_json: bool,
}

impl<'a> Printer<'a> {
    fn begin(columns: &'a [Column<'a>], count: usize, as_json: bool) -> Self {
        if count > 0 && !as_json {
            print!("\n{}", head(columns));
        }
        Self { columns, as_json }
    }

    fn print(&self, measured: &Value) {
        if self.as_json { println!("{measured}") } else { print!("{}", row(self.columns, measured)) }
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
    let pairs = measure_cells(&cells, &options, args.json)?;
    let followed = measure_sequences(&specs, &options, args.json)?;
    let sequences: Vec<Value> = followed.iter().map(|found| found.row.clone()).collect();
    let ensembles = measure_ensembles(&ensembles, &options, args.json)?;
    let first_poses = measure_first_poses(&objects, &options, args.json)?;
    let checks = limits::checks(&[&pairs[..], &sequences, &ensembles, &first_poses].concat());
    let circumstances = Circumstances::of(&args.root);
    let kept = json!({
        "bench": "accuracy", "where": circumstances.to_json(), "seed": args.seed, "quick": args.quick,
        "pairs": pairs, "sequences": sequences, "ensembles": ensembles, "first_poses": first_poses,
        "limits": checks.iter().map(|check| check.to_json(args.quick)).collect::<Vec<_>>(),
    });
    save(&args.root.join(KEPT), &format!("{kept:#}\n"))?;
    if args.is_full() && !args.no_docs {
        let page = args.root.join(PAGE);
        update(&page, &page::parts(&kept, &circumstances.line()))?;
        save(&page.with_extension("svg"), &page::accuracy_figure(&cells, &pairs))?;
        let drawn = followed.iter().filter(|found| found.row["sequence"] == DRAWN_SEQUENCE);
        let drawn = panels(&page::sequence_panels(drawn, "frame"), 2, &[DRAWN_SEQUENCE.to_owned()]);
        save(&page.with_file_name("accuracy_sequence.svg"), &drawn)?;
    }
    conclude(&checks, args.quick)
}

fn measure_cells(cells: &[cell::Cell], options: &Options, as_json: bool) -> anyhow::Result<Vec<Value>> {
    let printer = Printer::begin(&summary::COLUMNS, cells.len(), as_json);
    let mut scenes = SceneStore::default();
    let mut rows = Vec::new();
    for cell in cells {
        let measured = measure::measure_cell(cell, options, &mut scenes)?;
        for (index, method) in options.methods.iter().enumerate() {
            let row = summary::summary(cell, method.name(), index, &measured);
            printer.print(&row);
            rows.push(row);
        }
    }
    Ok(rows)
}

/// Runs the sequences, one per thread.
fn measure_sequences(specs: &[SequenceSpec], options: &Options, as_json: bool) -> anyhow::Result<Vec<SequenceRow>> {
    let printer = Printer::begin(&sequence_summary::COLUMNS, specs.len(), as_json);
    let begin = || Ok(SceneStore::default());
    let rows = in_parallel(specs.len(), options.threads, begin, |scenes, index| {
        let spec = &specs[index];
        let rows = track::run_sequence(spec, &options.methods, options.seed, scenes)
            .with_context(|| format!("sequence {}", spec.name))?;
        rows.iter().for_each(|found| printer.print(&found.row));
        Ok(rows)
    })?;
    Ok(rows.into_iter().flatten().collect())
}

/// Runs the ensembles one after the other, and the sequences of each on all threads.
fn measure_ensembles(specs: &[EnsembleSpec], options: &Options, as_json: bool) -> anyhow::Result<Vec<Value>> {
    let printer = Printer::begin(&sequence_summary::ENSEMBLE_COLUMNS, specs.len(), as_json);
    let mut rows = Vec::new();
    for spec in specs {
        let begin = || Ok(SceneStore::default());
        let runs = in_parallel(spec.sequences, options.threads, begin, |scenes, index| {
            track::follow(&spec.member(options.seed, index), &[Method::Direct], options.seed, scenes)
        });
        let row = ensemble_row(spec, Method::Direct.name(), &runs.with_context(|| spec.common.name.clone())?);
        printer.print(&row);
        rows.push(row);
    }
    Ok(rows)
}

/// The first poses of all objects.
fn measure_first_poses(
    objects: &[(&str, TargetConfig)],
    options: &Options,
    as_json: bool,
) -> anyhow::Result<Vec<Value>> {
    let printer = Printer::begin(&first_pose::COLUMNS, objects.len(), as_json);
    let moved_s = (!options.quick).then_some(first_pose::MOVED_S);
    in_parallel(
        objects.len(),
        options.threads,
        || Ok(()),
        |(), index| {
            let (name, target) = objects[index];
            let row = first_pose::measure(name, target, options.seed, first_pose::STARTS, moved_s)?;
            printer.print(&row);
            Ok(row)
        },
    )
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
