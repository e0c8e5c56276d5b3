//! `pb3dp doctor`: checks whether this computer meets the needs of a rig, with the remedies (docs/rig.md).

mod access;
mod cameras;
mod disk;
mod drivers;
mod keys;
mod needs;
mod realtime;
mod report;
mod serial;
mod signals;
mod system;
#[cfg(test)]
mod tests;
mod unit;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use clap::Args;
use pb3dp_setup::layers::SetupArgs;

use self::needs::Needs;
use self::report::Report;
pub(super) use self::system::free_bytes;
use pb3dp_cell::finding::Finding;
use pb3dp_cell::terminal::print_line;

use self::system::{Machine, System};

/// Meaning of exit code and `--json`.
const EXIT_CODES: &str = "Exit code: 0 if everything passes, 1 if there are warnings, 2 if something fails.
Object of --json:
  worst     pass, warning or fail
  findings  check, verdict (pass, warning or fail), found, advice (what to do, or null) of each";

/// Arguments of `pb3dp doctor`.
#[derive(Debug, Args)]
#[command(after_long_help = EXIT_CODES)]
pub struct DoctorArgs {
    /// Check the needs of this setup or gateway: a file or a built-in setup; may be repeated, later ones override. Default: the
    /// needs of any rig.
    #[arg(long, value_name = "FILE|NAME")]
    config: Vec<PathBuf>,
    /// Set one key of the setup.
    #[arg(long, value_name = "KEY=VALUE", requires = "config")]
    set: Vec<String>,
    /// Folder for recordings.
    #[arg(long, value_name = "DIR", default_value = "out")]
    recordings: PathBuf,
    /// One JSON object on standard output instead of text.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// If standard output cannot be written.
pub fn run(args: &DoctorArgs) -> Result<ExitCode> {
    let needs = match args.config.as_slice() {
        [] => Ok(Needs::general(args.recordings.clone())),
        configs => {
            let setup = SetupArgs { configs: configs.to_vec(), set: args.set.clone(), ..SetupArgs::default() };
            Needs::of_config(&setup, args.recordings.clone())
        }
    };
    let report = match needs {
        Ok(needs) => Report::of(findings(&Machine::new(), &needs)),
        Err(error) => {
            let found = format!("{:#}", anyhow::Error::new(error));
            Report::of(vec![Finding::fail("configuration", found, "correct the file; nothing else was checked")])
        }
    };
    let text = if args.json { report.json()? } else { report.text() };
    print_line(&text)?;
    Ok(ExitCode::from(report.exit_code()))
}

/// All checks, in the order of the output.
fn findings(system: &dyn System, needs: &Needs) -> Vec<Finding> {
    let mut findings = realtime::check(system, needs);
    findings.extend(access::check(system, &needs.groups()));
    findings.extend(serial::check(system, needs));
    findings.extend(signals::check(needs));
    findings.extend(keys::check(needs));
    findings.extend(cameras::check(system, needs));
    findings.extend(drivers::modules(system, needs));
    findings.extend(drivers::arcnet(system, needs));
    findings.push(disk::check(system, needs));
    findings.extend(unit::check(system, needs));
    findings
}
