//! The figures as a table and as JSON.

use std::fmt::Write as _;

use pb3dp_estimation_core::cpu::KernelSet;

use crate::machine::Machine;
use crate::measure::{KernelResult, PairKind, PairResult, SEED};

/// Goal: maximum milliseconds of a full frame with AVX2 or better.
const FRAME_GOAL_MS: f64 = 0.6;

/// Goal: minimum ratio of the naive version's time per sample to that of AVX2 or better.
fn ratio_goal(kind: PairKind) -> f64 {
    match kind {
        PairKind::Rectified => 25.0,
        PairKind::General => 12.0,
    }
}

fn ratio(pair: &PairResult, kernel: &KernelResult) -> f64 {
    pair.naive_ns_per_sample / kernel.ns_per_sample_with_preparation
}

/// The goals that the vector kernels miss, as messages.
pub fn missed_goals(results: &[PairResult]) -> Vec<String> {
    let mut missed = Vec::new();
    for pair in results {
        for kernel in pair.kernels.iter().filter(|kernel| kernel.set != KernelSet::Scalar) {
            let name = format!("{} pair, {}", pair.kind.name(), kernel.set.name());
            if kernel.frame.total_ms > FRAME_GOAL_MS {
                missed.push(format!(
                    "{name}: a frame takes {:.3} ms, the goal is {FRAME_GOAL_MS} ms",
                    kernel.frame.total_ms
                ));
            }
            let (ratio, goal) = (ratio(pair, kernel), ratio_goal(pair.kind));
            if ratio <= goal {
                missed.push(format!("{name}: {ratio:.1} times faster than naive, the goal is more than {goal}"));
            }
        }
    }
    missed
}

/// Formats the table.
pub fn table(machine: &Machine, rounds: usize, results: &[PairResult]) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_table(&mut text, machine, rounds, results);
    text
}

fn write_table(text: &mut String, machine: &Machine, rounds: usize, results: &[PairResult]) -> std::fmt::Result {
    writeln!(text, "processor  {} ({})", machine.processor, machine.features.join(", "))?;
    writeln!(text, "commit     {}   seed {SEED}   medians of {rounds} rounds, one thread", machine.commit)?;
    writeln!(text, "frame      two 640x480 conversions, model, preparation, 60 individuals x 9 generations\n")?;
    for pair in results {
        let (inner, outer) = pair.points;
        writeln!(
            text,
            "{} pair, {inner} inner + {outer} outer points, naive {:.2} ns per sample (min {:.2})",
            pair.kind.name(),
            pair.naive_ns_per_sample,
            pair.naive_ns_per_sample_min
        )?;
        writeln!(
            text,
            "{:<8} {:>9} {:>8} {:>10} {:>7} | {:>8} {:>7} {:>7} {:>7} {:>8} {:>8} | {:>8}",
            "kernels",
            "ns/sample",
            "min",
            "with prep.",
            "ratio",
            "frame ms",
            "hues",
            "model",
            "prep.",
            "search",
            "min",
            "|dF| max"
        )?;
        for kernel in &pair.kernels {
            let frame = &kernel.frame;
            writeln!(
                text,
                "{:<8} {:>9.4} {:>8.4} {:>10.4} {:>7.1} | {:>8.3} {:>7.3} {:>7.3} {:>7.3} {:>8.3} {:>8.3} | {:>8.4}",
                kernel.set.name(),
                kernel.ns_per_sample,
                kernel.ns_per_sample_min,
                kernel.ns_per_sample_with_preparation,
                ratio(pair, kernel),
                frame.total_ms,
                frame.conversions_ms,
                frame.model_ms,
                frame.preparation_ms,
                frame.search_ms,
                kernel.frame_min_ms,
                kernel.fitness_difference_max
            )?;
        }
        writeln!(text)?;
    }
    writeln!(
        text,
        "goals for AVX2 and better: frame <= {FRAME_GOAL_MS} ms; ratio (preparation included) > {} rectified, > {} general: {}",
        ratio_goal(PairKind::Rectified),
        ratio_goal(PairKind::General),
        if missed_goals(results).is_empty() { "met" } else { "missed" }
    )
}

/// Formats the JSON.
pub fn json(machine: &Machine, rounds: usize, results: &[PairResult]) -> String {
    let features: Vec<String> = machine.features.iter().map(|feature| quoted(feature)).collect();
    let pairs: Vec<String> = results.iter().map(pair_json).collect();
    format!(
        "{{\"bench\":\"speed\",\"processor\":{},\"features\":[{}],\"commit\":{},\"seed\":{SEED},\"rounds\":{rounds},\"goals_met\":{},\"pairs\":[{}]}}",
        quoted(&machine.processor),
        features.join(","),
        quoted(&machine.commit),
        missed_goals(results).is_empty(),
        pairs.join(",")
    )
}

fn pair_json(pair: &PairResult) -> String {
    let kernels: Vec<String> = pair.kernels.iter().map(|kernel| kernel_json(pair, kernel)).collect();
    format!(
        "{{\"pair\":{},\"inner_points\":{},\"outer_points\":{},\"naive_ns_per_sample\":{:.4},\"naive_ns_per_sample_min\":{:.4},\"kernels\":[{}]}}",
        quoted(pair.kind.name()),
        pair.points.0,
        pair.points.1,
        pair.naive_ns_per_sample,
        pair.naive_ns_per_sample_min,
        kernels.join(",")
    )
}

fn kernel_json(pair: &PairResult, kernel: &KernelResult) -> String {
    let frame = &kernel.frame;
    format!(
        "{{\"kernels\":{},\"ns_per_sample\":{:.5},\"ns_per_sample_min\":{:.5},\"ns_per_sample_with_preparation\":{:.5},\"ratio_to_naive\":{:.2},\"frame_ms\":{:.4},\"conversions_ms\":{:.4},\"model_ms\":{:.4},\"preparation_ms\":{:.4},\"search_ms\":{:.4},\"frame_min_ms\":{:.4},\"fitness_difference_max\":{:.6}}}",
        quoted(kernel.set.name()),
        kernel.ns_per_sample,
        kernel.ns_per_sample_min,
        kernel.ns_per_sample_with_preparation,
        ratio(pair, kernel),
        frame.total_ms,
        frame.conversions_ms,
        frame.model_ms,
        frame.preparation_ms,
        frame.search_ms,
        kernel.frame_min_ms,
        kernel.fitness_difference_max
    )
}

fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for character in text.chars() {
        match character {
            '"' => quoted.push_str("\\\""),
            '\\' => quoted.push_str("\\\\"),
            control if control.is_control() => quoted.push(' '),
            other => quoted.push(other),
        }
    }
    quoted.push('"');
    quoted
}
