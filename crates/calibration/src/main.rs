//! The program `pb3dp-calibrate`, which `pb3dp calibrate` starts: command line, image files and printed results.

mod command;

use std::process::ExitCode;

use clap::Parser;

fn main() -> ExitCode {
    match command::run(&command::Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            command::tell_error(&error);
            ExitCode::FAILURE
        }
    }
}
