//! Speed of the published method on this machine: kernels, a full frame, and the ratio to a naive implementation
//! measured in the same run.
//!
//! `cargo run --release -p pb3dp-benchmarks --example published_speed -- [--json] [--check] [--rounds N]`
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program that reports to its user")]
#![allow(clippy::expect_used, reason = "the inputs of the benchmark are valid")]

mod machine;
mod measure;
mod report;

use std::process::ExitCode;

const HELP: &str = "\
Measures the published method: ns per sample, a full frame in ms, ratio to the naive version.

  --json       one JSON object on stdout instead of the table
  --check      exit with 1 if a goal is missed
  --rounds N   measurements per figure, 5 to 100000 (default 300); medians are reported
  --help       this text";

struct Options {
    json: bool,
    check: bool,
    rounds: usize,
}

fn parse(mut arguments: impl Iterator<Item = String>) -> Result<Option<Options>, String> {
    let mut options = Options { json: false, check: false, rounds: 300 };
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--json" => options.json = true,
            "--check" => options.check = true,
            "--rounds" => {
                let value = arguments.next().unwrap_or_default();
                options.rounds = value
                    .parse()
                    .ok()
                    .filter(|rounds| (5..=100_000).contains(rounds))
                    .ok_or_else(|| format!("--rounds is '{value}', not a number from 5 to 100000"))?;
            }
            "--help" | "-h" => return Ok(None),
            other => return Err(format!("unknown option '{other}': see --help")),
        }
    }
    Ok(Some(options))
}

fn main() -> ExitCode {
    let options = match parse(std::env::args().skip(1)) {
        Ok(Some(options)) => options,
        Ok(None) => {
            println!("{HELP}");
            return ExitCode::SUCCESS;
        }
        Err(message) => {
            eprintln!("{message}");
            return ExitCode::from(2);
        }
    };
    let results: Vec<_> = measure::PAIRS.into_iter().map(|pair| measure::run(pair, options.rounds)).collect();
    let machine = machine::Machine::read();
    if options.json {
        println!("{}", report::json(&machine, options.rounds, &results));
    } else {
        print!("{}", report::table(&machine, options.rounds, &results));
    }
    let missed = report::missed_goals(&results);
    for goal in &missed {
        eprintln!("missed: {goal}");
    }
    if options.check && !missed.is_empty() { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}
