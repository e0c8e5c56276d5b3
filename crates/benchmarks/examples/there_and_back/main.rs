//! The hand follows a target out and back for minutes or hours of virtual time: checks that memory does not grow, and
//! that the hand returns to its position.
//!
//! ```text
//! cargo run --release -p pb3dp-benchmarks --example there_and_back -- --minutes 60
//! ```
//!
//! With the setup of `configs/sim.toml`, the colourful card and all pixels; `--geometric` omits images. The run logs one
//! line per cycle and nothing else, because a full log grows with the run.
#![allow(clippy::print_stdout, reason = "prints its figures")]

mod cycles;

use anyhow::{Context, Result, bail};
use cycles::repeat;
use pb3dp_setup::setup::{Leader, Setup, read_setup};
use pb3dp_sim::targets::TargetConfig;
use system_tests::repository;

/// A week.
const MINUTES_MAX: f64 = 10_080.0;

/// The hand follows a target out and back: memory must not grow, and the hand must return.
#[derive(clap::Parser)]
struct Options {
    /// Minutes of virtual time.
    #[arg(long, default_value_t = 60.0, value_name = "NUMBER")]
    minutes: f64,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1, value_name = "NUMBER")]
    seed: u64,
    /// Without images.
    #[arg(long)]
    geometric: bool,
}

fn main() -> Result<()> {
    let Options { minutes, seed, geometric } = clap::Parser::parse();
    if !(0.0..=MINUTES_MAX).contains(&minutes) {
        bail!("--minutes is {minutes}, more than {MINUTES_MAX}: give less");
    }
    let figures = repeat(&setup(geometric, seed)?, minutes, |line| println!("{line}"))?;
    println!("{}", figures.text());
    figures.judge()
}

/// The setup of the repository, with the card.
fn setup(geometric: bool, seed: u64) -> Result<Setup> {
    let mut setup = read_setup(&repository().join("configs/sim.toml"))?;
    setup.reseed(seed);
    setup.world.as_mut().context("the setup has no simulated world")?.scene.target = TargetConfig::card();
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

    /// The minimum number of cycles; five with `cargo xtask test --all`.
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
