//! The routes of docs/routes.md exist in the code: each file names an item of the next one.

use crate::rust_text::{code_only, word_positions};
use crate::violation::Violation;
use crate::workspace::SourceFile;

/// The page; its tables are the list of files.
const PAGE: &str = "docs/routes.md";

/// Items whose definitions count.
const ITEMS: [&str; 7] = ["fn", "struct", "enum", "trait", "type", "const", "static"];

/// One row of a table: a file, and its link to the file of the next row.
struct Row<'a> {
    line: usize,
    file: &'a str,
    link: Option<Link<'a>>,
}

#[derive(Clone, Copy)]
enum Link<'a> {
    /// This file uses a name that the next file defines.
    Calls(&'a str),
    /// This file defines a name that the next file uses.
    Offers(&'a str),
}

/// Checks each route of the page: all files exist, and each one names an item of the next, or the next one an item of it.
pub fn check(texts: &[SourceFile]) -> Vec<Violation> {
    let Some(page) = texts.iter().find(|file| file.path == PAGE) else {
        return vec![Violation::of(PAGE, "routes", "is missing: it shows the routes through the code")];
    };
    let mut violations = Vec::new();
    let routes = routes(&page.text);
    if routes.is_empty() {
        violations.push(Violation::of(PAGE, "routes", "has no table with files"));
    }
    for route in routes {
        for (index, row) in route.iter().enumerate() {
            if let Err(message) = check_row(row, route.get(index + 1), texts) {
                violations.push(Violation::at(PAGE, row.line, "routes", message));
            }
        }
    }
    violations
}

/// The tables of the page.
fn routes(page: &str) -> Vec<Vec<Row<'_>>> {
    let mut routes: Vec<Vec<Row<'_>>> = Vec::new();
    let mut is_inside = false;
    for (index, line) in page.lines().enumerate() {
        let row = row(index + 1, line);
        let was_inside = std::mem::replace(&mut is_inside, row.is_some());
        match (row, routes.last_mut().filter(|_| was_inside)) {
            (Some(row), Some(route)) => route.push(row),
            (Some(row), None) => routes.push(vec![row]),
            (None, _) => {}
        }
    }
    routes
}

fn row(line: usize, text: &str) -> Option<Row<'_>> {
    let (file, rest) = text.strip_prefix("| `")?.split_once("` |")?;
    let link = rest.trim_end().trim_end_matches('|').rsplit('|').next().unwrap_or_default().trim();
    let name = |kind: &str| link.strip_prefix(kind)?.trim().strip_prefix('`')?.strip_suffix('`');
    let link = name("calls").map(Link::Calls).or_else(|| name("offers").map(Link::Offers));
    Some(Row { line, file, link })
}

fn check_row(row: &Row<'_>, next: Option<&Row<'_>>, texts: &[SourceFile]) -> Result<(), String> {
    let here = code_of(row.file, texts)?;
    let (link, next) = match (row.link, next) {
        (Some(link), Some(next)) => (link, next),
        (None, None) => return Ok(()),
        (Some(_), None) => return Err("the last file of a route has no link".to_owned()),
        (None, Some(_)) => return Err("write calls `name` or offers `name` in the last column".to_owned()),
    };
    let there = code_of(next.file, texts)?;
    let (name, (user, user_code), (owner, owner_code)) = match link {
        Link::Calls(name) => (name, (row.file, here), (next.file, there)),
        Link::Offers(name) => (name, (next.file, there), (row.file, here)),
    };
    if !defines(&owner_code, name) {
        return Err(format!("{owner} does not define `{name}`: show the present route"));
    }
    if word_positions(&user_code, name).next().is_none() {
        return Err(format!("{user} does not use `{name}`: show the present route"));
    }
    Ok(())
}

fn code_of(path: &str, texts: &[SourceFile]) -> Result<String, String> {
    let file = texts.iter().find(|file| file.path == path);
    file.map(|file| code_only(&file.text)).ok_or_else(|| format!("`{path}` does not exist: show the present route"))
}

/// Whether code has the definition of an item with this name.
fn defines(code: &str, name: &str) -> bool {
    word_positions(code, name).any(|at| {
        let before = code[..at].trim_end();
        at > before.len()
            && ITEMS.iter().any(|item| word_positions(before, item).any(|at| at + item.len() == before.len()))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(rows: &str, files: &[(&str, &str)]) -> Vec<String> {
        let text = |(path, text): &(&str, &str)| SourceFile { path: (*path).to_owned(), text: (*text).to_owned() };
        let page = format!("# Routes\n\n| file | what | link |\n|---|---|---|\n{rows}");
        let texts: Vec<_> = files.iter().chain([&(PAGE, page.as_str())]).map(text).collect();
        check(&texts).iter().map(|violation| violation.to_string()).collect()
    }

    #[test]
    fn a_route_with_moved_files_and_removed_calls_is_found() {
        let rows = "| `a.rs` | begins | calls `stop` |\n| `b.rs` | goes on | offers `State` |\n| `c.rs` | ends | |\n";
        let a = ("a.rs", "fn run() { stop(); }\n");
        let b = ("b.rs", "pub fn stop() {}\npub enum State { On }\n");
        let c = ("c.rs", "use crate::b::State;\n");
        assert_eq!(found(rows, &[a, b, c]), Vec::<String>::new());
        let moved = found(rows, &[a, b]);
        assert!(moved.len() == 2 && moved[0].contains("`c.rs` does not exist"), "{moved:?}");
        let not_called = found(rows, &[("a.rs", "fn run() {} // stop\n"), b, c]);
        assert!(not_called.len() == 1 && not_called[0].contains("a.rs does not use `stop`"), "{not_called:?}");
        let not_defined = found(rows, &[a, ("b.rs", "stop();\nenum State {}\n"), c]);
        assert!(not_defined.len() == 1 && not_defined[0].contains("b.rs does not define `stop`"), "{not_defined:?}");
        let not_offered = found(rows, &[a, b, ("c.rs", "")]);
        assert!(not_offered.len() == 1 && not_offered[0].contains("c.rs does not use `State`"), "{not_offered:?}");
    }

    #[test]
    fn a_row_without_a_link_and_a_page_without_rows_are_found() {
        let files = [("a.rs", "fn a() {}\n"), ("b.rs", "fn b() {}\n")];
        let rows = "| `a.rs` | begins | |\n| `b.rs` | ends | calls `a` |\n";
        assert_eq!(found(rows, &files).len(), 2);
        assert_eq!(found("", &files).len(), 1);
        assert_eq!(check(&[]).len(), 1);
    }
}
