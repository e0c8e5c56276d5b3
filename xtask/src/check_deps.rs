//! `cargo xtask check-deps`: rules for dependencies and access to the system.

mod features;
mod graph;
mod modules;
mod public_surface;
mod source;

use crate::packages;
use crate::violation::{Violation, conclude};
use crate::workspace::{Workspace, output_of};

/// Checks the rules for dependencies between packages and modules, and for access to the system.
///
/// Dependencies between packages go downwards, as in the table of xtask/src/check_deps/graph.rs, and those between modules form no
/// cycle; files, threads, clocks, the environment and the network are used in the places of xtask/src/check_deps/source.rs. The table
/// of all rules is in CONTRIBUTING.md.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {}

/// # Errors
/// If a rule is violated, or cargo or a file cannot be read.
pub fn run(workspace: &Workspace, _: &Args) -> anyhow::Result<()> {
    let metadata = workspace.metadata()?;
    let packages = packages::of(&metadata)?;
    let mut violations: Vec<Violation> = graph::check(&packages);
    let texts = workspace.texts(&[".rs"])?;
    for file in &texts {
        violations.extend(source::check(&file.path, &file.text));
    }
    violations.extend(modules::check(&texts));
    violations.extend(public_surface::check(&texts));
    violations.extend(fuzz_lock(workspace));
    violations.extend(features::check(workspace)?);
    conclude("check-deps", &format!("{} packages, {} Rust files", packages.len(), texts.len()), violations)
}

/// The fuzz targets are a workspace of their own: their lock file has what the manifests of our packages ask for. Without a network
/// and their dependencies this is not checked.
fn fuzz_lock(workspace: &Workspace) -> Option<Violation> {
    const MANIFEST: &str = "tests/fuzz/Cargo.toml";
    let words = ["metadata", "--locked", "--format-version", "1", "--manifest-path", MANIFEST];
    let error = output_of(workspace.cargo().args(words)).err()?.to_string();
    let message =
        format!("run `cargo metadata --format-version 1 --manifest-path {MANIFEST}`, and commit the lock file");
    error.contains("because --locked was passed").then(|| Violation::of("tests/fuzz/Cargo.lock", "fuzz-lock", message))
}
