//! Compilers other than the one that runs us: nightly for a few checks, and the oldest supported one.

use std::process::Command;

use anyhow::Context;

use crate::not_possible::NotPossible;
use crate::workspace::{Workspace, run_visibly};

/// The nightly cargo.
///
/// A missing component of it is fetched if the network permits.
///
/// # Errors
/// [`NotPossible`] without the nightly toolchain or a `component` of it (a cargo subcommand). The message gives the command.
pub fn nightly(workspace: &Workspace, component: Option<&str>) -> anyhow::Result<Command> {
    let plain = || cargo(workspace, "nightly");
    if !answers(&mut plain()) {
        let install = "rustup toolchain install nightly --profile minimal";
        return Err(NotPossible::because(format!("the nightly toolchain is missing: run `{install}`")));
    }
    let Some(component) = component else { return Ok(plain()) };
    let add = ["component", "add", "--toolchain", "nightly", component, "rust-src"];
    if !answers(plain().arg(component)) {
        let _ = workspace.output_of("rustup", &add);
    }
    match answers(plain().arg(component)) {
        true => Ok(plain()),
        false => Err(NotPossible::because(format!("{component} is missing: run `rustup {}`", add.join(" ")))),
    }
}

/// Checks the libraries and programs of the workspace with the compiler version in `rust-version`, if rustup has it or can
/// fetch it. Tests and benchmarks are ours, and nobody builds them with an older compiler.
///
/// # Errors
/// [`NotPossible`] if the compiler is not available; otherwise if a package does not build with it.
pub fn check_oldest(workspace: &Workspace) -> anyhow::Result<()> {
    let manifest: toml::Table = crate::files::read(&workspace.root().join("Cargo.toml"))?.parse()?;
    let version =
        manifest["workspace"]["package"]["rust-version"].as_str().context("Cargo.toml has no rust-version")?;
    let toolchain = format!("{version}.0");
    if !answers(&mut cargo(workspace, &toolchain)) {
        let _ = workspace.output_of("rustup", &["toolchain", "install", &toolchain, "--profile", "minimal"]);
    }
    if !answers(&mut cargo(workspace, &toolchain)) {
        return Err(NotPossible::because(format!(
            "rustc {version} is missing: run `rustup toolchain install {toolchain}`"
        )));
    }
    let mut command = cargo(workspace, &toolchain);
    command.args(["check", "--workspace", "--locked", "--quiet"]);
    run_visibly(command.env("CARGO_TARGET_DIR", workspace.target_folder()?.join("msrv")))
}

/// The cargo of a toolchain. Our own cargo sets variables that name its toolchain; with them the other cargo would use our rustc.
fn cargo(workspace: &Workspace, toolchain: &str) -> Command {
    let mut command = workspace.command("rustup");
    command.args(["run", toolchain, "cargo"]);
    for variable in ["CARGO", "RUSTC", "RUSTDOC", "RUSTUP_TOOLCHAIN", "RUSTFLAGS", "CARGO_ENCODED_RUSTFLAGS"] {
        command.env_remove(variable);
    }
    command
}

fn answers(command: &mut Command) -> bool {
    command.arg("--version").output().is_ok_and(|output| output.status.success())
}
