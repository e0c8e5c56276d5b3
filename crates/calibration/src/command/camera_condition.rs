//! Differences between the two cameras at calibration time; a later run compares its own images with them.

use pb3dp_record::metrics::median;
use std::path::PathBuf;

use anyhow::Result;
use pb3dp_record::image_quality::{Exposure, blur_of, brighter_by_percent, softer_by_px};
use pb3dp_record::images::load_rgb;

/// Medians over the pairs, under the names that a run uses (docs/rig.md, cameras that drift): additional blur of the right
/// camera, and the brightness of the right camera relative to the left. A value that the images do not determine is omitted.
pub(super) fn numbers(pairs: &[[PathBuf; 2]]) -> Result<Vec<(String, f64)>> {
    let (mut softer_px, mut brighter_percent) = (Vec::new(), Vec::new());
    for [left, right] in pairs {
        let images = [load_rgb(left)?, load_rgb(right)?];
        let [left_px, right_px] = [&images[0], &images[1]].map(|image| blur_of(&[image]));
        softer_px.extend(left_px.zip(right_px).map(|(left, right)| softer_by_px([left, right])));
        brighter_percent.push(brighter_by_percent(&[&images[0], &images[1]].map(|image| Exposure::of(&[image]))));
    }
    let medians =
        [("focus_difference_px", median(&softer_px)), ("brightness_difference_percent", median(&brighter_percent))];
    Ok(medians.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_softer_and_darker_right_image_is_reported() {
        let folder = tempfile::tempdir().expect("a folder");
        let sharp = image::RgbImage::from_fn(160, 120, |x, y| {
            image::Rgb([if (x / 16 + y / 16) % 2 == 0 { 40 } else { 200 }; 3])
        });
        // Slightly blurred as by a lens, so that no edge is a step.
        let left = image::imageops::blur(&sharp, 0.7);
        let mut right = image::imageops::blur(&sharp, 1.6);
        right.iter_mut().for_each(|level| *level = (f64::from(*level) * 0.8) as u8);
        let files = ["left.png", "right.png"].map(|name| folder.path().join(name));
        left.save(&files[0]).expect("saved");
        right.save(&files[1]).expect("saved");
        let found = numbers(&[files.clone(), files]).expect("numbers");
        let of = |name: &str| found.iter().find(|(key, _)| key == name).expect(name).1;
        assert!((of("focus_difference_px") - (1.6f64 * 1.6 - 0.7 * 0.7).sqrt()).abs() < 0.25, "{found:?}");
        assert!((of("brightness_difference_percent") + 20.0).abs() < 1.0, "{found:?}");
        assert_eq!(median(&[]), None);
    }
}
