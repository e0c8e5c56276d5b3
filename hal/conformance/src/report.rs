//! The results of a suite.

use std::fmt;

/// A contract rule that a backend breaks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// Name of the rule, as the suite's documentation lists it.
    pub rule: &'static str,
    /// What was expected and what was found.
    pub found: String,
}

/// All broken rules; empty if the backend fulfils the contract.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Report {
    subject: String,
    violations: Vec<Violation>,
}

impl Report {
    pub(crate) fn new(subject: &str) -> Self {
        Self { subject: subject.to_owned(), violations: Vec::new() }
    }

    /// Records a violation unless `holds`; `found` is only evaluated then. Returns `holds`.
    pub(crate) fn check(&mut self, rule: &'static str, holds: bool, found: impl FnOnce() -> String) -> bool {
        if !holds {
            self.violations.push(Violation { rule, found: found() });
        }
        holds
    }

    /// Whether no rule is broken.
    pub fn passed(&self) -> bool {
        self.violations.is_empty()
    }

    /// The broken rules, in the order of detection; a rule may be broken more than once.
    pub fn violations(&self) -> &[Violation] {
        &self.violations
    }

    /// Whether the rule of this name is broken.
    pub fn breaks(&self, rule: &str) -> bool {
        self.violations.iter().any(|violation| violation.rule == rule)
    }

    /// For tests.
    ///
    /// # Panics
    /// If a rule is broken, with all of them.
    #[track_caller]
    pub fn assert_passed(&self) {
        assert!(self.passed(), "{self}");
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.passed() {
            return write!(f, "{}: keeps the contract", self.subject);
        }
        write!(f, "{}: breaks the contract", self.subject)?;
        for violation in &self.violations {
            write!(f, "\n  {}: {}", violation.rule, violation.found)?;
        }
        Ok(())
    }
}
