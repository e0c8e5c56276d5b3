//! `pb3dp estimate` where it can answer.

use std::path::{Path, PathBuf};

use image::{GrayImage, Luma, RgbImage};
use nalgebra::Point3;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_record::calibration_files::save_json;
use pb3dp_record::dataset::{CaseDraft, Hardness, PlaneTruth, SearchRange, write_case};
use pb3dp_record::images::{StoredFormat, save};
use pb3dp_sim::targets::TargetConfig;
use pb3dp_sim::targets::part::SceneObject;
use serde_json::{Value, json};

use crate::cli::support::*;

/// The method of the paper, and the default.
const METHODS: [&str; 2] = ["published", "direct"];

/// A rendered flat target that is seen obliquely, in files, with its truth.
pub struct OnePair {
    pub dir: tempfile::TempDir,
    outline_px: Vec<[f64; 2]>,
    mask: GrayImage,
    pub left: RgbImage,
    pub right: RgbImage,
    cam_left_from_target: Pose<CamLeft, Target>,
}

impl OnePair {
    pub fn of(target: TargetConfig) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut renderer = renderer(target);
        let (scene_poses, cam_left_from_target) = poses([0.012, -0.008, 0.48], [0.2, -0.26, 0.15]);
        let (left, right) = render(&mut renderer, &scene_poses, 3);
        save(&left, &dir.path().join("left.png"), StoredFormat::Png).unwrap();
        save(&right, &dir.path().join("right.png"), StoredFormat::Png).unwrap();
        save_json(&rig(), &dir.path().join("calib.json")).unwrap();
        let outline = renderer.target_outline_px(&scene_poses).unwrap();
        let truth = renderer.ground_truth(&scene_poses);
        let inside = |u, v| truth.object[(v * left.width() + u) as usize] == SceneObject::Target;
        let mask = GrayImage::from_fn(left.width(), left.height(), |u, v| Luma([if inside(u, v) { 255 } else { 0 }]));
        let outline_px = outline.iter().map(|p| [p.x, p.y]).collect();
        Self { dir, outline_px, mask, left, right, cam_left_from_target }
    }

    pub fn file(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    pub fn centre_px(&self) -> [f64; 2] {
        let centre = self.cam_left_from_target.translation_m();
        rig().left().project(&centre.into()).map(|p| [p.x, p.y]).unwrap()
    }

    pub fn estimate(&self, method: &str, calibration: &dyn AsRef<std::ffi::OsStr>, region: &str) -> Finished {
        let (left, right) = (self.file("left.png"), self.file("right.png"));
        let z_range = "350,650";
        pb3dp(&words(&[
            &"estimate",
            &"--method",
            &method,
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

    /// The one line, which must be an answer as near to the truth as the method can tell.
    pub fn assert_near_truth(&self, method: &str, finished: Finished, what: &str) -> Value {
        self.assert_near_truth_at(self.centre_px(), method, finished, what)
    }

    /// The same for a region whose centroid, where the depth is reported, is not the centre of the target.
    fn assert_near_truth_at(&self, at_px: [f64; 2], method: &str, finished: Finished, what: &str) -> Value {
        let (depth_share_max, normal_max_deg) = if method == "direct" { (0.001, 0.6) } else { (0.03, 10.0) };
        let finished = finished.assert_success();
        let lines = finished.json_lines(&ESTIMATE_KEYS);
        let [line] = &lines[..] else { panic!("{what}: one line for one pair: {}", finished.stdout) };
        assert!(["ok", "weak-tilt"].contains(&line["status"].as_str().unwrap()), "{what}: {line}\n{}", finished.stderr);
        let (z_mm, true_mm) = (line["z_mm"].as_f64().unwrap(), true_depth_mm(&self.cam_left_from_target, at_px));
        assert!((z_mm / true_mm - 1.0).abs() < depth_share_max, "{what}: {z_mm} mm, true there {true_mm} mm");
        let normal = nalgebra::Vector3::from_vec(numbers(&line["normal"]));
        let away = self.cam_left_from_target.transform_vector(&nalgebra::Vector3::z());
        assert!((normal.norm() - 1.0).abs() < 1e-9 && normal.z < 0.0, "{what}: {normal}");
        let off_deg = normal.angle(&-away).to_degrees();
        assert!(off_deg < normal_max_deg, "{what}: the normal is off by {off_deg} degrees");
        line.clone()
    }
}

/// Without `--method` the direct method answers, and says how sure it is.
#[test]
fn the_default_is_the_direct_method_with_its_sigmas() {
    for line in real_cases_with(&[]) {
        assert_eq!((&line["method"], &line["status"]), (&"direct".into(), &"ok".into()), "{line}");
        let sigma = |key: &str| line[key].as_f64().unwrap();
        assert!(sigma("z_sigma_mm") > 0.0 && sigma("z_sigma_mm") < 1.0, "{line}");
        assert!(sigma("normal_sigma_deg") > 0.0 && sigma("normal_sigma_deg") < 1.0, "{line}");
    }
}

#[test]
fn the_method_of_the_paper_is_found_by_name() {
    let lines = real_cases_with(&["--method", "published"]);
    assert!(lines.iter().all(|line| line["method"] == "published"), "{lines:?}");
}

#[test]
fn images_of_earlier_calls_are_mentioned_and_stay() {
    let dir = tempfile::tempdir().unwrap();
    let old = dir.path().join("old.png");
    std::fs::write(&old, "mine").unwrap();
    let case = folders(&real_cases()).remove(0);
    let estimate = || pb3dp(&words(&[&"estimate", &"--cases", &case, &"--overlay", &dir.path()])).assert_success();
    assert!(estimate().stderr.contains("images of earlier calls are there (1)"));
    assert!(estimate().stderr.contains("images of earlier calls are there (2)"));
    assert_eq!(std::fs::read(&old).unwrap(), b"mine");
}

/// The lines of the real cases, with one image for each and a table of errors.
fn real_cases_with(arguments: &[&str]) -> Vec<Value> {
    let dir = tempfile::tempdir().unwrap();
    let overlay = dir.path().join("new/overlay");
    let mut all = words(&[&"estimate", &"--cases", &real_cases(), &"--json", &"--overlay", &overlay]);
    all.extend(arguments.iter().map(std::ffi::OsString::from));
    let finished = pb3dp(&all).assert_success();
    let lines = finished.json_lines(&ESTIMATE_KEYS);
    let expected: Vec<String> =
        folders(&real_cases()).iter().map(|f| f.file_name().unwrap().to_string_lossy().into_owned()).collect();
    assert!(!expected.is_empty());
    assert_eq!(lines.iter().map(|line| line["case"].as_str().unwrap()).collect::<Vec<_>>(), expected);
    for line in &lines {
        assert!(STATUSES.contains(&line["status"].as_str().unwrap()), "{line}");
        assert!(line["ms"].as_f64().unwrap() > 0.0, "{line}");
        assert_eq!(line["z_mm"].is_null(), line["normal"].is_null(), "{line}");
        let image = image::open(overlay.join(format!("{}.png", line["case"].as_str().unwrap()))).unwrap();
        assert!(image.width() >= 1280 && image.height() >= 480, "both images side by side");
    }
    let row = finished.stderr.lines().find(|line| line.starts_with("boards ")).expect("the table has the group");
    assert_eq!(row.split_whitespace().nth(1), Some(expected.len().to_string().as_str()), "{row}");
    lines
}

/// All cases of one calibration file share what their pairs show of the rig.
#[test]
fn the_rig_is_measured_on_all_pairs_of_a_calibration() {
    let dir = tempfile::tempdir().unwrap();
    copy_of_real_cases(dir.path());
    let (first, second) = (dir.path().join("bb201_c0"), dir.path().join("bb209_c0"));
    let description = std::fs::read_to_string(second.join("case.json")).unwrap();
    let mut value: Value = serde_json::from_str(&description).unwrap();
    value["calib"] = Value::String(first.join("calib.json").display().to_string());
    std::fs::write(second.join("case.json"), value.to_string()).unwrap();
    let depth_of = |folders: &Path| {
        let finished = pb3dp(&words(&[&"estimate", &"--cases", &folders, &"--json"])).assert_success();
        let line = finished.stdout.lines().find(|line| line.contains("bb209_c0")).unwrap();
        let value: Value = serde_json::from_str(line).unwrap();
        assert_eq!(value["status"], "ok", "{line}");
        value["z_mm"].as_f64().unwrap()
    };
    // The pair of the first case tells something of the rig, which moves the answer of the second one a little.
    let moved_mm = (depth_of(dir.path()) - depth_of(&second)).abs();
    assert!(moved_mm > 0.0 && moved_mm < 0.5, "{moved_mm} mm");
}

#[test]
fn the_table_is_for_people_and_has_a_line_per_case() {
    let finished = pb3dp(&words(&[&"estimate", &"--cases", &real_cases()])).assert_success();
    let lines: Vec<&str> = finished.stdout.lines().collect();
    assert_eq!(lines.len(), 1 + folders(&real_cases()).len(), "{}", finished.stdout);
    assert!(lines[0].contains("status") && lines[0].contains("z mm"), "{}", lines[0]);
    assert!(lines[1..].iter().all(|line| line.starts_with("bb") && !line.contains('{')), "{}", finished.stdout);
}

/// A message names an option for rectified images with the calibration of raw ones. A pose that must not be used is no answer.
#[test]
fn cases_with_rectified_images_and_the_calibration_of_raw_ones_need_an_option() {
    let (from, dir) = (real_cases().join("bb204_c0"), tempfile::tempdir().unwrap());
    for file in std::fs::read_dir(&from).unwrap().map(|entry| entry.unwrap().path()) {
        std::fs::copy(&file, dir.path().join(file.file_name().unwrap())).unwrap();
    }
    let file = dir.path().join("calib.json");
    let mut calibration: Value = serde_json::from_str(&std::fs::read_to_string(&file).unwrap()).unwrap();
    calibration["rectified"] = json!(false);
    for key in ["distortion_left", "distortion_right"] {
        calibration[key] = json!({"model": "plumb_bob", "coefficients": [-0.3, 0, 0, 0]});
    }
    std::fs::write(&file, calibration.to_string()).unwrap();
    let cases = words(&[&"estimate", &"--cases", &dir.path()]);
    let raw = pb3dp(&cases).assert_success();
    assert!(!raw.stdout.contains(" ok ") && raw.stderr.contains("\nboards: not answered: 1 "), "{}", raw.stderr);
    let rectified = pb3dp(&[cases, words(&[&"--rectified"])].concat()).assert_success();
    assert!(rectified.stdout.contains(" ok ") && !rectified.stderr.contains("not answered"), "{}", rectified.stderr);
}

/// Centroid of a polygon's area.
fn centroid(vertices: &[[f64; 2]]) -> [f64; 2] {
    let next = vertices.iter().cycle().skip(1);
    let (mut area, mut sum) = (0.0, [0.0; 2]);
    for (a, b) in vertices.iter().zip(next) {
        let cross = a[0] * b[1] - b[0] * a[1];
        area += 3.0 * cross;
        sum = [sum[0] + (a[0] + b[0]) * cross, sum[1] + (a[1] + b[1]) * cross];
    }
    sum.map(|value| value / area)
}

#[test]
fn a_region_is_given_in_four_ways() {
    let card = OnePair::of(TargetConfig::card());
    let mask = card.file("mask.png");
    card.mask.save(&mask).unwrap();
    let [u, v] = card.centre_px();
    let vertices: Vec<String> = card.outline_px.iter().map(|[u, v]| format!("{u:.2},{v:.2}")).collect();
    // Perspective moves the centroid of the outline away from the image of the centre.
    let centroid_px = centroid(&card.outline_px);
    for (region, at_px) in [
        (format!("rect:{:.0},{:.0},110,80", u - 55.0, v - 40.0), [u, v]),
        (format!("poly:{}", vertices.join(";")), centroid_px),
        (format!("mask:{}", mask.display()), centroid_px),
    ] {
        for method in METHODS {
            let finished = card.estimate(method, &card.file("calib.json"), &region);
            card.assert_near_truth_at(at_px, method, finished, &region);
        }
    }
    let crab = OnePair::of(TargetConfig::crab(0.0));
    let click = format!("click:{:.0},{:.0}", crab.centre_px()[0], crab.centre_px()[1]);
    for method in METHODS {
        crab.assert_near_truth(method, crab.estimate(method, &crab.file("calib.json"), &click), &click);
    }
}

#[test]
fn a_deadline_gives_the_best_answer_so_far_and_says_so() {
    for method in METHODS {
        let run = |deadline: &str| {
            let words = words(&[
                &"estimate",
                &"--method",
                &method,
                &"--cases",
                &real_cases(),
                &"--json",
                &"--deadline",
                &deadline,
            ]);
            let finished = pb3dp(&words).assert_success();
            (finished.json_lines(&ESTIMATE_KEYS).len(), finished.stderr.matches("cut short by the deadline").count())
        };
        let cases = folders(&real_cases()).len();
        let ((lines, cut), whole) = (run("0"), run("1000000"));
        // To the published method most of the boards have no hue, and there is no search to be cut.
        assert!(lines == cases && cut >= 1 && (cut == cases || method == "published"), "{method}: {cut} of {lines}");
        assert_eq!(whole, (cases, 0), "{method}");
    }
}

#[test]
fn the_same_seed_gives_the_same_lines() {
    let line = |seed: &str| -> Vec<Value> {
        let finished = pb3dp(&words(&[
            &"estimate",
            &"--method",
            &"published",
            &"--cases",
            &real_cases(),
            &"--json",
            &"--seed",
            &seed,
        ]));
        finished.assert_success().json_lines(&ESTIMATE_KEYS).into_iter().map(without_time).collect()
    };
    assert_eq!(line("5"), line("5"));
    assert_ne!(line("5"), line("6"), "the seed reaches the search");
    let direct = pb3dp(&words(&[&"estimate", &"--cases", &real_cases(), &"--seed", &"5"])).assert_success();
    assert!(direct.stderr.contains("--seed has no effect: the method direct"), "{}", direct.stderr);
}

fn write_grey_case(folder: &Path, pair: &OnePair) {
    let grey = |image: &RgbImage| image::DynamicImage::ImageRgb8(image.clone()).to_luma8();
    let back = |image: GrayImage| image::DynamicImage::ImageLuma8(image).to_rgb8();
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
fn to_the_published_method_a_grey_region_is_not_observable_and_groups_are_distinguished() {
    let pair = OnePair::of(TargetConfig::card());
    write_grey_case(&pair.file("cases/a_grey"), &pair);
    write(&pair.file("cases/b_colour"), &pair, "colour", &pair.left, &pair.right);
    let cases = pair.file("cases");
    let finished =
        pb3dp(&words(&[&"estimate", &"--method", &"published", &"--cases", &cases, &"--json"])).assert_success();
    let lines = finished.json_lines(&ESTIMATE_KEYS);
    let [grey, colour] = &lines[..] else { panic!("{}", finished.stdout) };
    assert_eq!(grey["status"], "not-observable", "{grey}");
    assert!(grey["z_mm"].is_null() && grey["normal"].is_null(), "no pose where there is none: {grey}");
    assert!(finished.stderr.contains("hue"), "the reason is reported: {}", finished.stderr);
    let true_mm = true_depth_mm(&pair.cam_left_from_target, pair.centre_px());
    let z_mm = colour["z_mm"].as_f64().unwrap();
    assert!((z_mm / true_mm - 1.0).abs() < 0.02, "{colour}, true {true_mm} mm");
    let row = |group: &str| -> Vec<&str> {
        let line = finished.stderr.lines().find(|line| line.split_whitespace().next() == Some(group));
        line.unwrap_or_else(|| panic!("no group {group}: {}", finished.stderr)).split_whitespace().collect()
    };
    assert_eq!((row("textured")[1], row("textured")[2]), ("1", "1"));
    assert_eq!((row("lowtex")[1], row("lowtex")[2]), ("1", "0"), "asked once, never answered");
    assert!(finished.stderr.contains("\nlowtex: not answered: 1 not-observable\n"), "{}", finished.stderr);
}

#[test]
fn to_the_direct_method_grey_is_as_good_as_colour() {
    let pair = OnePair::of(TargetConfig::card());
    write_grey_case(&pair.file("cases/a_grey"), &pair);
    write(&pair.file("cases/b_colour"), &pair, "colour", &pair.left, &pair.right);
    let finished = pb3dp(&words(&[&"estimate", &"--cases", &pair.file("cases"), &"--json"])).assert_success();
    let true_mm = true_depth_mm(&pair.cam_left_from_target, pair.centre_px());
    for line in finished.json_lines(&ESTIMATE_KEYS) {
        assert_eq!(line["status"], "ok", "{line}");
        assert!((line["z_mm"].as_f64().unwrap() / true_mm - 1.0).abs() < 0.001, "{line}, true {true_mm} mm");
    }
}

/// Half of the region is the card, half the wall behind it.
#[test]
fn the_second_surface_of_a_region_is_reported_with_its_share() {
    let pair = OnePair::of(TargetConfig::card());
    let right_edge = pair.outline_px.iter().map(|[u, _]| *u).fold(f64::MIN, f64::max);
    let region = format!("rect:{:.0},{:.0},100,70", right_edge - 70.0, pair.centre_px()[1] - 35.0);
    let finished = pair.estimate("direct", &pair.file("calib.json"), &region).assert_success();
    let warning_line = finished.stderr.lines().find(|line| line.contains("lies on another surface"));
    let warning_line = warning_line.unwrap_or_else(|| panic!("no second surface in:\n{}", finished.stderr));
    assert!(warning_line.contains("% of the region") && warning_line.contains("normal"), "{warning_line}");
    let line = &finished.json_lines(&ESTIMATE_KEYS)[0];
    let second = &line["second_plane"];
    let [u, v] = [numbers(&line["centroid_px"])[0], numbers(&line["centroid_px"])[1]];
    assert!((u - (right_edge - 20.5)).abs() < 1.0 && (v - pair.centre_px()[1]).abs() < 1.0, "{line}");
    assert!(
        warning_line.contains(&format!("z {:.2} mm", second["z_mm"].as_f64().unwrap())),
        "{warning_line} but {line}"
    );
    assert!((0.1..0.5).contains(&second["share"].as_f64().unwrap()), "{line}");
    assert!(numbers(&second["normal"])[2] < 0.0, "{line}");
    assert!(line["row_offset_px"].as_f64().unwrap().abs() < 0.5, "{line}");
    assert!(line["reason"].as_str().unwrap().contains("of the region agree"), "{line}");
}

/// The same region, pixel by pixel: points on the card, and on the wall behind it.
#[test]
fn the_visible_surface_is_a_cloud_in_the_frame_of_the_left_camera() {
    let pair = OnePair::of(TargetConfig::card());
    let right_edge = pair.outline_px.iter().map(|[u, _]| *u).fold(f64::MIN, f64::max);
    let region = format!("rect:{:.0},{:.0},100,70", right_edge - 50.0, pair.centre_px()[1] - 35.0);
    let [left, right, calibration] = ["left.png", "right.png", "calib.json"].map(|name| pair.file(name));
    let (cloud, cases) = (pair.file("new/card.ply"), pair.file("cases"));
    let files: [&dyn AsRef<std::ffi::OsStr>; 9] =
        [&"estimate", &"--left", &left, &"--right", &right, &"--calib", &calibration, &"--region", &region];
    let with = |more: &[&dyn AsRef<std::ffi::OsStr>]| pb3dp(&words(&[&files[..], more].concat()));
    with(&[&"--surface", &cloud]).assert_success();
    let bytes = std::fs::read(&cloud).unwrap();
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|window| window == end).unwrap() + end.len();
    let header = String::from_utf8_lossy(&bytes[..at]);
    assert!(header.contains("frame cam_left, millimetres") && header.contains("float sigma"), "{header}");
    // Three floats, the standard deviation, four bytes.
    let floats = |chunk: &[u8]| [0, 1, 2, 3].map(|k| f32::from_le_bytes(chunk[4 * k..4 * k + 4].try_into().unwrap()));
    let points: Vec<[f64; 4]> = bytes[at..].chunks(20).map(|chunk| floats(chunk).map(f64::from)).collect();
    assert!(points.len() > 6500 && points.len() <= 7000, "{} points", points.len());
    let target_from_cam_left = pair.cam_left_from_target.inverse();
    let behind_mm =
        |[x, y, z, _]: &[f64; 4]| 1e3 * target_from_cam_left.transform_point(&(Point3::new(*x, *y, *z) / 1e3)).z;
    let share =
        |of: &dyn Fn(f64) -> bool| points.iter().filter(|p| of(behind_mm(p))).count() as f64 / points.len() as f64;
    let (on_card, behind) = (share(&|mm| mm.abs() < 8.0), share(&|mm| mm > 20.0));
    assert!(on_card > 0.3 && behind > 0.3 && on_card + behind > 0.9, "{on_card} on the card, {behind} behind");
    assert!(points.iter().all(|[.., sigma_mm]| (0.05..200.0).contains(sigma_mm)), "{:?}", points[0]);

    let warning_line = &with(&[&"--surface", &cloud, &"--json"]).assert_success();
    let line: Value = serde_json::from_str(warning_line.stdout.lines().next().unwrap()).unwrap();
    assert_eq!(line["surface"]["points"], points.len(), "{line}");
    assert!(line["surface"]["measured"].as_u64().unwrap() as f64 > 0.7 * points.len() as f64, "{line}");
    // Without a surface the answer stays.
    let none = pair.file("none.ply");
    let wrong = with(&[&"--surface", &none, &"--z-range", &"3000,9000", &"--json"]).assert_success();
    let line: Value = serde_json::from_str(wrong.stdout.lines().next().unwrap()).unwrap();
    assert!(line["surface"].is_null() && line["status"] != "error" && !none.exists(), "{line}");
    let warnings = line["warnings"].to_string();
    assert!(
        ["not written", "have a match in the right image", "--z-range"].iter().all(|part| warnings.contains(part)),
        "{line}"
    );
    with(&[&"--surface", &left]).assert_refused(&["--surface", "end with .ply"]);
    let image = pair.file("image.ply");
    std::fs::copy(&left, &image).unwrap();
    let mut own = words(&files);
    own[2] = image.clone().into();
    own.extend(["--surface".into(), image.clone().into()]);
    pb3dp(&own).assert_refused(&["is an input of this command"]);
    assert_eq!(std::fs::read(&image).unwrap(), std::fs::read(&left).unwrap());
    with(&[&"--surface", &cloud, &"--method", &"published"]).assert_refused(&["--surface", "--method direct"]);
    pb3dp(&words(&[&"estimate", &"--cases", &cases, &"--surface", &cloud])).assert_refused(&["--surface"]);
}

#[test]
fn swapped_images_are_never_a_sure_answer() {
    let pair = OnePair::of(TargetConfig::card());
    let (left, right, calibration) = (pair.file("left.png"), pair.file("right.png"), pair.file("calib.json"));
    let region = format!("rect:{:.0},{:.0},60,50", pair.centre_px()[0] - 30.0, pair.centre_px()[1] - 25.0);
    for method in METHODS {
        let finished = pb3dp(&words(&[
            &"estimate",
            &"--method",
            &method,
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
}

#[test]
fn swapped_real_images_are_refused_with_what_to_do() {
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
    finished.assert_refused(&["left and right look exchanged", "swap the images: --left and --right"]);
}

#[test]
fn a_range_that_misses_the_target_gives_no_sure_depth() {
    let case = pb3dp_record::dataset::load_case(&real_cases().join("bb201_c0")).unwrap();
    let ranges = ["399,401", "420,425", "1000,1010"];
    for (method, range) in METHODS.iter().flat_map(|method| ranges.map(|range| (method, range))) {
        let finished = pb3dp(&words(&[
            &"estimate",
            &"--method",
            &method,
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
        assert!(line["status"] == "ambiguous" || line["status"] == "not-observable", "{method}, {range}: {line}");
    }
}
