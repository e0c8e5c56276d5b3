//! `cargo xtask test`: all tests of the project.

pub mod build;
mod emulated;
mod prove_red;
mod report;
mod runner;
mod scheduling;

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::bail;

use crate::workspace::{Workspace, run_visibly};
pub use build::Built;
pub use report::Report;
use runner::Runner;
use scheduling::{LowSession, Precedence};

/// Runs all tests: unit tests, integration tests, examples in the documentation, whole-system tests.
///
/// Tests whose threads must run in real time (`real_time::` in their names) run with
/// priority over all others if the system grants it, otherwise after all others. Needs no hardware, no network (once the
/// dependencies are installed) and no further tool. Ends with the tests that this machine cannot check
/// (`NOT CHECKED: name: reason`) and the line `N passed, N failed, N skipped`. For one crate, or one test by a part of its name:
/// `cargo test -p pb3dp-geometry`, `cargo test -p pb3dp-sim lag`.
///
/// With `--aarch64` it runs the unit tests of the crates with vector kernels as ARM programs in an emulator, to test the NEON
/// kernels on a PC. That needs a cross linker and QEMU, on Debian the packages gcc-aarch64-linux-gnu,
/// libc6-dev-arm64-cross and qemu-user-static, and `rustup target add aarch64-unknown-linux-gnu`.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Args {
    /// Also the long sweeps: 100 simulated rigs, five minutes there and back, 60 000 random byte strings.
    #[arg(long)]
    all: bool,
    /// Print the 20 slowest test programs; cargo writes the times of the build to target/cargo-timings.
    #[arg(long)]
    timings: bool,
    /// Run the unit tests of the crates with vector kernels for 64-bit ARM, in an emulator.
    #[arg(long)]
    aarch64: bool,
    /// Build everything and run nothing: a reference for the build time.
    #[arg(long)]
    no_run: bool,
    /// Break the product in ten ways in a scratch copy; the test named by each must fail, without and with four busy loops in
    /// parallel. With a filter: the patches in tests/red whose names contain it.
    #[arg(long)]
    prove_red: bool,
    /// Run only the tests whose name contains this.
    filter: Option<String>,
}

/// # Errors
/// If a test fails or does not build, or a tool for `--aarch64` is missing.
pub fn run(workspace: &Workspace, args: &Args) -> anyhow::Result<()> {
    if args.aarch64 {
        return run_visibly(emulated::tests(workspace)?.args(args.filter.as_ref()));
    }
    if args.prove_red {
        return prove_red::run(workspace, args.filter.as_deref());
    }
    if args.no_run {
        return build::run(workspace, &Selection::Everything).map(|_| ());
    }
    let long = if args.all { Selection::Everything } else { Selection::Of(BTreeSet::new()) };
    let plan = Plan { packages: Selection::Everything, long, filter: args.filter.clone() };
    let tested = all(workspace, &plan, |_| {})?;
    if args.timings {
        print!("{}", tested.report.slowest());
    }
    tested.report.conclude()
}

/// A set of packages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Selection {
    /// All packages.
    Everything,
    /// These packages.
    Of(BTreeSet<String>),
}

impl Selection {
    /// Whether the set has this package.
    pub fn has(&self, package: &str) -> bool {
        match self {
            Self::Everything => true,
            Self::Of(packages) => packages.contains(package),
        }
    }

    /// Arguments of cargo that select the packages for which `may_have` holds.
    fn arguments(&self, may_have: impl Fn(&str) -> bool) -> Vec<&str> {
        match self {
            Self::Everything => vec!["--workspace"],
            Self::Of(packages) => {
                packages.iter().filter(|name| may_have(name)).flat_map(|name| ["--package", name]).collect()
            }
        }
    }
}

/// Selection of the tests.
pub struct Plan {
    /// Packages to build and test.
    pub packages: Selection,
    /// Packages with long sweeps.
    pub long: Selection,
    /// A part of the names of the tests to run.
    pub filter: Option<String>,
}

/// The build, and the results of the tests.
pub struct Tested {
    /// The build.
    pub built: Built,
    /// The test results.
    pub report: Report,
}

/// Builds and runs everything. `after_build` gets the prefix of a command that may run beside the tests.
/// Failed tests are no error here: [`Report::conclude`] reports them.
///
/// # Errors
/// If something does not build, or no program can be started.
pub fn all(workspace: &Workspace, plan: &Plan, after_build: impl FnOnce(&[&str])) -> anyhow::Result<Tested> {
    let begin = Instant::now();
    let built = build::run(workspace, &plan.packages)?;
    println!("built in {:.0} s; each test program gets a line when it ends", begin.elapsed().as_secs_f64());
    let precedence = Precedence::find();
    after_build(precedence.of_build());
    let mut report = Report::default();
    let runner = Runner::new(workspace, plan, precedence)?;
    let low = LowSession::enter();
    runner.run(&built.tests, &mut report)?;
    drop(low);
    runner::doctests(workspace, plan)?.into_iter().for_each(|run| report.add(run));
    if report.is_empty() {
        bail!("no test ran: check the filter");
    }
    report.took = begin.elapsed();
    Ok(Tested { built, report })
}

/// Folder in which this command saves its data between runs.
fn notebook(target: &std::path::Path) -> PathBuf {
    target.join("xtask")
}
