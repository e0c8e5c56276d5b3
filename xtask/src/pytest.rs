//! Tests that are written in Python.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::apt::need;
use crate::not_possible::NotPossible;
use crate::workspace::{Workspace, output_of, run_visibly};

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
    let requirements = format!("{tests}/requirements.txt");
    output_of(pip_install(workspace, &python).args(["--requirement", &requirements]))
        .map_err(|error| NotPossible::because(format!("the packages of {tests} cannot be installed: {error:#}")))?;
    Ok(python)
}

/// The command that installs packages in an environment.
pub fn pip_install(workspace: &Workspace, python: &Path) -> Command {
    let mut command = workspace.command(python);
    command.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"]);
    command
}

/// The command that runs the tests of a folder or file, with the programs in a folder; `filter` is an expression of pytest.
///
/// # Errors
/// Those of [`Workspace::metadata`].
pub fn pytest(
    workspace: &Workspace,
    python: &Path,
    tests: &str,
    programs: &Path,
    filter: Option<&str>,
) -> anyhow::Result<Command> {
    let cache = workspace.target_folder()?.join("pytest-cache").join(tests);
    let mut command = workspace.command(python);
    command.args(["-m", "pytest", "--quiet", "-o", &format!("cache_dir={}", cache.display()), tests]);
    command.args(filter.into_iter().flat_map(|filter| ["-k", filter]));
    command.env("PB3DP", programs.join("pb3dp")).env("PYTHONDONTWRITEBYTECODE", "1");
    Ok(command)
}
