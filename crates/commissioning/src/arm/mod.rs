//! `pb3dp arm`: commissioning of an arm (docs/commissioning.md).

mod checklist;
pub mod confirm;
mod drive;
mod flights;
mod motion;
mod probe;
mod probe_report;
mod reset;
mod stillness;
mod visit;
mod visit_run;

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
    /// Probe an arm with brakes on: gateway, limits, joints, status words, link. Exit code 1 on a mismatch.
    Probe(ProbeArgs),
    /// Move an arm to its start_deg in one straight move of all joints; without --move only show the plan.
    Home(HomeArgs),
    /// Turn one joint by an angle; without --move only show the plan.
    Jog(JogArgs),
    /// Clear a latched stop of an arm after its name is typed. Nothing moves; the brakes stay on.
    Reset(ResetArgs),
    /// Run the rig checklist step by step (link, one axis, emergency stop, cable, kill -9, two arms) and write a dated report; without
    /// --move only show the plan.
    Test(checklist::TestArgs),
    /// Find the bits of the status words that show emergency stop, limit switch, dead-man switch and power, with the brakes on, and print
    /// the lines for the setup. Nothing moves.
    Signals(checklist::signals::SignalsArgs),
    /// Move an arm through a list of poses and record a stereo pair at each, for a calibration; without --move only show the plan.
    Visit(visit::VisitArgs),
}

#[derive(Debug, Args)]
struct Place {
    #[command(flatten)]
    setup: SetupArgs,
    /// Arm: vs carries the cameras, tc the target; messages call them vs-robot and tc-robot.
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

    /// Name of the arm on the command line.
    fn arm_word(&self) -> &'static str {
        match self.arm {
            ArmName::Vs => "vs",
            ArmName::Tc => "tc",
        }
    }
}

/// Whether the other arm takes part.
#[derive(Clone, Copy, Debug, Args)]
struct Company {
    /// Leave out the other arm, which is powered off or absent. Then the distance between the arms is not monitored, and a stop of one arm
    /// does not stop the other.
    #[arg(long)]
    alone: bool,
}

impl Company {
    /// Word that the operator types before this arm moves.
    fn word(self, choice: ArmChoice) -> String {
        let alone = if self.alone { " alone" } else { "" };
        format!("{}{alone}", choice.name())
    }
}

#[derive(Debug, Args)]
struct ProbeArgs {
    #[command(flatten)]
    place: Place,
    /// Number of messages to exchange with the arm, at least, for the link figures.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(10..=100_000))]
    exchanges: u32,
    /// One JSON object on standard output instead of tables.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
struct MotionArgs {
    /// Move the arm after its name is typed. Without it nothing moves.
    #[arg(long = "move")]
    moves: bool,
    #[command(flatten)]
    company: Company,
    /// Folder for the flight recorders of an aborted move; a new one in out/ unless given.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Move for a checklist: its settings come as the first line of standard input, and the joints of each cycle go back as JSON.
    #[arg(long, hide = true)]
    report_joints: bool,
    /// TCP address of the arm, instead of the configured one.
    #[arg(long, hide = true, value_name = "ADDRESS:PORT", requires_all = ["line_key", "report_joints"])]
    line: Option<SocketAddr>,
    /// Key file of the gateway at this address.
    #[arg(long, hide = true, value_name = "FILE", requires = "line")]
    line_key: Option<PathBuf>,
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
    /// Angle, degrees, at most 30 at a time.
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

/// Largest jog, degrees.
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
/// A refused configuration, or an arm that does not answer or is stopped.
pub fn run(args: &ArmArgs, program: Program) -> anyhow::Result<ExitCode> {
    match &args.command {
        ArmCommand::Probe(args) => probe::run(args),
        ArmCommand::Reset(ResetArgs { place }) => reset::run(place),
        ArmCommand::Test(args) => checklist::run(args, program.commit),
        ArmCommand::Signals(args) => checklist::signals::run(args),
        ArmCommand::Visit(args) => visit::run(args, program),
        ArmCommand::Home(HomeArgs { place, motion }) => motion::run(place, motion, motion::Goal::Start),
        ArmCommand::Jog(JogArgs { place, axis, by, motion }) => {
            motion::run(place, motion, motion::Goal::Jog { joint: usize::from(axis - 1), by_rad: by.to_radians() })
        }
    }
}
