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
    if check.verdict == PairVerdict::Swapped {
        bail!("{}; swap --left and --right (in a dataset: its files)", exchanged(&check));
    }
    let warning = doubt(&check);
    if let Some(warning) = &warning {
        tracing::warn!("{name}: {warning}");
    }
    Ok(warning)
}

/// Checks the first pairs of cameras that were disconnected: their cables may be exchanged. `are_told_apart`: serial numbers have shown
/// that they are not, and images with too little texture for a verdict are accepted.
///
/// # Errors
/// Unless the images show, or the serial numbers do, that left and right are as before.
pub fn check_reopened(rig: &StereoRig, left: &RgbImage, right: &RgbImage, are_told_apart: bool) -> Result<()> {
    let check = check_pair(rig, left, right);
    match check.verdict {
        PairVerdict::Consistent => Ok(()),
        PairVerdict::Swapped => bail!("{}; connect each camera to its previous port", exchanged(&check)),
        _ => match doubt(&check) {
            Some(doubt) if are_told_apart => {
                tracing::warn!("cameras: {doubt}");
                Ok(())
            }
            Some(doubt) => bail!("the cameras may be exchanged: {doubt}"),
            None if are_told_apart => Ok(()),
            None => bail!(
                "too little texture to tell left from right: {} patches, {} of them match; turn the cameras to a textured scene, or use \
                 cameras with serial numbers",
                check.patches,
                check.agreeing
            ),
        },
    }
}

fn exchanged(PairCheck { agreeing, behind, fitting_exchanged, .. }: &PairCheck) -> String {
    format!(
        "left and right look exchanged: {behind} of {agreeing} patches match only behind the cameras, and once exchanged \
         {fitting_exchanged} match in front"
    )
}

/// Why the calibration may not belong to the images.
fn doubt(check: &PairCheck) -> Option<String> {
    let PairCheck { patches, matches, agreeing, behind, .. } = check;
    Some(match check.verdict {
        PairVerdict::Consistent | PairVerdict::Unknown | PairVerdict::Swapped => return None,
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
    })
}
