//! Result of a step: figures with limits, answers, reasons.

use serde::Serialize;

use super::steps::Step;

/// Outcome of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// Every figure is within its limits, and every answer is yes.
    Passed,
    /// A figure is out of its limits, or an answer is no.
    Failed,
    /// Ended by a signal.
    Interrupted,
    /// Not run.
    Skipped,
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
#[derive(Clone, Debug, Serialize)]
pub struct StepReport {
    /// The step.
    pub step: Step,
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
    pub fn skipped(step: Step, reason: impl Into<String>) -> Self {
        let mut report = Self::begin(step);
        report.result = Outcome::Skipped;
        report.reasons.push(reason.into());
        report
    }

    /// A step that begins now.
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

impl Outcome {
    /// Name in tables.
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
                "the operator answered no: Has it stopped?"
            ]
        );
    }
}
