//! Each safeguard, switched off, must let something go wrong: otherwise it is there for nothing, or the invariants see too little.
//!
//! Where several guard the same thing, each is shown by itself: with all the others off it is enough, and without it too it is not.

mod table;

use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Result, ensure};
use pb3dp_safeguards::{Safeguard, without};
use pb3dp_setup::setup::{Carrier, Setup};
use pb3dp_sim::trajectory::MotionConfig;
use system_tests::safety::invariants::Violation;
use system_tests::safety::rules::Rules;

use crate::faults::{Fault, Kind};
use crate::rig::base;
use crate::scenario::{Dice, Scenario};
use crate::{Args, Judged, judge, page, trace};

/// Seeds that are tried until something goes wrong without the safeguard.
const SEEDS: u64 = 6;
/// When the first fault comes, seconds: the hand follows by then.
const FIRST_S: f64 = 3.0;
/// How long a run lasts, seconds.
const RUN_S: f64 = 7.0;

/// That a safeguard is there for something.
struct Proof {
    guard: Safeguard,
    /// What guards the same and is off, too, in both runs.
    others: &'static [Safeguard],
    /// Whether a person leads.
    has_person: bool,
    /// How the target moves.
    motion: fn(&mut Dice) -> (MotionConfig, Carrier),
    /// What goes wrong: how long after [`FIRST_S`] it begins and for how long it lasts, seconds.
    faults: fn(&mut Dice) -> Vec<(f64, f64, Kind)>,
}

/// What became of one.
pub struct Shown {
    /// Of which safeguard.
    pub guard: Safeguard,
    /// What was off besides.
    pub others: &'static [Safeguard],
    /// Seed and violations of the first run without it in which anything did not hold.
    pub without: Option<(u64, Vec<Violation>)>,
    /// Seed and violations of a run with it in which something did not hold.
    pub with: Option<(u64, Vec<Violation>)>,
    /// Runs in all.
    pub runs: u64,
}

impl Shown {
    /// Whether it is enough by itself, and needed.
    pub fn is_proof(&self) -> bool {
        self.without.is_some() && self.with.is_none()
    }
}

impl Proof {
    fn scenario(&self, seed: u64) -> Scenario {
        let mut dice = Dice::new(seed);
        let (motion, carrier) = (self.motion)(&mut dice);
        let faults: Vec<_> = (self.faults)(&mut dice)
            .into_iter()
            .map(|(after_s, for_s, kind)| Fault { kind, from_s: FIRST_S + after_s, for_s })
            .collect();
        let has_person = self.has_person;
        Scenario { seed, motion_name: "proof", motion, carrier, faults, run_s: RUN_S, has_person, searches: false }
    }

    fn show(&self, setup: &Setup, rules: &Rules, args: &Args) -> Result<Shown> {
        let mut shown = Shown { guard: self.guard, others: self.others, without: None, with: None, runs: 0 };
        for seed in args.seed..args.seed + SEEDS {
            let judged = |off: &[Safeguard]| without(off, || judge(setup, rules, self.scenario(seed)));
            let found = |judged: Judged| (!judged.violations.is_empty()).then_some((seed, judged.violations));
            let off: Vec<_> = self.others.iter().chain([&self.guard]).copied().collect();
            let (with, without) = (judged(self.others)?, judged(&off)?);
            if args.trace {
                println!("== with {}", self.guard.name());
                trace(&with);
                println!("== without {}", self.guard.name());
                trace(&without);
                with.violations.iter().for_each(|violation| println!("with {}: {violation}", self.guard.name()));
            }
            shown.runs += 2;
            shown.with = shown.with.or(found(with));
            shown.without = found(without);
            if shown.without.is_some() {
                break;
            }
        }
        Ok(shown)
    }
}

/// All of them, or those whose name holds what was asked for.
///
/// # Errors
/// A run that cannot be wired, or no safeguard of that name.
pub fn run(args: &Args) -> Result<ExitCode> {
    let (setup, rules) = (base(false)?, Rules::of_the_rig());
    let proofs: Vec<_> = table::PROOFS.iter().filter(|proof| proof.guard.name().contains(&args.only)).collect();
    ensure!(!proofs.is_empty(), "--only {}: no safeguard has such a name", args.only);
    let next = AtomicUsize::new(0);
    let shown = Mutex::new(Vec::new());
    let work = || {
        while let Some((index, proof)) =
            Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|i| Some((i, proofs.get(i)?)))
        {
            let became = proof.show(&setup, &rules, args);
            if let Ok(mut shown) = shown.lock() {
                shown.push((index, became));
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(work);
        }
    });
    let mut shown = shown.into_inner().map_err(|_| anyhow::anyhow!("a run has panicked; its message is above"))?;
    ensure!(shown.len() == proofs.len(), "a run has panicked; its message is above");
    shown.sort_by_key(|(index, _)| *index);
    let shown: Vec<Shown> = shown.into_iter().map(|(_, became)| became).collect::<Result<_>>()?;
    let text = page::safeguards(&shown, &table::ELSEWHERE, &args.origin);
    println!("{text}");
    if let Some(folder) = &args.page {
        page::write_part(folder, None, Some(&text))?;
    }
    Ok(if shown.iter().all(Shown::is_proof) { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_safeguard_is_left_out() {
        for guard in Safeguard::ALL {
            let proofs = table::PROOFS.iter().filter(|proof| proof.guard == *guard).count();
            let elsewhere = table::ELSEWHERE.iter().filter(|(other, _)| other == guard).count();
            assert_eq!(proofs + elsewhere, 1, "{}", guard.name());
        }
    }

    #[test]
    fn each_safeguard_is_enough_and_needed() {
        assert_eq!(run(&Args::read(std::iter::empty()).unwrap()).unwrap(), ExitCode::SUCCESS);
    }
}
