//! `pb3dp arm`: what an integrator does with an arm before it serves anybody (docs/commissioning.md).

mod checklist;
pub mod confirm;
mod drive;
mod flights;
mod motion;
mod probe;
mod probe_report;
mod reset;
mod visit;

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Subcommand, ValueEnum};
use pb3dp_arm_pa10_emulation::line::mock_server::SocketAddr;
use pb3dp_cell::parts::ArmChoice;
use pb3dp_setup::layers::SetupArgs;

use crate::Program;

/// Arguments of `pb3dp arm`.
#[derive(Debug, Args)]
pub struct ArmArgs {
    #[command(subcommand)]
    command: ArmCommand,
}

#[derive(Debug, Subcommand)]
enum ArmCommand {
    /// Look at an arm, brakes on: gateway, limits, joints, status words, link. Exit code 1 if something does not fit.
    Probe(ProbeArgs),
    /// Bring an arm to its start_deg in one straight move of all joints; without --move only say how.
    Home(HomeArgs),
    /// Turn one joint by an angle; without --move only say how.
    Jog(JogArgs),
    /// Clear what stopped an arm, once its name was typed. Nothing moves; the brakes stay on.
    Reset(ResetArgs),
    /// Go through the checklist of a rig step by step (link, one axis, emergency stop, cable, kill -9, two arms) and write a dated report;
    /// without --move only say what would be done.
    Test(checklist::TestArgs),
    /// Bring an arm to poses one behind the other and take a pair at each, for a calibration; without --move only say how.
    Visit(visit::VisitArgs),
}

#[derive(Debug, Args)]
struct Place {
    #[command(flatten)]
    setup: SetupArgs,
    /// Which arm: vs carries the cameras, tc the target.
    #[arg(long, value_enum)]
    arm: ArmName,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum ArmName {
    Vs,
    Tc,
}

impl Place {
    fn choice(&self) -> ArmChoice {
        match self.arm {
            ArmName::Vs => ArmChoice::Vs,
            ArmName::Tc => ArmChoice::Tc,
        }
    }

    /// The arm as on the command line.
    fn arm_word(&self) -> &'static str {
        match self.arm {
            ArmName::Vs => "vs",
            ArmName::Tc => "tc",
        }
    }
}

/// Whether the other arm is there.
#[derive(Clone, Copy, Debug, Args)]
struct Company {
    /// Leave the other arm out: it is switched off, or not there. Nothing watches the room between both, and nothing that stops one stops
    /// the other.
    #[arg(long)]
    alone: bool,
}

impl Company {
    /// The other arm is left out.
    const ALONE: Self = Self { alone: true };

    /// What an operator has to type before this arm moves.
    fn word(self, choice: ArmChoice) -> String {
        let alone = if self.alone { " alone" } else { "" };
        format!("{}{alone}", choice.name())
    }
}

#[derive(Debug, Args)]
struct ProbeArgs {
    #[command(flatten)]
    place: Place,
    /// Messages to exchange with the arm, at least, for the figures of the link.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(10..=100_000))]
    exchanges: u32,
    /// One JSON object on standard output instead of tables.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct MotionArgs {
    /// Move the arm, once its name was typed. Without it nothing moves.
    #[arg(long = "move")]
    moves: bool,
    #[command(flatten)]
    company: Company,
    /// Folder for the flight recorders of a move that is broken off; a new one in out/ unless it is given.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Each cycle's joints as a line of JSON, for the program that has started this one.
    #[arg(long, hide = true)]
    report_joints: bool,
    /// Where the arm is found instead, by TCP.
    #[arg(long, hide = true, value_name = "ADDRESS:PORT")]
    line: Option<SocketAddr>,
}

#[derive(Debug, Args)]
struct HomeArgs {
    #[command(flatten)]
    place: Place,
    #[command(flatten)]
    motion: MotionArgs,
}

#[derive(Debug, Args)]
struct JogArgs {
    #[command(flatten)]
    place: Place,
    /// The axis, 1 at the base to 7 at the flange.
    #[arg(long, value_name = "1..7", value_parser = clap::value_parser!(u8).range(1..=7))]
    axis: u8,
    /// By how much, degrees, at most 30 at a time.
    #[arg(long, value_name = "DEGREES", value_parser = parse_jog, allow_hyphen_values = true)]
    by: f64,
    #[command(flatten)]
    motion: MotionArgs,
}

#[derive(Debug, Args)]
struct ResetArgs {
    #[command(flatten)]
    place: Place,
}

/// Farthest jog, degrees.
const JOG_MAX_DEG: f64 = 30.0;

fn parse_jog(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(degrees) if degrees != 0.0 && degrees.abs() <= JOG_MAX_DEG => Ok(degrees),
        _ => Err(format!("{text:?}: must be an angle in degrees, not 0 and from -{JOG_MAX_DEG} to {JOG_MAX_DEG}")),
    }
}

/// Runs the command.
///
/// # Errors
/// A configuration that is refused, an arm that does not answer, or that stopped.
pub fn run(args: &ArmArgs, program: Program) -> anyhow::Result<ExitCode> {
    match &args.command {
        ArmCommand::Probe(args) => probe::run(args),
        ArmCommand::Reset(ResetArgs { place }) => reset::run(place),
        ArmCommand::Test(args) => checklist::run(args, program.commit),
        ArmCommand::Visit(args) => visit::run(args, program.last_words),
        ArmCommand::Home(HomeArgs { place, motion }) => motion::run(place, motion, motion::Goal::Start),
        ArmCommand::Jog(JogArgs { place, axis, by, motion }) => {
            motion::run(place, motion, motion::Goal::Jog { joint: usize::from(axis - 1), by_rad: by.to_radians() })
        }
    }
}
