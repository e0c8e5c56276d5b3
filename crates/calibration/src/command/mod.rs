//! The commands of `pb3dp calibrate`: command line, image files and printed results.

mod board;
mod camera_condition;
mod coach;
mod convert;
mod gates_file;
mod hand_eye;
mod hand_eye_report;
mod images;
mod judgement;
mod numbers;
mod page;
mod poses;
mod propose;
mod recording;
mod report;
mod source;
mod touch_test;
mod verify;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use crate::board::Board;
use crate::fit::View;
use crate::gates::{Grade, Judged, Limits, verdict};
use crate::held_out::{Chosen, choose};
use crate::lens::LensModel;
use crate::quality::Quality;
use crate::report::{of_camera, of_stereo};
use anyhow::{Context, Result};
use clap::{Args, Parser, Subcommand};
use indicatif::{ProgressBar, ProgressFinish};
use pb3dp_camera_recordings::RecordingOptions;
use pb3dp_geometry::ImageSize;
use pb3dp_record::calibration_files::StatedCalibration;
use tempfile::TempDir;

use self::board::BoardArgs;
use self::coach::CoachArgs;
use self::convert::ConvertArgs;
use self::hand_eye::HandEyeArgs;
use self::images::Images;
use self::propose::ProposeArgs;
use self::source::StopFiles;
use self::verify::VerifyArgs;

/// Calibrate cameras and stereo rigs from images of a board, and report the calibration quality.
#[derive(Debug, Parser)]
#[command(name = "pb3dp-calibrate", bin_name = "pb3dp calibrate", version, propagate_version = true)]
pub struct Cli {
    /// The command.
    #[command(flatten)]
    pub args: CalibrateArgs,
}

/// Arguments of `pb3dp calibrate`.
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Calibrate one camera: focal lengths, principal point, lens distortion.
    Intrinsics(IntrinsicsArgs),
    /// Calibrate a stereo rig: both cameras and the pose between them, in one adjustment.
    Stereo(StereoArgs),
    /// Watch a recording while it is being made, and suggest the next view of the board.
    Coach(CoachArgs),
    /// Check an existing calibration: with new views of the board, a second calibration, a known length, or touched points.
    Verify(VerifyArgs),
    /// Estimate the pose of the cameras on the arm (hand-eye); with the board on the other arm, also the pose between the two
    /// arms.
    HandEye(HandEyeArgs),
    /// Propose arm poses for a calibration, starting from one view of the board.
    Propose(ProposeArgs),
    /// Write a board file for printing.
    Board(board::PrintArgs),
    /// Convert a calibration to another format.
    Convert(ConvertArgs),
}

/// The lens model to fit.
#[derive(Clone, Copy, Debug)]
enum LensChoice {
    /// The model selected by its held-out error.
    Auto,
    /// A fixed model.
    Fixed(LensModel),
}

/// Arguments common to camera and stereo calibration.
#[derive(Debug, Args)]
struct Common {
    #[command(flatten)]
    board: BoardArgs,
    /// Lens model: radial-1, radial-2, brown-4 (k1 k2 p1 p2), brown-5 (and k3), rational-8, or auto. auto takes the fewest
    /// coefficients whose error on held-out views is within 0.2 % of the lowest.
    #[arg(long, value_name = "MODEL", value_parser = numbers::lens, default_value = "auto")]
    lens: LensChoice,
    /// Gate limits to use instead of the built-in ones (copy configs/calibration_gates.toml).
    #[arg(long, value_name = "FILE")]
    gates: Option<PathBuf>,
    /// Also write an HTML report on one page: errors and coverage over the images, epipolar errors, lens models, worst views.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Also write the detected corners as CSV: view, camera, column, row, u, v.
    #[arg(long, value_name = "FILE")]
    corners: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct IntrinsicsArgs {
    /// Folder of images, PNG or JPEG.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    #[command(flatten)]
    common: Common,
}

/// Where the stereo pairs are read from.
#[derive(Debug, Args)]
struct Pairs {
    /// A recording of any kind that `pb3dp track` reads: a folder, an MCAP file or rosbag2 folder, a EuRoC folder. Views are selected from it,
    /// so full frame rate is fine. In recordings of arm stops, and in plain folders of images, each pair is one view.
    #[arg(long, value_name = "PATH", conflicts_with_all = ["left", "right"])]
    recording: Option<PathBuf>,
    /// Folder of left images, PNG or JPEG. Images are paired by file name, ignoring the words left and right.
    #[arg(long, value_name = "DIR", requires = "right")]
    left: Option<PathBuf>,
    /// Folder of right images. If it is the same folder, files with `right` in their name are used.
    #[arg(long, value_name = "DIR", requires = "left")]
    right: Option<PathBuf>,
    /// What the recording does not state itself.
    #[command(flatten)]
    how: RecordingOptions,
}

impl Pairs {
    fn sightings(&self, board: &Board) -> Result<DetectedBoards<2>> {
        match (&self.recording, &self.left, &self.right) {
            (Some(recording), ..) => recording::sightings(recording, &self.how, board),
            (None, Some(left), Some(right)) => Images::<2>::find(&[left, right])?.sightings(board),
            _ => anyhow::bail!("no images given; use --recording PATH, or --left DIR and --right DIR"),
        }
    }

    fn are_given(&self) -> bool {
        self.recording.is_some() || self.left.is_some()
    }
}

#[derive(Debug, Args)]
struct StereoArgs {
    #[command(flatten)]
    pairs: Pairs,
    #[command(flatten)]
    common: Common,
    /// Working distance at which the stereo rig is judged, mm.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, default_value = "500", allow_hyphen_values = true)]
    distance: f64,
    /// Baseline, mm, from the data sheet or measured between the lenses with a ruler to 1 %. Used to detect a wrong square size.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, allow_hyphen_values = true)]
    baseline: Option<f64>,
    /// Output file; written even if a gate refuses the calibration. A .toml is our own format with gates, date and cameras
    /// (docs/calibration.md). Formats without these: .json, Kalibr camchain (.kalibr.yaml), OpenCV (.opencv.yaml), or a folder
    /// for the ROS pair left.yaml and right.yaml.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// File that identifies the cameras (docs/calibration.md). Default: the cameras.toml in the left folder or above it.
    #[arg(long, value_name = "FILE")]
    cameras: Option<PathBuf>,
}

/// Runs the command; a calibration refused by a gate is a failure.
///
/// # Errors
/// A file that cannot be read or written, images without a board, views that determine no calibration.
pub fn run(args: &CalibrateArgs) -> Result<ExitCode> {
    match &args.what {
        What::Intrinsics(args) => intrinsics(args),
        What::Stereo(args) => stereo(args),
        What::Coach(args) => coach::run(args),
        What::Verify(args) => verify::run(args),
        What::HandEye(args) => hand_eye::run(args),
        What::Propose(args) => propose::run(args),
        What::Board(args) => board::run(args),
        What::Convert(args) => convert::run(args),
    }
}

fn intrinsics(args: &IntrinsicsArgs) -> Result<ExitCode> {
    let (board, limits) = args.common.checked()?;
    let images = Images::<1>::find(&[&args.images])?;
    images.check_one_camera(&args.images)?;
    let detected = images.sightings(&board)?;
    args.common.write_corners(&detected.views)?;
    tell(&detected.notes)?;
    let chosen = choose(&detected.views, &board, detected.size, args.common.models())?;
    let quality = Quality::of_camera(&chosen, &detected.views, detected.size);
    if let Some(file) = &args.common.report {
        let page = of_camera(&chosen, &quality, &limits.judge_cameras(&quality), &detected.views, detected.size);
        tell(&page::write(page, &chosen, &quality, &detected, file)?)?;
    }
    conclude(&chosen, &quality, &limits)
}

fn stereo(args: &StereoArgs) -> Result<ExitCode> {
    let (board, limits) = args.common.checked()?;
    if args.pairs.how.calibration.stated() != StatedCalibration::default() {
        anyhow::bail!(
            "--calib-unit, --calib-size, --calib-lens and --rectified have no effect here: no calibration is read; leave them out"
        );
    }
    // Refuse an unusable output name before the long computation.
    args.out.as_deref().map(convert::check_name).transpose()?;
    for file in args.out.iter().chain(&args.common.report) {
        make_folder_of(file)?;
    }
    let detected = args.pairs.sightings(&board)?;
    args.common.write_corners(&detected.views)?;
    tell(&detected.notes)?;
    let chosen = choose(&detected.views, &board, detected.size, args.common.models())?;
    let rig = chosen.fit.rig()?;
    let quality = Quality::of_stereo(&chosen, &detected.views, detected.size, args.distance * 1e-3)?;
    let quality = match args.baseline {
        Some(known_mm) => quality.with_known_baseline(&rig, known_mm * 1e-3),
        None => quality,
    };
    tell(&report::rig(&chosen.fit, &rig, args.distance * 1e-3)?)?;
    let code = conclude(&chosen, &quality, &limits)?;
    if let Some(out) = &args.out {
        let cameras = judgement::cameras(args.cameras.as_deref(), &detected.folder)?;
        let mut judgement =
            judgement::of(&chosen, &quality, &limits.judge_cameras(&quality), (detected.newest.as_str(), cameras));
        judgement.numbers.extend(camera_condition::numbers(&detected.files)?);
        tell(&convert::write(&rig, Some(&judgement), out)?)?;
    }
    if let Some(file) = &args.common.report {
        let page =
            of_stereo(&chosen, &quality, &limits.judge_cameras(&quality), &detected.views, args.distance * 1e-3)?;
        tell(&page::write(page, &chosen, &quality, &detected, file)?)?;
    }
    Ok(code)
}

/// Prints the quality figures and the verdict.
fn conclude<const N: usize>(chosen: &Chosen<N>, quality: &Quality, limits: &Limits) -> Result<ExitCode> {
    let judged = limits.judge_cameras(quality);
    tell(&report::fit(chosen))?;
    tell(&report::of_cameras(quality, &judged))?;
    Ok(exit_code(&judged))
}

/// A calibration refused by a gate is a failure.
fn exit_code(judged: &[Judged]) -> ExitCode {
    if verdict(judged).0 == Grade::Refused { ExitCode::FAILURE } else { ExitCode::SUCCESS }
}

impl Common {
    fn checked(&self) -> Result<(Board, Limits)> {
        let board = self.board.board()?;
        let limits = gates_file::read(self.gates.as_deref(), Limits::of_cameras())?;
        Ok((board, limits))
    }

    fn models(&self) -> &[LensModel] {
        match &self.lens {
            LensChoice::Auto => &LensModel::ALL,
            LensChoice::Fixed(model) => std::slice::from_ref(model),
        }
    }

    fn write_corners<const N: usize>(&self, views: &[View<N>]) -> Result<()> {
        let Some(file) = &self.corners else { return Ok(()) };
        std::fs::write(file, report::corners(views)).with_context(|| format!("{}: cannot write file", file.display()))
    }
}

/// Creates the parent folder of a file.
fn make_folder_of(file: &Path) -> Result<()> {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => {
            std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create folder", folder.display()))
        }
        _ => Ok(()),
    }
}

/// A bar on standard error for work on `total` views, until it is dropped; nothing if standard error is not a terminal.
fn progress(total: usize) -> ProgressBar {
    ProgressBar::new(total as u64).with_finish(ProgressFinish::AndClear)
}

/// Prints lines to standard output.
fn tell(text: &str) -> Result<()> {
    if text.is_empty() {
        return Ok(());
    }
    writeln!(std::io::stdout(), "{text}").context("cannot write to standard output")
}

/// Prints the whole error chain to standard error.
pub fn tell_error(error: &anyhow::Error) {
    // A failure to write to standard error cannot be reported anywhere.
    let _ = writeln!(std::io::stderr(), "error: {error:#}");
}

/// Detected boards of all views; all images have the same size.
#[derive(Debug)]
struct DetectedBoards<const N: usize> {
    views: Vec<View<N>>,
    size: ImageSize,
    /// Modification time of the newest image, RFC 3339.
    newest: String,
    /// Which images were left out, and why.
    notes: String,
    /// The images of each view.
    files: Vec<[PathBuf; N]>,
    /// The folder to search for a `cameras.toml`; the folder above is searched as well.
    folder: PathBuf,
    /// The stops of the arm, if each view is one.
    stops: Option<StopFiles>,
    /// The images of a recording that is no folder of images, until the command ends.
    _unpacked: Option<TempDir>,
}
