//! The list of files and functions that are longer than the rule allows.

use anyhow::Context;

use crate::violation::Violation;
use crate::workspace::Workspace;

/// Path of the list.
pub const LIST: &str = "xtask/tidy-exceptions.toml";

/// One entry: a file, or a function in it, that may have up to `lines_max` lines.
struct Exception {
    path: String,
    function: Option<String>,
    lines_max: usize,
    used: bool,
}

/// All entries.
#[derive(Default)]
pub struct Exceptions {
    entries: Vec<Exception>,
}

impl Exceptions {
    /// Reads the list.
    ///
    /// # Errors
    /// If it is missing, is not TOML, or an entry lacks a key.
    pub fn load(workspace: &Workspace) -> anyhow::Result<Self> {
        let text =
            std::fs::read_to_string(workspace.root().join(LIST)).with_context(|| format!("cannot read {LIST}"))?;
        Self::parse(&text).with_context(|| format!("in {LIST}"))
    }

    fn parse(text: &str) -> anyhow::Result<Self> {
        let table: toml::Table = text.parse()?;
        let mut entries = Vec::new();
        for kind in ["file", "function"] {
            for entry in table.get(kind).and_then(toml::Value::as_array).into_iter().flatten() {
                entries.push(Exception::parse(entry, kind == "function").with_context(|| format!("[[{kind}]]"))?);
            }
        }
        Ok(Self { entries })
    }

    /// Allowed lines of the file, or of the function in it; `usual` if it is not on the list.
    pub fn lines_max(&mut self, path: &str, function: Option<&str>, lines: usize, usual: usize) -> usize {
        if lines <= usual {
            return usual;
        }
        let listed = self.entries.iter_mut().find(|e| e.path == path && e.function.as_deref() == function);
        listed.map_or(usual, |entry| {
            entry.used = true;
            entry.lines_max
        })
    }

    /// Entries that are not needed.
    pub fn unused(&self) -> Vec<Violation> {
        let stale = self.entries.iter().filter(|entry| !entry.used);
        stale
            .map(|entry| {
                let what = entry.function.as_deref().unwrap_or("the file");
                let message = format!("{what} in {} is short enough or does not exist: remove the entry", entry.path);
                Violation::of(LIST, "stale-exception", message)
            })
            .collect()
    }
}

impl Exception {
    fn parse(entry: &toml::Value, is_function: bool) -> anyhow::Result<Self> {
        let text = |key: &str| -> anyhow::Result<String> {
            let value = entry.get(key).and_then(toml::Value::as_str).with_context(|| format!("`{key}` is missing"))?;
            Ok(value.to_owned())
        };
        let lines_max = entry.get("lines_max").and_then(toml::Value::as_integer).context("`lines_max` is missing")?;
        text("reason")?;
        Ok(Self {
            path: text("path")?,
            function: is_function.then(|| text("name")).transpose()?,
            lines_max: usize::try_from(lines_max).context("`lines_max` is negative")?,
            used: false,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: &str = "[[function]]\npath = \"a.rs\"\nname = \"f\"\nlines_max = 90\nreason = \"a table\"\n";

    #[test]
    fn a_listed_function_may_be_long_but_not_longer() {
        let mut list = Exceptions::parse(ONE).expect("valid");
        assert_eq!(list.lines_max("a.rs", Some("f"), 85, 70), 90);
        assert_eq!(list.lines_max("a.rs", Some("g"), 85, 70), 70);
        assert_eq!(list.lines_max("a.rs", None, 700, 600), 600);
        assert!(list.unused().is_empty());
    }

    #[test]
    fn an_entry_that_is_not_needed_must_go() {
        let mut list = Exceptions::parse(ONE).expect("valid");
        assert_eq!(list.lines_max("a.rs", Some("f"), 60, 70), 70);
        assert_eq!(list.unused().len(), 1);
    }

    #[test]
    fn an_entry_needs_a_reason() {
        let text = ONE.replace("reason", "because");
        assert!(Exceptions::parse(&text).is_err());
    }
}
