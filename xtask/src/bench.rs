//! `cargo xtask bench`: measures the speed of the program and the accuracy of the estimators.

use std::process::Stdio;

use anyhow::{Context, bail};
use clap::ValueEnum;
use serde_json::{Value, json};

use crate::files::write;
use crate::safeguard_switches;
use crate::workspace::{PROGRAM, Workspace, output_of, run_visibly};

const OUT: &str = "out/bench";
const BENCHMARKS: &str = "pb3dp-benchmarks";
const PAGES: &str = "docs/benchmarks";

/// Rounds of the example `published_speed` in a quick run.
const QUICK_ROUNDS: &str = "40";

/// Runs benchmarks with optimisation, and saves the figures with the commit and the machine.
///
/// speed        the published method and the direct one: kernels, cold start, tracking, scaling
/// raster       stereo pairs per second and core of the simulator's rasteriser; printed only
/// real         every method on real stereo cases, compared with other tools
/// accuracy     every method on rendered scenes with exact truth, compared with the Cramér-Rao bound
/// figures      the figures of docs/method.md
/// servo        tracking error of the hand in simulation, compared with an ideal filter or the arm's limits
/// safety       seeded runs with random faults, checked against the simulator's truth; --disabled: without each safeguard
/// calibration  accuracy of chessboard corners and of the calibrations from them
/// panel        cost of the operator panel: processor time, and lateness of control steps
/// recordings   what a recording costs a live run, and how long its replay takes
/// all          speed and raster
///
/// docs/benchmarks/README.md lists the pages that full runs write, and the times that they take; `-- --help` after
/// speed, real, accuracy and figures lists all options. The figures are also saved in `out/bench/*.json`, with commit, processor
/// and compiler. Measure on an idle machine.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// The benchmark.
    #[arg(value_enum, default_value = "all")]
    what: What,
    /// Print and save JSON instead of the table, for programs with this option.
    #[arg(long)]
    json: bool,
    /// Further options for the program; not for raster and all.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "OPTIONS")]
    options: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum What {
    Speed,
    Raster,
    Real,
    Accuracy,
    Figures,
    Servo,
    Safety,
    Calibration,
    Panel,
    Recordings,
    All,
}

/// # Errors
/// If a program does not build or fails, or its figures cannot be written.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    if let (What::Raster | What::All, Some(option)) = (args.what, args.options.first()) {
        bail!("`{option}`: no such option here; raster and all take no further options");
    }
    let raster = || run_visibly(&mut workspace.example(BENCHMARKS, "raster_speed"));
    match args.what {
        What::Speed => speed(workspace, args),
        What::Raster => raster(),
        What::All => speed(workspace, args).and_then(|()| raster()),
        What::Real => run_program(workspace, "real", args),
        What::Accuracy => run_program(workspace, "accuracy", args),
        What::Figures => run_program(workspace, "figures", args),
        What::Servo | What::Safety | What::Calibration | What::Panel | What::Recordings => example(workspace, args),
    }
}

/// Runs an example; a full run writes its page, and a sample or a partial run does not. The program checks its options.
fn example(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let options = &args.options;
    let named = |wanted: &[&str]| options.iter().any(|option| wanted.contains(&option.as_str()));
    let is_full = !named(&["--quick", "--seed", "--page"]);
    let (package, example, page, writes_page) = match args.what {
        What::Servo => (BENCHMARKS, "servo", "", options.is_empty()),
        What::Safety => (BENCHMARKS, "safety", "", options.is_empty() || options == &["--disabled"]),
        What::Calibration => ("pb3dp-calibration", "corner_accuracy", "/calibration.md", is_full),
        What::Panel => ("pb3dp-panel", "panel_cost", "/panel.md", is_full),
        _ => (BENCHMARKS, "recordings", "/recordings.md", is_full),
    };
    let mut command = match named(&["--disabled"]) {
        true => safeguard_switches::example(workspace, package, example)?,
        false => workspace.example(package, example),
    };
    command.args(["--origin", &origin(workspace)]);
    if args.what == What::Servo {
        command.args(["--json", &format!("{OUT}/servo.json")]);
    }
    if args.what == What::Recordings {
        command.arg("--program").arg(workspace.build(true, &PROGRAM)?.join("pb3dp"));
    }
    if writes_page {
        command.arg("--page").arg(workspace.root().join(format!("{PAGES}{page}")));
    }
    run_visibly(command.args(options))
}

/// Disables each safeguard: each must be needed, and sufficient alone.
///
/// # Errors
/// If one is not.
pub fn safeguards(workspace: &Workspace) -> anyhow::Result<()> {
    let mut command = safeguard_switches::example(workspace, BENCHMARKS, "safety")?;
    run_visibly(command.args(["--origin", &origin(workspace), "--disabled"]))
}

/// Runs a subcommand of `pb3dp-bench` in the user's current folder, so that relative paths are correct.
fn run_program(workspace: &Workspace, subcommand: &str, args: &Args) -> anyhow::Result<()> {
    let mut command = workspace.cargo();
    command.current_dir(std::env::current_dir().context("cannot find the current folder")?);
    command.args(["run", "--release", "--locked", "--quiet", "--package", BENCHMARKS, "--manifest-path"]);
    command.arg(workspace.root().join("Cargo.toml")).args(["--bin", "pb3dp-bench", "--", subcommand, "--root"]);
    command.arg(workspace.root()).args(args.json.then_some("--json")).args(&args.options);
    let status = command.status().context("cannot start cargo")?;
    if !status.success() {
        bail!("bench {subcommand} failed ({status})");
    }
    Ok(())
}

/// Measures the published method, whose figures `pb3dp-bench speed` reads as JSON, and then the direct one.
fn speed(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let named = |wanted: &[&str]| args.options.iter().any(|option| wanted.contains(&option.as_str()));
    if !named(&["--help", "-h"]) {
        let mut command = workspace.example(BENCHMARKS, "published_speed");
        command.arg("--json").args(named(&["--quick"]).then_some(["--rounds", QUICK_ROUNDS]).into_iter().flatten());
        println!("== the published method (cargo run --release -p {BENCHMARKS} --example published_speed)");
        let printed = output_of(command.stderr(Stdio::inherit()))?;
        let results: Vec<Value> = printed.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
        let kept = json!({ "where": origin(workspace), "results": results });
        write(&workspace.root().join(OUT).join("speed_published.json"), &format!("{kept:#}\n"))?;
    }
    run_program(workspace, "speed", args)
}

/// Commit, processor and compiler as a line for a page.
pub fn origin(workspace: &Workspace) -> String {
    let output_text = |program: &str, args: &[&str]| workspace.output_of(program, args);
    let known = |found: Option<String>, what: &str| found.unwrap_or_else(|| format!("unknown{what}"));
    let commit: String = known(output_text("git", &["rev-parse", "HEAD"]), "").chars().take(12).collect();
    let is_changed = output_text("git", &["status", "--porcelain"]).is_some_and(|changes| !changes.is_empty());
    let processor = std::fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| processor_name(&text));
    format!(
        "Commit {commit}{}; {}; {}.",
        if is_changed { "  with uncommitted changes" } else { "" },
        known(processor, " processor"),
        known(output_text("rustc", &["--version"]), " compiler"),
    )
}

fn processor_name(cpuinfo: &str) -> Option<String> {
    let line = cpuinfo.lines().find(|line| line.starts_with("model name"))?;
    line.split_once(':').map(|(_, name)| name.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_processor_is_read_from_linux() {
        let text = "processor\t: 0\nmodel name\t: Some CPU 3000\nmodel name\t: Other\n";
        assert_eq!(processor_name(text).as_deref(), Some("Some CPU 3000"));
        assert_eq!(processor_name("nothing"), None);
    }

    #[derive(clap::Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    #[test]
    fn options_go_to_the_program_and_are_refused_where_there_is_none() {
        let parse = |words: &[&str]| {
            <Cli as clap::Parser>::try_parse_from(std::iter::once("bench").chain(words.iter().copied()))
                .expect("valid")
                .args
        };
        let real = parse(&["real", "--cases", "a b", "--json", "--peers=c"]);
        assert_eq!(
            (real.what, real.options.as_slice()),
            (What::Real, ["--cases", "a b", "--json", "--peers=c"].map(str::to_owned).as_slice())
        );
        let speed = parse(&["speed", "--json"]);
        assert!(speed.json && speed.options.is_empty());
        let workspace = Workspace::find().expect("under cargo");
        let error = run(&workspace, &parse(&["raster", "--cases", "x"])).expect_err("nobody takes it");
        assert!(error.to_string().contains("--cases"), "{error}");
        let servo = parse(&["servo", "--quick", "--only", "laws/"]);
        assert_eq!(
            (servo.what, servo.options.as_slice()),
            (What::Servo, ["--quick", "--only", "laws/"].map(str::to_owned).as_slice())
        );
    }
}
