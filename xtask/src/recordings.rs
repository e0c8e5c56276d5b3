//! `cargo xtask recordings`: recordings that other programs read, recordings of others, and pixels of cameras as others decode them.

use std::path::Path;

use crate::not_possible::NotPossible;
use crate::pytest::{environment, pip_install, pytest};
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
    let programs = workspace.programs(None, args.release)?;
    let python = environment(workspace, "recordings-python", TESTS)?;
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
    let programs = workspace.programs(programs, false)?;
    let python = environment(workspace, "recordings-python", TESTS)?;
    let rerun = install_rerun(workspace, &python).map_err(|why| println!("NOT CHECKED: {why:#}")).is_ok();
    with_program(workspace, &programs, &python, &Args { rerun, ..Args::default() })
}

fn install_rerun(workspace: &Workspace, python: &Path) -> anyhow::Result<()> {
    let requirements = format!("{TESTS}/requirements-rerun.txt");
    run_visibly(pip_install(workspace, python).args(["--requirement", &requirements])).map_err(|error| {
        let why = format!("the package of Rerun cannot be installed: {error:#}; try again with a network");
        NotPossible::because(why)
    })
}

fn with_program(workspace: &Workspace, programs: &Path, python: &Path, args: &Args) -> anyhow::Result<()> {
    // The program that gives a pair of emulated cameras.
    let pair = ["--package", "pb3dp-camera-v4l2", "--example", "emulated_pair"];
    let pixels = workspace.build(args.release, &pair)?.join("examples/emulated_pair");
    let mut tests = pytest(workspace, python, TESTS, programs, args.filter.as_deref())?;
    tests.env("PB3DP_EMULATED_PAIR", pixels).envs(args.rerun.then_some(("PB3DP_RERUN", "1")));
    run_visibly(&mut tests)
}
