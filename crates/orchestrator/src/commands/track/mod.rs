//! `pb3dp track`: regions through a recorded stereo sequence.

mod csv;
mod overlays;
mod skew;
mod surface;
mod walk;

use std::process::ExitCode;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_cell::result_lines::TrackLine;
use pb3dp_cell::search_range::range_of_dataset;
use pb3dp_cell::terminal::print_line;
use pb3dp_estimation::estimator::Method;
use pb3dp_estimation_core::status::Status;
use pb3dp_hal_api::{CameraErrorKind, FramePair, StereoCamera};
use pb3dp_record::metrics::{MotionSummary, compare_motion};
use pb3dp_wiring::message_codes::error_text;
use pb3dp_wiring::wire_replay;
use pb3dp_wiring::{Recording, ReplayPace};

use self::csv::EstimateFiles;
use self::overlays::Overlays;
use self::walk::{Outcome, TargetResult, Walk};
use super::estimate::job::{default_range, overridden};
use crate::arguments::{TrackArgs, UNSURE};
use crate::commands::output_file::check_cloud;
use crate::progress::Progress;

/// A replay does not wait for images: this time-out should never expire.
const PAIR_TIMEOUT: Duration = Duration::from_secs(10);

/// Runs the command. It processes all frames and targets; the exit code is a failure if a frame could not be read, or the region of
/// one of several targets is refused.
///
/// # Errors
/// Bad arguments or configuration, an unusable sequence, exchanged images, or only refused regions.
pub fn run(args: &TrackArgs) -> Result<ExitCode> {
    let method = args.method.method;
    if args.surface.is_some() && !method.recovers_surface() {
        bail!("--surface: the method {method} recovers no surface: use --method {}", Method::Direct);
    }
    if let Some(file) = &args.surface {
        check_cloud("--surface", file)?;
    }
    args.method.warn_without_effect();
    let mut recording = opened(args, args.pace)?;
    for note in recording.notes.iter().chain(&recording.camera.calibration().notes) {
        tracing::info!("{note}");
    }
    for warning in &recording.warnings {
        tracing::warn!("{warning}");
    }
    let rig = *recording.camera.rig();
    let mut walk = new_walk(&recording, args)?;
    let mut csv = EstimateFiles::open(args.csv.as_deref(), walk.targets().len())?;
    let mut overlays = Overlays::open(&args.method)?;
    let mut pair = FramePair::black(rig.left().size());
    let (mut unread, mut unsure, first_s) = (0_usize, 0_usize, recording.times_s.first().copied().unwrap_or_default());
    if !args.method.json {
        print_line(&TrackLine::heading(walk.targets().len() > 1))?;
    }
    let progress = Progress::of(recording.times_s.len(), "frames");
    for (frame, &t_s) in recording.times_s.iter().enumerate() {
        let played = recording.camera.next_pair_into(&mut pair, PAIR_TIMEOUT);
        for note in recording.camera.take_notes() {
            tracing::info!("{note}");
        }
        let lines = match played {
            Ok(()) => {
                let found = walk.step(frame, &pair)?;
                if let Err(error) = overlays.add(frame, t_s, &pair, &rig, &found) {
                    tracing::warn!("frame {frame}: no image: {error:#}");
                }
                csv.add(t_s, &found)?;
                all_lines(frame, t_s, &found)
            }
            Err(error) if error.kind() == CameraErrorKind::BadPair => {
                unread += 1;
                let reason = error_text(&error.into());
                tracing::error!("frame {frame}: {reason}");
                walk.skip();
                csv.add_unread(t_s)?;
                TrackLine::all_of_error(frame, t_s, walk.targets().len(), &reason)
            }
            Err(error) => return Err(error.into()),
        };
        for line in &lines {
            unsure += usize::from(line.status != Status::Ok.as_str());
            progress.print_line(&if args.method.json { serde_json::to_string(line)? } else { line.human(first_s) })?;
        }
        progress.advance();
    }
    drop(progress);
    overlays.close()?;
    csv.close()?;
    if let Some(file) = &args.surface {
        surface::write_all(file, walk.targets())?;
    }
    report(&recording, &walk);
    Ok(match (unread > 0 || walk.has_refused(), unsure) {
        (true, _) => ExitCode::FAILURE,
        (false, 1..) if args.method.strict => ExitCode::from(UNSURE),
        (false, _) => ExitCode::SUCCESS,
    })
}

fn opened(args: &TrackArgs, pace: ReplayPace) -> Result<Recording> {
    wire_replay(&args.sequence, &args.calib, &args.recording.all(), pace).context("--sequence")
}

/// All targets of a recording, with the skew that its first pairs show if it states none.
fn new_walk(recording: &Recording, args: &TrackArgs) -> Result<Walk> {
    let rig = recording.camera.rig();
    let mut notes = Vec::new();
    let given = match &recording.search {
        Some(search) => range_of_dataset(search),
        None => default_range(rig, args.method.z_range.is_none(), &mut notes),
    };
    notes.iter().for_each(|note| tracing::info!("{note}"));
    let range = overridden(given, &args.method);
    let mut walk = Walk::new(rig, recording, args, range)?;
    if recording.states_skew {
        walk.first_target().map_or(Ok(()), |target| target.check_skew())?;
    } else if args.method.method == Method::Direct {
        let again = || Ok((opened(args, ReplayPace::Fast)?, Walk::new(rig, recording, args, range)?));
        let found_skew = skew::of(again)?;
        walk.use_skew(found_skew.skew, found_skew.warning());
        if found_skew.cost.is_some() {
            walk.watch_skew()?;
        }
    }
    Ok(walk)
}

/// A line for each target of a frame.
fn all_lines(frame: usize, t_s: f64, found: &[TargetResult]) -> Vec<TrackLine> {
    let line = |found: &TargetResult| {
        let mut line = match &found.outcome {
            Outcome::Estimate { estimate, millis } => TrackLine::of(frame, t_s, estimate, *millis),
            Outcome::Refused { reason } => TrackLine::of_error(frame, t_s, reason),
        };
        line.warnings.extend(found.rig_warnings.iter().cloned());
        TrackLine { target: found.target, ..line }
    };
    found.iter().map(line).collect()
}

/// Logs the table of motion errors, and the components that the method does not observe. The truth of a sequence belongs to its own
/// region, the first target.
fn report(recording: &Recording, walk: &Walk) {
    let mut text = String::new();
    if let (Some(truth), Some(target)) = (&recording.cam_left_from_model, walk.targets().first()) {
        let of = if walk.targets().len() > 1 { " of target 0" } else { "" };
        let since = match walk.judged_from() {
            0 => "the first frame with a pose".to_owned(),
            frame => format!("frame {frame}, the first one that shows how the target moved between the exposures"),
        };
        text += &format!("\nErrors of the motion{of} since {since}:\n");
        let poses = target.poses().get(walk.judged_from()..).unwrap_or_default();
        let truth = truth.get(walk.judged_from()..).unwrap_or_default();
        text += &match MotionSummary::of(&compare_motion(poses, truth)) {
            Some(summary) => summary.text_table(),
            None => "no frame has a pose: nothing to compare with the truth\n".to_owned(),
        };
    }
    if !walk.rotation_about_normal_observed() {
        text += "Where the rotation about the model's normal is not observed, it keeps its last value.\n";
    }
    // A closed standard error is ignored.
    let _ = std::io::Write::write_all(&mut std::io::stderr().lock(), text.as_bytes());
}
