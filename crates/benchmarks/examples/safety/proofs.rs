//! Each safeguard, disabled, must lead to a violation: otherwise it is useless, or the invariants are too weak.
//!
//! If several safeguards cover one hazard, each is tested with all others disabled: alone it is sufficient, and
//! without it an invariant is violated.

pub mod safeguards;
mod table;

use std::process::ExitCode;

use anyhow::{Result, ensure};
use pb3dp_benchmarks::page::{text, update};
use pb3dp_benchmarks::parallel::in_parallel;
use pb3dp_setup::setup::Carrier;
use pb3dp_sim::trajectory::MotionConfig;
use system_tests::safety::invariants::{Invariant, Violation};

use crate::faults::{Fault, Kind};
use crate::scenario::{Dice, Draw, PROOF, Scenario};
use crate::workcell::{Setups, Workcell};
use crate::{Args, Judged, judge, page, trace};
use safeguards::{HAS_SWITCHES, Safeguard, without};

/// Number of seeds that are tried until [`SHOWN_BY`] runs without the safeguard violate an invariant.
const SEEDS: u64 = 8;
/// Number of seeds that must show a safeguard: one alone may be chance.
const SHOWN_BY: usize = 2;
/// Time of the first fault, seconds; the hand tracks the target by then.
const FIRST_S: f64 = 3.0;
/// Duration of a run, seconds.
const RUN_S: f64 = 7.0;

/// The proof that a safeguard is needed.
struct Proof {
    guard: Safeguard,
    /// Safeguards against the same hazard that are disabled in both runs.
    others: &'static [Safeguard],
    /// Whether an operator is present.
    has_person: bool,
    /// Motion of the target.
    motion: fn(&mut Dice) -> (MotionConfig, Carrier),
    /// Faults: start after [`FIRST_S`] and duration, seconds.
    faults: fn(&mut Dice) -> Vec<(f64, f64, Kind)>,
}

/// Result of one proof.
pub struct Shown {
    /// The safeguard.
    pub guard: Safeguard,
    /// The other safeguards that were disabled.
    pub others: &'static [Safeguard],
    /// Seeds and violations of the runs without the safeguard that violated an invariant.
    pub without: Vec<(u64, Vec<Violation>)>,
    /// Seed and violations of a run with the safeguard that violated an invariant.
    pub with: Option<(u64, Vec<Violation>)>,
    /// Total number of runs.
    pub runs: u64,
    /// Hashes of the runs without the safeguard, to compare a proof that failed with one that did not.
    pub digests: Vec<u64>,
}

impl Shown {
    /// Whether the safeguard is sufficient alone, and needed.
    pub fn is_proof(&self) -> bool {
        self.without.len() >= SHOWN_BY && self.with.is_none()
    }
}

impl Proof {
    fn scenario(&self, seed: u64) -> Scenario {
        let mut dice = Dice::new(seed);
        let (motion, carrier) = (self.motion)(&mut dice);
        let faults: Vec<_> = (self.faults)(&mut dice)
            .into_iter()
            .map(|(after_s, for_s, kind)| Fault::new(kind, FIRST_S + after_s, for_s))
            .collect();
        let has_person = self.has_person;
        let workcell = Workcell::default();
        Scenario {
            seed,
            draw: Draw::First,
            motion_name: PROOF,
            motion,
            carrier,
            faults,
            run_s: RUN_S,
            has_person,
            searches: false,
            workcell,
            restart: None,
        }
    }

    fn show(&self, setups: &Setups, args: &Args) -> Result<Shown> {
        let mut shown = Shown {
            guard: self.guard,
            others: self.others,
            without: Vec::new(),
            with: None,
            runs: 0,
            digests: Vec::new(),
        };
        for seed in args.seed..args.seed + SEEDS {
            let judged = |off: &[Safeguard]| without(off, || judge(setups, self.scenario(seed), false))?;
            let found = |judged: Judged| (!judged.violations.is_empty()).then_some((seed, judged.violations));
            let off: Vec<_> = self.others.iter().chain([&self.guard]).copied().collect();
            let (mut with, without) = (judged(self.others)?, judged(&off)?);
            // The wait before the hand resumes is the supervisor's; without it the controller alone stops and resumes.
            if self.others.contains(&Safeguard::EstimateStale) {
                with.violations.retain(|violation| violation.invariant != Invariant::RestWhileInhibited);
            }
            if args.options.trace {
                println!("== with {}", self.guard.name());
                trace(&with);
                println!("== without {}", self.guard.name());
                trace(&without);
                with.violations.iter().for_each(|violation| println!("with {}: {violation}", self.guard.name()));
            }
            shown.runs += 2;
            shown.digests.push(without.digest);
            shown.with = shown.with.or(found(with));
            shown.without.extend(found(without));
            if shown.without.len() >= SHOWN_BY {
                break;
            }
        }
        Ok(shown)
    }
}

/// All proofs, or those whose name contains the given text.
///
/// # Errors
/// If this build has no switches, a run cannot be built, or no safeguard has that name.
pub fn run(args: &Args) -> Result<ExitCode> {
    ensure!(
        HAS_SWITCHES,
        "--disabled: this build cannot disable safeguards; use `cargo xtask bench safety --disabled`"
    );
    let setups = Setups::default();
    let proofs: Vec<_> = table::PROOFS.iter().filter(|proof| proof.guard.name().contains(&args.options.only)).collect();
    ensure!(!proofs.is_empty(), "--only {}: no safeguard has this text in its name", args.options.only);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let shown = in_parallel(proofs.len(), threads, || Ok(()), |(), index| proofs[index].show(&setups, args))?;
    let parts = page::safeguards(&shown, &table::ELSEWHERE, &args.options.origin);
    println!("{}", text(&parts));
    if let Some(folder) = &args.options.page {
        update(&folder.join("safety.md"), &parts)?;
    }
    Ok(if shown.iter().all(Shown::is_proof) { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(test)]
mod tests {
    use super::*;
    use pb3dp_servo::supervisor::Condition;

    /// The switches that [`HAS_SWITCHES`] means.
    const SWITCHES: &str = include_str!("../../../../tests/safeguards.toml");

    #[test]
    fn no_safeguard_is_left_out() {
        for guard in Safeguard::ALL {
            let proofs = table::PROOFS.iter().filter(|proof| proof.guard == *guard).count();
            let elsewhere = table::ELSEWHERE.iter().filter(|(other, _)| other == guard).count();
            assert_eq!(proofs + elsewhere, 1, "{}", guard.name());
        }
    }

    #[test]
    fn each_safeguard_has_a_switch() {
        for name in Safeguard::ALL.iter().map(|guard| guard.name()) {
            let is_condition =
                Condition::ALL.iter().any(|condition| name == format!("supervisor: {}", condition.key()));
            assert!(is_condition || SWITCHES.contains(&format!("is_off(\"{name}\")")), "{name}");
        }
    }

    #[test]
    fn a_run_without_safeguards_knows_which() {
        let name = || std::thread::current().name().map(str::to_owned);
        let names = without(&[Safeguard::LimiterSpeed, Safeguard::GuardRange], name).unwrap();
        assert_eq!(names.as_deref(), Some("limiter: speed; guard: range"));
    }
}
