//! The report of a checklist, for people (Markdown) and for programs (JSON): of each step figures with limits, answers, reasons.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::Serialize;

use super::super::probe_report::GatewayFacts;

/// Outcome of a step, or of all steps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// Every figure is within its limits, and every answer is yes; every step has passed.
    #[default]
    Passed,
    /// All requested steps have passed, others were skipped.
    Incomplete,
    /// A figure is out of its limits, or an answer is no; a step has failed.
    Failed,
    /// Ended by a signal.
    Interrupted,
    /// Not run.
    Skipped,
}

impl Outcome {
    /// Overall result of these steps.
    pub fn of(steps: &[StepReport]) -> Self {
        let any = |outcome| steps.iter().any(|step| step.result == outcome);
        let worse = [Self::Failed, Self::Interrupted].into_iter().find(|outcome| any(*outcome));
        worse.unwrap_or(if any(Self::Skipped) { Self::Incomplete } else { Self::Passed })
    }

    /// Name in headings and tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Passed => "passed",
            Self::Incomplete => "incomplete",
            Self::Failed => "failed",
            Self::Interrupted => "interrupted",
            Self::Skipped => "not done",
        }
    }
}

/// One figure.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// Measured quantity or checked condition.
    pub what: String,
    /// Measured value with its unit, or the observation.
    pub found: String,
    /// The value, if numeric.
    pub value: Option<f64>,
    /// Allowed range.
    pub allowed: String,
    /// The limit, if numeric.
    pub limit: Option<f64>,
    /// Unit of value and limit.
    pub unit: &'static str,
    /// Whether the figure is within its limit.
    pub passed: bool,
}

/// Answer of the operator.
#[derive(Clone, Debug, Serialize)]
pub struct Answer {
    /// The question.
    pub question: String,
    /// Whether the answer is yes.
    pub yes: bool,
}

/// Report of one step.
#[derive(Clone, Debug, Default, Serialize)]
pub struct StepReport {
    /// Name of the step.
    pub step: &'static str,
    /// Description of the step.
    pub title: &'static str,
    /// Outcome.
    pub result: Outcome,
    /// Reasons for another outcome than passed.
    pub reasons: Vec<String>,
    /// Start time, UTC.
    pub began: Option<String>,
    /// Start time on the clock of the program, which stamps the flight recorders, seconds.
    pub monotonic_s: Option<f64>,
    /// Duration, seconds.
    pub took_s: f64,
    /// Figures, in order of measurement.
    pub figures: Vec<Figure>,
    /// Answers, in order.
    pub answers: Vec<Answer>,
    /// Further information.
    pub notes: Vec<String>,
    /// Flight recorder files of a failed step.
    pub flights: Vec<String>,
}

impl StepReport {
    /// A skipped step.
    pub fn skipped(step: &'static str, title: &'static str, reason: impl Into<String>) -> Self {
        Self { result: Outcome::Skipped, reasons: vec![reason.into()], ..Self::begin(step, title) }
    }

    /// A step that begins now.
    pub fn begin(step: &'static str, title: &'static str) -> Self {
        Self { step, title, ..Self::default() }
    }

    /// A figure with an upper limit.
    pub fn at_most(&mut self, what: impl Into<String>, value: f64, most: f64, unit: &'static str) {
        // NaN is not within a limit.
        self.figure(what.into(), (value, unit), ("at most", most), value <= most);
    }

    /// A figure with a lower limit.
    pub fn at_least(&mut self, what: impl Into<String>, value: f64, least: f64, unit: &'static str) {
        self.figure(what.into(), (value, unit), ("at least", least), value >= least);
    }

    /// A condition, with the observation.
    pub fn holds(&mut self, what: impl Into<String>, passed: bool, found: impl Into<String>) {
        let (found, allowed) = (found.into(), "has to hold".to_owned());
        let (what, value, limit) = (what.into(), None, None);
        self.figures.push(Figure { what, found, value, allowed, limit, unit: "", passed });
    }

    /// A refusal; what was not refused was `accepted`.
    pub fn refused<T, E: ToString>(&mut self, what: &str, asked: &Result<T, E>, accepted: &str) {
        let found = asked.as_ref().map_or_else(ToString::to_string, |_| accepted.to_owned());
        self.holds(what, asked.is_err(), found);
    }

    /// Adds information.
    pub fn note(&mut self, text: impl Into<String>) {
        self.notes.push(text.into());
    }

    /// Figures and answers that did not pass.
    pub fn complaints(&self) -> Vec<String> {
        let figures = self.figures.iter().filter(|figure| !figure.passed);
        let figures = figures.map(|figure| format!("{}: {}, {}", figure.what, figure.found, figure.allowed));
        let answers = self.answers.iter().filter(|answer| !answer.yes);
        figures.chain(answers.map(|answer| format!("the operator answered no: {}", answer.question))).collect()
    }

    fn figure(&mut self, what: String, (value, unit): (f64, &'static str), (word, limit): (&str, f64), passed: bool) {
        let (found, allowed) = (with_unit("", value, unit), with_unit(word, limit, unit));
        self.figures.push(Figure { what, found, value: Some(value), allowed, limit: Some(limit), unit, passed });
    }
}

/// A number with its unit, rounded for an operator.
fn with_unit(before: &str, value: f64, unit: &str) -> String {
    // Adding zero removes the sign of minus zero.
    let rounded = (value * 1e4).round() / 1e4 + 0.0;
    let number = if value.is_infinite() { "never".to_owned() } else { format!("{rounded} {unit}") };
    format!("{before} {number}").trim().to_owned()
}

/// A test of one arm.
#[derive(Debug, Serialize)]
pub struct TestReport {
    /// Version of the report format.
    pub format: u32,
    /// Overall result.
    pub result: Outcome,
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
            text += &format!("| {} | {} | {} |\n", step.step, step.title, step.result.word());
        }
        for step in &self.steps {
            text += &chapter(step);
        }
        text
    }
}

fn chapter(step: &StepReport) -> String {
    let mut text = format!("\n## {}: {}\n\n{}.\n", step.step, step.result.word(), sentence(step.title));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_beyond_a_limit_or_no_number_is_complained_of() {
        let mut report = StepReport::begin("jog", "one axis");
        report.at_most("a", 1.0, 1.0, "deg");
        report.at_least("b", 2.0, 1.0, "");
        report.holds("c", true, "so it is");
        assert!(report.complaints().is_empty());
        report.at_most("d", 1.000_1, 1.0, "deg");
        report.at_least("e", 0.5, 1.0, "messages");
        report.at_most("f", f64::NAN, 1.0, "ms");
        report.at_most("g", f64::INFINITY, 1.0, "ms");
        report.holds("h", false, "it is not");
        report.answers.push(Answer { question: "Has it stopped?".into(), yes: false });
        assert_eq!(
            report.complaints(),
            [
                "d: 1.0001 deg, at most 1 deg",
                "e: 0.5 messages, at least 1 messages",
                "f: NaN ms, at most 1 ms",
                "g: never, at most 1 ms",
                "h: it is not, has to hold",
                "the operator answered no: Has it stopped?"
            ]
        );
    }
}
