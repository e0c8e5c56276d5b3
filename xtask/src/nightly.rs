//! The nightly compiler, for a few checks.

use std::process::Command;

use crate::not_possible::NotPossible;
use crate::workspace::Workspace;

/// The nightly cargo. `rustup run` selects the toolchain, because the cargo that runs us belongs to one toolchain.
///
/// A missing component of it is fetched if the network permits.
///
/// # Errors
/// [`NotPossible`] without the nightly toolchain or a `component` of it (a cargo subcommand). The message gives the command.
pub fn cargo(workspace: &Workspace, component: Option<&str>) -> anyhow::Result<Command> {
    if !answers(&mut plain(workspace)) {
        let install = "rustup toolchain install nightly --profile minimal";
        return Err(NotPossible::because(format!("the nightly toolchain is missing: run `{install}`")));
    }
    let Some(component) = component else { return Ok(plain(workspace)) };
    if answers(plain(workspace).arg(component)) {
        return Ok(plain(workspace));
    }
    let add = ["component", "add", "--toolchain", "nightly", component, "rust-src"];
    let _ = workspace.output_of("rustup", &add);
    match answers(plain(workspace).arg(component)) {
        true => Ok(plain(workspace)),
        false => Err(NotPossible::because(format!("{component} is missing: run `rustup {}`", add.join(" ")))),
    }
}

/// Our own cargo sets variables that name its toolchain; with them the nightly cargo would use the stable rustc.
fn plain(workspace: &Workspace) -> Command {
    let mut command = workspace.command("rustup");
    command.args(["run", "nightly", "cargo"]);
    for variable in ["CARGO", "RUSTC", "RUSTDOC", "RUSTUP_TOOLCHAIN", "RUSTFLAGS", "CARGO_ENCODED_RUSTFLAGS"] {
        command.env_remove(variable);
    }
    command
}

fn answers(command: &mut Command) -> bool {
    command.arg("--version").output().is_ok_and(|output| output.status.success())
}
