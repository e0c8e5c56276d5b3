//! Recordings of every kind that is read: sequence folders, MCAP files, EuRoC folders and plain folders of images.

use std::path::{Path, PathBuf};
use std::time::Duration;

use pb3dp_bag::BagError;
use pb3dp_bag::pairs::{PAIR_WITHIN, PairOptions, StereoBag};
use pb3dp_bag::reader::Bag;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_hal_api::{CameraError, CameraErrorKind};
use pb3dp_record::calibration_files::{StereoCalibration, load_stereo};
use pb3dp_record::dataset::{CASE_FILE, SearchRange, is_sequence, load_case, load_sequence};
use pb3dp_record::value_range::ValueRange;

use crate::bag::BagImages;
use crate::folder::{image_pairs, images_with_both};
use crate::source::{Layout, Place, Source, TimedPairs};
use crate::{ReplayCamera, ReplayOptions, euroc, unusable};

/// What a recording does not state itself.
#[derive(Clone, Debug)]
pub struct RecordingOptions {
    /// Calibration files: one, or a left and a right one; those of the recording if empty.
    pub calibration: Vec<PathBuf>,
    /// Topics of the left and the right images of an MCAP file; by their names if absent.
    pub topics: Option<[String; 2]>,
    /// Longest time between the images of a pair in MCAP and EuRoC recordings.
    pub within: Duration,
    /// Values of images with more than 8 bits that become black and white; measured on the first pair if absent.
    pub range: Option<ValueRange>,
    /// Arrangement, if each image of a folder has both views.
    pub layout: Option<Layout>,
}

impl Default for RecordingOptions {
    fn default() -> Self {
        Self { calibration: Vec::new(), topics: None, within: PAIR_WITHIN, range: None, layout: None }
    }
}

/// A recording, ready to be played.
#[derive(Debug)]
pub struct Recording {
    /// The camera that plays it.
    pub camera: ReplayCamera,
    /// Middle of the left exposure of each pair, seconds on the clock of the recording.
    pub times_s: Vec<f64>,
    /// Corners of the target in the left image of the first frame, pixels, if the recording has a region.
    pub region_polygon_left_px: Option<Vec<[f64; 2]>>,
    /// Search range, if the recording states one.
    pub search: Option<SearchRange>,
    /// True pose of the target in each frame, if it is known.
    pub cam_left_from_model: Option<Vec<Pose<CamLeft, Model>>>,
    /// What the user should know of the recording.
    pub notes: Vec<String>,
    /// What is missing or not as it should be.
    pub warnings: Vec<String>,
}

impl Recording {
    /// Opens a recording: a folder with a `sequence.json` or a `case.json`, an MCAP file or rosbag2 folder, a folder as those of the EuRoC dataset, or a plain
    /// folder of images.
    ///
    /// # Errors
    /// Kind `Unusable` if the recording, its description or its calibration cannot be used; images are checked when they are played.
    pub fn open(path: &Path, asked: &RecordingOptions, options: ReplayOptions) -> Result<Self, CameraError> {
        // The description of a bag stands for its folder.
        let path = path.parent().filter(|_| path.is_file() && path.ends_with("metadata.yaml")).unwrap_or(path);
        if is_sequence(path) || is_sequence_file(path) {
            return Self::of_sequence(path, asked, options);
        }
        if path.join(CASE_FILE).is_file() {
            return Self::of_case(path, asked, options);
        }
        if Bag::is_one(path) {
            return Self::of_bag(path, asked, options);
        }
        if let Some(cameras) = euroc::camera_folders(path) {
            let pairs = euroc::pairs(&cameras, asked.within)?;
            let calibration = match &asked.calibration[..] {
                [] => euroc::calibration(&cameras)?,
                files => calibration_in(path, files)?,
            };
            return Self::timed(path, pairs, calibration, (asked, options));
        }
        if path.is_file() {
            return Err(unusable_bag(path, BagError::NoMcap { file: path.to_path_buf() }));
        }
        if !path.exists() {
            let message = format!("cannot replay {}: it does not exist; check the path", path.display());
            return Err(CameraError::new(CameraErrorKind::Unusable, message));
        }
        let places = match asked.layout {
            Some(layout) => images_with_both(path)?.into_iter().map(|file| Place::Both(file, layout)).collect(),
            None => {
                let pairs = image_pairs(path).map_err(|error| no_recording(path, error))?;
                pairs.into_iter().map(|(left, right)| Place::Files(left, right)).collect()
            }
        };
        let folder = [path.to_path_buf()];
        let calibration =
            calibration_in(path, if asked.calibration.is_empty() { &folder } else { &asked.calibration })?;
        let source = Source::of_images(places, options.period);
        let note =
            format!("the images have no times: {:.1} pairs per second are assumed", 1.0 / options.period.as_secs_f64());
        Ok(Self::plain(camera(path, source, calibration, (asked, options))?, vec![note]))
    }

    fn of_sequence(path: &Path, asked: &RecordingOptions, options: ReplayOptions) -> Result<Self, CameraError> {
        let sequence = load_sequence(path).map_err(|error| unusable(path, error))?;
        let mut warnings = Vec::new();
        if sequence.is_unfinished {
            warnings.push(format!(
                "the recording was broken off: it has no sequence.json; its {} frames until the last whole one are used",
                sequence.frames()
            ));
        }
        if !sequence.other_keys.is_empty() {
            warnings.push(format!(
                "sequence.json has keys that are not known and not used: {}",
                sequence.other_keys.join(", ")
            ));
        }
        let source = Source::of_sequence(&sequence, options.period);
        let calibration = match &asked.calibration[..] {
            [] => sequence.load_calibration().map_err(|error| unusable(path, error))?,
            files => calibration_in(path, files)?,
        };
        Ok(Self {
            camera: camera(&sequence.folder, source, calibration, (asked, options))?,
            times_s: sequence.times_s,
            region_polygon_left_px: Some(sequence.region_polygon_left_px),
            search: Some(sequence.search),
            cam_left_from_model: sequence.cam_left_from_model,
            notes: Vec::new(),
            warnings,
        })
    }

    /// A single pair; its time is zero.
    fn of_case(path: &Path, asked: &RecordingOptions, options: ReplayOptions) -> Result<Self, CameraError> {
        let case = load_case(path).map_err(|error| unusable(path, error))?;
        let calibration = match &asked.calibration[..] {
            [] => case.load_calibration().map_err(|error| unusable(path, error))?,
            files => calibration_in(path, files)?,
        };
        let source = Source::of_images(vec![Place::Files(case.left.clone(), case.right.clone())], options.period);
        Ok(Self {
            region_polygon_left_px: Some(case.region_polygon_left_px),
            search: Some(case.search),
            ..Self::plain(camera(&case.folder, source, calibration, (asked, options))?, Vec::new())
        })
    }

    fn of_bag(path: &Path, asked: &RecordingOptions, options: ReplayOptions) -> Result<Self, CameraError> {
        let failed = |error| unusable_bag(path, error);
        let pairing = PairOptions { topics: asked.topics.clone(), within: asked.within, range: asked.range };
        let bag = StereoBag::open(path, pairing).map_err(failed)?;
        let calibration = match &asked.calibration[..] {
            [] => bag.calibration().map_err(failed)?,
            files => calibration_in(path, files)?,
        };
        let region = bag.region().map_err(failed)?;
        let (times, unpaired) = BagImages::times(&bag).map_err(failed)?;
        // A run's recording begins before its operator marks the target.
        let from = region.as_ref().map(|region| region.at);
        let skipped = times.iter().take_while(|(at, _)| from.is_some_and(|from| *at < from)).count();
        let mut notes = vec![format!("images: {} and {}", bag.topics()[0].name, bag.topics()[1].name)];
        let mut warnings = Vec::new();
        if bag.bag().is_unfinished() {
            warnings.push(format!(
                "the recording was broken off: it has no end; its {} pairs until the last whole one are used",
                times.len()
            ));
        }
        if skipped > 0 {
            notes.push(format!("the first {skipped} pairs are left out: the target was marked after them"));
        }
        let pairs: Vec<_> =
            times.into_iter().skip(skipped).map(|(at, skew_nanos)| (Place::Bag, at, skew_nanos)).collect();
        if pairs.is_empty() {
            let [left, right] = bag.topics().clone().map(|topic| topic.name);
            let (file, within_ms) = (path.to_path_buf(), asked.within.as_secs_f64() * 1e3);
            return Err(failed(BagError::NoPairs { file, left, right, within_ms }));
        }
        let images = BagImages::new(bag).after(skipped as u64);
        let mut recording = Self::timed(path, TimedPairs { pairs, unpaired }, calibration, (asked, options))?;
        recording.camera.bag = Some(images);
        recording.notes.splice(0..0, notes);
        recording.warnings.splice(0..0, warnings);
        recording.region_polygon_left_px = region.map(|region| region.corners_px);
        Ok(recording)
    }

    fn timed(
        path: &Path,
        TimedPairs { pairs, unpaired }: TimedPairs,
        calibration: StereoCalibration,
        (asked, options): (&RecordingOptions, ReplayOptions),
    ) -> Result<Self, CameraError> {
        let within_ms = asked.within.as_secs_f64() * 1e3;
        if pairs.is_empty() {
            let message = format!(
                "cannot replay {}: no left image has a right one within {within_ms} ms; state a longer time with --pair-within, or check the clocks of the cameras",
                path.display()
            );
            return Err(CameraError::new(CameraErrorKind::Unusable, message));
        }
        let mut warnings = Vec::new();
        if unpaired > 0 {
            warnings.push(format!(
                "images left out, because the other camera has none within {within_ms} ms (--pair-within): {unpaired}"
            ));
        }
        let source = Source::of_times(pairs, options.period);
        Ok(Self { warnings, ..Self::plain(camera(path, source, calibration, (asked, options))?, Vec::new()) })
    }

    fn plain(camera: ReplayCamera, notes: Vec<String>) -> Self {
        let (times_s, warnings) = (camera.source.times_s(), Vec::new());
        Self { camera, times_s, region_polygon_left_px: None, search: None, cam_left_from_model: None, notes, warnings }
    }
}

/// A folder of no kind that is read.
fn no_recording(path: &Path, error: CameraError) -> CameraError {
    let message = format!(
        "{}: no recording (no sequence.json, no MCAP file, no cam0/data.csv, no image pairs); docs/recordings.md describes what is read",
        path.display()
    );
    CameraError::caused_by(CameraErrorKind::Unusable, message, error)
}

fn camera(
    path: &Path,
    source: Source,
    calibration: StereoCalibration,
    (asked, options): (&RecordingOptions, ReplayOptions),
) -> Result<ReplayCamera, CameraError> {
    Ok(ReplayCamera { range: asked.range, ..ReplayCamera::new(path, source, calibration, options)? })
}

fn is_sequence_file(path: &Path) -> bool {
    path.is_file() && path.extension().is_some_and(|extension| extension == "json" || extension == "jsonl")
}

fn unusable_bag(path: &Path, error: BagError) -> CameraError {
    CameraError::caused_by(CameraErrorKind::Unusable, format!("cannot replay {}", path.display()), error)
}

fn calibration_in(path: &Path, files: &[PathBuf]) -> Result<StereoCalibration, CameraError> {
    load_stereo(files).map_err(|error| {
        let message = format!(
            "cannot replay {}: no usable calibration; give one with --calib, or put a calib.json there",
            path.display()
        );
        CameraError::caused_by(CameraErrorKind::Unusable, message, error)
    })
}
