//! Wrong and inconsistent calibration files: each error names file, key and reason.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests may fail loudly, as tests do")]

use std::fs;
use std::path::{Path, PathBuf};

use pb3dp_record::calibration_files::{CalibrationFileError, load_stereo};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// Replaces `from`, which must occur, in a good text and expects an error that begins with the file name and `start` and contains
/// `reason`.
fn check(files: &[(&str, &str)], edited: usize, from: &str, to: &str, [start, reason]: [&str; 2]) {
    let directory = tempfile::tempdir().unwrap();
    let mut paths = Vec::new();
    for (i, (name, text)) in files.iter().enumerate() {
        let path = directory.path().join(name);
        let text = if i == edited {
            assert!(text.contains(from), "{name} has no {from:?}");
            text.replacen(from, to, 1)
        } else {
            (*text).to_owned()
        };
        fs::write(&path, text).unwrap();
        paths.push(path);
    }
    let error = match load_stereo(&paths) {
        Ok(calibration) => panic!("{from:?} -> {to:?} was accepted: {calibration:?}"),
        Err(error) => error.to_string(),
    };
    let relative = error.replace(&format!("{}/", directory.path().display()), "");
    assert!(relative.starts_with(start), "{from:?} -> {to:?}: {relative}\nexpected to start with {start}");
    assert!(relative.contains(reason), "{from:?} -> {to:?}: {relative}\nexpected to contain {reason}");
}

#[test]
fn ros_pairs() {
    let [left, right] =
        ["left", "right"].map(|side| fs::read_to_string(data(&format!("ros_pair/{side}.yaml"))).unwrap());
    let files = [("left.yaml", left.as_str()), ("right.yaml", right.as_str())];
    let in_left = |from: &str, to: &str, expected| check(&files, 0, from, to, expected);
    let in_right = |from: &str, to: &str, expected| check(&files, 1, from, to, expected);
    in_left("image_width: 640", "image_width: 0", ["left.yaml: image_width: 0", "not a number of pixels"]);
    in_left("image_width: 640", "image_width: 639.5", ["left.yaml: image_width: 639.5", "not a number of pixels"]);
    in_left("image_height: 480\n", "", ["left.yaml: image_height: is missing", ""]);
    in_left("742.5", "-742.5", ["left.yaml: camera_matrix: fx is -742.5", "must be positive"]);
    in_left("742.5, 0.0", "742.5, 0.4", ["left.yaml: camera_matrix: ", "the skew, is 0.4"]);
    in_left("331.25", "1331.25", ["left.yaml: camera_matrix: cx is 1331.25", "far outside the image"]);
    in_left("742.5", ".nan", ["left.yaml: camera_matrix.data[0]: ", "not a finite number"]);
    in_left("742.5, ", "", ["left.yaml: camera_matrix.data: has 8 elements", "rows x cols is 3 x 3"]);
    in_left("plumb_bob", "fov", ["left.yaml: distortion_model: ", "unknown distortion model fov"]);
    in_left("plumb_bob", "equidistant", ["left.yaml: distortion_coefficients: has 5 coefficients", "has 4"]);
    in_left("plumb_bob", "[1, 2]", ["left.yaml: distortion_model: must be a string", ""]);
    in_left("rows: 3\n  cols: 3", "rows: 3\n  cols: 2", ["left.yaml: camera_matrix.data: has 9 elements", ""]);
    in_left("image_width: 640", "image_width: 320", ["right.yaml: projection_matrix: ", "320x480"]);
    in_left("749.2912867", "700.2912867", ["right.yaml: projection_matrix: element [0][0]", "in the left file"]);
    in_right("749.2912867", "7492.912867", ["right.yaml: projection_matrix: its fx is 7492.9", "factor of 5"]);
    in_right("-73.8398", "73.8398", ["right.yaml: projection_matrix: ", "exchange left and right"]);
    in_right("-73.83989060364465", "0", ["right.yaml: projection_matrix: ", "calibrated one by one"]);
    in_right("-73.8398906", "-73839.8906", ["right.yaml: projection_matrix: the baseline is 98.5", "unit"]);
    in_right("0.99953007", "-0.99953007", ["right.yaml: rectification_matrix: is not a rotation", ""]);
    in_right(
        "0.99953007",
        "0.97953007",
        ["right.yaml: rectification_matrix: is not a rotation", "differs from the identity"],
    );
    // Exchanged files, and one file alone.
    let exchanged = [files[1], files[0]];
    check(&exchanged, 0, "image", "image", ["right.yaml: projection_matrix: element [0][3]", "exchanged"]);
    check(&files[..1], 0, "image", "image", ["left.yaml: camera_matrix: ", "give the left and the right file"]);
}

#[test]
fn kalibr_camchain_files() {
    let text = "cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.31, 0.12, 0.0011, -0.0007]
  distortion_model: radtan
  intrinsics: [742.5, 738.25, 331.25, 228.5]
  resolution: [640, 480]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.001]
  - [0.0, 0.0, 1.0, 0.002]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.29, 0.11, 0.0, -0.0003]
  distortion_model: radtan
  intrinsics: [735.0, 731.5, 318.75, 240.125]
  resolution: [640, 480]
";
    let check = |from: &str, to: &str, expected| check(&[("camchain.yaml", text)], 0, from, to, expected);
    check("cam1:", "cam2:", ["camchain.yaml: cam1: is missing", ""]);
    check("model: pinhole", "model: omni", ["camchain.yaml: cam0.camera_model: ", "must be pinhole"]);
    check("-0.31, ", "", ["camchain.yaml: cam0.distortion_coeffs: has 3 coefficients", "radtan has 4"]);
    check("model: radtan", "model: fov", ["camchain.yaml: cam0.distortion_model: ", "use radtan"]);
    check("742.5, ", "", ["camchain.yaml: cam0.intrinsics: has 3 numbers, 4 are needed", ""]);
    check("738.25", "0", ["camchain.yaml: cam0.intrinsics: fy is 0", "must be positive"]);
    check("228.5", "-900", ["camchain.yaml: cam0.intrinsics: cy is -900", "far outside"]);
    check("[640, 480]", "[640]", ["camchain.yaml: cam0.resolution: must be [width, height]", ""]);
    check("[640, 480]", "[752, 480]", ["camchain.yaml: cam1.T_cn_cnm1: ", "752x480"]);
    check("  - [0.0, 0.0, 1.0, 0.002]\n", "", ["camchain.yaml: cam1.T_cn_cnm1: has 3 x 4 elements, 4 x 4", ""]);
    check("[0.0, 0.0, 1.0, 0.002]", "[0.0, 0.0, 1.0]", ["camchain.yaml: cam1.T_cn_cnm1[2]: has 3 elements", ""]);
    check("[0.0, 0.0, 1.0, 0.002]", "[0.0, 0.0, -1.0, 0.002]", ["camchain.yaml: cam1.T_cn_cnm1: ", "reflection"]);
    check("0.0, 1.0]", "0.0, 2.0]", ["camchain.yaml: cam1.T_cn_cnm1: ", "last row"]);
    check("-0.11", "0.11", ["camchain.yaml: cam1.T_cn_cnm1: ", "exchange left and right"]);
    check("-0.11", "-110", ["camchain.yaml: cam1.T_cn_cnm1: the baseline is 110", "unit of length"]);
    check("-0.11", "-0.11, 7", ["camchain.yaml: cam1.T_cn_cnm1[1]: has 4 elements", ""]);
    check("-0.11", "x", ["camchain.yaml: cam1.T_cn_cnm1[0][3]: \"x\" is not a finite number", ""]);
    check("[640, 480]\ncam1", "[640, 480\ncam1", ["camchain.yaml, line ", "not valid YAML"]);
    check("cam0:", "cam0: *nowhere", ["camchain.yaml, line 1: not valid YAML", ""]);
}

#[test]
fn opencv_files() {
    let text = fs::read_to_string(data("opencv_4_14_stereo.yaml")).unwrap();
    let in_mm = format!("{text}units: mm\n");
    let check = |from: &str, to: &str, expected| check(&[("stereo.yaml", &in_mm)], 0, from, to, expected);
    check("M2:", "N2:", ["stereo.yaml: M2: is missing", "cameraMatrix2"]);
    check("D1:", "E1:", ["stereo.yaml: D1: is missing", "distCoeffs1"]);
    check("image_width: 640\n", "", ["stereo.yaml: image_width: is missing", "--calib-size WxH"]);
    check("T: !!", "T9: !!", ["stereo.yaml: T: is missing", "translation"]);
    check("-98.5, 1.25, 2.75", "-98.5, 1.25", ["stereo.yaml: T.data: has 2 elements", "3 x 1"]);
    self::check(
        &[("stereo.yaml", &text)],
        0,
        "-98.5",
        "-14.5",
        ["stereo.yaml: T: has length 14.8", "add the key units"],
    );
    check("-98.5", "-98500", ["stereo.yaml: T: the baseline is 98.5", "between 0.001 and 10 m"]);
    check("-98.5", "98.5", ["stereo.yaml: T: ", "exchange left and right"]);
    check("-98.5", ".Nan", ["stereo.yaml: T.data[0]: ", "not a finite number"]);
    check("units: mm", "units: inch", ["stereo.yaml: units: unknown unit \"inch\"", "use mm"]);
    check("0.02, 0., 0.,", "0.02, 0., 1.,", ["stereo.yaml: D2: has a thin prism or tilt", "5 or 8"]);
    check("0.99913513687758537", "0.5", ["stereo.yaml: R: is not a rotation", "determinant"]);
    check("image_width", "distortion_model: fisheye\nimage_width", ["stereo.yaml: D1: has 5", "fisheye has 4"]);
    check("735., 0., 318.75", "735., 0., 31875", ["stereo.yaml: M2: cx is 31875", "another image size"]);
    check("-0.31, 0.12,", "-0.31,", ["stereo.yaml: D1.data: has 4 elements", "1 x 5"]);
    // In two files.
    let (intrinsics, extrinsics) = in_mm.split_at(in_mm.find("R: !!").unwrap());
    let extrinsics = format!("%YAML:1.0\n---\n{extrinsics}");
    let both = [("in.yml", intrinsics), ("ex.yml", &*extrinsics)];
    self::check(&both[..1], 0, "M2", "M2", ["in.yml: R and T: are missing", "as intrinsics.yml,extrinsics.yml"]);
    self::check(&both, 0, "M2:", "N2:", ["in.yml: M2: is missing", "cameraMatrix2"]);
    self::check(&both, 1, "T: !!", "T9: !!", ["ex.yml: T: is missing", "translation"]);
}

#[test]
fn case_calibrations() {
    let text = r#"{
 "image_size": [640, 480], "rectified": true, "distortion": "none (rectified)",
 "K_left": [[740, 0, 319.5], [0, 740, 239.5], [0, 0, 1]], "K_right": [[740, 0, 331.5], [0, 740, 239.5], [0, 0, 1]],
 "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t_mm": [-100, 0, 0], "baseline_mm": 100, "doffs_px": 12,
 "convention": "X_right = R X_left + t; x right, y down, z forward; pixel centres at integers"
}"#;
    let check = |from: &str, to: &str, expected| check(&[("calib.json", text)], 0, from, to, expected);
    check("-100", "100", ["calib.json: t_mm: ", "exchange left and right"]);
    check("[-100, 0, 0]", "[-100, 0]", ["calib.json: t_mm: has 1 x 2 elements, 3 x 1 are needed", ""]);
    check(
        "\"baseline_mm\": 100",
        "\"baseline_mm\": 120",
        ["calib.json: baseline_mm: is 120, but the length of t_mm is 100", ""],
    );
    check("\"doffs_px\": 12", "\"doffs_px\": -12", ["calib.json: doffs_px: is -12", "is 12"]);
    check("[640, 480]", "[64, 48]", ["calib.json: K_left: cx is 319.5", "another image size"]);
    check("[[1, 0, 0], [0, 1, 0]", "[[1, 0, 0], [0, 1, 0.2]", ["calib.json: R: is not a rotation", ""]);
    let contradicted = |from: &str, to: &str, found: &str| {
        let reason =
            format!("{found}; write false for images as the cameras took them, and correct these values otherwise");
        self::check(&[("calib.json", text)], 0, from, to, ["calib.json: rectified: is true, but ", &reason]);
    };
    contradicted("[0, 740, 239.5]", "[0, 741, 239.5]", "but K_left[1][1] is 741 and K_right[1][1] is 740");
    contradicted(
        "[[740, 0, 319.5], [0, 740, 239.5]",
        "[[747, 0, 319.5], [0, 740, 238]",
        "but K_left[0][0] is 747 and K_right[0][0] is 740, K_left[1][2] is 238 and K_right[1][2] is 239.5",
    );
    contradicted("-100, 0, 0", "-100, 0.01, 0", "but t_mm is [-100.0000, 0.0100, 0.0000], not along x");
    contradicted("[0, 1, 0], [0, 0, 1]]", "[0, 1, 1e-6], [0, -1e-6, 1]]", "but R turns by 5.730e-5 degrees");
    let coefficients = r#""distortion_right": {"model": "plumb_bob", "coefficients": [0.1, 0, 0, 0]}, "baseline_mm""#;
    contradicted("\"baseline_mm\"", coefficients, "but distortion_right is given");
    check(
        "none (rectified)",
        "see manual",
        ["calib.json: distortion: is \"see manual\"", "distortion_left is missing"],
    );
    check("X_right = R X_left + t", "X_left = R X_right + t", ["calib.json: convention: must begin", ""]);
    check("\"K_right\"", "\"K_r\"", ["calib.json: K_right: is missing", ""]);
    check("\"t_mm\"", "\"t\"", ["calib.json: t_mm: is missing", ""]);
    check("[[740, 0, 319.5]", "[[740, 0]", ["calib.json: K_left[1]: has 3 elements", ""]);
    check("\"rectified\": true", "\"rectified\": 1", ["calib.json: rectified: must be true or false", ""]);
    check("\"R\": [[1", "\"R\": [1", ["calib.json, line 4: not valid JSON", ""]);
    check("-100, 0, 0", "-0.1, 0, 0", ["calib.json: baseline_mm: ", ""]);
    // Also without the convention: a mistyped key must not make it a file of another format.
    let (bare, _) = text.split_once(",\n \"convention\"").unwrap();
    let files = [("calib.json", &*format!("{bare}\n}}"))];
    self::check(&files, 0, "\"t_mm\"", "\"t_m\"", ["calib.json: t_mm: is missing", ""]);
    // Missed, a distortion or a statement about the file would be dropped without a word.
    for (from, to, meant) in [("rectified", "rectifed", "rectified"), ("doffs_px", "dofs_px", "doffs_px")] {
        let (from, to) = (format!("\"{from}\""), format!("\"{to}\""));
        let reason = format!("is not a key of a calibration; did you mean {meant}?");
        self::check(&[("calib.json", text)], 0, &from, &to, ["calib.json: ", &reason]);
    }
}

#[test]
fn files_that_are_no_calibrations() {
    let none = load_stereo(&[]).unwrap_err().to_string();
    assert!(none.starts_with("0 calibration files were given"), "{none}");
    let missing = load_stereo(&[PathBuf::from("no/such/calib.yaml")]).unwrap_err();
    assert!(matches!(missing, CalibrationFileError::Read { .. }));
    let message = "no/such/calib.yaml: cannot be read: no such file; give the path of a calibration, or write one with `pb3dp calibrate stereo`";
    assert_eq!(missing.to_string(), message);
    let empty = tempfile::tempdir().unwrap();
    let error = load_stereo(&[empty.path().to_path_buf()]).unwrap_err().to_string();
    let expected = "contains no left.yaml and right.yaml, calib.json, calibration.toml, or intrinsics.yml and extrinsics.yml; give the calibration file itself";
    assert!(error.ends_with(expected), "{error}");
    fs::copy(data("ros_pair/left.yaml"), empty.path().join("left.yaml")).unwrap();
    let error = load_stereo(&[empty.path().to_path_buf()]).unwrap_err().to_string();
    assert!(error.contains("right.yaml: cannot be read: "), "{error}");
    let other = [("robot.yaml", "speed: 3\ngain: 4\n")];
    check(&other, 0, "gain", "gain", ["robot.yaml: not a stereo calibration", "top-level keys: gain, speed"]);
    for format in ["ROS camera_info", "Kalibr camchain", "OpenCV stereo YAML", "calib.json"] {
        check(&other, 0, "gain", "gain", ["robot.yaml: ", format]);
    }
    check(&[("x.yaml", "just words")], 0, "just", "", ["x.yaml: not a stereo calibration", "top-level keys: none"]);
    let long = format!("cam0: {}", "x".repeat(2 << 20));
    check(&[("x.yaml", &long)], 0, "cam0", "cam0", ["x.yaml: cannot be read", "at most 1048576 are read"]);
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("x.yaml"), [0xff, 0xfe, 0x00]).unwrap();
    let error = load_stereo(&[directory.path().join("x.yaml")]).unwrap_err().to_string();
    assert!(error.ends_with("x.yaml: is not text, so not a calibration; give a YAML or JSON file"), "{error}");
}
