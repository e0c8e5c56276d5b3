//! Runs test programs.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::available_parallelism;
use std::time::{Duration, Instant};

use anyhow::Context;
use serde_json::Value;

use super::report::{Report, Run};
use super::scheduling::Precedence;
use super::{Plan, build::Program, notebook};
use crate::files::create_folder;
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

/// Use of the processors by tests in real time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Sleeps,
    Computes,
    Alone,
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

    fn kind(&self) -> Kind {
        match self.program.package.as_str() {
            _ if self.program.target == ALONE => Kind::Alone,
            package if COMPUTING.contains(&package) => Kind::Computes,
            _ => Kind::Sleeps,
        }
    }

    /// The precedence that it needs beside the other tests.
    fn least_precedence(&self) -> Precedence {
        if self.kind() == Kind::Computes { Precedence::Class } else { Precedence::Priority }
    }
}

/// Runs the test programs: the tests in real time under their lock, the others on all processors.
pub struct Runner<'a> {
    plan: &'a Plan,
    precedence: Precedence,
    /// Duration of each run last time, s.
    before: BTreeMap<String, f64>,
    notebook: PathBuf,
    outputs: AtomicUsize,
}

fn of<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<'a> Runner<'a> {
    /// Reads the durations of the last run.
    ///
    /// # Errors
    /// If the target folder is unknown or cannot be written.
    pub fn new(workspace: &Workspace, plan: &'a Plan, precedence: Precedence) -> anyhow::Result<Self> {
        let notebook = notebook(&workspace.target_folder()?);
        create_folder(&notebook)?;
        let before = fs::read_to_string(notebook.join("durations.json")).ok();
        let before = before.and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default();
        Ok(Self { plan, precedence, before, notebook, outputs: AtomicUsize::new(0) })
    }

    /// Runs all programs, the longest first. Of the tests in real time, one program that computes and one that mostly sleeps run at a
    /// time, and then what must run without the others. Without a priority each of these waits for the end of all others.
    ///
    /// # Errors
    /// If the durations cannot be saved.
    pub fn run(&self, programs: &[Program], report: &mut Report) -> anyhow::Result<()> {
        let (punctual, mut others): (Vec<Job>, Vec<Job>) =
            self.jobs(programs).into_iter().partition(|job| job.is_punctual());
        let (beside, later): (Vec<Job>, Vec<Job>) =
            punctual.into_iter().partition(|job| self.precedence >= job.least_precedence());
        others.reverse();
        let others = Mutex::new(others);
        let shared = Mutex::new(&mut *report);
        let next = || of(&others).pop();
        let work = |job: &Job| self.work(job, &shared);
        let lane = |kind: Kind| beside.iter().filter(move |job| job.kind() == kind).for_each(work);
        std::thread::scope(|scope| {
            for _ in 0..available_parallelism().map_or(1, usize::from) {
                scope.spawn(|| {
                    while let Some(job) = next() {
                        work(&job);
                    }
                });
            }
            std::thread::scope(|inner| {
                inner.spawn(|| lane(Kind::Computes));
                lane(Kind::Sleeps);
            });
            lane(Kind::Alone);
        });
        later.iter().for_each(work);
        self.remember(report)
    }

    /// The runs of all programs, the longest first by their last durations; an unknown one counts as long.
    fn jobs(&self, programs: &[Program]) -> Vec<Job> {
        let of_program = |program: &Program| {
            // With a filter, the few matching tests wait for each other where necessary.
            let has_both = self.plan.filter.is_none()
                && program.kind == "test"
                && program.target != ALONE
                && list(program).lines().any(|line| line.starts_with(REAL_TIME));
            let parts: &[Part] = if has_both { &[Part::Punctual, Part::Others] } else { &[Part::All] };
            parts.iter().map(|part| Job { program: program.clone(), part: *part }).collect::<Vec<_>>()
        };
        let mut jobs: Vec<Job> = programs.iter().flat_map(of_program).collect();
        let seconds = |job: &Job| self.before.get(&job.name()).copied().unwrap_or(60.0);
        jobs.sort_by(|left, right| seconds(right).total_cmp(&seconds(left)));
        jobs
    }

    fn work(&self, job: &Job, report: &Mutex<&mut Report>) {
        let run = self.run_program(job);
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
        if self.plan.long.has(package) {
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
        command.args(self.plan.filter.as_ref());
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
    command.args(["test", "--quiet", "--doc", "--locked", "--no-fail-fast"]).args(selected);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::write;
    use crate::test::Selection;
    use crate::workspace::output_of;

    /// A test program that notes its arguments, with a test in real time and another one.
    fn program(folder: &Path, package: &str, target: &str, result: &str) -> Program {
        let (path, log) = (folder.join(format!("{package}-{target}")), folder.join("log"));
        let list = "real_time::a: test\nb: test";
        let text = format!(
            "#!/bin/sh\nif [ \"$1\" = --list ]; then printf '{list}'; exit; fi\n\
             echo \"{package} {target} $@\" >> {}\necho '{result}'\n",
            log.display()
        );
        write(&path.with_extension("sh"), &text).unwrap();
        // Another process writes the program: Linux executes no file that a process of another test may still hold open (ETXTBSY).
        output_of(Command::new("install").args(["-m", "755"]).arg(path.with_extension("sh")).arg(&path)).unwrap();
        let (package, target, kind) = (package.to_owned(), target.to_owned(), "test".to_owned());
        Program { package, target, kind, path, folder: folder.to_path_buf() }
    }

    #[test]
    fn tests_in_real_time_run_by_themselves_and_those_alone_at_the_end() {
        let folder = std::env::temp_dir().join(format!("pb3dp-runner-{}", std::process::id()));
        let good = "test result: ok. 1 passed; 0 failed; 0 ignored";
        let programs = [
            program(&folder, "pb3dp-panel", "integration", good),
            program(&folder, "pb3dp-arm-pa10", "alone", "test result: FAILED. 0 passed; 1 failed; 0 ignored"),
        ];
        let plan = Plan { packages: Selection::Everything, long: Selection::Everything, filter: None };
        for precedence in [Precedence::None, Precedence::Priority, Precedence::Class] {
            let (before, notebook) = (BTreeMap::new(), folder.clone());
            let runner = Runner { plan: &plan, precedence, before, notebook, outputs: AtomicUsize::new(0) };
            let mut report = Report::default();
            runner.run(&programs, &mut report).unwrap();
            let log = fs::read_to_string(folder.join("log")).unwrap();
            let runs: Vec<&str> = log.lines().map(str::trim_end).collect();
            let place =
                |run: &str| runs.iter().position(|found| *found == run).unwrap_or_else(|| panic!("{run}: {log}"));
            let others = place("pb3dp-panel integration --skip real_time::");
            let real_time = place("pb3dp-panel integration real_time:: --test-threads 4");
            let alone = place("pb3dp-arm-pa10 alone");
            assert!(runs.len() == 3 && (precedence > Precedence::None || alone > others), "{log}");
            assert!(precedence == Precedence::Priority || alone > real_time, "{precedence:?}: {log}");
            assert!(precedence == Precedence::Class || real_time > others, "{precedence:?}: {log}");
            assert_eq!((report.counts()[..2].to_vec(), report.real_time_counts()), (vec![2, 1], [0, 2]));
            fs::remove_file(folder.join("log")).unwrap();
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
