//! Seeded runs with random faults, checked against the simulator's truth. Run it by `cargo xtask bench safety`.
#![allow(clippy::print_stdout, reason = "prints its figures")]

mod cameras;
mod control;
mod digest;
mod effects;
mod faults;
mod figures;
mod kept;
mod page;
mod program_log;
mod proofs;
mod recorder;
mod restart;
mod rig;
mod scenario;
mod speaker;
mod stalls;
mod telling;
mod workcell;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use digest::digest;
use figures::Figures;
use pb3dp_benchmarks::page::{text, update};
use pb3dp_benchmarks::parallel::in_parallel;
use pb3dp_hal_platform::cpu_time::timed;
use rig::{Ran, run};
use scenario::{Draw, RUN_S, Scenario};
use system_tests::safety::invariants::{Invariant, Violation, check, check_recorder_stall};
use system_tests::safety::shape::room_m;
use system_tests::safety::truth::ARM_NAMES;
use workcell::Setups;

/// Runs of a full measurement.
const RUNS: u64 = 20_000;
/// Number of these runs that are repeated with images.
const RENDERED: u64 = 200;
/// Runs of a quick measurement.
const QUICK_RUNS: u64 = 200;

/// Largest difference between the drawn and the actual time of camera faults, seconds; more would make the table wrong.
const LEAD_OFF_MAX_S: f64 = 0.2;

/// Seeded runs with random faults, checked against the simulator's truth.
#[derive(Parser)]
struct Options {
    /// Seed of the first run; without it a fresh one is drawn and printed.
    #[arg(long, value_name = "NUMBER")]
    seed: Option<u64>,
    /// The draw of the scenarios: first, wide, stalls, starts or cells.
    #[arg(long, value_parser = draw, default_value = Draw::PRESENT.name())]
    draw: Draw,
    /// Number of runs.
    #[arg(long, value_name = "NUMBER")]
    runs: Option<u64>,
    /// Number of these runs that are repeated with images.
    #[arg(long, value_name = "NUMBER")]
    rendered: Option<u64>,
    /// 200 runs, and no page.
    #[arg(long, conflicts_with_all = ["page", "runs"])]
    quick: bool,
    /// Prints all that happens.
    #[arg(long)]
    trace: bool,
    /// Disables each safeguard, which must cause a violation.
    #[arg(long)]
    disabled: bool,
    /// Only safeguards whose name contains this.
    #[arg(long, default_value = "", value_name = "NAME")]
    only: String,
    /// Commit and machine, for the page.
    #[arg(long, default_value = "unknown", value_name = "TEXT")]
    origin: String,
    /// Folder of the page.
    #[arg(long, value_name = "FOLDER")]
    page: Option<PathBuf>,
}

fn draw(name: &str) -> Result<Draw> {
    Draw::named(name).context("give first, wide, stalls, starts or cells")
}

/// The options, and what follows from them.
struct Args {
    options: Options,
    seed: u64,
    runs: u64,
    rendered: u64,
    /// The kept seeds are repeated, too.
    repeats_kept: bool,
}

impl Args {
    fn of(options: Options) -> Result<Self> {
        let is_whole = !options.quick && options.runs.is_none();
        // The proofs of the safeguards have seeds of their own.
        let seed = options.seed.unwrap_or_else(|| if options.disabled { 1 } else { drawn_seed() });
        let runs = options.runs.unwrap_or(if options.quick { QUICK_RUNS } else { RUNS });
        let rendered = options.rendered.unwrap_or(if is_whole { RENDERED } else { 0 });
        ensure!(runs + rendered > 0, "--runs and --rendered are both 0: give at least one run");
        Ok(Self { repeats_kept: is_whole && !options.disabled, options, seed, runs, rendered })
    }
}

/// A seed that no run before had; it is printed, so that the runs can be repeated.
fn drawn_seed() -> u64 {
    /// Seeds stay short enough to be typed.
    const DIGITS: u64 = 1_000_000_000_000;
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    since.as_millis() as u64 * 1000 % DIGITS
}

/// Result of one seed.
pub struct Judged {
    /// The seed.
    pub scenario: Scenario,
    /// Whether images were rendered and processed.
    pub rendered: bool,
    /// What happened.
    pub ran: Ran,
    /// Violations.
    pub violations: Vec<Violation>,
    /// Hash of the whole record.
    pub digest: u64,
    /// CPU time, milliseconds.
    pub cpu_millis: f64,
}

/// Runs one scenario and checks the invariants.
///
/// # Errors
/// If the setup cannot be built.
fn judge(setups: &Setups, scenario: Scenario, rendered: bool) -> Result<Judged> {
    let seed = scenario.seed;
    let (setup, rules) = (setups.get(scenario.workcell.settings, rendered)?, scenario.workcell.rules());
    let ((ran, violations), cpu_millis) = timed(|| {
        let ran = run(&setup, &scenario);
        let undisturbed = scenario.without_recorder_stalls().map(|scenario| run(&setup, &scenario)).transpose();
        let mut violations = ran.as_ref().map_or_else(|_| Vec::new(), |ran| check(&rules, &ran.truth));
        if let (Ok(ran), Ok(Some(undisturbed))) = (&ran, &undisturbed) {
            violations.extend(check_recorder_stall(&ran.truth, &undisturbed.truth));
        }
        (ran.and_then(|ran| undisturbed.map(|_| ran)), violations)
    });
    let ran = ran.with_context(|| format!("seed {seed}"))?;
    let digest = digest(&ran.truth);
    if let Some(lead_s) = ran.lead_s {
        ensure!(
            (lead_s - cameras::LEAD_S).abs() < LEAD_OFF_MAX_S,
            "seed {seed}: the control loop started {lead_s} s after the camera; set LEAD_S in cameras.rs to this value"
        );
    }
    Ok(Judged { scenario, rendered, violations, digest, cpu_millis, ran })
}

/// The command that repeats one seed, with or without images.
pub fn replay((seed, draw): (u64, Draw), rendered: bool) -> String {
    let runs = if rendered { "--runs 0 --rendered 1" } else { "--runs 1" };
    let draw = if draw == Draw::PRESENT { String::new() } else { format!(" --draw {}", draw.name()) };
    format!("cargo xtask bench safety --seed {seed}{draw} {runs} --trace")
}

fn tell(judged: &Judged) {
    let seed = judged.scenario.seed;
    for violation in &judged.violations {
        println!("seed {seed}: {violation}\n  repeat: {}", replay((seed, judged.scenario.draw), judged.rendered));
    }
}

/// Prints the trace of one run.
fn trace(judged: &Judged) {
    let Judged { scenario, ran, digest, .. } = judged;
    println!("seed {}: {}, digest {digest:016x}", scenario.seed, scenario.motion_name);
    println!("target: {:?}, {:?}", scenario.carrier, scenario.motion);
    println!("workcell: {:?}", scenario.workcell);
    for (fault, became) in scenario.faults.iter().zip(&ran.became) {
        println!("{:7.3} to {:7.3} s  {:?}: {}", fault.from_s, fault.until_s(), fault.kind, became.name());
    }
    let mut lines: Vec<_> = ran.notes.iter().chain(&ran.truth.log).collect();
    lines.sort_by_key(|line| line.t_millis);
    for line in lines {
        println!("{:7.3} s  {}", line.t_millis as f64 * 1e-3, line.text.trim_start());
    }
    let rules = scenario.workcell.rules();
    for (arm, rules) in rules.arms.iter().enumerate() {
        let used = |joint: usize| {
            let shares =
                ran.truth.steps.iter().map(|step| step.arms[arm].position_rad[joint] / rules.operating_rad[joint]);
            let (least, most) =
                shares.fold((0.0f64, 0.0f64), |(least, most), share| (least.min(share), most.max(share)));
            format!("{least:.2} to {most:.2}")
        };
        let used: Vec<_> = (0..7).map(used).collect();
        println!("{}: used shares of the operating ranges: {}", ARM_NAMES[arm], used.join(", "));
    }
    let [mut one, mut other] = [Vec::new(), Vec::new()];
    let rooms = ran.truth.steps.iter().map(|step| {
        rules.arms[0].body.place(&step.arms[0].position_rad, &mut one);
        rules.arms[1].body.place(&step.arms[1].position_rad, &mut other);
        room_m(&one, &other)
    });
    println!("smallest distance between the arms: {:.0} mm", 1e3 * rooms.fold(f64::INFINITY, f64::min));
    let to_target = ran.truth.steps.iter().step_by(100).map(|step| {
        rules.arms[0].body.place(&step.arms[0].position_rad, &mut one);
        let target: Vec<_> = rules.target.iter().map(|rod| rod.placed(&step.world_from_target)).collect();
        format!("{:.0}", 1e3 * room_m(&one[3..], &target))
    });
    println!("distance of hand and target every 0.2 s, mm: {}", to_target.collect::<Vec<_>>().join(" "));
    println!("ended: {}", ran.ended.as_deref().unwrap_or("end of the run"));
    let broken = |invariant: Invariant| judged.violations.iter().any(|violation| violation.invariant == invariant);
    let [held, violated]: [Vec<&str>; 2] = [false, true].map(|wanted| {
        Invariant::ALL.into_iter().filter(|&invariant| broken(invariant) == wanted).map(Invariant::name).collect()
    });
    println!("held, {} of {}: {}", held.len(), Invariant::ALL.len(), held.join(", "));
    println!("violated: {}", if violated.is_empty() { "none".to_owned() } else { violated.join(", ") });
}

/// Progress of a long measurement: one line per minute.
struct Progress {
    since: Instant,
    minutes: AtomicU64,
}

impl Default for Progress {
    fn default() -> Self {
        Self { since: Instant::now(), minutes: AtomicU64::new(0) }
    }
}

impl Progress {
    fn tell(&self, [plain, rendered]: [&Figures; 2], [runs, with_images]: [u64; 2]) {
        let minutes = self.since.elapsed().as_secs() / 60;
        if self.minutes.swap(minutes, Ordering::Relaxed) < minutes {
            let violations = plain.broken() + rendered.broken();
            let (done, shown, rate) = (plain.runs, rendered.runs, plain.times_real_time());
            println!(
                "{minutes} min: {done} of {runs} runs, {shown} of {with_images} with images, {violations} violations, {rate:.0} times real time per core"
            );
        }
    }
}

/// Statistics of many runs, without and with images.
#[derive(Default)]
struct Both {
    plain: Figures,
    rendered: Figures,
}

/// The scenario of a run with this index, and whether it has images. Runs with images take longest, so they start first.
fn scenario(args: &Args, kept: &[Scenario], index: u64) -> Option<(Scenario, bool)> {
    let Some(index) = index.checked_sub(args.rendered) else {
        return Some((Scenario::of(args.options.draw, args.seed + index), true));
    };
    match index.checked_sub(args.runs) {
        None => Some((Scenario::of(args.options.draw, args.seed + index), false)),
        Some(index) => kept.get(index as usize).map(|scenario| (scenario.clone(), false)),
    }
}

fn all(args: &Args) -> Result<Both> {
    let kept = if args.repeats_kept { kept::scenarios()? } else { Vec::new() };
    let (setups, figures, progress) = (Setups::default(), Mutex::new(Both::default()), Progress::default());
    let (runs, threads) = (args.runs + kept.len() as u64, std::thread::available_parallelism().map_or(1, usize::from));
    in_parallel(
        (args.rendered + runs) as usize,
        threads,
        || Ok(()),
        |(), index| {
            let (scenario, rendered) = scenario(args, &kept, index as u64).context("a run without a scenario")?;
            let judged = judge(&setups, scenario, rendered)?;
            let mut figures = figures.lock().unwrap_or_else(PoisonError::into_inner);
            let Both { plain, rendered } = &mut *figures;
            tell(&judged);
            if args.options.trace {
                trace(&judged);
            }
            let rules = judged.scenario.workcell.rules();
            if judged.rendered { &mut *rendered } else { &mut *plain }.add(&judged, &rules);
            progress.tell([plain, rendered], [runs, args.rendered]);
            Ok(())
        },
    )?;
    Ok(figures.into_inner().unwrap_or_else(PoisonError::into_inner))
}

fn main() -> Result<ExitCode> {
    let args = Args::of(Options::parse())?;
    if args.options.disabled {
        return proofs::run(&args);
    }
    if args.options.seed.is_none() {
        println!("seed {}, drawn; repeat these runs with --seed {0}\n", args.seed);
    }
    let figures = all(&args)?;
    let Both { plain, rendered } = &figures;
    let parts = page::parts(plain, rendered, args.seed, &args.options.origin);
    if !args.options.trace {
        println!("{}", text(&parts));
    }
    if let Some(folder) = &args.options.page {
        update(&folder.join("safety.md"), &parts)?;
    }
    println!("{} virtual seconds per run, hash of all: {:016x}", RUN_S, plain.digest.wrapping_add(rendered.digest));
    Ok(if plain.broken() + rendered.broken() == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(arguments: &[&str]) -> Result<Args> {
        Args::of(Options::try_parse_from(std::iter::once("safety").chain(arguments.iter().copied()))?)
    }

    #[test]
    fn seeds_that_broke_an_invariant_keep_them_all() {
        let setups = Setups::default();
        for scenario in kept::scenarios().unwrap() {
            let judged = judge(&setups, scenario, false).unwrap();
            assert!(judged.violations.is_empty(), "{}: {:?}", judged.scenario.seed, judged.violations);
        }
    }

    #[test]
    fn options_are_read() {
        let quick = read(&["--quick", "--seed", "7"]).unwrap();
        assert!((quick.runs, quick.rendered, quick.seed) == (QUICK_RUNS, 0, 7) && !quick.repeats_kept);
        let full = read(&[]).unwrap();
        assert!(full.options.seed.is_none() && full.repeats_kept && full.seed > 0 && full.runs == RUNS);
        assert!(read(&["--quick", "--page", "docs"]).is_err() && read(&["--runs"]).is_err() && read(&["-x"]).is_err());
    }

    /// Some runs, twice: no invariant is violated, and all numbers are identical.
    #[test]
    fn seeded_runs_keep_the_invariants_and_repeat_themselves() {
        let args = read(&["--seed", "1", "--runs", "12"]).unwrap();
        let (one, other) = (all(&args).unwrap(), all(&args).unwrap());
        assert!(one.plain.violations.is_empty(), "{:?}", one.plain.violations);
        assert_eq!((one.plain.runs, one.rendered.runs), (12, 0));
        let page = tempfile::tempdir().unwrap();
        let parts = page::parts(&one.plain, &one.plain, 1, "a test");
        update(&page.path().join("safety.md"), &parts).unwrap();
        assert!(!text(&parts).contains('?'), "{parts:?}");
        assert_eq!(one.plain.digest, other.plain.digest, "the same seeds gave other runs");
    }
}
