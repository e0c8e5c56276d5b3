//! The oldest supported compiler.

use anyhow::Context;

use crate::not_possible::NotPossible;
use crate::workspace::{Workspace, run_visibly};

/// Checks the libraries and programs of the workspace with the compiler version in `rust-version`, if rustup has it or can
/// fetch it. Tests and benchmarks are ours, and nobody builds them with an older compiler.
///
/// # Errors
/// [`NotPossible`] if the compiler is not available; otherwise if a package does not build with it.
pub fn run(workspace: &Workspace) -> anyhow::Result<()> {
    let version = rust_version(workspace)?;
    let toolchain = format!("{version}.0");
    let has = |toolchain: &str| {
        let asked = workspace.output_of("rustup", &["run", toolchain, "rustc", "--version"]);
        asked.is_some_and(|said| said.contains(&version))
    };
    if !has(&toolchain) {
        let _ = workspace.output_of("rustup", &["toolchain", "install", &toolchain, "--profile", "minimal"]);
    }
    if !has(&toolchain) {
        return Err(NotPossible::because(format!(
            "rustc {version} is missing: run `rustup toolchain install {toolchain}`"
        )));
    }
    let mut command = workspace.command("rustup");
    command.args(["run", &toolchain, "cargo", "check", "--workspace", "--locked", "--quiet"]);
    // Some of the variables from the cargo that runs this command name its own compiler.
    for variable in ["CARGO", "RUSTC", "RUSTDOC", "RUSTUP_TOOLCHAIN"] {
        command.env_remove(variable);
    }
    command.env("CARGO_TARGET_DIR", workspace.target_folder()?.join("msrv"));
    run_visibly(&mut command)
}

fn rust_version(workspace: &Workspace) -> anyhow::Result<String> {
    let text = std::fs::read_to_string(workspace.root().join("Cargo.toml")).context("cannot read Cargo.toml")?;
    let manifest: toml::Table = text.parse()?;
    let version = manifest["workspace"]["package"]["rust-version"].as_str();
    Ok(version.context("Cargo.toml has no rust-version")?.to_owned())
}
