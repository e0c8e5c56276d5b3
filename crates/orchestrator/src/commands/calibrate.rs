//! `pb3dp calibrate`: starts the program `pb3dp-calibrate`, which is not linked into this one
//! (docs/adr/0011-calibration.md).

use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use anyhow::{Context, Result};
use clap::Args;

/// The program's name.
const PROGRAM: &str = "pb3dp-calibrate";

/// Arguments of `pb3dp calibrate`: all of them are the other program's.
#[derive(Debug, Args)]
#[command(disable_help_flag = true)]
pub struct CalibrateArgs {
    /// What to calibrate; `pb3dp calibrate --help` tells.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

/// Becomes the other program, which stands beside this one or in `PATH`.
///
/// # Errors
/// If there is none.
pub fn run(args: &CalibrateArgs) -> Result<ExitCode> {
    let here = std::env::current_exe().ok();
    let program = here.as_deref().and_then(beside).unwrap_or_else(|| PathBuf::from(PROGRAM));
    // Comes back only if it fails.
    let error = Command::new(&program).args(&args.arguments).exec();
    Err(error).with_context(|| {
        format!(
            "{} cannot be started: build it with `cargo build --release -p pb3dp-calibration` and put it beside pb3dp",
            program.display()
        )
    })
}

/// The program in the folder of this one.
fn beside(here: &Path) -> Option<PathBuf> {
    let program = here.parent()?.join(PROGRAM);
    program.is_file().then_some(program)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_program_beside_this_one_is_taken() {
        let folder = tempfile::tempdir().expect("a folder");
        assert_eq!(beside(&folder.path().join("pb3dp")), None);
        std::fs::write(folder.path().join(PROGRAM), "").expect("written");
        assert_eq!(beside(&folder.path().join("pb3dp")), Some(folder.path().join(PROGRAM)));
    }
}
