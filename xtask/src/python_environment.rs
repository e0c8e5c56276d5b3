//! Python environments of tests that are written in Python.

use std::path::PathBuf;
use std::process::Command;

use crate::apt::{need, output_of};
use crate::not_possible::NotPossible;
use crate::workspace::{Workspace, run_visibly};

/// The Python of an environment with the packages that `requirements.txt` in the folder of the tests names.
///
/// # Errors
/// [`NotPossible`] where the packages cannot be installed; otherwise if python3 has no module venv.
pub fn environment(workspace: &Workspace, name: &str, tests: &str) -> anyhow::Result<PathBuf> {
    need("the module venv of python3", "python3-venv", || {
        output_of(Command::new("python3").args(["-c", "import ensurepip, venv"])).is_ok()
    })?;
    let folder = workspace.target_folder()?.join(name);
    let python = folder.join("bin/python");
    if !python.exists() {
        run_visibly(Command::new("python3").args(["-m", "venv"]).arg(&folder))?;
    }
    let requirements = workspace.root().join(tests).join("requirements.txt");
    let install = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--requirement"];
    let installed = output_of(Command::new(&python).args(install).arg(&requirements));
    installed
        .map_err(|error| NotPossible::because(format!("the packages of {tests} cannot be installed: {error:#}")))?;
    Ok(python)
}
