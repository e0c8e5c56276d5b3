//! A sequence: numbered stereo pairs with their times, a region in the first left image and optional true poses.

use std::fmt;
use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{ImageSize, Pose};

use super::case::StereoImages;
use super::json::{JsonFile, Node};
use super::{DatasetError, SEQUENCE_FILE, SearchRange, UNFINISHED_FILE, polygon, search_range, unfinished};
use crate::calibration_files::{StereoCalibration, load_stereo};
use crate::images::load_rgb_of_size;

/// A file name pattern with one number, in C notation: `left_%04d.png`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FramePattern {
    before: String,
    digits: usize,
    after: String,
}

impl FramePattern {
    /// Parses a pattern with exactly one `%d` or `%0Nd` (N from 1 to 9); `None` for anything else.
    pub fn parse(pattern: &str) -> Option<Self> {
        let (before, rest) = pattern.split_once('%')?;
        let (width, after) = rest.split_once('d')?;
        let digits = match width.as_bytes() {
            [] => 1,
            [b'0', n @ b'1'..=b'9'] => usize::from(n - b'0'),
            _ => return None,
        };
        (!after.contains('%')).then(|| Self { before: before.into(), digits, after: after.into() })
    }

    /// `<side>_%04d.<extension>`, the pattern of our own recordings.
    pub(super) fn of_recording(side: &str, extension: &str) -> Self {
        Self { before: format!("{side}_"), digits: 4, after: format!(".{extension}") }
    }

    /// The file name of a frame.
    pub fn name(&self, frame: u64) -> String {
        format!("{}{frame:0digits$}{}", self.before, self.after, digits = self.digits)
    }
}

impl fmt::Display for FramePattern {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.digits {
            1 => write!(f, "{}%d{}", self.before, self.after),
            digits => write!(f, "{}%0{digits}d{}", self.before, self.after),
        }
    }
}

/// The checked `sequence.json` of a sequence folder. Images are checked when they are loaded.
#[derive(Clone, Debug, PartialEq)]
pub struct Sequence {
    /// The sequence's folder.
    pub folder: PathBuf,
    /// Names of the left images, relative to the folder.
    pub left: FramePattern,
    /// Names of the right images, relative to the folder.
    pub right: FramePattern,
    /// Middle of the left exposure of each frame, seconds on the recording clock, strictly increasing.
    pub times_s: Vec<f64>,
    /// Middle of the right exposure minus middle of the left one, seconds, per frame; empty if not recorded.
    pub skew_s: Vec<f64>,
    /// Calibration file.
    pub calibration: PathBuf,
    /// Corners `[u, v]` of the target in the left image of frame 0, pixels.
    pub region_polygon_left_px: Vec<[f64; 2]>,
    /// Search range.
    pub search: SearchRange,
    /// True pose of the target in each frame, if known. The model frame is chosen by the recorder: compare motions since frame 0,
    /// not poses.
    pub cam_left_from_model: Option<Vec<Pose<CamLeft, Model>>>,
    /// Keys that are not part of the format.
    pub other_keys: Vec<String>,
    /// Whether the recording was interrupted before its `sequence.json` was written; then these are the frames up to the last
    /// complete one.
    pub is_unfinished: bool,
}

const SEQUENCE_KEYS: [&str; 9] =
    ["left", "right", "frames", "times_s", "skew_s", "calib", "region_polygon_left_px", "search", "truth"];

/// Whether a folder holds a sequence, finished or not.
pub fn is_sequence(folder: &Path) -> bool {
    [SEQUENCE_FILE, UNFINISHED_FILE].iter().any(|name| folder.join(name).exists())
}

/// Loads and checks `sequence.json` of a sequence folder; for an interrupted recording, loads the complete frames.
///
/// # Errors
/// A missing or unreadable file, a missing key, or a value that is not allowed; the message names file, key and value.
pub fn load_sequence(folder: &Path) -> Result<Sequence, DatasetError> {
    // A path to the file itself is accepted as well.
    let is_the_file = [SEQUENCE_FILE, UNFINISHED_FILE].iter().any(|name| folder.ends_with(name)) && !folder.is_dir();
    let folder = folder.parent().filter(|_| is_the_file).unwrap_or(folder);
    let is_unfinished = is_sequence(folder) && !folder.join(SEQUENCE_FILE).exists();
    let file = if is_unfinished { unfinished::read(folder) } else { JsonFile::read(&folder.join(SEQUENCE_FILE)) }?;
    let root = file.root();
    let frames = root.get("frames")?.count()?;
    let times_s = increasing_times(&root.get("times_s")?, frames)?;
    let skew_s = root.optional("skew_s").map(|node| skews(&node, &times_s)).transpose()?.unwrap_or_default();
    let truth = root.optional("truth").map(|node| true_poses(&node.get("cam_left_from_model")?, frames)).transpose()?;
    Ok(Sequence {
        folder: folder.to_owned(),
        left: pattern(&root.get("left")?)?,
        right: pattern(&root.get("right")?)?,
        times_s,
        skew_s,
        calibration: root.get("calib")?.path()?,
        region_polygon_left_px: polygon(&root.get("region_polygon_left_px")?)?,
        search: search_range(&root.get("search")?)?,
        cam_left_from_model: truth,
        other_keys: root.other_keys(&SEQUENCE_KEYS),
        is_unfinished,
    })
}

fn pattern(node: &Node<'_>) -> Result<FramePattern, DatasetError> {
    let parsed = FramePattern::parse(node.text()?);
    parsed.ok_or_else(|| node.refuse("must contain exactly one %d or %0Nd, as in left_%04d.png"))
}

fn check_count(node: &Node<'_>, found: usize, frames: u64) -> Result<(), DatasetError> {
    if found as u64 == frames {
        return Ok(());
    }
    Err(node.refuse(format!("has {found} entries, but `frames` is {frames}; give one per frame")))
}

fn per_frame_numbers(node: &Node<'_>, frames: u64) -> Result<Vec<f64>, DatasetError> {
    let items = node.items()?;
    check_count(node, items.len(), frames)?;
    items.iter().map(Node::number).collect()
}

fn increasing_times(node: &Node<'_>, frames: u64) -> Result<Vec<f64>, DatasetError> {
    let times_s = per_frame_numbers(node, frames)?;
    for (i, pair) in times_s.windows(2).enumerate() {
        if pair[1] <= pair[0] {
            let items = node.items()?;
            let place = items.get(i + 1).unwrap_or(node);
            return Err(place.refuse(format!("must be later than the previous frame, {}", pair[0])));
        }
    }
    Ok(times_s)
}

/// Exposures of a pair are less than a frame apart: more is another unit.
fn skews(node: &Node<'_>, times_s: &[f64]) -> Result<Vec<f64>, DatasetError> {
    let skew_s = per_frame_numbers(node, times_s.len() as u64)?;
    let mut steps_s: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps_s.sort_by(f64::total_cmp);
    let Some(&period_s) = steps_s.get(steps_s.len() / 2) else { return Ok(skew_s) };
    let wrong = node.items()?.into_iter().zip(&skew_s).find(|(_, skew_s)| skew_s.abs() >= period_s);
    match wrong {
        Some((place, _)) => {
            Err(place.refuse(format!("must be in seconds, and less than the time between frames, {period_s} s")))
        }
        None => Ok(skew_s),
    }
}

fn true_poses(node: &Node<'_>, frames: u64) -> Result<Vec<Pose<CamLeft, Model>>, DatasetError> {
    let items = node.items()?;
    check_count(node, items.len(), frames)?;
    items.iter().map(true_pose).collect()
}

/// A row-major homogeneous matrix in millimetres.
fn true_pose(node: &Node<'_>) -> Result<Pose<CamLeft, Model>, DatasetError> {
    let m = node.numbers::<16>()?;
    let rotation = Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]);
    let defect = (rotation * rotation.transpose() - Matrix3::identity()).abs().max();
    if defect > 1e-3 || rotation.determinant() < 0.0 {
        return Err(
            node.refuse(format!("its 3x3 part must be a rotation, but R R^T differs from the identity by {defect:.4}"))
        );
    }
    if m[12..] != [0.0, 0.0, 0.0, 1.0] {
        return Err(node.refuse("its last row must be 0, 0, 0, 1"));
    }
    Ok(Pose::from_rotation_matrix(&rotation, Vector3::new(m[3], m[7], m[11]) * 1e-3))
}

impl Sequence {
    /// Number of frames, at least 1.
    pub fn frames(&self) -> u64 {
        self.times_s.len() as u64
    }

    /// Image files of a frame: left, right.
    pub fn image_files(&self, frame: u64) -> (PathBuf, PathBuf) {
        (self.folder.join(self.left.name(frame)), self.folder.join(self.right.name(frame)))
    }

    /// Loads the calibration.
    ///
    /// # Errors
    /// The file is missing or refused.
    pub fn load_calibration(&self) -> Result<StereoCalibration, DatasetError> {
        Ok(load_stereo(std::slice::from_ref(&self.calibration))?)
    }

    /// Loads both images of a frame and checks their size against the calibration.
    ///
    /// # Errors
    /// An image that is missing, damaged or of another size; the message names it.
    pub fn load_images(&self, frame: u64, size: ImageSize) -> Result<StereoImages, DatasetError> {
        let (left, right) = self.image_files(frame);
        let because_of = self.calibration.display().to_string();
        let load = |file: &Path| load_rgb_of_size(file, size, &because_of);
        Ok(StereoImages { left: load(&left)?, right: load(&right)? })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    #[test]
    fn patterns_are_those_of_printf() {
        let check = |pattern: &str, frame, expected: Option<&str>| {
            assert_eq!(FramePattern::parse(pattern).map(|p| p.name(frame)).as_deref(), expected, "{pattern}");
        };
        check("left_%04d.png", 7, Some("left_0007.png"));
        check("left_%04d.png", 12345, Some("left_12345.png"));
        check("%d.jpg", 10, Some("10.jpg"));
        assert_eq!(FramePattern::parse("a%05d.png").unwrap().to_string(), "a%05d.png");
        check("l/%03d_left.png", 2, Some("l/002_left.png"));
        for wrong in ["left.png", "%4d.png", "%s.png", "%04x.png", "%d_%d.png", "%00d", "%012d", "100%"] {
            check(wrong, 0, None);
        }
    }

    fn valid() -> Value {
        json!({
            "left": "l%d.png", "right": "r%d.png", "frames": 2, "times_s": [1.5, 1.533333], "calib": "calib.json",
            "region_polygon_left_px": [[0, 0], [9, 0], [9, 9]],
            "search": {"z_min_mm": 350, "z_max_mm": 800, "tilt_max_deg": 45},
            "truth": {"cam_left_from_model": [
                [0, -1, 0, 50, 1, 0, 0, -20, 0, 0, 1, 510, 0, 0, 0, 1],
                [1, 0, 0, 1, 0, 0, -1, 2, 0, 1, 0, 3, 0, 0, 0, 1]]},
        })
    }

    fn load(value: &Value) -> Result<Sequence, DatasetError> {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join(SEQUENCE_FILE), value.to_string()).unwrap();
        load_sequence(dir.path())
    }

    #[test]
    fn poses_are_row_major_millimetres() {
        let sequence = load(&valid()).unwrap();
        assert_eq!(sequence.frames(), 2);
        let pose = sequence.cam_left_from_model.as_ref().unwrap()[0];
        // A quarter turn about z maps the model's x axis to the camera's y axis.
        let point = pose.transform_point(&nalgebra::Point3::new(0.1, 0.0, 0.02));
        assert!((point.coords - Vector3::new(0.05, 0.08, 0.53)).norm() < 1e-12, "{point}");
        assert!(sequence.image_files(1).1.ends_with("r1.png"));
    }

    #[test]
    fn refusals_name_key_and_reason() {
        let check = |change: &dyn Fn(&mut Value), parts: &[&str]| {
            let mut value = valid();
            change(&mut value);
            let message = load(&value).unwrap_err().to_string();
            for part in parts.iter().chain(&["sequence.json"]) {
                assert!(message.contains(part), "{message:?} must contain {part:?}");
            }
        };
        check(&|v| v["left"] = json!("left.png"), &["`left`", "%0Nd"]);
        check(&|v| v["frames"] = json!(0), &["`frames`", "at least 1"]);
        check(&|v| v["times_s"] = json!([1.0]), &["`times_s`", "has 1 entries", "`frames` is 2"]);
        check(&|v| v["times_s"] = json!([1.0, 1.0]), &["`times_s[1]`", "later"]);
        check(&|v| v["skew_s"] = json!([0.001]), &["`skew_s`", "has 1 entries"]);
        check(&|v| v["skew_s"] = json!([0.0, -5.0]), &["`skew_s[1]`", "-5", "in seconds"]);
        check(&|v| v["truth"]["cam_left_from_model"][1][0] = json!(1.1), &["cam_left_from_model[1]", "rotation"]);
        check(&|v| v["truth"]["cam_left_from_model"][1][15] = json!(2), &["last row"]);
        check(&|v| v["truth"]["cam_left_from_model"][0] = json!([1, 2]), &["16 numbers, not 2"]);
        check(&|v| v["truth"]["cam_left_from_model"][0][0] = json!("a"), &["cam_left_from_model[0][0]"]);
    }
}
