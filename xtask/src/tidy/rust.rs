//! Rules for Rust files beside the lints of clippy: purpose and length of a file, and tests that prove nothing.

use crate::rust_text::{code_only, line_at, word_positions};
use crate::violation::Violation;

const FILE_LINES_MAX: usize = 600;

/// All rules for one file.
pub fn check(path: &str, text: &str) -> Vec<Violation> {
    let mut violations = test_attributes(path, &code_only(text));
    // What bindgen has made is not edited.
    if path.starts_with("hal/vendor/") {
        return violations;
    }
    if !text.starts_with("//!") {
        violations.push(Violation::of(path, "first-line", "begin with `//!` and what the file is for"));
    }
    let lines = text.lines().count();
    if lines > FILE_LINES_MAX {
        let message = format!("{lines} lines, at most {FILE_LINES_MAX}: split it by topic");
        violations.push(Violation::of(path, "file-length", message));
    }
    violations
}

fn test_attributes(path: &str, code: &str) -> Vec<Violation> {
    let mut violations = Vec::new();
    for (at, _) in code.match_indices("#[") {
        let attribute = code[at + 2..].split(']').next().unwrap_or_default();
        let names = |word: &str| word_positions(attribute, word).next().is_some();
        let is_test_switch = attribute.starts_with("ignore") || attribute.starts_with("cfg_attr");
        if is_test_switch && names("ignore") {
            let message = "an ignored test proves nothing: make it run, or remove it";
            violations.push(Violation::at(path, line_at(code, at), "ignored-test", message));
        }
        if names("should_panic") {
            let message = "check the returned error, or catch the panic around the one call that must panic";
            violations.push(Violation::at(path, line_at(code, at), "should-panic", message));
        }
    }
    violations
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(text: &str) -> Vec<&'static str> {
        check("a.rs", &format!("//! A file.\n{text}")).into_iter().map(|v| v.rule).collect()
    }

    #[test]
    fn a_file_without_its_purpose_is_caught() {
        assert_eq!(check("a.rs", "use b;\n//! A file.\n").len(), 1);
        assert!(check("hal/vendor/a.rs", "use b;\n").is_empty() && rules("use b;\n").is_empty());
    }

    #[test]
    fn a_long_file_is_caught() {
        assert!(rules(&"// x\n".repeat(599)).is_empty());
        assert_eq!(rules(&"// x\n".repeat(600)), ["file-length"]);
        assert!(check("hal/vendor/a.rs", &"// x\n".repeat(601)).is_empty());
    }

    #[test]
    fn tests_that_do_not_test_are_caught() {
        assert_eq!(rules("#[test]\n#[ignore = \"slow\"]\nfn f() {}"), ["ignored-test"]);
        assert_eq!(rules("#[cfg_attr(miri, ignore)]\nfn f() {}"), ["ignored-test"]);
        assert_eq!(rules("#[test]\n#[should_panic(expected = \"x\")]\nfn f() {}"), ["should-panic"]);
        assert!(rules("#[must_use]\n#[serde(ignore_unknown)]\nfn ignore() {}").is_empty());
    }
}
