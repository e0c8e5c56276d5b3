//! Errors of calibration files.

use std::path::PathBuf;

/// Why a calibration could not be read or written. `Display` includes file, key and reason.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationFileError {
    /// A file could not be read.
    #[error("{}: cannot be read: {reason}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// The system error.
        reason: String,
    },
    /// The file is not text, but an image, for example.
    #[error("{}: is not text, so not a calibration; give a YAML or JSON file", file.display())]
    NoText {
        /// The file.
        file: PathBuf,
    },
    /// A file could not be written.
    #[error("{}: cannot be written: {reason}", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The system error, on one line.
        reason: String,
        /// The system error.
        #[source]
        source: std::io::Error,
    },
    /// A file is not YAML, JSON or TOML.
    #[error("{}, line {line}: not valid {language}, the format expected for this file: {reason}", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: u64,
        /// `YAML`, `JSON` or `TOML`.
        language: &'static str,
        /// The message of the parser.
        reason: String,
    },
    /// A value is missing or wrong.
    #[error("{}: {key}: {reason}", file.display())]
    Key {
        /// The file.
        file: PathBuf,
        /// The key, with its parents, joined by dots.
        key: String,
        /// What is wrong with the value, and what would be correct.
        reason: String,
    },
    /// The format of the file is unknown.
    #[error(
        "{}: not a stereo calibration in a known format (top-level keys: {found}); accepted are a pair of ROS camera_info YAML files (camera_matrix, projection_matrix), a Kalibr camchain (cam0, cam1), an OpenCV stereo YAML (M1, D1, M2, D2, R, T), calib.json (K_left, K_right, R, t_mm) and a TOML file of pb3dp calibrate (format, left, right, cam_right_from_cam_left)",
        file.display()
    )]
    Format {
        /// The file.
        file: PathBuf,
        /// Its keys.
        found: String,
    },
    /// A directory without a calibration.
    #[error(
        "{}: contains no left.yaml and right.yaml, calib.json, calibration.toml, or intrinsics.yml and extrinsics.yml; give the calibration file itself",
        directory.display()
    )]
    Directory {
        /// The directory.
        directory: PathBuf,
    },
    /// Too few or too many files.
    #[error("{count} calibration files were given; give one file, a left and a right file, or a directory")]
    Paths {
        /// How many.
        count: usize,
    },
    /// The user states something else than the file.
    #[error("{source_files}: {option}: {reason}")]
    Stated {
        /// The files.
        source_files: String,
        /// The option, with its value.
        option: String,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// A rig that a format cannot represent.
    #[error("{format} cannot hold this calibration: {reason}")]
    NotRepresentable {
        /// The format.
        format: super::CalibrationFormat,
        /// The missing feature of the format.
        reason: String,
    },
}

/// An error and its causes on one line.
pub(super) fn one_line(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text = format!("{text}: {error}");
        cause = error.source();
    }
    text
}
