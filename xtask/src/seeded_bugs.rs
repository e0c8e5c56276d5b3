//! `cargo xtask seeded-bugs`: mistakes in the safety chain, and whether tests of the crates and the simulation find them.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

use crate::scratch::Scratch;
use crate::workspace::{Workspace, run_visibly};

const BUGS: &str = "tests/seeded_bugs.toml";
/// The environment variable that chooses a bug by its number, from 1.
const CHOICE: &str = "PB3DP_SEEDED_BUG";
/// Building takes less, seconds; a test without a mistake takes much less.
const TIME_OUT_S: &str = "3600";
/// Tests that take longer find a mistake by that, seconds.
const TESTS_MAX_S: &str = "90";
/// Where `text` of a bug asks whether it is chosen.
const PLACE: &str = "{bug}";

/// Puts the mistakes of tests/seeded_bugs.toml into the supervisor and the layers before the arms, and counts who finds each.
///
/// All mistakes are built into one program, and an environment variable chooses one. Each is tried with the tests of its crates
/// and with seeded runs of the simulation (`cargo xtask bench safety`), where a run counts that violates an invariant. Fails if
/// neither finds a mistake that is not explained. 50 mistakes with 500 runs each take about 40 minutes on two cores.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Runs of the simulation per mistake.
    #[arg(long, default_value_t = 500)]
    runs: u32,
    /// First seed of these runs.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Only the mistakes with these numbers, from 1.
    #[arg(long, value_delimiter = ',')]
    only: Vec<usize>,
}

/// One mistake.
struct Bug {
    what: String,
    file: String,
    old: String,
    new: New,
    why: Option<String>,
}

/// What takes the place of the old text.
enum New {
    /// Another expression.
    Expression(String),
    /// Another text, in which [`PLACE`] asks whether the mistake is chosen.
    Text(String),
}

impl Bug {
    fn read(entry: &toml::Value) -> anyhow::Result<Self> {
        let of = |key: &str| entry.get(key).and_then(toml::Value::as_str).map(str::to_owned);
        let needed = |key: &str| of(key).with_context(|| format!("{BUGS}: {key} is missing in {entry}"));
        let new = match (of("new"), of("text")) {
            (Some(new), None) => New::Expression(new),
            (None, Some(text)) if text.contains(PLACE) => New::Text(text),
            _ => bail!("{BUGS}: give either new, or text with {PLACE}, in {entry}"),
        };
        Ok(Self { what: needed("what")?, file: needed("file")?, old: needed("old")?, new, why: of("why") })
    }

    /// The source with this mistake as number `number`.
    fn put_into(&self, source: &str, number: usize) -> anyhow::Result<String> {
        let Self { what, file, old, new, .. } = self;
        // The old text stays, and comes first: the next mistake finds it there.
        let bug = format!("crate::seeded_bug({number})");
        let changed = match new {
            New::Expression(new) => format!("(if !{bug} {{ {old} }} else {{ {new} }})"),
            New::Text(text) => text.replace(PLACE, &bug),
        };
        if !source.contains(old.as_str()) {
            bail!("{BUGS}: {file} does not contain the old text of {what:?}: correct the entry");
        }
        Ok(source.replacen(old.as_str(), &changed, 1))
    }

    /// The folder of its crate.
    fn folder(&self) -> &str {
        self.file.split("/src/").next().unwrap_or(&self.file)
    }
}

fn read(workspace: &Workspace) -> anyhow::Result<Vec<Bug>> {
    let text = fs::read_to_string(workspace.root().join(BUGS)).with_context(|| format!("cannot read {BUGS}"))?;
    let table: toml::Table = text.parse().with_context(|| format!("{BUGS} is not TOML"))?;
    let entries = table.get("bug").and_then(toml::Value::as_array).cloned().unwrap_or_default();
    entries.iter().map(Bug::read).collect()
}

/// The files with all mistakes, by their paths, and the packages to which they belong.
fn with_all(bugs: &[Bug], tree: &Path) -> anyhow::Result<(BTreeMap<String, String>, BTreeSet<String>)> {
    let read = |file: &str| fs::read_to_string(tree.join(file)).with_context(|| format!("cannot read {file}"));
    let mut sources = BTreeMap::new();
    for (index, bug) in bugs.iter().enumerate() {
        let source = sources.remove(&bug.file).map_or_else(|| read(&bug.file), Ok)?;
        sources.insert(bug.file.clone(), bug.put_into(&source, index + 1)?);
    }
    let mut packages = BTreeSet::new();
    for folder in bugs.iter().map(Bug::folder).collect::<BTreeSet<_>>() {
        let lib = format!("{folder}/src/lib.rs");
        let source = read(&lib)? + &choice();
        sources.insert(lib, source);
        let manifest: toml::Table = read(&format!("{folder}/Cargo.toml"))?.parse()?;
        let name = manifest.get("package").and_then(|package| package.get("name")).and_then(toml::Value::as_str);
        packages.insert(name.with_context(|| format!("{folder}/Cargo.toml names no package"))?.to_owned());
    }
    Ok((sources, packages))
}

/// The function that says whether a mistake is chosen.
fn choice() -> String {
    format!(
        "\n/// Whether this mistake is chosen.\npub(crate) fn seeded_bug(number: usize) -> bool {{\n    \
         static CHOSEN: std::sync::LazyLock<usize> = std::sync::LazyLock::new(|| \
         std::env::var(\"{CHOICE}\").ok().and_then(|text| text.parse().ok()).unwrap_or(0));\n    *CHOSEN == number\n}}\n"
    )
}

/// Who finds a mistake.
struct Found {
    by_tests: bool,
    /// Number of runs that violate an invariant, and the invariants.
    runs: usize,
    invariants: BTreeSet<String>,
}

/// # Errors
/// If a mistake cannot be put in or built, or a mistake without an explanation is not found.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let bugs = read(workspace)?;
    if let Some(wrong) = args.only.iter().find(|number| !(1..=bugs.len()).contains(*number)) {
        bail!("--only {wrong}: give numbers from 1 to {}", bugs.len());
    }
    let scratch = Scratch::new(workspace, "seeded-bugs")?;
    let (sources, packages) = with_all(&bugs, &scratch.tree)?;
    for (file, source) in sources {
        fs::write(scratch.tree.join(&file), source).with_context(|| format!("cannot write {file}"))?;
    }
    // A mistake may let a test wait for ever; cargo and the test end together.
    let cargo = |within_s: &str, words: &[&str]| {
        let mut command = Command::new("timeout");
        command
            .args([within_s, "cargo"])
            .args(words)
            .arg("--release")
            .current_dir(&scratch.tree)
            .env("CARGO_TARGET_DIR", &scratch.target);
        command
    };
    let mut build = cargo(TIME_OUT_S, &["build", "--package", "pb3dp-benchmarks", "--example", "safety"]);
    run_visibly(&mut build)?;
    let mut tests = vec!["test", "--tests"];
    tests.extend(packages.iter().flat_map(|package| ["--package", package]));
    run_visibly(&mut cargo(TIME_OUT_S, &tests)).context("the tests fail without a mistake")?;
    let simulation = scratch.target.join("release/examples/safety");
    if simulate(&simulation, args, 0)?.0 > 0 {
        bail!("the simulation finds a violation without a mistake; choose another --seed, and report it");
    }
    println!(
        "| number | mistake | tests of its crate | runs of {} that violate an invariant | invariants |",
        args.runs
    );
    println!("|---:|---|---|---:|---|");
    let mut missed = Vec::new();
    for (index, bug) in bugs.iter().enumerate() {
        let number = index + 1;
        if !args.only.is_empty() && !args.only.contains(&number) {
            continue;
        }
        let tested = cargo(TESTS_MAX_S, &tests)
            .env(CHOICE, number.to_string())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()?;
        let (runs, invariants) = simulate(&simulation, args, number)?;
        let found = Found { by_tests: !tested.success(), runs, invariants };
        println!("{}", row(number, bug, &found));
        if !found.by_tests && found.runs == 0 && bug.why.is_none() {
            missed.push(bug.what.as_str());
        }
    }
    if !missed.is_empty() {
        bail!("not found, and not explained in {BUGS}:\n  {}", missed.join("\n  "));
    }
    Ok(())
}

fn row(number: usize, bug: &Bug, found: &Found) -> String {
    let Found { by_tests, runs, invariants } = found;
    let tests = if *by_tests { "find it" } else { "do not" };
    let invariants: Vec<_> = invariants.iter().map(String::as_str).collect();
    let why = bug.why.as_deref().filter(|_| *runs == 0).unwrap_or("");
    format!("| {number} | {} | {tests} | {runs} | {}{why} |", bug.what, invariants.join(", "))
}

/// Runs the simulation with a mistake, or none (0): the number of runs that violate an invariant, and the invariants.
fn simulate(simulation: &Path, args: &Args, number: usize) -> anyhow::Result<(usize, BTreeSet<String>)> {
    let mut command = Command::new(simulation);
    command.args(["--seed", &args.seed.to_string(), "--runs", &args.runs.to_string(), "--rendered", "0"]);
    let output = command.env(CHOICE, number.to_string()).output().context("cannot run the simulation")?;
    let text = String::from_utf8_lossy(&output.stdout);
    // A run that cannot be completed counts, too.
    if !text.contains("hash of all") {
        return Ok((1, BTreeSet::from(["the run failed".to_owned()])));
    }
    Ok(violations(&text))
}

/// The runs and invariants of the lines `seed 7: position, vs-robot, ...`.
fn violations(text: &str) -> (usize, BTreeSet<String>) {
    let (mut seeds, mut invariants) = (BTreeSet::new(), BTreeSet::new());
    for line in text.lines() {
        let Some((seed, rest)) = line.strip_prefix("seed ").and_then(|line| line.split_once(": ")) else { continue };
        seeds.insert(seed);
        invariants.extend(rest.split([',', ':']).next().map(str::to_owned));
    }
    (seeds.len(), invariants)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mistake_can_be_put_in() {
        let workspace = Workspace::find().unwrap();
        let bugs = read(&workspace).unwrap();
        assert!(bugs.len() >= 40, "{}", bugs.len());
        let (sources, packages) = with_all(&bugs, workspace.root()).unwrap();
        assert_eq!(packages.into_iter().collect::<Vec<_>>(), ["pb3dp-hal-middleware", "pb3dp-servo"]);
        let supervisor = &sources["crates/servo/src/supervisor.rs"];
        assert!(supervisor.contains("crate::seeded_bug(1)") && supervisor.contains("crate::seeded_bug(2)"));
    }

    #[test]
    fn violations_are_counted_by_run() {
        let text = "seed 7: position, vs-robot, axis 1: 0.1 at 2 s\n  repeat: x\nseed 7: speed, tc-robot\nseed 9: position, x\nend";
        let (runs, invariants) = violations(text);
        assert_eq!(
            (runs, invariants.into_iter().collect::<Vec<_>>()),
            (2, vec!["position".to_owned(), "speed".to_owned()])
        );
    }
}
