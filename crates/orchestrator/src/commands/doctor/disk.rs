//! Disk space for recordings.

use super::needs::Needs;
use super::system::System;
use pb3dp_cell::finding::Finding;

/// Minutes of recording: fewer than the first number fail, fewer than the second one cause a warning.
const MINUTES_MIN: [f64; 2] = [1.0, 10.0];

pub(super) fn check(system: &dyn System, needs: &Needs) -> Finding {
    const CHECK: &str = "space for recordings";
    let Some(folder) = &needs.recordings else {
        return Finding::pass(CHECK, format!("{} makes no recording", needs.source));
    };
    let free = match system.free_bytes(folder) {
        Ok(free) => free as f64,
        Err(error) => return Finding::fail(CHECK, error, "choose another folder: --recordings DIR"),
    };
    let minutes = free / needs.recording_bytes_per_s / 60.0;
    let found = format!(
        "{}: {:.1} GB free, enough for {minutes:.0} minutes of stereo pairs without compression ({:.0} MB/s)",
        folder.display(),
        free * 1e-9,
        needs.recording_bytes_per_s * 1e-6
    );
    let advice = "free some space, or record elsewhere: --recordings DIR here, and the same folder for --record";
    if minutes < MINUTES_MIN[0] {
        Finding::fail(CHECK, found, advice)
    } else if minutes < MINUTES_MIN[1] {
        Finding::warning(CHECK, found, advice)
    } else {
        Finding::pass(CHECK, found)
    }
}
