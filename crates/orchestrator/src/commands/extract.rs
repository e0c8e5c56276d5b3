//! `pb3dp extract`: the stereo pairs of an MCAP recording as image files, for a calibration or for other programs.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::Args;
use pb3dp_bag::pairs::{PairOptions, StereoBag};
use pb3dp_cell::terminal::print_line;
use pb3dp_record::images::{StoredFormat, save};

use crate::arguments::RecordingArgs;
use crate::progress::Progress;

/// Arguments of `pb3dp extract`.
#[derive(Debug, Args)]
pub struct ExtractArgs {
    /// The recording: an MCAP file, or a folder of rosbag2.
    #[arg(value_name = "PATH")]
    recording: PathBuf,
    /// Folder for the images: left/000000.png, right/000000.png and so on; it must be empty or new.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Only each N-th pair.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    every: u64,
    #[command(flatten)]
    how: RecordingArgs,
}

/// Runs the command. A damaged image costs its pair, and the exit code is then a failure.
///
/// # Errors
/// A recording that cannot be used, or a folder that is not empty or cannot be written.
pub fn run(args: &ExtractArgs) -> Result<ExitCode> {
    let asked = args.how.options(&[]);
    let options = PairOptions { topics: asked.topics, within: asked.within, range: asked.range };
    let bag = StereoBag::open(&args.recording, options)?;
    if std::fs::read_dir(&args.out).is_ok_and(|mut entries| entries.next().is_some()) {
        bail!("--out {}: is not empty; give another folder", args.out.display());
    }
    let folders = ["left", "right"].map(|side| args.out.join(side));
    for folder in &folders {
        std::fs::create_dir_all(folder).with_context(|| format!("--out {}: cannot be created", folder.display()))?;
    }
    let progress = Progress::of(usize::try_from(bag.pairs_max()).unwrap_or(usize::MAX), "pairs");
    let (mut pairs, mut number, mut damaged) = (bag.pairs(), 0_u64, 0_u64);
    loop {
        let is_wanted = number.is_multiple_of(args.every);
        if !is_wanted {
            if pairs.skip_pair()?.is_none() {
                break;
            }
        } else {
            let Some(pair) = pairs.next() else { break };
            for note in pairs.take_notes() {
                tracing::warn!("{note}");
            }
            match pair?.images {
                Ok(images) => {
                    for (image, folder) in images.iter().zip(&folders) {
                        save(image, &folder.join(format!("{number:06}.png")), StoredFormat::QuickPng)?;
                    }
                }
                Err(error) => {
                    damaged += 1;
                    tracing::error!("pair {number}: {:#}", anyhow::Error::new(error));
                }
            }
        }
        number += 1;
        progress.advance();
    }
    drop(progress);
    let unpaired = pairs.unpaired();
    if unpaired > 0 {
        tracing::warn!("{unpaired} images are left out: the other camera has none at their time (--pair-within)");
    }
    print_line(&format!("{}: {} pairs of {number}", args.out.display(), number.div_ceil(args.every) - damaged))?;
    Ok(if damaged > 0 || number == 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}
