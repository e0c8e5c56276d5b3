//! The replay camera with recordings written by the recorder of this repository.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests may fail the test")]

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use image::{Rgb, RgbImage};
use nalgebra::Vector3;
use pb3dp_camera_replay::{Pacing, Recording, RecordingOptions, Repeat, ReplayCamera, ReplayOptions};
use pb3dp_geometry::{Camera, Distortion, ImageSize, MonotonicTime, Pinhole, Pose, StereoRig};
use pb3dp_hal_api::{CameraError, CameraErrorKind, Clock, FramePair, StereoCamera};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_conformance::{CameraExpectations, stereo_camera_suite};
use pb3dp_record::calibration_files::save_json;
use pb3dp_record::dataset::{SearchRange, SequenceDraft, SequenceWriter, WrittenFrame};
use pb3dp_record::images::{StoredFormat, save};

const SECOND: Duration = Duration::from_secs(1);
const SIZE: ImageSize = ImageSize { width: 24, height: 16 };
const PERIOD_NANOS: u64 = 33_000_000;

fn rig() -> StereoRig {
    let camera = |fx, cx| Camera::new(SIZE, Pinhole { fx, fy: fx, cx, cy: 7.5 }, Distortion::None).unwrap();
    StereoRig::new(camera(30.0, 11.5), camera(31.0, 12.0), Pose::from_translation(Vector3::new(-0.1, 0.001, 0.0)))
        .unwrap()
}

fn image(value: u8) -> RgbImage {
    RgbImage::from_fn(SIZE.width, SIZE.height, |u, v| Rgb([value, u as u8, v as u8]))
}

/// Records `frames` pairs, identified by the red channel: 2 i on the left, 2 i + 1 on the right.
fn record(folder: &Path, frames: u8) {
    let draft = SequenceDraft {
        region_polygon_left_px: vec![[2.0, 2.0], [20.0, 2.0], [20.0, 12.0]],
        search: SearchRange { z_min_m: 0.3, z_max_m: 0.9, tilt_max_rad: 0.7 },
        images: StoredFormat::Png,
    };
    let mut writer = SequenceWriter::create(folder, &rig(), draft).unwrap();
    for i in 0..frames {
        let frame = WrittenFrame {
            left: &image(2 * i),
            right: &image(2 * i + 1),
            exposed_at: MonotonicTime::from_nanos(7_000_000_000 + PERIOD_NANOS * u64::from(i)),
            skew_nanos: 1_500,
            cam_left_from_model: None,
        };
        writer.push(frame).unwrap();
    }
    writer.finish().unwrap();
}

fn open(folder: &Path, pacing: Pacing, repeat: Repeat) -> ReplayCamera {
    play(folder, ReplayOptions { pacing, repeat, ..ReplayOptions::default() }).unwrap()
}

fn play(folder: &Path, options: ReplayOptions) -> Result<ReplayCamera, CameraError> {
    Ok(Recording::open(folder, &[], &RecordingOptions::default(), options)?.camera)
}

fn test_case() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases/bb204_c0")
}

#[test]
fn every_kind_of_recording_passes_the_camera_suite() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path(), 6);
    let once = || open(dir.path(), Pacing::Unpaced, Repeat::Once);
    stereo_camera_suite(once, &CameraExpectations::recording_of(6)).assert_passed();
    let forever = || open(dir.path(), Pacing::Unpaced, Repeat::Forever);
    stereo_camera_suite(forever, &CameraExpectations { repeatable: true, ..CameraExpectations::endless(15) })
        .assert_passed();
    let paced = || open(dir.path(), Pacing::Original(Arc::new(VirtualClock::new())), Repeat::Once);
    stereo_camera_suite(paced, &CameraExpectations::recording_of(6)).assert_passed();
    let case = || open(&test_case(), Pacing::Unpaced, Repeat::Once);
    stereo_camera_suite(case, &CameraExpectations::recording_of(1)).assert_passed();
    std::fs::remove_file(dir.path().join("right_0002.png")).unwrap();
    std::fs::write(dir.path().join("left_0005.png"), "").unwrap();
    let damaged = CameraExpectations { bad_pairs: 2, ..CameraExpectations::recording_of(4) };
    stereo_camera_suite(once, &damaged).assert_passed();
}

#[test]
fn pairs_carry_their_images_times_and_skew() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path(), 3);
    let mut camera = open(dir.path(), Pacing::Unpaced, Repeat::Forever);
    assert_eq!(camera.info().period, Some(Duration::from_nanos(PERIOD_NANOS)));
    assert_eq!((camera.pairs(), camera.rig().left().size()), (3, SIZE));
    for i in 0..8_u64 {
        let pair = camera.next_pair(SECOND).unwrap();
        let frame = (i % 3) as u8;
        assert_eq!((&pair.left, &pair.right), (&image(2 * frame), &image(2 * frame + 1)));
        assert_eq!((pair.sequence, pair.skew_nanos), (i, 1_500));
        // The rounds follow each other with the same period.
        assert_eq!(pair.exposed_at.as_nanos(), 7_000_000_000 + PERIOD_NANOS * i);
    }
}

#[test]
fn a_bad_pair_is_named_and_the_next_call_goes_on_behind_it() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path(), 5);
    let file = |name: &str| dir.path().join(name);
    let whole = std::fs::read(file("left_0001.png")).unwrap();
    std::fs::write(file("left_0001.png"), &whole[..whole.len() / 2]).unwrap();
    std::fs::remove_file(file("right_0002.png")).unwrap();
    save(&RgbImage::new(8, 8), &file("right_0003.png"), StoredFormat::Png).unwrap();
    let mut camera = open(dir.path(), Pacing::Unpaced, Repeat::Once);
    let check_bad = |camera: &mut ReplayCamera, name: &str, reason: &str| {
        let error = camera.next_pair(SECOND).unwrap_err();
        assert_eq!(error.kind(), CameraErrorKind::BadPair);
        assert!(error.to_string().contains(name), "{error}");
        let cause = std::error::Error::source(&error).unwrap().to_string();
        assert!(cause.contains(name) && cause.contains(reason), "{cause}");
    };
    assert_eq!(camera.next_pair(SECOND).unwrap().sequence, 0);
    check_bad(&mut camera, "left_0001.png", "truncated");
    check_bad(&mut camera, "right_0002.png", "no such file");
    check_bad(&mut camera, "right_0003.png", "8x8");
    assert_eq!(camera.next_pair(SECOND).unwrap().sequence, 4);
    for _ in 0..2 {
        assert_eq!(camera.next_pair(SECOND).unwrap_err().kind(), CameraErrorKind::EndOfStream);
    }
}

#[test]
fn original_timing_waits_on_the_clock_and_times_out_by_it() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path(), 4);
    let clock = Arc::new(VirtualClock::new());
    clock.sleep_until(MonotonicTime::from_nanos(500_000_000));
    let mut camera = open(dir.path(), Pacing::Original(clock.clone()), Repeat::Once);
    let first = camera.next_pair(SECOND).unwrap();
    assert_eq!(first.exposed_at.as_nanos(), 500_000_000);
    // With a timeout that is too short the clock advances by the timeout, and the pair stays pending.
    let error = camera.next_pair(Duration::from_millis(20)).unwrap_err();
    assert_eq!((error.kind(), clock.now().as_nanos()), (CameraErrorKind::Timeout, 520_000_000));
    let second = camera.next_pair(Duration::from_millis(20)).unwrap();
    assert_eq!((second.sequence, second.exposed_at.as_nanos()), (1, 533_000_000));
    assert_eq!(clock.now().as_nanos(), 533_000_000);
    // A late caller gets every pair, with its due time.
    clock.sleep_until(MonotonicTime::from_nanos(900_000_000));
    let late = camera.next_pair(SECOND).unwrap();
    assert_eq!((late.sequence, late.exposed_at.as_nanos()), (2, 566_000_000));
    assert_eq!(clock.now().as_nanos(), 900_000_000);
}

#[test]
fn a_live_replay_passes_over_what_a_slow_caller_missed() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path(), 4);
    let clock = Arc::new(VirtualClock::new());
    let mut camera = open(dir.path(), Pacing::Live(clock.clone()), Repeat::Forever);
    let mut next = || {
        let pair = camera.next_pair(SECOND).unwrap();
        assert_eq!(pair.left, image(2 * (pair.sequence % 4) as u8));
        (pair.sequence, pair.exposed_at.as_nanos())
    };
    assert_eq!(next(), (0, 0));
    clock.sleep_until(MonotonicTime::from_nanos(2 * PERIOD_NANOS - 1));
    assert_eq!(next(), (1, PERIOD_NANOS), "the newest is not missed");
    clock.sleep_until(MonotonicTime::from_nanos(7 * PERIOD_NANOS + 5));
    assert_eq!(next(), (7, 7 * PERIOD_NANOS), "in the second round");
    assert_eq!(next(), (8, 8 * PERIOD_NANOS), "a caller in time gets every pair");
    assert_eq!(clock.now().as_nanos(), 8 * PERIOD_NANOS);

    let clock = Arc::new(VirtualClock::new());
    let mut once = open(dir.path(), Pacing::Live(clock.clone()), Repeat::Once);
    assert_eq!(once.next_pair(SECOND).unwrap().sequence, 0);
    clock.sleep_until(MonotonicTime::from_nanos(900 * PERIOD_NANOS));
    assert_eq!(once.next_pair(SECOND).unwrap().sequence, 3, "the last pair is never missed");
    assert_eq!(once.next_pair(SECOND).unwrap_err().kind(), CameraErrorKind::EndOfStream);
}

#[test]
fn a_plain_folder_needs_a_calibration_and_keeps_the_period_it_is_given() {
    let dir = tempfile::tempdir().unwrap();
    for i in 0..3_u8 {
        save(&image(2 * i), &dir.path().join(format!("left_{i}.png")), StoredFormat::Png).unwrap();
        save(&image(2 * i + 1), &dir.path().join(format!("right_{i}.png")), StoredFormat::Png).unwrap();
    }
    let options = || ReplayOptions { period: Duration::from_millis(50), ..ReplayOptions::default() };
    let error = play(dir.path(), options()).unwrap_err();
    assert_eq!(error.kind(), CameraErrorKind::Unusable);
    assert!(error.to_string().contains("calib.json"), "{error}");
    save_json(&rig(), &dir.path().join("calib.json")).unwrap();
    stereo_camera_suite(|| play(dir.path(), options()).unwrap(), &CameraExpectations::recording_of(3)).assert_passed();
    let mut camera = play(dir.path(), options()).unwrap();
    let mut pair = FramePair::black(SIZE);
    let times: Vec<_> = (0..3)
        .map(|_| {
            camera.next_pair_into(&mut pair, SECOND).unwrap();
            pair.exposed_at.as_nanos()
        })
        .collect();
    assert_eq!(times, [0, 50_000_000, 100_000_000]);
    let zero = ReplayOptions { period: Duration::ZERO, ..ReplayOptions::default() };
    assert_eq!(play(dir.path(), zero).unwrap_err().kind(), CameraErrorKind::Unusable);
}

#[test]
fn irregular_recordings_state_no_period() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path(), 4);
    let file = dir.path().join("sequence.json");
    let text = std::fs::read_to_string(&file).unwrap();
    let start = text.find("\"times_s\"").unwrap();
    let end = start + text[start..].find(']').unwrap();
    let irregular = format!("{}\"times_s\": [-1.0, 0.0, 0.1, 0.5{}", &text[..start], &text[end..]);
    std::fs::write(&file, irregular).unwrap();
    let mut camera = open(dir.path(), Pacing::Unpaced, Repeat::Forever);
    assert_eq!(camera.info().period, None);
    let times: Vec<_> = (0..5).map(|_| camera.next_pair(SECOND).unwrap().exposed_at.as_nanos()).collect();
    // A negative start counts as zero; the next round begins one typical step (the median, 0.4 s) after the last pair.
    assert_eq!(times, [0, 1_000_000_000, 1_100_000_000, 1_500_000_000, 1_900_000_000]);
}
