//! The required safety tests. `cargo xtask ci` fails if one of them was not checked; `cargo xtask test --prove-red` breaks the
//! property behind each test, and checks that the test fails.

use std::collections::BTreeSet;
use std::fs;

use anyhow::{Context, bail};

use crate::files::read;
use crate::test::{Report, Selection};
use crate::workspace::Workspace;

/// Folder of the patches, one for each property; their heads name the tests.
pub const PATCHES: &str = "tests/red";

/// A safety property and the test that shows it.
#[derive(Clone, Debug)]
pub struct Required {
    /// The property.
    pub property: String,
    /// The package of the test.
    pub package: String,
    /// The test program.
    pub program: String,
    /// Name of the test in the program.
    pub test: String,
    /// File name of the patch that breaks the property.
    pub patch: String,
}

/// The required tests, from the heads of the patches.
///
/// # Errors
/// If a patch cannot be read, or its head lacks a line.
pub fn all(workspace: &Workspace) -> anyhow::Result<Vec<Required>> {
    let mut required = Vec::new();
    for entry in fs::read_dir(workspace.root().join(PATCHES)).with_context(|| format!("cannot list {PATCHES}"))? {
        let path = entry?.path();
        let (patch, text) = (path.file_name().unwrap_or_default().to_string_lossy().into_owned(), read(&path)?);
        let of = |key: &str| {
            let found = text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(": "));
            found.map(str::to_owned).with_context(|| format!("{PATCHES}/{patch}: the line `{key}: ...` is missing"))
        };
        let (property, package, program, test) = (of("property")?, of("package")?, of("program")?, of("test")?);
        required.push(Required { property, package, program, test, patch });
    }
    required.sort_by(|left, right| left.patch.cmp(&right.patch));
    Ok(required)
}

/// Largest share of the tests in real time that a machine may leave unchecked.
const UNCHECKED_MAX: f64 = 0.03;

/// # Errors
/// If a required test of a selected package did not pass, or too many tests in real time were not checked.
pub fn check(workspace: &Workspace, report: &Report, packages: &Selection) -> anyhow::Result<()> {
    let unchecked: BTreeSet<&str> = report.not_checked().map(|line| line.split(": ").next().unwrap_or(line)).collect();
    for required in all(workspace)?.iter().filter(|required| packages.has(&required.package)) {
        if unchecked.contains(&*required.test) || !report.has_passed(&required.package, &required.test) {
            bail!("not checked, but required: {} ({}: {})", required.property, required.package, required.test);
        }
    }
    let [left_out, all] = report.real_time_counts();
    println!("tests in real time: {all}, of them not checked: {left_out}");
    if left_out as f64 > UNCHECKED_MAX * all as f64 {
        bail!("{left_out} of {all} tests in real time were not checked, the limit is {:.0} %", 100.0 * UNCHECKED_MAX);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::workspace::SourceFile;

    #[test]
    fn each_patch_names_its_test_and_applies() {
        const TEST: &str = "each_patch_names_its_test_and_applies";
        let workspace = Workspace::find().unwrap();
        let required = all(&workspace).unwrap();
        assert_eq!(required.len(), 10);
        let sources = workspace.texts(&[".rs"]).unwrap();
        for Required { test, patch, .. } in required {
            // In its file, or by its whole name where a program lists its tests itself.
            let (module, name) = test.rsplit_once("::").unwrap();
            let module = module.rsplit("::").next().unwrap();
            let has = |file: &SourceFile| {
                let is_there = file.path.ends_with(&format!("/{module}.rs")) && file.text.contains(name);
                is_there || file.text.contains(&format!("\"{test}\""))
            };
            assert!(sources.iter().any(has), "{patch}: no test {test}");
            let git = workspace.command("git").args(["apply", "--check"]).arg(format!("{PATCHES}/{patch}")).output();
            match git {
                Ok(output) => assert!(output.status.success(), "{patch}: {}", String::from_utf8_lossy(&output.stderr)),
                Err(error) => println!("NOT CHECKED: required::tests::{TEST}: git does not start: {error}"),
            }
        }
    }
}
