//! Measures the accuracy and speed of the estimators: on rendered scenes with exact truth, and on real pairs with other tools.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program that reports to its user")]

mod accuracy;
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
    /// Accuracy on rendered scenes with exact truth, compared with the Cramér-Rao bound.
    Accuracy(accuracy::Args),
    /// Writes the stereo pairs of one configuration of `accuracy` as case folders, or one of its sequences as a sequence folder.
    Dump(accuracy::dump::Args),
    /// Draws the figures of docs/method.md.
    Figures(accuracy::figures::Args),
    /// Accuracy on real stereo cases, compared with other tools.
    Real(real::Args),
    /// Speed of the direct method.
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
