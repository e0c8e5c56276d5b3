//! Size of the estimation's interface: counts the public items of its entry.

use crate::rust_text::{code_only, line_at, without_test_items, word_positions};
use crate::violation::Violation;
use crate::workspace::SourceFile;

/// The entry.
const ENTRY: &str = "crates/estimation/src/";

/// Maximum number of public items.
const ITEMS_MAX: usize = 120;

const ITEMS: [&str; 10] = ["fn", "struct", "enum", "trait", "const", "static", "type", "mod", "unsafe", "async"];

/// Counts the public items and re-exports of the entry, and rejects glob re-exports.
pub fn check(files: &[SourceFile]) -> Vec<Violation> {
    let is_test = |path: &str| path.ends_with("/tests.rs") || path.ends_with("_tests.rs");
    let (mut count, mut violations) = (0, Vec::new());
    for file in files.iter().filter(|file| file.path.starts_with(ENTRY) && !is_test(&file.path)) {
        let code = without_test_items(&code_only(&file.text));
        for at in word_positions(&code, "pub") {
            let rest = code[at + "pub".len()..].trim_start();
            let word = rest.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default();
            if word == "use" {
                let names = rest.split(';').next().unwrap_or_default();
                count += names.matches(',').count() + 1;
                if names.trim_end().ends_with("::*") {
                    let message = "a glob re-export: name each item, so that a reader can count them";
                    violations.push(Violation::at(&file.path, line_at(&code, at), "public-surface", message));
                }
            }
            count += usize::from(ITEMS.contains(&word));
        }
    }
    if count > ITEMS_MAX {
        let message =
            format!("{count} public items, at most {ITEMS_MAX}: hide items that users of the estimation do not need");
        violations.push(Violation::of(ENTRY, "public-surface", message));
    }
    violations
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(path: &str, text: String) -> SourceFile {
        SourceFile { path: path.to_owned(), text }
    }

    #[test]
    fn too_many_items_and_re_exports_without_names_are_found() {
        let many = |count: usize| (0..count).map(|k| format!("pub fn f{k}() {{}}\n")).collect::<String>();
        let rules = |text: String| check(&[file("crates/estimation/src/lib.rs", text)]).len();
        assert_eq!(rules(many(ITEMS_MAX)), 0);
        assert_eq!(rules(many(ITEMS_MAX + 1)), 1);
        assert_eq!(rules(many(ITEMS_MAX - 2) + "pub use a::{B, C};"), 0);
        assert_eq!(rules(many(ITEMS_MAX - 2) + "pub use a::{B, C, D};"), 1);
        assert_eq!(rules("pub use a::*;".to_owned()), 1);
        assert_eq!(rules("pub(crate) use a::*;\n#[cfg(test)]\nmod tests { pub use a::*; }".to_owned()), 0);
        let elsewhere = file("crates/servo/src/lib.rs", many(ITEMS_MAX + 1));
        assert!(check(&[elsewhere]).is_empty());
    }
}
