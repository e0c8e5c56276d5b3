//! `cargo xtask test --prove-red`: breaks the product in ten ways, and checks that the test of each fails.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Instant;

use anyhow::{Context, bail};

use super::build::artifact;
use crate::required::{self, PATCHES, Required};
use crate::scratch::Scratch;
use crate::workspace::{Workspace, output_of};

/// Number of busy loops in the second half.
const BUSY_LOOPS: usize = 4;

/// Builds a scratch copy, in which each required test must pass; then breaks the property behind each test, which must fail,
/// without and with four busy loops in parallel.
///
/// # Errors
/// If a patch does not apply, the copy does not build, or a test has the wrong result.
pub fn run(workspace: &Workspace, filter: Option<&str>) -> anyhow::Result<()> {
    let begin = Instant::now();
    let mut wanted = required::all(workspace)?;
    wanted.retain(|required| filter.is_none_or(|part| required.patch.contains(part)));
    if wanted.is_empty() {
        bail!("no patch in {PATCHES} has this name");
    }
    let mut proof = Proof { scratch: Scratch::new(workspace, "red")?, wrong: Vec::new() };
    for required in &wanted {
        let program = proof.build(required)?;
        proof.expect(Colour::Green, "unbroken", &program, required)?;
    }
    for required in &wanted {
        proof.apply(required, false)?;
        let program = proof.build(required)?;
        proof.expect(Colour::Red, "broken", &program, required)?;
        let busy = Busy::start()?;
        proof.expect(Colour::Red, "broken, with four busy loops", &program, required)?;
        drop(busy);
        proof.apply(required, true)?;
    }
    let wrong = proof.wrong;
    println!("{} patches in {:.0} s", wanted.len(), begin.elapsed().as_secs_f64());
    if wrong.is_empty() {
        return Ok(());
    }
    bail!("tests with the wrong result: {}", wrong.join("; "))
}

/// Result of a test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Colour {
    Green,
    Red,
    /// The test was not checked, or does not exist.
    Unknown,
}

impl Colour {
    /// From the output of the test program.
    fn of(output: &str, succeeded: bool) -> Self {
        if output.contains("NOT CHECKED: ") {
            return Self::Unknown;
        }
        match (succeeded, output.contains("test result: ok. 1 passed"), output.contains(" 0 passed; 1 failed")) {
            (true, true, _) => Self::Green,
            (false, _, true) => Self::Red,
            _ => Self::Unknown,
        }
    }
}

/// The copy, and the tests with a wrong result.
struct Proof {
    scratch: Scratch,
    wrong: Vec<String>,
}

impl Proof {
    fn expect(&mut self, expected: Colour, how: &str, program: &Path, required: &Required) -> anyhow::Result<()> {
        let (outcome, took_s) = self.run(program, required)?;
        println!("{}, {how}: {outcome:?} in {took_s:.1} s", required.patch);
        if outcome != expected {
            self.wrong.push(format!("{} {how} is {outcome:?}", required.test));
        }
        Ok(())
    }

    /// Applies or reverts a patch.
    fn apply(&self, required: &Required, reverse: bool) -> anyhow::Result<()> {
        let mut command = Command::new("git");
        command.arg("apply").args(reverse.then_some("--reverse"));
        command.arg(Path::new(PATCHES).join(&required.patch)).current_dir(&self.scratch.tree);
        // Git must not take the tree for a part of the surrounding repository.
        command
            .env("GIT_CEILING_DIRECTORIES", self.scratch.tree.parent().context("the copy lies in a folder")?)
            .env_remove("GIT_DIR");
        output_of(&mut command)
            .map(|_| ())
            .with_context(|| format!("{PATCHES}/{} does not apply any more; create it again", required.patch))
    }

    /// The test program.
    fn build(&self, required: &Required) -> anyhow::Result<PathBuf> {
        let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
        command.current_dir(&self.scratch.tree).env("CARGO_TARGET_DIR", &self.scratch.target);
        command.args(["test", "--locked", "--no-run", "--package", &required.package, "--test", &required.program]);
        command.args(["--quiet", "--message-format", "json-render-diagnostics"]);
        let text = output_of(&mut command).with_context(|| format!("{} does not build", required.patch))?;
        let messages = text.lines().filter_map(|line| serde_json::from_str(line).ok());
        let mut programs = messages.filter_map(|message| artifact(&message));
        let program = programs.find(|(is_test, program)| *is_test && program.target == required.program);
        let program = program.map(|(_, program)| program.path);
        program.with_context(|| format!("cargo has not built the test {} {}", required.package, required.program))
    }

    /// The result of the test, and its duration, s.
    fn run(&self, program: &Path, required: &Required) -> anyhow::Result<(Colour, f64)> {
        let begin = Instant::now();
        let mut command = Command::new(program);
        command.args(["--exact", &required.test]).current_dir(&self.scratch.tree).stdin(Stdio::null());
        let output = command.output().with_context(|| format!("cannot start {}", program.display()))?;
        let text = [&output.stdout, &output.stderr].map(|bytes| String::from_utf8_lossy(bytes).into_owned()).concat();
        Ok((Colour::of(&text, output.status.success()), begin.elapsed().as_secs_f64()))
    }
}

/// Processes that keep the processors busy until this is dropped.
struct Busy(Vec<Child>);

impl Busy {
    fn start() -> anyhow::Result<Self> {
        let mut busy = Self(Vec::new());
        for _ in 0..BUSY_LOOPS {
            let mut command = Command::new("sh");
            busy.0.push(command.args(["-c", "while :; do :; done"]).spawn().context("cannot start sh")?);
        }
        Ok(busy)
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        for child in &mut self.0 {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_failure_of_the_test_itself_is_red() {
        let ok = "test result: ok. 1 passed; 0 failed; 0 ignored";
        assert_eq!(Colour::of(ok, true), Colour::Green);
        assert_eq!(Colour::of("test result: FAILED. 0 passed; 1 failed; 0 ignored", false), Colour::Red);
        assert_eq!(Colour::of("test result: ok. 0 passed; 0 failed; 0 ignored; 9 filtered out", true), Colour::Unknown);
        assert_eq!(Colour::of(&format!("NOT CHECKED: a: late\n{ok}"), true), Colour::Unknown);
        assert_eq!(Colour::of("", false), Colour::Unknown);
    }
}
