//! Tests and other items that documents name as `file.rs::name` exist.

use crate::rust_text::word_positions;
use crate::violation::Violation;
use crate::workspace::SourceFile;

/// Checks the names between backticks in all documents but the history.
pub fn check(texts: &[SourceFile]) -> Vec<Violation> {
    let documents = texts.iter().filter(|file| file.path.ends_with(".md") && file.path != "CHANGELOG.md");
    let lines =
        documents.flat_map(|file| file.text.lines().enumerate().map(move |(index, line)| (file, index + 1, line)));
    let mut violations = Vec::new();
    for (document, number, line) in lines {
        for quoted in line.split('`').skip(1).step_by(2) {
            let Some((path, name)) = quoted.split_once(".rs::").map(|(path, name)| (format!("{path}.rs"), name)) else {
                continue;
            };
            let item = name.rsplit("::").next().unwrap_or(name);
            let is_there = |file: &SourceFile| {
                (file.path == path || file.path.ends_with(&format!("/{path}"))) && defines(&file.text, item)
            };
            if !texts.iter().any(is_there) {
                let message = format!("{path} has no {item}: name the test that shows this now");
                violations.push(Violation::at(&document.path, number, "named-item", message));
            }
        }
    }
    violations
}

/// Whether a Rust text defines an item or a variant of this name.
fn defines(text: &str, item: &str) -> bool {
    let kinds = ["fn ", "struct ", "enum ", "const ", "trait "];
    word_positions(text, item).any(|at| kinds.iter().any(|kind| text[..at].ends_with(kind)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_without_its_test_is_caught() {
        let file = |path: &str, text: &str| SourceFile { path: path.to_owned(), text: text.to_owned() };
        for (line, is_true) in [
            ("| host | `hal/a/tests/stop.rs::it_stops` |", true),
            ("| host | `stop.rs::it_stops` |", true),
            ("| host | `hal/a/tests/stop.rs::it_stop` |", false),
            ("| host | `hal/b/tests/stop.rs::it_stops` |", false),
        ] {
            let found =
                check(&[file("hal/a/tests/stop.rs", "#[test]\nfn it_stops() {}\n"), file("docs/safety.md", line)]);
            assert_eq!(found.is_empty(), is_true, "{line}");
        }
    }
}
