//! `pb3dp calibrate propose`: arm poses for a calibration.

use std::path::PathBuf;
use std::process::ExitCode;

use crate::hand_eye::place_board;
use crate::hand_eye::propose::{ProposalRequest, head_of_look, propose};
use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, CamLeft, Flange, TcBase, TcFlange};
use pb3dp_record::calibration_files::{BoardPlace, load_hand_eye};
use pb3dp_record::stops::{ArmOfPoses, WantedPoses, save_poses};

use super::hand_eye::Recording;
use super::{numbers, poses, tell};

/// Assumed errors of a guessed camera pose and a nominal focal length.
const GUESSED: (f64, f64, f64) = (0.010, 3.0, 0.02);
/// Assumed errors of a calibrated camera pose and focal length.
const CALIBRATED: (f64, f64, f64) = (0.002, 0.5, 0.005);

/// The arm to move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Arm {
    /// The arm with the cameras.
    Vs,
    /// The arm with the board.
    Tc,
}

/// Arguments of `pb3dp calibrate propose`.
#[derive(Debug, Args)]
pub(super) struct ProposeArgs {
    #[command(flatten)]
    recording: Recording,
    /// The arm to move; the other one stays where it was at the last stop of the recording.
    #[arg(long, default_value = "vs")]
    arm: Arm,
    /// Number of poses: 15 to 20, plus some spare for poses that the arm cannot reach.
    #[arg(long, default_value_t = 18)]
    count: usize,
    /// Working distance from the left camera to the board, mm.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, default_value = "500", allow_hyphen_values = true)]
    distance: f64,
    /// Approximate pose of the left camera on the flange; 10 mm and 3 degrees are accurate enough. X,Y,Z in mm, and a rotation
    /// vector in degrees.
    #[arg(long, value_name = "X,Y,Z,RX,RY,RZ", value_parser = poses::six, allow_hyphen_values = true, conflicts_with = "hand_eye")]
    guess: Option<[f64; 6]>,
    /// For --arm tc: approximate pose of the base of tc in the base of vs.
    #[arg(long, value_name = "X,Y,Z,RX,RY,RZ", value_parser = poses::six, allow_hyphen_values = true)]
    guess_bases: Option<[f64; 6]>,
    /// A hand-eye calibration; replaces the guesses it covers.
    #[arg(long, value_name = "FILE")]
    hand_eye: Option<PathBuf>,
    /// A setup; its mounts and arm base poses replace the guesses.
    #[arg(long, value_name = "FILE")]
    setup: Option<PathBuf>,
    /// Output file with the poses, for `pb3dp arm visit`.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Assumed poses of cameras and arms.
struct Guesses {
    flange_from_cam_left: Pose<Flange, CamLeft>,
    vs_base_from_tc_base: Option<Pose<Base, TcBase>>,
    /// Whether the poses are calibrated.
    is_calibrated: bool,
}

impl ProposeArgs {
    fn guesses(&self) -> Result<Guesses> {
        let setup = self.setup.as_deref().map(poses::Setup::read).transpose()?;
        let hand_eye = self.hand_eye.as_deref().map(load_hand_eye).transpose()?;
        let flange_from_cam_left = match (&hand_eye, self.guess, &setup) {
            (Some(hand_eye), ..) => hand_eye.flange_from_cam_left,
            (None, Some(guess), _) => poses::pose(guess),
            (None, None, Some(setup)) => setup.flange_from_cam_left()?,
            (None, None, None) => bail!(
                "pose of the cameras on the flange unknown; measure it roughly with a ruler (--guess X,Y,Z,RX,RY,RZ), or give a --setup with mounts, or a --hand-eye calibration"
            ),
        };
        let by_hand_eye = match hand_eye.as_ref().map(|hand_eye| hand_eye.board) {
            Some(BoardPlace::Carried { vs_base_from_tc_base, .. }) => Some(vs_base_from_tc_base),
            _ => None,
        };
        let by_setup = || -> Result<Option<Pose<Base, TcBase>>> {
            let Some(setup) = &setup else { return Ok(None) };
            let vs = setup.world_from_base("vs")?;
            // The numbers stay the same; only the base frame is renamed to that of tc.
            Ok(Some(vs.inverse() * setup.world_from_base("tc")?.relabel()))
        };
        let vs_base_from_tc_base = match (by_hand_eye, self.guess_bases, self.arm) {
            (Some(bases), ..) => Some(bases),
            (None, Some(guess), _) => Some(poses::pose(guess)),
            (None, None, Arm::Tc) => by_setup()?,
            (None, None, Arm::Vs) => None,
        };
        let is_calibrated = hand_eye.is_some() && (self.arm == Arm::Vs || by_hand_eye.is_some());
        Ok(Guesses { flange_from_cam_left, vs_base_from_tc_base, is_calibrated })
    }
}

pub(super) fn run(args: &ProposeArgs) -> Result<ExitCode> {
    let guesses = args.guesses()?;
    let looked = args.recording.look()?;
    let Some(first) = looked.stops.last() else { bail!("the board was detected at no stop") };
    let drawn = &looked.calibration.rig;
    let of_look = looked.calibration.not_measured.as_ref().and_then(|_| {
        tell("the calibration is nominal: the pose between the cameras is estimated from this view of the board")
            .ok()?;
        head_of_look(drawn, &looked.board, &first.sightings)
    });
    let rig = of_look.as_ref().unwrap_or(drawn);
    let cam_left_from_board = place_board(rig, &looked.board, &first.sightings)
        .with_context(|| format!("stop {:?}: no board pose fits the corners; check --board and --calib", first.name))?;
    let (guess_error_m, guess_error_deg, _) = if guesses.is_calibrated { CALIBRATED } else { GUESSED };
    let (.., focal_error) = if looked.calibration.not_measured.is_some() { GUESSED } else { CALIBRATED };
    let request = ProposalRequest {
        count: args.count,
        distance_m: args.distance * 1e-3,
        guess_error_m,
        guess_error_rad: guess_error_deg.to_radians(),
        focal_error,
    };
    let views = propose(rig, &looked.board, &cam_left_from_board, &request)?;
    let base_from_cam_left = first.base_from_flange * guesses.flange_from_cam_left;
    let wanted = match args.arm {
        Arm::Vs => {
            let base_from_board = base_from_cam_left * cam_left_from_board;
            let cam_left_from_flange = guesses.flange_from_cam_left.inverse();
            let poses = views.cam_left_from_board.iter();
            let poses = poses.map(|view| base_from_board * view.inverse() * cam_left_from_flange).collect();
            WantedPoses { arm: ArmOfPoses::Vs, poses }
        }
        Arm::Tc => {
            let tc = first.tc_base_from_tc_flange.context("the recording has no pose of the arm tc")?;
            let bases = guesses.vs_base_from_tc_base.context(
                "pose of the base of tc in the base of vs unknown; give --guess-bases, a --setup, or a --hand-eye calibration of both arms",
            )?;
            let tc_base_from_cam_left = bases.inverse() * base_from_cam_left;
            let pose = |view: &Pose<CamLeft, _>| -> Pose<TcBase, TcFlange> {
                let motion: Pose<CamLeft, CamLeft> = *view * cam_left_from_board.inverse();
                tc_base_from_cam_left * motion * tc_base_from_cam_left.inverse() * tc
            };
            // The file holds poses of one arm, and names that arm.
            let poses = views.cam_left_from_board.iter().map(|view| pose(view).relabel()).collect();
            WantedPoses { arm: ArmOfPoses::Tc, poses }
        }
    };
    super::make_folder_of(&args.out)?;
    save_poses(&args.out, &wanted)?;
    let [left, right] = views.coverage.map(|share| 100.0 * share);
    tell(&format!(
        "{} poses of {} for the last stop, {:?}; the board corners will cover {left:.0} % of the left image and {right:.0} % of the right image\nwrote {}",
        wanted.poses.len(),
        wanted.arm.name(),
        first.name,
        args.out.display()
    ))?;
    Ok(ExitCode::SUCCESS)
}
