//! `cargo xtask bench`: measurements of speed.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use clap::ValueEnum;
use serde_json::{Value, json};

use crate::workspace::Workspace;

const OUT: &str = "out/bench";

/// Measures speed, with optimisation, and keeps the figures beside the commit and the machine.
///
/// speed   one frame of the published method: hue images, model, search; and the ratio to the naive scalar version
/// raster  pairs of pictures per second and core from the simulator's rasteriser
///
/// The programs are crates/estimation/examples/speed.rs and crates/sim/examples/raster_speed.rs; each prints its own table.
/// The figures are also written to out/bench/<name>.json, with commit, processor and compiler. Measure on an idle machine.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// What to measure.
    #[arg(value_enum, default_value = "all")]
    what: What,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum What {
    Speed,
    Raster,
    All,
}

struct Bench {
    what: What,
    name: &'static str,
    package: &'static str,
    example: &'static str,
    source: &'static str,
}

const BENCHES: [Bench; 2] = [
    Bench {
        what: What::Speed,
        name: "speed",
        package: "pb3dp-estimation",
        example: "speed",
        source: "crates/estimation/examples/speed.rs",
    },
    Bench {
        what: What::Raster,
        name: "raster",
        package: "pb3dp-sim",
        example: "raster_speed",
        source: "crates/sim/examples/raster_speed.rs",
    },
];

/// # Errors
/// If a program does not build or fails, or its figures can not be written.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    for bench in BENCHES.iter().filter(|bench| args.what == What::All || args.what == bench.what) {
        measure(workspace, bench).with_context(|| format!("bench {}", bench.name))?;
    }
    Ok(())
}

fn measure(workspace: &Workspace, bench: &Bench) -> anyhow::Result<()> {
    let source = std::fs::read_to_string(workspace.root().join(bench.source))
        .with_context(|| format!("cannot read {}", bench.source))?;
    let mut command = workspace.cargo();
    command.args(["run", "--release", "--locked", "--quiet", "--package", bench.package, "--example", bench.example]);
    if source.contains("\"--json\"") {
        command.args(["--", "--json"]);
    }
    println!("== {} (cargo run --release -p {} --example {})", bench.name, bench.package, bench.example);
    let results = run_and_collect(&mut command)?;
    if results.is_empty() {
        return Ok(());
    }
    let folder = workspace.root().join(OUT);
    std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {OUT}"))?;
    let path = format!("{OUT}/{}.json", bench.name);
    let text = format!("{:#}\n", json!({ "bench": bench.name, "where": circumstances(workspace), "results": results }));
    std::fs::write(workspace.root().join(&path), text).with_context(|| format!("cannot write {path}"))?;
    println!("kept in {path}");
    Ok(())
}

/// Runs the program, shows what it prints, and returns the lines that are JSON objects.
fn run_and_collect(command: &mut Command) -> anyhow::Result<Vec<Value>> {
    let mut child = command.stdout(Stdio::piped()).spawn().context("cannot start cargo")?;
    let stdout = child.stdout.take().context("the program has no output")?;
    let mut results = Vec::new();
    for line in BufReader::new(stdout).lines() {
        let line = line.context("cannot read the program's output")?;
        println!("{line}");
        results.extend(serde_json::from_str::<Value>(&line).ok().filter(Value::is_object));
    }
    let status = child.wait().context("cannot wait for the program")?;
    if !status.success() {
        bail!("the program failed ({status})");
    }
    Ok(results)
}

/// Commit, processor and compiler; "unknown" where the machine does not tell.
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

    #[test]
    fn json_lines_are_kept_and_failures_are_told() {
        let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        cargo.args(["metadata", "--no-deps", "--format-version", "1"]);
        let results = run_and_collect(&mut cargo).expect("cargo metadata prints one line of JSON");
        assert!(results.len() == 1 && results[0]["packages"].is_array());
        let mut broken = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        assert!(run_and_collect(broken.arg("no-such-command-of-ours").stderr(Stdio::null())).is_err());
    }
}
