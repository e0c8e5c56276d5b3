//! One build of everything for the tests: one call of cargo, one set of features, one profile.

use std::path::{Path, PathBuf};
use std::process::Stdio;

use anyhow::{Context, bail};
use serde_json::Value;

use super::Selection;
use crate::workspace::Workspace;

/// Examples with tests, and their packages. Clippy checks the others.
const TESTED_EXAMPLES: [(&str, &str); 4] = [
    ("safety", "pb3dp-benchmarks"),
    ("servo", "pb3dp-benchmarks"),
    ("soak", "system-tests"),
    ("there_and_back", "pb3dp-benchmarks"),
];

/// A test program that was built.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Program {
    /// Package name.
    pub package: String,
    /// Name of cargo's target.
    pub target: String,
    /// Kind of cargo's target: `lib`, `bin`, `test`, `example`.
    pub kind: String,
    /// The program.
    pub path: PathBuf,
    /// Folder of the package, where its tests run.
    pub folder: PathBuf,
}

impl Program {
    /// Name in tables: `pb3dp-servo integration`.
    pub fn name(&self) -> String {
        let what = if self.kind == "test" || self.kind == "example" { &self.target } else { "unit tests" };
        format!("{} {what}", self.package)
    }
}

/// Results of a build.
#[derive(Debug, Default)]
pub struct Built {
    /// The test programs.
    pub tests: Vec<Program>,
    /// Programs of the product.
    programs: Vec<Program>,
}

impl Built {
    /// Folder of the programs of the product.
    ///
    /// # Errors
    /// If the build had no programs.
    pub fn folder(&self) -> anyhow::Result<&Path> {
        let program = self.programs.iter().find(|program| program.target == "pb3dp");
        program.and_then(|program| program.path.parent()).context("the build has no program pb3dp")
    }
}

/// Builds the selected packages. Cargo writes the time of each unit to target/cargo-timings.
///
/// # Errors
/// If something does not build.
pub fn run(workspace: &Workspace, packages: &Selection) -> anyhow::Result<Built> {
    let selected = packages.arguments(|_| true);
    let mut command = workspace.cargo();
    command.arg("test").args(&selected).args(["--locked", "--no-run", "--bins", "--tests", "--timings"]);
    let examples = TESTED_EXAMPLES.iter().filter(|(_, package)| packages.has(package));
    command.args(examples.flat_map(|(name, _)| ["--example", name]));
    command.args(["--quiet", "--message-format", "json-render-diagnostics"]);
    println!("$ cargo test {} --no-run", selected.join(" "));
    let output = command.stderr(Stdio::inherit()).output().context("cannot run cargo")?;
    if !output.status.success() {
        bail!("the tests do not build: see the compiler errors above");
    }
    let mut built = Built::default();
    for line in String::from_utf8(output.stdout).context("cargo did not print text")?.lines() {
        let message: Value = serde_json::from_str(line).context("cargo did not print JSON")?;
        match artifact(&message) {
            Some((true, program)) => built.tests.push(program),
            Some((false, program)) => built.programs.push(program),
            None => {}
        }
    }
    Ok(built)
}

/// A program from one of cargo's messages, and whether it is a test.
pub fn artifact(message: &Value) -> Option<(bool, Program)> {
    if message["reason"] != "compiler-artifact" {
        return None;
    }
    let path = PathBuf::from(message["executable"].as_str()?);
    let is_test = message["profile"]["test"].as_bool()?;
    let manifest = Path::new(message["manifest_path"].as_str()?);
    let folder = manifest.parent()?.to_path_buf();
    let target = message["target"]["name"].as_str()?.to_owned();
    let kind = message["target"]["kind"][0].as_str()?.to_owned();
    Some((
        is_test,
        Program { package: package_of(message["package_id"].as_str()?, &folder), target, kind, path, folder },
    ))
}

/// Name of a package from its identifier: `path+file:///...crates/servo#pb3dp-servo@0.1.0`, or `...tests#0.1.0` if the folder has the same name.
fn package_of(id: &str, folder: &Path) -> String {
    let name = id.rsplit_once('#').and_then(|(_, tail)| tail.split_once('@')).map(|(name, _)| name.to_owned());
    name.unwrap_or_else(|| folder.file_name().unwrap_or_default().to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn programs_are_found_in_what_cargo_prints() {
        let message = |executable: &str, test: bool| {
            serde_json::json!({
                "reason": "compiler-artifact", "package_id": "path+file:///w/crates/servo#pb3dp-servo@0.1.0",
                "manifest_path": "/w/crates/servo/Cargo.toml", "executable": executable, "profile": { "test": test },
                "target": { "name": "integration", "kind": ["test"] },
            })
        };
        let (is_test, program) = artifact(&message("/w/target/debug/deps/integration-1", true)).unwrap();
        assert_eq!((is_test, program.name()), (true, "pb3dp-servo integration".to_owned()));
        assert_eq!(program.folder, Path::new("/w/crates/servo"));
        assert!(!artifact(&message("/w/target/debug/pb3dp", false)).unwrap().0);
        assert!(artifact(&serde_json::json!({ "reason": "build-finished", "success": true })).is_none());
        assert_eq!(package_of("path+file:///w/xtask#0.1.0", Path::new("/w/xtask")), "xtask");
    }
}
