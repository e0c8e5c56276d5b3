//! Packages of the distribution that checks need and a fresh machine lacks.

use std::process::{Command, Stdio};

use crate::not_possible::NotPossible;
use crate::workspace::output_of;

/// A server that does not answer fails the tests instead of blocking them.
const IMPATIENT: [&str; 6] =
    ["-o", "Acquire::http::Timeout=20", "-o", "Acquire::Retries=1", "-o", "DPkg::Lock::Timeout=60"];

/// apt-get without questions.
pub fn apt_get() -> Command {
    let mut command = Command::new("apt-get");
    command.args(["--quiet", "--quiet", "--yes"]).args(IMPATIENT);
    command.env("DEBIAN_FRONTEND", "noninteractive").stdin(Stdio::null());
    command
}

/// Whether this user may install packages.
pub fn is_root() -> bool {
    output_of(Command::new("id").arg("-u")).is_ok_and(|text| text.trim() == "0")
}

/// Installs a package if `runs` says that its program does not start, and this user may.
///
/// # Errors
/// [`NotPossible`], with the package to install.
pub fn need(program: &str, package: &str, runs: impl Fn() -> bool) -> anyhow::Result<()> {
    if runs() {
        return Ok(());
    }
    if !is_root() {
        return Err(NotPossible::because(format!(
            "{program} is missing: run `apt-get install --no-install-recommends {package}` as root"
        )));
    }
    println!("installing {package}");
    let install = || output_of(apt_get().args(["install", "--no-install-recommends", package]));
    // The package list may be empty or old.
    let installed = install().or_else(|_| output_of(apt_get().arg("update")).and_then(|_| install()));
    installed.map_err(|error| {
        NotPossible::because(format!("{program} is missing, and the installation of {package} failed: {error:#}"))
    })?;
    if !runs() {
        return Err(NotPossible::because(format!("{package} is installed, but {program} does not start")));
    }
    Ok(())
}
