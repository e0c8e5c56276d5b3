//! `pb3dp explain`: cause and remedy of a message, by its code.

use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::Args;
use pb3dp_cell::terminal::print_line;
use pb3dp_wiring::message_codes::{find, tables};

/// Arguments of `pb3dp explain`.
#[derive(Debug, Args)]
pub struct ExplainArgs {
    /// Code of a message, for instance PB3DP-CFG-005 or CFG-005; all codes without it.
    #[arg(value_name = "CODE")]
    code: Option<String>,
}

/// Runs the command.
///
/// # Errors
/// An unknown code.
pub fn run(args: &ExplainArgs) -> Result<ExitCode> {
    let Some(code) = &args.code else {
        for (title, codes) in tables() {
            print_line(title)?;
            for known in codes {
                print_line(&format!("    {}  {}", known.code, known.cause))?;
            }
        }
        return Ok(ExitCode::SUCCESS);
    };
    let Some(known) = find(code) else {
        bail!("{code}: no message has this code; `pb3dp explain` lists all codes");
    };
    print_line(&format!("{}\n    cause:  {}\n    remedy: {}", known.code, known.cause, known.remedy))?;
    Ok(ExitCode::SUCCESS)
}
