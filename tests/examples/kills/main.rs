//! Live runs in which `pb3dp run` or a `pb3dp gateway` is killed by SIGKILL while both arms move.
//!
//! The program and both gateways are processes, connected by TCP with a key; the controllers with the true joints are emulated in this
//! process, on sockets instead of ARCNET. Run it by `cargo xtask soak --kills 50`.
#![allow(clippy::print_stdout, reason = "prints its figures")]

mod cell;
mod files;
mod host;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use cell::{Cell, Motion};
use host::Host;
use pb3dp_estimation_core::rng::SplitMix64;

/// The names of the arms in a run.
const ARMS: [&str; 2] = ["vs-robot", "tc-robot"];
/// Time for which both arms are observed after a kill.
const WATCHED: Duration = Duration::from_millis(1500);
/// Time for which a program that was started anew may not move an arm.
const ANEW: Duration = Duration::from_secs(2);
/// From the kill to standstill at most: the controller's time-out of 0.2 s (`cell.rs`) or the gateway's of 0.05 s, the time in which
/// the host notices a closed connection, 0.1 s, and braking.
const REST_MAX: Duration = Duration::from_millis(500);
/// Largest angle of a joint after the kill: 0.5 rad/s for the 0.2 s of the time-out, and braking from there with 2 rad/s^2.
const MOVED_MAX_RAD: f64 = 0.17;
/// A machine that is busy may stop the arms before the kill; so many attempts per run are allowed.
const ATTEMPTS: usize = 5;

/// What is killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Killed {
    Host,
    Gateway(usize),
}

impl Killed {
    fn name(self) -> String {
        match self {
            Self::Host => "host".to_owned(),
            Self::Gateway(arm) => format!("gateway of {}", ARMS[arm]),
        }
    }
}

/// Result of one run.
struct Outcome {
    killed: Killed,
    rest: Duration,
    moved_rad: f64,
}

struct Options {
    runs: usize,
    seed: u64,
    program: PathBuf,
}

impl Options {
    fn parse(mut args: impl Iterator<Item = String>) -> Result<Self> {
        let (mut runs, mut seed, mut program) = (50, 1, None);
        while let Some(arg) = args.next() {
            let value = args.next().with_context(|| format!("{arg}: no value given"))?;
            match arg.as_str() {
                "--runs" => runs = value.parse().context("--runs: give a whole number")?,
                "--seed" => seed = value.parse().context("--seed: give a whole number")?,
                "--program" => program = Some(value.into()),
                _ => bail!("unknown option {arg}; options: --program PATH, --runs N, --seed N"),
            }
        }
        ensure!(runs > 0, "--runs 0: give at least 1");
        Ok(Self { runs, seed, program: program.context("--program: give the path of pb3dp")? })
    }
}

fn main() -> Result<()> {
    let options = Options::parse(std::env::args().skip(1))?;
    let mut random = SplitMix64::new(options.seed);
    let (mut outcomes, mut disturbed) = (Vec::new(), 0);
    for run in 0..options.runs {
        // Each kind in turn: half of the runs kill the host, a quarter each gateway.
        let killed = [Killed::Host, Killed::Gateway(0), Killed::Host, Killed::Gateway(1)][run % 4];
        let after = Duration::from_millis(u64::from(random.below(4000)));
        let outcome = attempt(&options, killed, after, &mut disturbed).with_context(|| format!("run {run}"))?;
        println!(
            "run {run}: {} killed, stationary after {:.0} ms, moved by {:.2} degrees",
            killed.name(),
            1e3 * outcome.rest.as_secs_f64(),
            outcome.moved_rad.to_degrees()
        );
        outcomes.push(outcome);
    }
    tell(&outcomes, disturbed);
    Ok(())
}

/// One run; it is repeated if the machine stops the arms before the kill.
fn attempt(options: &Options, killed: Killed, after: Duration, disturbed: &mut usize) -> Result<Outcome> {
    for _ in 0..ATTEMPTS {
        if let Some(outcome) = one(options, killed, after)? {
            return Ok(outcome);
        }
        *disturbed += 1;
    }
    bail!("the arms stopped before the kill in each of {ATTEMPTS} attempts; is the machine busy?")
}

/// `None`: the arms stopped before the kill.
fn one(options: &Options, killed: Killed, after: Duration) -> Result<Option<Outcome>> {
    let mut cell = Cell::start(&options.program)?;
    let mut host = Host::start(&options.program, &cell.files)?;
    if !host.lead_to_tracking()? || !cell.waits_until_it_moves(after) {
        return Ok(None);
    }
    if let Killed::Gateway(arm) = killed {
        cell.gateways[arm].kill();
    } else {
        host.kill();
    }
    let at = Instant::now();
    let before = cell.joints_rad();
    let Motion { last, .. } = cell.watch(WATCHED);
    let rest = last.map_or(Duration::ZERO, |last| last.saturating_duration_since(at));
    let after = cell.joints_rad();
    let moved_rad = (0..2).map(|arm| (after[arm] - before[arm]).amax()).fold(0.0, f64::max);
    ensure!(rest <= REST_MAX, "{} killed: an arm moved for {rest:?}, allowed {REST_MAX:?}", killed.name());
    ensure!(moved_rad <= MOVED_MAX_RAD, "{} killed: a joint moved by {moved_rad} rad", killed.name());
    ensure!(cell.are_braked(), "{} killed: a brake is open {WATCHED:?} later", killed.name());
    match killed {
        Killed::Host => refuses_anew(&options.program, &mut cell)?,
        Killed::Gateway(arm) => moves_nothing_anew(&mut cell, &mut host, arm)?,
    }
    Ok(Some(Outcome { killed, rest, moved_rad }))
}

/// A new program does not take over arms that the death of the first one has latched.
fn refuses_anew(program: &std::path::Path, cell: &mut Cell) -> Result<()> {
    let mut anew = Host::start(program, &cell.files)?;
    let output_text = anew.end_by_itself()?;
    ensure!(
        output_text.contains("was latched before this run"),
        "a new program used the arms of a dead one:\n{output_text}"
    );
    ensure!(output_text.contains("host-silent"), "the reason of the latch is missing:\n{output_text}");
    let moved = cell.watch(Duration::from_millis(100));
    ensure!(moved.last.is_none() && cell.are_braked(), "a new program moved an arm");
    Ok(())
}

/// A new gateway knows nothing; neither it nor the waiting program may move the arm, whatever the operator says but `reset`.
fn moves_nothing_anew(cell: &mut Cell, host: &mut Host, arm: usize) -> Result<()> {
    cell.restart_gateway(arm)?;
    for arg in ["start", "resume"] {
        host.say(arg)?;
        let moved = cell.watch(ANEW / 2);
        ensure!(moved.last.is_none() && cell.are_braked(), "an arm moved after {arg:?} behind a new gateway");
    }
    Ok(())
}

fn tell(outcomes: &[Outcome], disturbed: usize) {
    println!("\n{} live runs, {disturbed} more in which the machine stopped the arms before the kill", outcomes.len());
    println!(
        "\n| killed | runs | stationary after, ms, median (max) | moved, degrees, median (max) |\n|---|---:|---:|---:|"
    );
    for killed in [Killed::Host, Killed::Gateway(0), Killed::Gateway(1)] {
        let of: Vec<_> = outcomes.iter().filter(|outcome| outcome.killed == killed).collect();
        if of.is_empty() {
            continue;
        }
        let [rest, moved] = [
            of.iter().map(|outcome| 1e3 * outcome.rest.as_secs_f64()).collect::<Vec<_>>(),
            of.iter().map(|outcome| outcome.moved_rad.to_degrees()).collect(),
        ]
        .map(|mut values| {
            values.sort_by(f64::total_cmp);
            (values[values.len() / 2], values[values.len() - 1])
        });
        println!(
            "| {} | {} | {:.0} ({:.0}) | {:.2} ({:.2}) |",
            killed.name(),
            of.len(),
            rest.0,
            rest.1,
            moved.0,
            moved.1
        );
    }
}
