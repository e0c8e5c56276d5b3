//! `pb3dp arm visit`: moves an arm to a list of poses and records a stereo pair and the joints at each (docs/commissioning.md).

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, SystemTime};

use super::visit_run::{self, Output, Tour, Visited};
use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_cell::flight::Moment;
use pb3dp_cell::interruption::{INTERRUPTED, watch};
use pb3dp_cell::parts::{ArmChoice, Parts};
use pb3dp_cell::plan::Plan;
use pb3dp_cell::terminal::{parse_seconds, print_line};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Flange};
use pb3dp_hal_api::{Arm, JointCommand};
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_kinematics::{Damping, JointVector, reach};
use pb3dp_record::calibration_files::{CAMERAS_FILE, save_cameras};
use pb3dp_record::stops::{ArmOfPoses, STOPS_FILE, WantedPoses, load_poses};
use pb3dp_recording::pairs::{About, is_file};
use pb3dp_recording::stops::StopsRecording;
use pb3dp_setup::layers::SetupArgs;
use pb3dp_setup::setup::{Setup, read_layers};
use pb3dp_sim::targets::TargetConfig;
use pb3dp_wiring::commissioning::slow_setup;
use pb3dp_wiring::{Wired, wire_to_look, write_flights};

use super::confirm;
use crate::Program;

/// Joint speed, as for the home move.
const JOINT_MAX_RAD_PER_S: f64 = 0.1;

/// Arguments of `pb3dp arm visit`.
#[derive(Debug, Args)]
pub(super) struct VisitArgs {
    #[command(flatten)]
    setup: SetupArgs,
    /// File with the poses from `pb3dp calibrate propose`; it also names the arm.
    #[arg(long, value_name = "FILE", required_unless_present = "here", conflicts_with = "here")]
    poses: Option<PathBuf>,
    /// Record one pair at the current pose of both arms, brakes on; nothing moves.
    #[arg(long)]
    here: bool,
    /// Output folder for the pairs and stops.toml; it must not contain any.
    #[arg(long, value_name = "DIR", required_unless_present = "record")]
    out: Option<PathBuf>,
    /// Also, or instead, record everything in one file: pairs and joints of the stops, and the joints on the way between them, with ROS 2
    /// messages. `pb3dp calibrate` reads it.
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Move the arm; a real one after its name is typed. Without it nothing moves.
    #[arg(long = "move")]
    moves: bool,
    /// Longest wait for stationary images at a stop; a stop that takes longer is skipped.
    #[arg(long, value_name = "SECONDS", value_parser = parse_seconds, default_value = "10")]
    patience: f64,
    /// For simulated cameras: the chessboard on the second arm in place of the target, inner corners and side of a square in mm, for
    /// instance 9x6:20.
    #[arg(long, value_name = "COLUMNSxROWS:MM", value_parser = parse_board)]
    emulated_board: Option<TargetConfig>,
}

impl VisitArgs {
    /// Refuses an output that exists already, before a port opens.
    fn check_output(&self) -> Result<()> {
        if let Some(folder) = self.out.as_deref().filter(|folder| folder.join(STOPS_FILE).exists()) {
            bail!("--out: {} contains a recording of stops already: use another folder", folder.display());
        }
        match &self.record {
            Some(file) if !is_file(file) => {
                bail!("--record: {} has no name FILE.mcap; for a folder of images use --out", file.display())
            }
            Some(file) if file.exists() => bail!("--record: {} exists already: use another name", file.display()),
            _ => Ok(()),
        }
    }

    /// Creates folder and file, with the identities of the cameras if they are known.
    fn output(&self, setup: &Setup, program: Program, parts: &Parts) -> Result<Output> {
        let folders = [self.out.as_deref(), self.record.as_deref().and_then(Path::parent)];
        for folder in folders.into_iter().flatten() {
            std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be created", folder.display()))?;
        }
        let cameras = parts.cameras.as_ref();
        if let (Some(folder), Some(cameras)) = (&self.out, cameras) {
            save_cameras(cameras, &folder.join(CAMERAS_FILE))?;
        }
        let create = |file: &PathBuf| {
            let about = About::new(String::new(), program.commit, parts.clock.now())?;
            let arms = &setup.rig.arms;
            StopsRecording::create(file, &about, cameras, [&arms.vs.chain, &arms.tc.chain]).context("--record")
        };
        Ok(Output { folder: self.out.clone(), file: self.record.as_ref().map(create).transpose()? })
    }

    fn folder_of_flights(&self) -> &Path {
        let beside = self.record.as_deref().and_then(Path::parent);
        self.out.as_deref().or(beside).unwrap_or(Path::new("."))
    }

    /// What was written, for the user.
    fn written(&self) -> String {
        let stops = self.out.as_ref().map(|folder| folder.join(STOPS_FILE));
        let files: Vec<String> = stops.iter().chain(&self.record).map(|file| file.display().to_string()).collect();
        files.join(" and ")
    }
}

fn parse_board(text: &str) -> Result<TargetConfig, String> {
    let refuse = || format!("{text:?}: must be inner corners and the side of a square in mm, for instance 9x6:20");
    let (corners, square) = text.split_once(':').ok_or_else(refuse)?;
    let (columns, rows) = corners.split_once('x').ok_or_else(refuse)?;
    let corner = |text: &str| text.parse::<u32>().map_err(|_| refuse());
    let square_mm: f64 = square.parse().map_err(|_| refuse())?;
    Ok(TargetConfig::Chessboard { corners: [corner(columns)?, corner(rows)?], square_m: square_mm * 1e-3 })
}

/// Runs the command.
///
/// # Errors
/// A refused setup or poses, a missing confirmation, or a failed part.
pub(super) fn run(args: &VisitArgs, program: Program) -> Result<ExitCode> {
    // Before any thread starts: a signal that ends the program would leave the arms to their gateways.
    let mut signals = StopSignals::take_over().context("cannot take over the signals that end the program")?;
    let wanted = args.poses.as_deref().map(load_poses).transpose().context("--poses")?;
    let setup = to_look(read_layers(&args.setup)?, args.emulated_board)?;
    if args.moves && !setup.is_emulated() {
        confirm::need_no_button(&setup)?;
    }
    args.check_output()?;
    let patience = Duration::from_secs_f64(args.patience);
    let date = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
    // Arms and cameras are connected; all brakes stay on.
    let Wired { mut parts, monitors, .. } = wire_to_look(&setup, patience)?;
    let Some(wanted) = wanted else {
        let was_interrupted = watch(signals, &parts.interrupt, program.final_flush)?;
        let output = args.output(&setup, program, &parts)?;
        visit_run::record_here(&setup, parts, patience, output, date)?;
        if was_interrupted.load(Ordering::SeqCst) {
            return Ok(ExitCode::from(INTERRUPTED));
        }
        print_line(&format!("pair and joints recorded: {}", args.written()))?;
        return Ok(ExitCode::SUCCESS);
    };
    let tour = plan_tour(&setup, &mut parts, &wanted, patience)?;
    if !args.moves {
        print_line("dry run: the brakes stayed on and nothing moved; use --move to move the arm")?;
        return Ok(ExitCode::SUCCESS);
    }
    let person = match setup.is_emulated() {
        true => None,
        false => Some(confirm::confirmed(tour.choice.name(), Some(setup.operator_key_within), &mut signals)?),
    };
    let output = args.output(&setup, program, &parts)?;
    let was_interrupted = watch(signals, &parts.interrupt, program.final_flush)?;
    let (clock, flights) = (Arc::clone(&parts.clock), parts.flights.clone());
    let listen = |console| confirm::attend(console, setup.operator_key_within, &parts, std::io::stdout());
    let attended = person.map(listen).transpose()?;
    let visited = visit_run::run(&setup, parts, &tour, output, date);
    if let Err(failure) = &visited {
        let moment = Moment { monotonic: clock.now(), wall: SystemTime::now() };
        write_flights((args.folder_of_flights(), 1), &flights, &monitors, failure, moment);
    }
    let visited = visited?;
    tell(args, &tour, &visited)?;
    let was_ended = attended.is_some_and(|attended| attended.ended().is_some());
    Ok(match (was_ended || was_interrupted.load(Ordering::SeqCst), visited.taken > 0) {
        (true, _) => ExitCode::from(INTERRUPTED),
        (false, true) => ExitCode::SUCCESS,
        (false, false) => ExitCode::FAILURE,
    })
}

/// The setup for recording calibration data without a calibration: slow, with the board in front of simulated cameras.
fn to_look(mut setup: Setup, board: Option<TargetConfig>) -> Result<Setup> {
    if !setup.leader.needs_images() {
        bail!("estimator.method = {:?} renders no images to record: set \"direct\"", setup.leader.name());
    }
    match (board, setup.world.as_mut()) {
        (Some(_), None) => {
            bail!("--emulated-board: the cameras of this setup are real; remove the option")
        }
        (None, Some(_)) => bail!(
            "the simulated cameras of this setup show the target of its table [scene]; use --emulated-board 9x6:20, or another size, \
             for a chessboard in its place"
        ),
        (Some(board), Some(world)) => world.scene.target = board,
        (None, None) => {}
    }
    setup.rig.calibrations.clear();
    setup.rig.nominal_calibration = None;
    setup.drift = None;
    let setup = slow_setup(&setup, ArmChoice::Vs, JOINT_MAX_RAD_PER_S)?;
    slow_setup(&setup, ArmChoice::Tc, JOINT_MAX_RAD_PER_S)
}

/// Plans the paths to all reachable poses and back; prints them and the skipped poses.
fn plan_tour(setup: &Setup, parts: &mut Parts, wanted: &WantedPoses, patience: Duration) -> Result<Tour> {
    let choice = match wanted.arm {
        ArmOfPoses::Vs => ArmChoice::Vs,
        ArmOfPoses::Tc => ArmChoice::Tc,
    };
    let (goes, stays) = match choice {
        ArmChoice::Vs => (&mut parts.vs, &mut parts.tc),
        ArmChoice::Tc => (&mut parts.tc, &mut parts.vs),
    };
    let begin_rad = goes.exchange(JointCommand::Hold).context(choice.name())?.position_rad;
    let other_rad = stays.exchange(JointCommand::Hold).context(choice.other().name())?.position_rad;
    print_line(&format!(
        "{}: {} poses\nstop  pose  largest turn, deg  move, s  clearance to the {}",
        choice.name(),
        wanted.poses.len(),
        choice.other().name()
    ))?;
    let (mut ways, mut from_rad) = (Vec::new(), begin_rad);
    for (index, pose) in wanted.poses.iter().enumerate() {
        let way = way_to(setup, (choice, &other_rad), [&from_rad, &begin_rad], pose);
        match way {
            Ok((plan, room)) => {
                from_rad = plan.end_rad();
                let turn_deg = plan.by_rad().amax().to_degrees();
                ways.push(plan.clone());
                print_line(&format!(
                    "{:>4}  {:>4}  {turn_deg:>17.1}  {:>7.1}  {room}",
                    ways.len(),
                    index + 1,
                    plan.duration().as_secs_f64()
                ))?;
            }
            Err(error) => print_line(&format!("   -  {:>4}  skipped: {error:#}", index + 1))?,
        }
    }
    if ways.is_empty() {
        bail!("no pose can be reached: propose poses nearer to the current one");
    }
    let (back, _) =
        free_way(setup, (choice, &other_rad), &from_rad, &begin_rad).context("the return path to the start")?;
    ways.push(back);
    let tour = Tour { choice, ways, patience };
    print_line(&format!(
        "{} of {} poses, moves of {:.0} s, at most {JOINT_MAX_RAD_PER_S} rad/s; then back to the current pose",
        tour.stops(),
        wanted.poses.len(),
        tour.travel_time().as_secs_f64()
    ))?;
    Ok(tour)
}

/// Turns of the third joint that are tried for each pose, rad: with seven joints another elbow angle can bring a pose into the ranges of
/// all joints.
const ELBOW_TURNS_RAD: [f64; 4] = [0.5, -0.5, 1.0, -1.0];

/// The shortest free path to a pose, with the present elbow angle, that of the start (avoids elbow drift over the stops), or a turned one.
fn way_to(
    setup: &Setup,
    (choice, other_rad): (ArmChoice, &JointVector),
    [from_rad, begin_rad]: [&JointVector; 2],
    pose: &Pose<Base, Flange>,
) -> Result<(Plan, String)> {
    let damping = Damping::new(setup.controller.damping.threshold, setup.controller.damping.factor_max)?;
    let turned = ELBOW_TURNS_RAD.map(|turn_rad| {
        let mut start_rad = *begin_rad;
        start_rad[2] += turn_rad;
        start_rad
    });
    let mut ways = [*from_rad, *begin_rad].into_iter().chain(turned).map(|start_rad| {
        let to_rad = reach(&choice.of(setup).chain, &start_rad, pose, &damping)?;
        free_way(setup, (choice, other_rad), from_rad, &to_rad)
    });
    let first = ways.next().unwrap_or_else(|| bail!("no path was tried"));
    let shorter =
        |one: (Plan, String), other: (Plan, String)| if other.0.duration() < one.0.duration() { other } else { one };
    match (first, ways.flatten().reduce(shorter)) {
        (Ok(first), Some(other)) => Ok(shorter(first, other)),
        (first, None) => first,
        (Err(_), Some(other)) => Ok(other),
    }
}

/// A straight path that keeps its clearance to the other arm, with that clearance.
fn free_way(
    setup: &Setup,
    (choice, other_rad): (ArmChoice, &JointVector),
    from_rad: &JointVector,
    to_rad: &JointVector,
) -> Result<(Plan, String)> {
    let plan = Plan::new(choice.of(setup), *from_rad, to_rad - from_rad)?;
    let room = plan.room(setup, choice, other_rad);
    room.check(setup)?;
    Ok((plan, room.to_string()))
}

fn tell(args: &VisitArgs, tour: &Tour, visited: &Visited) -> Result<()> {
    for stop in &visited.unsettled_stops {
        tracing::warn!(
            "stop {stop} skipped: no stationary image within {:?} (limit {} px from one to the next)",
            tour.patience,
            visit_run::STILL_WITHIN_PX
        );
    }
    let end = if visited.is_whole { "returned to the start" } else { "ended early" };
    if visited.taken == 0 {
        return Ok(print_line(&format!("none of {} stops recorded, {end}", tour.stops()))?);
    }
    Ok(print_line(&format!("{} of {} stops recorded, {end}: {}", visited.taken, tour.stops(), args.written()))?)
}
