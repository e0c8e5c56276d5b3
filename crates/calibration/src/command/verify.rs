//! `pb3dp calibrate verify`: checks an existing calibration.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use crate::board::Chessboard;
use crate::gates::{Judged, Limits, verdict};
use crate::report::in_shown_units;
use crate::verify::against::{Comparison, Known, compare};
use crate::verify::lens::decide_lens;
use crate::verify::limits::{DIFFERENCE, HAND_ERROR, LENGTH, REPROJECTION, ROWS, SCALE, SIGMAS, TOUCH};
use crate::verify::touch::TouchResult;
use crate::verify::{Checked, check, depth_sigma_m, lengths_m};
use anyhow::{Context, Result, bail};
use clap::Args;
use nalgebra::DMatrix;
use pb3dp_record::calibration_files::{StereoCalibration, load_stated, load_stereo};

use super::hand_eye::{check_size, check_squares};
use super::{DetectedBoards, Pairs, exit_code, gates_file, numbers, tell, touch_test};

/// Arguments of `pb3dp calibrate verify`.
#[derive(Debug, Args)]
pub(super) struct VerifyArgs {
    /// The calibration, in any supported format.
    #[arg(value_name = "CALIBRATION")]
    calibration: PathBuf,
    #[command(flatten)]
    pairs: Pairs,
    /// Inner corners of the chessboard, for example 9x6.
    #[arg(long, value_name = "COLUMNSxROWS", value_parser = numbers::corners)]
    board: Option<[u32; 2]>,
    /// Measured side of a square, mm.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, allow_hyphen_values = true)]
    square: Option<f64>,
    /// A second calibration of the same stereo rig.
    #[arg(long, value_name = "CALIBRATION")]
    against: Option<PathBuf>,
    /// Two corners of the board whose distance was measured with a ruler: column and row of each, counted from 0,0.
    #[arg(long, value_name = "COLUMN,ROW", num_args = 2, value_parser = numbers::corner, requires = "length")]
    corners: Option<Vec<[u32; 2]>>,
    /// The measured distance between the two --corners, mm.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, requires = "corners", allow_hyphen_values = true)]
    length: Option<f64>,
    /// Touch test: a TOML file with board corners touched with the arm (docs/calibration.md); needs a recording of arm stops.
    #[arg(long, value_name = "FILE", requires = "hand_eye", requires = "recording")]
    touch: Option<PathBuf>,
    /// The hand-eye calibration for the touch test.
    #[arg(long, value_name = "FILE", requires = "touch")]
    hand_eye: Option<PathBuf>,
    /// Working distance at which the stereo rig is judged, mm.
    #[arg(long, value_name = "MM", value_parser = numbers::millimetres, default_value = "500", allow_hyphen_values = true)]
    distance: f64,
    /// Limits to use instead of the built-in ones (copy configs/calibration_verify.toml).
    #[arg(long, value_name = "FILE")]
    limits: Option<PathBuf>,
}

/// Runs the command; a calibration refused by a check is a failure.
pub(super) fn run(args: &VerifyArgs) -> Result<ExitCode> {
    let limits = gates_file::read(args.limits.as_deref(), Limits::of_checks())?;
    let detected = args.pairs.are_given().then(|| args.detected()).transpose()?;
    let calibration = args.calibration(detected.as_ref())?;
    let known = known(&calibration);
    let depth_m = args.distance * 1e-3;
    let made = calibration.judgement.as_ref().map_or_else(String::new, |judgement| format!(", of {}", judgement.date));
    tell(&format!("{}{made}: baseline {:.3} mm", calibration.source, known.rig.baseline_m() * 1e3))?;
    for note in calibration.notes.iter().chain(&calibration.warnings) {
        tell(&format!("note: {note}"))?;
    }
    let mut gates = Vec::new();
    // Squared contributions to the hand error, m^2: the measured ones, and the one from the covariance of the calibration.
    let mut hand_m2 = depth_sigma_m(&known, depth_m).map_or(0.0, |sigma_m| sigma_m.powi(2));
    if let Some((detected, board)) = &detected {
        tell(&detected.notes)?;
        check_squares(&known.rig, detected.views.iter().map(|view| &view.sightings), board)?;
        let checked = check(&known.rig, &detected.views, board)?;
        tell(&of_views(&checked, depth_m))?;
        let scale = checked.scale_at(depth_m);
        hand_m2 += ((scale.scale - 1.0).powi(2) + scale.sigma.powi(2)) * depth_m * depth_m;
        gates.push(limits.judge(REPROJECTION, checked.reprojection_rms_px));
        gates.push(limits.judge(ROWS, checked.rows.rms_px));
        gates.push(limits.judge(SCALE, 100.0 * (scale.scale - 1.0).abs()));
        gates.extend(args.ruler(&known, detected, &limits)?);
        gates.extend(args.touched(&known, detected, &limits)?);
    }
    if let Some(other) = &args.against {
        let second = load_stereo(std::slice::from_ref(other))
            .context("--against (options for what a file leaves unstated are about CALIBRATION; `pb3dp calibrate convert` has them, too)")?;
        let second = self::known(&second);
        if second.rig.left().size() != known.rig.left().size() {
            bail!("{}: the image size differs; compare calibrations with the same image size", other.display());
        }
        let comparison = compare(&known, &second, depth_m);
        tell(&of_comparison(&comparison, args.distance))?;
        gates.extend(comparison.sigmas.map(|sigmas| limits.judge(SIGMAS, sigmas)));
        gates.push(limits.judge(DIFFERENCE, comparison.p95_m()[2] * 1e3));
    }
    if gates.is_empty() {
        bail!(
            "no reference given; use --recording DIR (or --left and --right) with --board and --square, or --against CALIBRATION"
        );
    }
    if args.pairs.are_given() {
        gates.push(limits.judge(HAND_ERROR, hand_m2.sqrt() * 1e3));
    }
    conclude(&gates, args.distance)
}

/// Prints the checks and the verdict.
fn conclude(judged: &[Judged], distance_mm: f64) -> Result<ExitCode> {
    for judged in judged {
        tell(&judged.to_string())?;
    }
    if let Some(Judged { measured, .. }) = judged.iter().find(|judged| judged.gate.key == HAND_ERROR.key) {
        tell(&format!(
            "at {distance_mm:.0} mm the cameras contribute a hand error of about {measured:.2} mm; errors of the arm and of the hand-eye calibration are not included"
        ))?;
    }
    tell(&format!("verdict: {}", verdict(judged).1))?;
    Ok(exit_code(judged))
}

/// The calibration with its covariance.
fn known(calibration: &StereoCalibration) -> Known {
    let covariance = calibration.judgement.as_ref().and_then(|judgement| judgement.covariance.as_ref());
    let names = covariance.map_or_else(Vec::new, |covariance| covariance.names.clone());
    // The reader has checked that there are as many rows and columns as names.
    let value = |row: usize, column: usize| covariance.map_or(0.0, |covariance| covariance.rows[row][column]);
    Known { rig: calibration.rig, covariance: DMatrix::from_fn(names.len(), names.len(), value), names }
}

impl VerifyArgs {
    /// The calibration, as the user states it; the views decide the image size and the lens model if the file does not.
    fn calibration(&self, detected: Option<&(DetectedBoards<2>, Chessboard)>) -> Result<StereoCalibration> {
        let files = std::slice::from_ref(&self.calibration);
        let stated = self.pairs.how.calibration.stated();
        let calibration = load_stated(files, detected.map(|(detected, _)| detected.size), &stated)?;
        let Some((detected, board)) = detected else { return Ok(calibration.decided()?) };
        check_size(&calibration, detected.size)?;
        Ok(decide_lens(calibration, &detected.views, board)?)
    }

    fn detected(&self) -> Result<(DetectedBoards<2>, Chessboard)> {
        let [columns, rows] = self.board.context("--board is required with images, for example 9x6")?;
        let square_mm = self.square.context("--square is required with images: the side of a square, mm")?;
        let board = Chessboard::new(columns, rows, square_mm * 1e-3)?;
        Ok((self.pairs.sightings(&board)?, board))
    }

    /// Check with corners touched by the arm.
    fn touched(&self, known: &Known, detected: &DetectedBoards<2>, limits: &Limits) -> Result<Option<Judged>> {
        let (Some(file), Some(hand_eye)) = (&self.touch, &self.hand_eye) else { return Ok(None) };
        let results = touch_test::run(known, detected, hand_eye, file)?;
        tell(&touch_test::notes(&results))?;
        let worst_m = results.iter().map(TouchResult::error_m).fold(0.0, f64::max);
        Ok(Some(limits.judge(TOUCH, worst_m * 1e3)))
    }

    /// Check with a length measured with a ruler.
    fn ruler(&self, known: &Known, detected: &DetectedBoards<2>, limits: &Limits) -> Result<Option<Judged>> {
        let (Some([from, to]), Some(length_mm)) = (self.corners.as_deref(), self.length) else { return Ok(None) };
        let lengths_m = lengths_m(&known.rig, &detected.views, [*from, *to])?;
        let count = lengths_m.len() as f64;
        let mean_mm = lengths_m.iter().sum::<f64>() / count * 1e3;
        let scatter_mm = (lengths_m.iter().map(|m| (m * 1e3 - mean_mm).powi(2)).sum::<f64>() / count).sqrt();
        let percent = 100.0 * (mean_mm / length_mm - 1.0);
        tell(&format!(
            "corners {},{} and {},{}: {mean_mm:.3} mm by the cameras ({count} views, each +- {scatter_mm:.3}), {length_mm} mm by the ruler: {percent:+.3} %",
            from[0], from[1], to[0], to[1]
        ))?;
        Ok(Some(limits.judge(LENGTH, percent.abs())))
    }
}

/// Views by depth: relative length error, and apparent flatness of the board.
fn of_views(checked: &Checked, depth_m: f64) -> String {
    let mut views: Vec<_> = checked.views.iter().collect();
    views.sort_by(|a, b| a.depth_m.total_cmp(&b.depth_m));
    let mut text = format!(
        "{} views with this calibration: {:.3} px rms, mean vertical misalignment {:+.3} px\n  depth, mm      views  length error, %    flatness rms, mm\n",
        views.len(),
        checked.reprojection_rms_px,
        checked.rows.mean_px
    );
    for part in views.chunks(views.len().div_ceil(3).max(1)) {
        let count = part.len() as f64;
        let mean = part.iter().map(|view| view.scale - 1.0).sum::<f64>() / count;
        let scatter = (part.iter().map(|view| (view.scale - 1.0 - mean).powi(2)).sum::<f64>() / count).sqrt();
        let flatness = (part.iter().map(|view| view.flatness_m.powi(2)).sum::<f64>() / count).sqrt();
        let (from, to) = (part[0].depth_m * 1e3, part[part.len() - 1].depth_m * 1e3);
        // Writing to a `String` does not fail.
        let _ = writeln!(
            text,
            "  {from:>4.0} to {to:<4.0}  {:>6}  {:>+7.3} +- {:.3}  {:>15.3}",
            part.len(),
            100.0 * mean,
            100.0 * scatter,
            flatness * 1e3
        );
    }
    let scale = checked.scale_at(depth_m);
    let _ = write!(
        text,
        "at {:.0} mm the length error is {:+.3} +- {:.3} %",
        depth_m * 1e3,
        100.0 * (scale.scale - 1.0),
        100.0 * scale.sigma
    );
    match scale.slope_per_m {
        Some(slope) => {
            let _ = write!(
                text,
                ", changing by {:+.3} % per 100 mm of depth (constant over depth: baseline or squares; growing: disparity)",
                10.0 * slope
            );
        }
        None => {
            text.push_str("; show the board nearer and farther away to see whether the length error changes with depth")
        }
    }
    text
}

/// Differences of the parameters, and over the image.
fn of_comparison(comparison: &Comparison, distance_mm: f64) -> String {
    let mut text = String::new();
    if comparison.parameters.is_empty() {
        text.push_str("parameters are not compared: both files need a covariance\n");
    } else {
        text.push_str("second minus first, in standard deviations of the difference:\n");
    }
    for parameter in &comparison.parameters {
        let (name, factor) = in_shown_units(&parameter.name);
        let _ = writeln!(
            text,
            "  {name:<34} {:>+10.5} +- {:<9.5} {:>+6.2}",
            parameter.difference * factor,
            parameter.sigma * factor,
            parameter.sigmas()
        );
    }
    match comparison.sigmas {
        Some(sigmas) => {
            let _ = writeln!(text, "all together: {sigmas:.2} standard deviations rms (1 is chance)");
        }
        None => text.push_str("not judged together: the two calibrations estimated different parameters\n"),
    }
    let [depth_m, lateral_m, both_m] = comparison.p95_m();
    let _ = write!(
        text,
        "difference of a point at {distance_mm:.0} mm, 95th percentile over the image: depth {:.3} mm, lateral {:.3} mm, both {:.3} mm ({} points)",
        depth_m * 1e3,
        lateral_m * 1e3,
        both_m * 1e3,
        comparison.displacements.len()
    );
    text
}
