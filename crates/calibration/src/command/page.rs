//! HTML report files, with the images of the worst views.

use std::path::Path;

use crate::fit::CornerError;
use crate::held_out::Chosen;
use crate::quality::Quality;
use crate::report::vectors;
use anyhow::Result;
use image::RgbImage;
use image::imageops::FilterType;
use pb3dp_record::images::load_rgb;
use pb3dp_record::overlay::{Stroke, arrow, colors, cross, side_by_side};
use pb3dp_record::report::{ImagePlot, Report, ReportImage};

use super::DetectedBoards;

/// Number of worst views shown.
const WORST_VIEWS: usize = 3;
/// Width of each image on the page.
const WIDTH_PX: u32 = 480;

/// Adds the images of the worst views, writes the page, and returns the message to print.
pub(super) fn write<const N: usize>(
    page: Report,
    chosen: &Chosen<N>,
    quality: &Quality,
    detected: &DetectedBoards<N>,
    file: &Path,
) -> Result<String> {
    let mut strip = Vec::new();
    for (index, name, rms_px) in quality.views_by_error().into_iter().take(WORST_VIEWS) {
        let (Some(files), Some(errors)) = (detected.files.get(index), chosen.fit.errors().get(index)) else { continue };
        let magnified = ImagePlot::magnification(&vectors(errors.iter().flatten()), detected.size.width);
        let mut images = Vec::with_capacity(N);
        for (file, errors) in files.iter().zip(errors) {
            images.push(image(file, errors, magnified)?);
        }
        let together = images.into_iter().reduce(|left, right| side_by_side(&left, &right));
        let caption = format!("view {name}: {rms_px:.3} px rms; error vectors drawn {magnified} times longer");
        strip.extend(together.map(|image| (image, caption)));
    }
    let strip: Vec<_> = strip.iter().map(|(image, caption)| (ReportImage::Photo(image), caption.clone())).collect();
    page.heading("Views with the largest errors").images(&strip).write(file)?;
    Ok(format!("wrote {}: a report", file.display()))
}

/// A scaled image with its corners and error vectors.
fn image(file: &Path, errors: &[CornerError], magnified: f64) -> Result<RgbImage> {
    let whole = load_rgb(file)?;
    let scale = (f64::from(WIDTH_PX) / f64::from(whole.width())).min(1.0);
    let size = [whole.width(), whole.height()].map(|length| ((f64::from(length) * scale).round() as u32).max(1));
    let mut small = image::imageops::resize(&whole, size[0], size[1], FilterType::Triangle);
    for error in errors {
        let at = error.corner.pixel.map(|pixel| (pixel + 0.5) * scale - 0.5);
        let tip = at + error.error_px * (magnified * scale);
        cross(&mut small, at.into(), 2.0, Stroke { color: colors::REGION, width_px: 1.0 });
        arrow(&mut small, at.into(), tip.into(), Stroke { color: colors::BAD, width_px: 1.2 });
    }
    Ok(small)
}
