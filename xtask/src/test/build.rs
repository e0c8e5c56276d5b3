//! One build of everything for the tests: one call of cargo, one set of features, one profile.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::Stdio;

use anyhow::{Context, bail};
use serde_json::Value;

use super::Selection;
use super::timings::{self, Unit};
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
#[derive(Debug)]
pub struct Built {
    /// Programs of the product, by name: `pb3dp`, `pb3dp-calibrate`.
    programs: Vec<(String, PathBuf)>,
    /// Cargo's target folder.
    target: PathBuf,
}

impl Built {
    /// Folder of the programs of the product.
    ///
    /// # Errors
    /// If the build had no programs.
    pub fn folder(&self) -> anyhow::Result<&Path> {
        let program =
            self.programs.iter().find(|(name, _)| name == "pb3dp").context("the build has no program pb3dp")?;
        program.1.parent().context("the path of pb3dp has no folder")
    }

    /// Build time of each unit, without units that were up to date.
    pub fn units(&self) -> Vec<Unit> {
        timings::units(&self.target.join("cargo-timings"))
    }
}

/// Builds the selected packages, and passes on each test program as soon as it is built. `before` is the prefix of the cargo command.
///
/// # Errors
/// If something does not build.
pub fn run(
    workspace: &Workspace,
    before: &[&str],
    packages: &Selection,
    mut ready: impl FnMut(Program),
) -> anyhow::Result<Built> {
    let selected = packages.arguments(|_| true);
    let mut command = workspace.cargo_after(before);
    command.arg("test").args(&selected).args(["--locked", "--no-run", "--lib", "--bins", "--tests", "--timings"]);
    let examples = TESTED_EXAMPLES.iter().filter(|(_, package)| packages.has(package));
    command.args(examples.flat_map(|(name, _)| ["--example", name]));
    command.args(["--quiet", "--message-format", "json-render-diagnostics"]);
    println!("$ cargo test {} --no-run", selected.join(" "));
    let mut child = command.stdout(Stdio::piped()).spawn().context("cannot run cargo")?;
    let output = child.stdout.take().context("cargo has no output")?;
    let mut built = Built { programs: Vec::new(), target: workspace.target_folder()? };
    let mut handover = Handover::new(&workspace.metadata()?, packages);
    for line in BufReader::new(output).lines() {
        let message: Value = serde_json::from_str(&line?).context("cargo did not print JSON")?;
        let Some((is_test, program)) = artifact(&message) else { continue };
        handover.take(is_test, &program).into_iter().for_each(&mut ready);
        if !is_test {
            built.programs.push((program.target, program.path));
        }
    }
    if !child.wait()?.success() {
        bail!("the tests do not build: see the compiler errors above");
    }
    Ok(built)
}

/// Delays test programs until the programs that they start are built. Cargo does not: it tells tests the future path of a
/// program, and may link the program after them.
struct Handover {
    /// Package and name of the programs that are not built yet.
    awaited: Vec<(String, String)>,
    held: Vec<Program>,
}

impl Handover {
    /// Reads `cargo metadata`.
    fn new(metadata: &Value, packages: &Selection) -> Self {
        let of = |value: &Value| value["name"].as_str().unwrap_or_default().to_owned();
        let mut awaited = Vec::new();
        let all = metadata["packages"].as_array().into_iter().flatten();
        for package in all.filter(|package| packages.has(&of(package))) {
            let targets = package["targets"].as_array().into_iter().flatten();
            awaited.extend(targets.filter(|target| target["kind"][0] == "bin").map(|target| (of(package), of(target))));
        }
        Self { awaited, held: Vec::new() }
    }

    /// The tests that can run after this program has been built.
    fn take(&mut self, is_test: bool, program: &Program) -> Vec<Program> {
        if is_test {
            self.held.push(program.clone());
        } else {
            self.awaited.retain(|(package, name)| *package != program.package || *name != program.target);
        }
        let must_wait = |program: &Program| {
            program.kind == "test" && self.awaited.iter().any(|(package, _)| *package == program.package)
        };
        self.held.extract_if(.., |program| !must_wait(program)).collect()
    }
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

/// Name of a package from its identifier: `path+file:///...crates/servo#pb3dp-servo@0.1.0`, or `...tests#0.1.0` if the folder has the same name.
fn package_of(id: &str, folder: &Path) -> String {
    let name = id.rsplit_once('#').and_then(|(_, tail)| tail.split_once('@')).map(|(name, _)| name.to_owned());
    name.unwrap_or_else(|| folder.file_name().unwrap_or_default().to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tests_wait_for_the_programs_that_they_start() {
        let package = |name: &str, kind: &str, target: &str| serde_json::json!({ "name": name, "targets": [{ "name": target, "kind": [kind] }] });
        let packages = [package("pb3dp-servo", "lib", "pb3dp_servo"), package("pb3dp-calibration", "bin", "calibrate")];
        let mut handover = Handover::new(&serde_json::json!({ "packages": packages }), &Selection::Everything);
        let program = |package: &str, kind: &str, target: &str| Program {
            package: package.to_owned(),
            target: target.to_owned(),
            kind: kind.to_owned(),
            path: PathBuf::new(),
            folder: PathBuf::new(),
        };
        let tests = program("pb3dp-calibration", "test", "integration");
        let unit_tests = program("pb3dp-calibration", "lib", "pb3dp_calibration");
        let others = program("pb3dp-servo", "test", "integration");
        assert_eq!(handover.take(true, &tests), []);
        assert_eq!(handover.take(true, &others), [others]);
        assert_eq!(handover.take(true, &unit_tests), [unit_tests]);
        // The unit tests of a program are not a program.
        assert_eq!(handover.take(true, &program("pb3dp-calibration", "bin", "calibrate")).len(), 1);
        assert_eq!(handover.take(false, &program("pb3dp-calibration", "bin", "calibrate")), [tests]);
    }

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
