//! Other tools: a script that prints one JSON line per case and tool, with the errors that the script computed.

use std::collections::{BTreeSet, HashMap};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::rc::Rc;

use anyhow::{Context, bail};
use serde_json::Value;

use super::score::{Answer, CaseFacts, Entry, Maker};

const SCRIPT: &str = "peers.py";

/// The script in a folder.
///
/// # Errors
/// If the script does not exist.
pub fn script_in(folder: &Path) -> anyhow::Result<PathBuf> {
    let script = folder.join(SCRIPT);
    if !script.is_file() {
        bail!("--peers {}: no {SCRIPT} in this folder; give the folder that contains it", folder.display());
    }
    Ok(script)
}

/// Runs the script on the cases, each tool with one thread, and returns the printed lines.
///
/// # Errors
/// If Python cannot be started or the script fails.
pub fn run(python: &Path, script: &Path, cases: &Path, repeat: u32) -> anyhow::Result<String> {
    eprintln!("running {SCRIPT}, which may take some minutes");
    let mut command = Command::new(python);
    command.arg(script).arg(cases).args(["--repeat", &repeat.to_string()]);
    command.envs([("OMP_NUM_THREADS", "1"), ("OPENBLAS_NUM_THREADS", "1")]).stderr(Stdio::inherit());
    let output =
        command.output().with_context(|| format!("cannot start {}: give a Python with --python", python.display()))?;
    if !output.status.success() {
        bail!(
            "{} {} failed ({}): see its message above; it needs OpenCV and NumPy, set --python to a Python that has them",
            python.display(),
            script.display(),
            output.status
        );
    }
    String::from_utf8(output.stdout).with_context(|| format!("the output of {SCRIPT} is not UTF-8 text"))
}

/// The entries of files with the output of earlier runs.
///
/// # Errors
/// A file that cannot be read, or that has a line in another format.
pub fn entries_of_files(files: &[PathBuf], cases: &[Rc<CaseFacts>]) -> anyhow::Result<Vec<Entry>> {
    let mut found = Vec::new();
    for file in files {
        let text =
            std::fs::read_to_string(file).with_context(|| format!("cannot read --peer-results {}", file.display()))?;
        found.extend(entries(&text, cases, &file.display().to_string())?);
    }
    Ok(found)
}

/// Converts the lines to entries for the known cases; `source` names them in messages. A case that a tool left out has
/// no answer from this tool.
///
/// # Errors
/// A line in another format, by its number.
pub fn entries(lines: &str, cases: &[Rc<CaseFacts>], source: &str) -> anyhow::Result<Vec<Entry>> {
    let by_name: HashMap<&str, &Rc<CaseFacts>> = cases.iter().map(|case| (case.name.as_str(), case)).collect();
    let mut found = Vec::new();
    for (index, line) in lines.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let entry = entry_of(line, &by_name).with_context(|| format!("{source}, line {}", index + 1))?;
        found.extend(entry);
    }
    let present: BTreeSet<_> = found.iter().map(|entry| entry.case.name.clone()).collect();
    let missing: Vec<_> = cases.iter().map(|case| &case.name).filter(|name| !present.contains(*name)).collect();
    if let Some(first) = missing.first() {
        eprintln!("{source} has no line for {} of {} cases, such as {first}", missing.len(), cases.len());
    }
    Ok(found)
}

fn entry_of(line: &str, cases: &HashMap<&str, &Rc<CaseFacts>>) -> anyhow::Result<Option<Entry>> {
    // Python writes NaN and infinity in a way that is not JSON.
    let line = ["-Infinity", "Infinity", "NaN"].iter().fold(line.to_owned(), |l, word| l.replace(word, "null"));
    let value: Value = serde_json::from_str(&line).context("is not JSON")?;
    let text = |key: &str| value[key].as_str().with_context(|| format!("has no text `{key}`"));
    let number = |key: &str| value[key].as_f64();
    let (name, method) = (text("case")?, text("method")?);
    let Some(case) = cases.get(name) else { return Ok(None) };
    let answer = match (number("z_err_mm"), number("normal_err_deg")) {
        (Some(z_mm), Some(normal_deg)) => Some(Answer {
            z_m: 1e-3 * z_mm,
            normal_rad: normal_deg.to_radians(),
            disparity_px: number("disp_err_px"),
            z_sigma_m: None,
            normal_sigma_rad: None,
            map: number("gt_disp_med_abs_px").zip(number("gt_disp_within_1px")),
        }),
        _ => None,
    };
    Ok(Some(Entry { answer, ms: number("ms"), ..Entry::new(case, method, Maker::Peer) }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::real::score::Grade;
    use crate::real::score::tests::case;
    use pb3dp_record::metrics::Group;

    #[test]
    fn lines_become_entries_that_are_judged_by_our_own_measure() {
        let known = [case("a", Group::Textured, (1.0, 4.0)), case("b", Group::Textured, (0.0, 0.0))];
        let lines = concat!(
            "{\"case\": \"a\", \"method\": \"bm\", \"z_err_mm\": -3.5, \"normal_err_deg\": 7.5, \"ms\": 2.5, ",
            "\"gt_disp_med_abs_px\": 0.2, \"gt_disp_within_1px\": 0.75, \"ok\": true}\n\n",
            "{\"case\": \"elsewhere\", \"method\": \"bm\", \"z_err_mm\": 1, \"normal_err_deg\": 1}\n",
            "{\"case\": \"b\", \"method\": \"bm\", \"z_err_mm\": NaN, \"normal_err_deg\": -Infinity, \"ms\": 4}\n",
        );
        let found = entries(lines, &known, "x").expect("valid");
        assert_eq!(found.len(), 2, "the unknown case is left out");
        // 7.5 degrees are within twice the truth's 4.
        assert_eq!((found[0].grade(), found[0].ms), (Some(Grade::Pass), Some(2.5)));
        assert_eq!(found[0].answer.and_then(|a| a.map), Some((0.2, 0.75)));
        assert_eq!((found[1].answer, found[1].ms, found[1].maker), (None, Some(4.0), Maker::Peer));
    }

    #[test]
    fn a_bad_line_is_named_by_its_number() {
        let check = |lines: &str, parts: &[&str]| {
            let message = format!("{:#}", entries(lines, &[], "old.jsonl").expect_err("refused"));
            parts.iter().for_each(|part| assert!(message.contains(part), "{message:?} must contain {part:?}"));
        };
        check("{\"case\": \"a\", \"method\": \"bm\"}\nTraceback", &["old.jsonl, line 2", "JSON"]);
        check("{\"case\": \"a\"}", &["line 1", "`method`"]);
    }

    #[test]
    fn a_python_that_is_missing_or_fails_is_named() {
        let message = |python: &str| {
            let outcome = run(Path::new(python), Path::new("no/such/script"), Path::new("."), 1);
            format!("{:#}", outcome.expect_err("it cannot work"))
        };
        assert!(message("no-such-python").contains("no-such-python"));
        assert!(message("false").contains("--python"));
    }
}
