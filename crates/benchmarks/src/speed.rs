//! Speed of the direct method: cold start, tracking, kernels, and the influence of sizes and counts.
//!
//! [`cold`] measures single pairs, with [`stages`] for the parts; [`tracking`] measures sequences, and [`scaling`] the influence of sizes
//! and counts. [`clips`] renders the images, and [`page`] has goals, tables and figure.

mod clips;
mod cold;
mod page;
mod scaling;
mod stages;
mod times;
mod tracking;

use std::path::{Path, PathBuf};

use anyhow::bail;
use pb3dp_benchmarks::circumstances::{Circumstances, check_root};
use pb3dp_benchmarks::limit::Check;
use pb3dp_benchmarks::page::{save, text, update};
use serde_json::{Value, json};

const KEPT: &str = "out/bench/speed.json";
const PAGE: &str = "docs/benchmarks/speed.md";
const FIGURE: &str = "docs/benchmarks/speed.svg";
/// Results of the published method's program, if it ran before.
const PUBLISHED: &str = "out/bench/speed_published.json";

/// Options.
#[derive(clap::Args)]
pub struct Args {
    /// Also measure real cases: a folder with cases (docs/dataset-format.md).
    #[arg(long, value_name = "DIR")]
    cases: Option<PathBuf>,
    /// Fewer calls and every tenth case, for a check in half a minute; does not change docs/benchmarks.
    #[arg(long)]
    quick: bool,
    /// Calls per figure; for each real case, a twentieth of this number.
    #[arg(long, value_name = "NUMBER", default_value_t = 300, value_parser = clap::value_parser!(u32).range(20..=100_000))]
    rounds: u32,
    /// Exit with an error if a goal is missed.
    #[arg(long)]
    check: bool,
    /// One JSON object instead of the tables.
    #[arg(long)]
    json: bool,
    /// Does not change docs/benchmarks.
    #[arg(long)]
    no_docs: bool,
    /// Root folder of the workspace.
    #[arg(long, default_value = ".", value_name = "DIR")]
    root: PathBuf,
}

/// Rounds of a quick run.
const QUICK_ROUNDS: usize = 40;
/// A quick run uses one case of this many.
const QUICK_EVERY: usize = 10;

/// Runs the measurements, prints the results and saves them.
///
/// # Errors
/// A folder or file that cannot be used, by name; with `--check`, a missed goal.
pub fn run(args: &Args) -> anyhow::Result<()> {
    check_root(&args.root)?;
    let circumstances = Circumstances::of(&args.root);
    let kept = measure(args, &circumstances)?;
    let parts = page::parts(&kept, &command_line(args), &circumstances.line());
    if args.json {
        println!("{kept}");
    } else {
        print!("{}", text(&parts));
    }
    save(&args.root.join(KEPT), &format!("{kept:#}\n"))?;
    if !args.quick && !args.no_docs {
        update(&args.root.join(PAGE), &parts)?;
        save(&args.root.join(FIGURE), &page::figure(&kept))?;
    }
    let missed: Vec<Check> = page::goals(&kept).into_iter().filter(|goal| !goal.is_kept()).collect();
    for Check { what, found, most, unit } in &missed {
        eprintln!("missed: {what} is {:.2} {unit}, the goal is {most:.2} {unit}", found.unwrap_or(f64::NAN));
    }
    if args.check && !missed.is_empty() {
        bail!("{} goals are missed", missed.len());
    }
    Ok(())
}

fn measure(args: &Args, circumstances: &Circumstances) -> anyhow::Result<Value> {
    let rounds = if args.quick { QUICK_ROUNDS } else { args.rounds as usize };
    let every = if args.quick { QUICK_EVERY } else { 1 };
    let real = args.cases.as_deref().map(|folder| {
        eprintln!("real cases");
        cold::real(folder, (rounds / 20).max(3), every)
    });
    let real = real.transpose()?;
    eprintln!("cold start by size");
    let sizes = cold::sizes(rounds)?;
    eprintln!("cold start on raw images");
    let raw = cold::raw(rounds)?;
    eprintln!("tracking");
    let tracking = tracking::tracking(4 * rounds)?;
    eprintln!("kernels");
    let mut kernels = cold::kernels(rounds)?;
    kernels.push(tracking::kernels(rounds)?);
    eprintln!("scaling");
    let scaling = scaling::scaling(rounds)?;
    let mut kept = json!({
        "bench": "speed",
        "where": circumstances.to_json(),
        "cold_start_by_size": sizes,
        "cold_start_on_raw_images": raw,
        "cold_start_on_cases": real,
        "tracking": tracking,
        "kernels": kernels,
        "scaling": scaling,
        "published": published(&args.root),
    });
    kept["goals"] = page::goals(&kept).iter().map(Check::to_json).collect();
    Ok(kept)
}

/// The JSON object from the published method's program, if it ran.
fn published(root: &Path) -> Option<Value> {
    let text = std::fs::read_to_string(root.join(PUBLISHED)).ok()?;
    let kept: Value = serde_json::from_str(&text).ok()?;
    kept["results"].get(0).filter(|found| found["pairs"].is_array()).cloned()
}

/// The command that writes the page again, without the folders of this machine.
fn command_line(args: &Args) -> String {
    let mut words = vec!["cargo xtask bench speed".to_owned()];
    if args.cases.is_some() {
        words.push("--cases DIR".into());
    }
    if args.quick {
        words.push("--quick".into());
    }
    if args.rounds != 300 {
        words.push(format!("--rounds {}", args.rounds));
    }
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    fn args(words: &[&str]) -> Args {
        Cli::try_parse_from(std::iter::once("speed").chain(words.iter().copied())).expect("valid").args
    }

    #[test]
    fn the_command_on_the_page_names_no_folder_of_this_machine() {
        assert_eq!(command_line(&args(&["--cases", "/some/where"])), "cargo xtask bench speed --cases DIR");
        assert_eq!(command_line(&args(&["--rounds", "50", "--json"])), "cargo xtask bench speed --rounds 50");
    }

    #[test]
    fn wrong_paths_and_numbers_are_refused() {
        let error = run(&args(&["--root", "no/such/clone"])).expect_err("refused").to_string();
        assert!(error.contains("no/such/clone") && error.contains("Cargo.toml"), "{error}");
        assert!(Cli::try_parse_from(["speed", "--rounds", "3"]).is_err());
    }
}
