//! Runs test programs during the build.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::available_parallelism;
use std::time::{Duration, Instant};

use anyhow::Context;
use serde_json::Value;

use super::report::{Report, Run};
use super::scheduling::{LowSession, Precedence};
use super::{Built, Plan, Selection, build::Program, notebook};
use crate::workspace::Workspace;

/// The module of the tests that must run in real time.
const REAL_TIME: &str = "real_time::";
/// Programs with only real-time tests.
const ALONE: &str = "alone";
/// A program that runs longer than this hangs.
const LONGEST: Duration = Duration::from_secs(1200);
/// Environment variable for the long sweeps.
const LONG_TESTS: &str = "PB3DP_LONG_TESTS";
/// Packages whose real-time tests run whole programs or loops, which compute: they get no SCHED_FIFO priority.
const COMPUTING: [&str; 3] = ["pb3dp-orchestrator", "pb3dp-panel", "system-tests"];

/// Number of real-time tests of a package that run in parallel: they mostly sleep, whole loops with images less.
fn punctual_threads(package: &str) -> &'static str {
    match package {
        "system-tests" => "2",
        "pb3dp-panel" => "4",
        _ => "6",
    }
}

/// Selection of the tests of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    All,
    Punctual,
    Others,
}

/// A test program to run.
#[derive(Clone, Debug)]
struct Job {
    program: Program,
    part: Part,
}

impl Job {
    fn name(&self) -> String {
        let more = if self.part == Part::Punctual { ", real time" } else { "" };
        format!("{}{more}", self.program.name())
    }

    fn is_punctual(&self) -> bool {
        self.part == Part::Punctual || self.program.target == ALONE
    }

    fn computes(&self) -> bool {
        COMPUTING.contains(&self.program.package.as_str())
    }
}

#[derive(Default)]
struct State {
    others: Vec<Job>,
    punctual: Vec<Job>,
    is_building: bool,
    running_punctual: usize,
    running_others: usize,
}

/// Runs test programs as they are built: the real-time tests under their lock, the others on all processors that the build
/// does not use.
pub struct Runner {
    state: Mutex<State>,
    changed: Condvar,
    /// Priority of real-time tests.
    pub precedence: Precedence,
    long: Selection,
    filter: Option<String>,
    /// Duration of each run last time, s.
    before: BTreeMap<String, f64>,
    notebook: PathBuf,
    outputs: AtomicUsize,
}

fn of<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Runner {
    /// Reads the durations of the last run.
    ///
    /// # Errors
    /// If the target folder is unknown or cannot be written.
    pub fn new(workspace: &Workspace, plan: &Plan) -> anyhow::Result<(Self, Report)> {
        let notebook = notebook(&workspace.target_folder()?);
        fs::create_dir_all(&notebook).with_context(|| format!("cannot create {}", notebook.display()))?;
        let before = fs::read_to_string(notebook.join("durations.json")).ok();
        let runner = Self {
            state: Mutex::new(State { is_building: true, ..State::default() }),
            changed: Condvar::new(),
            precedence: Precedence::find(),
            long: plan.long.clone(),
            filter: plan.filter.clone(),
            before: before.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default(),
            notebook,
            outputs: AtomicUsize::new(0),
        };
        Ok((runner, Report::default()))
    }

    /// Builds, runs the built programs meanwhile, and waits for all of them.
    ///
    /// # Errors
    /// If the build fails; programs that are already built run to their ends.
    pub fn run(
        &self,
        build: impl FnOnce(&Self) -> anyhow::Result<Built>,
        report: &mut Report,
    ) -> anyhow::Result<Built> {
        let processors = available_parallelism().map_or(1, usize::from);
        let report = Mutex::new(report);
        let _low = LowSession::enter();
        let built = std::thread::scope(|scope| {
            for computing in [true, false] {
                let report = &report;
                scope.spawn(move || {
                    while let Some(job) = self.next_punctual(computing) {
                        self.work(&job, report)
                    }
                });
            }
            for place in 0..processors {
                let report = &report;
                scope.spawn(move || {
                    while let Some(job) = self.next_other(place) {
                        self.work(&job, report);
                    }
                });
            }
            let begin = Instant::now();
            let built = build(self);
            let mut state = of(&self.state);
            state.is_building = false;
            println!(
                "build ended after {:.0} s; {} test programs run, {} wait: each gets a line when it ends, the longest ones began first",
                begin.elapsed().as_secs_f64(),
                state.running_others + state.running_punctual,
                state.others.len() + state.punctual.len()
            );
            if built.is_err() {
                (state.others, state.punctual) = (Vec::new(), Vec::new());
            }
            drop(state);
            self.changed.notify_all();
            built
        })?;
        let report = report.into_inner().unwrap_or_else(PoisonError::into_inner);
        self.remember(report)?;
        Ok(built)
    }

    /// Queues a built program.
    pub fn ready(&self, program: Program) {
        // With a filter, the few matching tests wait for each other where necessary.
        let has_both = self.filter.is_none()
            && program.kind == "test"
            && list(&program).lines().any(|line| line.starts_with(REAL_TIME));
        let job = |part| Job { program: program.clone(), part };
        let mut state = of(&self.state);
        if program.target == ALONE {
            state.punctual.push(job(Part::All));
        } else if has_both {
            state.punctual.push(job(Part::Punctual));
            state.others.push(job(Part::Others));
        } else {
            state.others.push(job(Part::All));
        }
        drop(state);
        self.changed.notify_all();
    }

    /// The next job of the other tests. During a build they use one processor only.
    fn next_other(&self, place: usize) -> Option<Job> {
        let mut state = of(&self.state);
        loop {
            let may_run = place == 0 || !state.is_building;
            if may_run && let Some(index) = self.longest(&state.others, |_| true) {
                state.running_others += 1;
                return Some(state.others.remove(index));
            }
            if !state.is_building && state.others.is_empty() {
                return None;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// The next job of real-time tests: one program that computes and one that mostly sleeps at a time, and at the end what must run
    /// without other real-time tests. Without a priority each waits for the end of all others.
    fn next_punctual(&self, computing: bool) -> Option<Job> {
        let mut state = of(&self.state);
        loop {
            let is_free = !state.is_building && state.running_punctual == 0;
            let is_quiet = is_free && state.others.is_empty() && state.running_others == 0;
            let is_end = is_free && state.punctual.iter().all(|job| job.program.target == ALONE);
            let may_run = |job: &Job| {
                let least = if job.computes() { Precedence::Priority } else { Precedence::None };
                let is_in_turn = job.program.target != ALONE || is_end;
                job.computes() == computing && is_in_turn && (is_quiet || self.precedence > least)
            };
            if let Some(index) = self.longest(&state.punctual, may_run) {
                state.running_punctual += 1;
                return Some(state.punctual.remove(index));
            }
            if !state.is_building && state.punctual.iter().all(|job| job.computes() != computing) {
                return None;
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// The longest job of those that may run, by its last duration; an unknown job counts as long.
    fn longest(&self, jobs: &[Job], may_run: impl Fn(&Job) -> bool) -> Option<usize> {
        let seconds = |index: &usize| self.before.get(&jobs[*index].name()).copied().unwrap_or(60.0);
        let due = (0..jobs.len()).filter(|index| may_run(&jobs[*index]));
        due.max_by(|left, right| seconds(left).total_cmp(&seconds(right)))
    }

    fn work(&self, job: &Job, report: &Mutex<&mut Report>) {
        let run = self.run_program(job);
        let mut state = of(&self.state);
        match job.is_punctual() {
            true => state.running_punctual -= 1,
            false => state.running_others -= 1,
        }
        drop(state);
        self.changed.notify_all();
        // A program without tests gets no line.
        if run.passed + run.failed + run.ignored > 0 {
            of(report).add(run);
        }
    }

    fn run_program(&self, job: &Job) -> Run {
        let begin = Instant::now();
        let file = self.notebook.join(format!("output-{}", self.outputs.fetch_add(1, Ordering::Relaxed)));
        let ended = self.command(job, &file).and_then(|mut command| wait(&mut command, begin));
        let mut output = fs::read(&file).map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default();
        fs::remove_file(&file).ok();
        let succeeded = match ended {
            Ok(succeeded) => succeeded,
            Err(error) => {
                output.push_str(&format!("\n{error:#}\n"));
                false
            }
        };
        let mut run = Run::read(job.name(), output, succeeded, begin.elapsed());
        run.is_punctual = job.is_punctual();
        run
    }

    /// The program with its output in a file: both streams in their order.
    fn command(&self, job: &Job, output: &Path) -> anyhow::Result<Command> {
        let Program { path, folder, package, .. } = &job.program;
        let before = if job.is_punctual() { &[] } else { self.precedence.of_tests() };
        let mut words = before.iter().map(OsStr::new).chain([path.as_os_str()]);
        let mut command = Command::new(words.next().unwrap_or_default());
        command.args(words).current_dir(folder).env("CARGO_MANIFEST_DIR", folder).env("CARGO_PKG_NAME", package);
        command.env_remove(LONG_TESTS);
        if self.long.has(package) {
            command.env(LONG_TESTS, "1");
        }
        match job.part {
            Part::All => {}
            Part::Punctual => {
                command.args([REAL_TIME, "--test-threads", punctual_threads(package)]);
            }
            Part::Others => {
                command.args(["--skip", REAL_TIME]);
            }
        }
        command.args(self.filter.as_ref());
        let file = File::create(output).with_context(|| format!("cannot write {}", output.display()))?;
        command.stdin(Stdio::null()).stderr(file.try_clone()?).stdout(file);
        Ok(command)
    }

    fn remember(&self, report: &Report) -> anyhow::Result<()> {
        let mut known = self.before.clone();
        known.extend(report.programs.iter().map(|run| (run.name.clone(), run.took.as_secs_f64())));
        let text = serde_json::to_string_pretty(&known)?;
        fs::write(self.notebook.join("durations.json"), text).context("cannot save the durations of the tests")
    }
}

/// Runs the documentation examples of the selected libraries without `doctest = false`; `None` if there is none.
///
/// # Errors
/// If cargo cannot be run.
pub fn doctests(workspace: &Workspace, plan: &Plan) -> anyhow::Result<Option<Run>> {
    let begin = Instant::now();
    let metadata = workspace.metadata()?;
    let selected = plan.packages.arguments(|package| has_doctests(&metadata, package));
    if selected.is_empty() {
        return Ok(None);
    }
    let mut command = workspace.cargo();
    println!("$ cargo test --doc {}", selected.join(" "));
    command.args(["test", "--quiet", "--doc", "--locked"]).args(selected);
    let output = command.args(&plan.filter).output().context("cannot run cargo")?;
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
    Ok(Some(Run::read("examples in the documentation".to_owned(), text, output.status.success(), begin.elapsed())))
}

fn has_doctests(metadata: &Value, package: &str) -> bool {
    let packages = metadata["packages"].as_array().into_iter().flatten().filter(|found| found["name"] == package);
    packages.flat_map(|found| found["targets"].as_array().into_iter().flatten()).any(|target| target["doctest"] == true)
}

/// Waits for the end of a program; returns whether it succeeded.
fn wait(command: &mut Command, begin: Instant) -> anyhow::Result<bool> {
    let mut child = command.spawn().with_context(|| format!("cannot start {command:?}"))?;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status.success());
        }
        if begin.elapsed() > LONGEST {
            child.kill()?;
            child.wait()?;
            anyhow::bail!("killed after {} s: it hangs", LONGEST.as_secs());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Names of the tests of a program.
fn list(program: &Program) -> String {
    let output =
        Command::new(&program.path).args(["--list", "--format", "terse"]).current_dir(&program.folder).output();
    output.map(|output| String::from_utf8_lossy(&output.stdout).into_owned()).unwrap_or_default()
}
