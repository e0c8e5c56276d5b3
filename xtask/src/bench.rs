//! `cargo xtask bench`: measures the speed of the program and the accuracy of the estimators.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use clap::ValueEnum;
use serde_json::{Value, json};

use crate::safeguard_switches;
use crate::workspace::{Workspace, run_visibly};

const OUT: &str = "out/bench";
/// Benchmarks that are separate programs.
const EXAMPLES: &str = "crates/benchmarks/examples";
const PAGES: &str = "docs/benchmarks";

/// Rounds of the example `published_speed` in a quick run.
const QUICK_ROUNDS: &str = "40";

/// Runs benchmarks with optimisation, and saves the figures with the commit and the machine.
///
/// speed   the published method (kernels, a frame, ratio to the naive scalar version), then the direct method: cold start,
///         tracking, kernels, and scaling; --cases DIR adds real cases, --quick takes half a minute;
///         `cargo xtask bench speed -- --help` lists the options. Writes docs/benchmarks/speed.md
/// raster  stereo pairs per second and core of the simulator's rasteriser
/// real    every method on real stereo cases, compared with other tools if given: --cases DIR, --peers DIR;
///         `cargo xtask bench real -- --help` lists the options. Writes docs/benchmarks/real.md; with --leave-one-scene-out
///         docs/benchmarks/left_out.md, with --sequences DIR docs/benchmarks/sequences.md
/// accuracy  every method on rendered scenes with exact truth, compared with the Cramér-Rao bound (up to 20 minutes on two cores;
///           --quick: 3); `cargo xtask bench accuracy -- --help` lists the options. Writes docs/benchmarks/accuracy.md
/// figures  the figures of docs/method.md, on rendered scenes: takes some minutes. Writes docs/images/score.svg, noise.svg, track.svg
/// servo   tracking error of the hand in simulation: the experiment of Fig. 7, sinusoids, steps, compared with an ideal filter or
///         the arm's limits; fails if a limit is missed (ten minutes on two idle cores; --quick: seconds; --only WORDS,
///         --seed N). Writes docs/benchmarks/servo.md
/// safety  seeded runs with random faults, with both arms emulated in virtual time, checked against the simulator's truth;
///         fails if an invariant is violated, and prints the command to repeat that run: --runs N, --trace, --quick (200 runs, no page),
///         --seed N (without it a fresh seed is drawn and printed; a full run also repeats the seeds that once found something),
///         --rendered N (repeats the first N runs with rendered images); a run of default length writes docs/benchmarks/safety.md.
///         --disabled, in a copy with the switches of tests/safeguards.toml: disables each safeguard, which must cause a violation; --only NAME: some of them;
///         a run with all safeguards writes their part of that page
/// calibration  accuracy of chessboard corners and of the calibrations from them, on rendered boards with exact truth and on real
///         boards; fails if a limit is missed (some minutes; --quick: a minute; --boards adds real boards; --seed N).
///         Writes docs/benchmarks/calibration.md
/// panel   cost of the operator panel: processor time and lateness of control steps with 0, 1 and 5 pages; fails if a limit is
///         missed (6 minutes; --quick). Writes docs/benchmarks/panel.md
/// recordings  what a recording costs a live run (lateness, size, rate), how long its replay takes, ten minutes of two cameras in one
///         file; fails if a limit is missed (20 minutes on two idle cores; --quick; --folder DIR for the files, 4 GB).
///         Writes docs/benchmarks/recordings.md
/// all     speed and raster
///
/// All are in crates/benchmarks, except `corner_accuracy` of crates/calibration and `panel_cost` of crates/panel: the examples
/// `published_speed` and `raster_speed` measure the published method and the rasteriser, `servo` and `safety` the whole loop,
/// `pb3dp-bench` all others; each prints its own table. The figures are also
/// saved in `out/bench/*.json`, with commit, processor and compiler. Measure on an idle machine.
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

/// Subcommands of `pb3dp-bench` in crates/benchmarks, which take options and save their results themselves.
const PROGRAMS: [(What, &str); 4] =
    [(What::Speed, "speed"), (What::Real, "real"), (What::Accuracy, "accuracy"), (What::Figures, "figures")];

/// The benchmarks of `all`.
const OF_ALL: [What; 2] = [What::Speed, What::Raster];

struct Bench {
    what: What,
    name: &'static str,
    example: &'static str,
}

const BENCHES: [Bench; 2] = [
    Bench { what: What::Speed, name: "speed_published", example: "published_speed" },
    Bench { what: What::Raster, name: "raster", example: "raster_speed" },
];

/// # Errors
/// If a program does not build or fails, or its figures cannot be written.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    if args.what == What::Servo {
        return servo(workspace, &args.options);
    }
    if args.what == What::Safety {
        return safety(workspace, &args.options);
    }
    if args.what == What::Calibration {
        return example(workspace, ("pb3dp-calibration", "corner_accuracy", "calibration.md"), &args.options);
    }
    if args.what == What::Panel {
        return example(workspace, ("pb3dp-panel", "panel_cost", "panel.md"), &args.options);
    }
    if args.what == What::Recordings {
        return recordings(workspace, &args.options);
    }
    let wanted = |what: What| args.what == What::All && OF_ALL.contains(&what) || args.what == what;
    let takes_options = PROGRAMS.iter().any(|(what, _)| *what == args.what);
    if let Some(option) = args.options.first().filter(|_| !takes_options) {
        bail!("`{option}`: no such option here; only `speed`, `real`, `accuracy` and `figures` take further options");
    }
    let asks_for_help = args.options.iter().any(|option| option == "--help" || option == "-h");
    for bench in BENCHES.iter().filter(|bench| wanted(bench.what) && !asks_for_help) {
        measure(workspace, bench, args).with_context(|| format!("bench {}", bench.name))?;
    }
    for (_, subcommand) in PROGRAMS.iter().filter(|(what, _)| wanted(*what)) {
        run_program(workspace, subcommand, args)?;
    }
    Ok(())
}

/// Runs the example `servo`; a full run writes its page.
fn servo(workspace: &Workspace, options: &[String]) -> anyhow::Result<()> {
    let mut command = workspace.cargo();
    command.args(["run", "--release", "--locked", "--package", "pb3dp-benchmarks", "--example", "servo", "--"]);
    command.args(["--origin", &origin(workspace), "--json", &format!("{OUT}/servo.json")]);
    // A sample or a partial run does not change the page; the program checks its other options.
    if options.is_empty() {
        command.args(["--page", PAGES]);
    }
    command.args(options);
    run_visibly(&mut command)
}

/// Disables each safeguard: each must be needed, and sufficient alone.
///
/// # Errors
/// If one is not.
pub fn safeguards(workspace: &Workspace) -> anyhow::Result<()> {
    safety(workspace, &["--disabled".to_owned(), "--only".to_owned(), String::new()])
}

/// Runs the example `safety`; a full run writes its page.
fn safety(workspace: &Workspace, options: &[String]) -> anyhow::Result<()> {
    let mut command = match options.iter().any(|option| option == "--disabled") {
        true => safeguard_switches::run(workspace)?,
        false => {
            let mut command = workspace.cargo();
            command.args(["run", "--release"]);
            command
        }
    };
    command.args(["--locked", "--package", "pb3dp-benchmarks", "--example", "safety"]);
    command.args(["--", "--origin", &origin(workspace)]).args(options);
    if options.is_empty() || options == ["--disabled"] {
        command.arg("--page").arg(workspace.root().join(PAGES));
    }
    run_visibly(&mut command)
}

/// Runs an example of a package; a full run writes its page.
fn example(
    workspace: &Workspace,
    (package, example, page): (&str, &str, &str),
    options: &[String],
) -> anyhow::Result<()> {
    let mut command = workspace.cargo();
    command.args(["run", "--release", "--locked", "--package", package, "--example", example, "--"]);
    command.args(["--origin", &origin(workspace)]);
    // Other seeds and shorter runs do not change the page, unless the page is named.
    if !options.iter().any(|option| ["--quick", "--seed", "--page"].contains(&option.as_str())) {
        command.args(["--page", &format!("{PAGES}/{page}")]);
    }
    command.args(options);
    run_visibly(&mut command)
}

/// Runs the example `recordings` with the program that it measures.
fn recordings(workspace: &Workspace, options: &[String]) -> anyhow::Result<()> {
    let mut build = workspace.cargo();
    build.args(["build", "--release", "--locked", "--package", "pb3dp-orchestrator", "--bin", "pb3dp"]);
    run_visibly(&mut build)?;
    let program = workspace.target_folder()?.join("release/pb3dp");
    let program = ["--program".to_owned(), program.display().to_string()];
    example(workspace, ("pb3dp-benchmarks", "recordings", "recordings.md"), &[&program, options].concat())
}

/// Runs a subcommand of `pb3dp-bench` in the user's current folder, so that relative paths are correct.
fn run_program(workspace: &Workspace, subcommand: &str, args: &Args) -> anyhow::Result<()> {
    let mut command = workspace.cargo();
    command.current_dir(std::env::current_dir().context("cannot find the current folder")?);
    command.args(["run", "--release", "--locked", "--quiet", "--package", "pb3dp-benchmarks", "--manifest-path"]);
    command.arg(workspace.root().join("Cargo.toml")).args(["--bin", "pb3dp-bench", "--", subcommand, "--root"]);
    command.arg(workspace.root()).args(args.json.then_some("--json")).args(&args.options);
    let status = command.status().context("cannot start cargo")?;
    if !status.success() {
        bail!("bench {subcommand} failed ({status})");
    }
    Ok(())
}

/// Runs an example and saves its figures; those of the published method go to the page of `pb3dp-bench speed`, which reads
/// them as JSON.
fn measure(workspace: &Workspace, bench: &Bench, args: &Args) -> anyhow::Result<()> {
    let mut command = workspace.cargo();
    command.args([
        "run",
        "--release",
        "--locked",
        "--quiet",
        "--package",
        "pb3dp-benchmarks",
        "--example",
        bench.example,
    ]);
    let as_json = args.json || bench.what == What::Speed;
    command.arg("--");
    if offers_json(&workspace.root().join(EXAMPLES), bench.example)? && as_json {
        command.arg("--json");
    }
    if bench.what == What::Speed && args.options.iter().any(|option| option == "--quick") {
        command.args(["--rounds", QUICK_ROUNDS]);
    }
    println!("== {} (cargo run --release -p pb3dp-benchmarks --example {})", bench.name, bench.example);
    let (results, table) = run_and_collect(&mut command)?;
    let folder = workspace.root().join(OUT);
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {OUT}"))?;
    let path = format!("{OUT}/{}.json", bench.name);
    let kept = json!({ "bench": bench.name, "where": circumstances(workspace), "results": results, "printed": table });
    std::fs::write(workspace.root().join(&path), format!("{kept:#}\n"))
        .with_context(|| format!("cannot write {path}"))?;
    println!("saved in {path}");
    Ok(())
}

/// Whether an example's source contains the option `--json`; an example is one file or a folder.
fn offers_json(folder: &Path, example: &str) -> anyhow::Result<bool> {
    let (file, directory) = (folder.join(format!("{example}.rs")), folder.join(example));
    let mut sources = vec![file];
    if let Ok(entries) = std::fs::read_dir(&directory) {
        sources.extend(entries.filter_map(|entry| Some(entry.ok()?.path())));
    }
    let texts: Vec<String> = sources.iter().filter_map(|path| std::fs::read_to_string(path).ok()).collect();
    if texts.is_empty() {
        bail!("no example `{example}` in {}", folder.display());
    }
    Ok(texts.iter().any(|text| text.contains("\"--json\"")))
}

/// Runs the program and prints its output; returns the JSON lines, and the other lines.
fn run_and_collect(command: &mut Command) -> anyhow::Result<(Vec<Value>, Vec<String>)> {
    let mut child = command.stdout(Stdio::piped()).spawn().context("cannot start cargo")?;
    let stdout = child.stdout.take().context("the program has no output")?;
    let (mut results, mut table) = (Vec::new(), Vec::new());
    for line in BufReader::new(stdout).lines() {
        let line = line.context("cannot read the program's output")?;
        println!("{line}");
        match serde_json::from_str::<Value>(&line) {
            Ok(result) if result.is_object() => results.push(result),
            _ => table.push(line),
        }
    }
    let status = child.wait().context("cannot wait for the program")?;
    if !status.success() {
        bail!("the program failed ({status})");
    }
    Ok((results, table))
}

/// Commit, processor and compiler; "unknown" if not available.
fn circumstances(workspace: &Workspace) -> Value {
    let told = |program: &str, args: &[&str]| workspace.output_of(program, args);
    let unknown = || "unknown".to_owned();
    let changed = told("git", &["status", "--porcelain"]).is_some_and(|changes| !changes.is_empty());
    let processor = std::fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| processor_name(&text));
    json!({
        "commit": told("git", &["rev-parse", "HEAD"]).unwrap_or_else(unknown),
        "uncommitted_changes": changed,
        "processor": processor.unwrap_or_else(unknown),
        "processors": std::thread::available_parallelism().map_or(0, std::num::NonZero::get),
        "compiler": told("rustc", &["--version"]).unwrap_or_else(unknown),
    })
}

/// Commit, processor and compiler as a line for a page.
pub fn origin(workspace: &Workspace) -> String {
    let found = circumstances(workspace);
    format!(
        "Commit {}{}; {}; {}.",
        found["commit"].as_str().unwrap_or("unknown").chars().take(12).collect::<String>(),
        if found["uncommitted_changes"] == true { "  with uncommitted changes" } else { "" },
        found["processor"].as_str().unwrap_or("unknown processor"),
        found["compiler"].as_str().unwrap_or("unknown compiler"),
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
        let here = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("a parent");
        assert!(here.join("crates/benchmarks/src/real.rs").is_file());
        let workspace = Workspace::find().expect("under cargo");
        let error = run(&workspace, &parse(&["raster", "--cases", "x"])).expect_err("nobody takes it");
        assert!(error.to_string().contains("--cases"), "{error}");
        let servo = parse(&["servo", "--quick", "--only", "laws/"]);
        assert_eq!(
            (servo.what, servo.options.as_slice()),
            (What::Servo, ["--quick", "--only", "laws/"].map(str::to_owned).as_slice())
        );
    }

    #[test]
    fn an_example_is_found_as_file_or_folder_and_missed_if_it_is_gone() {
        let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(EXAMPLES);
        assert!(offers_json(&examples, "raster_speed").is_ok());
        let error = offers_json(&examples, "no_such_example").expect_err("not there");
        assert!(error.to_string().contains("no_such_example"), "{error}");
        let own_sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
        assert!(offers_json(&own_sources, "bench").expect("this very file"));
    }

    #[test]
    fn json_lines_are_kept_and_failures_are_told() {
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.args(["metadata", "--no-deps", "--format-version", "1"]);
        let (results, table) = run_and_collect(&mut cargo).expect("cargo metadata prints one line of JSON");
        assert!(results.len() == 1 && results[0]["packages"].is_array() && table.is_empty());
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        let (results, table) = run_and_collect(cargo.arg("--version")).expect("cargo tells its version");
        assert!(results.is_empty() && table[0].starts_with("cargo "));
        let mut broken = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        assert!(run_and_collect(broken.arg("no-such-command-of-ours").stderr(Stdio::null())).is_err());
    }
}
