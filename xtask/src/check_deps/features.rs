//! One set of features: a build of one package has the features of the build of all.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::Context;

use crate::violation::Violation;
use crate::workspace::{Workspace, output_of};

/// Where features are added that a single package lacks.
const FILE: &str = "crates/third-party/Cargo.toml";

/// Packages of each floor, which are built by themselves: `cargo build --bin pb3dp`, `cargo test -p NAME`.
const BUILT_ALONE: [&str; 9] = [
    "pb3dp-servo",
    "pb3dp-estimation",
    "pb3dp-arm-pa10-gateway",
    "pb3dp-sim",
    "pb3dp-cell",
    "pb3dp-panel",
    "pb3dp-orchestrator",
    "pb3dp-benchmarks",
    "system-tests",
];

/// What runs in our programs; then also macros and build scripts, whose crates have features of their own.
const EDGES: [&str; 2] = ["normal,dev,no-proc-macro", "normal,dev,build"];

/// The sets of features with which a crate is built, by `name vVERSION`.
type Features = BTreeMap<String, BTreeSet<BTreeSet<String>>>;

/// Compares the features of third-party crates in a build of a package with those in the build of the workspace.
///
/// # Errors
/// If `cargo tree` cannot be run or read.
pub fn check(workspace: &Workspace) -> anyhow::Result<Vec<Violation>> {
    let mut violations = Vec::new();
    for edges in EDGES {
        let all = features(&tree(workspace, edges, &["--workspace"])?)?;
        for package in BUILT_ALONE {
            violations.extend(compare(package, &features(&tree(workspace, edges, &["-p", package])?)?, &all));
        }
    }
    Ok(violations)
}

fn tree(workspace: &Workspace, edges: &str, of: &[&str]) -> anyhow::Result<String> {
    let format = ["tree", "--locked", "--prefix", "none", "--format", "{p}|{f}", "--edges", edges];
    output_of(workspace.cargo().args(format).args(of))
}

/// Reads lines such as `log v0.4.35|alloc,std (*)`.
fn features(tree: &str) -> anyhow::Result<Features> {
    let mut read = Features::new();
    for line in tree.lines().filter(|line| !line.is_empty()) {
        let (package, features) = line.trim_end_matches(" (*)").split_once('|').with_context(|| line.to_owned())?;
        let name = package.split(' ').take(2).collect::<Vec<_>>().join(" ");
        let features = features.split(',').filter(|feature| !feature.is_empty()).map(str::to_owned).collect();
        read.entry(name).or_default().insert(features);
    }
    Ok(read)
}

fn compare(package: &str, alone: &Features, all: &Features) -> Vec<Violation> {
    let none = BTreeSet::new();
    let differing = alone.iter().flat_map(|(name, sets)| sets.iter().map(move |features| (name, features)));
    let differing = differing.filter(|(name, features)| !all.get(*name).unwrap_or(&none).contains(*features));
    let differences = differing.map(|(name, features)| {
        let more = all.get(name).into_iter().flatten().next().into_iter().flatten();
        let missing: Vec<&str> = more.filter(|feature| !features.contains(*feature)).map(String::as_str).collect();
        let message = format!(
            "a build of {package} alone has {name} without the features {}, so it is built twice; add them here",
            missing.join(", ")
        );
        Violation::of(FILE, "features", message)
    });
    differences.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_feature_that_only_the_workspace_has_is_named() {
        let all =
            features("pb3dp-geometry v0.1.0 (/x)|\nlog v0.4.35|alloc,std\nsyn v2.0.1 (proc-macro)|full (*)\n").unwrap();
        let one = |text: &str| compare("pb3dp-servo", &features(text).unwrap(), &all);
        assert_eq!(one("log v0.4.35|alloc,std (*)\nsyn v2.0.1|full"), []);
        let [violation] = one("log v0.4.35|\nsyn v2.0.1|full").try_into().unwrap();
        assert!(violation.message.contains("log v0.4.35 without the features alloc, std"), "{violation}");
        assert!(features("no bar").is_err());
    }
}
