//! `cargo xtask python`: the Python package and its tests.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use crate::files::{copy, remove_folder};
use crate::pytest::{environment, pip_install, pytest};
use crate::workspace::{Workspace, run_visibly};

const TESTS: &str = "tests/python";
const PACKAGE: &str = "crates/python";
/// The module of Python as an example of its crate, which one build with all tests can contain.
const EXTENSION: &str = "pb3dp_extension";

/// Tests the Python package against the program (tests/python): the same bits, the stub and its docstrings, the pages, the notebook.
///
/// Needs python3 with its module venv; the packages of tests/python/requirements.txt go into a folder of their own. The module comes from
/// the build of all tests, which `cargo xtask ci` has built before. With --wheel, a wheel of the release is built by maturin, installed in
/// a new environment, and tested.
#[derive(Default, clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Run only tests whose names match this expression of pytest.
    filter: Option<String>,
    /// Build, install and test a wheel of the release.
    #[arg(long)]
    wheel: bool,
    /// Measure the time that the package adds to each call, and write docs/benchmarks/python.md.
    #[arg(long, requires = "wheel")]
    bench: bool,
    /// Write the docstrings of the module into its stub (crates/python/python/pb3dp/_pb3dp.pyi).
    #[arg(long, conflicts_with = "wheel")]
    stub: bool,
}

/// All tests with the programs in a folder, or after a build.
///
/// # Errors
/// If a test fails, or the machine lacks a requirement.
pub fn run(workspace: &Workspace, args: &Args, programs: Option<&Path>) -> anyhow::Result<()> {
    let python = if args.wheel { of_wheel(workspace)? } else { of_test_build(workspace)? };
    if args.stub {
        return run_visibly(python.command(workspace).arg(format!("{TESTS}/stub.py")));
    }
    if args.bench {
        return run_visibly(python.command(workspace).arg(format!("{TESTS}/overhead.py")));
    }
    // A test build, also beside a wheel of the release: the bits are the same in every profile.
    let programs = workspace.programs(programs, false)?;
    test(workspace, &python, &programs, args.filter.as_deref())
}

/// A Python that has the package.
struct Python {
    interpreter: PathBuf,
    /// Folder of the package, if it is not installed.
    path: Option<PathBuf>,
}

impl Python {
    /// The interpreter, which finds the package.
    fn command(&self, workspace: &Workspace) -> Command {
        let mut command = workspace.command(&self.interpreter);
        command.envs(self.path.iter().map(|path| ("PYTHONPATH", path)));
        command
    }
}

/// The package in a folder, with the module from the build of all tests: same features, same profile, so only the module is built.
fn of_test_build(workspace: &Workspace) -> anyhow::Result<Python> {
    let interpreter = environment(workspace, "python", TESTS)?;
    let programs = workspace.build(false, &["--workspace", "--example", EXTENSION])?;
    let path = workspace.target_folder()?.join("python-package");
    let package = path.join("pb3dp");
    let sources = workspace.root().join(PACKAGE).join("python/pb3dp");
    let files = std::fs::read_dir(&sources).with_context(|| format!("{} cannot be read", sources.display()))?;
    for file in files {
        let file = file?.path();
        if let (true, Some(name)) = (file.is_file(), file.file_name()) {
            copy(&file, &package.join(name))?;
        }
    }
    copy(&programs.join(format!("examples/lib{EXTENSION}.so")), &package.join("_pb3dp.abi3.so"))?;
    Ok(Python { interpreter, path: Some(path) })
}

/// A new environment with a wheel of the release.
fn of_wheel(workspace: &Workspace) -> anyhow::Result<Python> {
    let target = workspace.target_folder()?;
    let (name, wheels) = ("python-wheel", target.join("python-wheels"));
    for folder in [target.join(name), wheels.clone()] {
        remove_folder(&folder)?;
    }
    let interpreter = environment(workspace, name, TESTS)?;
    let mut build = workspace.command(&interpreter);
    build.args(["-m", "maturin", "build", "--release", "--locked", "--auditwheel", "skip", "--out"]).arg(&wheels);
    build.args(["--manifest-path", &format!("{PACKAGE}/Cargo.toml"), "--interpreter"]).arg(&interpreter);
    run_visibly(&mut build)?;
    let mut install = pip_install(workspace, &interpreter);
    install.args(["--no-deps", "--find-links"]).arg(&wheels).args(["--no-index", "pb3dp"]);
    run_visibly(&mut install)?;
    Ok(Python { interpreter, path: None })
}

fn test(workspace: &Workspace, python: &Python, programs: &Path, filter: Option<&str>) -> anyhow::Result<()> {
    let mut tests = pytest(workspace, &python.interpreter, TESTS, programs, filter)?;
    tests.env("MYPY_CACHE_DIR", workspace.target_folder()?.join("python-mypy"));
    if let Some(path) = &python.path {
        tests.env("PYTHONPATH", path).env("MYPYPATH", path);
    }
    run_visibly(&mut tests)
}
