//! `pb3dp calibrate hand-eye`: estimates the pose of the cameras on the arm.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use crate::board::{Chessboard, Sighting};
use crate::fit::View;
use crate::gates::{Judged, Limits};
use crate::hand_eye::{CalibrationCovariance, Given, HandEyeFit, HandEyeStop, RobotSigma, tc_has_moved};
use crate::report::of_hand_eye;
use crate::verify::length_ratio;
use crate::verify::lens::decide_lens;
use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_camera_recordings::CalibrationOptions;
use pb3dp_geometry::{ImageSize, StereoRig};
use pb3dp_record::calibration_files::{HandEye, StereoCalibration, load_stated, save_hand_eye};
use pb3dp_record::images::StoredImage;

use super::source::StopFiles;
use super::{exit_code, gates_file, hand_eye_report, images, judgement, numbers, poses, report, tell};

/// The recordings, the cameras that made them, and the board.
#[derive(Debug, Args)]
pub(super) struct Recording {
    /// Recordings of stops, as `pb3dp arm visit` writes them: folders with a stops.toml, or MCAP files. Board and cameras must not have been
    /// moved between them.
    #[arg(long, required = true, value_name = "PATH", num_args = 1..)]
    recording: Vec<PathBuf>,
    /// The stereo calibration: one file, or a left and a right one.
    #[arg(long, required = true, value_name = "FILE", num_args = 1..=2)]
    calib: Vec<PathBuf>,
    /// Inner corners of the chessboard (where four squares meet; one fewer than squares per side), for example 9x6. One number
    /// must be odd, the other even.
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = numbers::corners)]
    board: [u32; 2],
    /// Side of a square, mm. Measure ten squares and divide.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, allow_hyphen_values = true)]
    square: f64,
    /// What the stereo calibration does not state.
    #[command(flatten)]
    calibration: CalibrationOptions,
}

/// Arguments of `pb3dp calibrate hand-eye`.
#[derive(Debug, Args)]
pub(super) struct HandEyeArgs {
    #[command(flatten)]
    recording: Recording,
    /// Noise of the flange pose from stop to stop, one standard deviation: mm in each direction, degrees about each axis.
    #[arg(long, value_name = "MM,DEG", value_parser = numbers::robot_sigma, default_value = "0.1,0.02", allow_hyphen_values = true)]
    robot_sigma: RobotSigma,
    /// Working distance at which the hand error is judged, mm.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, default_value = "500", allow_hyphen_values = true)]
    distance: f64,
    /// Gate limits to use instead of the built-in ones (copy configs/hand_eye_gates.toml).
    #[arg(long, value_name = "FILE")]
    gates: Option<PathBuf>,
    /// Setup whose arms.vs.world_from_base is used to print the lines for arms.tc. Without it the world frame is the base of vs.
    #[arg(long, value_name = "FILE")]
    setup: Option<PathBuf>,
    /// Also write an HTML report on one page: verdict, gates, and each stop compared with all others.
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Output file (.toml); written even if a gate refuses the calibration.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// A recording with the boards detected in its images.
pub(super) struct DetectedStops {
    pub calibration: StereoCalibration,
    pub board: Chessboard,
    pub date: String,
    /// Stops at which both cameras see the board.
    pub stops: Vec<HandEyeStop>,
}

impl Recording {
    /// Detects the board in all images; reports and leaves out stops at which a camera does not see it.
    pub(super) fn look(&self) -> Result<DetectedStops> {
        let [columns, rows] = self.board;
        let board = Chessboard::new(columns, rows, self.square * 1e-3)?;
        let recordings = self.recording.iter().map(|path| StopFiles::open(path)).collect::<Result<Vec<_>>>()?;
        let count: usize = recordings.iter().map(|recorded| recorded.stops.stops.len()).sum();
        let files = recordings
            .iter()
            .flat_map(|recorded| recorded.stops.stops.iter().map(|stop| recorded.folder.join(&stop.left)));
        // Damaged images are reported where they are used.
        let size = files.into_iter().find_map(|file| Some(StoredImage::load(&file).ok()?.size()));
        let calibration = load_stated(&self.calib, size, &self.calibration.stated())?;
        if let Some(size) = size {
            check_size(&calibration, size)?;
        }
        let (mut stops, mut date) = (Vec::new(), String::new());
        for (path, recorded) in self.recording.iter().zip(recordings) {
            stops.extend(self.stops(path, &recorded, &board, calibration.rig.left().size())?);
            // A calibration is as old as its oldest image.
            if date.is_empty() || recorded.stops.date < date {
                date = recorded.stops.date;
            }
        }
        if stops.is_empty() {
            bail!("the board was detected at none of {count} stops");
        }
        let view = |stop: &HandEyeStop| View { name: stop.name.clone(), sightings: stop.sightings.clone() };
        let calibration = decide_lens(calibration, &stops.iter().map(view).collect::<Vec<_>>(), &board)?;
        for note in calibration.notes.iter().chain(&calibration.warnings) {
            tell(&format!("note: {note}"))?;
        }
        Ok(DetectedStops { calibration, board, date, stops })
    }

    /// The stops of one recording.
    fn stops(
        &self,
        path: &Path,
        recorded: &StopFiles,
        board: &Chessboard,
        size: ImageSize,
    ) -> Result<Vec<HandEyeStop>> {
        let mut stops = Vec::with_capacity(recorded.stops.stops.len());
        for stop in &recorded.stops.stops {
            let files = [&stop.left, &stop.right].map(|file| recorded.folder.join(file));
            let alone = self.recording.len() == 1;
            let name = if alone { stop.left.clone() } else { path.join(&stop.left).display().to_string() };
            match images::view(&name, &files, board, size, "the calibration")? {
                Ok(view) => stops.push(HandEyeStop {
                    name: view.name,
                    sightings: view.sightings,
                    base_from_flange: stop.vs.base_from_flange,
                    // The numbers stay the same; only the frames are renamed to those of tc.
                    tc_base_from_tc_flange: stop.tc.map(|tc| tc.base_from_flange.relabel()),
                }),
                Err((file, reason)) => tell(&format!("left out {}: {reason}", file.display()))?,
            }
        }
        Ok(stops)
    }
}

/// Board lengths with a larger relative error indicate an input mistake: either in --square or in the square size of the stereo
/// calibration.
const SQUARES_OFF_MAX: f64 = 0.03;

/// Refuses a calibration for images of another size.
pub(super) fn check_size(calibration: &StereoCalibration, images: ImageSize) -> Result<()> {
    let (calibrated, source) = (calibration.rig.left().size(), &calibration.source);
    if calibrated != images {
        bail!(
            "the images have {}x{} pixels, but {source} is for {}x{}; give the calibration of these images, or state --calib-size if they \
             were scaled",
            images.width,
            images.height,
            calibrated.width,
            calibrated.height
        );
    }
    Ok(())
}

/// Refuses a square size that contradicts the stereo rig before other errors are searched for.
pub(super) fn check_squares<'a>(
    rig: &StereoRig,
    views: impl Iterator<Item = &'a [Sighting; 2]>,
    board: &Chessboard,
) -> Result<()> {
    match length_ratio(rig, views, board) {
        Some(ratio) if (ratio - 1.0).abs() > SQUARES_OFF_MAX => bail!(
            "the square size contradicts the stereo calibration: --square is {} mm, the stereo calibration gives about {:.1} mm; \
             measure ten squares with a ruler, divide, and correct --square. If --square is right, calibrate the stereo rig again \
             (wrong square size used there, other cameras, or left and right exchanged)",
            (board.square_m() * 1e6).round() / 1e3,
            board.square_m() * 1e3 * ratio
        ),
        _ => Ok(()),
    }
}

pub(super) fn run(args: &HandEyeArgs) -> Result<ExitCode> {
    let limits = gates_file::read(args.gates.as_deref(), Limits::of_hand_eye())?;
    let vs_world_from_base =
        args.setup.as_deref().map(|file| poses::Setup::read(file)?.world_from_base("vs")).transpose()?;
    let looked = args.recording.look()?;
    if let Some(reason) = &looked.calibration.not_measured {
        bail!(
            "{} is not a measured calibration ({reason}); calibrate the stereo rig first with `pb3dp calibrate stereo`; the same images can be used",
            looked.calibration.source
        );
    }
    let rig = &looked.calibration.rig;
    check_squares(rig, looked.stops.iter().map(|stop| &stop.sightings), &looked.board)?;
    let judgement = looked.calibration.judgement.as_ref();
    let covariance = judgement.and_then(|judgement| judgement.covariance.as_ref());
    let rig_covariance = covariance.map(|covariance| CalibrationCovariance::new(rig, covariance)).transpose()?;
    if rig_covariance.is_none() {
        tell(
            "the stereo calibration has no covariance, so its errors are not included; use a .toml from `pb3dp calibrate stereo`",
        )?;
    }
    tell(if tc_has_moved(&looked.stops) {
        "both arms have moved: the board is mounted on the flange of tc"
    } else {
        "the arm tc has not moved: the board is stationary in the room"
    })?;
    let given = Given { rig, rig_covariance: rig_covariance.as_ref(), board: &looked.board, robot: args.robot_sigma };
    let fit = HandEyeFit::new(&looked.stops, &given)?;
    let judged = limits.judge_hand_eye(&fit, args.distance * 1e-3);
    tell(&hand_eye_report::fit(&fit, args.robot_sigma))?;
    tell(&hand_eye_report::lines(&fit, rig, vs_world_from_base))?;
    tell(&report::gates(&judged))?;
    if let Some(file) = &args.report {
        of_hand_eye(&fit, &judged, args.distance * 1e-3).write(file)?;
        tell(&format!("wrote {}: a report", file.display()))?;
    }
    if let Some(out) = &args.out {
        write(&hand_eye(&fit, &looked, &judged, args.distance), out)?;
    }
    Ok(exit_code(&judged))
}

fn write(hand_eye: &HandEye, out: &Path) -> Result<()> {
    if out.extension().is_none_or(|extension| !extension.eq_ignore_ascii_case("toml")) {
        bail!("{}: unknown file extension; a hand-eye calibration is written as .toml", out.display());
    }
    save_hand_eye(hand_eye, out).with_context(|| "the hand-eye calibration was not saved")?;
    tell(&format!("wrote {}", out.display()))
}

/// Contents of the calibration file.
fn hand_eye(fit: &HandEyeFit, looked: &DetectedStops, judged: &[Judged], distance_mm: f64) -> HandEye {
    let scales = fit.scales;
    let number = |name: &str, value: f64| (name.to_owned(), value);
    let mut measured = vec![
        number("distance_mm", distance_mm),
        number("corner_sigma_px", fit.corner_sigma_px),
        number("robot_noise_ratio", fit.robot_noise_ratio),
        number("scale_squares", scales.squares.factor),
        number("scale_squares_sigma", scales.squares.sigma),
        number("scale_baseline", scales.baseline.factor),
        number("scale_baseline_sigma", scales.baseline.sigma),
    ];
    for stop in &fit.stops {
        let what = if stop.used { "stop" } else { "rejected stop" };
        measured.push((format!("{what} {}: left_out_mm", stop.name), stop.left_out_mm));
        measured.push((format!("{what} {}: left_out_deg", stop.name), stop.left_out_deg));
    }
    measured.sort_by(|a, b| a.0.cmp(&b.0));
    let (stops, used) = (fit.stops.len(), fit.used().count());
    let source = format!("{stops} stops, {used} of them used; stereo rig: {}", looked.calibration.source);
    let of_head = looked.calibration.judgement.as_ref();
    let cameras = of_head.map(|judgement| judgement.cameras.clone()).unwrap_or_default();
    let about = (looked.date.as_str(), source, cameras);
    let judgement = judgement::judgement(about, measured, (&fit.names, &fit.covariance), judged);
    HandEye { flange_from_cam_left: fit.flange_from_cam_left(), board: fit.board(), judgement }
}
