//! Checks that every third-party dependency of the root manifest is used, and has its reason in the record.

use crate::violation::Violation;
use crate::workspace::SourceFile;

const ROOT: &str = "Cargo.toml";
const RECORD: &str = "docs/adr/0002-dependencies.md";

/// Compares the root manifest with the record and with the members' manifests.
pub fn check(texts: &[SourceFile]) -> Vec<Violation> {
    let text_of = |path: &str| texts.iter().find(|file| file.path == path).map_or("", |file| file.text.as_str());
    let members: Vec<&SourceFile> = texts.iter().filter(|file| file.path.ends_with("/Cargo.toml")).collect();
    let root: toml::Table = match text_of(ROOT).parse() {
        Ok(table) => table,
        Err(error) => return vec![Violation::of(ROOT, "manifest", format!("{error}"))],
    };
    let listed = root.get("workspace").and_then(|w| w.get("dependencies")).and_then(toml::Value::as_table);
    let mut violations = Vec::new();
    for (name, entry) in listed.into_iter().flatten() {
        if entry.get("path").is_some() {
            continue;
        }
        if !text_of(RECORD).contains(&format!("| `{name}` |")) {
            let message = format!("`{name}` has no reason in {RECORD}: add a row");
            violations.push(Violation::of(ROOT, "dependency-reason", message));
        }
        if !members.iter().any(|member| is_used(name, &member.text)) {
            let message = format!("no member uses `{name}`: remove it");
            violations.push(Violation::of(ROOT, "unused-dependency", message));
        }
    }
    violations
}

fn is_used(name: &str, manifest: &str) -> bool {
    manifest.lines().any(|line| {
        let rest = line.trim_start().strip_prefix(name).unwrap_or_default();
        rest.starts_with('.') || rest.starts_with(' ') || rest.starts_with('=')
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rules(root: &str, member: &str, record: &str) -> Vec<&'static str> {
        let file = |path: &str, text: &str| SourceFile { path: path.to_owned(), text: text.to_owned() };
        let files = [file(ROOT, root), file("crates/a/Cargo.toml", member), file(RECORD, record)];
        check(&files).into_iter().map(|v| v.rule).collect()
    }

    #[test]
    fn a_dependency_needs_a_user_and_a_reason() {
        let root = "[workspace.dependencies]\nown = { path = \"crates/own\" }\npng = \"0.18\"\n";
        let (user, reason) = ("[dependencies]\npng.workspace = true\n", "| `png` | MIT | animated images |");
        assert_eq!(rules(root, user, reason), [""; 0]);
        assert_eq!(rules(root, user, ""), ["dependency-reason"]);
        assert_eq!(rules(root, "[dependencies]\npng-tools.workspace = true\n", reason), ["unused-dependency"]);
    }
}
