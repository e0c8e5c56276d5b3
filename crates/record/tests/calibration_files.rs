//! Calibration files: files written by independent software, round trips, and no panics on damaged files.

#![allow(clippy::unwrap_used, reason = "helpers of tests may fail loudly, as tests do")]

use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use pb3dp_geometry::{Camera, Distortion, ImageSize, Pinhole, Pose, StereoRig, so3};
use pb3dp_record::calibration_files::{
    CalibrationFileError, CalibrationFormat, CameraIdentity, Judgement, LengthUnit, LensModel, StatedCalibration,
    StereoCalibration, load_stated, load_stereo, load_stereo_for, parse_euroc, parse_ros_pair, save_json, save_judged,
    save_kalibr, save_opencv, save_ros_pair,
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

const MILLIMETRES: StatedCalibration =
    StatedCalibration { unit: Some(LengthUnit::Millimetres), size: None, lens: None, rectified: false };

#[test]
fn file_written_by_opencv_is_read() {
    let calibration = load_stated(&[data("opencv_4_14_stereo.yaml")], None, &MILLIMETRES).unwrap();
    assert_eq!(calibration.format, CalibrationFormat::OpenCv);
    assert!(difference(&calibration.rig, &rig([FIVE, EIGHT])) < 1e-14);
    assert!(calibration.notes.is_empty() && calibration.warnings.is_empty(), "{calibration:?}");
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
    // ROS drivers write the 14 coefficients of OpenCV under the same name.
    for more in ["", ", 0, 0, 0, 0", ", 0, 0, 0, 0, 0, 0"] {
        let lens = lens.replace("0.02]", &format!("0.02{more}]"));
        let json = load_texts(&[("calib.json", &JSON.replace("\"source\"", &lens))]).unwrap();
        assert!(difference(&json.rig, &rig([Distortion::None, EIGHT])) < 1e-14);
    }
    let prism = JSON.replace("\"source\"", &lens.replace("0.02]", "0.02, 0.001, 0, 0, 0]"));
    let refused = load_texts(&[("calib.json", &prism)]).unwrap_err().to_string();
    assert!(refused.contains("thin prism or tilt term, which is not supported"), "{refused}");
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
    assert_eq!(calibration.warnings, Vec::<String>::new(), "the unit is stated");
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
    assert!(calibration.warnings[0].contains("m is used, because the baseline is then 98.5 mm"), "{calibration:?}");
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
        let rectified = rig([FIVE, EIGHT]).rectify().unwrap().rig;
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
    let whole = load_stated(&[data("opencv_4_14_stereo.yaml")], None, &MILLIMETRES).unwrap();
    let size = whole.rig.left().size();
    let sizeless: String = text.lines().filter(|l| !l.contains("image_")).map(|l| format!("{l}\n")).collect();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("stereo.yml");
    std::fs::write(&file, sizeless + "units: mm\n").unwrap();
    let read = load_stereo_for(std::slice::from_ref(&file), size).unwrap();
    assert_eq!(read.rig, whole.rig);
    assert!(read.warnings.iter().any(|warning| warning.contains("image size")), "{:?}", read.warnings);
    let missing = load_stereo(std::slice::from_ref(&file)).unwrap_err().to_string();
    assert!(missing.contains("image_width") && missing.contains("--calib-size WxH"), "{missing}");
    // Images of half the size: the principal point is in their corner.
    let half = ImageSize { width: 320, height: 240 };
    let refused = load_stereo_for(std::slice::from_ref(&file), half).unwrap_err().to_string();
    assert!(refused.contains("--calib-size 640x480"), "{refused}");
    let stated = StatedCalibration { size: Some(size), ..StatedCalibration::default() };
    let scaled = load_stated(std::slice::from_ref(&file), Some(half), &stated).unwrap();
    let (left, of_whole) = (scaled.rig.left(), whole.rig.left());
    assert_eq!((left.size(), left.distortion()), (half, of_whole.distortion()));
    let Pinhole { fx, fy, cx, cy } = *of_whole.pinhole();
    let expected = Pinhole { fx: 0.5 * fx, fy: 0.5 * fy, cx: 0.5 * (cx + 0.5) - 0.5, cy: 0.5 * (cy + 0.5) - 0.5 };
    assert_eq!(*left.pinhole(), expected);
    let cut = load_stated(&[file], Some(ImageSize { width: 320, height: 200 }), &stated).unwrap_err().to_string();
    assert!(cut.contains("--calib-size 640x480") && cut.contains("cut off"), "{cut}");
}

/// An OpenCV file of a pair of cameras side by side: length of T, coefficients of both cameras, and more keys.
fn side_by_side(length: f64, coefficients: &str, more: &str) -> String {
    let camera = "[[700, 0, 321], [0, 700, 238], [0, 0, 1]]";
    format!(
        "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\nK1: {camera}\nK2: {camera}\nD1: {coefficients}\nD2: {coefficients}\n\
         R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: [-{length}, 0, 0]\n{more}\n"
    )
}

fn read_stated(text: &str, stated: StatedCalibration) -> Result<StereoCalibration, String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("stereo.yml");
    fs::write(&file, text).unwrap();
    load_stated(&[file], None, &stated).map_err(|error| error.to_string())
}

#[test]
fn an_unstated_unit_is_used_only_if_no_other_is_plausible() {
    let lens = "[0.1, 0, 0, 0, 0]";
    let read = |length, stated| read_stated(&side_by_side(length, lens, ""), stated);
    for (length, baseline_m, unit) in
        [(0.128, 0.128, "m"), (0.5, 0.5, "m"), (3.0, 0.03, "cm"), (64.3, 0.0643, "mm"), (500.0, 0.5, "mm")]
    {
        let found = read(length, StatedCalibration::default()).unwrap();
        assert!((found.rig.baseline_m() - baseline_m).abs() < 1e-12, "{length}");
        assert!(found.warnings.len() == 1 && found.warnings[0].contains(&format!(": {unit} is used")), "{found:?}");
        assert!(found.warnings[0].contains("mm (otherwise ") && found.warnings[0].contains(" mm with the unit "));
    }
    for (length, needed) in [
        (12.86, ["12.9 mm with the unit mm, 128.6 mm with the unit cm", "--calib-unit mm or --calib-unit cm"]),
        (1.5, ["15.0 mm with the unit cm, 1500.0 mm with the unit m", "--calib-unit cm or --calib-unit m"]),
        (0.004, ["none is plausible", "add the key units"]),
    ] {
        let refused = read(length, StatedCalibration::default()).unwrap_err();
        assert!(needed.iter().all(|needed| refused.contains(needed)), "{refused}");
    }
    // What is stated is never refused for being unusual.
    let centimetres = StatedCalibration { unit: Some(LengthUnit::Centimetres), ..StatedCalibration::default() };
    for (length, baseline_m) in [(12.86, 0.1286), (0.4, 0.004), (900.0, 9.0)] {
        let found = read(length, centimetres).unwrap();
        assert!((found.rig.baseline_m() - baseline_m).abs() < 1e-12 && found.warnings.is_empty(), "{found:?}");
    }
    let refused = read_stated(&side_by_side(64.3, lens, "units: mm"), centimetres).unwrap_err();
    assert!(refused.contains("units: is mm, --calib-unit states cm: leave the option out"), "{refused}");
    let refused = read_stated(KALIBR, centimetres).unwrap_err();
    assert!(refused.contains("--calib-unit cm: a Kalibr camchain states this itself"), "{refused}");
}

#[test]
fn four_coefficients_have_two_readings_until_the_lens_is_stated() {
    let text = |more: &str| side_by_side(64.3, "[-0.012, 0.041, -0.038, 0.008]", &format!("units: mm\n{more}"));
    let coefficients = [-0.012, 0.041, -0.038, 0.008];
    let equidistant = Distortion::Equidistant { coefficients };
    let [k1, k2, p1, p2] = coefficients;
    let brown = Distortion::BrownConrady5 { coefficients: [k1, k2, p1, p2, 0.0] };
    let open = read_stated(&text(""), StatedCalibration::default()).unwrap();
    let other = open.other_lens.unwrap();
    assert_eq!((open.rig.left().distortion(), other.right().distortion()), (&brown, &equidistant));
    let refused = open.clone().decided().unwrap_err().to_string();
    assert!(refused.contains("--calib-lens brown or --calib-lens equidistant"), "{refused}");
    assert!(load_texts(&[("stereo.yml", &text(""))]).is_err(), "no command uses one of them in silence");
    assert_eq!(open.with_lens(LensModel::Equidistant, "it fits").rig, other);
    let lens = |lens| StatedCalibration { lens: Some(lens), ..StatedCalibration::default() };
    for (stated, more, expected) in [
        (lens(LensModel::BrownConrady), "", &brown),
        (lens(LensModel::Equidistant), "", &equidistant),
        (StatedCalibration::default(), "distortion_model: fisheye", &equidistant),
        (StatedCalibration::default(), "distortion_model: plumb_bob", &brown),
        (lens(LensModel::Equidistant), "distortion_model: fisheye", &equidistant),
    ] {
        let found = read_stated(&text(more), stated).unwrap();
        assert_eq!(
            (found.rig.left().distortion(), found.other_lens, found.warnings.len()),
            (expected, None, 0),
            "{more}"
        );
    }
    let refused = read_stated(&text("distortion_model: plumb_bob"), lens(LensModel::Equidistant)).unwrap_err();
    assert!(refused.contains("distortion_model: states the lens model Brown-Conrady"), "{refused}");
    let zeros = read_stated(&side_by_side(0.0643, "[0, 0, 0, 0]", ""), StatedCalibration::default()).unwrap();
    assert_eq!((zeros.rig.left().distortion(), zeros.other_lens), (&Distortion::None, None));
}

#[test]
fn rectified_images_have_the_projection_matrices() {
    let rectified = StatedCalibration { rectified: true, ..StatedCalibration::default() };
    let pair = [data("ros_pair/left.yaml"), data("ros_pair/right.yaml")];
    let raw = load_stereo(&pair).unwrap();
    let found = load_stated(&pair, None, &rectified).unwrap().rig;
    assert!(found.is_rectified() && *found.left().distortion() == Distortion::None, "{found:?}");
    assert!((found.baseline_m() - raw.rig.baseline_m()).abs() < 1e-9);
    let text = fs::read_to_string(&pair[0]).unwrap();
    let p = text.split("projection_matrix").nth(1).unwrap();
    assert!(
        p.contains(&format!("{:?}", found.left().pinhole().fx))
            && p.contains(&format!("{:?}", found.left().pinhole().cy)),
        "{found:?} {p}"
    );
    // Without matrices: the rectified cameras of the rig; P1 and P2 of OpenCV, if they are there.
    let kalibr = read_stated(KALIBR, rectified).unwrap().rig;
    assert_eq!(kalibr, load_texts(&[("camchain.yaml", KALIBR)]).unwrap().rig.rectify().unwrap().rig);
    let p = "units: mm\nP1: [[650, 0, 300, 0], [0, 650, 240, 0], [0, 0, 1, 0]]\nP2: [[650, 0, 310, -41795], [0, 650, 240, 0], [0, 0, 1, 0]]";
    let opencv = read_stated(&side_by_side(64.3, "[0.1, 0, 0, 0]", p), rectified).unwrap().rig;
    assert!((opencv.baseline_m() - 0.0643).abs() < 1e-12 && opencv.right().pinhole().cx == 310.0, "{opencv:?}");
}

/// A `camera_info` pair of this size and camera matrix, with more lines, for images of this size.
fn window_pair(
    (width, height): (u32, u32),
    [fx, cx, cy]: [f64; 3],
    more: &str,
    images: Option<ImageSize>,
) -> Result<StereoCalibration, CalibrationFileError> {
    let text = |shift: f64| {
        format!(
            "image_width: {width}\nimage_height: {height}\ncamera_matrix: [[{fx}, 0, {cx}], [0, {fx}, {cy}], [0, 0, 1]]\n\
             distortion_model: plumb_bob\ndistortion_coefficients: [0.1, 0, 0, 0, 0]\n\
             rectification_matrix: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n\
             projection_matrix: [[{fx}, 0, {cx}, {}], [0, {fx}, {cy}, 0], [0, 0, 1, 0]]\n{more}\n",
            -fx * shift
        )
    };
    parse_ros_pair([Path::new("left.yaml"), Path::new("right.yaml")], [&text(0.0), &text(0.1)], images)
}

/// The images have 640x480 pixels, a focal length of 700 pixels, and the principal point (325, 235).
#[test]
fn binning_and_roi_of_a_camera_info_are_applied() {
    let binning = "binning_x: 2\nbinning_y: 2";
    let roi = "roi: {x_offset: 200, y_offset: 150, width: 640, height: 480, do_rectify: false}";
    let both = "binning_x: 2\nbinning_y: 2\nroi: {x_offset: 100, y_offset: 60, width: 1280, height: 960}";
    let of_binned = [1400.0, 650.5, 470.5];
    let check = |size, matrix, more: &str, images, (notes, warnings): (usize, usize)| {
        let read = window_pair(size, matrix, more, images).unwrap();
        let camera = read.rig.right();
        assert_eq!((camera.size(), read.rig.baseline_m()), (SIZE, 0.1), "{more}");
        assert_eq!(*camera.pinhole(), Pinhole { fx: 700.0, fy: 700.0, cx: 325.0, cy: 235.0 }, "{more}");
        assert_eq!((read.notes.len(), read.warnings.len()), (notes, warnings), "{:?} {:?}", read.notes, read.warnings);
    };
    // The size is that of the sensor, as ROS defines it; the size of the images need not be known.
    for images in [None, Some(SIZE)] {
        check((1280, 960), of_binned, binning, images, (1, 0));
        check((1280, 960), [700.0, 525.0, 385.0], roi, images, (1, 0));
        check((1500, 1100), [1400.0, 750.5, 530.5], both, images, (1, 0));
        check((640, 480), [700.0, 325.0, 235.0], "binning_x: 1\nroi: {width: 640, height: 480}", images, (0, 0));
        check((640, 480), [700.0, 325.0, 235.0], "binning_x: 0\nroi: {x_offset: 0}", images, (0, 0));
    }
    // A small part in a corner of the sensor does not contain the principal point.
    let corner = "roi: {x_offset: 1920, y_offset: 1440, width: 640, height: 480}";
    let far = window_pair((2560, 1920), [700.0, 1279.5, 959.5], corner, Some(SIZE)).unwrap();
    assert_eq!((far.rig.left().pinhole().cx, far.rig.left().pinhole().cy), (-640.5, -480.5));
    far.rig.rectify().unwrap();
    // The size is that of the images; the camera matrix is that of the sensor, or of the images.
    check((640, 480), of_binned, binning, Some(SIZE), (0, 1));
    check((640, 480), [700.0, 525.0, 385.0], roi, Some(SIZE), (0, 1));
    check((640, 480), [700.0, 325.0, 235.0], binning, Some(SIZE), (0, 1));
}

#[test]
fn binning_and_roi_that_can_be_read_in_two_ways_are_refused() {
    let refused = |size, matrix, more: &str, parts: &[&str]| {
        let error = window_pair(size, matrix, more, Some(SIZE)).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{error}");
    };
    let small = "roi: {x_offset: 40, y_offset: 30, width: 640, height: 480}";
    let small_in_both = ["left.yaml: roi: roi of 640x480 at (40, 30)", "(285.0, 205.0)", "(325.0, 235.0)", "both are"];
    refused((640, 480), [700.0, 325.0, 235.0], small, &small_in_both);
    refused((640, 480), [700.0, 960.0, 235.0], "binning_x: 2", &["binning_x: binning 2x1", "neither is", "--calib"]);
    // The window has another size than the images.
    let other = "roi: {x_offset: 200, y_offset: 150, width: 320, height: 240}";
    refused(
        (1280, 960),
        [700.0, 525.0, 385.0],
        other,
        &["images have 640x480", "the stated size 1280x960", "320x240 at"],
    );
    refused((640, 480), [700.0, 525.0, 385.0], other, &["neither is"]);
    refused((640, 480), [700.0, 525.0, 385.0], "binning_y: 1.5", &["binning_y: 1.5 is not a number of pixels"]);
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
