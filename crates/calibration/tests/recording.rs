//! Recordings at full rate: which pairs are taken, what comes of them, and what the report says.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "tests may fail loudly, and show what they measured"
)]

#[path = "support/film.rs"]
mod film;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use film::{AT_REST, Studio, board, places, record, rig};
use pb3dp_geometry::Pose;
use pb3dp_record::calibration_files::load_stereo;
use pb3dp_record::stops::{ArmStand, Stop, Stops, save_stops};

fn calibrate(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pb3dp-calibrate")).args(args).output().expect("it starts")
}

fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// Tags are closed in the order in which they are opened, and nothing is loaded from elsewhere.
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
    // Pictures are letters that may say anything.
    let pictures = html.split("base64,").skip(1).map(|rest| rest.split('"').next().expect("an end"));
    let said = pictures.fold(html.to_owned(), |html, picture| html.replace(picture, ""));
    assert!(!said.contains("<script") && !said.contains("http") && !said.contains("NaN"), "{said}");
}

/// Frames that were taken as views.
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
    let common = ["--recording", &recording, "--board", "9x6", "--square"];
    let made = ["25", "--lens", "radial-2", "--corners", &corners, "--out", &toml, "--report", &html];
    let output = calibrate(&[&["stereo"], &common[..], &made].concat());
    let told = text(&output);
    println!("{told}");
    assert!(output.status.success(), "{told}");
    assert!(told.contains(&format!("of {} pairs, took", rests.len())), "{told}");
    assert!(told.contains("the board moves by more than"), "{told}");
    let chosen = frames(Path::new(&corners));
    let at: BTreeSet<Option<usize>> = chosen.iter().map(|frame| rests[*frame]).collect();
    assert!(!at.contains(&None) && !at.contains(&Some(blurred)), "{chosen:?}");
    assert_eq!(at.len(), chosen.len(), "one of each place: {chosen:?}");
    assert!(at.len() >= places.len() - 2, "{at:?}");
    let calibration = load_stereo(&[toml.clone().into()]).expect("a calibration");
    let (found, truth) = (&calibration.rig, &studio.rig);
    let baseline = found.baseline_m() / truth.baseline_m() - 1.0;
    let focal = found.left().pinhole().fx / truth.left().pinhole().fx - 1.0;
    println!("baseline {:+.3} %, focal length {:+.3} % wrong", 100.0 * baseline, 100.0 * focal);
    assert!(baseline.abs() < 0.005 && focal.abs() < 0.005);
    report_says_what_the_file_says(&html, &calibration.judgement.expect("judged").gates, &told);
    verified(&toml, &common);
    assert!(chosen.len() * AT_REST < rests.len());
}

fn report_says_what_the_file_says(html: &str, gates: &[pb3dp_record::calibration_files::JudgedGate], told: &str) {
    let html = fs::read_to_string(html).expect("a report");
    check_html(&html);
    for gate in gates {
        let row = format!("<td>{}</td><td>{}</td><td>{:.3}</td>", gate.name, gate.grade, gate.measured);
        assert!(html.contains(&row), "{row}");
    }
    let verdict = told.lines().find_map(|line| line.strip_prefix("verdict: ")).expect("a verdict");
    assert!(html.contains(&format!("Verdict: {verdict}")), "{verdict}");
    assert!(html.contains("data:image/jpeg;base64,") && html.matches("drawn").count() > 4);
}

/// The same board holds, one that is typed wrong does not.
fn verified(toml: &str, common: &[&str]) {
    let verify = |square: &str, further: &[&str]| calibrate(&[&["verify", toml], common, &[square], further].concat());
    let good = verify("25", &["--corners", "0,0", "8,5", "--length", "235.85"]);
    println!("{}", text(&good));
    assert!(good.status.success() && text(&good).contains("good     length_percent"), "{}", text(&good));
    let typed_wrong = verify("25.5", &[]);
    assert!(
        !typed_wrong.status.success() && text(&typed_wrong).contains("refused  scale_percent = 1.8"),
        "{}",
        text(&typed_wrong)
    );
    let measured_wrong = verify("25", &["--corners", "0,0", "8,5", "--length", "231"]);
    assert!(!measured_wrong.status.success() && text(&measured_wrong).contains("refused  length_percent = 2."));
    let no_corner = verify("25", &["--corners", "0,0", "9,5", "--length", "231"]);
    assert!(text(&no_corner).contains("corner 9,5 is seen by both cameras in no view"), "{}", text(&no_corner));
}

#[test]
fn each_stop_of_an_arm_is_a_view() {
    let folder = tempfile::tempdir().expect("a folder");
    let studio = Studio::new(rig());
    let stand = ArmStand { joints_rad: [0.1; 7], base_from_flange: Pose::coincident() };
    let mut stops = Vec::new();
    for (number, place) in places(&studio.rig).iter().enumerate().take(6) {
        let names = ["left", "right"].map(|side| format!("{side}_{number}.png"));
        for (picture, name) in studio.pair(place, 0.0).iter().zip(&names) {
            picture.save(folder.path().join(name)).expect("written");
        }
        let [left, right] = names;
        stops.push(Stop { left, right, vs: stand, tc: None });
    }
    save_stops(folder.path(), &Stops { date: "2026-11-22T09:00:00Z".to_owned(), stops }).expect("written");
    let corners = folder.path().join("corners.csv").display().to_string();
    let recording = folder.path().display().to_string();
    let board = format!("{}x{}", board().columns(), board().rows());
    let args = ["stereo", "--recording", &recording, "--board", &board, "--square", "25", "--lens", "radial-1"];
    let output = calibrate(&[&args[..], &["--corners", &corners]].concat());
    let seen = fs::read_to_string(&corners).expect("corners");
    assert!(text(&output).contains("views = 6.000"), "{}", text(&output));
    assert!(seen.contains("\nstop 00,left,0,0,") && seen.contains("\nstop 05,right,8,5,"), "{}", text(&output));
}
