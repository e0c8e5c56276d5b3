//! Writers of case and sequence folders.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use image::RgbImage;
use nalgebra::Vector3;
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{ImageSize, MonotonicTime, Pose, StereoRig};
use serde_json::{Value, json};

use super::case::{Hardness, PlaneTruth};
use super::unfinished::Log;
use super::{CALIBRATION_FILE, CASE_FILE, DatasetError, FramePattern, SEQUENCE_FILE, SearchRange, UNFINISHED_FILE};
use crate::calibration_files::save_json;
use crate::images::{StoredFormat, save, size_of};

/// The description of a case, without images and calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct CaseDraft {
    /// Name of the case.
    pub name: String,
    /// Corners `[u, v]` of the region in the left image, pixels.
    pub region_polygon_left_px: Vec<[f64; 2]>,
    /// Centroid of the region's pixels.
    pub region_centroid_px: Option<[f64; 2]>,
    /// Search range.
    pub search: SearchRange,
    /// Whether the region is a plane.
    pub planar: bool,
    /// What makes the case difficult.
    pub hard: Option<Hardness>,
    /// Ground truth of the plane.
    pub truth: Option<PlaneTruth>,
}

/// The description of a sequence, without frames and calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceDraft {
    /// Corners `[u, v]` of the target in the left image of frame 0, pixels.
    pub region_polygon_left_px: Vec<[f64; 2]>,
    /// Search range.
    pub search: SearchRange,
    /// Storage format of the images.
    pub images: StoredFormat,
}

/// One frame for [`SequenceWriter::push`].
#[derive(Clone, Copy, Debug)]
pub struct WrittenFrame<'a> {
    /// Left image.
    pub left: &'a RgbImage,
    /// Right image.
    pub right: &'a RgbImage,
    /// Middle of the left exposure.
    pub exposed_at: MonotonicTime,
    /// Middle of the right exposure minus middle of the left exposure, nanoseconds.
    pub skew_nanos: i64,
    /// True pose of the target, if known; in all frames or in none.
    pub cam_left_from_model: Option<Pose<CamLeft, Model>>,
}

/// Image files of one frame. They may be written by other threads than the owner of the [`SequenceWriter`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameFiles {
    /// Left image.
    pub left: PathBuf,
    /// Right image.
    pub right: PathBuf,
    /// Storage format of both.
    pub images: StoredFormat,
}

impl FrameFiles {
    /// Writes both images.
    ///
    /// # Errors
    /// An image that cannot be written.
    pub fn save(&self, left: &RgbImage, right: &RgbImage) -> Result<(), DatasetError> {
        save(left, &self.left, self.images)?;
        Ok(save(right, &self.right, self.images)?)
    }

    /// Removes both images if present.
    fn remove(&self) {
        for file in [&self.left, &self.right] {
            // A missing file needs no removal; a remaining file is harmless, because no description refers to it.
            let _ = std::fs::remove_file(file);
        }
    }
}

/// Summary of a finished recording.
#[derive(Clone, Debug, PartialEq)]
pub struct SequenceSummary {
    /// Its `sequence.json`.
    pub file: PathBuf,
    /// Number of frames.
    pub frames: u64,
}

/// Writes a case folder: `left.png`, `right.png`, `calib.json`, `case.json`. Creates the folder if necessary.
///
/// # Errors
/// The folder already contains a case, or a file cannot be written.
pub fn write_case(
    folder: &Path,
    draft: &CaseDraft,
    rig: &StereoRig,
    left: &RgbImage,
    right: &RgbImage,
) -> Result<(), DatasetError> {
    let file = folder.join(CASE_FILE);
    start_folder(folder, &file)?;
    save(left, &folder.join("left.png"), StoredFormat::Png)?;
    save(right, &folder.join("right.png"), StoredFormat::Png)?;
    save_json(rig, &folder.join(CALIBRATION_FILE))?;
    let mut keys = vec![
        ("case", json!(draft.name)),
        ("left", json!("left.png")),
        ("right", json!("right.png")),
        ("calib", json!(CALIBRATION_FILE)),
        ("planar", json!(draft.planar)),
        ("hard", json!(draft.hard.map(Hardness::name))),
        ("region_polygon_left_px", json!(draft.region_polygon_left_px)),
        ("search", search_value(&draft.search)),
    ];
    keys.extend(draft.region_centroid_px.map(|centroid| ("region_centroid_px", json!(centroid))));
    keys.extend(draft.truth.as_ref().map(|truth| ("truth", truth_value(truth))));
    write_object(&file, &keys)
}

fn truth_value(truth: &PlaneTruth) -> Value {
    let normal: [f64; 3] = truth.normal_in_cam_left.into();
    let mut value = json!({"normal": normal, "z_mm": truth.z_m * 1e3});
    let optional = [
        ("h_mm", truth.h_m.map(|m| json!(m * 1e3))),
        ("mm_per_px_disparity", truth.m_per_px_disparity.map(|m| json!(m * 1e3))),
        ("disparity_plane", truth.disparity_plane.map(|plane| json!(plane))),
        ("z_sigma_mm", truth.z_sigma_m.map(|m| json!(m * 1e3))),
        ("normal_sigma_deg", truth.normal_sigma_rad.map(|rad| json!(rad.to_degrees()))),
        ("how", truth.how.as_ref().map(|how| json!(how))),
    ];
    for (key, entry) in optional {
        if let Some(entry) = entry {
            value[key] = entry;
        }
    }
    value
}

/// Records a sequence folder frame by frame. `sequence.json` is written by [`SequenceWriter::finish`]; an unfinished recording
/// can be loaded without it.
#[derive(Debug)]
pub struct SequenceWriter {
    folder: PathBuf,
    draft: SequenceDraft,
    size: ImageSize,
    left: FramePattern,
    right: FramePattern,
    times: Vec<MonotonicTime>,
    skews_nanos: Vec<i64>,
    poses: Vec<Pose<CamLeft, Model>>,
    /// Present while there is at least one frame.
    log: Option<Log>,
}

impl SequenceWriter {
    /// Checks that a recording can be written to `folder`, and creates the folder.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn check_folder(folder: &Path) -> Result<(), DatasetError> {
        start_folder(folder, &folder.join(UNFINISHED_FILE))?;
        start_folder(folder, &folder.join(SEQUENCE_FILE))?;
        let probe = folder.join("sequence.probe");
        std::fs::write(&probe, "").and_then(|()| std::fs::remove_file(&probe)).map_err(|source| DatasetError::Io {
            file: folder.to_owned(),
            action: "write",
            source,
        })
    }

    /// Starts a recording: creates the folder and writes `calib.json`.
    ///
    /// # Errors
    /// The folder already contains a sequence, or cannot be written to.
    pub fn create(folder: &Path, rig: &StereoRig, draft: SequenceDraft) -> Result<Self, DatasetError> {
        start_folder(folder, &folder.join(UNFINISHED_FILE))?;
        start_folder(folder, &folder.join(SEQUENCE_FILE))?;
        save_json(rig, &folder.join(CALIBRATION_FILE))?;
        let extension = draft.images.extension();
        Ok(Self {
            folder: folder.to_owned(),
            draft,
            size: rig.left().size(),
            left: FramePattern::of_recording("left", extension),
            right: FramePattern::of_recording("right", extension),
            times: Vec::new(),
            skews_nanos: Vec::new(),
            poses: Vec::new(),
            log: None,
        })
    }

    /// Writes the images of the next frame.
    ///
    /// # Errors
    /// A frame that is not later than the previous one, whose size differs from the calibration, or with a true pose where other
    /// frames have none; such a frame is not recorded. An image that cannot be written.
    pub fn push(&mut self, frame: WrittenFrame<'_>) -> Result<(), DatasetError> {
        let files = self.accept(&frame)?;
        files.save(frame.left, frame.right).inspect_err(|_| self.forget_last())
    }

    /// Logs the next frame and returns its image files, which the caller writes. If writing fails, remove the frame with
    /// [`Self::keep`].
    ///
    /// # Errors
    /// As [`Self::push`], except for image files that cannot be written.
    pub fn accept(&mut self, frame: &WrittenFrame<'_>) -> Result<FrameFiles, DatasetError> {
        let number = self.frames();
        self.check(frame).map_err(|reason| DatasetError::Frame {
            frame: number,
            folder: self.folder.clone(),
            reason,
        })?;
        self.times.push(frame.exposed_at);
        self.skews_nanos.push(frame.skew_nanos);
        self.poses.extend(frame.cam_left_from_model);
        self.note(number, frame).inspect_err(|_| self.forget_last())?;
        Ok(self.files(number))
    }

    fn note(&mut self, number: u64, frame: &WrittenFrame<'_>) -> Result<(), DatasetError> {
        let log = match self.log.take() {
            Some(log) => log,
            None => {
                let head = self.head().map(|(key, value)| (key.to_owned(), value)).into_iter().collect();
                Log::create(&self.folder, &Value::Object(head))?
            }
        };
        let log = self.log.insert(log);
        let times = (frame.exposed_at.as_secs_f64(), frame.skew_nanos as f64 * 1e-9);
        log.note(number, times, frame.cam_left_from_model.as_ref().map(row_major_millimetres))
    }

    /// The keys of the description that do not grow with the frames.
    fn head(&self) -> [(&'static str, Value); 5] {
        [
            ("left", json!(self.left.to_string())),
            ("right", json!(self.right.to_string())),
            ("calib", json!(CALIBRATION_FILE)),
            ("region_polygon_left_px", json!(self.draft.region_polygon_left_px)),
            ("search", search_value(&self.draft.search)),
        ]
    }

    /// Number of frames so far.
    pub fn frames(&self) -> u64 {
        self.times.len() as u64
    }

    /// Keeps the first frames and removes all others with their images.
    pub fn keep(&mut self, frames: u64) {
        while self.frames() > frames {
            self.forget_last();
        }
    }

    fn forget_last(&mut self) {
        if self.times.pop().is_some() {
            self.skews_nanos.pop();
            self.poses.truncate(self.times.len());
            self.files(self.frames()).remove();
            if let Some(log) = self.log.take_if(|_| self.times.is_empty()) {
                log.remove();
            }
        }
    }

    fn files(&self, number: u64) -> FrameFiles {
        let place = |pattern: &FramePattern| self.folder.join(pattern.name(number));
        FrameFiles { left: place(&self.left), right: place(&self.right), images: self.draft.images }
    }

    fn check(&self, frame: &WrittenFrame<'_>) -> Result<(), String> {
        if let Some(last) = self.times.last().filter(|last| frame.exposed_at <= **last) {
            let (now_s, last_s) = (frame.exposed_at.as_secs_f64(), last.as_secs_f64());
            return Err(format!("its time {now_s} s must be later than the previous frame, {last_s} s"));
        }
        for (name, image) in [("left", frame.left), ("right", frame.right)] {
            let (found, size) = (size_of(image), self.size);
            if found != size {
                return Err(format!(
                    "the {name} image has {}x{} pixels, the calibration {}x{}",
                    found.width, found.height, size.width, size.height
                ));
            }
        }
        if frame.cam_left_from_model.is_some() != (self.poses.len() == self.times.len()) && !self.times.is_empty() {
            return Err("the true pose must be given in all frames or in none".into());
        }
        Ok(())
    }

    /// Writes `sequence.json`. If the disk is full, the last frames are removed to make room for it.
    ///
    /// # Errors
    /// No frame was pushed, or the file cannot be written.
    pub fn finish(mut self) -> Result<SequenceSummary, DatasetError> {
        loop {
            match self.describe() {
                Err(error) if error.is_disk_full() && self.frames() > 1 => self.forget_last(),
                done => {
                    if let (Ok(_), Some(log)) = (&done, &self.log) {
                        log.remove();
                    }
                    return done;
                }
            }
        }
    }

    fn describe(&self) -> Result<SequenceSummary, DatasetError> {
        if self.times.is_empty() {
            let reason = "a sequence must have at least one frame".into();
            return Err(DatasetError::Frame { frame: 0, folder: self.folder.clone(), reason });
        }
        let file = self.folder.join(SEQUENCE_FILE);
        let times_s: Vec<f64> = self.times.iter().map(|t| t.as_secs_f64()).collect();
        let [left, right, calibration, region, search] = self.head();
        let (frames, times) = (("frames", json!(times_s.len())), ("times_s", json!(times_s)));
        let mut keys = vec![left, right, frames, times, calibration, region, search];
        if self.skews_nanos.iter().any(|skew| *skew != 0) {
            let skew_s: Vec<f64> = self.skews_nanos.iter().map(|nanos| *nanos as f64 * 1e-9).collect();
            keys.push(("skew_s", json!(skew_s)));
        }
        if !self.poses.is_empty() {
            let rows: Vec<_> = self.poses.iter().map(row_major_millimetres).collect();
            keys.push(("truth", json!({"cam_left_from_model": rows})));
        }
        write_object(&file, &keys)?;
        Ok(SequenceSummary { file, frames: times_s.len() as u64 })
    }
}

/// A pose as in files and `--json` output: 16 numbers of the homogeneous matrix, row by row, millimetres.
fn row_major_millimetres(pose: &Pose<CamLeft, Model>) -> [f64; 16] {
    let (r, t) = (pose.rotation_matrix(), pose.translation_m());
    let mut numbers = [0.0; 16];
    for row in 0..3 {
        for column in 0..3 {
            numbers[4 * row + column] = r[(row, column)];
        }
        numbers[4 * row + 3] = t[row] * 1e3;
    }
    numbers[15] = 1.0;
    numbers
}

fn search_value(search: &SearchRange) -> Value {
    json!({
        "z_min_mm": search.z_min_m * 1e3,
        "z_max_mm": search.z_max_m * 1e3,
        "tilt_max_deg": search.tilt_max_rad.to_degrees(),
    })
}

fn start_folder(folder: &Path, file: &Path) -> Result<(), DatasetError> {
    if file.exists() {
        return Err(DatasetError::Exists { file: file.to_owned() });
    }
    std::fs::create_dir_all(folder).map_err(|source| DatasetError::Io {
        file: folder.to_owned(),
        action: "write",
        source,
    })
}

/// Writes an object with one key per line, completely or not at all.
fn write_object(file: &Path, keys: &[(&str, Value)]) -> Result<(), DatasetError> {
    let mut text = String::from("{\n");
    for (i, (key, value)) in keys.iter().enumerate() {
        let comma = if i + 1 < keys.len() { "," } else { "" };
        // Writing to a String does not fail.
        let _ = writeln!(text, " \"{key}\": {value}{comma}");
    }
    text.push_str("}\n");
    let partial = file.with_extension("json.partial");
    std::fs::write(&partial, text).and_then(|()| std::fs::rename(&partial, file)).map_err(|source| {
        // Remove the partial file; it may not exist.
        let _ = std::fs::remove_file(&partial);
        DatasetError::Io { file: file.to_owned(), action: "write", source }
    })
}

impl PlaneTruth {
    /// Ground truth of an exactly known plane through `point_in_cam_left` (metres, on the ray of the region's centroid). The
    /// normal may have either sign.
    pub fn exact(point_in_cam_left: Vector3<f64>, normal_in_cam_left: Vector3<f64>) -> Self {
        let unit = normal_in_cam_left.normalize();
        let facing = if unit.dot(&point_in_cam_left) > 0.0 { -unit } else { unit };
        Self {
            normal_in_cam_left: facing,
            z_m: point_in_cam_left.z,
            h_m: Some(-facing.dot(&point_in_cam_left)),
            m_per_px_disparity: None,
            disparity_plane: None,
            z_sigma_m: Some(0.0),
            normal_sigma_rad: Some(0.0),
            how: None,
        }
    }
}
