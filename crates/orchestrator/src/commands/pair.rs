//! Images of files that do not match their calibration.

use anyhow::{Context, Result};
use pb3dp_estimation::pair_check::PairCheck;

/// Refuses an exchanged pair; logs and returns why the calibration may not belong to it.
///
/// # Errors
/// Left and right are exchanged.
pub fn usable(name: &str, check: &PairCheck) -> Result<Option<String>> {
    tracing::debug!("{name}: {check:?}");
    let doubt =
        check.accepted().context("swap the images: --left and --right, or the files or folders of the recording")?;
    if let Some(doubt) = &doubt {
        tracing::warn!("{name}: {doubt}");
    }
    Ok(doubt)
}
