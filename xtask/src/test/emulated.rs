//! Unit tests as programs for 64-bit ARM.

use std::process::{Command, Stdio};

use anyhow::{Context, bail};

use crate::workspace::Workspace;

/// The crates with code for one kind of processor.
const WITH_KERNELS: [&str; 6] = [
    "pb3dp-estimation-core",
    "pb3dp-estimation-views",
    "pb3dp-estimation-direct",
    "pb3dp-estimation-track",
    "pb3dp-estimation-published",
    "pb3dp-camera-v4l2",
];

/// The command that runs their unit tests as static ARM programs.
pub fn tests(workspace: &Workspace) -> anyhow::Result<Command> {
    const LINKER: &str = "aarch64-linux-gnu-gcc";
    let emulators = ["qemu-aarch64-static", "qemu-aarch64"];
    if !is_there(LINKER) {
        bail!("--aarch64 needs the linker {LINKER}: install gcc-aarch64-linux-gnu and libc6-dev-arm64-cross");
    }
    let emulator = emulators.into_iter().find(|name| is_there(name));
    let emulator = emulator.with_context(|| format!("--aarch64 needs {}: install qemu-user-static", emulators[0]))?;
    let mut command = workspace.cargo();
    command.args(["test", "--lib", "--locked", "--target", "aarch64-unknown-linux-gnu"]);
    command.args(WITH_KERNELS.iter().flat_map(|package| ["-p", package]));
    let variable = |name: &str| format!("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_{name}");
    command.env(variable("LINKER"), LINKER).env(variable("RUNNER"), emulator);
    command.env(variable("RUSTFLAGS"), "-C target-feature=+crt-static");
    Ok(command)
}

/// Whether a program can be started.
fn is_there(program: &str) -> bool {
    let mut command = Command::new(program);
    command.arg("--version").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}
