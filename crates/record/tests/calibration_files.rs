//! Calibration files: files written by independent software, round trips, and no panics on damaged files.

#![allow(clippy::unwrap_used, reason = "helpers of tests may fail loudly, as tests do")]

use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig, so3};
use pb3dp_record::calibration_files::{
    CalibrationFileError, CalibrationFormat, CameraIdentity, Judgement, StereoCalibration, load_stereo,
    load_stereo_for, parse_euroc, save_json, save_judged, save_kalibr, save_opencv, save_ros_pair,
};
use proptest::prelude::*;

const SIZE: ImageSize = ImageSize { width: 640, height: 480 };

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn rig(lenses: [Distortion; 2]) -> StereoRig {
    let camera = |pinhole, lens| Camera::new(SIZE, pinhole, lens).unwrap();
    let left = camera(Pinhole { fx: 742.5, fy: 738.25, cx: 331.25, cy: 228.5 }, lenses[0]);
    let right = camera(Pinhole { fx: 735.0, fy: 731.5, cx: 318.75, cy: 240.125 }, lenses[1]);
    let rotation = so3::exp(&Vector3::new(0.013, -0.041, 0.007));
    StereoRig::new(left, right, Pose::from_parts(Vector3::new(-0.0985, 0.00125, 0.00275), rotation)).unwrap()
}

const FIVE: Distortion = Distortion::BrownConrady5 { coefficients: [-0.31, 0.12, 0.0011, -0.0007, -0.018] };
const FOUR: Distortion = Distortion::BrownConrady5 { coefficients: [-0.31, 0.12, 0.0011, -0.0007, 0.0] };
const EIGHT: Distortion =
    Distortion::BrownConrady8 { coefficients: [0.42, -0.21, -0.0009, 0.0013, 0.05, 0.71, -0.13, 0.02] };
const WIDE: Distortion = Distortion::Equidistant { coefficients: [-0.012, 0.0043, -0.0021, 0.0004] };

/// Largest relative difference of the pinholes, and of the pose in metres and radians; the distortions must be equal.
fn difference(a: &StereoRig, b: &StereoRig) -> f64 {
    let mut worst = 0.0_f64;
    for (a, b) in [(a.left(), b.left()), (a.right(), b.right())] {
        assert_eq!(a.distortion(), b.distortion());
        assert_eq!(a.size(), b.size());
        worst = worst.max((a.pinhole().matrix() - b.pinhole().matrix()).amax() / a.pinhole().fx);
    }
    let (a, b) = (a.cam_right_from_cam_left(), b.cam_right_from_cam_left());
    worst.max((a.to_homogeneous() - b.to_homogeneous()).amax())
}

#[test]
fn file_written_by_opencv_is_read() {
    let calibration = load_stereo(&[data("opencv_4_14_stereo.yaml")]).unwrap();
    assert_eq!(calibration.format, CalibrationFormat::OpenCv);
    assert!(difference(&calibration.rig, &rig([FIVE, EIGHT])) < 1e-14);
    assert_eq!(calibration.notes.len(), 1, "{:?}", calibration.notes);
    assert!(calibration.notes[0].contains("millimetres are assumed"), "{:?}", calibration.notes);
    assert!(calibration.source.ends_with("opencv_4_14_stereo.yaml"));
}

#[test]
fn ros_pair_rectified_by_opencv_gives_back_the_pose() {
    let directory = load_stereo(&[data("ros_pair")]).unwrap();
    assert_eq!(directory.format, CalibrationFormat::RosPair);
    assert!(difference(&directory.rig, &rig([FIVE, EIGHT])) < 1e-12, "{:?}", directory.rig);
    let files = load_stereo(&[data("ros_pair/left.yaml"), data("ros_pair/right.yaml")]).unwrap();
    assert_eq!(files, directory);
}

/// As Kalibr's wiki shows a camchain, with the camera-IMU and topic keys that it adds; the transform is the one of the
/// other files, from `cv2.Rodrigues([0.013, -0.041, 0.007])` of OpenCV 4.14.0.
const KALIBR: &str = "cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.31, 0.12, 0.0011, -0.0007]
  distortion_model: radtan
  intrinsics: [742.5, 738.25, 331.25, 228.5]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.99913513687758537, -0.0072642425393967137, -0.04094153193198221, -0.0985]
  - [0.0067313268813077153, 0.99989101724815821, -0.013139363183216535, 0.00125]
  - [0.041032517532143743, 0.012852408598091688, 0.99907514637198436, 0.00275]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.012, 0.0043, -0.0021, 0.0004]
  distortion_model: equidistant
  intrinsics: [735.0, 731.5, 318.75, 240.125]
  resolution: [640, 480]
  rostopic: /cam1/image_raw
";

const JSON: &str = r#"{
 "image_size": [640, 480], "rectified": false, "distortion": "none (undistorted)",
 "K_left": [[742.5, 0, 331.25], [0, 738.25, 228.5], [0, 0, 1]],
 "K_right": [[735.0, 0, 318.75], [0, 731.5, 240.125], [0, 0, 1]],
 "R": [[0.99913513687758537, -0.0072642425393967137, -0.04094153193198221],
       [0.0067313268813077153, 0.99989101724815821, -0.013139363183216535],
       [0.041032517532143743, 0.012852408598091688, 0.99907514637198436]],
 "t_mm": [-98.5, 1.25, 2.75],
 "baseline_mm": 98.546,
 "doffs_px": -12.5,
 "convention": "X_right = R X_left + t; x right, y down, z forward; pixel centres at integers",
 "source": "made for this test"
}
"#;

/// Loads texts as files.
fn load_texts(files: &[(&str, &str)]) -> Result<StereoCalibration, CalibrationFileError> {
    let directory = tempfile::tempdir().unwrap();
    let paths = files.iter().map(|(name, text)| {
        let path = directory.path().join(name);
        fs::write(&path, text).unwrap();
        path
    });
    load_stereo(&paths.collect::<Vec<_>>())
}

#[test]
fn camchain_and_case_calibration_are_read() {
    let kalibr = load_texts(&[("camchain.yaml", KALIBR)]).unwrap();
    assert_eq!(kalibr.format, CalibrationFormat::Kalibr);
    assert!(difference(&kalibr.rig, &rig([FOUR, WIDE])) < 1e-14);
    let json = load_texts(&[("calib.json", JSON)]).unwrap();
    assert_eq!(json.format, CalibrationFormat::CaseJson);
    assert!(difference(&json.rig, &rig([Distortion::None, Distortion::None])) < 1e-14);
    let lens = r#""distortion_right": {"model": "rational_polynomial", "coefficients":
        [0.42, -0.21, -0.0009, 0.0013, 0.05, 0.71, -0.13, 0.02]}, "source""#;
    let json = load_texts(&[("calib.json", &JSON.replace("\"source\"", lens))]).unwrap();
    assert!(difference(&json.rig, &rig([Distortion::None, EIGHT])) < 1e-14);
}

#[test]
fn a_calibration_of_no_cameras_is_known_by_its_own_words() {
    let nominal = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/calibration/nominal.json");
    let text = std::fs::read_to_string(&nominal).unwrap();
    let says = load_stereo(&[nominal]).unwrap().not_measured.unwrap();
    assert!(says.starts_with("none: the numbers of the drawing"), "{says}");
    // Other texts and other types are notes.
    for other in ["\"0.2 px rms of 40 boards\"", "{\"rms_px\": 0.2}"] {
        let text = text.replace(&format!("\"{says}\""), other);
        assert_eq!(load_texts(&[("calib.json", &text)]).unwrap().not_measured, None, "{other}");
    }
}

#[test]
fn other_spellings_of_opencv_files_are_read() {
    let text = fs::read_to_string(data("opencv_4_14_stereo.yaml")).unwrap();
    let spelled = text
        .replace("M1:", "cameraMatrix1:")
        .replace("M2:", "cameraMatrix2:")
        .replace("D1:", "distCoeffs1:")
        .replace("D2:", "distCoeffs2:")
        .replace("image_width: 640\nimage_height: 480", "imageSize: [640, 480]\nunits: mm");
    let calibration = load_texts(&[("stereo.yml", &spelled)]).unwrap();
    assert!(difference(&calibration.rig, &rig([FIVE, EIGHT])) < 1e-14);
    assert_eq!(calibration.notes, Vec::<String>::new(), "the unit is stated");
    // Split as in OpenCV's stereo sample, and in metres.
    let cut = text.find("R: !!").unwrap();
    let extrinsics =
        format!("%YAML:1.0\n---\n{}", text[cut..].replace("-98.5, 1.25, 2.75", "-0.0985, 0.00125, 0.00275"));
    let calibration = load_texts(&[("intrinsics.yml", &text[..cut]), ("extrinsics.yml", &extrinsics)]).unwrap();
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("intrinsics.yml"), &text[..cut]).unwrap();
    fs::write(directory.path().join("extrinsics.yml"), &extrinsics).unwrap();
    let folder = [directory.path().to_path_buf()];
    assert_eq!(load_stereo(&folder).unwrap().rig, calibration.rig);
    save_judged(&rig([FIVE, EIGHT]), &judgement(), &directory.path().join("calibration.toml")).unwrap();
    assert_eq!(load_stereo(&folder).unwrap().format, CalibrationFormat::Judged);
    assert!(difference(&calibration.rig, &rig([FIVE, EIGHT])) < 1e-14);
    assert!(calibration.notes[0].contains("metres are assumed"));
}

/// A judgement with unknown contents.
fn judgement() -> Judgement {
    Judgement {
        date: String::new(),
        tool: String::new(),
        source: String::new(),
        cameras: [CameraIdentity::default(), CameraIdentity::default()],
        numbers: Vec::new(),
        covariance: None,
        gates: Vec::new(),
    }
}

/// Writes a rig in one format and reads it back.
fn there_and_back(format: CalibrationFormat, rig: &StereoRig) -> StereoCalibration {
    let directory = tempfile::tempdir().unwrap();
    let (left, right) = (directory.path().join("left.yaml"), directory.path().join("right.yaml"));
    let one = directory.path().join("calib.json");
    match format {
        CalibrationFormat::RosPair => {
            save_ros_pair(rig, &left, &right).unwrap();
            return load_stereo(&[left, right]).unwrap();
        }
        CalibrationFormat::EurocPair => panic!("this format is only read"),
        CalibrationFormat::Kalibr => save_kalibr(rig, &left).unwrap(),
        CalibrationFormat::OpenCv => save_opencv(rig, &left).unwrap(),
        CalibrationFormat::CaseJson => {
            save_json(rig, &one).unwrap();
            return load_stereo(&[directory.path().to_path_buf()]).unwrap();
        }
        CalibrationFormat::Judged => {
            let ours = directory.path().join("calibration.toml");
            save_judged(rig, &judgement(), &ours).unwrap();
            return load_stereo(&[ours]).unwrap();
        }
    }
    load_stereo(&[left]).unwrap()
}

const FORMATS: [CalibrationFormat; 5] = [
    CalibrationFormat::RosPair,
    CalibrationFormat::Kalibr,
    CalibrationFormat::OpenCv,
    CalibrationFormat::CaseJson,
    CalibrationFormat::Judged,
];

// The OpenCV file that `save_opencv` writes for `rig([FIVE, EIGHT])` was read once by OpenCV 4.14.0
// (`cv2.FileStorage(path, cv2.FILE_STORAGE_READ)`, PyPI opencv-python-headless 4.14.0.94): `getNode("M1").mat()` and the
// other matrices came back equal to the last bit, `getNode("units").string()` as "m". PyYAML 6.0.3 read the ROS pair.
#[test]
fn every_format_goes_there_and_back() {
    for format in FORMATS {
        for lenses in [[FOUR, WIDE], [Distortion::None, FOUR], [FIVE, EIGHT], [WIDE, FIVE]] {
            if format == CalibrationFormat::Kalibr && lenses.iter().any(|lens| [FIVE, EIGHT].contains(lens)) {
                continue;
            }
            let back = there_and_back(format, &rig(lenses));
            assert_eq!(back.format, format);
            assert!(back.notes.is_empty(), "{format}: {:?}", back.notes);
            assert!(difference(&back.rig, &rig(lenses)) < 1e-12, "{format}: {:?}", back.rig);
        }
    }
}

#[test]
fn rectified_rigs_stay_rectified() {
    let rectified = rig([FIVE, EIGHT]).rectify().unwrap().rig;
    for format in FORMATS {
        let back = there_and_back(format, &rectified).rig;
        assert!(back.is_rectified(), "{format}: {back:?}");
        assert!(difference(&back, &rectified) < 1e-12);
    }
}

#[test]
fn what_a_format_can_not_hold_is_refused_on_writing() {
    let path = tempfile::tempdir().unwrap().path().join("camchain.yaml");
    let error = save_kalibr(&rig([FOUR, FIVE]), &path).unwrap_err();
    assert!(
        error.to_string().contains("Kalibr camchain cannot hold this calibration: its radtan model has no k3"),
        "{error}"
    );
    assert!(!path.exists());
    let error = save_opencv(&rig([FOUR, FIVE]), &path).unwrap_err();
    assert!(matches!(error, CalibrationFileError::Write { .. }), "the directory is gone: {error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn any_rig_goes_there_and_back(
        turn in prop::array::uniform3(-0.3..0.3_f64),
        centre in (0.05..0.8_f64, -0.02..0.02_f64, -0.02..0.02_f64),
        pinholes in prop::array::uniform2((500.0..900.0_f64, 500.0..900.0_f64, 250.0..390.0_f64, 190.0..290.0_f64)),
        coefficients in prop::array::uniform4(-0.01..0.01_f64),
        format in prop::sample::select(FORMATS.to_vec()),
    ) {
        let [a, b, c, d] = coefficients;
        let lenses = [Distortion::Equidistant { coefficients }, Distortion::BrownConrady5 { coefficients: [a, b, c, d, 0.0] }];
        let [left, right] = [0, 1].map(|i| {
            let (fx, fy, cx, cy) = pinholes[i];
            Camera::new(SIZE, Pinhole { fx, fy, cx, cy }, lenses[i]).unwrap()
        });
        let rotation = so3::exp(&Vector3::from(turn));
        let translation_m = -(rotation * Vector3::new(centre.0, centre.1, centre.2));
        let rig = StereoRig::new(left, right, Pose::from_parts(translation_m, rotation)).unwrap();
        prop_assert!(difference(&there_and_back(format, &rig).rig, &rig) < 1e-12);
    }
}

/// Base texts of the fuzz tests.
fn good_files() -> Vec<(&'static str, String)> {
    vec![
        ("camchain.yaml", KALIBR.to_owned()),
        ("calib.json", JSON.to_owned()),
        ("stereo.yaml", fs::read_to_string(data("opencv_4_14_stereo.yaml")).unwrap()),
        ("left.yaml", fs::read_to_string(data("ros_pair/left.yaml")).unwrap()),
        ("right.yaml", fs::read_to_string(data("ros_pair/right.yaml")).unwrap()),
    ]
}

/// Loads damaged bytes alone and beside a good file. Any answer is accepted, a panic is not. An error must name the file.
fn load_damaged(name: &str, bytes: &[u8]) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join(name);
    fs::write(&path, bytes).unwrap();
    let other = data("ros_pair/right.yaml");
    for paths in [vec![path.clone()], vec![path.clone(), other.clone()], vec![other, path.clone()]] {
        if let Err(error) = load_stereo(&paths) {
            let text = error.to_string();
            assert!(text.contains(name) || text.contains("right.yaml"), "{text}");
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), json: bool) {
        load_damaged(if json { "x.json" } else { "x.yaml" }, &bytes);
    }

    #[test]
    fn mutated_files_never_panic(
        which in 0_usize..5,
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<prop::sample::Index>(), 0..4), 1..4),
        token in prop::sample::select(vec![
            "", "0", "-1", ".nan", ".inf", "1e400", "[", "]", "{", "}", ":", "\n", "- ", "null", "~", "\"", "&a ", "*a",
            "!!x ", "99999999999999999999", "é", "\u{0}", "1e-320", "[[[[[[[[", "-",
        ]),
    ) {
        let (name, text) = good_files().swap_remove(which);
        let mut text: Vec<char> = text.chars().collect();
        for (from, length, kind) in edits {
            let at = from.index(text.len());
            let end = (at + length.index(12)).min(text.len());
            match kind {
                0 => drop(text.splice(at..end, token.chars())),
                1 => drop(text.splice(at..at, token.chars())),
                2 => text.truncate(at.max(1)),
                _ => { text.remove(at); }
            }
            if text.is_empty() { break }
        }
        load_damaged(name, text.into_iter().collect::<String>().as_bytes());
    }
}

#[test]
fn the_two_files_of_opencvs_stereo_sample_get_their_size_from_the_images() {
    let text = std::fs::read_to_string(data("opencv_4_14_stereo.yaml")).unwrap();
    let whole = load_stereo(&[data("opencv_4_14_stereo.yaml")]).unwrap();
    let size = whole.rig.left().size();
    let sizeless: String = text.lines().filter(|l| !l.contains("image_")).map(|l| format!("{l}\n")).collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("stereo.yml");
    std::fs::write(&file, sizeless).unwrap();
    let read = load_stereo_for(std::slice::from_ref(&file), size).unwrap();
    assert_eq!(read.rig, whole.rig);
    assert!(read.notes.iter().any(|note| note.contains("image size")), "{:?}", read.notes);
    assert!(load_stereo(&[file]).unwrap_err().to_string().contains("image_width"));
}

/// The body is neither camera: turned by a third about (1, 1, 1), which maps x to y, y to z and z to x.
#[test]
fn cameras_of_euroc_have_their_poses_in_the_body() {
    let yaml = |pose: &str, distortion: &str| {
        format!(
            "%YAML:1.0\n---\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{pose}]\nrate_hz: 20\n\
             resolution: [752, 480]\ncamera_model: pinhole\nintrinsics: [458.6, 457.2, 367.2, 248.3]\n{distortion}"
        )
    };
    let distorted = "distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 0.00002]\n";
    let [left, right] = [Path::new("cam0/sensor.yaml"), Path::new("cam1/sensor.yaml")];
    // The left camera is at (0.1, 0.2, 0.3), the right one 110 mm along the x axis of the left one, which is y of the body.
    let turn = ["0, 0, 1", "1, 0, 0", "0, 1, 0"];
    let pose = |at: [f64; 3]| {
        let row = |k: usize| format!("{}, {}", turn[k], at[k]);
        format!("{}, {}, {}, 0, 0, 0, 1", row(0), row(1), row(2))
    };
    let texts = [yaml(&pose([0.1, 0.2, 0.3]), distorted), yaml(&pose([0.1, 0.31, 0.3]), distorted)];
    let found = parse_euroc([left, right], [&texts[0], &texts[1]]).unwrap();
    let between = found.rig.cam_right_from_cam_left();
    assert!((between.translation_m() - Vector3::new(-0.11, 0.0, 0.0)).norm() < 1e-12, "{between:?}");
    assert!(between.rotation_angle_rad() < 1e-12);
    assert!(matches!(found.rig.left().distortion(), Distortion::BrownConrady5 { .. }));
    assert_eq!(found.source, "cam0/sensor.yaml, cam1/sensor.yaml");

    let refused = |text: &str, parts: &[&str]| {
        let message = parse_euroc([left, right], [&texts[0], text]).unwrap_err().to_string();
        assert!(parts.iter().chain(&["cam1/sensor.yaml"]).all(|part| message.contains(part)), "{message}");
    };
    refused(&texts[1].replace("0, 0, 0, 1]", "0, 0, 1, 1]"), &["T_BS", "0, 0, 0, 1"]);
    refused(&texts[1].replace("0, 0, 1, 0.1", "0, 0, 2, 0.1"), &["T_BS"]);
    refused(&texts[1].replace("radial-tangential", "omni"), &["distortion_model", "omni"]);
    refused(&texts[1].replace("pinhole", "omni"), &["camera_model", "omni"]);
    refused(&texts[1].replace("248.3", "248.3, 1"), &["intrinsics", "5"]);
}
