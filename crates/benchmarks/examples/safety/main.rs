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
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, bail, ensure};
use digest::digest;
use figures::Figures;
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

/// Command line options.
struct Args {
    seed: u64,
    draw: Draw,
    /// The seed was drawn, not given.
    is_drawn: bool,
    runs: u64,
    rendered: u64,
    /// The kept seeds are repeated, too.
    repeats_kept: bool,
    trace: bool,
    disabled: bool,
    only: String,
    origin: String,
    page: Option<PathBuf>,
}

impl Args {
    fn read(mut words: impl Iterator<Item = String>) -> Result<Self> {
        let mut args = Self {
            seed: 0,
            draw: Draw::PRESENT,
            is_drawn: false,
            runs: RUNS,
            rendered: 0,
            repeats_kept: false,
            trace: false,
            disabled: false,
            only: String::new(),
            origin: "unknown".into(),
            page: None,
        };
        let (mut is_whole, mut is_quick, mut seed, mut rendered) = (true, false, None, None);
        while let Some(word) = words.next() {
            let mut value = || words.next().with_context(|| format!("{word}: no value given"));
            match word.as_str() {
                "--seed" => seed = Some(value()?.parse().context("--seed: give a whole number")?),
                "--draw" => {
                    args.draw = Draw::named(&value()?).context("--draw: first, wide, stalls, starts or cells")?
                }
                "--runs" => (args.runs, is_whole) = (value()?.parse().context("--runs: give a whole number")?, false),
                "--rendered" => rendered = Some(value()?.parse().context("--rendered: give a whole number")?),
                "--quick" => (args.runs, is_whole, is_quick) = (QUICK_RUNS, false, true),
                "--trace" => args.trace = true,
                "--disabled" => args.disabled = true,
                "--only" => args.only = value()?,
                "--origin" => args.origin = value()?,
                "--page" => args.page = Some(value()?.into()),
                _ => bail!(
                    "unknown option {word}; options: --seed N, --draw NAME, --runs N, --rendered N, --quick, --trace, --disabled, --only NAME, --page FOLDER, --origin TEXT"
                ),
            }
        }
        ensure!(!(is_quick && args.page.is_some()), "--quick writes no page: leave out --page");
        args.rendered = rendered.unwrap_or(if is_whole { RENDERED } else { 0 });
        args.repeats_kept = is_whole && !args.disabled;
        // The proofs of the safeguards have seeds of their own.
        (args.seed, args.is_drawn) = match (seed, args.disabled) {
            (Some(seed), _) => (seed, false),
            (None, true) => (1, false),
            (None, false) => (drawn_seed(), true),
        };
        ensure!(args.runs + args.rendered > 0, "--runs and --rendered are both 0: give at least one run");
        Ok(args)
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
        return Some((Scenario::of(args.draw, args.seed + index), true));
    };
    match index.checked_sub(args.runs) {
        None => Some((Scenario::of(args.draw, args.seed + index), false)),
        Some(index) => kept.get(index as usize).map(|scenario| (scenario.clone(), false)),
    }
}

fn all(args: &Args) -> Result<Both> {
    let kept = if args.repeats_kept { kept::scenarios()? } else { Vec::new() };
    let setups = Setups::default();
    let next = AtomicU64::new(0);
    let figures = Mutex::new(Ok(Both::default()));
    let told = Progress::default();
    let work = || {
        while let Some((scenario, rendered)) = scenario(args, &kept, next.fetch_add(1, Ordering::Relaxed)) {
            let judged = judge(&setups, scenario, rendered);
            let Ok(mut figures) = figures.lock() else { return };
            match (judged, figures.as_mut()) {
                (Ok(judged), Ok(Both { plain, rendered })) => {
                    tell(&judged);
                    if args.trace {
                        trace(&judged);
                    }
                    let rules = judged.scenario.workcell.rules();
                    if judged.rendered { &mut *rendered } else { &mut *plain }.add(&judged, &rules);
                    told.tell([plain, rendered], [args.runs + kept.len() as u64, args.rendered]);
                }
                (Err(error), Ok(_)) => {
                    *figures = Err(error);
                    return;
                }
                (_, Err(_)) => return,
            }
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(work);
        }
    });
    figures.into_inner().map_err(|_| anyhow::anyhow!("a run panicked; see its message above"))?
}

fn main() -> Result<ExitCode> {
    let args = Args::read(std::env::args().skip(1))?;
    if args.disabled {
        return proofs::run(&args);
    }
    if args.is_drawn {
        println!("seed {}, drawn; repeat these runs with --seed {0}\n", args.seed);
    }
    let figures = all(&args)?;
    let Both { plain, rendered } = &figures;
    let text = page::text(plain, rendered, args.seed, &args.origin);
    if !args.trace {
        println!("{text}");
    }
    if let Some(folder) = &args.page {
        page::write_part(folder, Some(&text), None)?;
    }
    println!("{} virtual seconds per run, hash of all: {:016x}", RUN_S, plain.digest.wrapping_add(rendered.digest));
    Ok(if plain.broken() + rendered.broken() == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let read = |words: &[&str]| Args::read(words.iter().map(|word| (*word).to_owned()));
        let quick = read(&["--quick", "--seed", "7"]).unwrap();
        assert!((quick.runs, quick.rendered, quick.seed) == (QUICK_RUNS, 0, 7) && !quick.is_drawn);
        assert!(!quick.repeats_kept);
        let full = read(&[]).unwrap();
        assert!(full.is_drawn && full.repeats_kept && full.seed > 0 && full.runs == RUNS);
        assert!(read(&["--quick", "--page", "docs"]).is_err() && read(&["--runs"]).is_err() && read(&["-x"]).is_err());
    }

    /// Some runs, twice: no invariant is violated, and all numbers are identical.
    #[test]
    fn seeded_runs_keep_the_invariants_and_repeat_themselves() {
        let args = Args::read(["--seed", "1", "--runs", "12"].map(str::to_owned).into_iter()).unwrap();
        let (one, other) = (all(&args).unwrap(), all(&args).unwrap());
        assert!(one.plain.violations.is_empty(), "{:?}", one.plain.violations);
        assert_eq!((one.plain.runs, one.rendered.runs), (12, 0));
        assert_eq!(one.plain.digest, other.plain.digest, "the same seeds gave other runs");
    }
}
