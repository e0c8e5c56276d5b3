//! Tests of the program as a user runs it.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests may fail loudly, and show what they measured"
)]

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use pb3dp_record::calibration_files::{CameraIdentity, load_stereo, save_cameras};

const DATA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data");

fn calibrate(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pb3dp-calibrate")).args(args).output().expect("it starts")
}

fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

fn chessboards() -> String {
    format!("{DATA}/opencv_chessboards")
}

/// `stereo` with the chessboards and additional arguments.
fn stereo(further: &[&str]) -> Output {
    let folder = chessboards();
    let args = ["stereo", "--left", &folder, "--right", &folder, "--board", "9x6", "--square", "25"];
    calibrate(&[&args, further].concat())
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
    let output_text = text(&output);
    println!("{output_text}");
    assert!(output_text.contains("verdict: "), "{output_text}");
    assert!(output_text.contains("not judged: the size of the squares"), "{output_text}");
    // The detected corners are the committed ones, which OpenCV used.
    let found = fs::read_to_string(&corners).expect("corners");
    assert_eq!(found, fs::read_to_string(Path::new(DATA).join("corners.csv")).expect("corners"));
    let calibration = load_stereo(&[toml.clone().into()]).expect("a calibration");
    let judgement = calibration.judgement.expect("judged");
    assert_eq!(judgement.cameras, identities);
    assert_eq!(judgement.gates.len(), 10, "{judgement:?}");
    for gate in &judgement.gates {
        assert!(output_text.contains(&format!("{} = {:.3}", gate.name, gate.measured)), "{gate:?}\n{output_text}");
    }
    // The board was held by hand, and the exposures of the cameras were not synchronised.
    assert!(!output.status.success());
    let refusals: Vec<&str> = judgement.refusals().map(|gate| gate.name.as_str()).collect();
    assert_eq!(refusals, ["motion_rms_px"], "{output_text}");
    assert!(output_text.contains("hold the board still"), "{output_text}");
    let covariance = judgement.covariance.expect("known");
    assert!(covariance.names.contains(&"cam_right_from_cam_left.x_m".to_owned()), "{:?}", covariance.names);
    assert!(judgement.numbers.contains(&("corners".to_owned(), 1296.0)), "{:?}", judgement.numbers);
    let rig = calibration.rig;
    assert!((rig.baseline_m() * 1e3 - 83.0).abs() < 1.0, "{rig:?}");
    for name in ["calib.json", "rig.opencv.yaml", "camchain.kalibr.yaml", "ros"] {
        let out = path(name);
        let output = calibrate(&["convert", &toml, "--out", &out]);
        assert!(output.status.success(), "{}", text(&output));
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
    let images = format!("{DATA}/bumblebee2_chessboards");
    let output = calibrate(&[
        "stereo",
        "--left",
        &images,
        "--right",
        &images,
        "--board",
        "6x4",
        "--square",
        "30",
        "--corners",
        &corners,
    ]);
    let output_text = text(&output);
    println!("{output_text}");
    // Eleven boards in the middle of the image.
    assert!(!output.status.success() && output_text.contains("refused  coverage_percent"), "{output_text}");
    let found = fs::read_to_string(&corners).expect("corners");
    assert_eq!(found, fs::read_to_string(Path::new(DATA).join("bumblebee2_corners.csv")).expect("corners"));
}

#[test]
fn the_views_decide_what_a_verified_calibration_leaves_unstated() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("calib.opencv.yaml");
    let name = file.display().to_string();
    assert!(text(&stereo(&["--lens", "brown-4", "--out", &name])).contains("wrote"));
    let whole = fs::read_to_string(&file).expect("written");
    let states = |line: &&str| !["image_", "units", "distortion_model"].iter().any(|key| line.starts_with(key));
    // The fifth coefficient is zero.
    let bare: String =
        whole.lines().filter(states).map(|line| format!("{}\n", line.replace("cols: 5", "cols: 4"))).collect();
    fs::write(&file, bare.replace(", 0.0]\nM2", "]\nM2").replace(", 0.0]\nR", "]\nR")).expect("written");
    let images = chessboards();
    let args = ["verify", &name, "--left", &images, "--right", &images, "--board", "9x6", "--square", "25"];
    let output_text = text(&calibrate(&args));
    for part in [
        "that of the images, 640x480, is used",
        "no lens model: Brown-Conrady (k1 k2 p1 p2) is used, because the repro",
    ] {
        assert!(output_text.contains(part), "{output_text}");
    }
    let stated = text(&calibrate(&[&args[..], &["--calib-lens", "equidistant"]].concat()));
    assert!(stated.contains("refused  reprojection_rms_px = 3.") && !stated.contains("no lens model"), "{stated}");
    let half = text(&calibrate(&[&args[..], &["--calib-size", "320x240", "--calib-lens", "brown"]].concat()));
    assert!(half.contains("of 320x240 pixels is scaled to the images of 640x480"), "{half}");
}

#[test]
fn options_of_a_calibration_that_is_read_are_refused_where_none_is() {
    let output_text = text(&stereo(&["--calib-lens", "brown"]));
    assert!(
        output_text.contains("--calib-lens and --rectified have no effect here: no calibration is read"),
        "{output_text}"
    );
}

#[test]
fn gates_of_a_file_refuse_and_the_program_fails() {
    let folder = tempfile::tempdir().expect("a folder");
    let strict = folder.path().join("gates.toml");
    let limits = include_str!("../../../configs/calibration_gates.toml");
    let limits = limits.replace("views = { good = 12, refused = 6 }", "views = { good = 20, refused = 14 }");
    fs::write(&strict, limits).expect("written");
    let output = stereo(&["--lens", "brown-4", "--gates", &strict.display().to_string()]);
    assert!(!output.status.success());
    let output_text = text(&output);
    assert!(output_text.contains("board: bow along its rows "), "{output_text}");
    assert!(
        output_text.contains("refused  views = 12.000") && output_text.contains("take more images"),
        "{output_text}"
    );
    assert!(output_text.contains("verdict: refused"), "{output_text}");
}

#[test]
fn a_wrong_size_of_the_squares_is_refused_where_the_baseline_is_known() {
    let images = format!("{DATA}/bumblebee2_chessboards");
    for (square, grade) in [("30", "good "), ("29", "refused")] {
        let output = calibrate(&[
            "stereo",
            "--left",
            &images,
            "--right",
            &images,
            "--board",
            "6x4",
            "--square",
            square,
            "--baseline",
            "120",
            "--lens",
            "radial-1",
        ]);
        let output_text = text(&output);
        let line = output_text.lines().find(|line| line.contains("scale_percent")).unwrap_or_default();
        println!("{square} mm: {line}");
        assert!(line.starts_with(grade), "{output_text}");
        assert_eq!(line.contains("measure ten squares"), square == "29", "{output_text}");
        assert!(!output_text.contains("not judged"), "{output_text}");
    }
}

#[test]
fn mistakes_are_named() {
    let folder = chessboards();
    let refusal = |args: &[&str]| {
        let output = calibrate(args);
        assert!(!output.status.success(), "{args:?}");
        text(&output)
    };
    let one = ["intrinsics", "--images", &folder, "--square", "25", "--board"];
    let both = ["stereo", "--left", &folder, "--right", &folder, "--square", "25", "--board"];
    assert!(
        refusal(&[&both[..], &["8x6"]].concat()).contains("a grid of 9 x 6 corners was detected, the board has 8 x 6")
    );
    assert!(refusal(&[&one[..], &["9x6"]].concat()).contains("images are called left and"));
    let no_format = refusal(&[&both[..], &["9x6", "--out", "calibration.yaml"]].concat());
    assert!(no_format.contains("unknown file extension") && !no_format.contains("baseline"), "{no_format}");
    assert!(refusal(&[&one[..], &["7x7"]].concat()).contains("quarter turn"));
    assert!(refusal(&[&one[..], &["nine"]].concat()).contains("COLUMNSxROWS"));
    let empty = tempfile::tempdir().expect("a folder");
    let empty = empty.path().display().to_string();
    let stereo = ["stereo", "--left", &empty, "--right", &empty, "--board", "9x6", "--square", "25"];
    assert!(refusal(&stereo).contains("no matching images of 2 camera(s)"));
    assert!(refusal(&["convert", &format!("{DATA}/corners.csv"), "--out", "x.json"]).contains("corners.csv"));
    let nominal = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/calibration/nominal.json");
    assert!(refusal(&["convert", nominal, "--out", "x.toml"]).contains("needs quality data"));
}
