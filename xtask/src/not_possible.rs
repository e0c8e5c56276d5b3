//! What a machine cannot do.

/// The machine lacks what a check needs: nothing is wrong with what it checks.
#[derive(Debug)]
pub struct NotPossible(String);

impl NotPossible {
    /// The error, with what is missing and what to do.
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
