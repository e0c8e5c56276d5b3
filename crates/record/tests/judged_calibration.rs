//! Our TOML file of a calibration: bit-exact round trip, and refused files.

#![allow(clippy::unwrap_used, reason = "helpers of tests may fail loudly, as tests do")]

use std::fs;

use crate::check_changes;
use nalgebra::Vector3;
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig, so3};
use pb3dp_record::calibration_files::{
    CalibrationFormat, CameraIdentity, JudgedGate, Judgement, ParameterCovariance, load_cameras, load_stereo,
    save_cameras, save_judged,
};

fn rig(lenses: [Distortion; 2]) -> StereoRig {
    let size = ImageSize { width: 640, height: 480 };
    // Thirds have no short decimals.
    let left =
        Camera::new(size, Pinhole { fx: 2227.0 / 3.0, fy: 738.25, cx: 331.0 / 1.1, cy: 228.5 }, lenses[0]).unwrap();
    let right = Camera::new(size, Pinhole { fx: 735.0, fy: 731.5, cx: 318.75, cy: 240.0 / 0.99 }, lenses[1]).unwrap();
    let turn = so3::exp(&Vector3::new(0.013, -0.041, 0.007));
    StereoRig::new(left, right, Pose::from_parts(Vector3::new(-0.1 / 1.015, 0.00125, 1e-9 / 7.0), turn)).unwrap()
}

fn cameras() -> [CameraIdentity; 2] {
    let left = CameraIdentity { serial: Some("SN \"0\"".to_owned()), place: None, focus: Some(-3) };
    [left, CameraIdentity { place: Some("usb-0000:00:14.0-2".to_owned()), ..CameraIdentity::default() }]
}

fn judgement() -> Judgement {
    let gate = |name: &str, measured: f64, grade: &str| JudgedGate {
        name: name.to_owned(),
        measured,
        good: 0.3,
        refused: 0.5,
        grade: grade.to_owned(),
    };
    Judgement {
        date: "2026-11-22T09:00:00Z".to_owned(),
        tool: "pb3dp-calibrate 0.1.0".to_owned(),
        source: "13 views, \"quoted\", C:\\images".to_owned(),
        cameras: cameras(),
        numbers: vec![("corners".to_owned(), 1296.0), ("view \"7\": rms_px".to_owned(), 0.1 / 0.7)],
        covariance: Some(ParameterCovariance {
            names: vec!["left.fx".to_owned(), "right.k1".to_owned()],
            rows: vec![vec![0.5 / 0.7, -1e-12 / 3.0], vec![-1e-12 / 3.0, 1e-5]],
        }),
        gates: vec![gate("held_out_ratio", 1.0 / 3.0, "fair"), gate("reprojection_rms_px", 0.7, "refused")],
    }
}

const FIVE: Distortion = Distortion::BrownConrady5 { coefficients: [-0.31, 0.12 / 0.7, 0.0011, -0.0007, 0.0] };
const EIGHT: Distortion =
    Distortion::BrownConrady8 { coefficients: [0.4, -0.2, -0.0009, 0.0013, 0.05, 0.7, -0.1, 0.02] };
const WIDE: Distortion = Distortion::Equidistant { coefficients: [-0.012, 0.0043, -0.0021, 0.0004] };
const ZEROS: Distortion = Distortion::BrownConrady5 { coefficients: [0.0; 5] };

#[test]
fn a_calibration_comes_back_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("calibration.toml");
    let load = || load_stereo(std::slice::from_ref(&file)).unwrap();
    for lenses in [[FIVE, EIGHT], [WIDE, Distortion::None], [ZEROS, FIVE]] {
        let (rig, judgement) = (rig(lenses), judgement());
        save_judged(&rig, &judgement, &file).unwrap();
        let loaded = load();
        assert_eq!((loaded.rig, loaded.format), (rig, CalibrationFormat::Judged));
        assert_eq!(loaded.judgement, Some(judgement));
        assert_eq!(loaded.notes, ["gate reprojection_rms_px refused this calibration when it was made: measured 0.7"]);
    }
    let bare = Judgement {
        cameras: Default::default(),
        numbers: Vec::new(),
        covariance: None,
        gates: Vec::new(),
        ..judgement()
    };
    save_judged(&rig([FIVE, FIVE]), &bare, &file).unwrap();
    assert_eq!(load().judgement, Some(bare));
}

#[test]
fn the_cameras_of_a_recording_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cameras.toml");
    save_cameras(&cameras(), &file).unwrap();
    assert_eq!(load_cameras(&file).unwrap(), cameras());
    let good = fs::read_to_string(&file).unwrap();
    let changes = [
        ("focus = -3", "focus = 2.5", "left.focus: is 2.5"),
        ("focus = -3", "fokus = -3", "left.fokus: unknown key; the keys are serial, place, focus"),
        ("[right]", "[both]", "right: is missing"),
        ("cameras 1", "cameras 2", "format: is \"pb3dp cameras 2\""),
    ];
    check_changes(&good, &changes, |text| {
        fs::write(&file, text).unwrap();
        load_cameras(&file).unwrap_err().to_string()
    });
}

#[test]
fn what_is_wrong_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("calibration.toml");
    save_judged(&rig([FIVE, EIGHT]), &judgement(), &file).unwrap();
    let good = fs::read_to_string(&file).unwrap();
    let refusal = |text: &str| {
        fs::write(&file, text).unwrap();
        load_stereo(std::slice::from_ref(&file)).unwrap_err().to_string()
    };
    let changes = [
        ("calibration 1", "calibration 2", "use a newer pb3dp"),
        ("fx_px = 735.0", "fx_px = -735.0", "right: fx is -735"),
        ("rotation_wxyz = [0.9", "rotation_wxyz = [0.8", "rotation_wxyz"),
        ("grade = \"fair\"", "grade = \"fine\"", "gates.held_out_ratio.grade"),
        (
            "grade = \"refused\"",
            "grade = \"fair\"",
            "gates.reprojection_rms_px.grade: is \"fair\", but 0.7 was measured",
        ),
        ("\"left.fx\", ", "", "covariance.matrix"),
        ("corners = 1296.0", "corners = nan", "measured.corners"),
        ("translation_m = [-0.09", "translation_m = [0.09", "exchange left and right"),
        ("[left]", "[left", "line 6: not valid TOML"),
        ("date = ", "day = ", "date: is missing"),
        (&good, "a = 1\n", "a TOML file of pb3dp calibrate"),
    ];
    check_changes(&good, &changes, refusal);
    let not_written = |change: fn(&mut Judgement), named: &str| {
        let mut endless = judgement();
        change(&mut endless);
        let error = save_judged(&rig([FIVE, FIVE]), &endless, &file).unwrap_err().to_string();
        assert!(error.contains(named), "{error}");
    };
    not_written(|judged| judged.gates[0].measured = f64::INFINITY, "held_out_ratio is inf");
    let number = |judged: &mut Judgement| judged.covariance.as_mut().unwrap().rows[1][1] = f64::NAN;
    not_written(number, "the covariance of right.k1 is NaN");
}
