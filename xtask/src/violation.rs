//! Violations of the rules of a check.

use std::fmt;

/// One violation.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Violation {
    /// Path inside the workspace, with slashes.
    pub file: String,
    /// Line from 1; 0 stands for the whole file.
    pub line: usize,
    /// Short name of the rule.
    pub rule: &'static str,
    /// The problem and the remedy.
    pub message: String,
}

impl Violation {
    /// A violation at one line.
    pub fn at(file: &str, line: usize, rule: &'static str, message: impl Into<String>) -> Self {
        Self { file: file.to_owned(), line, rule, message: message.into() }
    }

    /// A violation of a whole file.
    pub fn of(file: &str, rule: &'static str, message: impl Into<String>) -> Self {
        Self::at(file, 0, rule, message)
    }
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.line == 0 {
            write!(f, "{}: [{}] {}", self.file, self.rule, self.message)
        } else {
            write!(f, "{}:{}: [{}] {}", self.file, self.line, self.rule, self.message)
        }
    }
}

/// Prints the violations in order of their positions, and fails if there are any.
///
/// # Errors
/// If there is at least one violation; `checked` lists the checked items.
pub fn conclude(command: &str, checked: &str, mut violations: Vec<Violation>) -> anyhow::Result<()> {
    violations.sort();
    violations.dedup();
    for violation in &violations {
        eprintln!("{violation}");
    }
    if violations.is_empty() {
        println!("{command}: {checked}: no violations");
        return Ok(());
    }
    anyhow::bail!("{command}: {} violations (see the rules in CONTRIBUTING.md)", violations.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_violation_fails_and_none_passes() {
        assert!(conclude("tidy", "0 files", Vec::new()).is_ok());
        assert!(conclude("tidy", "1 file", vec![Violation::of("a.rs", "file-length", "700 lines")]).is_err());
    }

    #[test]
    fn a_violation_prints_as_a_place_an_editor_can_open() {
        let violation = Violation::at("crates/a/src/lib.rs", 7, "todo", "left over");
        assert_eq!(violation.to_string(), "crates/a/src/lib.rs:7: [todo] left over");
    }
}
