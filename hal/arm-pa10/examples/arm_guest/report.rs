//! Output on the console; xtask's `vm/console.rs` parses the same words.

use std::error::Error;
use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::system;

/// Measured values for the reader, or why a check failed.
pub type Outcome = Result<String, Box<dyn Error>>;

/// Counts checks.
#[derive(Default)]
pub struct Report {
    checks: u32,
}

impl Report {
    /// Runs a check. A panic is a failure.
    pub fn check(&mut self, name: &str, check: impl FnOnce() -> Outcome) {
        self.checks += 1;
        match catch_unwind(AssertUnwindSafe(check)) {
            Ok(Ok(figures)) if figures.is_empty() => println!("vm: passed {name}"),
            Ok(Ok(figures)) => println!("vm: passed {name}: {figures}"),
            Ok(Err(error)) => failed(name, &chain(error.as_ref())),
            Err(_) => failed(name, "it panicked"),
        }
    }

    /// Ends the report.
    pub fn end(self) {
        println!("vm: end {}", self.checks);
    }
}

fn failed(name: &str, why: &str) {
    println!("vm: failed {name}: {}", why.replace('\n', " "));
    for line in system::last_kernel_messages(8) {
        note(&format!("kernel: {line}"));
    }
}

/// A note for the reader.
pub fn note(text: &str) {
    println!("vm: note {text}");
}

/// Requests that a device be unplugged. The kernel reports when this has happened.
pub fn unplug(device: &str) {
    println!("vm: unplug {device}");
}

/// Requests that the device be plugged in again.
pub fn plug(device: &str) {
    println!("vm: plug {device}");
}

/// An error with its causes.
pub fn chain(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(source) = cause {
        text.push_str(": ");
        text.push_str(&source.to_string());
        cause = source.source();
    }
    text
}

/// An error unless the condition holds.
pub fn ensure(holds: bool, otherwise: impl FnOnce() -> String) -> Result<(), Box<dyn Error>> {
    if holds { Ok(()) } else { Err(otherwise().into()) }
}
