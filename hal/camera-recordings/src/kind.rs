//! Kinds of recordings: sequence folders, cases, MCAP files, EuRoC folders and plain folders of images.

use std::path::{Path, PathBuf};

use pb3dp_bag::BagError;
use pb3dp_bag::pairs::{MarkedRegion, PAIR_WITHIN, PairOptions, StereoBag};
use pb3dp_bag::reader::Bag;
use pb3dp_geometry::ImageSize;
use pb3dp_hal_api::{CameraError, CameraErrorKind};
use pb3dp_record::calibration_files::{CalibrationFileError, StatedCalibration, StereoCalibration, load_stated};
use pb3dp_record::dataset::{CASE_FILE, Case, DatasetError, Sequence, is_sequence, load_case, load_sequence};

use crate::euroc;
use crate::options::{RecordingOptions, Topics};

/// A recording with its description.
#[derive(Debug)]
pub enum Kind {
    /// A folder with a `sequence.json`.
    Sequence(Sequence),
    /// A folder with a `case.json`: one pair.
    Case(Case),
    /// An MCAP file or a folder of rosbag2.
    Bag(StereoBag),
    /// Two camera folders as in the EuRoC dataset.
    Euroc([PathBuf; 2]),
    /// A plain folder of images.
    Images,
}

impl Kind {
    /// Finds the kind of a recording and reads its description.
    ///
    /// # Errors
    /// Kind `Unusable` if there is no recording, its description cannot be used, or an option has no effect on its kind.
    pub fn of(path: &Path, asked: &RecordingOptions) -> Result<Self, CameraError> {
        let kind = Self::found(path, asked)?;
        kind.check(path, asked)?;
        Ok(kind)
    }

    /// Refuses the options without effect.
    fn check(&self, path: &Path, asked: &RecordingOptions) -> Result<(), CameraError> {
        let is_bag = matches!(self, Self::Bag(_));
        let is_paired = is_bag || matches!(self, Self::Euroc(_));
        let without_effect = [
            ("--topics", asked.topics.is_some() && !is_bag, "only MCAP recordings have topics"),
            ("--segment", asked.segment.is_some() && !is_bag, "only the calibration of MCAP recordings changes"),
            (
                "--pair-within",
                asked.pair_within != PAIR_WITHIN && !is_paired,
                "only the images of MCAP and EuRoC recordings are paired by their times",
            ),
            (
                "--layout",
                asked.layout.is_some() && !matches!(self, Self::Images),
                "only the images of plain folders have both views",
            ),
        ];
        match without_effect.into_iter().find(|(_, is_given, _)| *is_given) {
            Some((option, _, why)) => {
                let message = format!("{option} has no effect on {}: {why}; leave it out", path.display());
                Err(CameraError::new(CameraErrorKind::Unusable, message))
            }
            None => Ok(()),
        }
    }

    fn found(path: &Path, asked: &RecordingOptions) -> Result<Self, CameraError> {
        if is_sequence(path) || is_sequence_file(path) {
            return load_sequence(path).map(Self::Sequence).map_err(|error| unusable(path, error));
        }
        if path.join(CASE_FILE).exists() {
            return load_case(path).map(Self::Case).map_err(|error| unusable(path, error));
        }
        if Bag::is_one(path) {
            let topics = asked.topics.clone().map(|Topics(names)| names);
            let (within, range, segment) = (asked.pair_within, asked.range, asked.segment);
            let pairing = PairOptions { topics, within, range, segment };
            return StereoBag::open(path, pairing).map(Self::Bag).map_err(|error| unusable_bag(path, error));
        }
        if let Some(cameras) = euroc::camera_folders(path) {
            return Ok(Self::Euroc(cameras));
        }
        if path.exists() && !path.is_dir() {
            let error = Bag::open(path).err().unwrap_or_else(|| BagError::NoMcap { file: path.to_path_buf() });
            return Err(unusable_bag(path, error));
        }
        if !path.exists() {
            let message = format!("cannot replay {}: it does not exist; check the path", path.display());
            return Err(CameraError::new(CameraErrorKind::Unusable, message));
        }
        Ok(Self::Images)
    }

    /// The calibration in these files, or that of the recording if there are none, as the user states it. `images` is the size of the images,
    /// if one can be read. [`StereoCalibration::other_lens`] is left to be decided.
    ///
    /// # Errors
    /// Kind `Unusable` if there is none, or it cannot be used.
    pub fn calibration(
        &self,
        path: &Path,
        files: &[PathBuf],
        (stated, images): (&StatedCalibration, Option<ImageSize>),
    ) -> Result<StereoCalibration, CameraError> {
        let load = |files: &[PathBuf]| load_stated(files, images, stated);
        let refused = |error: CalibrationFileError| unusable(path, DatasetError::from(error));
        match (files, self) {
            ([], Self::Sequence(sequence)) => load(std::slice::from_ref(&sequence.calibration)).map_err(refused),
            ([], Self::Case(case)) => load(std::slice::from_ref(&case.calibration)).map_err(refused),
            ([], Self::Bag(bag)) => bag.calibration(stated).map_err(|error| unusable_bag(path, error)),
            ([], Self::Euroc(cameras)) => euroc::calibration(cameras)?.as_stated(stated, images).map_err(refused),
            ([], Self::Images) => load(&[path.to_path_buf()]).map_err(|error| {
                let message = format!(
                    "cannot replay {}: no usable calibration; give one with --calib, or put a calib.json there",
                    path.display()
                );
                CameraError::caused_by(CameraErrorKind::Unusable, message, error)
            }),
            (files, _) => load(files).map_err(|error| {
                let message = "the calibration of --calib cannot be used".to_owned();
                CameraError::caused_by(CameraErrorKind::Unusable, message, error)
            }),
        }
    }

    /// The region that an operator marked, in an MCAP recording.
    ///
    /// # Errors
    /// Kind `Unusable` if the recording is damaged.
    pub fn marked(&self, path: &Path) -> Result<Option<MarkedRegion>, CameraError> {
        match self {
            Self::Bag(bag) => bag.region().map_err(|error| unusable_bag(path, error)),
            _ => Ok(None),
        }
    }
}

/// The recording at a path: the description of a bag stands for its folder.
pub fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|_| path.is_file() && path.ends_with("metadata.yaml")).unwrap_or(path)
}

/// A folder of no kind that is read.
pub(crate) fn no_recording(path: &Path, error: CameraError) -> CameraError {
    let message = format!(
        "{}: no recording (no sequence.json, no MCAP file, no cam0/data.csv, no image pairs); docs/recordings.md describes what is read",
        path.display()
    );
    CameraError::caused_by(CameraErrorKind::Unusable, message, error)
}

pub(crate) fn unusable_bag(path: &Path, error: BagError) -> CameraError {
    CameraError::caused_by(CameraErrorKind::Unusable, format!("cannot replay {}", path.display()), error)
}

pub(crate) fn unusable(folder: &Path, error: DatasetError) -> CameraError {
    CameraError::caused_by(CameraErrorKind::Unusable, format!("cannot replay {}", folder.display()), error)
}

fn is_sequence_file(path: &Path) -> bool {
    !path.is_dir()
        && path.exists()
        && path.extension().is_some_and(|extension| extension == "json" || extension == "jsonl")
}
