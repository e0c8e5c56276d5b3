//! The steps of `cargo xtask ci`.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow, bail};

use super::changes::Changes;
use super::space;
use crate::workspace::{Workspace, run_visibly};
use crate::{
    check_deps, commissioning, fuzz_build, licences, miri, msrv, panel, python_package, recordings, required, test,
    tidy, vm,
};

/// Context of the steps.
pub struct Progress<'a> {
    /// The workspace.
    pub workspace: &'a Workspace,
    /// The change.
    pub changes: Changes,
    /// Results of the step `test`.
    pub tested: Option<test::Tested>,
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
    /// Folder of the programs that the step `test` built, if it ran.
    fn programs(&self) -> Option<&Path> {
        self.tested.as_ref().and_then(|tested| tested.built.folder().ok())
    }
}

/// A step.
pub struct Step {
    /// Name on the command line.
    pub name: &'static str,
    /// The packages for whose change it runs; empty for a step that always runs.
    pub of: &'static [&'static str],
    /// Runs the step.
    pub run: fn(&mut Progress<'_>) -> anyhow::Result<()>,
}

const ALWAYS: &[&str] = &[];
/// Packages with unsafe kernels or fuzz targets.
const KERNELS: &[&str] = &[
    "pb3dp-estimation-core",
    "pb3dp-estimation-direct",
    "pb3dp-estimation-track",
    "pb3dp-estimation-published",
    "pb3dp-camera-pixels",
];
const FUZZED: &[&str] = &["pb3dp-estimation", "pb3dp-arm-pa10-test-support"];
/// Files that affect every package: manifests, the lock file and the toolchain.
const MANIFESTS: &[&str] = &["manifests"];

/// The steps, the fastest first.
pub const STEPS: [Step; 19] = [
    Step { name: "space", of: ALWAYS, run: |progress| space::check(progress.workspace) },
    Step { name: "fmt", of: ALWAYS, run: |progress| fmt(progress.workspace) },
    Step { name: "tidy", of: ALWAYS, run: |progress| tidy::run(progress.workspace, &tidy::Args {}) },
    Step { name: "check-deps", of: ALWAYS, run: |progress| check_deps::run(progress.workspace, &check_deps::Args {}) },
    Step { name: "licences", of: ALWAYS, run: |progress| licences::run(progress.workspace) },
    Step { name: "advisories", of: ALWAYS, run: |progress| licences::advisories(progress.workspace) },
    Step { name: "clippy", of: ALWAYS, run: |progress| clippy(progress.workspace) },
    Step { name: "doc", of: ALWAYS, run: |progress| doc(progress.workspace) },
    Step { name: "test", of: ALWAYS, run: tests },
    Step { name: "safeguards", of: ALWAYS, run: |progress| safeguards(progress.workspace) },
    Step {
        name: "commissioning",
        of: &["pb3dp-calibration", "pb3dp-orchestrator"],
        run: |progress| commissioning::calibrate(progress.workspace, progress.programs()),
    },
    Step { name: "panel", of: &["pb3dp-panel"], run: |progress| panel::check(progress.workspace, progress.programs()) },
    Step {
        name: "recordings",
        of: &["pb3dp-bag", "pb3dp-recording", "pb3dp-camera-replay", "pb3dp-orchestrator"],
        run: |progress| recordings::check(progress.workspace, progress.programs()),
    },
    Step {
        name: "python",
        of: &["pb3dp-python", "pb3dp-orchestrator"],
        run: |progress| python_package::check(progress.workspace, progress.programs()),
    },
    Step { name: "accuracy", of: &["pb3dp-benchmarks"], run: accuracy },
    Step { name: "vm", of: &["pb3dp-arm-pa10-emulation", "pb3dp-camera-v4l2", "system-tests"], run: guests },
    Step { name: "fuzz", of: FUZZED, run: |progress| fuzz_build::run(progress.workspace) },
    Step { name: "miri", of: KERNELS, run: |progress| miri::run(progress.workspace) },
    Step { name: "msrv", of: MANIFESTS, run: |progress| msrv::run(progress.workspace) },
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

/// All tests, with the long sweeps of the affected packages. The required safety tests must have been checked.
fn tests(progress: &mut Progress<'_>) -> anyhow::Result<()> {
    let long = match &progress.changes {
        Changes::Everything(_) => test::Long::Everywhere,
        Changes::Packages { names, .. } => test::Long::In(names.iter().cloned().collect()),
    };
    let tested = test::all(progress.workspace, &test::Plan { long, filter: None })?;
    let tested = progress.tested.insert(tested);
    tested.report.conclude()?;
    required::check(&tested.report)
}

/// The feature that lets tests disable safeguards.
const SWITCHES: &str = "disabled-guards";

/// No release can contain the disabling of safeguards, and without the feature none can be disabled. The tests of the example
/// `safety` show that disabling any safeguard causes a violation.
fn safeguards(workspace: &Workspace) -> anyhow::Result<()> {
    let package = ["--locked", "--package", "pb3dp-safeguards"];
    run_visibly(workspace.cargo().arg("test").args(package))?;
    let mut release = workspace.cargo();
    release.args(["check", "--release", "--features", SWITCHES]).args(package);
    let built = release.output().context("cannot run cargo")?;
    let said = String::from_utf8_lossy(&built.stderr);
    if built.status.success() || !said.contains("no program for real arms may have it") {
        bail!("a release was built with the feature {SWITCHES}, or failed for another reason:\n{said}");
    }
    Ok(())
}

/// The accuracy benchmark with few poses: fails if a limit is not met. Built as the programs of the emulated computers are: with the
/// checks of the test build the run takes more than three times as long (over 9 minutes instead of 3, 2026-11-22). It runs beside the
/// later steps: it keeps one processor busy, and so does the emulation of a computer, whose time is counted, not measured.
fn accuracy(progress: &mut Progress<'_>) -> anyhow::Result<()> {
    let workspace = progress.workspace;
    let cargo = |subcommand: &str| {
        let mut command = match vm::CAN_BE_BUILT {
            true => vm::cargo_of_guests(workspace, subcommand),
            false => {
                let mut command = workspace.cargo();
                command.args([subcommand, "--release", "--locked"]);
                command
            }
        };
        command.args(["--package", "pb3dp-benchmarks", "--bin", "pb3dp-bench"]);
        command
    };
    run_visibly(&mut cargo("build"))?;
    let log = workspace.target_folder()?.join("ci-accuracy.log");
    let mut command = cargo("run");
    command.args(["--", "accuracy", "--quick"]);
    progress.beside = Some(Beside::start("accuracy", &mut command, log)?);
    Ok(())
}

/// The suites in emulated computers for the affected packages.
fn guests(progress: &mut Progress<'_>) -> anyhow::Result<()> {
    let suites = vm::suites_of(|package| progress.changes.touch(&[package]));
    vm::run_suites(progress.workspace, suites)
}
