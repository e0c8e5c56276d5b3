//! `cargo xtask panel`: drives the operator panel with a browser.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::Context;

use crate::apt::need;
use crate::files::remove_folder;
use crate::not_possible::NotPossible;
use crate::pytest::{environment, pytest};
use crate::workspace::{PROGRAM, Workspace, run_visibly};

const TESTS: &str = "tests/panel";
const LONG_TESTS: &str = "tests/panel/long_panel.py";
const FROM_CLONE: &str = "tests/panel/from_clone.py";
/// A machine that wakes a thread later than this says nothing about the panel: a page that it holds up for half a second is silent, and
/// the arms hold, as they must. Chosen by hand.
const HELD_UP: Duration = Duration::from_millis(150);
const ARTEFACTS: &str = "out/panel";
/// Browsers that the tests accept, the first one is installed where there is none.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];

/// Drives the operator panel with a browser: the real program, the simulated cell, and Chromium (tests/panel).
///
/// A test that fails is tried once more. Screenshots are written to out/panel. Needs python3 with its module venv, and Chromium; the packages of tests/panel/requirements.txt
/// go into a folder of their own. Chromium and the module are installed by apt-get if permitted.
#[derive(Default, clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Run only tests whose names match this expression of pytest.
    filter: Option<String>,
    /// Use the release program.
    #[arg(long)]
    release: bool,
    /// Run the tests that take minutes instead: no false stop in ten minutes, the time from silence to stop, and from the button.
    #[arg(long)]
    long: bool,
    /// Follow the README instead, with a stopwatch, from a fresh clone of the last commit to a hand that follows. Writes the transcript
    /// out/panel/from_clone.txt. Run nothing else meanwhile (10 minutes).
    #[arg(long, conflicts_with_all = ["long", "filter", "release"])]
    from_clone: bool,
}

/// # Errors
/// If a test fails, or the machine lacks a requirement.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    if args.from_clone {
        return from_clone(workspace, args);
    }
    with_program(workspace, &workspace.build(args.release, &PROGRAM)?, args)
}

/// The steps of the README in a fresh clone, which is removed afterwards.
fn from_clone(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    let clone = workspace.target_folder()?.join("from-clone");
    remove_folder(&clone)?;
    let mut git = workspace.command("git");
    git.args(["clone", "--quiet", "--no-hardlinks"]).arg(workspace.root()).arg(&clone);
    run_visibly(&mut git)?;
    let result = with_program(workspace, &clone.join("target/release"), args);
    remove_folder(&clone)?;
    result
}

/// All tests with the programs in a folder, or after a build.
///
/// # Errors
/// Those of [`run`]; [`NotPossible`] if tests failed while the machine held threads up.
pub fn check(workspace: &Workspace, programs: Option<&Path>) -> anyhow::Result<()> {
    let witness = Witness::start();
    let programs = workspace.programs(programs, false);
    let result = programs.and_then(|programs| with_program(workspace, &programs, &Args::default()));
    let late = witness.end();
    match result {
        Err(error) if late > HELD_UP && error.downcast_ref::<NotPossible>().is_none() => {
            Err(NotPossible::because(format!(
                "browser tests failed, and this machine held a thread up for {late:?}: repeat them on a quiet one by cargo xtask panel"
            )))
        }
        result => result,
    }
}

/// A thread that only sleeps, and measures how much too late it wakes up.
struct Witness {
    is_over: Arc<AtomicBool>,
    thread: JoinHandle<Duration>,
}

impl Witness {
    fn start() -> Self {
        const SLEEP: Duration = Duration::from_millis(5);
        let is_over = Arc::<AtomicBool>::default();
        let its_end = Arc::clone(&is_over);
        let thread = std::thread::spawn(move || {
            let mut late = Duration::ZERO;
            while !its_end.load(Ordering::SeqCst) {
                let before = Instant::now();
                std::thread::sleep(SLEEP);
                late = late.max(before.elapsed().saturating_sub(SLEEP));
            }
            late
        });
        Self { is_over, thread }
    }

    /// The longest lateness so far.
    fn end(self) -> Duration {
        self.is_over.store(true, Ordering::SeqCst);
        self.thread.join().unwrap_or_default()
    }
}

fn with_program(workspace: &Workspace, programs: &Path, args: &Args) -> anyhow::Result<()> {
    let python = environment(workspace, "panel-python", TESTS)?;
    let browser = browser()?;
    let artefacts = workspace.root().join(ARTEFACTS);
    remove_folder(&artefacts)?;
    let (folder, shows_output) = match (args.long, args.from_clone) {
        (true, _) => (LONG_TESTS, true),
        (_, true) => (FROM_CLONE, true),
        _ => (TESTS, false),
    };
    let tests = |more: &[&str]| {
        let mut tests = pytest(workspace, &python, folder, programs, args.filter.as_deref())?;
        tests.args(shows_output.then_some("--capture=no")).args(more).env("PB3DP_CHROMIUM", &browser);
        // The programs are in its target/release.
        if let (true, Some(clone)) = (args.from_clone, programs.ancestors().nth(2)) {
            tests.env("PB3DP_CLONE", clone);
        }
        run_visibly(tests.env("PB3DP_PANEL_ARTEFACTS", &artefacts))
    };
    let first = tests(&[]);
    if first.is_ok() || args.long || args.from_clone {
        return first;
    }
    println!(
        "What failed is tried once more: a page that this machine holds up for half a second is silent, and every arm holds."
    );
    tests(&["--last-failed"])
}

fn browser() -> anyhow::Result<PathBuf> {
    if let Some(browser) = std::env::var_os("PB3DP_CHROMIUM") {
        return Ok(browser.into());
    }
    let found = || {
        let paths = std::env::var_os("PATH").unwrap_or_default();
        let all = std::env::split_paths(&paths).flat_map(|folder| BROWSERS.map(|name| folder.join(name)));
        all.into_iter().find(|path| path.is_file())
    };
    need("Chromium", BROWSERS[0], || found().is_some())?;
    found().context("Chromium was installed and is not there")
}
