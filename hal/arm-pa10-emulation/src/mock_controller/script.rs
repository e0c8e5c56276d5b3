//! Times of faults: absolute, relative or random.

use std::time::Duration;

use super::fault::Fault;
use super::words::{LineError, Words};

/// One line: a fault and its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScriptLine {
    /// Time of the fault.
    pub when: When,
    /// The fault.
    pub fault: Fault,
}

/// Time of a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum When {
    /// At once.
    Now,
    /// This time after the line was given.
    In(Duration),
    /// This time after the controller was created.
    At(Duration),
    /// At each message that is answered, with this probability.
    Chance {
        /// 0 to 1.
        probability: f64,
        /// Maximum number of consecutive messages.
        at_most_in_a_row: Option<u32>,
    },
}

/// A text of such lines, checked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script {
    /// In the order of the text.
    pub lines: Vec<ScriptLine>,
}

/// Which line of a script is invalid, and why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {error}")]
pub struct ScriptError {
    /// Number of the line, from 1.
    pub line: usize,
    /// The error.
    pub error: LineError,
}

impl ScriptLine {
    /// The content of a line: `None` if it is empty or a comment.
    ///
    /// # Errors
    /// Names the wrong word and the allowed ones.
    pub fn parse(text: &str) -> Result<Option<Self>, LineError> {
        let mut words = Words::new(text);
        let Some(first) = words.peek() else { return Ok(None) };
        let when = match first {
            "at" | "in" => {
                words.skip();
                let time = words.duration("the time")?;
                if first == "at" { When::At(time) } else { When::In(time) }
            }
            "chance" => {
                words.skip();
                let probability = words.take("the chance", "a part such as 1% of messages, 0% to 100%", percent)?;
                let at_most_in_a_row = match words.peek() {
                    Some("at-most") => {
                        words.skip();
                        Some(words.count("the number of messages in a row")?)
                    }
                    _ => None,
                };
                When::Chance { probability, at_most_in_a_row }
            }
            _ => When::Now,
        };
        Ok(Some(Self { when, fault: words.fault()? }))
    }
}

impl Script {
    /// A script from its text: one fault per line, `#` begins a comment.
    ///
    /// # Errors
    /// Names the first invalid line.
    pub fn parse(text: &str) -> Result<Self, ScriptError> {
        let mut lines = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let parsed = ScriptLine::parse(line).map_err(|error| ScriptError { line: index + 1, error })?;
            lines.extend(parsed);
        }
        Ok(Self { lines })
    }
}

impl std::fmt::Display for ScriptLine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.when {
            When::Now => {}
            When::In(time) => write!(f, "in {time:?} ")?,
            When::At(time) => write!(f, "at {time:?} ")?,
            When::Chance { probability, at_most_in_a_row } => {
                write!(f, "chance {}% ", probability * 100.0)?;
                if let Some(most) = at_most_in_a_row {
                    write!(f, "at-most {most} ")?;
                }
            }
        }
        write!(f, "{}", self.fault)
    }
}

fn percent(word: &str) -> Option<f64> {
    let percent: f64 = word.strip_suffix('%')?.parse().ok()?;
    (0.0..=100.0).contains(&percent).then_some(percent / 100.0)
}
