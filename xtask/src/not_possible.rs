//! Checks that a machine cannot run.

/// The machine lacks a requirement of a check; the check itself has not failed.
#[derive(Debug)]
pub struct NotPossible(String);

impl NotPossible {
    /// The error, with the missing requirement and the remedy.
    pub fn because(why: impl Into<String>) -> anyhow::Error {
        anyhow::Error::new(Self(why.into()))
    }
}

impl std::fmt::Display for NotPossible {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for NotPossible {}
