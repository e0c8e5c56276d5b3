//! The crates that the program contains.

use std::collections::BTreeSet;

use anyhow::Context;
use serde_json::Value;

use crate::workspace::{Workspace, output_of};

/// The package of the program.
pub const PROGRAM: &str = "pb3dp-orchestrator";

/// The crates linked into the program, itself included, as `cargo metadata` describes them: without build scripts' and tests'
/// dependencies.
///
/// # Errors
/// If cargo does not list them.
pub fn crates(workspace: &Workspace) -> anyhow::Result<Vec<Value>> {
    let tree = ["tree", "--locked", "--package", PROGRAM, "--edges", "normal", "--prefix", "none"];
    let listed = output_of(workspace.cargo().args(tree).args(["--format", "{p}"]))?;
    let linked: BTreeSet<(&str, &str)> = listed.lines().filter_map(name_and_version).collect();
    let mut metadata = workspace.metadata()?;
    let packages = metadata["packages"].as_array_mut().context("`packages` is missing from cargo metadata")?;
    let mut packages = std::mem::take(packages);
    let key = |package: &Value, key: &str| package[key].as_str().unwrap_or_default().to_owned();
    packages.retain(|package| linked.contains(&(&*key(package, "name"), &*key(package, "version"))));
    Ok(packages)
}

/// `serde v1.0.228 (proc-macro)`.
fn name_and_version(line: &str) -> Option<(&str, &str)> {
    let mut words = line.split_whitespace();
    Some((words.next()?, words.next()?.strip_prefix('v')?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_cargo_tree_give_name_and_version() {
        assert_eq!(name_and_version("serde v1.0.228"), Some(("serde", "1.0.228")));
        assert_eq!(name_and_version("serde_derive v1.0.228 (proc-macro) (*)"), Some(("serde_derive", "1.0.228")));
        assert_eq!(name_and_version(""), None);
    }
}
