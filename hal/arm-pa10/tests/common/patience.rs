//! What a loaded machine does to tests in real time.

#![allow(clippy::expect_used, clippy::print_stderr, reason = "helpers of tests")]

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use pb3dp_arm_pa10::io::witness::{TOO_LATE, Witness};

/// A test whose threads were not run in time is tried again so often: a mistake shows each time.
const FAILURES: u32 = 6;
/// With those that fail while the machine itself is late.
const TRIES: u32 = 9;

/// What the arm says when a thread, or the kernel's own that carries the bytes of terminals, was not run for some 10 ms. The rules
/// about these times are tested in virtual time.
#[allow(dead_code, reason = "not for every test")]
const HELD_UP: [&str; 10] = [
    "without a usable reply",
    "LinkLost",
    "the brakes stay closed",
    "no measurement since",
    "the newest measurement is",
    "no velocity for",
    "CommandTimeout",
    "host-silent",
    "HostSilent",
    "too loaded",
];

/// Runs a test, again where the machine was held up.
#[allow(dead_code, reason = "not for every test")]
pub fn patiently(test: impl Fn()) {
    patiently_where(&HELD_UP, test);
}

/// Runs a test, again where what it says of its failure has one of these marks. What fails while the machine holds even its most urgent
/// threads up shows nothing; on a machine that always does the test is left out, which is said.
pub fn patiently_where(marks: &[&str], test: impl Fn()) {
    let (mut failures, mut latest) = (0, std::time::Duration::ZERO);
    for _ in 0..TRIES {
        let witness = Witness::start().expect("a thread that watches the machine");
        let outcome = catch_unwind(AssertUnwindSafe(&test));
        let late = witness.end().max;
        let Err(panic) = outcome else { return };
        failures += u32::from(late <= TOO_LATE);
        latest = latest.max(late);
        if failures == FAILURES || !has(panic.as_ref(), marks) {
            resume_unwind(panic);
        }
    }
    eprintln!("left out: this machine holds threads of the highest priority up by {latest:?}");
}

fn has(panic: &(dyn Any + Send), marks: &[&str]) -> bool {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.is_some_and(|text| marks.iter().any(|mark| text.contains(mark)))
}
