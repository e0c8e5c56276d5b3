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
mod sensor_window;
mod stated;
pub mod stops;
mod write;

use std::fmt;
use std::path::{Path, PathBuf};

use pb3dp_geometry::{ImageSize, StereoRig};

use document::{Document, Node};
pub use error::CalibrationFileError;
use error::one_line;
pub use hand_eye::{BoardPlace, HandEye};
pub use identity::CameraIdentity;
pub use judged::{JudgedGate, Judgement, ParameterCovariance};
pub use ros::RosCameraInfo;
pub use stated::{LengthUnit, LensModel, StatedCalibration};

/// A checked stereo calibration and its source.
#[derive(Clone, Debug, PartialEq)]
pub struct StereoCalibration {
    /// The two cameras and the pose between them.
    pub rig: StereoRig,
    /// The rig with equidistant (fisheye) lenses, if the file leaves the lens model unstated and `rig` is only one of two possible readings.
    /// The images decide ([`Self::with_lens`]), or the calibration is refused ([`Self::decided`]).
    pub other_lens: Option<StereoRig>,
    /// The format of the file or files.
    pub format: CalibrationFormat,
    /// The files, as the caller named them, for reports.
    pub source: String,
    /// Assumptions and omissions of the reader that the user should know, such as a unit of length.
    pub notes: Vec<String>,
    /// Assumptions of the reader that can be wrong.
    pub warnings: Vec<String>,
    /// The statement of the file if its numbers are not measured: `calibration_quality` of a `calib.json` that begins with
    /// `none`.
    pub not_measured: Option<String>,
    /// Origin and quality of the calibration, from our TOML file.
    pub judgement: Option<Judgement>,
}

impl StereoCalibration {
    /// Refuses a calibration of which two readings are possible.
    ///
    /// # Errors
    /// [`Self::other_lens`] is a possible reading.
    pub fn decided(self) -> Result<Self, CalibrationFileError> {
        match self.other_lens {
            None => Ok(self),
            Some(_) => Err(self.undecided_lens("both are possible")),
        }
    }

    /// The refusal of an unstated lens model.
    pub fn undecided_lens(&self, why: &str) -> CalibrationFileError {
        CalibrationFileError::Stated {
            source_files: self.source.clone(),
            option: "--calib-lens".to_owned(),
            reason: format!(
                "the calibration has four coefficients and states no lens model: {} or {}; {why}; state it with --calib-lens brown or \
                 --calib-lens equidistant, or with the key distortion_model (plumb_bob or fisheye)",
                LensModel::BrownConrady,
                LensModel::Equidistant
            ),
        }
    }

    /// One of two possible readings, with the reason for a warning.
    #[must_use]
    pub fn with_lens(mut self, lens: LensModel, because: &str) -> Self {
        if let Some(other) = self.other_lens.take() {
            if lens == LensModel::Equidistant {
                self.rig = other;
            }
            self.warnings.push(format!(
                "the calibration states no lens model: {lens} is used, because {because}; if this is wrong, state it with --calib-lens"
            ));
        }
        self
    }

    /// The calibration as the user states it, for images of a known size, if it is known. The readers apply unit and lens model.
    ///
    /// # Errors
    /// The file states something else; a rig that cannot be rectified.
    pub fn as_stated(
        mut self,
        stated: &StatedCalibration,
        images: Option<ImageSize>,
    ) -> Result<Self, CalibrationFileError> {
        let refuse = |option: String, reason: String| CalibrationFileError::Stated {
            source_files: self.source.clone(),
            option,
            reason,
        };
        if self.format != CalibrationFormat::OpenCv {
            for (name, value) in
                [("unit", stated.unit.map(LengthUnit::name)), ("lens", stated.lens.map(LensModel::name))]
            {
                if let Some(value) = value {
                    let reason = format!("a {} states this itself; leave the option out", self.format);
                    return Err(refuse(format!("--calib-{name} {value}"), reason));
                }
            }
        }
        if stated.rectified {
            if self.other_lens.is_some() {
                return Err(self.undecided_lens("without P1 and P2 the rectified cameras depend on it"));
            }
            let rectified = self.rig.rectify().map_err(|error| refuse("--rectified".to_owned(), one_line(&error)))?;
            self.rig = rectified.rig;
        }
        let made_for = self.rig.left().size();
        if let Some(size) = stated.size {
            let option = format!("--calib-size {}x{}", size.width, size.height);
            if made_for != size {
                let reason = format!(
                    "the file states {}x{} pixels; leave the option out, or correct the file",
                    made_for.width, made_for.height
                );
                return Err(refuse(option, reason));
            }
            if let Some(images) = images.filter(|images| *images != size) {
                let scale =
                    |rig: &StereoRig| stated::scaled(rig, images).map_err(|reason| refuse(option.clone(), reason));
                (self.rig, self.other_lens) = (scale(&self.rig)?, self.other_lens.as_ref().map(scale).transpose()?);
                self.notes.push(format!(
                    "the calibration of {}x{} pixels is scaled to the images of {}x{}",
                    size.width, size.height, images.width, images.height
                ));
            }
        }
        if stated.rectified || self.rig.left().size() != made_for {
            // Its numbers are those of the cameras as calibrated.
            self.judgement.iter_mut().for_each(|judgement| judgement.covariance = None);
        }
        Ok(self)
    }
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
    load_stated(paths, None, &StatedCalibration::default())?.decided()
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

/// As [`load_stereo`], for images of a known size, which is used for files that may omit the size (OpenCV), or that state a part of the
/// sensor (ROS). The size of any other file is not compared with it.
///
/// # Errors
/// As [`load_stereo`].
pub fn load_stereo_for(paths: &[PathBuf], images: ImageSize) -> Result<StereoCalibration, CalibrationFileError> {
    load_stated(paths, Some(images), &StatedCalibration::default())?.decided()
}

/// As [`load_stereo_for`], with what the user states. [`StereoCalibration::other_lens`] is left to be decided.
///
/// # Errors
/// As [`load_stereo`]; the user and the file state different things.
pub fn load_stated(
    paths: &[PathBuf],
    images: Option<ImageSize>,
    stated: &StatedCalibration,
) -> Result<StereoCalibration, CalibrationFileError> {
    let paths = match paths {
        [directory] if directory.is_dir() => in_directory(directory)?,
        paths => paths.to_vec(),
    };
    let documents = paths.iter().map(|path| Document::read(path)).collect::<Result<Vec<_>, _>>()?;
    assemble(&paths, &documents, images, stated)
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
    assemble(&[name.to_path_buf()], &[Document::parse(name, text)?], images, &StatedCalibration::default())?.decided()
}

/// As [`load_stereo_for`], for the texts of the left and the right ROS `camera_info` file; `names` stand for the files in messages.
///
/// # Errors
/// As [`load_stereo`].
pub fn parse_ros_pair(
    names: [&Path; 2],
    texts: [&str; 2],
    images: Option<ImageSize>,
) -> Result<StereoCalibration, CalibrationFileError> {
    let documents = [Document::parse(names[0], texts[0])?, Document::parse(names[1], texts[1])?];
    assemble(&names.map(Path::to_path_buf), &documents, images, &StatedCalibration::default())
}

/// As [`load_stereo`], for the texts of `sensor.yaml` of `cam0` and `cam1` in the layout of the EuRoC dataset.
///
/// # Errors
/// As [`load_stereo`].
pub fn parse_euroc(names: [&Path; 2], texts: [&str; 2]) -> Result<StereoCalibration, CalibrationFileError> {
    let [left, right] = [Document::parse(names[0], texts[0])?, Document::parse(names[1], texts[1])?];
    Ok(StereoCalibration {
        rig: euroc::read(&left.root(), &right.root())?,
        other_lens: None,
        format: CalibrationFormat::EurocPair,
        source: names.map(|name| name.display().to_string()).join(", "),
        notes: Vec::new(),
        warnings: Vec::new(),
        not_measured: None,
        judgement: None,
    })
}

fn assemble(
    paths: &[PathBuf],
    documents: &[Document],
    images: Option<ImageSize>,
    stated: &StatedCalibration,
) -> Result<StereoCalibration, CalibrationFileError> {
    let made_for = stated.size.or(images);
    let Parsed { rig, other_lens, format, remarks: Remarks { notes, warnings }, judgement } = match documents {
        [one] => read_one(one, made_for, stated)?,
        [first, second] => read_two(first, second, made_for, stated)?,
        _ => return Err(CalibrationFileError::Paths { count: paths.len() }),
    };
    let source = paths.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ");
    let not_measured = match (documents, format) {
        ([one], CalibrationFormat::CaseJson) => case_json::not_measured(&one.root()),
        _ => None,
    };
    StereoCalibration { rig, other_lens, format, source, notes, warnings, not_measured, judgement }
        .as_stated(stated, images)
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
    other_lens: Option<StereoRig>,
    format: CalibrationFormat,
    remarks: Remarks,
    judgement: Option<Judgement>,
}

/// What the user should know of a calibration.
#[derive(Default)]
struct Remarks {
    notes: Vec<String>,
    /// Assumptions that can be wrong.
    warnings: Vec<String>,
}

impl Remarks {
    fn notes(notes: Vec<String>) -> Self {
        Self { notes, ..Self::default() }
    }
}

impl Parsed {
    fn of(format: CalibrationFormat, rig: StereoRig) -> Self {
        Self { rig, other_lens: None, format, remarks: Remarks::default(), judgement: None }
    }
}

fn of_opencv(
    roots: &[Node<'_>],
    images: Option<ImageSize>,
    stated: &StatedCalibration,
) -> Result<Parsed, CalibrationFileError> {
    let opencv::OpenCvRig { rig, other_lens, remarks } = opencv::read(roots, images, stated)?;
    Ok(Parsed { remarks, other_lens, ..Parsed::of(CalibrationFormat::OpenCv, rig) })
}

fn read_one(
    document: &Document,
    images: Option<ImageSize>,
    stated: &StatedCalibration,
) -> Result<Parsed, CalibrationFileError> {
    let root = document.root();
    if judged::recognises(&root) {
        let (rig, judgement) = judged::read(&root)?;
        let note = |gate: &JudgedGate| {
            format!("gate {} refused this calibration when it was made: measured {}", gate.name, gate.measured)
        };
        let remarks = Remarks::notes(judgement.refusals().map(note).collect());
        Ok(Parsed { remarks, judgement: Some(judgement), ..Parsed::of(CalibrationFormat::Judged, rig) })
    } else if case_json::recognises(&root) {
        Ok(Parsed::of(CalibrationFormat::CaseJson, case_json::read(&root)?))
    } else if kalibr::recognises(&root) {
        Ok(Parsed::of(CalibrationFormat::Kalibr, kalibr::read(&root)?))
    } else if opencv::recognises(&root) {
        of_opencv(&[root], images, stated)
    } else if ros::recognises(&root) {
        Err(root
            .error("camera_matrix", "this is one camera of a ROS camera_info pair; give the left and the right file"))
    } else {
        Err(CalibrationFileError::Format { file: document.file().to_path_buf(), found: document.keys() })
    }
}

fn read_two(
    first: &Document,
    second: &Document,
    images: Option<ImageSize>,
    stated: &StatedCalibration,
) -> Result<Parsed, CalibrationFileError> {
    let (one, two) = (first.root(), second.root());
    if ros::recognises(&one) && ros::recognises(&two) {
        let (rig, remarks) = ros::read(&one, &two, (images, stated.rectified))?;
        Ok(Parsed { remarks, ..Parsed::of(CalibrationFormat::RosPair, rig) })
    } else if opencv::recognises(&one) || opencv::recognises(&two) {
        of_opencv(&[one, two], images, stated)
    } else {
        let stranger = if ros::recognises(&one) { second } else { first };
        Err(CalibrationFileError::Format { file: stranger.file().to_path_buf(), found: stranger.keys() })
    }
}

fn in_directory(directory: &Path) -> Result<Vec<PathBuf>, CalibrationFileError> {
    let candidates = IN_DIRECTORY.iter().map(|names| names.iter().map(|name| directory.join(name)).collect::<Vec<_>>());
    let found = candidates.into_iter().find(|files| files.iter().any(|file| file.exists()));
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
