//! Seeded runs in which everything goes wrong, judged on the simulator's truth. Run it by `cargo xtask bench safety`.
#![allow(clippy::print_stdout, reason = "prints its figures")]

mod digest;
mod faults;
mod figures;
mod page;
#[cfg(feature = "disabled-guards")]
mod proofs;
mod recorder;
mod rig;
mod scenario;
mod speaker;
mod telling;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use pb3dp_orchestrator::config::setup::Setup;
use pb3dp_orchestrator::cpu_time::timed;
use system_tests::safety::invariants::{Violation, check};
use system_tests::safety::rules::Rules;
use system_tests::safety::shape::room_m;
use system_tests::safety::truth::ARM_NAMES;

use digest::digest;
use figures::Figures;
use rig::{Ran, base, run};
use scenario::{RUN_S, Scenario};

/// Runs of a whole measurement.
const RUNS: u64 = 20_000;
/// Runs of a quick one.
const QUICK_RUNS: u64 = 200;

/// What was asked for.
struct Args {
    seed: u64,
    runs: u64,
    trace: bool,
    disabled: bool,
    only: String,
    origin: String,
    page: Option<PathBuf>,
}

impl Args {
    fn read(mut words: impl Iterator<Item = String>) -> Result<Self> {
        let (only, origin) = (String::new(), "unknown".into());
        let mut args = Self { seed: 1, runs: RUNS, trace: false, disabled: false, only, origin, page: None };
        while let Some(word) = words.next() {
            let mut value = || words.next().with_context(|| format!("{word} needs a value"));
            match word.as_str() {
                "--seed" => args.seed = value()?.parse().context("--seed: a number from 0 on")?,
                "--runs" => args.runs = value()?.parse().context("--runs: a number from 1 on")?,
                "--quick" => args.runs = QUICK_RUNS,
                "--trace" => args.trace = true,
                "--disabled" => args.disabled = true,
                "--only" => args.only = value()?,
                "--origin" => args.origin = value()?,
                "--page" => args.page = Some(value()?.into()),
                _ => bail!(
                    "{word}: --seed N, --runs N, --quick, --trace, --disabled, --only NAME, --page FOLDER and --origin TEXT are known"
                ),
            }
        }
        ensure!(args.runs > 0, "--runs: at least one");
        Ok(args)
    }
}

/// What one seed came to.
pub struct Judged {
    /// Of which seed.
    pub scenario: Scenario,
    /// What happened.
    pub ran: Ran,
    /// What did not hold.
    pub violations: Vec<Violation>,
    /// Of the whole record.
    pub digest: u64,
    /// CPU time, milliseconds.
    pub cpu_millis: f64,
}

/// Runs one seed and judges it.
///
/// # Errors
/// If it can not be wired.
fn judge(setup: &Setup, rules: &Rules, scenario: Scenario) -> Result<Judged> {
    let seed = scenario.seed;
    let (ran, cpu_millis) = timed(|| run(setup, &scenario));
    let ran = ran.with_context(|| format!("seed {seed}"))?;
    let violations = check(rules, &ran.truth);
    let digest = digest(&ran.truth);
    Ok(Judged { scenario, violations, digest, cpu_millis, ran })
}

/// The command that does one seed again.
pub fn replay(seed: u64) -> String {
    format!("cargo xtask bench safety --seed {seed} --runs 1 --trace")
}

fn tell(judged: &Judged) {
    let seed = judged.scenario.seed;
    for violation in &judged.violations {
        println!("seed {seed}: {violation}\n  again: {}", replay(seed));
    }
}

/// Everything of one run.
fn trace(judged: &Judged) {
    let Judged { scenario, ran, digest, .. } = judged;
    println!("seed {}: {}, digest {digest:016x}", scenario.seed, scenario.motion_name);
    println!("the target: {:?}, {:?}", scenario.carrier, scenario.motion);
    for (fault, noticed) in scenario.faults.iter().zip(&ran.noticed) {
        let noticed = match noticed {
            None => "after the end",
            Some(true) => "noticed",
            Some(false) => "not noticed",
        };
        println!("{:7.3} to {:7.3} s  {:?}: {noticed}", fault.from_s, fault.until_s(), fault.kind);
    }
    for line in &ran.truth.log {
        println!("{:7.3} s  {}", line.t_millis as f64 * 1e-3, line.text);
    }
    let rules = Rules::of_the_rig();
    for (arm, rules) in rules.arms.iter().enumerate() {
        let used = |joint: usize| {
            let shares =
                ran.truth.steps.iter().map(|step| step.arms[arm].position_rad[joint] / rules.operating_rad[joint]);
            let (least, most) =
                shares.fold((0.0f64, 0.0f64), |(least, most), share| (least.min(share), most.max(share)));
            format!("{least:.2} to {most:.2}")
        };
        let used: Vec<_> = (0..7).map(used).collect();
        println!("{}: shares of the operating ranges that were used: {}", ARM_NAMES[arm], used.join(", "));
    }
    let [mut one, mut other] = [Vec::new(), Vec::new()];
    let rooms = ran.truth.steps.iter().map(|step| {
        rules.arms[0].body.place(&step.arms[0].position_rad, &mut one);
        rules.arms[1].body.place(&step.arms[1].position_rad, &mut other);
        room_m(&one, &other)
    });
    println!("least room between both arms: {:.0} mm", 1e3 * rooms.fold(f64::INFINITY, f64::min));
    println!("ended: {}", ran.ended.as_deref().unwrap_or("at its time"));
}

/// How far a long measurement is: a line each minute.
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
    fn tell(&self, figures: &Figures, of: u64) {
        let minutes = self.since.elapsed().as_secs() / 60;
        if self.minutes.swap(minutes, Ordering::Relaxed) < minutes {
            let violations: usize = figures.violations.values().map(Vec::len).sum();
            let (runs, rate) = (figures.runs, figures.times_real_time());
            println!("{minutes} min: {runs} of {of} runs, {violations} violations, {rate:.0} times real time per core");
        }
    }
}

fn all(args: &Args) -> Result<Figures> {
    let (setup, rules) = (base()?, Rules::of_the_rig());
    let next = AtomicU64::new(0);
    let figures = Mutex::new(Ok(Figures::default()));
    let told = Progress::default();
    let work = || {
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= args.runs {
                return;
            }
            let judged = judge(&setup, &rules, Scenario::of(args.seed + index));
            let Ok(mut figures) = figures.lock() else { return };
            match (judged, figures.as_mut()) {
                (Ok(judged), Ok(figures)) => {
                    tell(&judged);
                    if args.trace {
                        trace(&judged);
                    }
                    figures.add(&judged, &rules);
                    told.tell(figures, args.runs);
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
    figures.into_inner().map_err(|_| anyhow::anyhow!("a run has panicked; its message is above"))?
}

fn main() -> Result<ExitCode> {
    let args = Args::read(std::env::args().skip(1))?;
    if args.disabled {
        return disabled(&args);
    }
    let figures = all(&args)?;
    let text = page::text(&figures, args.seed, &args.origin);
    println!("{text}");
    if let Some(folder) = &args.page {
        page::write_part(folder, Some(&text), None)?;
    }
    println!("{} virtual seconds per run, digest of all: {:016x}", RUN_S, figures.digest);
    Ok(if figures.violations.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Switches each safeguard off.
#[cfg(feature = "disabled-guards")]
fn disabled(args: &Args) -> Result<ExitCode> {
    proofs::run(args)
}

/// # Errors
/// Always.
#[cfg(not(feature = "disabled-guards"))]
fn disabled(_: &Args) -> Result<ExitCode> {
    bail!("--disabled: in this build no safeguard can be switched off; use `cargo xtask bench safety --disabled`")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Some runs, twice: nothing is violated, and every number is the same again.
    #[test]
    fn seeded_runs_keep_the_invariants_and_repeat_themselves() {
        let args = Args::read(["--runs", "12"].map(str::to_owned).into_iter()).unwrap();
        let (one, other) = (all(&args).unwrap(), all(&args).unwrap());
        assert!(one.violations.is_empty(), "{:?}", one.violations);
        assert_eq!(one.runs, 12);
        assert_eq!(one.digest, other.digest, "the same seeds gave other runs");
    }
}
