//! The layout of the tree: entries of the top level, and requirements for every package.

use crate::violation::Violation;

/// All entries of the top level.
const TOP_LEVEL: [&str; 24] = [
    ".cargo",
    ".ci",
    ".editorconfig",
    ".gitattributes",
    ".github",
    ".gitignore",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "Cargo.lock",
    "Cargo.toml",
    "LICENSE-APACHE",
    "LICENSE-MIT",
    "README.md",
    "SECURITY.md",
    "clippy.toml",
    "configs",
    "crates",
    "deny.toml",
    "docs",
    "hal",
    "rustfmt.toml",
    "tests",
    "xtask",
];

/// Checks the first part of every path.
pub fn top_level(files: &[String]) -> Vec<Violation> {
    let first = |file: &String| file.split('/').next().unwrap_or_default().to_owned();
    let mut strangers: Vec<String> = files.iter().map(first).filter(|name| !TOP_LEVEL.contains(&&**name)).collect();
    strangers.dedup();
    let message = "does not belong at the top level: see ARCHITECTURE.md";
    strangers.iter().map(|name| Violation::of(name, "top-level", message)).collect()
}

/// A publishable crate has a README, which its registry page shows.
pub fn readme(path: &str, text: &str, files: &[String]) -> Vec<Violation> {
    let is_crate = path.starts_with("crates/") || (path.starts_with("hal/") && !path.starts_with("hal/vendor/"));
    let readme = path.replace("Cargo.toml", "README.md");
    if !is_crate || text.contains("\npublish = false\n") || files.contains(&readme) {
        return Vec::new();
    }
    vec![Violation::of(&readme, "readme", "is missing: state the crate's purpose, with an example for a library")]
}

/// Checks a member's `Cargo.toml`: lints and package keys from the workspace, dependencies from the workspace.
pub fn manifest(path: &str, text: &str) -> Vec<Violation> {
    let vendored = path.starts_with("hal/vendor/") || path.starts_with("tests/fuzz/");
    if vendored {
        return Vec::new();
    }
    let table = match text.parse::<toml::Table>() {
        Ok(table) => table,
        Err(error) => return vec![Violation::of(path, "manifest", error.to_string())],
    };
    let inherits = |value: Option<&toml::Value>| {
        value.and_then(|value| value.get("workspace")).and_then(toml::Value::as_bool) == Some(true)
    };
    let mut violations = Vec::new();
    if !inherits(table.get("lints")) {
        violations.push(Violation::of(path, "manifest", "`[lints] workspace = true` is missing"));
    }
    let is_private =
        table.get("package").and_then(|package| package.get("publish")) == Some(&toml::Value::Boolean(false));
    let of_published: &[&str] = if is_private { &[] } else { &["repository", "keywords", "categories"] };
    for key in ["version", "edition", "rust-version", "license"].iter().chain(of_published) {
        let value = table.get("package").and_then(|package| package.get(key));
        if !inherits(value) {
            violations.push(Violation::of(path, "manifest", format!("`{key}.workspace = true` is missing")));
        }
    }
    for section in ["dependencies", "dev-dependencies", "build-dependencies"] {
        let Some(entries) = table.get(section).and_then(toml::Value::as_table) else { continue };
        // Cargo does not publish a crate of the workspace without a version: no cycle, no test crate to publish.
        let is_left_out = |entry: &toml::Value| {
            section == "dev-dependencies"
                && !is_private
                && entry.get("path").is_some()
                && entry.get("version").is_none()
        };
        for (name, _) in entries.iter().filter(|(_, entry)| !inherits(Some(entry)) && !is_left_out(entry)) {
            let message =
                format!("`{name}` in [{section}]: state the version once, in the root, and write `workspace = true`");
            violations.push(Violation::of(path, "manifest", message));
        }
    }
    violations
}

/// Checks that a package's root file states in `//!` what the package is.
pub fn crate_docs(path: &str, text: &str) -> Vec<Violation> {
    let is_root = path.ends_with("/src/lib.rs") || path.ends_with("/src/main.rs");
    if is_root && !text.trim_start().starts_with("//!") {
        let message = "start with `//!`: purpose of the crate, its limits, its main types";
        return vec![Violation::at(path, 1, "crate-docs", message)];
    }
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strangers_at_the_top_level_are_caught() {
        let files = ["README.md", "crates/a/src/lib.rs", "scripts/run.py", "scripts/sim.py"].map(str::to_owned);
        let found: Vec<_> = top_level(&files).into_iter().map(|v| v.file).collect();
        assert_eq!(found, ["scripts"]);
    }

    #[test]
    fn a_crate_without_a_readme_is_caught() {
        let files = ["crates/a/README.md".to_owned()];
        assert_eq!(readme("crates/a/Cargo.toml", MANIFEST, &files), []);
        assert_eq!(readme("crates/b/Cargo.toml", MANIFEST, &files).len(), 1);
        assert_eq!(readme("crates/b/Cargo.toml", "[package]\npublish = false\n", &files), []);
    }

    const MANIFEST: &str = "[package]\nname = \"a\"\nversion.workspace = true\nedition.workspace = true\n\
        rust-version.workspace = true\nlicense.workspace = true\nrepository.workspace = true\n\
        keywords.workspace = true\ncategories.workspace = true\n[lints]\nworkspace = true\n[dependencies]\nnalgebra.workspace = true\n";

    #[test]
    fn a_manifest_of_its_own_mind_is_caught() {
        assert_eq!(manifest("crates/a/Cargo.toml", MANIFEST), []);
        for (from, to) in [
            ("[lints]\nworkspace = true\n", ""),
            ("edition.workspace = true", "edition = \"2021\""),
            ("rust-version.workspace = true", "rust-version = \"1.95\""),
            ("nalgebra.workspace = true", "nalgebra = \"0.34\""),
            ("nalgebra.workspace = true", "a-b = { path = \"../b\" }"),
            ("keywords.workspace = true\n", ""),
        ] {
            let text = MANIFEST.replace(from, to);
            assert_eq!(manifest("crates/a/Cargo.toml", &text).len(), 1, "{to}");
        }
    }

    #[test]
    fn a_crate_without_its_documentation_is_caught() {
        assert_eq!(crate_docs("crates/a/src/lib.rs", "pub mod b;").len(), 1);
        assert_eq!(crate_docs("crates/a/src/lib.rs", "//! Says what it is.\n"), []);
        assert_eq!(crate_docs("crates/a/src/b.rs", "pub fn f() {}"), []);
    }
}
