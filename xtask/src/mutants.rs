//! `cargo xtask mutants`: changes the product in small ways, and checks whether a test fails.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, bail};
use serde_json::Value;

use crate::not_possible::NotPossible;
use crate::scratch::Scratch;
use crate::workspace::{Workspace, run_visibly};

/// Changes the code of the safety chain in small ways, and checks whether a test fails.
///
/// A mutant is one small change: `<` for `<=`, a function that returns at once, a match without one arm. A seeded sample is drawn
/// from each part, and the tests in virtual time run against each mutant in a scratch copy. A mutant without a failing test must be
/// explained in tests/mutants.toml. Results are kept until a source file changes, so an interrupted run continues. Fails if less
/// than 95 % of a part are noticed, too slow or explained. Needs cargo-mutants: `cargo install --locked cargo-mutants`.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// The part: middleware, clearance, law, supervisor, codec, driver or gateway. Default: all parts.
    part: Option<String>,
    /// Seed of the sample.
    #[arg(long, default_value_t = 20)]
    seed: u64,
    /// Number of mutants of each part that build; at most all of them.
    #[arg(long, default_value_t = 60)]
    sample: usize,
    /// Only the K-th of N shares of the sample, from 1, as K/N, to divide it among machines or evenings.
    #[arg(long, value_parser = Shard::parse, default_value = "1/1")]
    shard: Shard,
}

/// A share of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shard {
    index: usize,
    count: usize,
}

impl Shard {
    fn parse(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
        match numbers {
            Some((index, count)) if (1..=count).contains(&index) => Ok(Self { index: index - 1, count }),
            _ => Err(format!("{text:?} is not a share: write K/N with K from 1 to N, such as 2/5")),
        }
    }
}

/// A part of the code that must not change unnoticed.
struct Part {
    name: &'static str,
    package: &'static str,
    files: &'static str,
    /// The packages whose tests run, separated by commas.
    tested_by: &'static str,
}

const PARTS: [Part; 7] = [
    Part {
        name: "middleware",
        package: "pb3dp-hal-middleware",
        files: "hal/middleware/src/**/*.rs",
        tested_by: "pb3dp-hal-middleware",
    },
    Part {
        name: "clearance",
        package: "pb3dp-kinematics",
        files: "crates/kinematics/src/clearance.rs",
        tested_by: "pb3dp-kinematics",
    },
    Part { name: "law", package: "pb3dp-servo", files: "crates/servo/src/law/**/*.rs", tested_by: "pb3dp-servo" },
    Part {
        name: "supervisor",
        package: "pb3dp-servo",
        files: "crates/servo/src/supervisor{,/*}.rs",
        tested_by: "pb3dp-servo",
    },
    Part {
        name: "codec",
        package: "pb3dp-arm-pa10-protocol",
        files: "hal/arm-pa10-protocol/src/**/*.rs",
        tested_by: "pb3dp-arm-pa10-protocol,pb3dp-arm-pa10,pb3dp-arm-pa10-gateway,pb3dp-arm-pa10-emulation",
    },
    Part {
        name: "driver",
        package: "pb3dp-arm-pa10",
        files: "hal/arm-pa10/src/driver/**/*.rs",
        tested_by: "pb3dp-arm-pa10,pb3dp-arm-pa10-gateway,pb3dp-arm-pa10-emulation",
    },
    Part {
        name: "gateway",
        package: "pb3dp-arm-pa10-gateway",
        files: "hal/arm-pa10-gateway/src/gateway/**/*.rs",
        tested_by: "pb3dp-arm-pa10-gateway,pb3dp-arm-pa10",
    },
];
/// File of the results of all runs.
const KEPT: &str = "results.json";
/// Minimum share of noticed or explained mutants.
const NOTICED_MIN: f64 = 0.95;
/// Tests in real time, by the beginnings of their names. The last two run alone, in a program of their own.
const REAL_TIME: [&str; 3] = ["real_time::", "killed::", "no_allocation::exchanges"];
/// Mutants that do not change the promised behaviour, each with its reason.
const EXPLAINED: &str = "tests/mutants.toml";

/// # Errors
/// [`NotPossible`] without cargo-mutants; otherwise if the tests fail without a change, or too few mutants are noticed.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    if !Command::new("cargo-mutants").args(["mutants", "--version"]).output().is_ok_and(|out| out.status.success()) {
        return Err(NotPossible::because("cargo-mutants is missing: run `cargo install --locked cargo-mutants`"));
    }
    let parts: Vec<&Part> =
        PARTS.iter().filter(|part| args.part.as_ref().is_none_or(|name| name == part.name)).collect();
    if parts.is_empty() {
        bail!("no such part; give one of: {}", PARTS.map(|part| part.name).join(", "));
    }
    let explained = explained(workspace)?;
    let sources = sources(workspace)?;
    let scratch = Scratch::new(workspace, "mutants")?;
    let mut lines = Vec::new();
    let mut short = Vec::new();
    for part in parts {
        let mutants = shuffled(list(&scratch, part)?, args.seed);
        let all = mutants.len();
        let share: Vec<Mutant> = mutants.into_iter().skip(args.shard.index).step_by(args.shard.count).collect();
        let wanted = args.sample.div_ceil(args.shard.count);
        let tally = draw(&share, wanted, &explained, |sample| test(&scratch, part, sample, sources))?;
        for mutant in &tally.unnoticed {
            println!("not noticed: {}\n    {}", mutant.name, mutant.line);
        }
        lines.push(tally.line(part, all));
        if tally.share_noticed() < NOTICED_MIN {
            short.push(part.name);
        }
    }
    println!("\n| part | mutants | tried | do not build | noticed | too slow | explained | not noticed |");
    println!("|---|---|---|---|---|---|---|---|\n{}", lines.join("\n"));
    match short[..] {
        [] => Ok(()),
        _ => bail!("fewer than {:.0} % are noticed or explained: {}", 100.0 * NOTICED_MIN, short.join(", ")),
    }
}

/// One small change.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Mutant {
    /// `file:line:column: change`.
    name: String,
    file: String,
    /// The change, without its position.
    change: String,
    /// The line of the source.
    line: String,
}

impl Mutant {
    fn read(value: &Value, tree: &Path) -> Option<Self> {
        let (name, file) = (value["name"].as_str()?, value["file"].as_str()?);
        let place = &value["span"]["start"]["line"];
        let source = fs::read_to_string(tree.join(file)).ok()?;
        let line = source.lines().nth(usize::try_from(place.as_u64()?).ok()?.checked_sub(1)?)?.trim().to_owned();
        let change = name.splitn(4, ':').nth(3)?.trim().to_owned();
        Some(Self { name: name.to_owned(), file: file.to_owned(), change, line })
    }
}

fn cargo_mutants(scratch: &Scratch, part: &Part) -> Command {
    let mut command = Command::new("cargo-mutants");
    command.args(["mutants", "--no-config", "--package", part.package, "--file", part.files]);
    command.args(["--test-package", part.tested_by]);
    // Examples are not built.
    command.args(["--cargo-arg=--lib", "--cargo-arg=--tests"]);
    command.arg("--dir").arg(&scratch.tree).env("CARGO_TARGET_DIR", &scratch.target);
    command
}

/// All mutants of a part.
fn list(scratch: &Scratch, part: &Part) -> anyhow::Result<Vec<Mutant>> {
    let output =
        cargo_mutants(scratch, part).args(["--list", "--json"]).output().context("cannot run cargo-mutants")?;
    if !output.status.success() {
        bail!("cargo-mutants cannot list mutants: {}", String::from_utf8_lossy(&output.stderr));
    }
    let listed: Vec<Value> = serde_json::from_slice(&output.stdout).context("the list of cargo-mutants is not JSON")?;
    let read = |value: &Value| {
        Mutant::read(value, &scratch.tree).with_context(|| format!("needs cargo-mutants 26.1 or newer: {value}"))
    };
    listed.iter().map(read).collect()
}

/// The mutants in an order that depends on the seed alone.
fn shuffled(mut mutants: Vec<Mutant>, seed: u64) -> Vec<Mutant> {
    mutants.sort_by_cached_key(|mutant| (scrambled(seed, &mutant.name), mutant.name.clone()));
    mutants
}

/// Tries mutants until this many of them build, or all have been tried. `test` returns the results of the given mutants.
fn draw(
    mutants: &[Mutant],
    wanted: usize,
    explained: &[Explained],
    test: impl Fn(&[Mutant]) -> anyhow::Result<Results>,
) -> anyhow::Result<Tally> {
    let mut drawn = wanted.min(mutants.len());
    loop {
        let sample = &mutants[..drawn];
        let tally = Tally::of(sample, &test(sample)?, explained);
        let more = (wanted + tally.unviable).min(mutants.len());
        if more <= drawn {
            return Ok(tally);
        }
        drawn = more;
    }
}

/// A number from the seed and the text: FNV-1a, whose last bits are mixed as in SplitMix64.
fn scrambled(seed: u64, text: &str) -> u64 {
    let hash = text
        .bytes()
        .fold(0xcbf2_9ce4_8422_2325 ^ seed, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3));
    let mixed = (hash ^ hash >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb)
}

/// Results by the names of the mutants, as from cargo-mutants.
type Results = BTreeMap<String, String>;

/// Runs the tests against the mutants without a result. A result is valid while no source file changes.
fn test(scratch: &Scratch, part: &Part, mutants: &[Mutant], sources: u64) -> anyhow::Result<Results> {
    let folder = scratch.target.join("results").join(part.name).join(format!("{sources:016x}"));
    fs::create_dir_all(&folder)?;
    // Includes the results of an interrupted run.
    let mut known = read_kept(&folder);
    known.extend(read_results(&folder.join("mutants.out")));
    let names = mutants.iter().filter(|mutant| !known.contains_key(&mutant.name)).map(|mutant| escaped(&mutant.name));
    let names: Vec<String> = names.collect();
    if !names.is_empty() {
        let mut command = cargo_mutants(scratch, part);
        command.args(["--in-place", "--no-shuffle", "--cap-lints", "true", "--minimum-test-timeout", "60"]);
        command.arg("--output").arg(&folder).arg("--re").arg(format!("^({})$", names.join("|")));
        // Mutants in waiting code would cost real time: only tests in virtual time run.
        command.args(["--", "--"]);
        command.args(REAL_TIME.iter().flat_map(|tests| ["--skip", tests]));
        // cargo-mutants fails if a mutant is missed; the results contain this.
        let ended = run_visibly(&mut command);
        let results = read_results(&folder.join("mutants.out"));
        if results.is_empty() {
            ended?;
            bail!("cargo-mutants tried nothing in {}", part.files);
        }
        known.extend(results);
    }
    fs::write(folder.join(KEPT), serde_json::to_string_pretty(&known)?).context("cannot save the results")?;
    Ok(known)
}

/// A hash of all source files, product and tests.
fn sources(workspace: &Workspace) -> anyhow::Result<u64> {
    let files = workspace.texts(&[".rs", ".toml", ".urdf", "Cargo.lock"])?;
    let files = files.iter().filter(|file| !file.path.starts_with("xtask/") && file.path != EXPLAINED);
    Ok(files.fold(0, |sum, file| scrambled(scrambled(sum, &file.path), &file.text)))
}

/// A pattern that matches only this text.
fn escaped(name: &str) -> String {
    name.chars().flat_map(|c| r"\.+*?()|[]{}^$".contains(c).then_some('\\').into_iter().chain([c])).collect()
}

fn read_results(folder: &Path) -> Results {
    let mut results = Results::new();
    for word in ["caught", "unviable", "timeout", "missed"] {
        let names = fs::read_to_string(folder.join(word).with_extension("txt")).unwrap_or_default();
        results.extend(names.lines().map(|name| (name.to_owned(), word.to_owned())));
    }
    results
}

fn read_kept(folder: &Path) -> Results {
    let text = fs::read_to_string(folder.join(KEPT)).unwrap_or_default();
    serde_json::from_str(&text).unwrap_or_default()
}

/// A mutant that no test needs to notice.
#[derive(Debug, PartialEq, Eq)]
struct Explained {
    file: String,
    change: String,
    line: String,
}

fn explained(workspace: &Workspace) -> anyhow::Result<Vec<Explained>> {
    let file = workspace.root().join(EXPLAINED);
    let text = fs::read_to_string(&file).with_context(|| format!("cannot read {EXPLAINED}"))?;
    let table: toml::Table = text.parse().with_context(|| format!("{EXPLAINED} is not TOML"))?;
    let entries = table.get("mutant").and_then(toml::Value::as_array).cloned().unwrap_or_default();
    let read = |entry: &toml::Value| {
        let of = |key: &str| entry.get(key).and_then(toml::Value::as_str).map(str::to_owned);
        of("why").filter(|why| !why.is_empty())?;
        Some(Explained { file: of("file")?, change: of("change")?, line: of("line")? })
    };
    let complete =
        |entry| read(entry).with_context(|| format!("{EXPLAINED}: file, change, line or why is missing in {entry}"));
    entries.iter().map(complete).collect()
}

/// Results of the mutants of a part.
#[derive(Default)]
struct Tally {
    noticed: usize,
    too_slow: usize,
    unviable: usize,
    explained: usize,
    unnoticed: Vec<Mutant>,
    untried: usize,
}

impl Tally {
    fn of(mutants: &[Mutant], results: &Results, explained: &[Explained]) -> Self {
        let mut tally = Self::default();
        for mutant in mutants {
            let is_explained = explained
                .iter()
                .any(|known| (&known.file, &known.change, &known.line) == (&mutant.file, &mutant.change, &mutant.line));
            match results.get(&mutant.name).map(String::as_str) {
                Some("caught") => tally.noticed += 1,
                Some("timeout") => tally.too_slow += 1,
                Some("unviable") => tally.unviable += 1,
                Some("missed") if is_explained => tally.explained += 1,
                Some(_) => tally.unnoticed.push(mutant.clone()),
                None => tally.untried += 1,
            }
        }
        tally
    }

    /// Share of the mutants that build. An untried mutant counts as not noticed.
    fn share_noticed(&self) -> f64 {
        let good = self.noticed + self.too_slow + self.explained;
        good as f64 / (good + self.unnoticed.len() + self.untried).max(1) as f64
    }

    fn line(&self, part: &Part, all: usize) -> String {
        let Self { noticed, too_slow, unviable, explained, unnoticed, untried } = self;
        let missed = unnoticed.len();
        let tried = noticed + too_slow + unviable + explained + missed;
        let rest = if *untried > 0 { format!(" (and {untried} not tried)") } else { String::new() };
        format!(
            "| {} | {all} | {tried}{rest} | {unviable} | {noticed} | {too_slow} | {explained} | {missed} |",
            part.name
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mutant(line: u32) -> Mutant {
        let change = "replace < with <= in Limiter::limit".to_owned();
        let file = "hal/middleware/src/limiter.rs".to_owned();
        Mutant { name: format!("{file}:{line}:9: {change}"), file, change, line: format!("if a < {line} {{") }
    }

    #[test]
    fn the_order_depends_on_the_seed_alone() {
        let all: Vec<Mutant> = (0..50).map(mutant).collect();
        let mut reversed = all.clone();
        reversed.reverse();
        let drawn = shuffled(all.clone(), 7);
        assert_eq!(drawn, shuffled(reversed, 7));
        assert_ne!(drawn, all);
        assert_ne!(drawn, shuffled(all, 8));
    }

    #[test]
    fn what_is_missed_counts_unless_its_line_is_explained() {
        let mutants: Vec<Mutant> = (1..=5).map(mutant).collect();
        let words = ["caught", "missed", "missed", "timeout"];
        let results: Results =
            mutants.iter().zip(words).map(|(mutant, word)| (mutant.name.clone(), word.to_owned())).collect();
        let known = &mutants[1];
        let explained =
            [Explained { file: known.file.clone(), change: known.change.clone(), line: known.line.clone() }];
        let tally = Tally::of(&mutants, &results, &explained);
        assert_eq!((tally.noticed, tally.too_slow, tally.explained, tally.untried), (1, 1, 1, 1));
        assert_eq!(tally.unnoticed, [mutants[2].clone()]);
        assert!((tally.share_noticed() - 0.6).abs() < 1e-12);
    }

    #[test]
    fn as_many_are_drawn_as_build() {
        let mutants: Vec<Mutant> = (0..20).map(mutant).collect();
        // Every second one does not build.
        let test = |sample: &[Mutant]| {
            let words = ["unviable", "caught"].into_iter().cycle();
            Ok(sample.iter().zip(words).map(|(mutant, word)| (mutant.name.clone(), word.to_owned())).collect())
        };
        let tally = draw(&mutants, 6, &[], test).unwrap();
        assert_eq!((tally.noticed, tally.unviable), (6, 6));
        let tally = draw(&mutants, 60, &[], test).unwrap();
        assert_eq!((tally.noticed, tally.unviable), (10, 10));
    }

    #[test]
    fn a_share_is_one_of_several() {
        assert_eq!(Shard::parse("2/5"), Ok(Shard { index: 1, count: 5 }));
        for wrong in ["0/5", "6/5", "2", "a/b", ""] {
            assert!(Shard::parse(wrong).unwrap_err().contains("is not a share"), "{wrong}");
        }
    }

    #[test]
    fn names_are_no_patterns() {
        assert_eq!(escaped("a/b.rs:3: replace < with * in f -> [T]"), r"a/b\.rs:3: replace < with \* in f -> \[T\]");
    }
}
