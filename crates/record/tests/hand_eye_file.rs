//! Our TOML file of a hand-eye calibration: bit-exact round trip, and refused files.

#![allow(clippy::unwrap_used, reason = "helpers of tests may fail loudly, as tests do")]

use std::fs;

use crate::check_changes;
use nalgebra::Vector3;
use pb3dp_geometry::{Frame, Pose, so3};
use pb3dp_record::calibration_files::{
    BoardPlace, CameraIdentity, HandEye, JudgedGate, Judgement, ParameterCovariance, load_hand_eye, load_stereo,
    save_hand_eye,
};

fn pose<To: Frame, From: Frame>(x_m: f64, turn_rad: [f64; 3]) -> Pose<To, From> {
    Pose::from_parts(Vector3::new(x_m / 0.7, -0.05 / 0.3, 1e-9 / 7.0), so3::exp(&Vector3::from(turn_rad)))
}

fn hand_eye(board: BoardPlace) -> HandEye {
    let left = CameraIdentity { serial: Some("A1".to_owned()), ..CameraIdentity::default() };
    let judgement = Judgement {
        date: "2026-11-22T09:00:00Z".to_owned(),
        tool: "pb3dp-calibrate 0.1.0".to_owned(),
        source: "15 stops".to_owned(),
        cameras: [left, CameraIdentity::default()],
        numbers: vec![("corner_rms_px".to_owned(), 0.1 / 0.7)],
        covariance: Some(ParameterCovariance {
            names: vec!["flange_from_cam_left.x_m".to_owned()],
            rows: vec![vec![1e-8 / 3.0]],
        }),
        gates: vec![JudgedGate {
            name: "stops".to_owned(),
            measured: 7.0,
            good: 12.0,
            refused: 8.0,
            grade: "refused".to_owned(),
        }],
    };
    HandEye { flange_from_cam_left: pose(0.03, [0.1, -0.2, 1.5]), board, judgement }
}

fn room() -> BoardPlace {
    BoardPlace::Room { base_from_board: pose(0.9, [3.0, 0.1, -0.2]) }
}

fn carried() -> BoardPlace {
    BoardPlace::Carried {
        vs_base_from_tc_base: pose(2.0, [0.01, -0.02, 3.1]),
        tc_flange_from_board: pose(0.1, [1.0, -1.1, 0.3]),
    }
}

#[test]
fn a_hand_eye_calibration_comes_back_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("hand_eye.toml");
    for board in [room(), carried()] {
        let hand_eye = hand_eye(board);
        save_hand_eye(&hand_eye, &file).unwrap();
        assert_eq!(load_hand_eye(&file).unwrap(), hand_eye);
        assert_eq!(load_hand_eye(&file).unwrap().judgement.refusals().count(), 1);
    }
    // It is not a stereo calibration, and the stereo reader reports the keys it found.
    let error = load_stereo(std::slice::from_ref(&file)).unwrap_err().to_string();
    assert!(error.contains("flange_from_cam_left"), "{error}");
}

#[test]
fn what_is_wrong_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("hand_eye.toml");
    let check = |board, changes: &[(&str, &str, &str)]| {
        save_hand_eye(&hand_eye(board), &file).unwrap();
        check_changes(&fs::read_to_string(&file).unwrap(), changes, |text| {
            fs::write(&file, text).unwrap();
            load_hand_eye(&file).unwrap_err().to_string()
        });
    };
    check(carried(), &[("[tc_flange_from_board]", "[tc_flange]", "tc_flange_from_board: is missing")]);
    let of_translation = "flange_from_cam_left.translation_m: has length 40.";
    check(
        room(),
        &[
            ("calibration 1", "calibration 2", "format: is \"pb3dp hand-eye calibration 2\""),
            ("[base_from_board]", "[board_from_base]", "base_from_board: is missing"),
            ("wxyz = [0.", "wxyz = [1.", "flange_from_cam_left.rotation_wxyz: is not a unit quaternion"),
            ("translation_m = [0.0", "translation_m = [40.0", of_translation),
            ("grade = \"refused\"", "grade = \"good\"", "gates.stops.grade"),
            ("measured = 7.0", "measured = nan", "gates.stops.measured"),
        ],
    );
    let mut endless = hand_eye(room());
    endless.judgement.numbers[0].1 = f64::NAN;
    let error = save_hand_eye(&endless, &file).unwrap_err().to_string();
    assert!(error.contains("corner_rms_px is NaN"), "{error}");
}
