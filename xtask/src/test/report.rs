//! The test results.

use std::collections::BTreeSet;
use std::time::Duration;

use anyhow::bail;

/// Output of a test program for a test that the machine cannot check.
const NOT_CHECKED: &str = "NOT CHECKED: ";

/// One run of a test program.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Name in tables.
    pub name: String,
    /// Tests that passed, as counted by the harness.
    pub passed: usize,
    /// Tests that failed.
    pub failed: usize,
    /// Tests that the harness ignored.
    pub ignored: usize,
    /// `name: reason` of each test that was not checked.
    pub not_checked: Vec<String>,
    /// Duration.
    pub took: Duration,
    /// The whole output.
    pub output: String,
    /// Whether its tests must run in real time.
    pub is_punctual: bool,
}

impl Run {
    /// Reads the counts from the output of a test program. A program that ended badly without counts has one failure.
    pub fn read(name: String, output: String, succeeded: bool, took: Duration) -> Self {
        let mut run = Self { name, took, ..Self::default() };
        let mut has_result = false;
        for line in output.lines() {
            if let Some(counts) = line.trim_start().strip_prefix("test result: ") {
                has_result = true;
                run.passed += count(counts, " passed");
                run.failed += count(counts, " failed");
                run.ignored += count(counts, " ignored");
            }
            if let Some(what) = line.strip_prefix(NOT_CHECKED) {
                run.not_checked.push(what.to_owned());
            }
        }
        if !(succeeded && has_result) && run.failed == 0 {
            run.failed = 1;
        }
        run.output = output;
        run
    }

    /// Names of the tests that were not checked, without duplicates.
    fn unchecked(&self) -> BTreeSet<&str> {
        self.not_checked.iter().map(|line| line.split(": ").next().unwrap_or(line)).collect()
    }

    fn skipped(&self) -> usize {
        self.unchecked().len() + self.ignored
    }
}

/// The number before a word in the harness's line of counts.
fn count(text: &str, word: &str) -> usize {
    let before = text.split(word).next().unwrap_or_default();
    before.rsplit(|letter: char| !letter.is_ascii_digit()).next().and_then(|digits| digits.parse().ok()).unwrap_or(0)
}

/// All runs.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// One per start of a program.
    pub programs: Vec<Run>,
    /// From the first build to the last test.
    pub took: Duration,
}

impl Report {
    /// Adds a run, and prints it: one line, and the whole output of a failed program.
    pub fn add(&mut self, run: Run) {
        let verdict = if run.failed == 0 { "ok" } else { "FAILED" };
        let Run { name, passed, failed, took, .. } = &run;
        println!("{verdict:<6} {:>6.1} s  {passed:>4} passed {failed:>2} failed  {name}", took.as_secs_f64());
        if run.failed > 0 {
            println!("{}", run.output);
        }
        self.programs.push(run);
    }

    /// Whether no test ran.
    pub fn is_empty(&self) -> bool {
        self.programs.iter().all(|run| run.passed + run.failed == 0)
    }

    /// `name: reason` of each test that was not checked.
    pub fn not_checked(&self) -> impl Iterator<Item = &String> {
        self.programs.iter().flat_map(|run| &run.not_checked)
    }

    /// Counts: passed, failed, skipped.
    pub fn counts(&self) -> [usize; 3] {
        let sum = |of: fn(&Run) -> usize| self.programs.iter().map(of).sum::<usize>();
        let unchecked = sum(|run| run.unchecked().len());
        [sum(|run| run.passed).saturating_sub(unchecked), sum(|run| run.failed), sum(Run::skipped)]
    }

    /// Whether a test ran in a program of this package, and none failed there.
    pub fn has_passed(&self, package: &str, test: &str) -> bool {
        let ran = |run: &&Run| {
            let names = run.output.lines().filter_map(|line| line.strip_prefix("test ")?.split(' ').next());
            run.name.split(' ').next() == Some(package) && run.failed == 0 && names.into_iter().any(|name| name == test)
        };
        self.programs.iter().find(ran).is_some()
    }

    /// Tests that must run in real time: number that were not checked, and total number.
    pub fn real_time_counts(&self) -> [usize; 2] {
        let punctual = || self.programs.iter().filter(|run| run.is_punctual);
        [punctual().map(|run| run.unchecked().len()).sum(), punctual().map(|run| run.passed + run.failed).sum()]
    }

    /// The slowest runs.
    pub fn slowest(&self) -> String {
        const ROWS: usize = 20;
        let mut runs: Vec<&Run> = self.programs.iter().collect();
        runs.sort_by_key(|run| std::cmp::Reverse(run.took));
        let row = |run: &&Run| format!("{:<48} {:>8.1}\n", run.name, run.took.as_secs_f64());
        let rows: String = runs.iter().take(ROWS).map(row).collect();
        format!("\n{:<48} {:>8}\n{rows}", "the slowest test programs", "run, s")
    }

    /// Prints the tests that were not checked, and the counts on a separate line.
    pub fn tell(&self) {
        println!();
        for line in self.not_checked() {
            println!("{NOT_CHECKED}{line}");
        }
        let [passed, failed, skipped] = self.counts();
        println!("{} programs in {:.0} s", self.programs.len(), self.took.as_secs_f64());
        println!("{passed} passed, {failed} failed, {skipped} skipped");
    }

    /// Like [`Self::tell`].
    ///
    /// # Errors
    /// If a test failed; the message names the programs.
    pub fn conclude(&self) -> anyhow::Result<()> {
        self.tell();
        if self.counts()[1] == 0 {
            return Ok(());
        }
        let names: Vec<&str> = self.programs.iter().filter(|run| run.failed > 0).map(|run| run.name.as_str()).collect();
        bail!("tests failed in: {}", names.join(", "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "\nrunning 3 tests\ntest a ... ok\nNOT CHECKED: real_time::b: this machine is late: by 9 ms\n\
                        test result: ok. 3 passed; 0 failed; 1 ignored; 0 measured; 12 filtered out; finished in 0.1s\n";

    fn read(output: &str, succeeded: bool) -> Run {
        Run::read("a integration".to_owned(), output.to_owned(), succeeded, Duration::from_secs(1))
    }

    #[test]
    fn a_test_that_was_not_checked_is_skipped_not_passed() {
        let report = Report { programs: vec![read(GOOD, true)], took: Duration::ZERO };
        assert_eq!(report.counts(), [2, 0, 2]);
        assert!(report.conclude().is_ok());
        assert_eq!(report.not_checked().next().unwrap(), "real_time::b: this machine is late: by 9 ms");
    }

    #[test]
    fn a_program_that_ends_badly_has_failed() {
        assert_eq!(read("test result: FAILED. 3 passed; 2 failed; 0 ignored", false).failed, 2);
        assert_eq!(read("running 3 tests\n", false).failed, 1);
        assert_eq!(read("running 3 tests\n", true).failed, 1);
        assert_eq!(read(GOOD, false).failed, 1);
        let report = Report { programs: vec![read("", false)], took: Duration::ZERO };
        assert!(report.conclude().unwrap_err().to_string().contains("a integration"));
    }

    #[test]
    fn a_test_has_passed_where_it_ran_and_nothing_failed() {
        let mut report = Report { programs: vec![read(GOOD, true)], took: Duration::ZERO };
        report.programs[0].is_punctual = true;
        assert!(report.has_passed("a", "a"));
        assert!(!report.has_passed("a", "c") && !report.has_passed("b", "a"));
        assert_eq!(report.real_time_counts(), [1, 3]);
        report.programs[0].failed = 1;
        assert!(!report.has_passed("a", "a"));
    }
}
