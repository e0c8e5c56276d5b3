//! The program `pb3dp`.

use std::io::Write;
use std::process::ExitCode;

use clap::{CommandFactory, Parser};
use pb3dp_orchestrator::cli::{Cli, Command};
use pb3dp_orchestrator::{commands, logging, panics};
use pb3dp_wiring::message_codes::{error_text, key_of, option_of, spell_arguments};

const PROGRAM: pb3dp_commissioning::Program =
    pb3dp_commissioning::Program { commit: pb3dp_orchestrator::COMMIT, final_flush: logging::final_flush };

/// Exit code of a wrong command line, as in clap.
const USAGE: u8 = 2;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let reads_setup = matches!(cli.command, Command::Run(_) | Command::Replay(_) | Command::Identify(_));
    spell_arguments(if reads_setup { key_of } else { option_of });
    // Lives until the end, also after a panic.
    let _log = match logging::init(cli.log_format, cli.filter()) {
        Ok(log) => log,
        Err(error) => {
            // The log does not exist yet.
            let _ = writeln!(std::io::stderr(), "error: {error:#}");
            return ExitCode::from(USAGE);
        }
    };
    panics::install();
    let outcome = match &cli.command {
        Command::Run(args) => commands::run::run(args),
        Command::Estimate(args) => commands::estimate::run(args),
        Command::Track(args) => commands::track::run(args),
        Command::Extract(args) => commands::extract::run(args),
        Command::Recover(args) => commands::recover::run(args),
        Command::Replay(args) => commands::replay::run(args),
        Command::Report(args) => commands::report::run(args),
        Command::Panel(args) => commands::panel::run(args),
        Command::Identify(args) => commands::identify::run(args),
        Command::Arm(args) => pb3dp_commissioning::arm::run(args, PROGRAM),
        Command::MockArm(args) => pb3dp_commissioning::mock_arm::run(args),
        Command::Gateway(args) => pb3dp_commissioning::gateway::run(args),
        Command::Cameras(args) => commands::cameras::run(args),
        Command::Calibrate(args) => pb3dp_calibration::command::run(args),
        Command::Rig(args) => commands::rig::run(args),
        Command::Config(args) => commands::config::run(args),
        Command::Doctor(args) => commands::doctor::run(args),
        Command::Explain(args) => commands::explain::run(args),
        Command::Completions(args) => commands::completions::run(args, Cli::command()),
        Command::Generate(args) => commands::generate::run(args, &Cli::command()),
    };
    match outcome {
        Ok(code) => code,
        Err(error) => {
            tracing::error!("{}", error_text(&error));
            ExitCode::FAILURE
        }
    }
}
