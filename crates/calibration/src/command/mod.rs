//! The command line of `pb3dp-calibrate`.

mod board;
mod coach;
mod convert;
mod eyes;
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
mod touch_test;
mod verify;
mod verify_limits;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Args, Parser, Subcommand};
use pb3dp_calibration::board::Board;
use pb3dp_calibration::fit::View;
use pb3dp_calibration::gates::Limits;
use pb3dp_calibration::held_out::{Chosen, choose};
use pb3dp_calibration::lens::LensModel;
use pb3dp_calibration::quality::Quality;
use pb3dp_calibration::report::{of_camera, of_stereo};
use pb3dp_geometry::ImageSize;

use self::board::BoardArgs;
use self::coach::CoachArgs;
use self::convert::ConvertArgs;
use self::hand_eye::HandEyeArgs;
use self::images::Images;
use self::propose::ProposeArgs;
use self::verify::VerifyArgs;

/// Calibrate cameras and stereo heads from images of a board, and say how good the result is.
#[derive(Debug, Parser)]
#[command(name = "pb3dp-calibrate", bin_name = "pb3dp calibrate", version, propagate_version = true)]
pub struct Cli {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// One camera: focal lengths, principal point, lens.
    Intrinsics(IntrinsicsArgs),
    /// A stereo head: both cameras and their pose to each other, in one adjustment.
    Stereo(StereoArgs),
    /// Look at a recording while it grows, and say what view of the board is missing next.
    Coach(CoachArgs),
    /// Whether a calibration still holds: fresh views of the board, a second calibration, a length, places that were touched.
    Verify(VerifyArgs),
    /// Where the cameras sit on the arm, and with a board on the other arm where both arms stand to each other.
    HandEye(HandEyeArgs),
    /// The poses that an arm is to visit for a calibration, from a first look at the board.
    Propose(ProposeArgs),
    /// Write a board for printing.
    Board(board::PrintArgs),
    /// Write a calibration in another format.
    Convert(ConvertArgs),
}

/// Which lens model is fitted.
#[derive(Clone, Copy, Debug)]
enum LensChoice {
    /// The one whose held-out error says so.
    Auto,
    /// This one.
    Fixed(LensModel),
}

/// What both ways to calibrate take.
#[derive(Debug, Args)]
struct Common {
    #[command(flatten)]
    board: BoardArgs,
    /// radial-1, radial-2, brown-4 (k1 k2 p1 p2), brown-5 (and k3), rational-8, or auto: the fewest coefficients whose error on
    /// views that the fit has not seen is within 0.2 % of the lowest.
    #[arg(long, value_name = "MODEL", value_parser = numbers::lens, default_value = "auto")]
    lens: LensChoice,
    /// Other limits than the built-in ones (copy configs/calibration_gates.toml).
    #[arg(long, value_name = "FILE")]
    gates: Option<PathBuf>,
    /// Also write a report as one page of HTML: errors and coverage over the images, rows, lens models, the worst views.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Also write the corners that were found, as CSV: view, camera, column, row, u, v.
    #[arg(long, value_name = "FILE")]
    corners: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct IntrinsicsArgs {
    /// Folder of the images, PNG or JPEG.
    #[arg(long, value_name = "DIR")]
    images: PathBuf,
    #[command(flatten)]
    common: Common,
}

/// Where stereo pairs are.
#[derive(Debug, Args)]
struct Pairs {
    /// A recording, as `pb3dp cameras record` makes it, also at full rate: views are chosen from it. Or one of stops of an arm
    /// (stops.toml): each stop is a view.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["left", "right"])]
    recording: Option<PathBuf>,
    /// Folder of the left images, PNG or JPEG. Images are paired by their names without the words left and right.
    #[arg(long, value_name = "DIR", requires = "right")]
    left: Option<PathBuf>,
    /// Folder of the right images; if it is the same folder, those with `right` in their name.
    #[arg(long, value_name = "DIR", requires = "left")]
    right: Option<PathBuf>,
}

impl Pairs {
    fn sightings(&self, board: &Board) -> Result<Seen<2>> {
        match (&self.recording, &self.left, &self.right) {
            (Some(recording), ..) => recording::sightings(recording, board),
            (None, Some(left), Some(right)) => Images::<2>::find(&[left, right])?.sightings(board),
            _ => anyhow::bail!("give --recording DIR, or --left DIR and --right DIR"),
        }
    }

    fn are_given(&self) -> bool {
        self.recording.is_some() || self.left.is_some()
    }

    /// The folder in which, or above which, a `cameras.toml` may be.
    fn folder(&self) -> &Path {
        self.recording.as_deref().or(self.left.as_deref()).unwrap_or(Path::new("."))
    }
}

#[derive(Debug, Args)]
struct StereoArgs {
    #[command(flatten)]
    pairs: Pairs,
    #[command(flatten)]
    common: Common,
    /// The distance for which the head is judged, mm.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, default_value = "500", allow_hyphen_values = true)]
    distance: f64,
    /// The baseline, mm, as measured with a ruler between the lenses, to 1 %, or as the maker states it: with it a wrong size of the
    /// squares is found.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, allow_hyphen_values = true)]
    baseline: Option<f64>,
    /// Write the calibration, also where a gate refuses it: .toml (ours, with gates, date and cameras, as docs/calibration.md has them), or
    /// without these .json, a Kalibr camchain (.kalibr.yaml), OpenCV (.opencv.yaml), or a folder for the ROS pair left.yaml and right.yaml.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Which cameras these were (docs/calibration.md); without it the cameras.toml in or above the left folder.
    #[arg(long, value_name = "FILE")]
    cameras: Option<PathBuf>,
}

/// Runs the command; a calibration that a gate refuses is a failure.
pub fn run(cli: &Cli) -> Result<ExitCode> {
    match &cli.what {
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
    let seen = images.sightings(&board)?;
    args.common.write_corners(&seen.views)?;
    tell(&seen.told)?;
    let chosen = choose(&seen.views, &board, seen.size, args.common.models())?;
    let quality = Quality::of_camera(&chosen, &seen.views, seen.size);
    if let Some(file) = &args.common.report {
        let page = of_camera(&chosen, &quality, &limits.judge(&quality), &seen.views, seen.size);
        tell(&page::write(page, &chosen, &quality, &seen, file)?)?;
    }
    conclude(&chosen, &quality, &limits)
}

fn stereo(args: &StereoArgs) -> Result<ExitCode> {
    let (board, limits) = args.common.checked()?;
    // What cannot be written is refused before all the work.
    args.out.as_deref().map(convert::check_name).transpose()?;
    for file in args.out.iter().chain(&args.common.report) {
        make_folder_of(file)?;
    }
    let seen = args.pairs.sightings(&board)?;
    args.common.write_corners(&seen.views)?;
    tell(&seen.told)?;
    let chosen = choose(&seen.views, &board, seen.size, args.common.models())?;
    let rig = chosen.fit.rig()?;
    let quality = Quality::of_stereo(&chosen, &seen.views, seen.size, args.distance * 1e-3)?;
    let quality = match args.baseline {
        Some(known_mm) => quality.with_known_baseline(&rig, known_mm * 1e-3),
        None => quality,
    };
    tell(&report::rig(&chosen.fit, &rig, args.distance * 1e-3)?)?;
    let code = conclude(&chosen, &quality, &limits)?;
    if let Some(out) = &args.out {
        let cameras = judgement::cameras(args.cameras.as_deref(), args.pairs.folder())?;
        let mut judgement = judgement::of(&chosen, &quality, &limits.judge(&quality), (seen.newest.as_str(), cameras));
        judgement.numbers.extend(eyes::numbers(&seen.files)?);
        tell(&convert::write(&rig, Some(&judgement), out)?)?;
    }
    if let Some(file) = &args.common.report {
        let page = of_stereo(&chosen, &quality, &limits.judge(&quality), &seen.views, args.distance * 1e-3)?;
        tell(&page::write(page, &chosen, &quality, &seen, file)?)?;
    }
    Ok(code)
}

/// Tells the numbers and the verdict.
fn conclude<const N: usize>(chosen: &Chosen<N>, quality: &Quality, limits: &Limits) -> Result<ExitCode> {
    let verdicts = limits.judge(quality);
    tell(&report::fit(chosen))?;
    tell(&report::verdicts(quality, &verdicts))?;
    Ok(if report::is_refused(&verdicts) { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

impl Common {
    fn checked(&self) -> Result<(Board, Limits)> {
        let board = self.board.board()?;
        let limits = self.gates.as_deref().map_or_else(|| Ok(Limits::default()), gates_file::read)?;
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
        std::fs::write(file, report::corners(views)).with_context(|| format!("{}: cannot be written", file.display()))
    }
}

/// Makes the folder in which a file is to be.
fn make_folder_of(file: &Path) -> Result<()> {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => {
            std::fs::create_dir_all(folder).with_context(|| format!("{}: the folder cannot be made", folder.display()))
        }
        _ => Ok(()),
    }
}

/// Lines on standard output.
fn tell(text: &str) -> Result<()> {
    if text.is_empty() {
        return Ok(());
    }
    writeln!(std::io::stdout(), "{text}").context("standard output cannot be written")
}

/// The whole chain of an error on standard error.
pub fn tell_error(error: &anyhow::Error) {
    // Nobody is left who could be told that this cannot be written.
    let _ = writeln!(std::io::stderr(), "error: {error:#}");
}

/// The images of all views have this size.
#[derive(Debug)]
struct Seen<const N: usize> {
    views: Vec<View<N>>,
    size: ImageSize,
    /// When the newest of the images was written, RFC 3339.
    newest: String,
    /// Which images were left out, and why.
    told: String,
    /// The images of each view.
    files: Vec<[PathBuf; N]>,
}
