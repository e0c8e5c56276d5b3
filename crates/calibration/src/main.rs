//! The program `pb3dp-calibrate`: the commands of `pb3dp calibrate` alone, without cameras and arms.

use std::process::ExitCode;

use clap::Parser;
use pb3dp_calibration::command;

fn main() -> ExitCode {
    match command::run(&command::Cli::parse().args) {
        Ok(code) => code,
        Err(error) => {
            command::tell_error(&error);
            ExitCode::FAILURE
        }
    }
}
