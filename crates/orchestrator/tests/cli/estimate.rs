//! `pb3dp estimate` where it can answer.

use std::path::{Path, PathBuf};

use image::{GrayImage, Luma, RgbImage};
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_record::calibration_files::{save_json, save_kalibr, save_opencv, save_ros_pair};
use pb3dp_record::dataset::{CaseDraft, Hardness, PlaneTruth, SearchRange, write_case};
use pb3dp_record::images::{PictureFormat, save};
use pb3dp_sim::scene::SceneObject;
use pb3dp_sim::targets::TargetConfig;
use serde_json::Value;

use crate::support::*;

/// A rendered flat target that is seen obliquely, in files, with its truth.
struct OnePair {
    dir: tempfile::TempDir,
    outline_px: Vec<[f64; 2]>,
    mask: GrayImage,
    left: RgbImage,
    right: RgbImage,
    cam_left_from_target: Pose<CamLeft, Target>,
}

impl OnePair {
    fn of(target: TargetConfig) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut renderer = renderer(target);
        let (scene_poses, cam_left_from_target) = poses([0.012, -0.008, 0.48], [0.2, -0.26, 0.15]);
        let (left, right) = render(&mut renderer, &scene_poses, 3);
        save(&left, &dir.path().join("left.png"), PictureFormat::Png).unwrap();
        save(&right, &dir.path().join("right.png"), PictureFormat::Png).unwrap();
        save_json(&rig(), &dir.path().join("calib.json")).unwrap();
        let outline = renderer.target_outline_px(&scene_poses).unwrap();
        let truth = renderer.ground_truth(&scene_poses);
        let inside = |u, v| truth.object[(v * left.width() + u) as usize] == SceneObject::Target;
        let mask = GrayImage::from_fn(left.width(), left.height(), |u, v| Luma([if inside(u, v) { 255 } else { 0 }]));
        let outline_px = outline.iter().map(|p| [p.x, p.y]).collect();
        Self { dir, outline_px, mask, left, right, cam_left_from_target }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn centre_px(&self) -> [f64; 2] {
        let centre = self.cam_left_from_target.translation_m();
        rig().left().project(&centre.into()).map(|p| [p.x, p.y]).unwrap()
    }

    fn estimate(&self, calibration: &dyn AsRef<std::ffi::OsStr>, region: &str) -> Finished {
        let (left, right) = (self.file("left.png"), self.file("right.png"));
        let z_range = "350,650";
        pb3dp(&words(&[
            &"estimate",
            &"--left",
            &left,
            &"--right",
            &right,
            &"--calib",
            calibration,
            &"--region",
            &region,
            &"--z-range",
            &z_range,
            &"--tilt-max",
            &"35",
            &"--json",
        ]))
    }

    /// The one line, which must be an answer near the truth.
    fn assert_near_truth(&self, finished: Finished, what: &str) -> Value {
        let finished = finished.assert_success();
        let lines = finished.json_lines(&ESTIMATE_KEYS);
        let [line] = &lines[..] else { panic!("{what}: one line for one pair: {}", finished.stdout) };
        assert!(["ok", "weak-tilt"].contains(&line["status"].as_str().unwrap()), "{what}: {line}\n{}", finished.stderr);
        let (z_mm, true_mm) =
            (line["z_mm"].as_f64().unwrap(), true_depth_mm(&self.cam_left_from_target, self.centre_px()));
        assert!((z_mm / true_mm - 1.0).abs() < 0.03, "{what}: {z_mm} mm, true at the centre {true_mm} mm");
        let normal = nalgebra::Vector3::from_vec(numbers(&line["normal"]));
        let away = self.cam_left_from_target.transform_vector(&nalgebra::Vector3::z());
        assert!((normal.norm() - 1.0).abs() < 1e-9 && normal.z < 0.0, "{what}: {normal}");
        let off_deg = normal.angle(&-away).to_degrees();
        assert!(off_deg < 10.0, "{what}: the normal is off by {off_deg} degrees");
        line.clone()
    }
}

#[test]
fn real_cases_give_one_line_each_and_a_table_of_errors() {
    let dir = tempfile::tempdir().unwrap();
    let overlay = dir.path().join("new/overlay");
    let finished =
        pb3dp(&words(&[&"estimate", &"--cases", &real_cases(), &"--json", &"--overlay", &overlay])).assert_success();
    let lines = finished.json_lines(&ESTIMATE_KEYS);
    let expected: Vec<String> =
        folders(&real_cases()).iter().map(|f| f.file_name().unwrap().to_string_lossy().into_owned()).collect();
    assert!(!expected.is_empty());
    assert_eq!(lines.iter().map(|line| line["case"].as_str().unwrap()).collect::<Vec<_>>(), expected);
    for line in &lines {
        assert!(STATUSES.contains(&line["status"].as_str().unwrap()), "{line}");
        assert_eq!(line["method"], "published");
        assert!(line["ms"].as_f64().unwrap() > 0.0, "{line}");
        assert_eq!(line["z_mm"].is_null(), line["normal"].is_null(), "{line}");
        let picture = image::open(overlay.join(format!("{}.png", line["case"].as_str().unwrap()))).unwrap();
        assert!(picture.width() >= 1280 && picture.height() >= 480, "both pictures side by side");
    }
    let row = finished.stderr.lines().find(|line| line.starts_with("boards ")).expect("the table has the group");
    assert_eq!(row.split_whitespace().nth(1), Some(expected.len().to_string().as_str()), "{row}");
}

#[test]
fn the_table_is_for_people_and_has_a_line_per_case() {
    let finished = pb3dp(&words(&[&"estimate", &"--cases", &real_cases()])).assert_success();
    let lines: Vec<&str> = finished.stdout.lines().collect();
    assert_eq!(lines.len(), 1 + folders(&real_cases()).len(), "{}", finished.stdout);
    assert!(lines[0].contains("status") && lines[0].contains("z mm"), "{}", lines[0]);
    assert!(lines[1..].iter().all(|line| line.starts_with("bb") && !line.contains('{')), "{}", finished.stdout);
}

#[test]
fn a_region_is_given_in_four_ways() {
    let card = OnePair::of(TargetConfig::card());
    let mask = card.file("mask.png");
    card.mask.save(&mask).unwrap();
    let [u, v] = card.centre_px();
    let vertices: Vec<String> = card.outline_px.iter().map(|[u, v]| format!("{u:.2},{v:.2}")).collect();
    for region in [
        format!("rect:{:.0},{:.0},110,80", u - 55.0, v - 40.0),
        format!("poly:{}", vertices.join(";")),
        format!("mask:{}", mask.display()),
    ] {
        card.assert_near_truth(card.estimate(&card.file("calib.json"), &region), &region);
    }
    let crab = OnePair::of(TargetConfig::crab(0.0));
    let click = format!("click:{:.0},{:.0}", crab.centre_px()[0], crab.centre_px()[1]);
    crab.assert_near_truth(crab.estimate(&crab.file("calib.json"), &click), &click);
}

#[test]
fn every_calibration_format_gives_the_same_answer() {
    let pair = OnePair::of(TargetConfig::crab(0.0));
    let region = format!("click:{:.0},{:.0}", pair.centre_px()[0], pair.centre_px()[1]);
    let expected = pair.assert_near_truth(pair.estimate(&pair.file("calib.json"), &region), "calib.json");
    save_kalibr(&rig(), &pair.file("camchain.yaml")).unwrap();
    save_opencv(&rig(), &pair.file("stereo.yaml")).unwrap();
    let (left, right) = (pair.file("left.yaml"), pair.file("right.yaml"));
    save_ros_pair(&rig(), &left, &right).unwrap();
    let ros = format!("{},{}", left.display(), right.display());
    for calibration in [pair.file("camchain.yaml"), pair.file("stereo.yaml"), ros.into()] {
        let what = calibration.display().to_string();
        let line = pair.assert_near_truth(pair.estimate(&calibration, &region), &what);
        let difference_mm = line["z_mm"].as_f64().unwrap() - expected["z_mm"].as_f64().unwrap();
        assert!(difference_mm.abs() < 1.0, "{what}: {line} instead of {expected}");
    }
}

#[test]
fn the_same_seed_gives_the_same_lines() {
    let line = |seed: &str| -> Vec<Value> {
        let finished = pb3dp(&words(&[&"estimate", &"--cases", &real_cases(), &"--json", &"--seed", &seed]));
        finished.assert_success().json_lines(&ESTIMATE_KEYS).into_iter().map(without_time).collect()
    };
    assert_eq!(line("5"), line("5"));
    assert_ne!(line("5"), line("6"), "the seed reaches the search");
}

fn write_grey_case(folder: &Path, pair: &OnePair) {
    let grey = |picture: &RgbImage| image::DynamicImage::ImageRgb8(picture.clone()).to_luma8();
    let back = |picture: GrayImage| image::DynamicImage::ImageLuma8(picture).to_rgb8();
    write(folder, pair, "grey", &back(grey(&pair.left)), &back(grey(&pair.right)));
}

fn write(folder: &Path, pair: &OnePair, name: &str, left: &RgbImage, right: &RgbImage) {
    let away = pair.cam_left_from_target.transform_vector(&nalgebra::Vector3::z());
    let centre_px = pair.centre_px();
    let ray = rig().left().unproject(&centre_px.into()).unwrap();
    let point = ray * (true_depth_mm(&pair.cam_left_from_target, centre_px) * 1e-3);
    let draft = CaseDraft {
        name: name.into(),
        region_polygon_left_px: pair.outline_px.clone(),
        region_centroid_px: Some(centre_px),
        search: SearchRange { z_min_m: 0.35, z_max_m: 0.65, tilt_max_rad: 0.6 },
        planar: true,
        hard: (name == "grey").then_some(Hardness::LowTexture),
        truth: Some(PlaneTruth::exact(point, away)),
    };
    write_case(folder, &draft, &rig(), left, right).unwrap();
}

#[test]
fn a_grey_region_is_not_observable_and_groups_are_told_apart() {
    let pair = OnePair::of(TargetConfig::card());
    write_grey_case(&pair.file("cases/a_grey"), &pair);
    write(&pair.file("cases/b_colour"), &pair, "colour", &pair.left, &pair.right);
    let finished = pb3dp(&words(&[&"estimate", &"--cases", &pair.file("cases"), &"--json"])).assert_success();
    let lines = finished.json_lines(&ESTIMATE_KEYS);
    let [grey, colour] = &lines[..] else { panic!("{}", finished.stdout) };
    assert_eq!(grey["status"], "not-observable", "{grey}");
    assert!(grey["z_mm"].is_null() && grey["normal"].is_null(), "no pose where there is none: {grey}");
    assert!(finished.stderr.contains("hue"), "the reason is told: {}", finished.stderr);
    let true_mm = true_depth_mm(&pair.cam_left_from_target, pair.centre_px());
    let z_mm = colour["z_mm"].as_f64().unwrap();
    assert!((z_mm / true_mm - 1.0).abs() < 0.02, "{colour}, true {true_mm} mm");
    let row = |group: &str| -> Vec<&str> {
        let line = finished.stderr.lines().find(|line| line.split_whitespace().next() == Some(group));
        line.unwrap_or_else(|| panic!("no group {group}: {}", finished.stderr)).split_whitespace().collect()
    };
    assert_eq!((row("textured")[1], row("textured")[2]), ("1", "1"));
    assert_eq!((row("lowtex")[1], row("lowtex")[2]), ("1", "0"), "asked once, never answered");
}

#[test]
fn swapped_pictures_are_never_a_sure_answer() {
    let pair = OnePair::of(TargetConfig::card());
    let (left, right, calibration) = (pair.file("left.png"), pair.file("right.png"), pair.file("calib.json"));
    let region = format!("rect:{:.0},{:.0},60,50", pair.centre_px()[0] - 30.0, pair.centre_px()[1] - 25.0);
    let finished = pb3dp(&words(&[
        &"estimate",
        &"--left",
        &right,
        &"--right",
        &left,
        &"--calib",
        &calibration,
        &"--region",
        &region,
        &"--json",
        &"--z-range",
        &"350,650",
    ]));
    let lines = finished.json_lines(&ESTIMATE_KEYS);
    assert_eq!(lines.len(), 1);
    assert_ne!(lines[0]["status"], "ok", "{}", lines[0]);
}

#[test]
fn swapped_real_pictures_are_refused_with_what_to_do() {
    let folder = real_cases().join("bb201_c0");
    let case = pb3dp_record::dataset::load_case(&folder).unwrap();
    let finished = pb3dp(&words(&[
        &"estimate",
        &"--left",
        &case.right,
        &"--right",
        &case.left,
        &"--calib",
        &case.calibration,
        &"--region",
        &"rect:340,110,140,190",
    ]));
    finished.assert_refused(&["left and right look exchanged", "swap --left and --right"]);
}

#[test]
fn a_range_that_misses_the_target_gives_no_sure_depth() {
    let case = pb3dp_record::dataset::load_case(&real_cases().join("bb201_c0")).unwrap();
    for range in ["399,401", "420,425", "1000,1010"] {
        let finished = pb3dp(&words(&[
            &"estimate",
            &"--left",
            &case.left,
            &"--right",
            &case.right,
            &"--calib",
            &case.calibration,
            &"--region",
            &"rect:340,110,140,190",
            &"--json",
            &"--z-range",
            &range,
        ]));
        let line = &finished.json_lines(&ESTIMATE_KEYS)[0];
        assert!(line["status"] == "ambiguous" || line["status"] == "not-observable", "{range}: {line}");
    }
}
