//! Tests of the program as a user runs it.

use std::fs;
use std::path::Path;

use pb3dp_record::calibration_files::{CameraIdentity, load_stereo, save_cameras};

use crate::program::{Output, calibrate};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");
const CHESSBOARDS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/opencv_chessboards");
const BUMBLEBEE2: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/bumblebee2_chessboards");
const BOARD: [&str; 4] = ["--board", "9x6", "--square", "25"];

/// `stereo` with the chessboards and additional arguments.
fn stereo(further: &[&str]) -> Output {
    calibrate(&[&["stereo", "--left", CHESSBOARDS, "--right", CHESSBOARDS], &BOARD, further])
}

/// `stereo` with the images of a Bumblebee2, the side of a square and additional arguments.
fn bumblebee2(square_mm: &str, further: &[&str]) -> Output {
    let board = ["--board", "6x4", "--square", square_mm];
    calibrate(&[&["stereo", "--left", BUMBLEBEE2, "--right", BUMBLEBEE2], &board, further])
}

#[test]
fn a_head_is_calibrated_from_a_folder_of_images() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (corners, toml, cameras) = (path("corners.csv"), path("calib.toml"), path("cameras.toml"));
    let camera = |serial: &str| CameraIdentity { serial: Some(serial.to_owned()), ..CameraIdentity::default() };
    let identities = [camera("A1"), camera("B2")];
    save_cameras(&identities, Path::new(&cameras)).expect("written");
    let output = stereo(&["--corners", &corners, "--out", &toml, "--cameras", &cameras]);
    output.contains_all(&["verdict: ", "not judged: the size of the squares", "hold the board still"]);
    // The detected corners are the committed ones, which OpenCV used.
    let found = fs::read_to_string(&corners).expect("corners");
    assert_eq!(found, fs::read_to_string(Path::new(DATA).join("corners.csv")).expect("corners"));
    let calibration = load_stereo(&[toml.clone().into()]).expect("a calibration");
    let judgement = calibration.judgement.expect("judged");
    assert_eq!(judgement.cameras, identities);
    assert_eq!(judgement.gates.len(), 10, "{judgement:?}");
    for gate in &judgement.gates {
        output.contains_all(&[&format!("{} = {:.3}", gate.name, gate.measured)]);
    }
    // The board was held by hand, and the exposures of the cameras were not synchronised.
    output.refused();
    let refusals: Vec<&str> = judgement.refusals().map(|gate| gate.name.as_str()).collect();
    assert_eq!(refusals, ["motion_rms_px"]);
    let covariance = judgement.covariance.expect("known");
    assert!(covariance.names.contains(&"cam_right_from_cam_left.x_m".to_owned()), "{:?}", covariance.names);
    assert!(judgement.numbers.contains(&("corners".to_owned(), 1296.0)), "{:?}", judgement.numbers);
    let rig = calibration.rig;
    assert!((rig.baseline_m() * 1e3 - 83.0).abs() < 1.0, "{rig:?}");
    for name in ["calib.json", "rig.opencv.yaml", "camchain.kalibr.yaml", "ros"] {
        let out = path(name);
        calibrate(&[&["convert", &toml, "--out", &out]]).succeeded();
        let again = load_stereo(&[out.into()]).expect("a calibration").rig;
        let apart = again.cam_right_from_cam_left().to_homogeneous() - rig.cam_right_from_cam_left().to_homogeneous();
        assert!(apart.amax() < 1e-14, "{name}: {apart}");
        assert_eq!(again.left().distortion(), rig.left().distortion());
    }
}

#[test]
fn colour_images_of_another_board_give_the_committed_corners() {
    let folder = tempfile::tempdir().expect("a folder");
    let corners = folder.path().join("corners.csv").display().to_string();
    // Eleven boards in the middle of the image.
    bumblebee2("30", &["--corners", &corners]).refused().contains_all(&["refused  coverage_percent"]);
    let found = fs::read_to_string(&corners).expect("corners");
    assert_eq!(found, fs::read_to_string(Path::new(DATA).join("bumblebee2_corners.csv")).expect("corners"));
}

#[test]
fn the_views_decide_what_a_verified_calibration_leaves_unstated() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("calib.opencv.yaml");
    let name = file.display().to_string();
    stereo(&["--lens", "brown-4", "--out", &name]).contains_all(&["wrote"]);
    let whole = fs::read_to_string(&file).expect("written");
    let states = |line: &&str| !["image_", "units", "distortion_model"].iter().any(|key| line.starts_with(key));
    // The fifth coefficient is zero.
    let bare: String =
        whole.lines().filter(states).map(|line| format!("{}\n", line.replace("cols: 5", "cols: 4"))).collect();
    fs::write(&file, bare.replace(", 0.0]\nM2", "]\nM2").replace(", 0.0]\nR", "]\nR")).expect("written");
    let verify = |further: &[&str]| {
        calibrate(&[&["verify", &name, "--left", CHESSBOARDS, "--right", CHESSBOARDS], &BOARD, further])
    };
    verify(&[]).contains_all(&[
        "that of the images, 640x480, is used",
        "no lens model: Brown-Conrady (k1 k2 p1 p2) is used, because the repro",
    ]);
    let stated = verify(&["--calib-lens", "equidistant"]);
    stated.contains_all(&["refused  reprojection_rms_px = 3."]);
    assert!(!stated.text.contains("no lens model"));
    verify(&["--calib-size", "320x240", "--calib-lens", "brown"])
        .contains_all(&["of 320x240 pixels is scaled to the images of 640x480"]);
}

#[test]
fn options_of_a_calibration_that_is_read_are_refused_where_none_is() {
    stereo(&["--calib-lens", "brown"])
        .contains_all(&["--calib-lens and --rectified have no effect here: no calibration is read"]);
}

#[test]
fn gates_of_a_file_refuse_and_the_program_fails() {
    let folder = tempfile::tempdir().expect("a folder");
    let strict = folder.path().join("gates.toml");
    let limits = include_str!("../../../configs/calibration_gates.toml");
    let limits = limits.replace("views = { good = 12, refused = 6 }", "views = { good = 20, refused = 14 }");
    fs::write(&strict, limits).expect("written");
    stereo(&["--lens", "brown-4", "--gates", &strict.display().to_string()]).refused().contains_all(&[
        "board: bow along its rows ",
        "refused  views = 12.000",
        "take more images",
        "verdict: refused",
    ]);
}

#[test]
fn a_wrong_size_of_the_squares_is_refused_where_the_baseline_is_known() {
    for (square_mm, grade) in [("30", "good "), ("29", "refused")] {
        let text = bumblebee2(square_mm, &["--baseline", "120", "--lens", "radial-1"]).text;
        let line = text.lines().find(|line| line.contains("scale_percent")).unwrap_or_default();
        assert!(line.starts_with(grade), "{text}");
        assert_eq!(line.contains("measure ten squares"), square_mm == "29", "{text}");
        assert!(!text.contains("not judged"), "{text}");
    }
}

#[test]
fn mistakes_are_named() {
    let empty = tempfile::tempdir().expect("a folder");
    let empty = empty.path().display().to_string();
    let corners = format!("{DATA}/corners.csv");
    let nominal = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/calibration/nominal.json");
    let one = ["intrinsics", "--images", CHESSBOARDS, "--square", "25", "--board"];
    let both = ["stereo", "--left", CHESSBOARDS, "--right", CHESSBOARDS, "--square", "25", "--board"];
    let refused: [(&[&str], &[&str], &str); 8] = [
        (&both, &["8x6"], "a grid of 9 x 6 corners was detected, the board has 8 x 6"),
        (&both, &["9x6", "--out", "calibration.yaml"], "unknown file extension"),
        (&one, &["9x6"], "images are called left and"),
        (&one, &["7x7"], "quarter turn"),
        (&one, &["nine"], "COLUMNSxROWS"),
        (&["stereo", "--left", &empty, "--right", &empty], &BOARD, "no matching images of 2 camera(s)"),
        (&["convert", &corners], &["--out", "x.json"], "corners.csv"),
        (&["convert", nominal], &["--out", "x.toml"], "needs quality data"),
    ];
    for (args, further, named) in refused {
        let output = calibrate(&[args, further]).refused();
        output.contains_all(&[named]);
        assert!(!output.text.contains("baseline"), "nothing is computed before: {}", output.text);
    }
}
