//! What the log says of the images of files before their first estimate.

use anyhow::{Context, Result};
use image::RgbImage;
use pb3dp_estimation::pair_check::PairCheck;
use pb3dp_estimation_core::region::{Region, RegionConfig};

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

/// Logs the region that a click has selected, which may be larger or smaller than intended.
pub fn tell_click(name: &str, region: &Region, left: &RgbImage, regions: &RegionConfig) {
    if let Region::Click { .. } = region
        && let Ok(mask) = region.rasterize(left, regions)
        && let Some(bounds) = mask.bbox()
    {
        tracing::info!(
            "{name}: the click has taken {} px within rect:{},{},{},{} (--overlay shows them)",
            mask.area_px(),
            bounds.x,
            bounds.y,
            bounds.width,
            bounds.height
        );
    }
}
