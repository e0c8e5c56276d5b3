//! `cargo xtask check-deps`: who may know whom.

mod graph;
mod modules;
mod public_surface;
mod source;

use crate::violation::{Violation, conclude};
use crate::workspace::Workspace;

/// Checks who may know whom.
///
/// * Dependencies between our packages run downwards only, as in the table of xtask/src/check_deps/graph.rs; every package
///   of the workspace has its line there.
/// * No circle between the modules that a package's lib.rs declares.
/// * Who may name a backend is a list of modules; backends do not name each other, the estimation or the servo.
/// * The entry of the estimation has at most 120 public items, and no re-export without names.
/// * Nothing enables the feature `disabled-guards`, with which tests switch safeguards off, but who asks for it by name.
/// * serde stands in setup, cell, commissioning, orchestrator, record, benchmarks and calibration only.
/// * Files, threads, clocks, the environment, the network: each may be used only by the modules that the table of
///   xtask/src/check_deps/source.rs allows; tests are exempt.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {}

/// # Errors
/// If a rule is broken, or cargo or a file cannot be read.
pub fn run(workspace: &Workspace, _: &Args) -> anyhow::Result<()> {
    let packages = graph::packages(&workspace.metadata()?)?;
    let mut violations: Vec<Violation> = graph::check(&packages);
    let texts = workspace.texts(&[".rs"])?;
    for file in &texts {
        violations.extend(source::check(&file.path, &file.text));
    }
    violations.extend(modules::check(&texts));
    violations.extend(public_surface::check(&texts));
    conclude("check-deps", &format!("{} packages, {} Rust files", packages.len(), texts.len()), violations)
}
