//! What came of a step: figures beside what is allowed, answers, reasons.

use serde::Serialize;

use super::steps::Step;

/// What came of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// Every figure is within its limits, every question answered with yes.
    Passed,
    /// Something is not.
    Failed,
    /// A signal ended it.
    Interrupted,
    /// It was not done.
    Skipped,
}

/// One figure.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// What was measured, or has to hold.
    pub what: String,
    /// What was found, with its unit.
    pub found: String,
    /// The number, where it is one.
    pub value: Option<f64>,
    /// What is allowed.
    pub allowed: String,
    /// The limit, where it is a number.
    pub limit: Option<f64>,
    /// Its unit.
    pub unit: &'static str,
    /// Whether it is as it has to be.
    pub passed: bool,
}

/// What the operator said.
#[derive(Clone, Debug, Serialize)]
pub struct Answer {
    /// What was asked.
    pub question: String,
    /// Whether he said yes.
    pub yes: bool,
}

/// One step.
#[derive(Clone, Debug, Serialize)]
pub struct StepReport {
    /// Which.
    pub step: Step,
    /// What it is.
    pub title: &'static str,
    /// What came of it.
    pub result: Outcome,
    /// Why not more.
    pub reasons: Vec<String>,
    /// When it began, UTC.
    pub began: Option<String>,
    /// When it began, seconds on the clock of the program, which stamps the flight recorders.
    pub monotonic_s: Option<f64>,
    /// How long it took.
    pub took_s: f64,
    /// In the order in which they were found.
    pub figures: Vec<Figure>,
    /// In the order in which they were given.
    pub answers: Vec<Answer>,
    /// What is worth knowing.
    pub notes: Vec<String>,
    /// Files of the flight recorders, where it failed.
    pub flights: Vec<String>,
}

impl StepReport {
    /// One that was not done.
    pub fn skipped(step: Step, reason: impl Into<String>) -> Self {
        let mut report = Self::begin(step);
        report.result = Outcome::Skipped;
        report.reasons.push(reason.into());
        report
    }

    /// One that begins.
    pub fn begin(step: Step) -> Self {
        Self {
            step,
            title: step.title(),
            result: Outcome::Passed,
            reasons: Vec::new(),
            began: None,
            monotonic_s: None,
            took_s: 0.0,
            figures: Vec::new(),
            answers: Vec::new(),
            notes: Vec::new(),
            flights: Vec::new(),
        }
    }

    /// A number that may be at most this.
    pub fn at_most(&mut self, what: impl Into<String>, value: f64, most: f64, unit: &'static str) {
        // What is no number is not within its limit.
        self.figure(what.into(), (value, unit), ("at most", most), value <= most);
    }

    /// A number that has to be at least this.
    pub fn at_least(&mut self, what: impl Into<String>, value: f64, least: f64, unit: &'static str) {
        self.figure(what.into(), (value, unit), ("at least", least), value >= least);
    }

    /// Something that has to hold, and how it was seen.
    pub fn holds(&mut self, what: impl Into<String>, passed: bool, found: impl Into<String>) {
        let (found, allowed) = (found.into(), "has to hold".to_owned());
        let (what, value, limit) = (what.into(), None, None);
        self.figures.push(Figure { what, found, value, allowed, limit, unit: "", passed });
    }

    /// Something worth knowing.
    pub fn note(&mut self, text: impl Into<String>) {
        self.notes.push(text.into());
    }

    /// What is not as it has to be.
    pub fn complaints(&self) -> Vec<String> {
        let figures = self.figures.iter().filter(|figure| !figure.passed);
        let figures = figures.map(|figure| format!("{}: {}, {}", figure.what, figure.found, figure.allowed));
        let answers = self.answers.iter().filter(|answer| !answer.yes);
        figures.chain(answers.map(|answer| format!("the operator says no: {}", answer.question))).collect()
    }

    fn figure(&mut self, what: String, (value, unit): (f64, &'static str), (word, limit): (&str, f64), passed: bool) {
        let (found, allowed) = (with_unit("", value, unit), with_unit(word, limit, unit));
        self.figures.push(Figure { what, found, value: Some(value), allowed, limit: Some(limit), unit, passed });
    }
}

/// A number with as many digits as an operator wants to read, between words.
fn with_unit(before: &str, value: f64, unit: &str) -> String {
    // Plus zero, so that nothing is minus zero.
    let rounded = (value * 1e4).round() / 1e4 + 0.0;
    let number = if value.is_infinite() { "never".to_owned() } else { format!("{rounded} {unit}") };
    format!("{before} {number}").trim().to_owned()
}

impl Outcome {
    /// For tables.
    pub fn word(self) -> &'static str {
        match self {
            Self::Passed => "passed",
            Self::Failed => "failed",
            Self::Interrupted => "interrupted",
            Self::Skipped => "not done",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_beyond_a_limit_or_no_number_is_complained_of() {
        let mut report = StepReport::begin(Step::Jog);
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
                "the operator says no: Has it stopped?"
            ]
        );
    }
}
