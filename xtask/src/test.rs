//! `cargo xtask test`: every test of the project.

use std::process::{Command, Stdio};

use anyhow::{Context, bail};

use crate::workspace::{Workspace, run_visibly};

/// Runs every test: unit tests, crate tests, examples in the documentation, whole-system tests.
///
/// This is `cargo test --workspace --no-fail-fast` with the locked dependencies; it needs no hardware, no network (once the
/// dependencies are there) and no further tool. The whole-system tests are the package `system-tests` in tests/. To run the
/// tests of one crate, or one test by a part of its name: `cargo test -p pb3dp-geometry`, `cargo test -p pb3dp-sim lag`.
/// With `--aarch64` it runs the unit tests of the crates with vector kernels as ARM programs in an emulator, which is how those of
/// NEON are tested on a PC. That needs a cross linker and QEMU, on Debian the packages gcc-aarch64-linux-gnu,
/// libc6-dev-arm64-cross and qemu-user-static, and `rustup target add aarch64-unknown-linux-gnu`.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// With optimisation: slower to build, quicker to run.
    #[arg(long)]
    release: bool,
    /// The unit tests of the crates with vector kernels for 64-bit ARM, in an emulator.
    #[arg(long)]
    aarch64: bool,
    /// Run only the tests whose name contains this.
    filter: Option<String>,
}

/// # Errors
/// If a test fails or does not build, or a tool for `--aarch64` is missing.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let mut command = if args.aarch64 { emulated_tests(workspace)? } else { all_tests(workspace) };
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

/// The crates that have code for one kind of processor.
const WITH_KERNELS: [&str; 2] = ["pb3dp-estimation", "pb3dp-camera-v4l2"];

/// The command that runs their unit tests as static ARM programs.
fn emulated_tests(workspace: &Workspace) -> anyhow::Result<Command> {
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
