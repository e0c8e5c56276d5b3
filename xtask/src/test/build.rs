//! One build of everything that tests need: one call of cargo, one set of features, one profile.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use anyhow::{Context, bail};
use serde_json::Value;

use super::timings::{self, Unit};
use crate::workspace::Workspace;

/// Examples with tests of their own. The others are checked by clippy.
const TESTED_EXAMPLES: [&str; 4] = ["safety", "servo", "soak", "there_and_back"];

/// Tests switch safeguards off one by one: each must be missed.
pub const FEATURES: &str = "system-tests/disabled-guards";

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
    /// For tables: `pb3dp-servo integration`.
    pub fn name(&self) -> String {
        let what = if self.kind == "test" || self.kind == "example" { &self.target } else { "unit tests" };
        format!("{} {what}", self.package)
    }
}

/// What a build left.
#[derive(Debug)]
pub struct Built {
    /// Programs of the product, by name: `pb3dp`, `pb3dp-calibrate`.
    programs: Vec<(String, PathBuf)>,
    /// Where cargo puts everything.
    target: PathBuf,
}

impl Built {
    /// Folder of the programs of the product.
    ///
    /// # Errors
    /// If the build had none.
    pub fn folder(&self) -> anyhow::Result<&Path> {
        let program = self.programs.iter().find(|(name, _)| name == "pb3dp").context("the build has no pb3dp")?;
        program.1.parent().context("pb3dp lies in no folder")
    }

    /// How long each unit took to build; nothing of what was there before.
    pub fn units(&self) -> Vec<Unit> {
        timings::units(&self.target.join("cargo-timings"))
    }
}

/// Builds everything, and hands each test program over as soon as it is there.
///
/// # Errors
/// If something does not build.
pub fn run(workspace: &Workspace, mut ready: impl FnMut(Program)) -> anyhow::Result<Built> {
    let mut command = workspace.cargo();
    command.args(["test", "--workspace", "--locked", "--no-run", "--lib", "--bins", "--tests", "--timings"]);
    command.args(["--features", FEATURES]);
    command.args(TESTED_EXAMPLES.iter().flat_map(|name| ["--example", name]));
    command.args(["--quiet", "--message-format", "json-render-diagnostics"]);
    println!("$ cargo test --workspace --no-run");
    let mut child = command.stdout(Stdio::piped()).spawn().context("cannot run cargo")?;
    let output = child.stdout.take().context("cargo has no output")?;
    let mut built = Built { programs: Vec::new(), target: workspace.target_folder()? };
    for line in BufReader::new(output).lines() {
        let message: Value = serde_json::from_str(&line?).context("cargo did not print JSON")?;
        match artifact(&message) {
            Some((true, program)) => ready(program),
            Some((false, program)) => built.programs.push((program.target, program.path)),
            None => {}
        }
    }
    if !child.wait()?.success() {
        bail!("the tests do not build: the compiler's errors stand above");
    }
    Ok(built)
}

/// A program from one of cargo's messages, and whether it is a test.
fn artifact(message: &Value) -> Option<(bool, Program)> {
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

/// Name of a package by its identifier: `path+file:///...crates/servo#pb3dp-servo@0.1.0`, or `...tests#0.1.0` where the folder has its name.
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
