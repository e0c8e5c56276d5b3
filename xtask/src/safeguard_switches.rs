//! A build in which each safeguard of the safety chain can be disabled: a copy of the work tree with the switches of tests/safeguards.toml.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, ensure};

use crate::scratch::Scratch;
use crate::workspace::Workspace;

const SWITCHES: &str = "tests/safeguards.toml";
/// What the switches call. A run without safeguards has a thread whose name lists them.
const IS_OFF: &str = "
/// Whether the run on this thread has disabled the safeguard of this name.
pub(crate) fn is_off(name: &str) -> bool {
    std::thread::current().name().is_some_and(|names| names.split(\"; \").any(|off| off == name))
}
";

/// The command that builds and runs an example with the switches.
///
/// # Errors
/// If the copy cannot be written, or a switch does not fit the source.
pub fn example(workspace: &Workspace, package: &str, example: &str) -> anyhow::Result<Command> {
    let scratch = Scratch::new(workspace, "safeguards")?;
    for (file, source) in with_switches(workspace.root())? {
        std::fs::write(scratch.tree.join(&file), source).with_context(|| format!("cannot write {file}"))?;
    }
    let manifest = scratch.tree.join("Cargo.toml");
    std::fs::write(&manifest, with_own_version(&std::fs::read_to_string(&manifest)?)?)?;
    let mut command = workspace.cargo();
    // The lock file of the copy gets the version of the copy, and nothing else changes in it.
    command.args(["run", "--offline", "--package", package, "--example", example, "--"]);
    // The crates of others are built there already.
    command.current_dir(&scratch.tree).env("CARGO_TARGET_DIR", workspace.target_folder()?);
    Ok(command)
}

/// A manifest whose packages have another version. With the same one cargo takes the packages of the copy for those of the work tree: both
/// have one target folder, and the next build of the work tree would contain the switches.
fn with_own_version(manifest: &str) -> anyhow::Result<String> {
    let (start, end) =
        manifest.split_once("[workspace.package]\nversion = \"").context("Cargo.toml states no version")?;
    let (version, end) = end.split_once('"').context("Cargo.toml states no version")?;
    Ok(format!("{start}[workspace.package]\nversion = \"{version}+off\"{end}"))
}

/// The files that differ with the switches, by their paths.
fn with_switches(root: &Path) -> anyhow::Result<BTreeMap<String, String>> {
    let read = |file: &str| std::fs::read_to_string(root.join(file)).with_context(|| format!("cannot read {file}"));
    let switches: toml::Table = read(SWITCHES)?.parse().with_context(|| format!("{SWITCHES} is not TOML"))?;
    let edits = switches.get("edit").and_then(toml::Value::as_array).context("it has no edits").context(SWITCHES)?;
    let mut sources = BTreeMap::new();
    for edit in edits {
        let of = |key: &str| edit.get(key).and_then(toml::Value::as_str);
        let (Some(file), Some(old), Some(new)) = (of("file"), of("old"), of("new")) else {
            anyhow::bail!("{SWITCHES}: give file, old and new in {edit}");
        };
        let source = sources.remove(file).map_or_else(|| read(file), Ok)?;
        let count = source.matches(old).count();
        ensure!(count == 1, "{SWITCHES}: {file} contains {count} times, not once: {old}");
        sources.insert(file.to_owned(), source.replacen(old, new, 1));
        let library = file.split_once("/src/").map(|(package, _)| format!("{package}/src/lib.rs"));
        if let Some(library) = library.filter(|library| !sources.contains_key(library)) {
            let source = read(&library)? + IS_OFF;
            sources.insert(library, source);
        }
    }
    Ok(sources)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_switch_fits_the_source() {
        let sources = with_switches(Workspace::find().unwrap().root()).unwrap();
        let libraries: Vec<_> = sources.keys().filter(|file| file.ends_with("/src/lib.rs")).collect();
        let packages = ["crates/servo", "hal/arm-pa10-gateway", "hal/arm-pa10", "hal/middleware"];
        assert_eq!(libraries, packages.map(|package| format!("{package}/src/lib.rs")).iter().collect::<Vec<_>>());
        assert!(sources["hal/middleware/src/limiter.rs"].contains("crate::is_off(\"limiter: speed\")"));
    }

    /// A build of the work tree after the proofs once contained the switches.
    #[test]
    fn the_copy_is_built_as_other_packages() {
        let root = Workspace::find().unwrap().root().to_owned();
        let manifest = std::fs::read_to_string(root.join("Cargo.toml")).unwrap();
        let changed = with_own_version(&manifest).unwrap();
        let version = |text: &str| -> String {
            let manifest: toml::Table = text.parse().unwrap();
            manifest["workspace"]["package"]["version"].as_str().unwrap().to_owned()
        };
        assert_eq!(version(&changed), version(&manifest) + "+off");
        assert_eq!(changed.len(), manifest.len() + "+off".len());
    }
}
