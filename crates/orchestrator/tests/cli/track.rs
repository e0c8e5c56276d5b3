//! `pb3dp track` on a small sequence that the test records.

use std::ffi::OsStr;
use std::path::Path;

use pb3dp_bag::cdr::Bytes;
use pb3dp_bag::messages::{CameraInfo, Header, Image, RegionOfInterest};
use pb3dp_bag::topics::ours;
use pb3dp_bag::writer::{BagWriter, WhenFull};
use pb3dp_geometry::MonotonicTime;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Target};
use pb3dp_record::calibration_files::{load_stereo, ros_camera_infos};
use pb3dp_record::dataset::{SearchRange, SequenceDraft, SequenceWriter, WrittenFrame};
use pb3dp_record::images::{StoredFormat, load_rgb};
use pb3dp_sim::targets::TargetConfig;

use crate::cli::estimate::OnePair;
use crate::cli::support::*;

const FRAMES: usize = 7;
/// How far the target goes from frame to frame, mm: right, up, away.
const STEP_MM: [f64; 3] = [3.0, -1.5, 2.5];

/// Records a card that drifts.
fn record(folder: &Path) -> Vec<Pose<CamLeft, Target>> {
    let mut renderer = renderer(TargetConfig::card());
    let way = |i: usize| -> [f64; 3] { std::array::from_fn(|axis| STEP_MM[axis] * 1e-3 * i as f64) };
    let pose_at = |i: usize| {
        let [x, y, z] = way(i);
        poses([x - 0.01, y + 0.005, z + 0.45], [0.1, -0.15, 0.08])
    };
    let outline = renderer.target_outline_px(&pose_at(0).0).unwrap();
    let draft = SequenceDraft {
        region_polygon_left_px: outline.iter().map(|p| [p.x, p.y]).collect(),
        search: SearchRange { z_min_m: 0.35, z_max_m: 0.65, tilt_max_rad: 0.6 },
        images: StoredFormat::Png,
    };
    let mut writer = SequenceWriter::create(folder, &rig(), draft).unwrap();
    let mut truth = Vec::new();
    for i in 0..FRAMES {
        let (scene_poses, cam_left_from_target) = pose_at(i);
        let (left, right) = render(&mut renderer, &scene_poses, i as u64);
        let exposed_at = MonotonicTime::from_nanos(2_000_000_000 + 33_000_000 * i as u64);
        let in_model = Pose::from_parts(cam_left_from_target.translation_m(), cam_left_from_target.rotation());
        let frame =
            WrittenFrame { left: &left, right: &right, exposed_at, skew_nanos: 0, cam_left_from_model: Some(in_model) };
        writer.push(frame).unwrap();
        truth.push(cam_left_from_target);
    }
    writer.finish().unwrap();
    truth
}

/// How far a method may be off, in position (mm), normal and rotation since the first frame (degrees).
struct Limits {
    method: &'static str,
    moved_mm: f64,
    normal_deg: f64,
    turned_deg: f64,
}

#[test]
fn the_published_method_follows_a_drifting_card_and_a_missing_frame_costs_only_itself() {
    check_drifting_card(&Limits { method: "published", moved_mm: 6.0, normal_deg: 8.0, turned_deg: 8.0 });
}

#[test]
fn the_direct_method_follows_a_drifting_card_and_a_missing_frame_costs_only_itself() {
    check_drifting_card(&Limits { method: "direct", moved_mm: 0.3, normal_deg: 1.0, turned_deg: 0.5 });
}

fn check_drifting_card(limits: &Limits) {
    let dir = tempfile::tempdir().unwrap();
    let sequence = dir.path().join("sequence");
    let truth = record(&sequence);
    let track = |overlay: &Path| {
        let method = &limits.method;
        pb3dp(&words(&[&"track", &"--method", method, &"--sequence", &sequence, &"--json", &"--overlay", &overlay]))
    };
    let whole = track(&dir.path().join("whole")).assert_success();
    let lines = whole.json_lines(&TRACK_KEYS);
    assert_eq!(lines.len(), FRAMES);
    let first = numbers(&lines[0]["cam_left_from_model"]);
    for (i, line) in lines.iter().enumerate() {
        assert_eq!(line["frame"], i);
        assert!((line["t_s"].as_f64().unwrap() - 2.0 - 0.033 * i as f64).abs() < 1e-9, "{line}");
        assert!(["ok", "weak-tilt"].contains(&line["status"].as_str().unwrap()), "{line}\n{}", whole.stderr);
        let m = numbers(&line["cam_left_from_model"]);
        assert_eq!((m.len(), &m[12..]), (16, &[0.0, 0.0, 0.0, 1.0][..]));
        for axis in 0..3 {
            let (moved, true_moved) = (m[4 * axis + 3] - first[4 * axis + 3], STEP_MM[axis] * i as f64);
            assert!(
                (moved - true_moved).abs() < limits.moved_mm,
                "frame {i}, axis {axis}: moved {moved} mm, truly {true_moved} mm"
            );
        }
        let normal = nalgebra::Vector3::new(m[2], m[6], m[10]);
        let off_deg = normal.angle(&truth[i].transform_vector(&nalgebra::Vector3::z())).to_degrees();
        assert!(off_deg < limits.normal_deg, "frame {i}: z of the model frame is off by {off_deg} degrees");
        // The card does not turn.
        let turn = rotation(&m) * rotation(&first).transpose();
        let turned_deg = nalgebra::UnitQuaternion::from_matrix(&turn).angle().to_degrees();
        assert!(turned_deg < limits.turned_deg, "frame {i}: turned by {turned_deg} degrees");
        let fitness = line["fitness"].as_f64().unwrap();
        assert!((0.5..=1.0).contains(&fitness), "{line}");
        check_covariance(limits.method, line);
    }
    for part in ["translation, mm", "tilt, deg", "jitter", &format!("no pose in 0 of {FRAMES} frames")] {
        assert!(whole.stderr.contains(part), "{part:?} is missing in:\n{}", whole.stderr);
    }
    assert_animated(&dir.path().join("whole/sequence.png"), FRAMES as u32);

    std::fs::remove_file(sequence.join("right_0003.png")).unwrap();
    let finished = track(&dir.path().join("gap"));
    finished.assert_refused(&["frame 3", "right_0003.png", &format!("no pose in 1 of {FRAMES} frames")]);
    let with_gap = finished.json_lines(&TRACK_KEYS);
    assert_eq!(with_gap.len(), FRAMES);
    assert_eq!(with_gap[3]["status"], "error");
    assert!(TRACK_KEYS[3..9].iter().all(|key| with_gap[3][key].is_null()), "{}", with_gap[3]);
    assert!(with_gap[3]["reason"].as_str().unwrap().contains("right_0003.png"), "{}", with_gap[3]);
    for i in (0..FRAMES).filter(|&i| i != 3) {
        assert!(["ok", "weak-tilt"].contains(&with_gap[i]["status"].as_str().unwrap()), "{}", with_gap[i]);
        assert!(dir.path().join(format!("gap/frame_{i:04}.png")).exists());
    }
    assert!(with_gap[..3].iter().zip(&lines).all(|(a, b)| without_time(a.clone()) == without_time(b.clone())));
    assert_animated(&dir.path().join("gap/sequence.png"), FRAMES as u32 - 1);
}

fn rotation(m: &[f64]) -> nalgebra::Matrix3<f64> {
    nalgebra::Matrix3::new(m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10])
}

/// In mm and radians: symmetric, and of the size that such images allow. The published method gives none.
fn check_covariance(method: &str, line: &serde_json::Value) {
    if method == "published" {
        assert!(
            ["covariance", "first_pose_covariance", "pose_covariance"].iter().all(|key| line[*key].is_null()),
            "{line}"
        );
        return;
    }
    let [own, first, sum] =
        ["covariance", "first_pose_covariance", "pose_covariance"].map(|key| numbers(&line[key])[14]);
    let expected = if line["frame"] == 0 { first } else { first + own };
    assert!((sum / expected - 1.0).abs() < 1e-9, "{line}");
    let c = numbers(&line["covariance"]);
    assert_eq!(c.len(), 36);
    for i in 0..6 {
        let sigma = c[7 * i].sqrt();
        let (least, most) = if i < 3 { (1e-4, 1.0) } else { (1e-6, 2e-2) };
        assert!((least..most).contains(&sigma), "sigma {i} is {sigma}: {line}");
        let scale = |j: usize| (c[7 * i] * c[7 * j]).sqrt();
        assert!((0..6).all(|j| (c[6 * i + j] - c[6 * j + i]).abs() < 1e-9 * scale(j)), "{line}");
    }
}

/// An animated PNG with so many frames: the number stands behind the name of its `acTL` chunk.
fn assert_animated(file: &Path, frames: u32) {
    let bytes = std::fs::read(file).unwrap();
    let at = bytes.windows(4).position(|window| window == b"acTL").expect("the image is animated") + 4;
    assert_eq!(u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()), frames);
    image::open(file).unwrap();
}

#[test]
fn a_sequence_without_its_first_frame_starts_with_the_second() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path());
    std::fs::write(dir.path().join("left_0000.png"), "").unwrap();
    for method in ["published", "direct"] {
        let finished = pb3dp(&words(&[&"track", &"--method", &method, &"--sequence", &dir.path(), &"--json"]));
        finished.assert_refused(&["frame 0", "left_0000.png"]);
        let lines = finished.json_lines(&TRACK_KEYS);
        assert_eq!((lines.len(), lines[0]["status"].as_str()), (FRAMES, Some("error")));
        assert!(lines[1..].iter().all(|line| !line["cam_left_from_model"].is_null()), "{}", finished.stdout);
    }
}

/// Images that show nothing: the region is tried for half a second, then a message says what to do.
#[test]
fn a_target_that_is_never_visible_is_given_up() {
    let dir = tempfile::tempdir().unwrap();
    let draft = SequenceDraft {
        region_polygon_left_px: vec![[300.0, 200.0], [380.0, 210.0], [360.0, 290.0]],
        search: SearchRange { z_min_m: 0.35, z_max_m: 0.65, tilt_max_rad: 0.6 },
        images: StoredFormat::Png,
    };
    let mut writer = SequenceWriter::create(dir.path(), &rig(), draft).unwrap();
    let wall = image::RgbImage::from_pixel(640, 480, image::Rgb([90, 100, 80]));
    for i in 0..18 {
        let exposed_at = MonotonicTime::from_nanos(33_000_000 * i);
        let frame = WrittenFrame { left: &wall, right: &wall, exposed_at, skew_nanos: 0, cam_left_from_model: None };
        writer.push(frame).unwrap();
    }
    writer.finish().unwrap();
    let finished = pb3dp(&words(&[&"track", &"--sequence", &dir.path(), &"--json"])).assert_success();
    let statuses: Vec<String> = finished
        .json_lines(&TRACK_KEYS)
        .iter()
        .map(|line| {
            assert!(line["cam_left_from_model"].is_null(), "{line}");
            line["status"].as_str().unwrap().to_owned()
        })
        .collect();
    assert!(statuses[..15].iter().all(|status| status == "not-observable"), "{statuses:?}");
    assert!(statuses[15..].iter().all(|status| status == "lost"), "{statuses:?}");
    assert!(finished.stderr.contains("mark it again"), "{}", finished.stderr);
}

/// Keys of a line if there are several targets.
fn keys_of_several() -> Vec<&'static str> {
    let (frame, others) = TRACK_KEYS.split_first().unwrap();
    [frame, &"target"].into_iter().chain(others).copied().collect()
}

/// The second target is a part of the same card: both move alike, and the first is what it is alone.
#[test]
fn several_targets_are_distinguished_and_do_not_disturb_each_other() {
    let dir = tempfile::tempdir().unwrap();
    let sequence = dir.path().join("sequence");
    let truth = record(&sequence);
    let centre = rig().left().project(&truth[0].translation_m().into()).unwrap();
    let region = format!("rect:{:.0},{:.0},60,50", centre.x - 10.0, centre.y - 20.0);
    let overlay = dir.path().join("overlay");
    let alone = pb3dp(&words(&[&"track", &"--sequence", &sequence, &"--json"])).assert_success();
    let both =
        pb3dp(&words(&[&"track", &"--sequence", &sequence, &"--region", &region, &"--json", &"--overlay", &overlay]))
            .assert_success();
    let lines = both.json_lines(&keys_of_several());
    assert_eq!(lines.len(), 2 * FRAMES);
    for (i, (pair, alone)) in lines.chunks(2).zip(alone.json_lines(&TRACK_KEYS)).enumerate() {
        assert!(pair[0]["frame"] == i && pair[0]["target"] == 0 && pair[1]["frame"] == i && pair[1]["target"] == 1);
        let mut first = without_time(pair[0].clone());
        first.as_object_mut().unwrap().remove("target");
        assert_eq!(first, without_time(alone));
        let way = |k: usize| {
            let at = |line: &serde_json::Value| numbers(&line["cam_left_from_model"])[4 * k + 3];
            at(&pair[1]) - at(&lines[1])
        };
        let off_mm = (0..3).map(|k| (way(k) - STEP_MM[k] * i as f64).powi(2)).sum::<f64>().sqrt();
        assert!(off_mm < 0.5, "frame {i}: the second target is off by {off_mm} mm");
    }
    assert!(overlay.join("frame_0006.png").exists() && both.stderr.contains("motion of target 0 since"));
}

/// The target of a region that cannot serve has an error in each frame; the other is what it is alone.
#[test]
fn a_region_that_is_refused_leaves_the_other_targets_alone() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path());
    let track = |arguments: &[&str]| {
        let mut all = words(&[&"track", &"--sequence", &dir.path(), &"--json"]);
        all.extend(arguments.iter().map(std::ffi::OsString::from));
        pb3dp(&all)
    };
    let alone = track(&[]).assert_success().json_lines(&TRACK_KEYS);
    let refused = track(&["--region", "rect:5,5,3,3"]);
    refused.assert_refused(&["frame 0, target 1", "region", "left out"]);
    assert_eq!(refused.stderr.matches("left out").count(), 1, "{}", refused.stderr);
    let lines = refused.json_lines(&keys_of_several());
    assert_eq!(lines.len(), 2 * FRAMES);
    for (pair, alone) in lines.chunks(2).zip(alone) {
        assert_eq!(pair[0]["cam_left_from_model"], alone["cam_left_from_model"]);
        assert_eq!(pair[1]["status"], "error");
        assert!(pair[1]["cam_left_from_model"].is_null() && pair[1]["reason"] == lines[1]["reason"]);
        assert!(pair[1]["reason"].as_str().unwrap().starts_with("the region has"), "{}", pair[1]);
    }
}

/// The columns of a run's `estimates.csv`, with the values of the JSON lines; a frame without images has an empty row.
#[test]
fn the_estimates_are_also_a_table_with_the_columns_of_a_run() {
    let dir = tempfile::tempdir().unwrap();
    let sequence = dir.path().join("sequence");
    record(&sequence);
    std::fs::write(sequence.join("left_0003.png"), "no image").unwrap();
    let file = dir.path().join("new/track.csv");
    let tracked = pb3dp(&words(&[&"track", &"--sequence", &sequence, &"--csv", &file, &"--json"]));
    let lines = tracked.json_lines(&TRACK_KEYS);
    let text = std::fs::read_to_string(&file).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    assert!(rows.len() == FRAMES + 1 && rows.iter().all(|row| row.len() == 12 + 2 * 36), "{text}");
    assert!(text.starts_with("t_s,status,age_ms,latency_ms,fitness,x_mm,y_mm,z_mm,qx,qy,qz,qw,c11,c12,"), "{text}");
    for (line, row) in lines.iter().zip(&rows[1..]) {
        assert_eq!((line["status"].as_str().unwrap(), ""), (row[1], row[2]), "{line}");
        let Some(pose) = line["cam_left_from_model"].as_array() else {
            assert!(row[5..].iter().all(|cell| cell.is_empty()), "{row:?}");
            continue;
        };
        let agrees = |k: usize, cell: &str| (pose[k].as_f64().unwrap() - cell.parse::<f64>().unwrap()).abs() < 1e-3;
        assert!(agrees(3, row[5]) && agrees(7, row[6]) && agrees(11, row[7]), "{line} {row:?}");
        for (key, first) in [("covariance", 12), ("pose_covariance", 12 + 36)] {
            let c22 = numbers(&line[key])[7];
            assert!((c22 / row[first + 7].parse::<f64>().unwrap() - 1.0).abs() < 1e-5, "{line} {row:?}");
        }
    }
    assert_eq!(rows[4][1], "error", "{text}");
    let refused = pb3dp(&words(&[&"track", &"--sequence", &sequence, &"--csv", &dir.path()]));
    refused.assert_refused(&["--csv", "is a folder"]);
}

/// The card is flat: its points lie in the plane z = 0 of the model, within the card, and have its colours.
#[test]
fn the_surface_of_a_flat_card_is_a_flat_coloured_cloud() {
    let dir = tempfile::tempdir().unwrap();
    let (sequence, file) = (dir.path().join("sequence"), dir.path().join("card.ply"));
    record(&sequence);
    pb3dp(&words(&[&"track", &"--sequence", &sequence, &"--surface", &file])).assert_success();
    let points = vertices(&file);
    assert!(points.len() > 400, "{} points", points.len());
    let rms_mm = (points.iter().map(|p| p.z_mm.powi(2)).sum::<f32>() / points.len() as f32).sqrt();
    assert!(rms_mm < 1.0, "rms of {rms_mm} mm about the plane");
    assert!(points.iter().all(|p| p.x_mm.abs() < 120.0 && p.y_mm.abs() < 120.0 && p.nz < -0.8), "on the card");
    assert!(points.iter().all(|p| (0.001..1.0).contains(&p.sigma_mm)), "{} mm", points[0].sigma_mm);
    let colourful = points.iter().filter(|p| p.rgb.iter().max().unwrap() - p.rgb.iter().min().unwrap() > 40).count();
    assert!(colourful * 4 > points.len(), "{colourful} of {} are coloured", points.len());

    let refused = pb3dp(&words(&[&"track", &"--method", &"published", &"--sequence", &sequence, &"--surface", &file]));
    refused.assert_refused(&["--surface", "published", "--method direct"]);
    // Before any frame is worked on.
    for (bad, why) in [(dir.path().to_path_buf(), "is a folder"), (file.join("a.ply"), "cannot be written")] {
        let refused = pb3dp(&words(&[&"track", &"--sequence", &sequence, &"--surface", &bad, &"--json"]));
        refused.assert_refused(&["--surface", why]);
        assert_eq!(refused.stdout, "");
    }
    let region = &"rect:300,200,60,50";
    let two = dir.path().join("new/two.ply");
    pb3dp(&words(&[&"track", &"--sequence", &sequence, &"--surface", &two, &"--region", region])).assert_success();
    assert!(["new/two-0.ply", "new/two-1.ply"].iter().all(|name| !vertices(&dir.path().join(name)).is_empty()));
    assert!(!two.exists());
}

struct Vertex {
    x_mm: f32,
    y_mm: f32,
    z_mm: f32,
    nz: f32,
    sigma_mm: f32,
    rgb: [u8; 3],
}

/// Reads what `write_ply` writes: seven little-endian floats and four bytes per vertex.
fn vertices(file: &Path) -> Vec<Vertex> {
    let bytes = std::fs::read(file).unwrap();
    let end = b"end_header\n";
    let at = bytes.windows(end.len()).position(|window| window == end).unwrap() + end.len();
    assert!(String::from_utf8_lossy(&bytes[..at]).contains("frame model"), "the header names the frame");
    assert_eq!((bytes.len() - at) % 32, 0);
    let float = |chunk: &[u8], k: usize| f32::from_le_bytes(chunk[4 * k..4 * k + 4].try_into().unwrap());
    let vertex = |chunk: &[u8]| Vertex {
        x_mm: float(chunk, 0),
        y_mm: float(chunk, 1),
        z_mm: float(chunk, 2),
        nz: float(chunk, 5),
        sigma_mm: float(chunk, 6),
        rgb: chunk[28..31].try_into().unwrap(),
    };
    bytes[at..].chunks(32).map(vertex).collect()
}

/// White paper that is saturated in one image tells nothing about its surface. It counted as another surface, and of two boards a small part
/// was followed.
#[test]
fn a_bright_board_is_followed_as_a_whole() {
    for name in ["bb201_c0", "bb204_c0", "bb207_c0", "bb209_c0"] {
        let case = repository().join("tests/data/cases").join(name);
        let tracked = pb3dp(&words(&[&"track", &"--sequence", &case, &"--json"])).assert_success();
        let estimated = pb3dp(&words(&[&"estimate", &"--sequence", &case, &"--json"])).assert_success();
        let [tracked, estimated] = [&tracked, &estimated].map(|finished| {
            let line: serde_json::Value = serde_json::from_str(finished.stdout.lines().next().unwrap()).unwrap();
            assert!(line["status"] == "ok" && line["warnings"].as_array().unwrap().is_empty(), "{name}: {line}");
            line
        });
        let pose = |line: &serde_json::Value| -> Vec<f64> {
            line["cam_left_from_model"].as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
        };
        // Translations are in millimetres, rotations have no unit.
        for (index, (tracked, estimated)) in pose(&tracked).into_iter().zip(pose(&estimated)).enumerate() {
            let tolerance = if index % 4 == 3 { 0.3 } else { 0.005 };
            assert!((tracked - estimated).abs() < tolerance, "{name}, {index}: {tracked}, not {estimated}");
        }
    }
}

/// A folder of images: the pair of this folder, twice.
fn twice(pair: &Path) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (side, number) in [("left", 0), ("right", 0), ("left", 1), ("right", 1)] {
        let to = dir.path().join(format!("{side}_{number}.png"));
        std::fs::copy(pair.join(format!("{side}.png")), to).unwrap();
    }
    dir
}

/// The recording is read twice if it states no skew.
#[test]
fn the_assumed_range_of_depths_is_reported_once() {
    let case = repository().join("tests/data/cases/bb201_c0");
    let (dir, calibration, region) = (twice(&case), case.join("calib.json"), "rect:340,110,140,190");
    let all = words(&[&"track", &"--sequence", &dir.path(), &"--calib", &calibration, &"--region", &region]);
    let finished = pb3dp(&all).assert_success();
    assert_eq!(finished.stderr.matches("no --z-range given").count(), 1, "{}", finished.stderr);
}

/// A click takes what has its colour, which may not be the object that was meant.
#[test]
fn a_click_says_once_which_part_it_took() {
    let crab = OnePair::of(TargetConfig::crab(0.0));
    let calibration = crab.file("calib.json");
    let dir = twice(crab.dir.path());
    let click = format!("click:{:.0},{:.0}", crab.centre_px()[0], crab.centre_px()[1]);
    let all = words(&[&"track", &"--sequence", &dir.path(), &"--calib", &calibration, &"--region", &click]);
    let finished = pb3dp(&all).assert_success();
    let expected_click = "frame 0: the click has taken ";
    assert_eq!(finished.stderr.matches(expected_click).count(), 1, "{}", finished.stderr);
}

/// Writes the images of a sequence into a recording of ROS 2 in this order, with stamps of the frames in `stamps`. With `changed_at`, each
/// image has a `camera_info` after it; that of the right camera has another focal length from this frame on.
fn as_bag(sequence: &Path, file: &Path, stamps: &[usize], changed_at: Option<usize>) {
    let mut writer = BagWriter::create(file, WhenFull::Wait).unwrap();
    let infos = ros_camera_infos(&rig()).unwrap();
    for (number, &frame) in stamps.iter().enumerate() {
        let written_at = MonotonicTime::from_nanos(1_000_000 * number as u64);
        let stamp = MonotonicTime::from_nanos(2_000_000_000 + 33_000_000 * frame as u64);
        let sides = [(ours::LEFT_IMAGE, ours::LEFT_INFO, "left"), (ours::RIGHT_IMAGE, ours::RIGHT_INFO, "right")];
        for ((topic, info_topic, side), info) in sides.into_iter().zip(&infos) {
            let image = load_rgb(&sequence.join(format!("{side}_{number:04}.png"))).unwrap();
            let (width, height) = image.dimensions();
            let header = Header { stamp: stamp.into(), frame_id: side.to_owned() };
            let (encoding, data) = ("rgb8".to_owned(), Bytes(image.into_raw()));
            let message =
                Image { header: header.clone(), height, width, encoding, is_bigendian: 0, step: 3 * width, data };
            writer.push(topic, written_at, &message);
            let Some(changed_at) = changed_at else { continue };
            let zoom = if side == "right" && frame >= changed_at { 1.1 } else { 1.0 };
            let mut k = info.camera_matrix;
            (k[0], k[4]) = (zoom * k[0], zoom * k[4]);
            let message = CameraInfo {
                header,
                height,
                width,
                distortion_model: info.distortion_model.to_owned(),
                d: info.distortion.clone(),
                k,
                r: info.rectification,
                p: info.projection,
                binning_x: 0,
                binning_y: 0,
                roi: RegionOfInterest::default(),
            };
            writer.push(info_topic, written_at, &message);
        }
    }
    writer.finish().unwrap();
}

/// Stamps that go back were the end of the program.
#[test]
fn pairs_whose_times_go_back_repeat_or_jump_are_left_out_and_named() {
    let dir = tempfile::tempdir().unwrap();
    let sequence = dir.path().join("sequence");
    record(&sequence);
    let first =
        format!("1 (the first is pair 0 of the recording: 31.700000 s before 2.033000 s in {})", ours::LEFT_IMAGE);
    let left_out = "pairs left out, because their times go back, repeat or jump: 1";
    for (name, stamps, tracked, warning) in [
        ("exchanged", [0, 1, 3, 2, 4, 5, 6], 6, left_out),
        ("repeated", [0, 1, 2, 2, 4, 5, 6], 6, left_out),
        ("jumped", [0, 1, 900, 3, 4, 5, 6], 6, left_out),
        ("first", [900, 1, 2, 3, 4, 5, 6], 6, &first),
        ("equal", [0; FRAMES], FRAMES, "all pairs have the same time, 2.000000 s"),
    ] {
        let bag = dir.path().join(format!("{name}.mcap"));
        as_bag(&sequence, &bag, &stamps, None);
        let calib = sequence.join("calib.json");
        let region = "rect:140,110,60,60";
        let args: [&dyn AsRef<OsStr>; 8] =
            [&"track", &"--sequence", &bag, &"--calib", &calib, &"--region", &region, &"--json"];
        let finished = pb3dp(&words(&args)).assert_success();
        assert_eq!(finished.json_lines(&TRACK_KEYS).len(), tracked, "{name}: {}", finished.stdout);
        assert!(finished.stderr.contains(warning), "{name}: {}", finished.stderr);
        // Each pair can be chosen, too.
        let args: [&dyn AsRef<OsStr>; 9] =
            [&"estimate", &"--sequence", &bag, &"--frame", &"3", &"--calib", &calib, &"--region", &region];
        pb3dp(&words(&args)).assert_success();
    }
}

/// The calibration of the begin was used for all pairs.
#[test]
fn a_change_of_the_calibration_begins_a_segment() {
    let dir = tempfile::tempdir().unwrap();
    let sequence = dir.path().join("sequence");
    record(&sequence);
    let stamps: Vec<usize> = (0..FRAMES).collect();
    let warning = format!(
        "the calibration changes at pair 4 ({}, 2.132000 s): 4 pairs are used, and 3 are not; these need --segment 2,",
        ours::RIGHT_INFO
    );
    for (name, changed_at, used) in [("changed", 4, 4), ("same", 100, FRAMES), ("at_once", 0, FRAMES)] {
        let bag = dir.path().join(format!("{name}.mcap"));
        as_bag(&sequence, &bag, &stamps, Some(changed_at));
        let track = |more: &[&dyn AsRef<OsStr>]| {
            let args: [&dyn AsRef<OsStr>; 6] =
                [&"track", &"--sequence", &bag, &"--region", &"rect:140,110,60,60", &"--json"];
            let finished = pb3dp(&words(&[&args, more].concat())).assert_success();
            (finished.json_lines(&TRACK_KEYS).len(), finished.stderr.contains(&warning))
        };
        assert_eq!(track(&[]), (used, name == "changed"), "{name}");
        // A calibration that the user gives holds for the whole recording.
        assert_eq!(track(&[&"--calib", &sequence.join("calib.json")]), (FRAMES, false), "{name}");
        let out = dir.path().join(name);
        let extracted = pb3dp(&words(&[&"extract", &bag, &"--out", &out])).assert_success();
        assert_eq!(std::fs::read_dir(out.join("right")).unwrap().count(), used);
        assert_eq!(extracted.stderr.contains(&warning), name == "changed", "{}", extracted.stderr);
        let second = dir.path().join(format!("{name}_2"));
        let extracted = pb3dp(&words(&[&"extract", &bag, &"--segment", &"2", &"--out", &second]));
        if name != "changed" {
            assert!(extracted.stderr.contains("--segment 2 does not exist: there are 1"));
            continue;
        }
        extracted.assert_success();
        assert_eq!(std::fs::read_dir(second.join("right")).unwrap().count(), FRAMES - 4);
        let focal_px = |folder: &Path| load_stereo(&[folder.join("calib.json")]).unwrap().rig.right().pinhole().fx;
        assert!((focal_px(&second) / focal_px(&out) - 1.1).abs() < 1e-9);
    }
}
