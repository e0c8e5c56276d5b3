//! The program `pb3dp`: its command line, the log, and all commands but those of one arm, which are in `pb3dp-commissioning`.
//!
//! The library exists so that the system tests can run the commands; the binary is `pb3dp`.

pub mod arguments;
pub mod cli;
pub mod commands;
pub mod logging;
mod numbers;
pub mod panel_access;
pub mod panics;
mod progress;

/// The commit that the program was built from.
pub const COMMIT: &str = match option_env!("PB3DP_COMMIT") {
    Some(commit) => commit,
    None => "unknown",
};
