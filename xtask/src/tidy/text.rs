//! Rules for every text file: no paths of one machine, no paths outside the repository, no nameless reminders.

use crate::violation::Violation;

/// First folders of absolute paths that exist on one machine only. Written in halves, so that this file obeys its own rule.
const MACHINE_FOLDERS: [&str; 6] = [
    concat!("/wo", "rk/"),
    concat!("/ro", "ot/"),
    concat!("/ho", "me/"),
    concat!("/Us", "ers/"),
    concat!("/tm", "p/"),
    concat!(":\\Us", "ers\\"),
];
const OUTSIDE: &str = concat!("../sha", "red");
const REMINDERS: [&str; 2] = [concat!("TO", "DO"), concat!("FIX", "ME")];

/// All rules for one file.
pub fn check(path: &str, text: &str) -> Vec<Violation> {
    let mut violations = Vec::new();
    for (index, line) in text.lines().enumerate() {
        if let Some(folder) = machine_folder(line) {
            let message = format!("`{folder}...` exists on one machine only; use a path inside the repository");
            violations.push(Violation::at(path, index + 1, "machine-path", message));
        }
        if line.contains(OUTSIDE) {
            let message = format!("`{OUTSIDE}` is outside the repository: remove the dependency on it");
            violations.push(Violation::at(path, index + 1, "outside-path", message));
        }
        if let Some(word) = nameless_reminder(line) {
            let message = format!("`{word}` without (name, issue): do it, or open an issue and give its number");
            violations.push(Violation::at(path, index + 1, "nameless-reminder", message));
        }
    }
    violations
}

fn machine_folder(line: &str) -> Option<&'static str> {
    let starts_a_path = |at: usize| {
        let before = line[..at].chars().next_back();
        !before.is_some_and(|c| c.is_alphanumeric() || "._-~}>*".contains(c))
    };
    MACHINE_FOLDERS.into_iter().find(|folder| {
        let drive = folder.starts_with(':');
        line.match_indices(folder).any(|(at, _)| drive || starts_a_path(at))
    })
}

fn nameless_reminder(line: &str) -> Option<&'static str> {
    REMINDERS.into_iter().find(|word| {
        line.match_indices(word).any(|(at, _)| {
            let inside_word = line[..at].chars().next_back().is_some_and(|c| c.is_alphanumeric() || c == '_');
            let rest = &line[at + word.len()..];
            let inside_word = inside_word || rest.starts_with(|c: char| c.is_alphanumeric() || c == '_');
            !inside_word && !is_named(rest)
        })
    })
}

/// Whether the text continues as `(name, issue)`.
fn is_named(rest: &str) -> bool {
    let Some((inner, _)) = rest.strip_prefix('(').and_then(|rest| rest.split_once(')')) else { return false };
    let parts: Vec<&str> = inner.split(',').map(str::trim).collect();
    parts.len() == 2 && parts.iter().all(|part| !part.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(text: &str) -> Vec<&'static str> {
        check("a.md", text).into_iter().map(|v| v.rule).collect()
    }

    #[test]
    fn machine_paths_are_caught() {
        for folder in MACHINE_FOLDERS {
            assert_eq!(rules(&format!("see `{folder}x/y`")), ["machine-path"], "{folder}");
        }
        assert!(
            rules(&format!("https://example.org{}page and ~{}x", MACHINE_FOLDERS[2], MACHINE_FOLDERS[0])).is_empty()
        );
    }

    #[test]
    fn paths_out_of_the_repository_are_caught() {
        assert_eq!(rules(&format!("let p = \"{OUTSIDE}/data\";")), ["outside-path"]);
    }

    #[test]
    fn reminders_need_a_name_and_an_issue() {
        let word = REMINDERS[0];
        assert_eq!(rules(&format!("// {word}: later")), ["nameless-reminder"]);
        assert_eq!(rules(&format!("// {word}(ann): later")), ["nameless-reminder"]);
        assert_eq!(rules(&format!("// {}", REMINDERS[1])), ["nameless-reminder"]);
        assert!(rules(&format!("// {word}(ann, #12): later, and {word}S is a word")).is_empty());
    }
}
