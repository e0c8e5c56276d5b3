//! Checks that the table of contents of the site has every page once.

use crate::violation::Violation;
use crate::workspace::SourceFile;

const SUMMARY: &str = "docs/SUMMARY.md";

/// Checks that every Markdown page of docs/ is in the table of contents exactly once.
pub fn check(files: &[SourceFile]) -> Vec<Violation> {
    let Some(summary) = files.iter().find(|file| file.path == SUMMARY) else {
        return vec![Violation::of(SUMMARY, "site", "is missing: it is the table of contents of the site")];
    };
    let pages = files.iter().filter_map(|file| file.path.strip_prefix("docs/").filter(|page| page.ends_with(".md")));
    let wrong = pages.filter(|page| *page != "SUMMARY.md").filter_map(|page| {
        let count = summary.text.matches(&format!("]({page})")).count();
        let message = format!("`{page}` is listed {count} times: list every page exactly once");
        (count != 1).then(|| Violation::of(SUMMARY, "site", message))
    });
    wrong.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pages_that_are_left_out_or_named_twice_are_found() {
        let file = |path: &str, text: &str| SourceFile { path: path.to_owned(), text: text.to_owned() };
        let found = |summary: &str| {
            check(&[file(SUMMARY, summary), file("docs/units.md", ""), file("docs/adr/0001-a.md", "")]).len()
        };
        assert_eq!(found("- [Units](units.md)\n- [A](adr/0001-a.md)"), 0);
        assert_eq!(found("- [Units](units.md)"), 1);
        assert_eq!(found("- [Units](units.md)\n- [A](adr/0001-a.md)\n- [Units](units.md)"), 1);
        assert_eq!(check(&[file("docs/units.md", "")]).len(), 1, "no table of contents");
    }
}
