//! The program that `cargo xtask vm rig` runs in an emulated computer: the environment of the program `pb3dp` (`/bin/pb3dp`),
//! which cannot tell the difference. Two emulated arms are at the far ends of its serial lines, and two cameras (`vivid`)
//! show the view from their hand; in the suite `rig-one-device` one camera shows both views side by side.
//!
//! It is the first program of that computer. It reports its results on the console, in the format of `report.rs`.

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

#[path = "../../../crates/panel/tests/support/client.rs"]
#[allow(clippy::unwrap_used, dead_code, reason = "the checks may panic; other tests need more of it")]
mod client;

mod clock {
    //! The clock, for `system.rs`.
    pub use pb3dp_hal_platform::realtime::{now, sleep_until};
}

use std::process::ExitCode;

use report::Report;
use setup::Devices;

/// Process number of the first program.
const FIRST: u32 = 1;

fn main() -> ExitCode {
    if std::process::id() != FIRST {
        println!("start this program by `cargo xtask vm rig`");
        return ExitCode::FAILURE;
    }
    let mut report = Report::default();
    report.check("the computer starts", system::prepare);
    let suite = std::env::args().nth(1).unwrap_or_default();
    match Devices::of_suite(&suite) {
        Some(devices) => {
            let world = run::check(devices, &mut report);
            commands::check(devices, &mut report);
            drop(world);
        }
        None => report.check("the suite is known", || Err(format!("there is no suite `{suite}`").into())),
    }
    report.end();
    system::switch_off();
    ExitCode::SUCCESS
}
