//! `cargo xtask same-answers`: checks that a change of structure has changed no result.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail, ensure};
use serde_json::Value;

use crate::workspace::{Workspace, run_visibly};

/// The compared methods.
const METHODS: [&str; 2] = ["direct", "published"];

/// The cases of the repository.
const CASES: &str = "tests/data/cases";

/// Keys whose values depend on the clock or the commit, at any depth of a JSON document.
const NOT_COMPARED: [&str; 5] = ["ms", "latency_p50_millis", "latency_p99_millis", "duration", "commit"];

/// Number of differing lines that are shown per answer.
const SHOWN: usize = 5;

/// Compares the results of the work tree with those of an earlier commit, byte for byte, without times.
///
/// Builds the programs of both with optimisation. Then both run the experiment in simulation (summary.json), estimate the four
/// cases of the repository and those of --cases DIR with each method (`estimate --json`), track --sequence DIR
/// (`track --json`), and do seeded safety runs (a hash of each whole record). The first build of a commit takes some minutes;
/// it is kept below the target folder.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// The commit before the change.
    #[arg(long, value_name = "COMMIT")]
    before: String,
    /// Also estimate each case in this folder.
    #[arg(long, value_name = "DIR")]
    cases: Option<PathBuf>,
    /// Also track this sequence, with each method.
    #[arg(long, value_name = "DIR")]
    sequence: Option<PathBuf>,
    /// Number of seeded safety runs.
    #[arg(long, default_value_t = 200)]
    seeds: u64,
}

/// The inputs of both programs.
struct Questions {
    /// Folders of cases (absolute), with a name for each.
    cases: Vec<(&'static str, PathBuf)>,
    sequence: Option<PathBuf>,
    seeds: u64,
}

/// A checkout, and its build folder.
struct Tree {
    root: PathBuf,
    target: PathBuf,
}

/// One request, and the lines of the answer.
struct Answer {
    name: String,
    lines: Vec<String>,
}

/// # Errors
/// If a program does not build or fails, or an answer differs.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let folder = workspace.target_folder()?.join("xtask").join("same-answers");
    let before = checked_out(workspace, &args.before, &folder)?;
    let now = Tree { root: workspace.root().to_path_buf(), target: workspace.target_folder()? };
    let absolute = |given: &Path| given.canonicalize().with_context(|| format!("cannot find {}", given.display()));
    let mut cases = vec![("cases of the repository", workspace.root().join(CASES))];
    cases.extend(args.cases.as_deref().map(absolute).transpose()?.map(|given| ("given cases", given)));
    let sequence = args.sequence.as_deref().map(absolute).transpose()?;
    let questions = Questions { cases, sequence, seeds: args.seeds };

    let mut answers = Vec::new();
    for (tree, name) in [(&before, "before"), (&now, "now")] {
        println!("== {name}: {}", tree.root.display());
        answers.push(tree.answers(workspace, &questions, &folder.join(name))?);
    }
    let [before, now] = answers.try_into().ok().context("two trees have answered")?;
    conclude(&before, &now)
}

/// The files of a commit, in a separate folder named after it.
fn checked_out(workspace: &Workspace, commit: &str, folder: &Path) -> anyhow::Result<Tree> {
    let wanted = format!("{commit}^{{commit}}");
    let commit = workspace
        .output_of("git", &["rev-parse", "--verify", &wanted])
        .with_context(|| format!("--before {commit}: git has no such commit"))?;
    let root = folder.join(&commit);
    let (index, begun) = (folder.join(format!("{commit}.index")), folder.join("begun"));
    if !root.is_dir() {
        // A temporary name until the checkout is complete, so that an interrupted one is not used.
        if begun.is_dir() {
            fs::remove_dir_all(&begun).with_context(|| format!("cannot remove {}", begun.display()))?;
        }
        fs::create_dir_all(&begun).with_context(|| format!("cannot create {}", begun.display()))?;
        let git = || {
            let mut command = workspace.command("git");
            command.env("GIT_INDEX_FILE", &index);
            command
        };
        run_visibly(git().args(["read-tree", &commit]))?;
        run_visibly(git().args(["checkout-index", "--all"]).arg(format!("--prefix={}/", begun.display())))?;
        fs::rename(&begun, &root).with_context(|| format!("cannot create {}", root.display()))?;
    }
    Ok(Tree { root, target: folder.join("target") })
}

impl Tree {
    /// A cargo command with optimisation in this tree: the first word is the subcommand.
    fn cargo(&self, workspace: &Workspace, words: &[&str]) -> Command {
        let mut command = workspace.cargo();
        command.current_dir(&self.root).env("CARGO_TARGET_DIR", &self.target);
        command.arg(words[0]).args(["--release", "--locked", "--quiet"]).args(&words[1..]);
        command
    }

    /// Builds both programs and runs all requests; the output of a run goes to `out`.
    fn answers(&self, workspace: &Workspace, questions: &Questions, out: &Path) -> anyhow::Result<Vec<Answer>> {
        run_visibly(&mut self.cargo(workspace, &["build", "--package", "pb3dp-orchestrator", "--bin", "pb3dp"]))?;
        // The example is in one of both packages, because it was moved.
        let packages = ["build", "--package", "system-tests", "--package", "pb3dp-benchmarks", "--example", "safety"];
        run_visibly(&mut self.cargo(workspace, &packages))?;
        let mut answers = vec![self.experiment(out)?];
        for method in METHODS {
            for (name, folder) in &questions.cases {
                let words = ["estimate", "--method", method, "--json", "--cases"];
                answers.push(self.lines(format!("estimate, {method}, {name}"), &words, folder)?);
            }
            if let Some(folder) = &questions.sequence {
                let words = ["track", "--method", method, "--json", "--sequence"];
                answers.push(self.lines(format!("track, {method}"), &words, folder)?);
            }
        }
        answers.push(self.safety(questions.seeds)?);
        Ok(answers)
    }

    fn program(&self) -> Command {
        let mut command = Command::new(self.target.join("release").join("pb3dp"));
        command.current_dir(&self.root);
        command
    }

    /// The results of the experiment in simulation.
    fn experiment(&self, out: &Path) -> anyhow::Result<Answer> {
        let output = self.program().args(["run", "--config", "configs/sim.toml", "--out"]).arg(out).output()?;
        ensure!(output.status.success(), "the experiment failed:\n{}", String::from_utf8_lossy(&output.stderr));
        let file = out.join("summary.json");
        let text = fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
        let summary = without_times(serde_json::from_str(&text)?);
        let lines = serde_json::to_string_pretty(&summary)?.lines().map(str::to_owned).collect();
        Ok(Answer { name: "summary.json of the experiment".into(), lines })
    }

    /// The JSON lines of a command. A rejected case makes the command fail; its message is a line like all others.
    fn lines(&self, name: String, words: &[&str], folder: &Path) -> anyhow::Result<Answer> {
        let output = self.program().args(words).arg(folder).output()?;
        let text = String::from_utf8(output.stdout).with_context(|| format!("{name}: the output is not text"))?;
        let lines: Vec<String> = text
            .lines()
            .map(|line| Ok(without_times(serde_json::from_str(line)?).to_string()))
            .collect::<anyhow::Result<_>>()
            .with_context(|| format!("{name}: a line is not JSON"))?;
        ensure!(!lines.is_empty(), "{name}: no answer:\n{}", String::from_utf8_lossy(&output.stderr));
        Ok(Answer { name, lines })
    }

    /// A hash of each seeded run, in the order of seeds.
    fn safety(&self, seeds: u64) -> anyhow::Result<Answer> {
        let mut command = Command::new(self.target.join("release").join("examples").join("safety"));
        let output =
            command.current_dir(&self.root).args(["--seed", "1", "--trace", "--runs", &seeds.to_string()]).output()?;
        ensure!(output.status.success(), "safety runs failed:\n{}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8_lossy(&output.stdout);
        let mut lines: Vec<String> = text
            .lines()
            .filter(|line| line.starts_with("seed ") && line.contains(", digest "))
            .map(str::to_owned)
            .collect();
        lines.sort();
        ensure!(lines.len() as u64 == seeds, "{} of {seeds} safety runs have a digest", lines.len());
        Ok(Answer { name: "safety runs".into(), lines })
    }
}

/// The document without values that depend on the clock.
fn without_times(value: Value) -> Value {
    match value {
        Value::Object(entries) => entries
            .into_iter()
            .filter(|(key, _)| !NOT_COMPARED.contains(&key.as_str()))
            .map(|(key, value)| (key, without_times(value)))
            .collect(),
        Value::Array(entries) => entries.into_iter().map(without_times).collect(),
        other => other,
    }
}

/// Prints for each answer whether it is the same.
fn conclude(before: &[Answer], now: &[Answer]) -> anyhow::Result<()> {
    let mut different = 0;
    for (before, now) in before.iter().zip(now) {
        let differences = differences(&before.lines, &now.lines);
        let verdict = if differences.is_empty() { "same" } else { "DIFFERENT" };
        println!("{verdict:<9}  {:>5} lines  {}", now.lines.len(), now.name);
        for line in differences.iter().take(SHOWN) {
            println!("{line}");
        }
        different += usize::from(!differences.is_empty());
    }
    if different > 0 {
        bail!("{different} of {} answers differ", now.len());
    }
    Ok(())
}

fn differences(before: &[String], now: &[String]) -> Vec<String> {
    let now: Vec<String> = now.iter().enumerate().map(|(at, line)| as_before(before.get(at), line)).collect();
    let now = now.as_slice();
    let count = before.len().max(now.len());
    let line = |lines: &[String], at: usize| lines.get(at).map_or_else(|| "(no line)".to_owned(), Clone::clone);
    (0..count)
        .filter(|&at| before.get(at) != now.get(at))
        .map(|at| format!("  before: {}\n  now:    {}", line(before, at), line(now, at)))
        .collect()
}

/// A line of JSON without new keys: lines may gain keys, but not lose or rename any.
fn as_before(before: Option<&String>, now: &str) -> String {
    let object = |line: &str| serde_json::from_str::<serde_json::Map<String, Value>>(line).ok();
    match (before.and_then(|line| object(line)), object(now)) {
        (Some(before), Some(mut now)) => {
            now.retain(|key, _| before.contains_key(key));
            Value::Object(now).to_string()
        }
        _ => now.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn times_are_left_out_at_any_depth_and_nothing_else() {
        let document =
            json!({"ms": 1.5, "z_mm": 300.1, "cycles": {"latency_p50_millis": 2, "count": 3}, "all": [{"ms": 4}, 5]});
        let expected = json!({"z_mm": 300.1, "cycles": {"count": 3}, "all": [{}, 5]});
        assert_eq!(without_times(document), expected);
    }

    #[test]
    fn a_changed_digit_a_missing_line_and_a_new_one_are_differences() {
        let lines = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>();
        assert!(differences(&lines(&["a", "b"]), &lines(&["a", "b"])).is_empty());
        assert!(differences(&lines(&[r#"{"z":1}"#]), &lines(&[r#"{"z":1,"point":2}"#])).is_empty(), "a key may be new");
        assert_eq!(differences(&lines(&[r#"{"z":1,"y":2}"#]), &lines(&[r#"{"z":1}"#])).len(), 1, "none may go");
        assert_eq!(differences(&lines(&["a", "b"]), &lines(&["a", "c"])).len(), 1);
        assert_eq!(differences(&lines(&["a", "b"]), &lines(&["a"])), ["  before: b\n  now:    (no line)"]);
        assert_eq!(differences(&lines(&["a"]), &lines(&["a", "b"])).len(), 1);
    }
}
