//! Checks that links and paths in Markdown exist, also in a release.

use crate::package::is_shipped;
use crate::violation::Violation;

/// Address of a file of the repository; a page of a release links other files by it.
const REPOSITORY: &str = "https://github.com/pb3dp/pb3dp/blob/main/";

/// First folders of the paths in backticks that are checked.
const ROOTS: [&str; 7] = ["crates/", "hal/", "configs/", "docs/", "tests/", "xtask/", ".ci/"];

/// Checks the relative links of one Markdown file, and the paths from the root that are in backticks.
pub fn check(path: &str, text: &str, files: &[String]) -> Vec<Violation> {
    let exists = |target: &str| {
        let target = target.trim_end_matches('/');
        target.is_empty() || files.iter().any(|file| file == target || file.starts_with(&format!("{target}/")))
    };
    let mut violations = Vec::new();
    let mut in_code = false;
    for (index, line) in text.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            in_code = !in_code;
        }
        if in_code {
            continue;
        }
        let links = links(line).filter_map(|link| resolve(path, link)).filter(|target| !exists(target));
        let paths = code_spans(line).filter(|span| is_path(span) && !exists(span)).map(str::to_owned);
        for target in links.chain(paths) {
            violations.push(Violation::at(path, index + 1, "dead-link", format!("`{target}` does not exist")));
        }
        let relative = self::links(line).filter(|link| is_shipped(path) && !link.contains("://"));
        let found = relative.filter_map(|link| resolve(path, link));
        for target in found.filter(|target| exists(target) && !is_shipped(target)) {
            let message = format!("no release contains `{target}`: link {REPOSITORY}{target}");
            violations.push(Violation::at(path, index + 1, "dead-link", message));
        }
    }
    violations
}

fn links(line: &str) -> impl Iterator<Item = &str> {
    line.split("](").skip(1).filter_map(|rest| rest.split(')').next())
}

fn code_spans(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}

fn is_path(span: &str) -> bool {
    let plain = span.chars().all(|c| c.is_ascii_alphanumeric() || "/._-".contains(c));
    plain && ROOTS.iter().any(|root| span.starts_with(root))
}

/// The path from the root for a link; `None` for other sites and anchors in the same file.
fn resolve(path: &str, link: &str) -> Option<String> {
    let target = link.split('#').next().unwrap_or_default();
    if let Some(of_repository) = target.strip_prefix(REPOSITORY) {
        return Some(of_repository.to_owned());
    }
    if target.is_empty() || target.contains("://") || target.starts_with("mailto:") {
        return None;
    }
    let mut parts: Vec<&str> = path.split('/').collect();
    parts.pop();
    for part in target.split('/') {
        match part {
            "." | "" => {}
            ".." => drop(parts.pop()),
            name => parts.push(name),
        }
    }
    Some(parts.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn messages(path: &str, text: &str) -> Vec<String> {
        let files = ["README.md", "docs/units.md", "docs/adr/0001-a.md", "crates/a/src/lib.rs"].map(str::to_owned);
        check(path, text, &files).into_iter().map(|v| v.message).collect()
    }

    #[test]
    fn dead_links_and_paths_are_caught() {
        assert_eq!(messages("README.md", "see [units](docs/unit.md)"), ["`docs/unit.md` does not exist"]);
        assert_eq!(messages("docs/adr/0001-a.md", "[u](../unit.md)"), ["`docs/unit.md` does not exist"]);
        assert_eq!(messages("README.md", "in `crates/a/src/main.rs`"), ["`crates/a/src/main.rs` does not exist"]);
    }

    /// An installed page would lead nowhere.
    #[test]
    fn a_link_to_a_file_that_no_release_contains_names_the_repository() {
        let by_repository = format!("[a]({REPOSITORY}crates/a/src/lib.rs)");
        let expected = format!("no release contains `crates/a/src/lib.rs`: link {REPOSITORY}crates/a/src/lib.rs");
        assert_eq!(messages("docs/units.md", "[a](../crates/a/src/lib.rs)"), [expected]);
        assert_eq!(messages("docs/units.md", &by_repository), [""; 0]);
        assert_eq!(messages("crates/a/NOTES.md", "[a](src/lib.rs)"), [""; 0], "no page of a release");
        let dead = by_repository.replace("lib.rs", "main.rs");
        assert_eq!(messages("docs/units.md", &dead), ["`crates/a/src/main.rs` does not exist"]);
    }

    #[test]
    fn living_links_pass() {
        for (path, text) in [
            ("README.md", "[u](docs/units.md#time), [adr](docs/adr), [web](https://example.org/x)"),
            ("docs/adr/0001-a.md", "[u](../units.md) and [r](../../README.md) and [here](#context)"),
            ("README.md", "`crates/a/` and `crates/*/src` and `cargo test -p a` and `docs/units.md`"),
            ("README.md", "```\n[u](docs/unit.md)\n```"),
        ] {
            assert_eq!(messages(path, text), [""; 0], "{text}");
        }
    }
}
