//! `cargo xtask recordings`: recordings that other programs read, recordings of others, and pixels of cameras as others decode them.

use std::path::{Path, PathBuf};

use crate::not_possible::NotPossible;
use crate::python_environment;
use crate::workspace::{Workspace, run_visibly};

const TESTS: &str = "tests/recordings";

/// Lets other libraries read a recorded run, tracks recordings that other libraries wrote, and compares the pixels of emulated cameras with
/// those that OpenCV decodes (tests/recordings).
///
/// Needs python3 with its module venv; the packages of tests/recordings/requirements.txt go into a folder of their own.
#[derive(Default, clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Run only tests whose names match this expression of pytest.
    filter: Option<String>,
    /// Use the release program.
    #[arg(long)]
    release: bool,
    /// Also let Rerun read a recording, as `cargo xtask ci` does; its package takes 450 MB.
    #[arg(long)]
    rerun: bool,
}

/// # Errors
/// If a test fails, or the machine lacks a requirement.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let programs = build(workspace, args.release)?;
    let python = python_environment::environment(workspace, "recordings-python", TESTS)?;
    if args.rerun {
        install_rerun(workspace, &python)?;
    }
    with_program(workspace, &programs, &python, args)
}

/// All tests with the programs in a folder, or after a build; those with Rerun if it can be installed.
///
/// # Errors
/// Those of [`run`].
pub fn check(workspace: &Workspace, programs: Option<&Path>) -> anyhow::Result<()> {
    let programs = programs.map_or_else(|| build(workspace, false), |programs| Ok(programs.to_path_buf()))?;
    let python = python_environment::environment(workspace, "recordings-python", TESTS)?;
    let rerun = install_rerun(workspace, &python).map_err(|why| println!("NOT CHECKED: {why:#}")).is_ok();
    with_program(workspace, &programs, &python, &Args { rerun, ..Args::default() })
}

/// Builds the program; returns its folder.
fn build(workspace: &Workspace, is_release: bool) -> anyhow::Result<PathBuf> {
    let mut build = workspace.cargo();
    build.args(["build", "--locked", "--package", "pb3dp-orchestrator", "--bin", "pb3dp"]);
    if is_release {
        build.arg("--release");
    }
    run_visibly(&mut build)?;
    Ok(workspace.target_folder()?.join(if is_release { "release" } else { "debug" }))
}

fn install_rerun(workspace: &Workspace, python: &Path) -> anyhow::Result<()> {
    let mut install = workspace.command(python);
    install.args(["-m", "pip", "install", "--quiet", "--requirement", &format!("{TESTS}/requirements-rerun.txt")]);
    run_visibly(&mut install).map_err(|error| {
        let why = format!("the package of Rerun cannot be installed: {error:#}; try again with a network");
        NotPossible::because(why)
    })
}

fn with_program(workspace: &Workspace, programs: &Path, python: &Path, args: &Args) -> anyhow::Result<()> {
    let cache = format!("cache_dir={}", workspace.target_folder()?.join("recordings-cache").display());
    let pixels = emulated_pair(workspace, args.release)?;
    let mut tests = workspace.command(python);
    tests.args(["-m", "pytest", "--quiet", "-o", &cache, TESTS]);
    if let Some(filter) = &args.filter {
        tests.args(["-k", filter]);
    }
    tests.env("PB3DP", programs.join("pb3dp")).env("PB3DP_EMULATED_PAIR", pixels).env("PYTHONDONTWRITEBYTECODE", "1");
    if args.rerun {
        tests.env("PB3DP_RERUN", "1");
    }
    run_visibly(&mut tests)
}

/// The program that gives a pair of emulated cameras.
fn emulated_pair(workspace: &Workspace, is_release: bool) -> anyhow::Result<PathBuf> {
    const EXAMPLE: &str = "emulated_pair";
    let mut build = workspace.cargo();
    build.args(["build", "--locked", "--package", "pb3dp-camera-v4l2", "--example", EXAMPLE]);
    if is_release {
        build.arg("--release");
    }
    run_visibly(&mut build)?;
    let profile = if is_release { "release" } else { "debug" };
    Ok(workspace.target_folder()?.join(profile).join("examples").join(EXAMPLE))
}
