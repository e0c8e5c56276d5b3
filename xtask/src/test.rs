//! `cargo xtask test`: every test of the project.

use std::process::Command;

use crate::workspace::{Workspace, run_visibly};

/// Runs every test: unit tests, crate tests, examples in the documentation, whole-system tests.
///
/// This is `cargo test --workspace --no-fail-fast` with the locked dependencies; it needs no hardware, no network (once the
/// dependencies are there) and no further tool. The whole-system tests are the package `system-tests` in tests/. To run the
/// tests of one crate, or one test by a part of its name: `cargo test -p pb3dp-geometry`, `cargo test -p pb3dp-sim lag`.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// With optimisation: slower to build, quicker to run.
    #[arg(long)]
    release: bool,
    /// Run only the tests whose name contains this.
    filter: Option<String>,
}

/// # Errors
/// If a test fails or does not build.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let mut command = all_tests(workspace);
    if args.release {
        command.arg("--release");
    }
    command.args(args.filter.as_ref());
    run_visibly(&mut command)
}

/// The command that runs every test.
pub fn all_tests(workspace: &Workspace) -> Command {
    let mut command = workspace.cargo();
    command.args(["test", "--workspace", "--locked", "--no-fail-fast"]);
    command
}
