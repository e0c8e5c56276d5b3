//! Checks that every test file belongs to a test program.
//!
//! Packages list their test programs themselves (`autotests = false`), so a file without a test program would not be compiled, and
//! its tests would never fail.

use crate::violation::Violation;
use crate::workspace::SourceFile;

/// Checks the Rust files in the folders `tests` of all packages.
pub fn check(texts: &[SourceFile]) -> Vec<Violation> {
    let roots: Vec<(&str, &str)> = texts.iter().filter_map(package_with_its_own_list).collect();
    let mut violations = Vec::new();
    for (folder, manifest) in roots {
        let tests = format!("{folder}tests/");
        let inside: Vec<&SourceFile> =
            texts.iter().filter(|file| file.path.starts_with(folder) && file.path.ends_with(".rs")).collect();
        for file in &inside {
            let Some(path) = file.path.strip_prefix(&tests) else { continue };
            let is_program = manifest.contains(&format!("path = \"tests/{path}\""));
            let is_fuzzed = path.starts_with("fuzz/");
            if !is_program && !is_fuzzed && !is_named(path, &inside) {
                let message = "no test program includes this file: add `mod` to the root in tests/";
                violations.push(Violation::at(&file.path, 1, "unlisted-test", message));
            }
        }
    }
    violations
}

/// Folder of a package, with a slash at the end, and its manifest.
fn package_with_its_own_list(file: &SourceFile) -> Option<(&str, &str)> {
    let folder = file.path.strip_suffix("Cargo.toml")?;
    file.text.contains("autotests = false").then_some((folder, file.text.as_str()))
}

/// Whether a file next to or above this one has a `mod` for it.
fn is_named(path: &str, inside: &[&SourceFile]) -> bool {
    let module = path.strip_suffix("/mod.rs").or_else(|| path.strip_suffix(".rs")).unwrap_or(path);
    let name = module.rsplit('/').next().unwrap_or(module);
    let declared = [format!("mod {name};"), format!("/{name}.rs\"]"), format!("\"{path}\"]")];
    inside
        .iter()
        .any(|file| file.path.rsplit('/').next() != Some(path) && declared.iter().any(|text| file.text.contains(text)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(files: &[(&str, &str)]) -> Vec<String> {
        let file = |(path, text): &(&str, &str)| SourceFile { path: (*path).to_owned(), text: (*text).to_owned() };
        let files: Vec<SourceFile> = files.iter().map(file).collect();
        check(&files).into_iter().map(|violation| violation.file).collect()
    }

    const MANIFEST: (&str, &str) =
        ("crates/a/Cargo.toml", "autotests = false\n[[test]]\nname = \"integration\"\npath = \"tests/main.rs\"\n");

    #[test]
    fn a_file_that_no_program_names_is_caught() {
        let root = ("crates/a/tests/main.rs", "mod law;\n#[path = \"support/arm.rs\"]\nmod arm;\nmod servo;\n");
        let all = [
            MANIFEST,
            root,
            ("crates/a/tests/law.rs", ""),
            ("crates/a/tests/support/arm.rs", ""),
            ("crates/a/tests/servo/mod.rs", "mod hold;"),
            ("crates/a/tests/servo/hold.rs", ""),
        ];
        assert_eq!(found(&all), [""; 0]);
        let forgotten = ("crates/a/tests/forgotten.rs", "#[test]\nfn never() {}\n");
        assert_eq!(found(&[MANIFEST, root, forgotten]), ["crates/a/tests/forgotten.rs"]);
    }
}
