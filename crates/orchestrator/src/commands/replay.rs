//! `pb3dp replay`: a recorded run again, compared with the recording to the bit; or two recorded runs, compared with each other.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_bag::sinks::Sinks;
use pb3dp_bag::writer::{BagWriter, WhenFull};
use pb3dp_cell::terminal::print_line;
use pb3dp_estimation::estimator::Method;
use pb3dp_geometry::MonotonicTime;
use pb3dp_recording::compare::Comparison;
use pb3dp_recording::pairs::{About, is_file};
use pb3dp_recording::replay::{Estimates, Opened, ReplayOptions, Replayed};
use pb3dp_setup::layers::toml_of;

use crate::arguments::UNSURE;
use crate::commands::run::create_parent;

/// Missing inputs that are named one by one.
const NOTES_SHOWN: usize = 5;

/// Arguments of `pb3dp replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// The recording of a run.
    #[arg(value_name = "FILE.mcap", required_unless_present = "compare")]
    file: Option<PathBuf>,
    /// Set one key of the recorded settings, for instance `servo.feed_forward.position_per_s=12`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Estimate with this method, `direct` or `published`, and without others beside it.
    #[arg(long, value_name = "METHOD")]
    method: Option<String>,
    /// Take the recorded estimates as inputs, for a replay of the control only; images are not needed.
    #[arg(long)]
    without_images: bool,
    /// Record the replay in a new file.
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Compare two recorded runs, such as a recording and its replay with `--record`: settings, estimates, filter, commands and decisions;
    /// exit code 3 if these differ.
    #[arg(
        long,
        num_args = 2,
        value_names = ["A.mcap", "B.mcap"],
        conflicts_with_all = ["file", "set", "method", "without_images", "record"]
    )]
    compare: Vec<PathBuf>,
    /// With --compare: folder for compare.html, a page with plots over time, and compare.csv, a line for each pair.
    // Also a conflict: clap does not require what conflicts with another argument.
    #[arg(long, value_name = "DIR", requires = "compare", conflicts_with = "file")]
    out: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// A file that is no recording of a run, settings that are refused, or a new file that cannot be written.
pub fn run(args: &ReplayArgs) -> Result<ExitCode> {
    match (&args.compare[..], &args.file) {
        ([a, b], _) => compare([a, b], args.out.as_deref()),
        (_, file) => replay(file.as_deref().context("name the recording of a run, or two with --compare")?, args),
    }
}

fn compare([a, b]: [&Path; 2], out: Option<&Path>) -> Result<ExitCode> {
    let comparison = Comparison::of_files(a, b).context("--compare")?;
    print_line(&comparison.text())?;
    if let Some(folder) = out {
        let files = comparison.write(folder).context("--out")?;
        print_line(&files.map(|file| format!("written: {}", file.display())).join("\n"))?;
    }
    Ok(if comparison.is_equal() { ExitCode::SUCCESS } else { ExitCode::from(UNSURE) })
}

fn replay(file: &Path, args: &ReplayArgs) -> Result<ExitCode> {
    if let Some(method) = &args.method {
        Method::from_name(method).context("--method")?;
    }
    // A method is not compared with itself.
    let method = args.method.iter();
    let method = method.flat_map(|method| [format!("estimator.method={method}"), "estimator.compare=[]".to_owned()]);
    let set: Vec<String> = args.set.iter().cloned().chain(method).collect();
    let options =
        ReplayOptions { set, estimates: if args.without_images { Estimates::Recorded } else { Estimates::Anew } };
    let started = Instant::now();
    let mut opened = Opened::new(file, &options)?;
    let settings = toml_of(&opened.setup.layers.effective());
    let mut about = About::new(settings, crate::COMMIT, MonotonicTime::ZERO)?;
    about.version += &format!(", a replay of {}", file.display());
    let writer = args.record.as_deref().map(new_recording).transpose().context("--record")?;
    let replayed = opened.replay(writer.map(|writer| (&about, Sinks::new(Some(writer), None, None))), false)?;
    print_line(&text(&replayed, started.elapsed().as_secs_f64()))?;
    Ok(if replayed.differences.any() { ExitCode::from(UNSURE) } else { ExitCode::SUCCESS })
}

/// A new file, in a folder that is created.
fn new_recording(file: &Path) -> Result<BagWriter> {
    if !is_file(file) {
        bail!("{}: a replay is recorded in one file; name a FILE.mcap", file.display());
    }
    create_parent(file)?;
    Ok(BagWriter::create(file, WhenFull::Wait)?)
}

fn text(replayed: &Replayed, wall_s: f64) -> String {
    let Replayed { version, steps, pairs, duration_s, differences, notes, end, .. } = replayed;
    let times = duration_s / wall_s.max(1e-9);
    let mut text = format!(
        "recorded by {version}\n{steps} control steps and {pairs} pairs of {duration_s:.1} s in {wall_s:.1} s: {times:.1} times as fast\n{}",
        differences.text()
    );
    for note in notes.iter().take(NOTES_SHOWN) {
        text += &format!("missing: {note}\n");
    }
    if notes.len() > NOTES_SHOWN {
        text += &format!("missing: {} more inputs\n", notes.len() - NOTES_SHOWN);
    }
    if end.is_none() {
        text += "the recording has no end: it was broken off, or goes on in another file\n";
    }
    text + match (differences.any(), notes.is_empty()) {
        (true, _) => "the replay differs",
        (false, true) => "equal to the bit",
        (false, false) => "equal to the bit, but inputs are missing",
    }
}
