//! A recording of any kind, ready to be played.

use std::path::{Path, PathBuf};

use pb3dp_camera_recordings::{Kind, RecordedPairs, RecordingOptions, folder_of};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_hal_api::CameraError;
use pb3dp_record::dataset::SearchRange;

use crate::{ReplayCamera, ReplayOptions};

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
    /// Whether the time between the exposures of a pair is known.
    pub states_skew: bool,
    /// What the user should know of the recording.
    pub notes: Vec<String>,
    /// What is missing or not as it should be.
    pub warnings: Vec<String>,
}

impl Recording {
    /// Opens a recording: a folder with a `sequence.json` or a `case.json`, an MCAP file or rosbag2 folder, a folder as those of the EuRoC
    /// dataset, or a plain folder of images. `calibration` names one file, or a left and a right one; that of the recording is used if it is
    /// empty.
    ///
    /// # Errors
    /// Kind `Unusable` if the recording, its description or its calibration cannot be used; images are checked when they are played.
    pub fn open(
        path: &Path,
        calibration: &[PathBuf],
        asked: &RecordingOptions,
        options: ReplayOptions,
    ) -> Result<Self, CameraError> {
        let options = ReplayOptions { period: asked.rate.map_or(options.period, |rate| rate.period()), ..options };
        let path = folder_of(path);
        let kind = Kind::of(path, asked)?;
        let mut pairs = RecordedPairs::of(path, &kind, asked, options.period)?;
        pairs = pairs.with_one_calibration(!calibration.is_empty())?;
        let size = pairs.image_size();
        let calibration = kind.calibration(path, calibration, (&asked.calibration.stated(), size))?;
        let marked = kind.marked(path)?;
        if let Some(marked) = &marked {
            // A run's recording begins before its operator marks the target.
            pairs = pairs.since(marked.at, options.period);
        }
        let mut notes = pairs.take_notes();
        let (mut region, mut search, mut truth) = (marked.map(|marked| marked.corners_px), None, None);
        match kind {
            Kind::Sequence(sequence) => {
                (region, search) = (Some(sequence.region_polygon_left_px), Some(sequence.search));
                truth = sequence.cam_left_from_model;
            }
            Kind::Case(case) => (region, search) = (Some(case.region_polygon_left_px), Some(case.search)),
            Kind::Images => notes.push(format!(
                "the images have no times: {:.1} pairs per second are {}",
                1.0 / options.period.as_secs_f64(),
                if asked.rate.is_some() { "stated" } else { "assumed (--rate states them)" }
            )),
            Kind::Bag(_) | Kind::Euroc(_) => {}
        }
        let states_skew = pairs.states_skew();
        let (times_s, mut warnings) = (pairs.times_s(), pairs.take_warnings());
        warnings.extend(calibration.warnings.iter().cloned());
        Ok(Self {
            camera: ReplayCamera::new(path, pairs, calibration, options)?,
            times_s,
            region_polygon_left_px: region,
            search,
            cam_left_from_model: truth,
            states_skew,
            notes,
            warnings,
        })
    }
}
