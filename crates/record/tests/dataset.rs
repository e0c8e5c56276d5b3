//! The dataset format from outside: test data of the repository, and output of the writers. The schema has its tests in
//! `tests/python/test_dataset_schema.py`.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests may fail the test")]

use std::path::{Path, PathBuf};

use image::{Rgb, RgbImage};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use pb3dp_geometry::frames::{CamLeft, Model};
use pb3dp_geometry::{Camera, Distortion, ImageSize, MonotonicTime, Pinhole, Pose, StereoRig};
use pb3dp_record::dataset::{
    CaseDraft, DatasetError, Hardness, PlaneTruth, SearchRange, Sequence, SequenceDraft, SequenceWriter, WrittenFrame,
    find_cases, load_case, load_sequence, write_case,
};
use pb3dp_record::images::{ImageProblem, StoredFormat};
use pb3dp_record::metrics::plane::disparity_plane;
use pb3dp_record::metrics::{Group, PlaneEstimate};
use serde_json::Value;

fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

fn json_file(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn the_test_data_load() {
    let folders = find_cases(&repository().join("tests/data/cases")).unwrap();
    assert_eq!(folders.len(), 4);
    for folder in folders {
        let case = load_case(&folder).unwrap();
        assert_eq!(case.other_keys, [""; 0]);
        assert_eq!(Group::of(&case), Group::Boards);
        let images = case.load_images().unwrap();
        assert_eq!(images.left.dimensions(), (640, 480));
        assert_ne!(images.left, images.right);
        let rig = case.load_calibration().unwrap().rig;
        assert!(rig.is_rectified() && (rig.baseline_m() - 0.120_376_75).abs() < 1e-8);
        check_truth_is_consistent(&case.truth.unwrap(), case.region_centroid_px.unwrap(), &rig);
    }
}

/// The ground truth gives one plane three times: as normal and depth, as normal and distance, and as disparities.
fn check_truth_is_consistent(truth: &PlaneTruth, centroid_px: [f64; 2], rig: &StereoRig) {
    let ray = rig.left().unproject(&Vector2::from(centroid_px)).unwrap();
    let h_m = -truth.normal_in_cam_left.dot(&ray) * truth.z_m;
    assert!((h_m - truth.h_m.unwrap()).abs() < 1e-6, "{h_m}");
    let estimate = PlaneEstimate { z_m: truth.z_m, normal_in_cam_left: truth.normal_in_cam_left };
    let found = disparity_plane(&estimate, centroid_px, rig).unwrap();
    for (found, expected) in found.into_iter().zip(truth.disparity_plane.unwrap()) {
        assert!((found - expected).abs() < 1e-3 * expected.abs().max(0.1), "{found} is not {expected}");
    }
}

fn search() -> SearchRange {
    SearchRange { z_min_m: 0.35, z_max_m: 0.8, tilt_max_rad: 0.75 }
}

fn rig() -> StereoRig {
    let camera = |fx, cx, k1| {
        let size = ImageSize { width: 32, height: 24 };
        let pinhole = Pinhole { fx, fy: fx + 0.5, cx, cy: 11.25 };
        Camera::new(size, pinhole, Distortion::BrownConrady5 { coefficients: [k1, 0.02, 1e-3, -2e-3, 0.1] }).unwrap()
    };
    let turn = UnitQuaternion::from_euler_angles(0.01, -0.02, 0.03);
    let pose = Pose::from_parts(Vector3::new(-0.1, 0.002, -0.003), turn);
    StereoRig::new(camera(40.0, 15.5, -0.1), camera(41.0, 16.0, -0.2), pose).unwrap()
}

fn image(seed: u8) -> RgbImage {
    RgbImage::from_fn(32, 24, |u, v| Rgb([seed, (7 * u) as u8, (9 * v) as u8]))
}

fn same_rig(a: &StereoRig, b: &StereoRig) {
    assert_eq!((a.left(), a.right()), (b.left(), b.right()));
    let difference = a.cam_right_from_cam_left().to_homogeneous() - b.cam_right_from_cam_left().to_homogeneous();
    assert!(difference.amax() < 1e-12, "{difference}");
}

#[test]
fn a_written_case_is_read_back() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("new/case");
    let truth = PlaneTruth {
        m_per_px_disparity: Some(0.002),
        how: Some("made \"up\"".into()),
        ..PlaneTruth::exact(Vector3::new(0.05, -0.02, 0.6), Vector3::new(0.2, -0.3, 0.9))
    };
    let draft = CaseDraft {
        name: "made".into(),
        region_polygon_left_px: vec![[1.5, 2.0], [20.0, 3.0], [18.0, 20.25]],
        region_centroid_px: Some([13.0, 8.5]),
        search: search(),
        planar: false,
        hard: Some(Hardness::LowTexture),
        truth: Some(truth.clone()),
    };
    write_case(&folder, &draft, &rig(), &image(1), &image(2)).unwrap();
    // The Python tests check this file against the schema.
    let expected = json_file(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/written_case.json"));
    assert_eq!(json_file(&folder.join("case.json")), expected);
    let case = load_case(&folder).unwrap();
    assert_eq!((case.name.as_str(), case.planar, case.hard), ("made", false, Some(Hardness::LowTexture)));
    assert_eq!(case.region_polygon_left_px, draft.region_polygon_left_px);
    assert!((case.search.z_max_m - 0.8).abs() < 1e-12 && (case.search.tilt_max_rad - 0.75).abs() < 1e-12);
    let read = case.truth.as_ref().unwrap();
    assert!((read.normal_in_cam_left - truth.normal_in_cam_left).norm() < 1e-12);
    assert!((read.h_m.unwrap() - truth.h_m.unwrap()).abs() < 1e-12);
    assert_eq!(read.how, truth.how);
    let images = case.load_images().unwrap();
    assert_eq!((images.left, images.right), (image(1), image(2)));
    same_rig(&case.load_calibration().unwrap().rig, &rig());
    let again = write_case(&folder, &draft, &rig(), &image(1), &image(2)).unwrap_err();
    assert!(matches!(again, DatasetError::Exists { .. }), "{again}");
}

fn pose(i: u64) -> Pose<CamLeft, Model> {
    let s = i as f64;
    let turn = UnitQuaternion::from_euler_angles(0.1 * s, 0.2, -0.3);
    Pose::from_parts(Vector3::new(0.01 * s, -0.02, 0.5 + 0.003 * s), turn)
}

fn draft(images: StoredFormat) -> SequenceDraft {
    SequenceDraft { region_polygon_left_px: vec![[1.0, 2.0], [20.0, 3.0], [18.0, 20.0]], search: search(), images }
}

fn frame<'a>([left, right]: [&'a RgbImage; 2], at_nanos: u64, skew_nanos: i64) -> WrittenFrame<'a> {
    let exposed_at = MonotonicTime::from_nanos(at_nanos);
    WrittenFrame { left, right, exposed_at, skew_nanos, cam_left_from_model: None }
}

/// A frame with its true pose.
fn posed(i: u64, [left, right]: &[RgbImage; 2]) -> WrittenFrame<'_> {
    let frame = frame([left, right], 5_000_000_000 + 33_333_333 * i, -250_000);
    WrittenFrame { cam_left_from_model: Some(pose(i)), ..frame }
}

fn recorded(folder: &Path, images: StoredFormat) -> DatasetResult {
    let mut writer = SequenceWriter::create(folder, &rig(), draft(images))?;
    for i in 0..3 {
        writer.push(posed(i, &[image(10 * i as u8), image(10 * i as u8 + 1)]))?;
    }
    Ok(writer.finish()?.frames)
}

type DatasetResult = Result<u64, DatasetError>;

#[test]
fn a_recorded_sequence_is_read_back() {
    let dir = tempfile::tempdir().unwrap();
    assert_eq!(recorded(dir.path(), StoredFormat::Png).unwrap(), 3);
    let sequence = load_sequence(dir.path()).unwrap();
    assert_eq!(load_sequence(&dir.path().join("sequence.json")).unwrap(), sequence);
    let times_nanos: Vec<_> = sequence.times_s.iter().map(|t| MonotonicTime::from_secs_f64(*t).as_nanos()).collect();
    assert_eq!(times_nanos, [5_000_000_000, 5_033_333_333, 5_066_666_666]);
    assert_eq!(sequence.skew_s, [-0.000_25; 3]);
    same_rig(&sequence.load_calibration().unwrap().rig, &rig());
    let size = ImageSize { width: 32, height: 24 };
    let images = sequence.load_images(2, size).unwrap();
    assert_eq!((images.left, images.right), (image(20), image(21)));
    for (i, read) in (0..).zip(sequence.cam_left_from_model.as_ref().unwrap()) {
        assert!((read.to_homogeneous() - pose(i).to_homogeneous()).amax() < 1e-12);
    }
    let again = recorded(dir.path(), StoredFormat::Png).unwrap_err();
    assert!(matches!(again, DatasetError::Exists { .. }), "{again}");
}

#[test]
fn a_frame_that_does_not_fit_is_refused_and_leaves_the_recording_usable() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SequenceWriter::create(dir.path(), &rig(), draft(StoredFormat::Jpeg { quality: 90 })).unwrap();
    let (whole, small) = (image(1), RgbImage::new(8, 8));
    let frame = |right, at, cam_left_from_model| WrittenFrame { cam_left_from_model, ..frame([&whole, right], at, 0) };
    writer.push(frame(&whole, 100, None)).unwrap();
    let mut check = |frame, part: &str| {
        let message = writer.push(frame).unwrap_err().to_string();
        assert!(message.contains("frame 1") && message.contains(part), "{message}");
    };
    check(frame(&whole, 100, None), "later");
    check(frame(&small, 200, None), "right image has 8x8");
    check(frame(&whole, 200, Some(pose(0))), "all frames or in none");
    writer.push(frame(&whole, 200, None)).unwrap();
    assert_eq!(writer.finish().unwrap().frames, 2);
    let sequence = load_sequence(dir.path()).unwrap();
    assert!(sequence.cam_left_from_model.is_none() && sequence.skew_s.is_empty());
    assert!(sequence.image_files(1).0.ends_with("left_0001.jpg"));
    assert!(sequence.load_images(1, ImageSize { width: 32, height: 24 }).is_ok());
}

#[test]
fn frames_written_by_others_count_as_far_as_they_are_kept() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SequenceWriter::create(dir.path(), &rig(), draft(StoredFormat::Png)).unwrap();
    let mut files = Vec::new();
    for i in 0..4 {
        let (left, right) = (image(i), image(100 + i));
        files.push(writer.accept(&frame([&left, &right], 33_000_000 * (1 + u64::from(i)), -250_000)).unwrap());
        files[usize::from(i)].save(&left, &right).unwrap();
    }
    // Simulates that the third image could not be written.
    writer.keep(2);
    assert_eq!((writer.frames(), writer.finish().unwrap().frames), (2, 2));
    assert!(files[1].right.exists() && !files[2].left.exists() && !files[3].right.exists());
    let sequence = load_sequence(dir.path()).unwrap();
    assert_eq!((sequence.frames(), sequence.skew_s.as_slice()), (2, [-0.000_25; 2].as_slice()));
    let images = sequence.load_images(1, ImageSize { width: 32, height: 24 }).unwrap();
    assert_eq!((images.left, images.right), (image(1), image(101)));
}

/// An unfinished recording with some frames, after `fate` has modified its folder.
fn broken_off(frames: u8, fate: impl FnOnce(&Path)) -> Result<Sequence, DatasetError> {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SequenceWriter::create(dir.path(), &rig(), draft(StoredFormat::Png)).unwrap();
    for i in 0..frames {
        writer.push(posed(u64::from(i), &[image(i), image(100 + i)])).unwrap();
    }
    drop(writer);
    fate(dir.path());
    load_sequence(dir.path())
}

#[test]
fn what_was_recorded_until_a_program_was_killed_can_be_read() {
    let whole = broken_off(3, |folder| {
        assert!(!folder.join("sequence.json").exists());
        // No other recording overwrites it.
        let again = SequenceWriter::create(folder, &rig(), draft(StoredFormat::Png)).unwrap_err();
        assert!(matches!(again, DatasetError::Exists { .. }), "{again}");
        let sequence = load_sequence(folder).unwrap();
        let images = sequence.load_images(2, ImageSize { width: 32, height: 24 }).unwrap();
        assert_eq!((images.left, images.right), (image(2), image(102)));
        assert_eq!(load_sequence(&folder.join("sequence.unfinished.jsonl")).unwrap(), sequence);
    });
    let whole = whole.unwrap();
    assert!(whole.is_unfinished);
    assert_eq!((whole.frames(), whole.skew_s.as_slice()), (3, [-0.000_25; 3].as_slice()));
    let poses = whole.cam_left_from_model.unwrap();
    assert!((poses[2].to_homogeneous() - pose(2).to_homogeneous()).amax() < 1e-12);
    let frames = |fate: fn(&Path)| broken_off(4, fate).unwrap().frames();
    // Killed within an image, before an image, and within a line of the log.
    let cut = |name: &str, folder: &Path, bytes: u64| {
        let file = std::fs::OpenOptions::new().write(true).open(folder.join(name)).unwrap();
        file.set_len(file.metadata().unwrap().len() - bytes).unwrap();
    };
    let cut = &cut;
    assert_eq!(broken_off(4, |folder| cut("right_0003.png", folder, 7)).unwrap().frames(), 3);
    assert_eq!(frames(|folder| std::fs::remove_file(folder.join("left_0003.png")).unwrap()), 3);
    assert_eq!(broken_off(4, |folder| cut("sequence.unfinished.jsonl", folder, 9)).unwrap().frames(), 3);
    // A damaged frame in the middle costs only this frame.
    assert_eq!(frames(|folder| std::fs::remove_file(folder.join("left_0001.png")).unwrap()), 4);
    // Not even the first frame is complete.
    let none = broken_off(1, |folder| std::fs::remove_file(folder.join("left_0000.png")).unwrap()).unwrap_err();
    assert!(none.to_string().contains("sequence.unfinished.jsonl") && none.to_string().contains("`frames`"), "{none}");
    // A recording without frames does not block the next one.
    let dir = tempfile::tempdir().unwrap();
    drop(SequenceWriter::create(dir.path(), &rig(), draft(StoredFormat::Png)).unwrap());
    assert_eq!(recorded(dir.path(), StoredFormat::Png).unwrap(), 3);
    assert!(!dir.path().join("sequence.unfinished.jsonl").exists());
}

#[test]
fn an_image_that_can_not_be_written_is_not_counted() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = SequenceWriter::create(dir.path(), &rig(), draft(StoredFormat::Png)).unwrap();
    let image = image(1);
    let frame = |at| frame([&image, &image], at, 0);
    writer.push(frame(1)).unwrap();
    std::fs::create_dir(dir.path().join("right_0001.png")).unwrap();
    let error = writer.push(frame(2)).unwrap_err();
    assert!(error.to_string().contains("right_0001.png") && !error.is_disk_full(), "{error}");
    assert!(!dir.path().join("left_0001.png").exists(), "an incomplete frame is removed");
    std::fs::remove_dir(dir.path().join("right_0001.png")).unwrap();
    writer.push(frame(2)).unwrap();
    assert_eq!(writer.finish().unwrap().frames, 2);
}

#[test]
fn a_bad_image_costs_its_own_frame_only() {
    let dir = tempfile::tempdir().unwrap();
    recorded(dir.path(), StoredFormat::Png).unwrap();
    let sequence = load_sequence(dir.path()).unwrap();
    std::fs::write(dir.path().join("right_0001.png"), b"\x89PNG\r\n\x1a\n cut").unwrap();
    let size = ImageSize { width: 32, height: 24 };
    match sequence.load_images(1, size).unwrap_err() {
        DatasetError::Image(error) => {
            assert_eq!(error.problem, ImageProblem::Damaged);
            assert!(error.file.ends_with("right_0001.png"));
        }
        other => panic!("{other}"),
    }
    assert!(sequence.load_images(0, size).is_ok() && sequence.load_images(2, size).is_ok());
    let message = sequence.load_images(0, ImageSize { width: 640, height: 480 }).unwrap_err().to_string();
    assert!(message.contains("left_0000.png") && message.contains("32x24") && message.contains("calib.json"));
}
