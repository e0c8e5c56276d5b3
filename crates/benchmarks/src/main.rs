//! Measures what the estimators reach: against exact truth on rendered scenes, and against other tools on real pairs.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program that reports to its user")]

mod accuracy;
mod common;
mod real;
mod speed;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Measurements of the estimators.
#[derive(Parser)]
struct Cli {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Rendered scenes with exact truth, beside the Cramér-Rao bound.
    Accuracy(accuracy::Args),
    /// Writes the pairs of one cell of `accuracy` as case folders, or one of its sequences as a sequence folder.
    Dump(accuracy::dump::Args),
    /// The figures of docs/method.md.
    Figures(accuracy::figures::Args),
    /// Real stereo cases, beside other tools.
    Real(real::Args),
    /// How long the direct method takes.
    Speed(speed::Args),
}

fn main() -> ExitCode {
    let outcome = match Cli::parse().what {
        What::Accuracy(args) => accuracy::run(&args),
        What::Dump(args) => accuracy::dump::run(&args),
        What::Figures(args) => accuracy::figures::run(&args),
        What::Real(args) => real::run(&args),
        What::Speed(args) => speed::run(&args),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
