//! The hand follows a target there and back for minutes or hours of virtual time: whether memory stays as it was, and whether the hand
//! comes back to where it was.
//!
//! ```text
//! cargo run --release -p pb3dp-benchmarks --example there_and_back -- --minutes 60
//! ```
//!
//! With the setup of `configs/sim.toml`, the colourful card and all pixels; `--geometric` leaves images out. Nothing of the run is
//! written down but one line for each cycle, as what a run writes down grows with its length.
#![allow(clippy::print_stdout, reason = "prints its figures")]

mod cycles;

use anyhow::{Context, Result, bail};
use cycles::repeat;
use pb3dp_setup::setup::{Leader, Setup, read_setup};
use pb3dp_sim::targets::TargetConfig;
use system_tests::repository;

/// A week.
const MINUTES_MAX: f64 = 10_080.0;

fn main() -> Result<()> {
    let (mut minutes, mut geometric, mut seed) = (60.0, false, 1);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        let mut value = || arguments.next().with_context(|| format!("{argument} needs a value"));
        match argument.as_str() {
            "--minutes" => minutes = value()?.parse().context("--minutes: give a number")?,
            "--seed" => seed = value()?.parse().context("--seed: give a whole number")?,
            "--geometric" => geometric = true,
            _ => bail!("{argument} is unknown: there are --minutes N, --seed N and --geometric"),
        }
    }
    if !(0.0..=MINUTES_MAX).contains(&minutes) {
        bail!("--minutes is {minutes}: give at most {MINUTES_MAX}");
    }
    let figures = repeat(&setup(geometric, seed)?, minutes, |line| println!("{line}"))?;
    println!("{}", figures.text());
    figures.judge()
}

/// The repository's setup, with the card.
fn setup(geometric: bool, seed: u64) -> Result<Setup> {
    let mut setup = read_setup(&repository().join("configs/sim.toml"))?;
    setup.reseed(seed);
    setup.world_mut().context("the setup has no simulated world")?.scene.target = TargetConfig::card();
    setup.compared.clear();
    if geometric {
        setup.leader =
            Leader::Geometric(setup.geometric.context("configs/sim.toml has no table [estimator.geometric]")?);
    }
    Ok(setup)
}

#[cfg(test)]
mod tests {
    use pb3dp_test_support::sweep;

    use super::*;
    use crate::cycles::Figures;

    /// As few as can be judged; five with `cargo xtask test --all`.
    #[test]
    fn minutes_there_and_back_leave_memory_and_hand_as_they_were() {
        let (minutes, cycles) = sweep((2.4, 24), (5.0, 50));
        let figures = repeat(&setup(true, 1).unwrap(), minutes, |_| ()).unwrap();
        println!("{}", figures.text());
        assert_eq!(figures.cycles(), cycles);
        figures.judge().unwrap();
    }

    #[test]
    fn drift_and_leaks_are_judged() {
        let quiet = |drift_mm: f64, held: usize| {
            let mut figures = Figures::default();
            for k in 0..40 {
                let noise_mm = if k % 2 == 0 { 0.02 } else { -0.02 };
                figures.push([noise_mm + drift_mm * f64::from(k) / 40.0, 0.0, 0.0], 1_000_000 + k as usize * held);
            }
            figures.judge()
        };
        quiet(0.0, 0).unwrap();
        quiet(0.08, 0).unwrap();
        assert!(quiet(0.3, 0).unwrap_err().to_string().contains("mm"));
        assert!(quiet(0.0, 10_000).unwrap_err().to_string().contains("bytes"));
    }
}
