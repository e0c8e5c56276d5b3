//! The experiment of `configs/hil.toml` three times: in simulated time and in real time with simulated joints in this
//! process, then through serial lines and by TCP with a key to emulated arms. Run it by `cargo xtask hil`.
#![allow(clippy::print_stdout, reason = "prints its figures")]

use std::fmt::Write as _;
use std::io::{BufReader, PipeWriter, Write as _, pipe};
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_cell::attended::AttendedCommand;
use pb3dp_cell::console::{Console, ConsoleOptions};
use pb3dp_cell::cycles::CycleSummary;
use pb3dp_cell::experiment;
use pb3dp_cell::figures::RmsMax;
use pb3dp_cell::parts::{ArmChoice, Parts};
use pb3dp_cell::summary::{RunSummary, summarize};
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::key_file::write_new_key;
use pb3dp_hal_platform::witness::{PERIOD, TOO_LATE, Witness};
use pb3dp_setup::setup::{ArmLink, Pace, Setup, read_setup};
use pb3dp_wiring::commissioning::{emulate_at_address, set_line};
use pb3dp_wiring::wire;
use system_tests::repository;

/// Largest ratio of the tracking error with arms behind gateways to that in simulated time.
const RATIO_MAX: f64 = 1.2;

/// Name of the run by TCP.
const TCP: &str = "TCP with a key, real time";

fn main() -> Result<()> {
    let options = Options::parse(std::env::args().skip(1))?;
    let hil = read_setup(&repository().join("configs/hil.toml"))?;
    let mut in_process = hil.clone();
    (in_process.rig.arms.vs.link, in_process.rig.arms.tc.link) = (ArmLink::InProcess, ArmLink::InProcess);
    let mut simulated = in_process.clone();
    simulated.pace = Pace::Fast;
    let mut runs = Vec::new();
    for (name, setup) in [
        ("in process, simulated time", &simulated),
        ("in process, real time", &in_process),
        ("serial lines, real time", &hil),
    ] {
        println!("{name} ...");
        runs.push((name, run(setup, options.stop_after_s).context(name)?));
    }
    println!("{TCP} ...");
    runs.push((TCP, run_by_tcp(&hil, options.stop_after_s).context(TCP)?));
    let figures = Figures::of(runs)?;
    let tables = figures.tables();
    print!("\n{tables}");
    if let Some(file) = &options.page {
        std::fs::write(file, page(&options.origin, &tables)).with_context(|| format!("cannot write {file}"))?;
    }
    figures.judge()
}

fn run(setup: &Setup, stop_after_s: Option<f64>) -> Result<RunSummary> {
    run_with(setup, wire(setup)?, stop_after_s)
}

fn run_with(setup: &Setup, parts: Parts, stop_after_s: Option<f64>) -> Result<RunSummary> {
    // In simulated time no thread can be late.
    let witness = (setup.pace == Pace::Live).then(Witness::start).transpose()?;
    let outcome = experiment::run(setup, parts, stop_after_s, None);
    let machine = witness.map(|witness| CycleSummary::new("the machine", PERIOD, &witness.end()));
    let outcome = outcome.with_context(|| machine.as_ref().map_or(String::new(), doubt))?;
    let mut summary = summarize(&outcome.log, &outcome.plan);
    summary.cycles.extend(machine);
    Ok(summary)
}

/// A run with arms that are emulated behind gateways on TCP, whose frames carry a counter and a MAC.
fn run_by_tcp(hil: &Setup, stop_after_s: Option<f64>) -> Result<RunSummary> {
    let folder = tempfile::tempdir()?;
    let key_file = folder.path().join("arms.key");
    write_new_key(&key_file)?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let mut setup = hil.clone();
    let mut arms = Vec::new();
    for choice in [ArmChoice::Vs, ArmChoice::Tc] {
        let arm = emulate_at_address(hil, choice, &key_file, &clock)?;
        set_line(&mut setup, choice, arm.address().parse()?, key_file.clone());
        arms.push(arm);
    }
    // What answers by TCP counts as real: somebody must press a key.
    let mut parts = wire(&setup)?;
    let (keys, keyboard) = pipe()?;
    std::thread::spawn(move || press_enter(keyboard));
    let options = ConsoleOptions { interrupt: Arc::clone(&parts.interrupt), prompt: "", targets: None };
    let console = Console::start(Arc::clone(&parts.clock), BufReader::new(keys), std::io::sink(), options)?;
    parts.operator = Box::new(AttendedCommand::new(console.with_keys(setup.operator_key_within)));
    run_with(&setup, parts, stop_after_s)
}

/// Presses Enter every two seconds until nobody reads it.
fn press_enter(mut keyboard: PipeWriter) {
    while keyboard.write_all(b"\n").is_ok() {
        std::thread::sleep(Duration::from_secs(2));
    }
}

/// Explains how long the machine delayed a thread of highest priority.
fn doubt(machine: &CycleSummary) -> String {
    let late = machine.late_max_millis;
    let advice = if late > TOO_LATE.as_secs_f64() * 1e3 {
        "too late for a cycle of 10 ms; repeat on a machine without other load (virtual machines often share processors)"
    } else {
        "so the machine did not cause the delay"
    };
    format!("the machine delayed its thread of highest priority by up to {late:.1} ms; {advice}")
}

/// Tracking error of the hand in a run.
struct Row {
    name: &'static str,
    summary: RunSummary,
    /// Relative to the desired pose from the initial lock, while the target moves.
    moving_mm: RmsMax,
    moving_deg: RmsMax,
}

struct Figures {
    /// The run in simulated time first.
    rows: Vec<Row>,
}

impl Figures {
    fn of(runs: Vec<(&'static str, RunSummary)>) -> Result<Self> {
        let rows = runs.into_iter().map(|(name, summary)| {
            let of = |error: Option<RmsMax>| error.with_context(|| format!("{name}: the target was not tracked"));
            let (moving_mm, moving_deg) = (of(summary.locked.moving_mm)?, of(summary.locked.moving_deg)?);
            Ok(Row { name, moving_mm, moving_deg, summary })
        });
        Ok(Self { rows: rows.collect::<Result<_>>()? })
    }

    fn tables(&self) -> String {
        let mut text = String::from(
            "| run | moving rms, mm | max | moving rms, deg | max | hold rms, mm | rms, deg | total rms, mm | rms, deg | lag, s |\n\
             |---|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n",
        );
        let or_dash = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
        let rms = |error: Option<RmsMax>| error.map_or("-".to_owned(), |error| format!("{:.3}", error.rms));
        for Row { name, summary, moving_mm, moving_deg } in &self.rows {
            let _ = writeln!(
                text,
                "| {name} | {:.2} | {:.2} | {:.3} | {:.2} | {} | {} | {} | {} | {} |",
                moving_mm.rms,
                moving_mm.max,
                moving_deg.rms,
                moving_deg.max,
                rms(summary.locked.hold_mm),
                rms(summary.locked.hold_deg),
                rms(summary.tracking_position_mm),
                rms(summary.tracking_orientation_deg),
                or_dash(summary.lag_s),
            );
        }
        text += "\n| run | frames | without pose | latency p50, ms | p99 |\n|---|---:|---:|---:|---:|\n";
        for Row { name, summary, .. } in &self.rows {
            let _ = writeln!(
                text,
                "| {name} | {} | {} | {} | {} |",
                summary.frames,
                summary.frames_without_pose,
                or_dash(summary.latency_p50_millis),
                or_dash(summary.latency_p99_millis),
            );
        }
        text += &format!("\nError in motion relative to that in simulated time; at most {RATIO_MAX} is allowed:\n\n");
        text += "| run | position | orientation |\n|---|---:|---:|\n";
        for (name, [position, orientation]) in self.ratios() {
            let _ = writeln!(text, "| {name} | {position:.2} | {orientation:.2} |");
        }
        text += "\n";
        text +=
            "| run | cycle | period, ms | begun | late p50, ms | p99 | max | skipped | not consumed | replies lost |\n";
        text += "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|\n";
        for Row { name, summary, .. } in &self.rows {
            for cycle in &summary.cycles {
                let _ = writeln!(
                    text,
                    "| {name} | {} | {:.1} | {} | {:.2} | {:.2} | {:.2} | {} | {} | {} |",
                    cycle.name,
                    cycle.period_millis,
                    cycle.cycles,
                    cycle.late_p50_millis,
                    cycle.late_p99_millis,
                    cycle.late_max_millis,
                    cycle.missed,
                    cycle.dropped,
                    cycle.replies_lost,
                );
            }
        }
        text
    }

    /// Ratios of position and orientation error of the other runs to those in simulated time.
    fn ratios(&self) -> impl Iterator<Item = (&'static str, [f64; 2])> {
        let of = |row: &Row| [row.moving_mm.rms, row.moving_deg.rms];
        let simulated = self.rows.first().map_or([f64::NAN; 2], of);
        self.rows.iter().skip(1).map(move |row| (row.name, [0, 1].map(|which| of(row)[which] / simulated[which])))
    }

    fn judge(&self) -> Result<()> {
        for ((name, [position, orientation]), row) in self.ratios().zip(self.rows.iter().skip(1)) {
            // A NaN ratio is a failure, too.
            if position <= RATIO_MAX && orientation <= RATIO_MAX {
                continue;
            }
            let machine = row.summary.cycles.last().map_or(String::new(), doubt);
            bail!(
                "{name}: the errors in position and orientation are {position:.2} and {orientation:.2} times those in simulated time, the \
                 limit is {RATIO_MAX}; {machine}"
            )
        }
        Ok(())
    }
}

fn page(origin: &str, tables: &str) -> String {
    format!(
        "# Hardware in the loop\n\n\
         This page is written by the command below; change the program, not the page.\n\n\
         The experiment of `configs/hil.toml` ([hil.md](../hil.md)), with the method `direct`.\n\
         The first estimate of the target's plane has an error, which is constant during a run and is most of the \
         total error.\n\
         Therefore the errors while moving and holding are relative to the desired pose from the initial lock.\n\n\
         * **in process, simulated time**: joints simulated in the process, one thread, as in `configs/sim.toml`.\n\
         * **in process, real time**: the same joints, with perception and control on separate threads.\n\
         * **serial lines, real time**: both arms emulated byte by byte behind gateways on pseudo-terminals.\n\
         * **TCP with a key, real time**: the same behind gateways on TCP ports of this computer, with a counter and a MAC in each \
         frame; all gateways check their own limits.\n\n\
         Cycles: the control loop runs every 10 ms, and so do the links; `late` is the delay of the start of a cycle.\n\
         `the machine` is a thread of highest priority on each processor that only sleeps for 1 ms: its delay does not come from this \
         program; the worst processor is shown.\n\n\
         ```text\ncargo xtask hil\n```\n\n{origin}\n\n{tables}"
    )
}

/// The command line options.
#[derive(Default)]
struct Options {
    stop_after_s: Option<f64>,
    page: Option<String>,
    origin: String,
}

impl Options {
    fn parse(mut args: impl Iterator<Item = String>) -> Result<Self> {
        let mut options = Self::default();
        while let Some(arg) = args.next() {
            let value = args.next().with_context(|| format!("{arg}: no value given"))?;
            match arg.as_str() {
                "--stop-after" => {
                    let seconds: f64 = value.parse().with_context(|| format!("--stop-after {value}: not a number"))?;
                    options.stop_after_s = Some(seconds);
                }
                "--page" => options.page = Some(value),
                "--origin" => options.origin = value,
                other => bail!("unknown option {other}; options: --stop-after, --page, --origin"),
            }
        }
        Ok(options)
    }
}
