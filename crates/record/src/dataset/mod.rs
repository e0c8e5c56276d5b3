//! The dataset format: case folders (one stereo pair with a region and optional ground truth) and sequence folders.
//!
//! `docs/dataset-format.md` describes the files and `docs/dataset.schema.json` is their JSON schema. Files hold millimetres and
//! degrees; everything here is metres and radians. Relative paths are relative to the folder of the JSON file. Keys that are not
//! part of the format are tolerated and listed in `other_keys`, so that a program can report misspelt keys.

mod case;
mod json;
mod sequence;
mod unfinished;
mod writer;

use std::collections::{HashSet, VecDeque};
use std::path::{Path, PathBuf};

pub use case::{Case, Hardness, PlaneTruth, StereoImages, load_case};
pub use sequence::{FramePattern, Sequence, is_sequence, load_sequence};
pub use writer::{CaseDraft, FrameFiles, SequenceDraft, SequenceSummary, SequenceWriter, WrittenFrame, write_case};

use crate::calibration_files::CalibrationFileError;
use crate::images::ImageFileError;

/// Name of the file that makes a folder a case.
pub const CASE_FILE: &str = "case.json";
/// Name of the file that makes a folder a sequence.
pub const SEQUENCE_FILE: &str = "sequence.json";
/// Name of the file that replaces it while a recording is not finished.
const UNFINISHED_FILE: &str = "sequence.unfinished.jsonl";
/// Maximum tilt of a search range, degrees; the same as in the estimators.
pub const TILT_LIMIT_DEG: f64 = 85.0;
/// Maximum search depth for cases below the given folder.
const FOLDERS_DEEP: usize = 8;
/// Default name of the calibration file.
pub const CALIBRATION_FILE: &str = "calib.json";

/// Why a case or sequence cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// A file or folder cannot be read or written.
    #[error("cannot {action} {}; check that it exists and its permissions", file.display())]
    Io {
        /// The file or folder.
        file: PathBuf,
        /// `read` or `write`.
        action: &'static str,
        /// The system error.
        #[source]
        source: std::io::Error,
    },
    /// The file is not JSON.
    #[error("{} is not valid JSON; correct the position given in the cause", file.display())]
    Syntax {
        /// The file.
        file: PathBuf,
        /// Line, column and reason.
        #[source]
        source: serde_json::Error,
    },
    /// A required key is absent.
    #[error("{}: key `{key}` is missing; add it (docs/dataset-format.md)", file.display())]
    MissingKey {
        /// The file.
        file: PathBuf,
        /// The whole path of the key, `search.z_min_mm`.
        key: String,
    },
    /// A value is not allowed.
    #[error("{}: key `{key}` is {value}: {expected}", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// The whole path of the key.
        key: String,
        /// The value found, shortened.
        value: String,
        /// What is allowed.
        expected: String,
    },
    /// No case below a folder.
    #[error("no {CASE_FILE} in {} or in the folders below it ({FOLDERS_DEEP} levels); give the folder that contains the cases", folder.display())]
    NoCases {
        /// The folder.
        folder: PathBuf,
    },
    /// A recording would overwrite another one.
    #[error("{} already exists; give an empty folder", file.display())]
    Exists {
        /// The file that already exists.
        file: PathBuf,
    },
    /// An image cannot be used.
    #[error(transparent)]
    Image(#[from] ImageFileError),
    /// A calibration cannot be used.
    #[error(transparent)]
    Calibration(#[from] CalibrationFileError),
    /// A frame does not fit the frames before it.
    #[error("frame {frame} of the recording in {}: {reason}", folder.display())]
    Frame {
        /// Number of the frame, from 0.
        frame: u64,
        /// The recording's folder.
        folder: PathBuf,
        /// The check that failed.
        reason: String,
    },
}

impl DatasetError {
    /// Whether the disk or the user's quota is full.
    pub fn is_disk_full(&self) -> bool {
        match self {
            Self::Io { source, .. } => is_full(source),
            Self::Image(error) => std::error::Error::source(error)
                .and_then(|cause| cause.downcast_ref::<std::io::Error>())
                .is_some_and(is_full),
            _ => false,
        }
    }
}

fn is_full(error: &std::io::Error) -> bool {
    matches!(error.kind(), std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded)
}

/// The search range of a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SearchRange {
    /// Nearest depth in `cam_left`, metres.
    pub z_min_m: f64,
    /// Farthest depth in `cam_left`, metres.
    pub z_max_m: f64,
    /// Largest tilt of the plane about x and about y, radians.
    pub tilt_max_rad: f64,
}

/// Every case folder under `dir`, sorted by path: `dir` itself if it is a case, otherwise the folders with a `case.json` at any
/// depth up to eight levels.
///
/// Cases inside a case are ignored. Hidden folders (name begins with a dot) are skipped. Links to folders are followed; a folder
/// that is reachable by several paths is listed once.
///
/// # Errors
/// A folder that cannot be read, or one without any case.
pub fn find_cases(dir: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let mut cases = Vec::new();
    let mut present = HashSet::new();
    let mut pending = VecDeque::from([(dir.to_owned(), 0)]);
    while let Some((folder, depth)) = pending.pop_front() {
        let unreadable = |source| DatasetError::Io { file: folder.clone(), action: "read", source };
        if !present.insert(folder.canonicalize().map_err(unreadable)?) {
            continue;
        }
        if folder.join(CASE_FILE).exists() {
            cases.push(folder);
        } else if depth < FOLDERS_DEEP {
            for subfolder in subfolders(&folder).map_err(unreadable)? {
                // Links come last: a folder that is also reachable directly is listed by its direct path.
                if subfolder.is_symlink() {
                    pending.push_back((subfolder, depth + 1));
                } else {
                    pending.push_front((subfolder, depth + 1));
                }
            }
        }
    }
    if cases.is_empty() {
        return Err(DatasetError::NoCases { folder: dir.to_owned() });
    }
    cases.sort();
    Ok(cases)
}

/// The folders in a folder that are not hidden, including links to folders, sorted.
fn subfolders(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let is_hidden = entry.file_name().as_encoded_bytes().first() == Some(&b'.');
        if !is_hidden && entry.path().is_dir() {
            found.push(entry.path());
        }
    }
    found.sort();
    Ok(found)
}

/// Reads the polygon of a region; pixels, integer coordinates are pixel centres.
fn polygon(node: &json::Node<'_>) -> Result<Vec<[f64; 2]>, DatasetError> {
    let points = node.items()?.iter().map(json::Node::numbers::<2>).collect::<Result<Vec<_>, _>>()?;
    if points.len() < 3 {
        return Err(node.refuse(format!("must have at least 3 corners [u, v], not {}", points.len())));
    }
    let area = polygon_area_px(&points);
    if area < 1.0 {
        return Err(node.refuse(format!("encloses {area:.2} square pixels, at least 1 is required")));
    }
    Ok(points)
}

/// Area inside a polygon, square pixels.
fn polygon_area_px(points: &[[f64; 2]]) -> f64 {
    let next = points.iter().cycle().skip(1);
    let twice: f64 = points.iter().zip(next).map(|(a, b)| a[0] * b[1] - b[0] * a[1]).sum();
    (0.5 * twice).abs()
}

fn search_range(node: &json::Node<'_>) -> Result<SearchRange, DatasetError> {
    let z_min_mm = node.get("z_min_mm")?.positive()?;
    let z_max = node.get("z_max_mm")?;
    let z_max_mm = z_max.positive()?;
    if z_max_mm <= z_min_mm {
        return Err(z_max.refuse(format!("must be greater than z_min_mm, {z_min_mm}")));
    }
    let tilt = node.get("tilt_max_deg")?;
    let tilt_max_deg = tilt.number()?;
    if !(0.0..=TILT_LIMIT_DEG).contains(&tilt_max_deg) {
        return Err(tilt.refuse(format!("must be between 0 and {TILT_LIMIT_DEG} degrees")));
    }
    Ok(SearchRange { z_min_m: z_min_mm * 1e-3, z_max_m: z_max_mm * 1e-3, tilt_max_rad: tilt_max_deg.to_radians() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_of_a_quad_does_not_depend_on_the_sense() {
        // Trapezium: parallel sides 4 and 2, height 3.
        let points = [[1.0, 1.0], [5.0, 1.0], [4.0, 4.0], [2.0, 4.0]];
        assert!((polygon_area_px(&points) - 9.0).abs() < 1e-12);
        let reversed: Vec<_> = points.into_iter().rev().collect();
        assert!((polygon_area_px(&reversed) - 9.0).abs() < 1e-12);
    }

    /// Creates folders, those with a `+` as cases.
    fn make(dir: &Path, names: &[&str]) {
        for name in names {
            let folder = dir.join(name.trim_start_matches('+'));
            std::fs::create_dir_all(&folder).unwrap();
            if name.starts_with('+') {
                std::fs::write(folder.join(CASE_FILE), "{}").unwrap();
            }
        }
    }

    #[track_caller]
    fn check_found(dir: &Path, expected: &[&str]) {
        let expected: Vec<_> = expected.iter().map(|name| dir.join(name)).collect();
        assert_eq!(find_cases(dir).unwrap(), expected);
    }

    #[test]
    fn cases_are_found_at_any_depth_sorted_and_not_inside_cases() {
        let dir = tempfile::tempdir().unwrap();
        make(dir.path(), &["b", "_scenes/images", "empty"]);
        let error = find_cases(dir.path()).unwrap_err();
        assert!(matches!(error, DatasetError::NoCases { .. }) && error.to_string().contains("8 levels"), "{error}");
        make(dir.path(), &["+b", "+a/z", "+c/deeper/still", "+_scenes/one", "+.hidden/x", "+b/inside", "+a/.trash"]);
        check_found(dir.path(), &["_scenes/one", "a/z", "b", "c/deeper/still"]);
        assert_eq!(find_cases(&dir.path().join("b")).unwrap(), [dir.path().join("b")]);
        assert!(matches!(find_cases(&dir.path().join("none")), Err(DatasetError::Io { .. })));
    }

    #[test]
    fn cases_are_looked_for_eight_levels_down() {
        let dir = tempfile::tempdir().unwrap();
        make(dir.path(), &["+1/2/3/4/5/6/7/8", "+1/2/3/4/5/6/7/x/9"]);
        check_found(dir.path(), &["1/2/3/4/5/6/7/8"]);
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_once_and_never_in_a_circle() {
        use std::os::unix::fs::symlink;
        let (dir, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        make(dir.path(), &["+m/one", "n"]);
        make(elsewhere.path(), &["+two"]);
        symlink(dir.path(), dir.path().join("n/circle")).unwrap();
        symlink(dir.path().join("m/one"), dir.path().join("a")).unwrap();
        symlink(elsewhere.path(), dir.path().join("linked")).unwrap();
        symlink(dir.path().join("gone"), dir.path().join("dangling")).unwrap();
        check_found(dir.path(), &["linked/two", "m/one"]);
    }
}
