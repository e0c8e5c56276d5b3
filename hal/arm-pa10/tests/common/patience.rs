//! What a loaded machine does to tests in real time.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

/// A test whose threads were not run in time is tried again so often: a mistake shows each time.
const TRIES: u32 = 6;

/// What the arm says when a thread, or the kernel's own that carries the bytes of terminals, was not run for some 10 ms. The rules
/// about these times are tested in virtual time.
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
pub fn patiently(test: impl Fn()) {
    for _ in 1..TRIES {
        match catch_unwind(AssertUnwindSafe(&test)) {
            Ok(()) => return,
            Err(panic) if was_held_up(panic.as_ref()) => {}
            Err(panic) => resume_unwind(panic),
        }
    }
    test();
}

fn was_held_up(panic: &(dyn Any + Send)) -> bool {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.is_some_and(|text| HELD_UP.iter().any(|mark| text.contains(mark)))
}
