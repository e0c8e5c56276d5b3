//! The word list of plain English: words to avoid, in texts and as parts of names, and their replacements.

use anyhow::Context;

use crate::rust_text::code_only;
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

/// A word that is no part of a name in the code: `note_told` and `ToldOnce` have the part `told`.
struct NamePart {
    /// The part, in lower case.
    not: String,
    but: String,
    /// Folders in which the rule holds; empty: all. `word` is a term for a status word and for 32 bits, but not for a command.
    folders: Vec<String>,
    /// Names outside our choice, such as recorded fields, each as `name in folder`.
    except: Vec<String>,
}

/// Reads the list, and searches all texts for its words, and all code for names with its parts.
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
    let parts = parse_parts(&list).with_context(|| format!("in {LIST}"))?;
    let mut violations: Vec<_> =
        words.iter().flat_map(|word| word.violations(texts.iter().filter(is_searched))).collect();
    violations.extend(violations_of_names(&parts, texts.iter().filter(is_searched)));
    Ok(violations)
}

fn parse(list: &str) -> anyhow::Result<Vec<Word>> {
    let word = |entry: &toml::Value| {
        Ok(Word { not: text(entry, "not")?, but: text(entry, "but")?, except: texts(entry, "except") })
    };
    entries(list, "word")?.iter().map(word).collect()
}

fn parse_parts(list: &str) -> anyhow::Result<Vec<NamePart>> {
    let part = |entry: &toml::Value| {
        let (not, but) = (text(entry, "not")?, text(entry, "but")?);
        Ok(NamePart { not, but, folders: texts(entry, "folders"), except: texts(entry, "except") })
    };
    entries(list, "name")?.iter().map(part).collect()
}

fn entries(list: &str, kind: &str) -> anyhow::Result<Vec<toml::Value>> {
    let table: toml::Table = list.parse()?;
    let entries = table.get(kind).and_then(toml::Value::as_array);
    Ok(entries.with_context(|| format!("[[{kind}]] is missing"))?.clone())
}

fn text(entry: &toml::Value, key: &str) -> anyhow::Result<String> {
    let text = entry.get(key).and_then(toml::Value::as_str).map(str::to_owned);
    text.with_context(|| format!("an entry has no `{key}`"))
}

fn texts(entry: &toml::Value, key: &str) -> Vec<String> {
    let values = entry.get(key).and_then(toml::Value::as_array).into_iter().flatten();
    values.filter_map(|value| value.as_str().map(str::to_owned)).collect()
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

/// Names in Rust code, and names of its files, that have one of the parts.
fn violations_of_names<'a>(parts: &[NamePart], texts: impl Iterator<Item = &'a SourceFile>) -> Vec<Violation> {
    let mut violations = Vec::new();
    let mut unused: Vec<_> = parts.iter().flat_map(|part| part.except.iter().map(move |name| (part, name))).collect();
    for SourceFile { path, text } in texts.filter(|file| file.path.ends_with(".rs")) {
        let code = code_only(text);
        let stem = path.rsplit('/').next().unwrap_or(path).trim_end_matches(".rs");
        let names =
            code.lines().enumerate().flat_map(|(index, line)| names_in(line).map(move |name| (index + 1, name)));
        for (line, name) in std::iter::once((1, stem)).chain(names) {
            let Some(part) = parts.iter().find(|part| part.is_in(path, name)) else { continue };
            if let Some(exception) = part.exception(path, name) {
                unused.retain(|(_, other)| *other != exception);
                continue;
            }
            let message = format!("`{name}`: not `{}` in a name, but {} ({LIST})", part.not, part.but);
            violations.push(Violation::at(path, line, "plain-words", message));
        }
    }
    let stale = unused.iter().map(|(part, name)| {
        let message = format!("`{}`: no code has the exception `{name}` any more", part.not);
        Violation::of(LIST, "plain-words", message)
    });
    violations.extend(stale);
    violations
}

/// The names and keywords of a line of code.
fn names_in(line: &str) -> impl Iterator<Item = &str> {
    let parts = line.split(|c: char| !c.is_alphanumeric() && c != '_');
    parts.filter(|name| !name.is_empty() && !name.starts_with(|c: char| c.is_ascii_digit()))
}

/// The parts of a name in lower case: `SeenPose2D`, `seen_pose` and `SEEN_POSE` have the parts `seen` and `pose`.
fn parts_of(name: &str) -> Vec<String> {
    let mut parts = Vec::new();
    for piece in name.split('_') {
        let letters: Vec<char> = piece.chars().collect();
        let mut part = String::new();
        for (index, &letter) in letters.iter().enumerate() {
            let after_small = index > 0 && !letters[index - 1].is_uppercase();
            let before_small = letters.get(index + 1).is_some_and(|next| next.is_lowercase());
            if letter.is_uppercase() && (after_small || before_small) {
                parts.push(std::mem::take(&mut part));
            }
            part.extend(letter.to_lowercase());
        }
        parts.push(part);
    }
    parts
}

impl NamePart {
    fn is_in(&self, path: &str, name: &str) -> bool {
        let holds = self.folders.is_empty() || self.folders.iter().any(|folder| path.starts_with(folder.as_str()));
        holds && parts_of(name).contains(&self.not)
    }

    /// The exception that permits a name in a file.
    fn exception(&self, path: &str, name: &str) -> Option<&String> {
        let permits = |exception: &&String| {
            exception.split_once(" in ").is_some_and(|(known, folder)| known == name && path.starts_with(folder))
        };
        self.except.iter().find(permits)
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

    #[test]
    fn a_part_of_a_name_is_found_between_underscores_and_capitals() {
        for name in ["note_told", "told", "ToldOnce", "TOLD_EVERY", "isTold", "HTTPTold"] {
            assert!(parts_of(name).contains(&"told".to_owned()), "{name}: {:?}", parts_of(name));
        }
        for name in ["untold", "toldest", "Mantold", "x"] {
            assert!(!parts_of(name).contains(&"told".to_owned()), "{name}: {:?}", parts_of(name));
        }
    }

    #[test]
    fn only_names_in_code_and_of_files_count_in_the_folders_of_the_rule() {
        let list = "[[name]]\nnot = \"told\"\nbut = \"reported\"\nexcept = [\"told_at in a/\", \"told_never in a/\"]\n\n\
                    [[name]]\nnot = \"word\"\nbut = \"command\"\nfolders = [\"a/\"]\n";
        let parts = parse_parts(list).unwrap();
        let texts = [
            file("a/b.rs", "// told, a word\nlet told_at = \"told\"; // told\nlet x = is_told(word);\n"),
            file("b/told.rs", "let word = told_at;\n"),
            file("b/c.md", "is_told\n"),
        ];
        let found: Vec<_> =
            violations_of_names(&parts, texts.iter()).iter().map(|violation| violation.to_string()).collect();
        assert_eq!(found.len(), 5, "{found:?}");
        assert!(found[0].starts_with("a/b.rs:3:") && found[0].contains("`is_told`"), "{found:?}");
        assert!(found[1].starts_with("a/b.rs:3:") && found[1].contains("`word`"), "{found:?}");
        assert!(found[2].starts_with("b/told.rs:1:"), "{found:?}");
        assert!(found[3].contains("`told_at`") && found[4].contains("told_never in a/"), "{found:?}");
    }
}
