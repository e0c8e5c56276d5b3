//! The word list of plain English: words to avoid, and their replacements.

use anyhow::Context;

use crate::violation::Violation;
use crate::workspace::{SourceFile, Workspace};

/// Path of the list.
pub const LIST: &str = "xtask/plain-words.toml";

/// Extensions of the searched files.
const ENDINGS: [&str; 3] = [".rs", ".md", ".toml"];

/// One entry of the list.
struct Word {
    /// The word, in lower case.
    not: String,
    but: String,
    except: Vec<String>,
}

/// Reads the list, and searches all texts for its words.
///
/// # Errors
/// If the list is missing, is not TOML, or an entry lacks a key.
pub fn check(workspace: &Workspace, texts: &[SourceFile]) -> anyhow::Result<Vec<Violation>> {
    let list = std::fs::read_to_string(workspace.root().join(LIST)).with_context(|| format!("cannot read {LIST}"))?;
    let words = parse(&list).with_context(|| format!("in {LIST}"))?;
    let is_searched = |file: &&SourceFile| {
        ENDINGS.iter().any(|ending| file.path.ends_with(ending))
            && file.path != LIST
            && !file.path.starts_with("hal/vendor/")
    };
    Ok(words.iter().flat_map(|word| word.violations(texts.iter().filter(is_searched))).collect())
}

fn parse(list: &str) -> anyhow::Result<Vec<Word>> {
    let table: toml::Table = list.parse()?;
    let entries = table.get("word").and_then(toml::Value::as_array).context("[[word]] is missing")?;
    let text = |entry: &toml::Value, key: &str| {
        entry
            .get(key)
            .and_then(toml::Value::as_str)
            .map(str::to_owned)
            .with_context(|| format!("[[word]]: `{key}` is missing"))
    };
    let word = |entry: &toml::Value| {
        let except = entry.get("except").and_then(toml::Value::as_array).into_iter().flatten();
        let except = except.filter_map(|path| path.as_str().map(str::to_owned)).collect();
        Ok(Word { not: text(entry, "not")?, but: text(entry, "but")?, except })
    };
    entries.iter().map(word).collect()
}

impl Word {
    fn violations<'a>(&self, texts: impl Iterator<Item = &'a SourceFile>) -> Vec<Violation> {
        let mut violations = Vec::new();
        let mut unused = self.except.clone();
        for SourceFile { path, text } in texts {
            let lines = text.lines().enumerate().filter(|(_, line)| self.is_in(line));
            if self.except.contains(path) {
                if lines.count() > 0 {
                    unused.retain(|exception| exception != path);
                }
                continue;
            }
            let message = format!("`{}`: write {} ({LIST})", self.not, self.but);
            violations.extend(lines.map(|(index, _)| Violation::at(path, index + 1, "plain-words", message.clone())));
        }
        let stale = unused.iter().map(|path| {
            Violation::of(path, "plain-words", format!("has no `{}` any more: take it out of {LIST}", self.not))
        });
        violations.extend(stale);
        violations
    }

    /// Whether a line has the word as a whole word, or its plural; not after a hyphen (`hand-eye`).
    fn is_in(&self, line: &str) -> bool {
        let line = line.to_ascii_lowercase();
        line.match_indices(&self.not).any(|(at, _)| {
            let before = line[..at].chars().next_back();
            let rest = &line[at + self.not.len()..];
            let after = rest.strip_prefix('s').unwrap_or(rest).chars().next();
            let is_inside = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
            !is_inside(before) && before != Some('-') && !is_inside(after)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WORDS: &str = "[[word]]\nnot = \"eye\"\nbut = \"camera\"\nexcept = [\"a/crab.rs\", \"a/gone.rs\"]\n";

    fn file(path: &str, text: &str) -> SourceFile {
        SourceFile { path: path.to_owned(), text: text.to_owned() }
    }

    #[test]
    fn a_word_is_found_as_a_whole_one_and_its_exceptions_are_needed() {
        let words = parse(WORDS).unwrap();
        let texts = [
            file("a/b.rs", "// Both eyes.\nlet fisheye = 1;\n// A hand-eye calibration.\n// The Eye.\n"),
            file("a/crab.rs", "// The eye of a crab.\n"),
            file("a/gone.rs", "// Nothing.\n"),
        ];
        let found = words[0].violations(texts.iter());
        let places: Vec<_> = found.iter().map(|violation| violation.to_string()).collect();
        assert_eq!(places.len(), 3, "{places:?}");
        assert!(places[0].starts_with("a/b.rs:1:") && places[1].starts_with("a/b.rs:4:"), "{places:?}");
        assert!(places[2].contains("a/gone.rs") && places[2].contains("any more"), "{places:?}");
        assert!(parse("[[word]]\nnot = \"eye\"\n").is_err());
    }
}
