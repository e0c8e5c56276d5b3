//! Messages for images that do not match their calibration.

use anyhow::{Result, bail};
use image::RgbImage;
use pb3dp_estimation::pair_check::{PairCheck, PairVerdict, check_pair};
use pb3dp_geometry::StereoRig;

/// Checks a stereo pair against its calibration; returns a warning if the match is doubtful.
///
/// # Errors
/// If left and right are exchanged: all estimates from them would be wrong.
pub fn check_images(name: &str, rig: &StereoRig, left: &RgbImage, right: &RgbImage) -> Result<Option<String>> {
    let check = check_pair(rig, left, right);
    tracing::debug!("{name}: {check:?}");
    let PairCheck { patches, matches, agreeing, behind, fitting_exchanged, .. } = check;
    let warning = match check.verdict {
        PairVerdict::Consistent | PairVerdict::Unknown => return Ok(None),
        PairVerdict::Swapped => bail!(
            "left and right look exchanged: {behind} of {agreeing} patches match only behind the cameras, and once exchanged \
             {fitting_exchanged} match in front; swap --left and --right (in a dataset: its files)"
        ),
        PairVerdict::BehindCameras => format!(
            "{behind} of {agreeing} patches match only behind the cameras, and swapping the images would not help: the \
             calibration does not belong to them; give the right file or calibrate again"
        ),
        PairVerdict::RowsDisagree { offset_px } => format!(
            "{agreeing} of {matches} matching patches lie {:.1} px {} the row or line that the calibration predicts (spread \
             {:.1} px): it does not belong to these images, or the cameras have moved; give the right file or calibrate \
             again",
            offset_px.abs(),
            if offset_px > 0.0 { "below" } else { "above" },
            check.row_spread_px.unwrap_or_default()
        ),
        PairVerdict::Unrelated => format!(
            "only {agreeing} of {patches} textured patches of the left image are found in the right one where the \
             calibration predicts them: the images do not show the same scene at the same moment, or the calibration does \
             not belong to them; check the files, or calibrate again"
        ),
    };
    tracing::warn!("{name}: {warning}");
    Ok(Some(warning))
}
