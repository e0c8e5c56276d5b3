//! Markdown: one sentence per line, so that a change of one sentence is a change of one line.
//!
//! Headings, tables, code and HTML are ignored, and doubtful cases pass.

use crate::violation::Violation;

const ABBREVIATIONS: [&str; 13] =
    ["e.g.", "i.e.", "etc.", "vs.", "cf.", "Fig.", "Figs.", "eq.", "eqs.", "No.", "Dr.", "St.", "et al."];

/// Checks one file.
pub fn check(path: &str, text: &str) -> Vec<Violation> {
    let mut violations = Vec::new();
    let mut in_code = false;
    let mut previous = "";
    for (index, line) in text.lines().enumerate() {
        let line_text = line.trim();
        if line_text.starts_with("```") || line_text.starts_with("~~~") {
            in_code = !in_code;
            previous = "";
            continue;
        }
        if in_code || !is_prose(line_text) {
            previous = "";
            continue;
        }
        if let Some(second) = second_sentence(line_text) {
            let message = format!("a second sentence starts at \"{second}\": start a new line");
            violations.push(Violation::at(path, index + 1, "one-sentence-per-line", message));
        }
        if breaks_inside_sentence(previous, line_text) {
            violations.push(Violation::at(
                path,
                index + 1,
                "one-sentence-per-line",
                "continues the line above: join the lines",
            ));
        }
        previous = line_text;
    }
    violations
}

fn is_prose(line: &str) -> bool {
    !line.is_empty() && !line.starts_with(['#', '|', '<', '!']) && !line.starts_with("    ")
}

/// The first words of a sentence that starts within the line.
fn second_sentence(line: &str) -> Option<String> {
    let line = without_code_spans(line);
    for (at, mark) in line.match_indices(['.', '!', '?']) {
        let (before, after) = (&line[..at + mark.len()], &line[at + mark.len()..]);
        let after = after.trim_start_matches([')', '"', '*', '_']);
        let Some(next) = after.strip_prefix(' ') else { continue };
        let starts_sentence = next.trim_start_matches(['*', '_', '"', '(']).starts_with(|c: char| c.is_uppercase());
        let ends_sentence = before[..at].ends_with(|c: char| c.is_lowercase() || ")`\"*_".contains(c));
        let is_abbreviation = ABBREVIATIONS.iter().any(|abbreviation| before.ends_with(abbreviation));
        if starts_sentence && ends_sentence && !is_abbreviation {
            return Some(next.chars().take(30).collect());
        }
    }
    None
}

/// The line with the text of code spans replaced by `x`.
fn without_code_spans(line: &str) -> String {
    let mut parts = line.split('`');
    let mut kept = parts.next().unwrap_or_default().to_owned();
    for (index, part) in parts.enumerate() {
        kept.push('`');
        if index % 2 == 0 { kept.extend(part.chars().map(|_| 'x')) } else { kept.push_str(part) }
    }
    kept
}

fn breaks_inside_sentence(previous: &str, line: &str) -> bool {
    let open = previous.ends_with(|c: char| c.is_alphanumeric() || c == ',');
    open && line.starts_with(|c: char| c.is_lowercase())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_sentences_on_a_line_are_caught() {
        assert_eq!(check("a.md", "This is one. This is two.").len(), 1);
        assert_eq!(check("a.md", "* A list item says `so`. And more.").len(), 1);
    }

    #[test]
    fn a_sentence_broken_over_two_lines_is_caught() {
        assert_eq!(check("a.md", "This goes on,\nand on.").len(), 1);
        assert!(check("a.md", "This ends.\n\nand this is its own paragraph").is_empty());
    }

    #[test]
    fn doubtful_cases_pass() {
        for text in [
            "See Fig. 7 and eq. (8), e.g. Middlebury.",
            "| A cell. Another sentence. |",
            "# A heading. Still a heading.",
            "```\nOne. Two.\n```",
            "The file `a. B` is 0.5 mm long (see 3. Above).",
            "Version 1.2 Beta is not a sentence.",
        ] {
            assert_eq!(check("a.md", text), [], "{text}");
        }
    }
}
