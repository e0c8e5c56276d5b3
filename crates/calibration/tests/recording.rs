//! Recordings at full frame rate: selected pairs, resulting calibrations, and reports.

use crate::film;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use crate::film::{AT_REST, Studio, places, record, rig};
use crate::program::{Output, calibrate};
use crate::support::board;
use image::RgbImage;
use nalgebra::Isometry3;
use pb3dp_bag::cdr::Bytes;
use pb3dp_bag::messages::{Header, Image};
use pb3dp_bag::run_messages::{SetupFile, SetupFiles};
use pb3dp_bag::writer::{BagWriter, WhenFull};
use pb3dp_geometry::frames::{Base, Flange};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_record::calibration_files::{
    BoardPlace, CameraIdentity, HandEye, JudgedGate, Judgement, cameras_text, load_hand_eye, load_stereo,
    save_hand_eye, save_json,
};
use pb3dp_record::dataset::load_sequence;
use pb3dp_record::images::load_rgb;
use pb3dp_record::stops::{ArmStand, Stop, Stops, save_stops};

const BOARD: [&str; 4] = ["--board", "9x6", "--square", "25"];

/// Saves the pairs of these board poses in a folder, each as a stop of an arm.
fn record_stops(folder: &Path, studio: &Studio, stops: &[(Isometry3<f64>, Pose<Base, Flange>)]) {
    let stop = |(number, (place, base_from_flange)): (usize, &(Isometry3<f64>, Pose<Base, Flange>))| {
        let [left, right] = ["left", "right"].map(|side| format!("{side}_{number}.png"));
        for (image, name) in studio.pair(place, 0.0).iter().zip([&left, &right]) {
            image.save(folder.join(name)).expect("written");
        }
        Stop { left, right, vs: ArmStand { joints_rad: [0.1; 7], base_from_flange: *base_from_flange }, tc: None }
    };
    let stops = stops.iter().enumerate().map(stop).collect();
    save_stops(folder, &Stops { date: "2026-11-22T09:00:00Z".to_owned(), stops }).expect("written");
}

/// Tags are closed in the order in which they are opened, and no external resource is loaded.
fn check_html(html: &str) {
    let mut open: Vec<&str> = Vec::new();
    for tag in html.split('<').skip(1) {
        let tag = tag.split('>').next().expect("a tag");
        let name = tag.trim_start_matches('/').split([' ', '/']).next().expect("a name");
        if ["!doctype", "meta", "img"].contains(&name) || tag.ends_with('/') {
            continue;
        }
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name), "</{name}>");
        } else {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "{open:?}");
    // Base64 image data may contain any letters.
    let images = html.split("base64,").skip(1).map(|rest| rest.split('"').next().expect("an end"));
    let html_text = images.fold(html.to_owned(), |html, image| html.replace(image, ""));
    // The content policy of the page is no link.
    let html_text = html_text.replace("http-equiv", "");
    assert!(!html_text.contains("<script") && !html_text.contains("http") && !html_text.contains("NaN"), "{html_text}");
}

/// Frames selected as views.
fn frames(corners: &Path) -> BTreeSet<usize> {
    let text = fs::read_to_string(corners).expect("corners");
    let number = |line: &str| line.split(',').next().expect(line).parse().expect(line);
    text.lines().skip(1).map(number).collect()
}

#[test]
fn views_are_chosen_from_a_recording_and_the_head_is_found() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = folder.path().join("recording");
    let studio = Studio::new(rig());
    let places = places(&studio.rig);
    let blurred = 9;
    let rests = record(&recording, &studio, &places, blurred);
    let path = |name: &str| folder.path().join(name).display().to_string();
    let (corners, toml, html) = (path("corners.csv"), path("calib.toml"), path("report.html"));
    let recording = recording.display().to_string();
    let made = ["--lens", "radial-2", "--corners", &corners, "--out", &toml, "--report", &html];
    let output = calibrate(&[&["stereo", "--recording", &recording], &BOARD, &made]).succeeded();
    output.contains_all(&[&format!("of {} pairs, selected", rests.len()), "the board moves faster than"]);
    let chosen = frames(Path::new(&corners));
    let at: BTreeSet<Option<usize>> = chosen.iter().map(|frame| rests[*frame]).collect();
    assert!(!at.contains(&None) && !at.contains(&Some(blurred)), "{chosen:?}");
    assert_eq!(at.len(), chosen.len(), "one per board pose: {chosen:?}");
    assert!(at.len() >= places.len() - 2, "{at:?}");
    let calibration = load_stereo(&[toml.clone().into()]).expect("a calibration");
    let (found, truth) = (&calibration.rig, &studio.rig);
    let baseline = found.baseline_m() / truth.baseline_m() - 1.0;
    let focal = found.left().pinhole().fx / truth.left().pinhole().fx - 1.0;
    println!("baseline {:+.3} %, focal length {:+.3} % wrong", 100.0 * baseline, 100.0 * focal);
    assert!(baseline.abs() < 0.005 && focal.abs() < 0.005);
    report_says_what_the_file_says(&html, &calibration.judgement.expect("judged").gates, &output);
    verified(&toml, &recording);
    assert!(chosen.len() * AT_REST < rests.len());
    let mcap = folder.path().join("board.mcap");
    let date = as_mcap(Path::new(&recording), &mcap);
    let (mcap, second) = (mcap.display().to_string(), path("of_mcap.toml"));
    let made = ["--lens", "radial-2", "--out", &second];
    let output = calibrate(&[&["stereo", "--recording", &mcap], &BOARD, &made]);
    // The recording has a cameras.toml.
    output.contains_all(&[&format!("of {} pairs, selected {}", rests.len(), chosen.len()), "cameras: "]);
    let second = load_stereo(&[second.into()]).expect("a calibration");
    assert_eq!(second.rig, calibration.rig, "the same images give the same calibration");
    let judgement = second.judgement.expect("judged");
    assert_eq!((judgement.date, judgement.cameras[1].serial.as_deref()), (date, Some("R-2")));
}

fn rgb_message(image: RgbImage, at: MonotonicTime) -> Image {
    let (width, height) = image.dimensions();
    let header = Header { stamp: at.into(), frame_id: String::new() };
    let (encoding, data) = ("rgb8".to_owned(), Bytes(image.into_raw()));
    Image { header, height, width, encoding, is_bigendian: 0, step: 3 * width, data }
}

/// The images of a sequence in an MCAP file, with the identities of the cameras, as ROS 2 messages of another program. Returns when the last one
/// was taken.
fn as_mcap(folder: &Path, file: &Path) -> String {
    let sequence = load_sequence(folder).expect("a sequence");
    let mut writer = BagWriter::create(file, WhenFull::Wait).expect("a file");
    let cameras =
        ["L-1", "R-2"].map(|serial| CameraIdentity { serial: Some(serial.to_owned()), place: None, focus: None });
    let identities = SetupFile { path: "cameras.toml".to_owned(), data: Bytes(cameras_text(&cameras).into_bytes()) };
    writer.push("/pb3dp/files", MonotonicTime::ZERO, &SetupFiles { files: vec![identities] });
    // 2026-05-04, 03:02:22 UTC.
    let begin = Duration::from_secs(1_777_863_742);
    for (number, time_s) in (0..).zip(&sequence.times_s) {
        let at = MonotonicTime::ZERO + begin + Duration::from_secs_f64(*time_s);
        let (left, right) = sequence.image_files(number);
        for (name, topic) in [(left, "/left/image_raw"), (right, "/right/image_raw")] {
            writer.push(topic, at, &rgb_message(load_rgb(&name).expect("an image"), at));
        }
    }
    writer.finish().expect("written");
    let last_s = 22.0 + sequence.times_s.last().expect("a pair");
    assert!(last_s < 60.0, "the same minute");
    format!("2026-05-04T03:02:{:02}Z", last_s.floor())
}

#[test]
fn images_with_both_views_are_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let (sides, both) = (folder.path().join("sides"), folder.path().join("both"));
    for sub in [&sides, &both] {
        fs::create_dir(sub).expect("a folder");
    }
    let studio = Studio::new(rig());
    for (number, place) in places(&studio.rig).iter().enumerate().take(6) {
        let pair = studio.pair(place, 0.0);
        let (width, height) = pair[0].dimensions();
        let mut whole = RgbImage::new(2 * width, height);
        for (side, image) in (0_i64..).zip(&pair) {
            image::imageops::replace(&mut whole, image, side * i64::from(width), 0);
        }
        whole.save(both.join(format!("{number:02}.png"))).expect("written");
        for (image, side) in pair.iter().zip(["left", "right"]) {
            image.save(sides.join(format!("{side}_{number:02}.png"))).expect("written");
        }
    }
    let found = |path: &Path, more: &[&str]| {
        let corners = folder.path().join("corners.csv").display().to_string();
        let path = path.display().to_string();
        let made = ["--lens", "radial-1", "--corners", &corners];
        calibrate(&[&["stereo", "--recording", &path], &BOARD, &made, more]).contains_all(&["views = 6.000"]);
        let corners = fs::read_to_string(corners).expect("corners");
        let without_name = |line: &str| line.split_once(',').expect("a table").1.to_owned();
        corners.lines().map(without_name).collect::<Vec<_>>()
    };
    let apart = found(&sides, &[]);
    assert!(apart.len() > 600, "nearly all 648 corners of both cameras: {}", apart.len());
    assert_eq!(apart, found(&both, &["--layout", "side-by-side"]));
    let path = both.display().to_string();
    calibrate(&[&["stereo", "--recording", &path], &BOARD]).refused().contains_all(&["no recording"]);
}

fn report_says_what_the_file_says(html: &str, gates: &[JudgedGate], output: &Output) {
    says(html, gates, output);
    let html = fs::read_to_string(html).expect("a report");
    assert!(html.contains("data:image/jpeg;base64,") && html.matches("drawn").count() > 4);
}

/// Checks that a page shows the gates and the verdict of the file and of the printed output.
fn says(html: &str, gates: &[JudgedGate], output: &Output) {
    let html = fs::read_to_string(html).expect("a report");
    check_html(&html);
    for gate in gates {
        let row = format!("<td>{}</td><td>{}</td><td>{:.3}</td>", gate.name, gate.grade, gate.measured);
        assert!(html.contains(&row), "{row}");
    }
    let verdict = output.text.lines().find_map(|line| line.strip_prefix("verdict: ")).expect("a verdict");
    assert!(html.contains(&format!("Verdict: {verdict}")), "{verdict}");
}

/// The same board passes verification, a wrong square size does not.
fn verified(toml: &str, recording: &str) {
    let verify = |square: &str, corners: &[&str]| {
        calibrate(&[&["verify", toml, "--recording", recording, "--board", "9x6", "--square", square], corners])
    };
    verify("25", &["--corners", "0,0", "8,5", "--length", "235.85"])
        .succeeded()
        .contains_all(&["good     length_percent"]);
    for (square, corners, named) in [
        // Lengths are 1.96 % short: 25 / 25.5.
        ("25.5", &[][..], "refused  scale_percent = 1.9"),
        ("25", &["--corners", "0,0", "8,5", "--length", "231"], "refused  length_percent = 2."),
        ("25", &["--corners", "0,0", "9,5", "--length", "231"], "corner 9,5 is visible to both cameras in no view"),
    ] {
        verify(square, corners).refused().contains_all(&[named]);
    }
}

#[test]
fn each_stop_of_an_arm_is_a_view() {
    let folder = tempfile::tempdir().expect("a folder");
    let studio = Studio::new(rig());
    let stops: Vec<_> = places(&studio.rig).into_iter().take(6).map(|place| (place, Pose::coincident())).collect();
    record_stops(folder.path(), &studio, &stops);
    let corners = folder.path().join("corners.csv").display().to_string();
    let recording = folder.path().display().to_string();
    let made = ["--lens", "radial-1", "--corners", &corners];
    calibrate(&[&["stereo", "--recording", &recording], &BOARD, &made]).contains_all(&["views = 6.000"]);
    let corners_text = fs::read_to_string(&corners).expect("corners");
    assert!(corners_text.contains("\nstop 00,left,0,0,") && corners_text.contains("\nstop 05,right,8,5,"));
}

/// Cameras without a common trigger: their images are 4 ms apart.
#[test]
fn each_stop_in_a_file_is_a_view() {
    let folder = tempfile::tempdir().expect("a folder");
    let studio = Studio::new(rig());
    let file = folder.path().join("stops.mcap");
    let mut writer = BagWriter::create(&file, WhenFull::Wait).expect("a file");
    for (number, place) in (0..6).zip(&places(&studio.rig)) {
        let at = MonotonicTime::ZERO + Duration::from_secs(1_777_863_742 + 5 * number);
        let topics = [("/left/image_raw", at), ("/right/image_raw", at + Duration::from_millis(4))];
        for (image, (topic, at)) in studio.pair(place, 0.0).into_iter().zip(topics) {
            writer.push(topic, at, &rgb_message(image, at));
        }
        let stand =
            pb3dp_bag::stops::of_stand(&ArmStand { joints_rad: [0.1; 7], base_from_flange: Pose::coincident() });
        writer.push("/pb3dp/stops", at, &pb3dp_bag::run_messages::Stop { stamp: at.into(), vs: stand, tc: Vec::new() });
    }
    writer.finish().expect("written");
    let path = file.display().to_string();
    calibrate(&[&["stereo", "--recording", &path, "--lens", "radial-1"], &BOARD]).contains_all(&["views = 6.000"]);
}

/// The cameras see a stationary board from many stops.
#[test]
fn what_was_touched_is_where_the_cameras_say() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    let studio = Studio::new(rig());
    let pose = |shift: [f64; 3], turn: [f64; 3]| Isometry3::new(shift.into(), turn.into());
    let base_from_board = pose([0.52, -0.11, 0.07], [2.9, 0.2, -0.4]);
    let flange_from_cam_left = pose([0.031, -0.045, 0.082], [0.1, -0.2, 1.4]);
    let stop = |cam_left_from_board: Isometry3<f64>| {
        let base_from_flange = base_from_board * cam_left_from_board.inverse() * flange_from_cam_left.inverse();
        (cam_left_from_board, Pose::from_isometry(base_from_flange))
    };
    record_stops(folder.path(), &studio, &places(&studio.rig).into_iter().map(stop).collect::<Vec<_>>());
    save_json(&studio.rig, &path("calib.json")).expect("written");
    let judgement = Judgement {
        date: "2026-11-22T10:00:00Z".to_owned(),
        tool: "a test".to_owned(),
        source: "exact".to_owned(),
        cameras: Default::default(),
        numbers: Vec::new(),
        covariance: None,
        gates: Vec::new(),
    };
    let place = BoardPlace::Room { base_from_board: Pose::from_isometry(base_from_board) };
    let flange_from_cam_left = Pose::from_isometry(flange_from_cam_left);
    let hand_eye = HandEye { flange_from_cam_left, board: place, judgement };
    save_hand_eye(&hand_eye, &path("hand_eye.toml")).expect("written");
    // The third point has a reading error of `off_mm`.
    let touch_file = |off_mm: f64| {
        let place = |([column, row], off_mm): ([u32; 2], f64)| {
            let at = base_from_board * board().corner_in_board(column, row) * 1e3;
            let (x, y, z) = (at.x, at.y + off_mm, at.z);
            format!("[[touch]]\nboard_corner = [{column}, {row}]\nbase_position_mm = [{x:.2}, {y:.2}, {z:.2}]\n")
        };
        [([0, 0], 0.0), ([8, 0], 0.0), ([3, 5], off_mm)].map(place).concat()
    };
    let verify = |off_mm: f64| {
        fs::write(path("touch.toml"), touch_file(off_mm)).expect("written");
        let [calib, recording, touch, hand_eye] =
            ["calib.json", "", "touch.toml", "hand_eye.toml"].map(|name| path(name).display().to_string());
        let touched = ["--touch", &touch, "--hand-eye", &hand_eye];
        calibrate(&[&["verify", &calib, "--recording", &recording], &BOARD, &touched])
    };
    verify(0.0).succeeded().contains_all(&["good     touch_mm = 0."]);
    hand_eye_has_a_report(folder.path());
    let wrong = verify(-5.0).refused();
    wrong.contains_all(&["refused  touch_mm = "]);
    assert!(wrong.text.lines().any(|line| line.starts_with("corner 3,5: touched at") && line.contains("12 stops")));
}

/// The report of a hand-eye calibration from the stops of a folder agrees with its file.
fn hand_eye_has_a_report(folder: &Path) {
    let [recording, calib, html, out] =
        ["", "calib.json", "hand.html", "found.toml"].map(|name| folder.join(name).display().to_string());
    let made = ["--report", &html, "--out", &out];
    let output = calibrate(&[&["hand-eye", "--recording", &recording, "--calib", &calib], &BOARD, &made]);
    let gates = load_hand_eye(Path::new(&out)).expect("a calibration").judgement.gates;
    assert_eq!(gates.len(), 8);
    says(&html, &gates, &output);
    let page = fs::read_to_string(&html).expect("a page");
    assert!(page.contains("left_5.png") && page.contains("base_from_board.rz, degrees"));
}

/// Output lines of a program, one by one.
fn lines(child: &mut std::process::Child) -> impl Iterator<Item = String> + use<> {
    let stdout = child.stdout.take().expect("a pipe");
    std::io::BufRead::lines(std::io::BufReader::new(stdout)).map(|line| line.expect("a line"))
}

/// The recording grows only after the coach has printed a line about the previous pairs, so no timing is involved.
#[test]
fn the_coach_looks_at_a_recording_that_grows() {
    let folder = tempfile::tempdir().expect("a folder");
    let (recording, page) = (folder.path().join("live"), folder.path().join("coach.html"));
    let studio = Studio::new(rig());
    let places = places(&studio.rig);
    let mut child = Command::new(env!("CARGO_BIN_EXE_pb3dp-calibrate"))
        .args(["coach", &recording.display().to_string(), "--board", "9x6", "--square", "25"])
        .args(["--page", &page.display().to_string()])
        .stdout(std::process::Stdio::piped())
        .spawn()
        .expect("it starts");
    let mut output_text = lines(&mut child);
    let mut assert_next = |part: &str| {
        let line = output_text.next().expect("a line");
        assert!(line.contains(part), "{line}");
    };
    assert_next("waiting for images");
    let mut writer = film::writer(&recording, &studio.rig);
    let pair = studio.pair(&places[0], 0.0);
    film::push(&mut writer, &pair);
    // One pair alone does not show whether the board is stationary.
    assert_next("0 views, 0 % covered: the board is moving");
    assert_next("next: hold the board in the middle of the images");
    film::push(&mut writer, &pair);
    assert_next("1 views");
    assert_next("next: ");
    film::push(&mut writer, &pair);
    assert_next("similar to an earlier view");
    assert_next("next: ");
    for _ in 0..2 {
        film::push(&mut writer, &studio.pair(&places[3], 0.0));
    }
    let taken = output_text.by_ref().find(|line| line.contains("2 views")).expect("a line");
    assert!(taken.contains("taken"), "{taken}");
    let next = output_text.next().expect("a line");
    println!("{taken}\n{next}");
    let html = fs::read_to_string(&page).expect("a page");
    check_html(&html.replace("http-equiv", ""));
    writer.finish().expect("written");
    let rest: Vec<String> = output_text.collect();
    assert!(rest.iter().any(|line| line.contains("the recording ended with 2 views")), "{rest:?}");
    assert!(!child.wait().expect("it ends").success());
    assert!(html.contains("Calibration coach") && html.contains("http-equiv=\"refresh\""));
}
