//! The program that `cargo xtask vm cameras` runs in an emulated computer: this crate with the real V4L2 of a real kernel, and
//! its driver `vivid`, whose two cameras fail on request.
//!
//! It is the first and only program of that computer. It prints its results on the console, in the format of `report.rs`.

#![allow(clippy::print_stdout, clippy::panic, reason = "a program for the console, whose checks may panic")]

mod cameras;
#[path = "../../../arm-pa10/examples/arm_guest/report.rs"]
#[allow(dead_code, reason = "used by programs that disconnect cables")]
mod report;
#[path = "../../../arm-pa10/examples/arm_guest/system.rs"]
#[allow(dead_code, reason = "used by programs that read the kernel log")]
mod system;

use std::process::ExitCode;

use report::Report;

mod clock {
    //! The time, for `system.rs`.

    use pb3dp_camera_v4l2::linux::Linux;
    use pb3dp_camera_v4l2::video::VideoSystem;
    use pb3dp_geometry::MonotonicTime;

    pub fn now() -> MonotonicTime {
        MonotonicTime::from_nanos(Linux.monotonic_nanos().unsigned_abs())
    }

    pub fn sleep_until(at: MonotonicTime) {
        std::thread::sleep(at.saturating_since(now()));
    }
}

/// Process number of the first program.
const FIRST: u32 = 1;

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    if std::process::id() == FIRST {
        let mut report = Report::default();
        report.check("the computer starts", system::prepare);
        cameras::check(&mut report);
        report.end();
        system::switch_off();
        return ExitCode::SUCCESS;
    }
    match words.as_slice() {
        ["open"] => cameras::try_to_open(),
        _ => {
            println!("this program is started by `cargo xtask vm cameras`");
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}
