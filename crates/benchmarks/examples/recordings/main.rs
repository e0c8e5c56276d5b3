//! What recordings cost a live run, how long their replay takes, and whether long ones are whole. Run it by `cargo xtask bench recordings`.

#![allow(clippy::print_stdout, reason = "a program for the console")]

mod cameras;

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::{Command, Output};
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use pb3dp_bag::reader::Bag;
use pb3dp_bag::topics::ours;
use pb3dp_benchmarks::page::update;
use serde_json::Value;

use crate::cameras::Long;

/// Largest lateness of control steps with a recording, relative to that without. Required.
const LATENESS_RATIO_MAX: f64 = 1.1;
/// Lateness that no comparison resolves, ms: the timers of a virtual machine.
const LATENESS_NOISE_MS: f64 = 0.1;
/// Smallest speed of a replay, relative to real time: with and without images. Required.
const SPEED_MIN: f64 = 8.0;
const SPEED_WITHOUT_IMAGES_MIN: f64 = 100.0;
/// Runs without and with a recording, in turn.
const ROUNDS: usize = 3;
/// Attempts for each run.
const ATTEMPTS: usize = 4;

struct Options {
    /// The program.
    program: PathBuf,
    run_s: u32,
    long_minutes: f64,
    page: Option<PathBuf>,
    origin: String,
    /// Folder of the recordings, which are deleted.
    folder: tempfile::TempDir,
}

fn main() -> Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| words.iter().position(|word| word == name).and_then(|at| words.get(at + 1)).cloned();
    let is_quick = words.iter().any(|word| word == "--quick");
    let options = Options {
        program: value("--program").context("--program FILE is missing")?.into(),
        run_s: if is_quick { 6 } else { 60 },
        long_minutes: if is_quick { 0.1 } else { 10.0 },
        page: value("--page").map(PathBuf::from),
        origin: value("--origin").unwrap_or_default(),
        folder: match value("--folder") {
            Some(folder) => tempfile::tempdir_in(folder)?,
            None => tempfile::tempdir()?,
        },
    };
    let mut limits = Limits::default();
    let text = [
        live_runs(&options, &mut limits)?,
        replays(&options, &mut limits)?,
        long(&options, &mut limits)?,
        limits.table(),
    ]
    .join("\n");
    print!("{text}");
    if let Some(page) = &options.page {
        update(page, &[("run", format!("{}\n\n{text}", options.origin))])?;
    }
    ensure!(limits.missed == 0, "limits are missed; see the last table");
    Ok(())
}

/// Requirements with what was measured.
#[derive(Default)]
struct Limits {
    rows: String,
    missed: usize,
    /// Runs that ended early and were made again.
    interrupted: usize,
}

impl Limits {
    fn check(&mut self, what: &str, measured: &str, required: &str, is_met: bool) {
        self.missed += usize::from(!is_met);
        let met = if is_met { "yes" } else { "**no**" };
        let _ = writeln!(self.rows, "| {what} | {measured} | {required} | {met} |");
    }

    fn table(&self) -> String {
        format!("| limit | measured | required | met |\n|---|---:|---:|---|\n{}", self.rows)
    }
}

impl Options {
    fn file(&self) -> PathBuf {
        self.folder.path().join("run.mcap")
    }

    fn pb3dp(&self, arguments: &[&str]) -> Result<Output> {
        let mut command = Command::new(&self.program);
        command.args(arguments).current_dir(self.folder.path());
        command.output().with_context(|| self.program.display().to_string())
    }
}

/// Lateness of the control steps of one run, ms.
struct Lateness {
    p50: f64,
    p99: f64,
}

/// A run in real time with emulated arms and rendered images. A computer that stands still for some cycles stops the arms, and ends the
/// run: then it is made again.
fn whole_run(options: &Options, is_recorded: bool, limits: &mut Limits) -> Result<Lateness> {
    for _ in 0..ATTEMPTS {
        if let Some(lateness) = run(options, is_recorded)? {
            return Ok(lateness);
        }
        limits.interrupted += 1;
    }
    bail!("{ATTEMPTS} runs ended early: the computer stands still for some cycles; measure on an idle one")
}

fn run(options: &Options, is_recorded: bool) -> Result<Option<Lateness>> {
    let seconds = options.run_s.to_string();
    let file = options.file();
    let mut arguments = vec!["run", "--config", "hil", "--stop-after", &seconds, "--out", "out"];
    if is_recorded {
        let _ = std::fs::remove_file(&file);
        arguments.extend(["--record", "run.mcap"]);
    }
    let done = options.pb3dp(&arguments)?;
    if !done.status.success() && String::from_utf8_lossy(&done.stderr).contains("PB3DP-ARM-") {
        return Ok(None);
    }
    let summary = std::fs::read_to_string(options.folder.path().join("out/summary.json"));
    let summary: Value =
        serde_json::from_str(&summary.with_context(|| String::from_utf8_lossy(&done.stderr).into_owned())?)?;
    let cycles = summary["summary"]["cycles"].as_array().context("summary.cycles")?;
    let control = cycles.iter().find(|cycle| cycle["name"] == "control").context("the control thread")?;
    let millis = |key: &str| control[key].as_f64().with_context(|| key.to_owned());
    Ok(Some(Lateness { p50: millis("late_p50_millis")?, p99: millis("late_p99_millis")? }))
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn live_runs(options: &Options, limits: &mut Limits) -> Result<String> {
    let (mut alone, mut recorded) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        alone.push(whole_run(options, false, limits)?);
        recorded.push(whole_run(options, true, limits)?);
    }
    let mut text = String::from(
        "| live run | lateness of control steps, ms: median / p99 | p99 of each run, ms |\n|---|---:|---|\n",
    );
    let p99 = [("not recorded", &alone), ("recorded", &recorded)].map(|(name, runs)| {
        let of = |pick: fn(&Lateness) -> f64| median(runs.iter().map(pick).collect());
        let each: Vec<String> = runs.iter().map(|run| format!("{:.3}", run.p99)).collect();
        let (p50, p99) = (of(|run| run.p50), of(|run| run.p99));
        let _ = writeln!(text, "| {name} | {p50:.3} / {p99:.3} | {} |", each.join(", "));
        p99
    });
    let most = (LATENESS_RATIO_MAX * p99[0]).max(p99[0] + LATENESS_NOISE_MS);
    limits.check(
        "lateness p99 with a recording, ms",
        &format!("{:.3}", p99[1]),
        &format!("at most {most:.3}"),
        p99[1] <= most,
    );
    let bag = Bag::open(&options.file())?;
    let count = |name: &str| bag.topics().iter().find(|topic| topic.name == name).map_or(0, |topic| topic.messages);
    let (pairs, left, right) = (count(ours::PAIRS), count(ours::LEFT_IMAGE), count(ours::RIGHT_IMAGE));
    let megabytes = std::fs::metadata(options.file())?.len() as f64 * 1e-6;
    let rate = megabytes / f64::from(options.run_s);
    let _ = writeln!(
        text,
        "\nThe last recording: {} s, {pairs} estimates, {left} left and {right} right images, {} control steps; {megabytes:.0} MB, {rate:.1} MB/s.",
        options.run_s,
        count(ours::STEPS)
    );
    limits.check(
        "estimates without images in the recording",
        &(2 * pairs - left - right).to_string(),
        "0",
        left == pairs && right == pairs,
    );
    Ok(text)
}

/// Replays the last recording.
fn replays(options: &Options, limits: &mut Limits) -> Result<String> {
    let mut text =
        String::from("| replay of this recording | s | times real time | exit code |\n|---|---:|---:|---:|\n");
    for (name, more, least) in [
        ("with images", &[][..], SPEED_MIN),
        ("`--without-images`", &["--without-images"][..], SPEED_WITHOUT_IMAGES_MIN),
    ] {
        let begun = Instant::now();
        let done = options.pb3dp(&[&["replay", "run.mcap"], more].concat())?;
        let took_s = begun.elapsed().as_secs_f64();
        let speed = f64::from(options.run_s) / took_s;
        let Some(code) = done.status.code() else { bail!("the replay was killed") };
        let _ = writeln!(text, "| {name} | {took_s:.2} | {speed:.0} | {code} |");
        limits.check(&format!("replay {name}: equal to the bit, exit code"), &code.to_string(), "0", code == 0);
        limits.check(
            &format!("replay {name}: times real time"),
            &format!("{speed:.0}"),
            &format!("at least {least:.0}"),
            speed >= least,
        );
    }
    std::fs::remove_file(options.file())?;
    Ok(text)
}

/// Records cameras for minutes.
fn long(options: &Options, limits: &mut Limits) -> Result<String> {
    let mut text = String::from(
        "| cameras | minutes | pairs | lost by the cameras | messages dropped | read back | MB | MB/s |\n|---|---:|---:|---:|---:|---:|---:|---:|\n",
    );
    let file = options.folder.path().join("cameras.mcap");
    let found = cameras::record("MJPG", std::time::Duration::from_secs_f64(60.0 * options.long_minutes), &file)?;
    std::fs::remove_file(&file)?;
    let Long { format, minutes, pairs, lost, dropped, read_back, bytes } = &found;
    let megabytes = *bytes as f64 * 1e-6;
    let rate = megabytes / minutes / 60.0;
    let _ = writeln!(
        text,
        "| {format} | {minutes:.1} | {pairs} | {lost} | {dropped} | {read_back} | {megabytes:.0} | {rate:.2} |"
    );
    let missing = pairs + lost - read_back.min(pairs);
    limits.check(&format!("pairs of {format} that the file lacks"), &missing.to_string(), "0", found.is_whole());
    Ok(text)
}
