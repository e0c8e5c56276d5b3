//! `pb3dp estimate` and its relatives with calibrations in every form.

use std::path::Path;

use pb3dp_record::calibration_files::{save_kalibr, save_opencv, save_ros_pair};
use pb3dp_record::images::{StoredFormat, save};
use pb3dp_sim::targets::TargetConfig;
use serde_json::Value;

use crate::cli::estimate::OnePair;
use crate::cli::support::*;

#[test]
fn every_calibration_format_gives_the_same_answer() {
    let pair = OnePair::of(TargetConfig::crab(0.0));
    let region = format!("click:{:.0},{:.0}", pair.centre_px()[0], pair.centre_px()[1]);
    save_kalibr(&rig(), &pair.file("camchain.yaml")).unwrap();
    save_opencv(&rig(), &pair.file("stereo.yaml")).unwrap();
    let (left, right) = (pair.file("left.yaml"), pair.file("right.yaml"));
    save_ros_pair(&rig(), &left, &right).unwrap();
    let ros = format!("{},{}", left.display(), right.display());
    for (method, apart_max_mm) in [("published", 1.0), ("direct", 0.02)] {
        let run = |calibration: &Path| {
            let what = format!("{method}, {}", calibration.display());
            pair.assert_near_truth(method, pair.estimate(method, &calibration, &region), &what)
        };
        let expected = run(&pair.file("calib.json"));
        for calibration in [pair.file("camchain.yaml"), pair.file("stereo.yaml"), ros.clone().into()] {
            let line = run(&calibration);
            let apart_mm = line["z_mm"].as_f64().unwrap() - expected["z_mm"].as_f64().unwrap();
            assert!(apart_mm.abs() < apart_max_mm, "{}: {line} instead of {expected}", calibration.display());
        }
    }
}

/// OpenCV's stereo sample states neither size nor unit, and `cv::fisheye` no lens model.
#[test]
fn what_a_calibration_leaves_unstated_is_used_with_a_warning_or_refused() {
    let pair = OnePair::of(TargetConfig::crab(0.0));
    let region = format!("click:{:.0},{:.0}", pair.centre_px()[0], pair.centre_px()[1]);
    let file = pair.file("stereo.yaml");
    save_opencv(&rig(), &file).unwrap();
    let whole = std::fs::read_to_string(&file).unwrap();
    let bare = whole.lines().filter(|line| !["image_", "units", "distortion_"].iter().any(|key| line.starts_with(key)));
    let bare: String = bare.map(|line| format!("{line}\n")).collect();
    std::fs::write(&file, &bare).unwrap();
    let expected = pair.estimate("direct", &pair.file("calib.json"), &region).assert_success();
    let found = pair.estimate("direct", &file, &region).assert_success();
    let line = &found.json_lines(&ESTIMATE_KEYS)[0];
    let apart_mm = line["z_mm"].as_f64().unwrap() - expected.json_lines(&ESTIMATE_KEYS)[0]["z_mm"].as_f64().unwrap();
    assert!(apart_mm.abs() < 0.02, "{line}");
    let warnings = line["warnings"].to_string();
    assert!(warnings.contains("--calib-size") && warnings.contains("--calib-unit"), "{warnings}");
    // `track` reads the same file in the same way, and `calibrate convert` once the size is stated.
    let sequence = pair.dir.path().join("sequence");
    for (side, image) in [("left", &pair.left), ("right", &pair.right)] {
        std::fs::create_dir_all(sequence.join(side)).unwrap();
        save(image, &sequence.join(side).join("0.png"), StoredFormat::Png).unwrap();
    }
    let z_range = "350,650";
    let track = |more: &[&dyn AsRef<std::ffi::OsStr>]| {
        let args: [&dyn AsRef<std::ffi::OsStr>; 10] = [
            &"track",
            &"--sequence",
            &sequence,
            &"--calib",
            &file,
            &"--region",
            &region,
            &"--z-range",
            &z_range,
            &"--json",
        ];
        pb3dp(&words(&[&args, more].concat()))
    };
    let tracked = track(&[]).assert_success();
    let warnings = tracked.json_lines(&TRACK_KEYS)[0]["warnings"].to_string();
    assert!(warnings.contains("--calib-size") && warnings.contains("--calib-unit"), "{warnings}");
    track(&[&"--rectified"]).assert_success();
    let out = pair.file("converted.json");
    let convert = |more: &[&dyn AsRef<std::ffi::OsStr>]| {
        let args: [&dyn AsRef<std::ffi::OsStr>; 5] = [&"calibrate", &"convert", &file, &"--out", &out];
        pb3dp(&words(&[&args, more].concat()))
    };
    convert(&[]).assert_refused(&["image_width: is missing", "--calib-size WxH"]);
    let size = rig().left().size();
    let size = format!("{}x{}", size.width, size.height);
    convert(&[&"--size", &size]).assert_success();
    convert(&[&"--calib-size", &size, &"--calib-unit", &"m"]).assert_success();
    let converted = pb3dp_record::calibration_files::load_stereo(&[out]).unwrap();
    assert!((converted.rig.baseline_m() - rig().baseline_m()).abs() < 1e-12);
    // Stated values that contradict the file.
    std::fs::write(&file, &whole).unwrap();
    track(&[&"--calib-unit", &"mm"]).assert_refused(&["units: is m, --calib-unit states mm"]);
    track(&[&"--calib-size", &"320x240"]).assert_refused(&["--calib-size 320x240: the file states"]);
    extracting_decides_the_lens_model(pair.dir.path(), &sequence, &bare);
    // The unit of centimetres.
    let in_cm = bare.replace("T: !!opencv-matrix", "was_T: !!opencv-matrix");
    let t = rig().cam_right_from_cam_left().translation_m() * 100.0;
    std::fs::write(&file, format!("{in_cm}T: [{}, {}, {}]\n", 2.0 * t.x, 2.0 * t.y, 2.0 * t.z)).unwrap();
    track(&[]).assert_refused(&["T: has length", "--calib-unit mm or --calib-unit cm"]);
}

/// Images are at hand where a recording is unpacked; `bare` is a calibration without lens model.
fn extracting_decides_the_lens_model(folder: &Path, sequence: &Path, bare: &str) {
    let [intrinsics, extrinsics] = ["intrinsics.yml", "extrinsics.yml"].map(|name| sequence.join(name));
    let four = bare.replace("D1: !!", "was_D1: !!").replace("D2: !!", "was_D2: !!");
    std::fs::write(&intrinsics, four + "D1: [0.0001, 0, 0, 0]\nD2: [0.0001, 0, 0, 0]\n").unwrap();
    std::fs::write(&extrinsics, "%YAML:1.0\n---\nnothing: 0\n").unwrap();
    let out = folder.join("extracted");
    let extracted = pb3dp(&words(&[&"extract", &sequence, &"--out", &out])).assert_success();
    assert!(extracted.stderr.contains("no lens model: Brown-Conrady (k1 k2 p1 p2) is used"), "{}", extracted.stderr);
    let decided = pb3dp_record::calibration_files::load_stereo(&[out.join("calib.json")]).unwrap();
    assert!((decided.rig.baseline_m() - rig().baseline_m()).abs() < 1e-12);
}

/// A case may have any calibration: its size is that of the images, too.
#[test]
fn a_case_with_a_calibration_without_size_is_read() {
    let dir = tempfile::tempdir().unwrap();
    copy_of_real_cases(dir.path());
    let folder = dir.path().join("bb201_c0");
    let case = pb3dp_record::dataset::load_case(&folder).unwrap();
    let file = folder.join("stereo.yml");
    save_opencv(&case.load_calibration().unwrap().rig, &file).unwrap();
    let text = std::fs::read_to_string(&file).unwrap();
    let bare: String = text.lines().filter(|line| !line.contains("image_")).map(|line| format!("{line}\n")).collect();
    std::fs::write(&file, bare).unwrap();
    let run =
        || pb3dp(&words(&[&"estimate", &"--cases", &folder, &"--json"])).assert_success().json_lines(&ESTIMATE_KEYS);
    let expected = run();
    let description = std::fs::read_to_string(folder.join("case.json")).unwrap();
    let mut value: Value = serde_json::from_str(&description).unwrap();
    value["calib"] = Value::String("stereo.yml".to_owned());
    std::fs::write(folder.join("case.json"), value.to_string()).unwrap();
    let found = run();
    let apart_mm = found[0]["z_mm"].as_f64().unwrap() - expected[0]["z_mm"].as_f64().unwrap();
    assert!(apart_mm.abs() < 0.01 && found[0]["warnings"].to_string().contains("--calib-size"), "{found:?}");
}
