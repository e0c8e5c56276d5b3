//! Stereo calibration files: ROS, Kalibr, OpenCV, and our own `calib.json`, read and written.
//!
//! [`load_stereo`] detects the format from the contents. Its result has passed every check that a file allows: shapes and finite
//! numbers, valid rotations, a principal point near the image, a baseline between 1 mm and 10 m, the right camera on the right.
//! Redundant values of a file must agree. An error names file, key and reason.
//!
//! | format | files | length unit | distortion |
//! |---|---|---|---|
//! | ROS `camera_info` | left and right YAML, or their directory | metres | `plumb_bob`, `rational_polynomial`, `equidistant` |
//! | Kalibr camchain | one YAML with `cam0`, `cam1` | metres | `radtan`, `equidistant`, `none` |
//! | OpenCV stereo | one YAML, or two (intrinsics, extrinsics) | see [`opencv`] | 4, 5 or 8 coefficients, or fisheye |
//! | `calib.json` | one JSON | millimetres | optional, as ROS |
//! | `pb3dp calibrate` | one TOML | metres | as ROS |
//!
//! The last one also stores the origin and quality of the calibration: [`Judgement`].
//!
//! In addition there are hand-eye calibrations ([`load_hand_eye`]), which give the pose of the left camera on an arm.
//!
//! `cam0` and the first camera of OpenCV are the left camera. Distortion coefficients that are all zero give an undistorted
//! camera, except for the equidistant model, where zeros are an ideal fisheye lens.

mod case_json;
mod checks;
mod document;
mod error;
mod euroc;
mod hand_eye;
mod identity;
mod judged;
mod kalibr;
pub mod opencv;
mod pose;
mod ros;
pub mod stops;
mod write;

use std::fmt;
use std::path::{Path, PathBuf};

use pb3dp_geometry::{ImageSize, StereoRig};

use document::Document;
pub use error::CalibrationFileError;
use error::one_line;
pub use hand_eye::{BoardPlace, HandEye};
pub use identity::CameraIdentity;
pub use judged::{JudgedGate, Judgement, ParameterCovariance};
pub use ros::RosCameraInfo;

/// A checked stereo calibration and its source.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoCalibration {
    /// The two cameras and the pose between them.
    pub rig: StereoRig,
    /// The format of the file or files.
    pub format: CalibrationFormat,
    /// The files, as the caller named them, for reports.
    pub source: String,
    /// Assumptions and omissions of the reader that the user should know, such as a unit of length.
    pub notes: Vec<String>,
    /// The statement of the file if its numbers are not measured: `calibration_quality` of a `calib.json` that begins with
    /// `none`.
    pub not_measured: Option<String>,
    /// Origin and quality of the calibration, from our TOML file.
    pub judgement: Option<Judgement>,
}

/// The formats that are read and written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CalibrationFormat {
    /// Two ROS `camera_info` YAML files.
    RosPair,
    /// Two `sensor.yaml` of a folder as those of the EuRoC dataset.
    EurocPair,
    /// A Kalibr camchain YAML file.
    Kalibr,
    /// An OpenCV `FileStorage` YAML file.
    OpenCv,
    /// Our `calib.json`.
    CaseJson,
    /// Our TOML of `pb3dp calibrate`.
    Judged,
}

impl fmt::Display for CalibrationFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::RosPair => "ROS camera_info pair",
            Self::EurocPair => "EuRoC sensor.yaml pair",
            Self::Kalibr => "Kalibr camchain",
            Self::OpenCv => "OpenCV stereo YAML",
            Self::CaseJson => "calib.json",
            Self::Judged => "pb3dp calibration TOML",
        })
    }
}

/// File names searched in a directory, in this order.
const IN_DIRECTORY: [&[&str]; 6] = [
    &["left.yaml", "right.yaml"],
    &["left.yml", "right.yml"],
    &["calib.json"],
    &["calibration.toml"],
    &["intrinsics.yml", "extrinsics.yml"],
    &["intrinsics.yaml", "extrinsics.yaml"],
];

/// Reads a stereo calibration: one file, a left and a right file, or a directory with `left.yaml` and `right.yaml`, `calib.json`,
/// `calibration.toml`, or `intrinsics.yml` and `extrinsics.yml` in it (`.yml` or `.yaml`).
///
/// # Errors
/// An invalid file; see [`CalibrationFileError`].
pub fn load_stereo(paths: &[PathBuf]) -> Result<StereoCalibration, CalibrationFileError> {
    load(paths, None)
}

/// File name of the identities of the cameras of a recording.
pub const CAMERAS_FILE: &str = "cameras.toml";

/// Reads the identities of the left and the right camera of a recording from its `cameras.toml`.
///
/// # Errors
/// An unreadable file, or one with other contents.
pub fn load_cameras(path: &Path) -> Result<[CameraIdentity; 2], CalibrationFileError> {
    identity::read_file(&Document::read(path)?.root())
}

/// Reads our TOML file of a hand-eye calibration.
///
/// # Errors
/// An invalid file; see [`CalibrationFileError`].
pub fn load_hand_eye(path: &Path) -> Result<HandEye, CalibrationFileError> {
    hand_eye::read(&Document::read(path)?.root())
}

/// Writes our TOML file of a hand-eye calibration, preserving all numbers bit by bit.
///
/// # Errors
/// A number of the judgement that is not finite; a file that cannot be written.
pub fn save_hand_eye(hand_eye: &HandEye, path: &Path) -> Result<(), CalibrationFileError> {
    write_file(path, &hand_eye::write(hand_eye)?)
}

/// As [`load_stereo`], for images of a known size, which is used for files that may omit the size (OpenCV). A size stated in the
/// file is not compared with it.
///
/// # Errors
/// As [`load_stereo`].
pub fn load_stereo_for(paths: &[PathBuf], images: ImageSize) -> Result<StereoCalibration, CalibrationFileError> {
    load(paths, Some(images))
}

fn load(paths: &[PathBuf], images: Option<ImageSize>) -> Result<StereoCalibration, CalibrationFileError> {
    let paths = match paths {
        [directory] if directory.is_dir() => in_directory(directory)?,
        paths => paths.to_vec(),
    };
    let documents = paths.iter().map(|path| Document::read(path)).collect::<Result<Vec<_>, _>>()?;
    assemble(&paths, &documents, images)
}

/// As [`load_stereo_for`], for one file whose text is already loaded; the format is detected from the contents.
///
/// # Errors
/// As [`load_stereo`].
pub fn parse_stereo(
    name: &Path,
    text: &str,
    images: Option<ImageSize>,
) -> Result<StereoCalibration, CalibrationFileError> {
    assemble(&[name.to_path_buf()], &[Document::parse(name, text)?], images)
}

/// As [`load_stereo`], for the texts of the left and the right ROS `camera_info` file; `names` stand for the files in messages.
///
/// # Errors
/// As [`load_stereo`].
pub fn parse_ros_pair(names: [&Path; 2], texts: [&str; 2]) -> Result<StereoCalibration, CalibrationFileError> {
    let documents = [Document::parse(names[0], texts[0])?, Document::parse(names[1], texts[1])?];
    assemble(&names.map(Path::to_path_buf), &documents, None)
}

/// As [`load_stereo`], for the texts of `sensor.yaml` of `cam0` and `cam1` in the layout of the EuRoC dataset.
///
/// # Errors
/// As [`load_stereo`].
pub fn parse_euroc(names: [&Path; 2], texts: [&str; 2]) -> Result<StereoCalibration, CalibrationFileError> {
    let [left, right] = [Document::parse(names[0], texts[0])?, Document::parse(names[1], texts[1])?];
    Ok(StereoCalibration {
        rig: euroc::read(&left.root(), &right.root())?,
        format: CalibrationFormat::EurocPair,
        source: names.map(|name| name.display().to_string()).join(", "),
        notes: Vec::new(),
        not_measured: None,
        judgement: None,
    })
}

fn assemble(
    paths: &[PathBuf],
    documents: &[Document],
    images: Option<ImageSize>,
) -> Result<StereoCalibration, CalibrationFileError> {
    let Parsed { rig, format, notes, judgement } = match documents {
        [one] => read_one(one, images)?,
        [first, second] => read_two(first, second, images)?,
        _ => return Err(CalibrationFileError::Paths { count: paths.len() }),
    };
    let source = paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ");
    let not_measured = match (documents, format) {
        ([one], CalibrationFormat::CaseJson) => case_json::not_measured(&one.root()),
        _ => None,
    };
    Ok(StereoCalibration { rig, format, source, notes, not_measured, judgement })
}

/// Writes a ROS `camera_info` YAML file for each camera; the pose is stored in the rectification and projection matrices.
///
/// # Errors
/// A rig that cannot be rectified and therefore has no such matrices, or images of unequal size; a file that cannot be written.
pub fn save_ros_pair(rig: &StereoRig, left: &Path, right: &Path) -> Result<(), CalibrationFileError> {
    check_sizes(rig, CalibrationFormat::RosPair)?;
    let [left_text, right_text] = ros::write(rig)?;
    write_file(left, &left_text)?;
    write_file(right, &right_text)
}

/// Writes a Kalibr camchain.
///
/// # Errors
/// A lens with k3 or a rational term, which Kalibr's `radtan` does not have; images of unequal size; a file that cannot be
/// written.
pub fn save_kalibr(rig: &StereoRig, path: &Path) -> Result<(), CalibrationFileError> {
    check_sizes(rig, CalibrationFormat::Kalibr)?;
    write_file(path, &kalibr::write(rig)?)
}

/// Writes an OpenCV `FileStorage` YAML file, in metres, with the extra keys that [`opencv`] describes.
///
/// # Errors
/// Images of unequal size; a file that cannot be written.
pub fn save_opencv(rig: &StereoRig, path: &Path) -> Result<(), CalibrationFileError> {
    check_sizes(rig, CalibrationFormat::OpenCv)?;
    write_file(path, &opencv::write(rig))
}

/// Writes our TOML file, preserving all numbers bit by bit.
///
/// # Errors
/// Images of unequal size, a number that is not finite; a file that cannot be written.
pub fn save_judged(rig: &StereoRig, judgement: &Judgement, path: &Path) -> Result<(), CalibrationFileError> {
    check_sizes(rig, CalibrationFormat::Judged)?;
    write_file(path, &judged::write(rig, judgement)?)
}

/// Writes the `cameras.toml` of a recording.
///
/// # Errors
/// A file that cannot be written.
pub fn save_cameras(cameras: &[CameraIdentity; 2], path: &Path) -> Result<(), CalibrationFileError> {
    write_file(path, &cameras_text(cameras))
}

/// The text of a `cameras.toml`.
pub fn cameras_text(cameras: &[CameraIdentity; 2]) -> String {
    identity::write_file(cameras)
}

/// Writes our `calib.json`, in millimetres.
///
/// # Errors
/// Images of unequal size; a file that cannot be written.
pub fn save_json(rig: &StereoRig, path: &Path) -> Result<(), CalibrationFileError> {
    check_sizes(rig, CalibrationFormat::CaseJson)?;
    write_file(path, &case_json::write(rig))
}

/// The text of our `calib.json`.
pub fn json_text(rig: &StereoRig) -> String {
    case_json::write(rig)
}

/// The `camera_info` of the left and the right camera, as ROS has it in files and messages.
///
/// # Errors
/// A rig that cannot be rectified.
pub fn ros_camera_infos(rig: &StereoRig) -> Result<[RosCameraInfo; 2], CalibrationFileError> {
    ros::camera_infos(rig)
}

/// The content of one or two files.
struct Parsed {
    rig: StereoRig,
    format: CalibrationFormat,
    notes: Vec<String>,
    judgement: Option<Judgement>,
}

impl Parsed {
    fn of(format: CalibrationFormat, rig: StereoRig) -> Self {
        Self { rig, format, notes: Vec::new(), judgement: None }
    }
}

fn read_one(document: &Document, images: Option<ImageSize>) -> Result<Parsed, CalibrationFileError> {
    let root = document.root();
    if judged::recognises(&root) {
        let (rig, judgement) = judged::read(&root)?;
        let note = |gate: &JudgedGate| {
            format!("gate {} refused this calibration when it was made: measured {}", gate.name, gate.measured)
        };
        let notes = judgement.refusals().map(note).collect();
        Ok(Parsed { notes, judgement: Some(judgement), ..Parsed::of(CalibrationFormat::Judged, rig) })
    } else if case_json::recognises(&root) {
        Ok(Parsed::of(CalibrationFormat::CaseJson, case_json::read(&root)?))
    } else if kalibr::recognises(&root) {
        Ok(Parsed::of(CalibrationFormat::Kalibr, kalibr::read(&root)?))
    } else if opencv::recognises(&root) {
        let (rig, notes) = opencv::read(&[root], images)?;
        Ok(Parsed { notes, ..Parsed::of(CalibrationFormat::OpenCv, rig) })
    } else if ros::recognises(&root) {
        Err(root
            .error("camera_matrix", "this is one camera of a ROS camera_info pair; give the left and the right file"))
    } else {
        Err(CalibrationFileError::Format { file: document.file().to_path_buf(), found: document.keys() })
    }
}

fn read_two(first: &Document, second: &Document, images: Option<ImageSize>) -> Result<Parsed, CalibrationFileError> {
    let (one, two) = (first.root(), second.root());
    if ros::recognises(&one) && ros::recognises(&two) {
        Ok(Parsed::of(CalibrationFormat::RosPair, ros::read(&one, &two)?))
    } else if opencv::recognises(&one) || opencv::recognises(&two) {
        let (rig, notes) = opencv::read(&[one, two], images)?;
        Ok(Parsed { notes, ..Parsed::of(CalibrationFormat::OpenCv, rig) })
    } else {
        let stranger = if ros::recognises(&one) { second } else { first };
        Err(CalibrationFileError::Format { file: stranger.file().to_path_buf(), found: stranger.keys() })
    }
}

fn in_directory(directory: &Path) -> Result<Vec<PathBuf>, CalibrationFileError> {
    let candidates = IN_DIRECTORY.iter().map(|names| names.iter().map(|name| directory.join(name)).collect::<Vec<_>>());
    let found = candidates.into_iter().find(|files| files.iter().any(|file| file.is_file()));
    found.ok_or_else(|| CalibrationFileError::Directory { directory: directory.to_path_buf() })
}

/// Refuses rigs that our readers would refuse.
fn check_sizes(rig: &StereoRig, format: CalibrationFormat) -> Result<(), CalibrationFileError> {
    if rig.left().size() == rig.right().size() {
        return Ok(());
    }
    let reason = "the two cameras have different image sizes".to_owned();
    Err(CalibrationFileError::NotRepresentable { format, reason })
}

fn write_file(path: &Path, text: &str) -> Result<(), CalibrationFileError> {
    std::fs::write(path, text).map_err(|source| CalibrationFileError::Write {
        file: path.to_path_buf(),
        reason: one_line(&source),
        source,
    })
}
