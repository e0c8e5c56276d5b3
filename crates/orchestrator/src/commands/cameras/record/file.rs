//! Records pairs into one MCAP file, with or without a calibration.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use pb3dp_bag::BagError;
use pb3dp_bag::sinks::Sinks;
use pb3dp_bag::topics::ours;
use pb3dp_bag::writer::{BagWriter, WhenFull};
use pb3dp_geometry::StereoRig;
use pb3dp_hal_api::{CameraErrorKind, Clock, FramePair, StereoCamera};
use pb3dp_record::calibration_files::CameraIdentity;
use pb3dp_recording::pairs::{About, PairRecording};

use super::Recorded;
use super::recorder::{CALL_TIMEOUT, CAMERA_TIMEOUT};

/// When a recording ends.
pub(super) struct Until {
    pub(super) pairs: Option<u64>,
    pub(super) time: Option<Duration>,
}

/// Records until the end, until `is_over` returns true, or an error occurs.
///
/// # Errors
/// A file that exists or cannot be created.
pub(super) fn record(
    camera: &mut dyn StereoCamera,
    clock: &dyn Clock,
    (path, rig, identities): (&Path, Option<&StereoRig>, &[CameraIdentity; 2]),
    until: &Until,
    is_over: &mut dyn FnMut() -> bool,
) -> Result<Recorded> {
    let writer = BagWriter::create(path, WhenFull::Drop).context("--out")?;
    let about = About::new(String::new(), crate::COMMIT, clock.now())?;
    let mut file = PairRecording::new(&about, rig, Sinks::new(Some(writer), None, None));
    file.cameras(Some(identities));
    let (begin, mut heartbeat_at) = (clock.now(), clock.now());
    let mut pair = FramePair::black(camera.info().size);
    let mut recorded = Recorded::default();
    let (mut taken, mut first_at, mut before) = (0_u64, None, None);
    while !is_over() && !file.is_over() && until.pairs.is_none_or(|max| taken < max) {
        if until.time.is_some_and(|max| clock.now().saturating_since(begin) >= max) {
            break;
        }
        match camera.next_pair_into(&mut pair, CALL_TIMEOUT) {
            Ok(()) => {
                (heartbeat_at, taken) = (clock.now(), taken + 1);
                let gap =
                    before.replace(pair.sequence).map_or(0, |before: u64| pair.sequence.saturating_sub(before + 1));
                recorded.missing_cameras += gap;
                let first_at = *first_at.get_or_insert(pair.exposed_at);
                recorded.seconds = pair.exposed_at.seconds_since(first_at);
                file.images(&pair);
            }
            Err(error) => {
                let goes_on = matches!(error.kind(), CameraErrorKind::Timeout | CameraErrorKind::BadPair);
                let is_silent = clock.now().saturating_since(heartbeat_at) >= CAMERA_TIMEOUT;
                let text = format!("{:#}", anyhow::Error::new(error));
                recorded.complaint = Some(text.clone());
                if !goes_on || is_silent {
                    recorded.failure = Some(format!("{text}; {taken} pairs before it are kept in {}", path.display()));
                    break;
                }
            }
        }
    }
    match file.finish().written.transpose() {
        Ok(None) => {}
        Ok(Some(written)) => {
            let images = |topic| written.messages.get(topic).copied().unwrap_or(0);
            recorded.pairs = (images(ours::LEFT_IMAGE) + images(ours::LEFT_COMPRESSED))
                .min(images(ours::RIGHT_IMAGE) + images(ours::RIGHT_COMPRESSED));
            recorded.missing_queue = taken - recorded.pairs;
        }
        Err(error) => recorded.failure = Some(failure_text(error, path)),
    }
    if recorded.pairs > 0 {
        recorded.file = Some(path.to_path_buf());
    } else if recorded.failure.is_none() {
        // A file without pairs is no recording.
        std::fs::remove_file(path).context("--out")?;
    }
    Ok(recorded)
}

fn failure_text(error: BagError, path: &Path) -> String {
    format!("{:#}; `pb3dp recover {}` keeps what was written until then", anyhow::Error::new(error), path.display())
}

/// Refuses what only a folder has.
///
/// # Errors
/// An option that has no meaning for a file.
pub(super) fn check_options(args: &super::RecordArgs) -> Result<()> {
    let of_folder = [
        ("--region", args.region.is_some()),
        ("--z-range", args.z_range.is_some()),
        ("--tilt-max", args.tilt_max.is_some()),
        ("--jpeg", args.jpeg.is_some()),
        ("--writers", args.writers.is_some()),
    ];
    if let Some((option, _)) = of_folder.iter().find(|(_, is_given)| *is_given) {
        bail!(
            "{option}: only a folder has it; `pb3dp track` takes region and depths with the file, and its images stay as the cameras delivered them"
        );
    }
    Ok(())
}
