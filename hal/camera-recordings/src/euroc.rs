//! Recordings in folders as those of the EuRoC MAV dataset: `cam0` and `cam1` with `data.csv`, `data/` and `sensor.yaml`.
//!
//! Each line of `data.csv` has the time of an image in nanoseconds and the name of its file. `sensor.yaml` has the camera and its pose
//! `T_BS` in the body (Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 2016).

use std::path::{Path, PathBuf};
use std::time::Duration;

use pb3dp_bag::matching::Matching;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{CameraError, CameraErrorKind};
use pb3dp_record::calibration_files::{StereoCalibration, parse_euroc};
use pb3dp_record::text_file::read_text;

use crate::source::{Place, TimedPairs};

/// The folder with `cam0` and `cam1`: this one, or its subfolder `mav0`.
pub(crate) fn camera_folders(folder: &Path) -> Option<[PathBuf; 2]> {
    [folder.to_path_buf(), folder.join("mav0")].into_iter().find_map(|base| {
        let cameras = ["cam0", "cam1"].map(|name| base.join(name));
        cameras.iter().all(|camera| camera.join("data.csv").exists()).then_some(cameras)
    })
}

fn unusable(message: String) -> CameraError {
    CameraError::new(CameraErrorKind::Unusable, message)
}

fn text_of(file: &Path) -> Result<String, CameraError> {
    read_text(file).map_err(|source| {
        let message = format!("cannot read {}; check that it exists and is text", file.display());
        CameraError::caused_by(CameraErrorKind::Unusable, message, source)
    })
}

/// The calibration in both `sensor.yaml`.
pub(crate) fn calibration(cameras: &[PathBuf; 2]) -> Result<StereoCalibration, CameraError> {
    let files = cameras.each_ref().map(|camera| camera.join("sensor.yaml"));
    let texts = [text_of(&files[0])?, text_of(&files[1])?];
    parse_euroc([&files[0], &files[1]], [&texts[0], &texts[1]]).map_err(|source| {
        let message =
            format!("the calibration in {} and beside it cannot be used; give one with --calib", files[0].display());
        CameraError::caused_by(CameraErrorKind::Unusable, message, source)
    })
}

/// The pairs: images of the cameras that are nearest in time, at most `within` apart, and the images without a partner.
pub(crate) fn pairs(cameras: &[PathBuf; 2], within: Duration) -> Result<TimedPairs, CameraError> {
    let [left, right] = [images(&cameras[0])?, images(&cameras[1])?];
    let (mut matching, mut pairs) = (Matching::new(within), Vec::new());
    let mut images: Vec<_> =
        left.into_iter().map(|image| (0, image)).chain(right.into_iter().map(|image| (1, image))).collect();
    images.sort_by_key(|(_, (at, _))| *at);
    let mut images = images.into_iter();
    loop {
        while let Some([(left_at, left), (right_at, right)]) = matching.next_pair() {
            let skew_nanos = right_at.as_nanos() as i64 - left_at.as_nanos() as i64;
            pairs.push((Place::Files(left, right), left_at, skew_nanos));
        }
        match images.next() {
            Some((side, (at, file))) => matching.push(side, at, (file, 0)),
            None if matching.is_complete() => break,
            None => matching.complete(),
        }
    }
    Ok(TimedPairs { pairs, left_out: matching.left_out() })
}

/// Times and files of the images of a camera.
fn images(camera: &Path) -> Result<Vec<(MonotonicTime, PathBuf)>, CameraError> {
    let list = camera.join("data.csv");
    let mut images: Vec<(MonotonicTime, PathBuf)> = Vec::new();
    for (number, line) in text_of(&list)?.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let refuse = |why: &str| unusable(format!("{}:{}: {why}: {line:?}", list.display(), number + 1));
        let (nanos, name) = line.split_once(',').ok_or_else(|| refuse("a line must be TIME_NS,FILE"))?;
        let nanos = nanos.trim().parse().map_err(|_| refuse("the time must be a whole number of nanoseconds"))?;
        let at = MonotonicTime::from_nanos(nanos);
        if images.last().is_some_and(|(before, _)| at <= *before) {
            return Err(refuse("the time must be later than the one before"));
        }
        images.push((at, camera.join("data").join(name.trim())));
    }
    Ok(images)
}
