//! Runs in the emulated computer of `cargo xtask vm`: tests the I/O of this crate with the real drivers of a real kernel.
//!
//! It is the first and only program of that computer. It prints its results on the console, in the format of `report.rs`, and
//! requests there that cables be unplugged. For some tests it starts itself again, as a separate process and as another user.

#![allow(clippy::print_stdout, reason = "a program for the console")]

mod arcnet;
mod card;
mod cell;
mod clock {
    //! The time, for `system.rs`.
    pub use pb3dp_hal_platform::realtime::{now, sleep_until};
}
mod modem;
mod pulled;
mod realtime;
mod report;
mod serial;
mod system;
mod two_arms;

use std::process::ExitCode;

use report::Report;

/// Process ID of the first program.
const FIRST: u32 = 1;

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    if std::process::id() == FIRST {
        run(args.first().copied().unwrap_or_default());
        system::switch_off();
        return ExitCode::SUCCESS;
    }
    match args.as_slice() {
        ["open", path, baud] => serial::try_to_open(path, baud),
        ["read", path] => serial::try_to_read(path),
        ["open-bus", interface] => arcnet::try_to_open(interface),
        ["realtime"] => realtime::try_to_enter(),
        _ => {
            println!("this is started by `cargo xtask vm`");
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

fn run(suite: &str) {
    let mut report = Report::default();
    report.check("the computer starts", system::prepare);
    match suite {
        "serial" => {
            serial::check(&mut report);
            realtime::check(&mut report);
            pulled::check(&mut report);
        }
        "arcnet" => {
            arcnet::check(&mut report);
            two_arms::check(&mut report);
        }
        other => report.check("the suite is known", || Err(format!("there is no suite `{other}`").into())),
    }
    report.end();
}
