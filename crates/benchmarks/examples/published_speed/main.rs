//! Speed of the published method on this machine: kernels, a full frame, and the ratio to a naive implementation
//! measured in the same run.
//!
//! `cargo run --release -p pb3dp-benchmarks --example published_speed -- [--json] [--check] [--rounds N]`
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a program that reports to its user")]
#![allow(clippy::expect_used, reason = "the inputs of the benchmark are valid")]

mod measure;

use std::path::Path;
use std::process::ExitCode;

use pb3dp_benchmarks::circumstances::Circumstances;
use pb3dp_benchmarks::page;
use pb3dp_benchmarks::table::{Column, cell, markdown, number};
use pb3dp_estimation_core::cpu::KernelSet;
use serde_json::{Value, json};

/// Measures the published method: ns per sample, a full frame in ms, ratio to the naive version.
#[derive(clap::Parser)]
struct Options {
    // `cargo xtask bench` looks for "--json" in this file.
    /// One JSON object instead of the table.
    #[arg(long)]
    json: bool,
    /// Exit with 1 if a goal is missed.
    #[arg(long)]
    check: bool,
    /// Measurements per figure; medians are reported.
    #[arg(long, value_name = "NUMBER", default_value_t = 300, value_parser = clap::value_parser!(u32).range(5..=100_000))]
    rounds: u32,
}

fn main() -> ExitCode {
    let options: Options = clap::Parser::parse();
    let rounds = options.rounds as usize;
    let results: Vec<_> = measure::PAIRS.into_iter().map(|pair| measure::run(pair, rounds)).collect();
    let missed = missed_goals(&results);
    let circumstances = Circumstances::of(Path::new("."));
    if options.json {
        let origin = circumstances.to_json();
        println!(
            "{}",
            json!({
                "bench": "speed", "where": origin, "seed": measure::SEED, "rounds": rounds,
                "goals_met": missed.is_empty(), "pairs": results,
            })
        );
    } else {
        print!("{}", text(&circumstances, rounds, &results));
    }
    for goal in &missed {
        eprintln!("missed: {goal}");
    }
    if options.check && !missed.is_empty() { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

/// Goal: maximum milliseconds of a full frame with AVX2 or better.
const FRAME_GOAL_MS: f64 = 0.6;
/// Goal: minimum ratio of the naive version's time per sample, preparation included, to that of AVX2 or better: for each pair.
const RATIO_GOALS: [(&str, f64); 2] = [("rectified", 25.0), ("general", 12.0)];

/// The goals that the vector kernels miss, as messages.
fn missed_goals(results: &[Value]) -> Vec<String> {
    let mut missed = Vec::new();
    for (pair, (name, ratio_goal)) in results.iter().zip(RATIO_GOALS) {
        let kernels = pair["kernels"].as_array().into_iter().flatten();
        for row in kernels.filter(|row| row["kernels"] != KernelSet::Scalar.name()) {
            let name = format!("{name} pair, {}", cell("{kernels}", row));
            let figure = |path: &str| number(row, path).unwrap_or(f64::NAN);
            let (frame_ms, ratio) = (figure("frame_ms"), figure("ratio_to_naive"));
            if frame_ms > FRAME_GOAL_MS {
                missed.push(format!("{name}: a frame takes {frame_ms:.3} ms, the goal is {FRAME_GOAL_MS} ms"));
            }
            if ratio <= ratio_goal {
                missed.push(format!("{name}: {ratio:.1} times faster than naive, the goal is more than {ratio_goal}"));
            }
        }
    }
    missed
}

const COLUMNS: [Column<'_>; 12] = [
    ("kernels", "{kernels}"),
    ("ns/sample", "{ns_per_sample:4}"),
    ("min", "{ns_per_sample_min:4}"),
    ("with prep.", "{ns_per_sample_with_preparation:4}"),
    ("ratio", "{ratio_to_naive:1}"),
    ("frame ms", "{frame_ms:3}"),
    ("hues", "{conversions_ms:3}"),
    ("model", "{model_ms:3}"),
    ("prep.", "{preparation_ms:3}"),
    ("search", "{search_ms:3}"),
    ("frame min", "{frame_min_ms:3}"),
    ("|dF| max", "{fitness_difference_max:4}"),
];

fn text(circumstances: &Circumstances, rounds: usize, results: &[Value]) -> String {
    let run = format!(
        "{} Seed {}, medians of {rounds} rounds, one thread.\n\
         A frame is two 640x480 conversions, the model, the preparation, and 60 individuals x 9 generations.",
        circumstances.line(),
        measure::SEED
    );
    let points = "{inner_points} inner + {outer_points} outer points, naive {naive_ns_per_sample:2} ns per sample (min {naive_ns_per_sample_min:2})";
    let pair = |(result, (name, _)): (&Value, (&'static str, f64))| {
        let kernels = result["kernels"].as_array().cloned().unwrap_or_default();
        (name, format!("{}\n\n{}", cell(points, result), markdown(&COLUMNS, &kernels)))
    };
    let pairs = results.iter().zip(RATIO_GOALS).map(pair);
    page::text(&std::iter::once(("run", run)).chain(pairs).collect::<Vec<_>>())
}
