//! `pb3dp extract`: the stereo pairs of a recording as image files, for other programs.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_cell::lens_reading::decide_lens;
use pb3dp_cell::terminal::print_line;
use pb3dp_record::calibration_files::{save_json, save_judged};
use pb3dp_record::images::{StoredFormat, save};
use pb3dp_wiring::{RecordedPairs, TimedRecordingOptions, calibration_of};

use crate::progress::Progress;

/// Arguments of `pb3dp extract`.
#[derive(Debug, Args)]
pub struct ExtractArgs {
    /// The recording, of any kind that `pb3dp track --sequence` reads.
    #[arg(value_name = "PATH")]
    recording: PathBuf,
    /// Folder for the images: left/000000.png, right/000000.png and so on, with the calibration of the recording, if it has one. It must be
    /// empty or new.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Only each N-th pair.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
    #[command(flatten)]
    how: TimedRecordingOptions,
}

/// Runs the command. A damaged image costs its pair, and the exit code is then a failure.
///
/// # Errors
/// A recording that cannot be used, or a folder that is not empty or cannot be written.
pub fn run(args: &ExtractArgs) -> Result<ExitCode> {
    let mut pairs = RecordedPairs::open(&args.recording, &args.how.all())?.with_one_calibration(false)?;
    if std::fs::read_dir(&args.out).is_ok_and(|mut entries| entries.next().is_some()) {
        bail!("--out {}: is not empty; give another folder", args.out.display());
    }
    let folders = ["left", "right"].map(|side| args.out.join(side));
    for folder in &folders {
        std::fs::create_dir_all(folder).with_context(|| format!("--out {}: cannot be created", folder.display()))?;
    }
    write_calibration(args, &mut pairs)?;
    for warning in pairs.take_warnings() {
        tracing::warn!("{warning}");
    }
    let (count, mut damaged) = (pairs.count(), 0_u64);
    let progress = Progress::of(usize::try_from(count.div_ceil(args.every)).unwrap_or(usize::MAX), "pairs");
    for number in (0..count).step_by(usize::try_from(args.every).unwrap_or(usize::MAX)) {
        match pairs.images(number, None) {
            Ok(images) => {
                for (image, folder) in images.iter().zip(&folders) {
                    save(image, &folder.join(format!("{number:06}.png")), StoredFormat::Png)?;
                }
            }
            Err(error) => {
                damaged += 1;
                tracing::error!("{:#}", anyhow::Error::new(error));
            }
        }
        for note in pairs.take_notes() {
            tracing::info!("{note}");
        }
        progress.advance();
    }
    drop(progress);
    print_line(&format!("{}: {} pairs of {count}", args.out.display(), count.div_ceil(args.every) - damaged))?;
    Ok(if damaged > 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Writes the calibration of the recording beside the images, where `--calib` and `track --sequence` find it.
fn write_calibration(args: &ExtractArgs, pairs: &mut RecordedPairs) -> Result<()> {
    let decided = |calibration| match (0..pairs.count()).find_map(|number| pairs.images(number, None).ok()) {
        Some([left, right]) => Ok(decide_lens(calibration, &left, &right)?),
        None => Ok(calibration.decided()?),
    };
    let found = calibration_of(&args.recording, &args.how.all()).map_err(anyhow::Error::new).and_then(decided);
    let calibration = match found {
        Ok(calibration) => calibration,
        Err(error) => {
            tracing::info!("no calibration is written: {error:#}");
            return Ok(());
        }
    };
    for warning in &calibration.warnings {
        tracing::warn!("{warning}");
    }
    if let Some(statement) = &calibration.not_measured {
        tracing::info!("no calibration is written: that of the recording is not measured ({statement})");
        return Ok(());
    }
    let name = if calibration.judgement.is_some() { "calibration.toml" } else { "calib.json" };
    let file = args.out.join(name);
    match &calibration.judgement {
        Some(judgement) => save_judged(&calibration.rig, judgement, &file),
        None => save_json(&calibration.rig, &file),
    }
    .with_context(|| format!("the calibration of {}", args.recording.display()))?;
    tracing::info!("{}: the calibration of the recording", file.display());
    Ok(())
}
