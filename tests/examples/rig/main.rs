//! What `cargo xtask vm rig` runs in an emulated computer: the world around the program `pb3dp`, which is there as `/bin/pb3dp` and knows
//! nothing of it. Two emulated arms stand at the far ends of its serial lines, and two cameras (`vivid`) show what their hand would see.
//!
//! It is the first program of that computer. What it finds out it says on the console, in the words of `report.rs`.

#![allow(clippy::print_stdout, clippy::panic, reason = "a program for the console, whose checks may panic")]

mod commands;
mod images;
mod lines;
mod outputs;
mod program;
#[path = "../../../hal/arm-pa10/examples/arm_guest/report.rs"]
#[allow(dead_code, reason = "other programs have cables that are pulled")]
mod report;
mod run;
mod setup;
#[path = "../../../hal/arm-pa10/examples/arm_guest/system.rs"]
#[allow(dead_code, reason = "other programs read what the kernel says")]
mod system;
mod world;

mod clock {
    //! The time, for `system.rs`.
    pub use pb3dp_hal_platform::realtime::{now, sleep_until};
}

use std::process::ExitCode;

use report::Report;

/// Process number of the first program.
const FIRST: u32 = 1;

fn main() -> ExitCode {
    if std::process::id() != FIRST {
        println!("this is started by `cargo xtask vm rig`");
        return ExitCode::FAILURE;
    }
    let mut report = Report::default();
    report.check("the computer starts", system::prepare);
    let world = run::check(&mut report);
    commands::check(&mut report);
    drop(world);
    report.end();
    system::switch_off();
    ExitCode::SUCCESS
}
