//! Tests that need their own process, one after the other: a host program that is killed, and heap allocations of all threads.
//!
//! With the argument `host` the program is the host of [`killed`].

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod killed;
mod no_allocation;

use libtest_mimic::{Arguments, Trial};
use pb3dp_test_support::real_time::{Priority, Turn, in_real_time_as};

const TESTS: [(&str, fn()); 5] = [
    ("killed::braked_after_kill_9", killed::killed),
    ("killed::reset_at_once", killed::killed_and_reset_at_once),
    ("killed::frozen", killed::frozen),
    ("killed::panicked", killed::panicked),
    ("no_allocation::exchanges", no_allocation::exchanges),
];

fn main() {
    let words: Vec<String> = std::env::args().collect();
    if words.get(1).is_some_and(|word| word == "host") {
        return killed::host(&words[2], words.get(3).is_some());
    }
    let mut arguments = Arguments::from_args();
    arguments.test_threads = Some(1);
    let trial = |(name, test): (&'static str, fn())| {
        Trial::test(name, move || {
            in_real_time_as(name, Turn::Alone, Priority::Granted, test);
            Ok(())
        })
    };
    libtest_mimic::run(&arguments, TESTS.map(trial).into()).exit();
}
