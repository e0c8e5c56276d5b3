//! The command line.

use clap::{ArgAction, Parser, Subcommand};
use pb3dp_calibration::command::CalibrateArgs;
use pb3dp_commissioning::arm::ArmArgs;
use pb3dp_commissioning::gateway::GatewayArgs;
use pb3dp_commissioning::mock_arm::MockArmArgs;

use crate::arguments::{EstimateArgs, RunArgs, TrackArgs};
use crate::commands::cameras::CamerasArgs;
use crate::commands::completions::CompletionsArgs;
use crate::commands::config::ConfigArgs;
use crate::commands::doctor::DoctorArgs;
use crate::commands::explain::ExplainArgs;
use crate::commands::extract::ExtractArgs;
use crate::commands::generate::GenerateArgs;
use crate::commands::identify::IdentifyArgs;
use crate::commands::panel::PanelArgs;
use crate::commands::recover::RecoverArgs;
use crate::commands::replay::ReplayArgs;
use crate::commands::report::ReportArgs;
use crate::commands::rig::RigArgs;
use crate::logging::LogFormat;

/// Help footer of every command except `doctor`, which has its own.
const EXIT_CODES: &str = "\
Exit codes: 0 good; 1 failed; 2 the command line is not understood; 3 unsure (--strict) or different (config diff, replay)";

impl Cli {
    /// Log options.
    pub fn filter(&self) -> &str {
        match (&self.log, self.quiet, self.verbose) {
            (Some(filter), ..) => filter,
            (None, true, _) => "warn",
            (None, false, 0) => "info",
            (None, false, 1) => "debug",
            (None, false, _) => "trace",
        }
    }
}

/// Stereo vision and visual servoing without object models: the pose of any object from one calibrated stereo pair.
#[derive(Debug, Parser)]
#[command(name = "pb3dp", version, propagate_version = true, max_term_width = 100, after_help = EXIT_CODES)]
pub struct Cli {
    /// The command.
    #[command(subcommand)]
    pub command: Command,
    /// Log level or directives, for instance `debug` or `pb3dp_cell=trace,info`; default `info`.
    #[arg(long, global = true, value_name = "FILTER", conflicts_with_all = ["quiet", "verbose"])]
    pub log: Option<String>,
    /// Log warnings and errors only.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Log more: -v as --log debug, -vv as --log trace.
    #[arg(short, long, global = true, action = ArgAction::Count)]
    pub verbose: u8,
    /// Log lines as readable text or as JSON, always on standard error.
    #[arg(long, global = true, value_enum, default_value = "human")]
    pub log_format: LogFormat,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run the complete loop: cameras, estimation, servo, arms.
    Run(RunArgs),
    /// Estimate the pose of a region in stereo images.
    Estimate(EstimateArgs),
    /// Track a region through a recorded stereo sequence.
    Track(TrackArgs),
    /// Write the stereo pairs of an MCAP recording as image files.
    Extract(ExtractArgs),
    /// Make a whole file from a recording that was broken off by a kill or a full disk.
    Recover(RecoverArgs),
    /// Run a recorded run again, from its recorded inputs, and compare to the bit, or compare two runs; exit code 3 if they differ.
    Replay(ReplayArgs),
    /// Write the page and the tables of a recorded run.
    Report(ReportArgs),
    /// Point at objects with the mouse, on recorded images or bare cameras, without arms.
    Panel(Box<PanelArgs>),
    /// Measure properties of the rig that a setup needs: its delays.
    Identify(IdentifyArgs),
    /// Commission an arm: read its state, jog it, move it to its start pose (docs/commissioning.md).
    Arm(ArmArgs),
    /// Run an emulated PA-10 in real time, with faults on request.
    MockArm(MockArmArgs),
    /// Run the gateway of one PA-10: it owns the bus and its cycle, and serves one host (docs/gateway.md).
    Gateway(GatewayArgs),
    /// List, check, view and record the cameras of a rig (docs/rig.md).
    Cameras(CamerasArgs),
    /// Calibrate cameras and stereo rigs from images of a board (docs/calibration.md).
    Calibrate(CalibrateArgs),
    /// Plan a stereo rig: accuracy of cameras, lenses and a baseline (docs/rig.md).
    Rig(RigArgs),
    /// Show, check, compare and explain setups, or create one.
    Config(ConfigArgs),
    /// Check whether this computer meets the needs of a rig, with the remedies (docs/rig.md).
    Doctor(DoctorArgs),
    /// Print cause and remedy of a message, by its code.
    Explain(ExplainArgs),
    /// Print the completion script for a shell.
    Completions(CompletionsArgs),
    /// Write the reference pages, manual pages and completion scripts.
    #[command(hide = true)]
    Generate(GenerateArgs),
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;
    use pb3dp_wiring::message_codes::{Argument, option_of};

    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn messages_ask_for_options_that_exist() {
        let program = Cli::command();
        let estimate = program.find_subcommand("estimate").unwrap();
        for argument in Argument::ALL {
            let option = option_of(argument);
            let exists = estimate.get_arguments().any(|known| known.get_long() == option.strip_prefix("--"));
            assert!(exists, "{argument:?}: {option}");
        }
    }

    #[test]
    fn one_pair_needs_all_of_its_parts() {
        let parse = |args: &[&str]| Cli::try_parse_from([&["pb3dp", "estimate"], args].concat());
        assert!(parse(&["--cases", "d"]).is_ok());
        assert!(parse(&["--left", "l", "--right", "r", "--calib", "c", "--region", "click:1,2"]).is_ok());
        let error = parse(&["--left", "l", "--right", "r", "--calib", "c"]).unwrap_err().to_string();
        assert!(error.contains("--region"), "{error}");
        assert!(parse(&[]).is_err());
    }
}
