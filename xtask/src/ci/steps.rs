//! The steps of `cargo xtask ci`.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};

use super::changes::Changes;
use super::space;
use crate::test::Selection;
use crate::workspace::{Workspace, run_visibly};
use crate::{
    bench, check_deps, commissioning, fuzz_build, licences, miri, panel, python_package, recordings, required, test,
    tidy, toolchains, vm,
};

/// Context of the steps.
pub struct Progress<'a> {
    /// The workspace.
    pub workspace: &'a Workspace,
    /// The change.
    pub changes: Changes,
    /// Whether a single step runs.
    pub is_alone: bool,
    /// Results of the step `test`.
    pub tested: Option<test::Tested>,
    /// The build of the programs for emulated computers, beside the tests and the steps after them.
    pub ahead: Option<Beside>,
    /// A command that runs beside the later steps.
    pub beside: Option<Beside>,
}

/// A command that runs beside the later steps, because it keeps one processor busy only.
pub struct Beside {
    /// Name of its step.
    pub name: &'static str,
    child: Child,
    log: PathBuf,
    begin: Instant,
}

impl Beside {
    /// Starts a command, with its output in a file.
    fn start(name: &'static str, command: &mut Command, log: PathBuf) -> anyhow::Result<Self> {
        let file = File::create(&log).with_context(|| format!("cannot create {}", log.display()))?;
        let errors = file.try_clone().context("cannot duplicate a file")?;
        let child = command.stdout(file).stderr(errors).spawn().with_context(|| format!("{name} does not start"))?;
        Ok(Self { name, child, log, begin: Instant::now() })
    }

    /// Waits for its end, and prints its output.
    ///
    /// # Errors
    /// If it failed.
    pub fn end(mut self) -> (Duration, anyhow::Result<()>) {
        let ended = self.child.wait();
        let time = self.begin.elapsed();
        print!("== {}, beside the steps above\n{}", self.name, std::fs::read_to_string(&self.log).unwrap_or_default());
        let result = match ended {
            Ok(status) if status.success() => Ok(()),
            Ok(status) => Err(anyhow!("`{}` failed ({status})", self.name)),
            Err(error) => Err(error.into()),
        };
        (time, result)
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        // After a failure of another step its result is of no use. It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Progress<'_> {
    /// Waits for the build beside the steps. If it failed, so does the next one, and says why.
    fn end_build(&mut self) {
        if let Some(ahead) = self.ahead.take() {
            let _ = ahead.end();
        }
    }

    /// Folder of the programs that the step `test` built, if it ran.
    fn programs(&self) -> Option<&Path> {
        self.tested.as_ref().and_then(|tested| tested.built.folder().ok())
    }
}

/// The changes for which a step runs.
#[derive(Clone, Copy)]
pub enum Due {
    /// All.
    Always,
    /// Those that affect the product of one of these packages.
    Product(&'static [&'static str]),
    /// Those that affect the product or the tests of one of these packages.
    Tests(&'static [&'static str]),
}

impl Due {
    /// Whether a step is due after these changes.
    pub fn after(self, changes: &Changes) -> bool {
        match self {
            Self::Always => true,
            Self::Product(packages) => packages.iter().any(|package| changes.change(package)),
            Self::Tests(packages) => changes.touch(packages),
        }
    }
}

/// A step.
pub struct Step {
    /// Name on the command line.
    pub name: &'static str,
    /// When it runs.
    pub due: Due,
    /// Runs the step.
    pub run: fn(&mut Progress<'_>) -> anyhow::Result<()>,
}

/// Packages with unsafe kernels or fuzz targets.
const KERNELS: &[&str] = &[
    "pb3dp-estimation-core",
    "pb3dp-estimation-views",
    "pb3dp-estimation-direct",
    "pb3dp-estimation-track",
    "pb3dp-estimation-published",
    "pb3dp-camera-pixels",
];
/// Packages with safeguards.
const GUARDED: &[&str] = &["pb3dp-servo", "pb3dp-hal-middleware", "pb3dp-arm-pa10", "pb3dp-arm-pa10-gateway"];
const FUZZED: &[&str] = &["pb3dp-estimation", "pb3dp-arm-pa10-test-support"];
/// Files that affect every package: manifests, the lock file and the toolchain.
const MANIFESTS: &[&str] = &["manifests"];

/// The steps, the fastest first.
pub const STEPS: [Step; 19] = [
    Step { name: "space", due: Due::Always, run: |progress| space::check(progress.workspace) },
    Step { name: "fmt", due: Due::Always, run: |progress| fmt(progress.workspace) },
    Step { name: "tidy", due: Due::Always, run: |progress| tidy::run(progress.workspace, &tidy::Args {}) },
    Step {
        name: "check-deps",
        due: Due::Always,
        run: |progress| check_deps::run(progress.workspace, &check_deps::Args {}),
    },
    Step { name: "licences", due: Due::Always, run: |progress| licences::run(progress.workspace) },
    Step { name: "advisories", due: Due::Always, run: |progress| licences::advisories(progress.workspace) },
    Step { name: "clippy", due: Due::Always, run: |progress| clippy(progress.workspace) },
    Step { name: "doc", due: Due::Always, run: |progress| doc(progress.workspace) },
    Step { name: "test", due: Due::Always, run: tests },
    Step {
        name: "commissioning",
        due: Due::Product(&["pb3dp-calibration", "pb3dp-orchestrator"]),
        run: |progress| {
            let args = commissioning::Args { calibrate_only: true, release: false };
            commissioning::run(progress.workspace, &args, progress.programs())
        },
    },
    Step {
        name: "recordings",
        due: Due::Product(&["pb3dp-bag", "pb3dp-recording", "pb3dp-camera-replay", "pb3dp-orchestrator"]),
        run: |progress| recordings::check(progress.workspace, progress.programs()),
    },
    Step {
        name: "python",
        due: Due::Tests(&["pb3dp-python", "pb3dp-orchestrator"]),
        run: |progress| python_package::run(progress.workspace, &python_package::Args::default(), progress.programs()),
    },
    Step { name: "panel", due: Due::Tests(&["pb3dp-panel"]), run: driven_panel },
    Step { name: "accuracy", due: Due::Product(&[MEASURED]), run: accuracy },
    Step {
        name: "vm",
        due: Due::Tests(&["pb3dp-arm-pa10-emulation", "pb3dp-camera-v4l2", "system-tests"]),
        run: guests,
    },
    Step { name: "safeguards", due: Due::Product(GUARDED), run: |progress| bench::safeguards(progress.workspace) },
    Step { name: "fuzz", due: Due::Tests(FUZZED), run: |progress| fuzz_build::run(progress.workspace) },
    Step { name: "miri", due: Due::Product(KERNELS), run: |progress| miri::run(progress.workspace) },
    Step { name: "msrv", due: Due::Product(MANIFESTS), run: |progress| toolchains::check_oldest(progress.workspace) },
];

/// Fails with the install command if a component of the toolchain is missing.
fn require(workspace: &Workspace, command: &str, component: &str) -> anyhow::Result<()> {
    let status = workspace.cargo().args([command, "--version"]).output().context("cannot run cargo")?.status;
    if !status.success() {
        bail!("`cargo {command}` is missing: run `rustup component add {component}`");
    }
    Ok(())
}

fn fmt(workspace: &Workspace) -> anyhow::Result<()> {
    require(workspace, "fmt", "rustfmt")?;
    run_visibly(workspace.cargo().args(["fmt", "--all", "--check"]))
}

fn clippy(workspace: &Workspace) -> anyhow::Result<()> {
    require(workspace, "clippy", "clippy")?;
    let args = ["clippy", "--workspace", "--all-targets", "--locked", "--", "-D", "warnings"];
    run_visibly(workspace.cargo().args(args))
}

fn doc(workspace: &Workspace) -> anyhow::Result<()> {
    let mut command = workspace.cargo();
    command.args(["doc", "--workspace", "--no-deps", "--locked"]).env("RUSTDOCFLAGS", "-D warnings");
    run_visibly(&mut command)
}

/// The tests of the affected packages, with their long sweeps if their product is affected, and those of the project commands, which
/// read most files. The required safety tests must have been checked.
fn tests(progress: &mut Progress<'_>) -> anyhow::Result<()> {
    let (packages, long) = match &progress.changes {
        Changes::Everything(_) => (Selection::Everything, Selection::Everything),
        Changes::Packages { changed, tested, .. } => {
            let packages = tested.iter().cloned().chain(["xtask".to_owned()]).collect();
            (Selection::Of(packages), Selection::Of(changed.clone()))
        }
    };
    let (workspace, changes, is_alone) = (progress.workspace, &progress.changes, progress.is_alone);
    let mut ahead = None;
    let start = |before: &[&str]| ahead = if is_alone { None } else { build_ahead(workspace, changes, before) };
    let plan = test::Plan { packages, long, filter: None };
    let tested = test::all(workspace, &plan, start)?;
    progress.ahead = ahead;
    let tested = progress.tested.insert(tested);
    tested.report.conclude()?;
    required::check(workspace, &tested.report, &plan.packages)
}

/// Starts the build for `accuracy` and `vm`, where a program of lower priority disturbs no test: the last tests and the steps after them keep
/// one processor busy.
fn build_ahead(workspace: &Workspace, changes: &Changes, before: &[&str]) -> Option<Beside> {
    if before.is_empty() || !changes.change(MEASURED) {
        return None;
    }
    let log = workspace.target_folder().ok()?.join("ci-guests.log");
    Beside::start("the build for emulated computers", &mut build_of_guests(workspace, changes, before), log).ok()
}

/// One build of the benchmark and of all programs for emulated computers: with other packages their dependencies have other features.
fn build_of_guests(workspace: &Workspace, changes: &Changes, before: &[&str]) -> Command {
    let mut command = match vm::CAN_BE_BUILT {
        true => vm::build_of_suites(workspace, before, &vm::suites_of(|package| changes.touch(&[package]))),
        false => {
            let mut command = workspace.cargo_after(before);
            command.args(["build", "--release", "--locked"]);
            command
        }
    };
    command.args(["--package", MEASURED, "--bin", "pb3dp-bench"]);
    command
}

/// The package of the accuracy benchmark.
const MEASURED: &str = "pb3dp-benchmarks";

/// The panel in a browser, on a quiet machine.
fn driven_panel(progress: &mut Progress<'_>) -> anyhow::Result<()> {
    progress.end_build();
    panel::check(progress.workspace, progress.programs())
}

/// The accuracy benchmark with few poses: fails if a limit is not met. Built as the programs of the emulated computers are: with the
/// checks of the test build the run takes more than three times as long (over 9 minutes instead of 3, 2026-11-22). It runs beside the
/// later steps: it keeps one processor busy, and so does the emulation of a computer, whose time is counted, not measured.
fn accuracy(progress: &mut Progress<'_>) -> anyhow::Result<()> {
    let workspace = progress.workspace;
    progress.end_build();
    run_visibly(&mut build_of_guests(workspace, &progress.changes, &[]))?;
    let target = workspace.target_folder()?;
    let folder = if vm::CAN_BE_BUILT { vm::folder_of_programs(&target) } else { target.join("release") };
    let mut command = Command::new(folder.join("pb3dp-bench"));
    command.args(["accuracy", "--quick"]).current_dir(workspace.root());
    progress.beside = Some(Beside::start("accuracy", &mut command, target.join("ci-accuracy.log"))?);
    Ok(())
}

/// The suites in emulated computers for the affected packages.
fn guests(progress: &mut Progress<'_>) -> anyhow::Result<()> {
    let suites = vm::suites_of(|package| progress.changes.touch(&[package]));
    vm::run_suites(progress.workspace, suites)
}
