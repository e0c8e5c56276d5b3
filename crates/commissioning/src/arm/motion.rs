//! `pb3dp arm home` and `pb3dp arm jog`: one slow move behind limiter and guard, only after the operator's confirmation.

use std::collections::BTreeMap;
use std::io::Write;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::SystemTime;

use anyhow::{Context, Result, bail};
use pb3dp_cell::attended_motion::AttendedMotion;
use pb3dp_cell::live::enter_control_thread;
use pb3dp_cell::parts::ArmChoice;
use pb3dp_cell::plan::Plan;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_api::{Clock, JointCommand, JointState};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_kinematics::{DOF, JointVector};
use pb3dp_setup::setup::{ArmLink, Setup, read_layers};
use pb3dp_wiring::commissioning::{SlowArm, check_other_is_off, set_line, slow_setup, wire_slow};
use serde::{Deserialize, Serialize};

use super::drive::{self, Cycle, Drive};
use super::flights::{self, folder_of};
use super::{MotionArgs, Place, confirm};

/// Joint speed of a jog: that of the first motion in the rig checklist.
pub const JOG_RAD_PER_S: f64 = 0.02;

/// Joint speed of the home move: leaves time for the emergency stop.
const HOME_RAD_PER_S: f64 = 0.1;

/// Goal of a move.
#[derive(Clone, Copy, Debug)]
pub enum Goal {
    /// The start_deg of the setup.
    Start,
    /// One joint by an angle.
    Jog {
        /// Index from the base, 0 to 6.
        joint: usize,
        /// Angle, rad.
        by_rad: f64,
    },
}

impl Goal {
    fn name(self) -> &'static str {
        match self {
            Self::Start => "home",
            Self::Jog { .. } => "jog",
        }
    }

    fn joint_max_rad_per_s(self) -> f64 {
        match self {
            Self::Start => HOME_RAD_PER_S,
            Self::Jog { .. } => JOG_RAD_PER_S,
        }
    }

    fn by_rad(self, from_rad: &JointVector, start_rad: &JointVector) -> JointVector {
        match self {
            Self::Start => start_rad - from_rad,
            Self::Jog { joint, by_rad } => {
                let mut by = JointVector::zeros();
                by[joint] = by_rad;
                by
            }
        }
    }
}

/// Runs the command.
///
/// # Errors
/// A refused configuration or move, a missing confirmation, an arm that does not answer or was stopped.
pub fn run(place: &Place, args: &MotionArgs, goal: Goal) -> Result<ExitCode> {
    let (choice, began) = (place.choice(), SystemTime::now());
    // Before any thread starts.
    let mut signals = StopSignals::take_over()?;
    let mut setup = read_layers(&place.setup)?;
    if args.report_joints {
        confirm_by_parent(&setup)?;
        if let (Some(address), Some(key_file)) = (args.line, &args.line_key) {
            set_line(&mut setup, choice, address, key_file.clone());
        }
    }
    if choice.of(&setup).link == ArmLink::InProcess {
        bail!("{}.backend = \"mock\" has no arm to move; set emulated, serial, tcp or local", choice.of(&setup).key);
    }
    if args.moves && !choice.of(&setup).link.is_toy() {
        confirm::need_no_button(&setup)?;
    }
    let setup = slow_setup(&setup, choice, goal.joint_max_rad_per_s())?;
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    if args.company.alone {
        check_other_is_off(&setup, choice, &clock)?;
    }
    let mut arm = wire_slow(&setup, choice, !args.company.alone, &clock)?;
    let now_rad = arm.driven.exchange(JointCommand::Hold)?.position_rad;
    let plan = Plan::new(choice.of(&setup), now_rad, goal.by_rad(&now_rad, &choice.of(&setup).start_rad))?;
    show(&setup, (choice, goal), &plan, &mut arm)?;
    if !args.moves {
        print_line("dry run: the brakes stayed on and nothing moved; use --move to move the arm")?;
        return Ok(ExitCode::SUCCESS);
    }
    let attended = match args.report_joints {
        true => None,
        false => confirmed((&setup, choice, args), &clock, &mut signals)?,
    };
    enter_control_thread();
    let mut drive = Drive::new(&mut arm, &plan, &clock, setup.control_period).attended(attended.as_ref());
    let outcome = drive.run(&mut signals, &mut |cycle| if args.report_joints { tell(cycle) } else { Ok(()) });
    let lost = drive.lost();
    let reached = drive::stopped_after(choice, &mut arm, outcome);
    drop(attended);
    if let Err(failure) = &reached {
        let folder = args.out.clone().unwrap_or_else(|| folder_of(goal.name(), choice, began));
        for kept in flights::keep(&folder, choice, &arm, failure, clock.now()) {
            match kept {
                Ok(path) => tracing::info!("flight recorder: {}", path.display()),
                Err(error) => tracing::warn!("{error:#}"),
            }
        }
    }
    let reached = reached?;
    let off_deg = (reached.position_rad - plan.end_rad()).amax().to_degrees();
    print_line(&format!("done: every joint within {off_deg:.3} degrees of its end, brakes on; {lost} replies lost"))?;
    Ok(ExitCode::SUCCESS)
}

/// Waits until the operator has typed the name of the arm; listens to the operator of an arm that is not emulated from then on.
fn confirmed(
    (setup, choice, args): (&Setup, ArmChoice, &MotionArgs),
    clock: &Arc<dyn Clock>,
    signals: &mut StopSignals,
) -> Result<Option<AttendedMotion>> {
    let (is_real, word) = (!choice.of(setup).link.is_toy(), args.company.word(choice));
    let key_within = setup.operator_key_within;
    let console = confirm::confirmed(&word, is_real.then_some(key_within), signals)?;
    let listen = |console: confirm::Console| {
        AttendedMotion::start(console.into_lines(), key_within, Arc::clone(clock), std::io::stdout(), |_| {})
    };
    let attended = is_real.then(|| listen(console)).transpose()?;
    // The other arm may have been enabled while nobody typed.
    if args.company.alone {
        check_other_is_off(setup, choice, clock)?;
    }
    Ok(attended)
}

/// All settings of a setup on one line, which a checklist hands to the process that moves the arm.
pub fn settings_line(setup: &Setup) -> Result<String> {
    let all: BTreeMap<_, _> = setup.layers.effective().into_iter().map(|one| (one.key, one.value)).collect();
    Ok(serde_json::to_string(&all)?)
}

/// Confirms a move that a checklist has started: its person has typed the name for exactly these settings.
fn confirm_by_parent(setup: &Setup) -> Result<()> {
    let mut line = String::new();
    std::io::stdin().read_line(&mut line).context("cannot read the settings of the checklist")?;
    if line.trim_end() != settings_line(setup)? {
        bail!("the settings have changed since the checklist began; nothing was moved: begin the checklist again");
    }
    Ok(())
}

/// Writes the joint positions for the parent process. If that process has ended, the move ends.
fn tell(cycle: &Cycle<'_>) -> Result<()> {
    let line = serde_json::to_string(&JointReport::of(cycle.measured))?;
    let mut out = std::io::stdout().lock();
    writeln!(out, "{line}").and_then(|()| out.flush()).context("the process that reads the joint positions has ended")
}

/// Joint positions for the parent process.
#[derive(Debug, Serialize, Deserialize)]
pub struct JointReport {
    /// Joint angles, rad, from the base.
    pub position_rad: [f64; DOF],
}

impl JointReport {
    fn of(measured: &JointState) -> Self {
        Self { position_rad: measured.position_rad.into() }
    }
}

/// Prints the planned commands.
fn show(setup: &Setup, (choice, goal): (ArmChoice, Goal), plan: &Plan, arm: &mut SlowArm) -> Result<()> {
    let duration = plan.duration();
    let commands = (duration.as_secs_f64() / setup.control_period.as_secs_f64()).ceil();
    print_line(&format!("{}: {}, {}", choice.name(), goal.name(), arm.driven.info().name))?;
    print_line(plan.table(choice.of(setup)).trim_end())?;
    print_line(&format!(
        "1. servos on, brakes on, at least 100 exchanges to test the link; brakes open at speed 0\n2. {commands} velocities, one \
         every {:?}, for {:.2} s: all joints together on a straight path, stationary at both ends\n3. speed 0, brakes on, servos off",
        setup.control_period,
        duration.as_secs_f64()
    ))?;
    let other_rad = match &mut arm.other {
        Some(other) => Some(other.driven.exchange(JointCommand::Hold)?.position_rad),
        None => None,
    };
    show_room(setup, choice, plan, other_rad.as_ref())
}

/// Prints the least clearance to the other arm; refuses a move that is too near.
///
/// # Errors
/// If the clearance is less than allowed.
pub fn show_room(setup: &Setup, choice: ArmChoice, plan: &Plan, other_rad: Option<&JointVector>) -> Result<()> {
    let other = choice.other();
    let Some(other_rad) = other_rad else {
        return Ok(print_line(&format!(
            "clearance to the {}: unknown with --alone; check that the path is free",
            other.name()
        ))?);
    };
    let room = plan.room(setup, choice, other_rad);
    let emulated = if other.of(setup).link.is_toy() { " (emulated, at its start pose)" } else { "" };
    print_line(&format!("least clearance to the {}{emulated} on the path: {room}", other.name()))?;
    room.check(setup)
}
