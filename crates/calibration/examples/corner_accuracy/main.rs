//! Accuracy of chessboard corners and of the calibrations from them: on rendered boards with exact truth, compared with the
//! Cramér-Rao bound, and on real boards by the error of held-out views. Run it by `cargo xtask bench calibration`.
#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "prints its figures; helpers of the tests may fail loudly"
)]

mod bound;
mod page;
mod real;
mod rendered;

#[path = "../../tests/support/rendered.rs"]
mod renderer;
#[allow(dead_code, reason = "shared with the tests")]
#[path = "../../tests/support/mod.rs"]
mod support;

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use page::Findings;

/// Rigs of a full run, and of a quick one.
const RIGS: [u32; 2] = [20, 3];
/// Seed of the first rig.
const SEED: u32 = 9000;

fn main() -> Result<()> {
    let options = Options::parse(std::env::args().skip(1))?;
    let mut sets = real::Set::of_repository()?;
    for text in &options.boards {
        sets.push(real::Set::parse(text)?);
    }
    let mut real = Vec::new();
    for set in &sets {
        real.extend(real::measure(set)?);
    }
    let rigs = if options.quick { RIGS[1] } else { RIGS[0] };
    let rendered = rendered::measure(options.seed, rigs, options.threads);
    let findings = Findings { rendered, real, seed: options.seed, rigs };
    let checks = findings.checks();
    print!("{}", findings.text(&checks));
    if let Some(file) = &options.page {
        std::fs::write(file, findings.page(&checks, &options.origin))
            .with_context(|| format!("cannot write {}", file.display()))?;
    }
    let missed = checks.iter().filter(|check| !check.is_kept()).count();
    if missed > 0 {
        bail!("{missed} of {} limits are missed; see the last table", checks.len());
    }
    Ok(())
}

struct Options {
    quick: bool,
    seed: u32,
    threads: usize,
    boards: Vec<String>,
    page: Option<PathBuf>,
    origin: String,
}

impl Options {
    fn parse(mut words: impl Iterator<Item = String>) -> Result<Self> {
        let mut options =
            Self { quick: false, seed: SEED, threads: 2, boards: Vec::new(), page: None, origin: String::new() };
        while let Some(word) = words.next() {
            if word == "--quick" {
                options.quick = true;
                continue;
            }
            let value = words.next().with_context(|| format!("{word}: no value given"))?;
            match word.as_str() {
                "--seed" => options.seed = value.parse().with_context(|| format!("--seed {value}"))?,
                "--threads" => options.threads = value.parse().with_context(|| format!("--threads {value}"))?,
                "--boards" => options.boards.push(value),
                "--page" => options.page = Some(value.into()),
                "--origin" => options.origin = value,
                other => {
                    bail!(
                        "unknown option {other}; options: --quick, --seed N, --threads N, --boards name,folder,prefix,COLUMNSxROWS,square_mm, --page FILE, --origin TEXT"
                    )
                }
            }
        }
        Ok(options)
    }
}
