//! The report of a checklist, for people (Markdown) and for programs (JSON).

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;

use super::super::probe_report::GatewayFacts;
use super::record::{Outcome, StepReport};

/// Overall result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Every step of the checklist has passed.
    Passed,
    /// All requested steps have passed, others were skipped.
    Incomplete,
    /// A step has failed.
    Failed,
    /// Ended by a signal.
    Interrupted,
}

/// A test of one arm.
#[derive(Debug, Serialize)]
pub struct TestReport {
    /// Version of the report format.
    pub format: u32,
    /// Overall result.
    pub result: Verdict,
    /// Name of the arm.
    pub arm: &'static str,
    /// Start time, UTC.
    pub began: String,
    /// End time, UTC.
    pub ended: String,
    /// The program.
    pub program: ProgramFacts,
    /// Processor and number of cores.
    pub machine: String,
    /// Files of the setup, with further settings.
    pub config: String,
    /// SHA-256 of `settings.toml` beside the report, with all values.
    pub config_sha256: String,
    /// Address or port of the arm.
    pub target: String,
    /// Whether gateway and controller were emulated.
    pub is_emulated: bool,
    /// Properties reported by the gateway.
    pub gateway: GatewayFacts,
    /// Name of the operator.
    pub operator: &'static str,
    /// The axis that moved, 1 to 7.
    pub axis: u8,
    /// Angle of each move, degrees.
    pub by_deg: f64,
    /// Largest speed, rad/s.
    pub speed_rad_per_s: f64,
    /// The steps, in order.
    pub steps: Vec<StepReport>,
}

/// Version and commit of the program.
#[derive(Debug, Serialize)]
pub struct ProgramFacts {
    /// Its version.
    pub version: &'static str,
    /// Commit that it was built from.
    pub commit: &'static str,
}

impl Verdict {
    /// Overall result of these steps.
    pub fn of(steps: &[StepReport]) -> Self {
        let any = |outcome| steps.iter().any(|step| step.result == outcome);
        if any(Outcome::Failed) {
            Self::Failed
        } else if any(Outcome::Interrupted) {
            Self::Interrupted
        } else if any(Outcome::Skipped) {
            Self::Incomplete
        } else {
            Self::Passed
        }
    }

    /// Name in headings.
    pub fn word(self) -> &'static str {
        match self {
            Self::Passed => "passed",
            Self::Incomplete => "incomplete",
            Self::Failed => "failed",
            Self::Interrupted => "interrupted",
        }
    }
}

impl TestReport {
    /// Writes `report.md` and `report.json` into a folder; returns the path of the first one.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, folder: &Path) -> Result<PathBuf> {
        let write = |name: &str, text: String| {
            let path = folder.join(name);
            std::fs::write(&path, text).with_context(|| format!("{}: cannot be written", path.display())).map(|()| path)
        };
        write("report.json", serde_json::to_string_pretty(self)? + "\n")?;
        write("report.md", self.markdown())
    }

    fn markdown(&self) -> String {
        let mut text = format!("# Test of the {}: {}\n\n", self.arm, self.result.word());
        let origin = if self.is_emulated { "emulated, no hardware was tested" } else { "as configured" };
        let gateway = self.gateway.to_string();
        let facts = [
            ("began, UTC", self.began.clone()),
            ("ended, UTC", self.ended.clone()),
            ("program", format!("pb3dp {}, commit {}", self.program.version, self.program.commit)),
            ("machine", self.machine.clone()),
            ("configuration", format!("{}, SHA-256 {}", self.config, self.config_sha256)),
            ("arm", format!("{} at {}, {origin}", self.arm, self.target)),
            ("gateway", gateway.trim_start_matches("gateway: ").replace("\n  ", "; ")),
            ("operator", self.operator.to_owned()),
            ("moves", format!("axis {}, {} deg, at most {} rad/s", self.axis, self.by_deg, self.speed_rad_per_s)),
        ];
        text += "| | |\n|---|---|\n";
        for (key, value) in facts {
            text += &format!("| {key} | {} |\n", cell(&value));
        }
        text += "\n| step | | result |\n|---|---|---|\n";
        for step in &self.steps {
            text += &format!("| {} | {} | {} |\n", step.step.name(), step.title, step.result.word());
        }
        for step in &self.steps {
            text += &chapter(step);
        }
        text
    }
}

fn chapter(step: &StepReport) -> String {
    let mut text = format!("\n## {}: {}\n\n{}.\n", step.step.name(), step.result.word(), sentence(step.title));
    if let (Some(began), Some(monotonic_s)) = (&step.began, step.monotonic_s) {
        text +=
            &format!("Began {began} ({monotonic_s:.3} s on the clock of the program), took {:.1} s.\n", step.took_s);
    }
    for reason in &step.reasons {
        text += &format!("\n* {reason}");
    }
    if !step.reasons.is_empty() {
        text += "\n";
    }
    if !step.figures.is_empty() {
        text += "\n| figure | found | allowed | |\n|---|---|---|---|\n";
        for figure in &step.figures {
            let word = if figure.passed { "ok" } else { "NOT OK" };
            text += &format!("| {} | {} | {} | {word} |\n", figure.what, cell(&figure.found), figure.allowed);
        }
    }
    if !step.answers.is_empty() {
        text += "\n| question to the operator | answer |\n|---|---|\n";
        for answer in &step.answers {
            text += &format!("| {} | {} |\n", cell(&answer.question), if answer.yes { "yes" } else { "NO" });
        }
    }
    for note in &step.notes {
        text += &format!("\n* {note}");
    }
    for flight in &step.flights {
        text += &format!("\n* flight recorder: {flight}");
    }
    if !step.notes.is_empty() || !step.flights.is_empty() {
        text += "\n";
    }
    text
}

fn sentence(title: &str) -> String {
    let mut letters = title.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

/// Text for a table cell.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}
