//! What a loaded machine does to tests in real time.

#![allow(clippy::expect_used, clippy::print_stderr, reason = "helpers of tests")]

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use pb3dp_arm_pa10::io::witness::{TOO_LATE, Witness};

/// A test that fails so often on a machine that keeps time is wrong: a mistake shows each time.
const FAILURES: u32 = 3;
/// With those that fail while the machine itself is late.
const TRIES: u32 = 7;

/// How late any thread of a test was at worst since this was last looked at, µs.
static LATENESS_US: AtomicU64 = AtomicU64::new(0);

/// A thread of a test was late by itself.
#[allow(dead_code, reason = "not for every test")]
pub fn note_lateness(lateness: Duration) {
    LATENESS_US.fetch_max(lateness.as_micros() as u64, Ordering::SeqCst);
}

/// Runs a test whose threads have to be run in time, again where it fails. What fails while the machine holds up threads that only
/// sleep, or bytes that only go through a line, shows nothing: on a machine that always does the test is left out, which is said. What
/// an arm does where it is late is tested in virtual time, and in the emulated computer, whose time does not depend on the machine's.
pub fn patiently(test: impl Fn()) {
    let (mut failures, mut latest) = (0, Duration::ZERO);
    let mut why = String::new();
    for _ in 0..TRIES {
        let witness = Witness::of_lines().expect("threads and a line that watch the machine");
        let outcome = catch_unwind(AssertUnwindSafe(&test));
        let late = Duration::from_micros(LATENESS_US.swap(0, Ordering::SeqCst)).max(witness.end().max);
        let Err(panic) = outcome else { return };
        failures += u32::from(late <= TOO_LATE);
        if failures == FAILURES {
            resume_unwind(panic);
        }
        latest = latest.max(late);
        why = text(panic.as_ref()).to_owned();
    }
    eprintln!("left out: this machine holds threads or lines up by {latest:?}; the last of {TRIES} failures: {why}");
}

fn text(panic: &(dyn Any + Send)) -> &str {
    let owned = panic.downcast_ref::<String>().map(String::as_str);
    owned.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic")
}
