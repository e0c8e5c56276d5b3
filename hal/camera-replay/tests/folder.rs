//! The pairs of plain folders of images, by the names of the files.

#![allow(clippy::unwrap_used, reason = "helpers of tests may fail the test")]

use std::error::Error as _;
use std::path::{Path, PathBuf};

use pb3dp_camera_recordings::{RecordedPairs, RecordingOptions};
use pb3dp_hal_api::CameraError;

fn open(folder: &Path) -> Result<RecordedPairs, CameraError> {
    RecordedPairs::open(folder, &RecordingOptions::default())
}

/// The pairs of a folder with these files, which are empty; the cause if it has none.
fn pairs_of(files: &[&str]) -> Result<Vec<(String, String)>, String> {
    let dir = tempfile::tempdir().unwrap();
    for file in files {
        let path = dir.path().join(file);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, "").unwrap();
    }
    let relative = |path: PathBuf| path.strip_prefix(dir.path()).unwrap().to_string_lossy().into_owned();
    let pairs = open(dir.path()).map_err(|error| error.source().unwrap().to_string())?.files().unwrap();
    Ok(pairs.into_iter().map(|[left, right]| (relative(left), relative(right))).collect())
}

fn check(files: &[&str], expected: &[(&str, &str)]) {
    let expected: Vec<_> = expected.iter().map(|(l, r)| (l.to_string(), r.to_string())).collect();
    assert_eq!(pairs_of(files).unwrap(), expected);
}

#[test]
fn names_are_ordered_by_the_value_of_their_numbers() {
    check(
        &["left_10.png", "left_9.png", "right_9.png", "right_10.png", "calib.json", "notes.txt", "leftover.txt"],
        &[("left_9.png", "right_9.png"), ("left_10.png", "right_10.png")],
    );
    check(
        &["left/b002.JPG", "left/b1.jpg", "right/b1.png", "right/b002.jpg"],
        &[("left/b1.jpg", "right/b1.png"), ("left/b002.JPG", "right/b002.jpg")],
    );
    check(&["left.png", "right.jpeg"], &[("left.png", "right.jpeg")]);
}

#[test]
fn an_image_without_partner_keeps_its_turn() {
    check(
        &["left_1.png", "right_1.png", "right_2.jpg", "left_3.png", "right_3.png"],
        &[("left_1.png", "right_1.png"), ("left_2.jpg", "right_2.jpg"), ("left_3.png", "right_3.png")],
    );
    check(&["left/a.v2.png", "right/b.png"], &[("left/a.v2.png", "right/a.v2.png"), ("left/b.png", "right/b.png")]);
}

#[test]
fn ambiguous_and_empty_folders_are_refused() {
    let refused = |files: &[&str], part: &str| {
        let message = pairs_of(files).unwrap_err();
        assert!(message.contains(part), "{message}");
    };
    refused(&["photo.png"], "no images left_*.png");
    refused(&["left_1.png", "left_1.jpg", "right_1.png"], "same image twice");
    refused(&["left_1.png", "right_1.png", "left/1.png"], "keep one of the two");
    let error = open(Path::new("/nonexistent/folder")).unwrap_err();
    assert!(error.to_string().contains("/nonexistent/folder"));
}
