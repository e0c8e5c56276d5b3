//! What the program refuses, and how it says so.

use std::ffi::{OsStr, OsString};
use std::io::{PipeWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use nalgebra::Vector3;
use pb3dp_geometry::{Pose, so3};
use pb3dp_record::stops::{ArmOfPoses, WantedPoses, save_poses};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::cli::support::*;
use crate::real_time::arm::{FIRST_RUN, pb3dp_arm, setup_at};

/// One real pair, copied, with the words that estimate it.
struct Pair {
    dir: tempfile::TempDir,
}

impl Pair {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        copy_of_real_cases(dir.path());
        Self { dir }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.dir.path().join("bb201_c0").join(name)
    }

    fn words(&self, left: &Path, right: &Path, calibration: &Path, region: &str) -> Vec<OsString> {
        words(&[
            &"estimate",
            &"--left",
            &left,
            &"--right",
            &right,
            &"--calib",
            &calibration,
            &"--region",
            &region,
            &"--json",
        ])
    }

    fn estimate(&self, region: &str) -> Finished {
        pb3dp(&self.words(&self.file("left.png"), &self.file("right.png"), &self.file("calib.json"), region))
    }
}

const REGION: &str = "rect:340,110,140,190";

#[test]
fn options_of_recordings_are_refused_for_two_images_and_for_cases() {
    let pair = Pair::new();
    let files = pair.words(&pair.file("left.png"), &pair.file("right.png"), &pair.file("calib.json"), REGION);
    let cases = words(&[&"estimate", &"--cases", &pair.dir.path()]);
    for option in [["--frame", "0"], ["--topics", "/l,/r"], ["--pair-within", "4"], ["--layout", "side-by-side"]] {
        for (args, instead) in [(&files, "--left"), (&cases, "--cases")] {
            pb3dp(&[&args[..], &option.map(OsString::from)].concat()).assert_refused(&[
                option[0],
                instead,
                "cannot be used with",
            ]);
        }
    }
    pb3dp(&[cases, words(&[&"--range", &"0,4095"])].concat()).assert_refused(&["--range", "--cases"]);
}

#[test]
fn options_without_effect_on_a_recording_are_refused() {
    let case = real_cases().join("bb201_c0");
    let options = [["--topics", "/l,/r"], ["--pair-within", "4"], ["--layout", "side-by-side"], ["--range", "0,4095"]];
    for command in ["track", "estimate"] {
        for option in options {
            pb3dp(&words(&[&command, &"--sequence", &case, &option[0], &option[1]])).assert_refused(&[
                &format!("{} has no effect", option[0]),
                "bb201_c0",
                "leave it out",
            ]);
        }
    }
    let rate = words(&[&"track", &"--sequence", &case, &"--rate", &"10"]);
    pb3dp(&rate).assert_refused(&["--rate 10 has no effect", "bb201_c0 is one pair", "leave it out"]);
}

#[test]
fn a_calibration_of_another_size_ends_track_at_once() {
    let pair = Pair::new();
    let text = std::fs::read_to_string(pair.file("calib.json")).unwrap();
    let (wrong, folder) = (pair.file("wrong.json"), pair.dir.path().join("images"));
    std::fs::write(&wrong, replaced(&text, "[640", "[800")).unwrap();
    std::fs::create_dir(&folder).unwrap();
    for (from, to) in ["left", "right"].into_iter().flat_map(|side| [0, 1].map(|n| (side, format!("{side}_{n}.png")))) {
        std::fs::copy(pair.file(&format!("{from}.png")), folder.join(to)).unwrap();
    }
    let refused =
        pb3dp(&words(&[&"track", &"--sequence", &folder, &"--calib", &wrong, &"--region", &REGION, &"--json"]));
    refused.assert_refused(&["the recording is not used", "640x480", "wrong.json", "800x480"]);
    assert_eq!((refused.stdout.as_str(), refused.stderr.matches("ERROR").count()), ("", 1), "{}", refused.stderr);
}

#[test]
fn a_recording_with_the_ending_of_another_file_is_refused() {
    let out = tempfile::tempdir().unwrap();
    let file = out.path().join("run.mcp");
    let run = pb3dp(&words(&[&"run", &"--config", &"sim", &"--out", &out.path().join("out"), &"--record", &file]));
    run.assert_refused(&["--record", "run.mcap, or a name without .mcp"]);
    assert!(!file.exists());
}

#[test]
fn an_access_without_a_panel_is_refused() {
    let run = words(&[&"run", &"--config", &"sim", &"--panel-token", &"absent"]);
    pb3dp(&run).assert_refused(&["--panel", "required"]);
}

#[test]
fn missing_and_damaged_files_are_named() {
    let pair = Pair::new();
    pair.estimate(REGION).assert_success();
    let (left, right, calibration) = (pair.file("left.png"), pair.file("right.png"), pair.file("calib.json"));
    let absent = pair.file("absent.png");
    for args in [
        pair.words(&absent, &right, &calibration, REGION),
        pair.words(&left, &absent, &calibration, REGION),
        pair.words(&left, &right, &absent, REGION),
        pair.words(&left, &right, &calibration, &format!("mask:{}", absent.display())),
    ] {
        let finished = pb3dp(&args);
        finished.assert_refused(&["absent.png", "[PB3DP-"]);
        assert_eq!(finished.stderr.to_lowercase().matches("no such file").count(), 1, "{}", finished.stderr);
    }
    let folder = pair.dir.path();
    pb3dp(&pair.words(folder, &right, &calibration, REGION)).assert_refused(&["is a folder; name the image file"]);
    pb3dp(&pair.words(&left, &right, &left, REGION)).assert_refused(&["left.png: is not text", "YAML or JSON"]);
    let mut overlay = pair.words(&left, &right, &calibration, REGION);
    overlay.extend(["--overlay".into(), left.clone().into()]);
    pb3dp(&overlay).assert_refused(&["--overlay", "left.png: is not a folder"]);
    let mut optimum = pair.words(&left, &right, &calibration, REGION);
    optimum.push("--reference-optimum".into());
    pb3dp(&optimum).assert_refused(&["--reference-optimum", "direct", "--method published"]);
    truncate(&right, 20_000);
    pair.estimate(REGION).assert_refused(&["right.png", "truncated", "[PB3DP-IMG-005]"]);
    std::fs::write(&right, "no image at all").unwrap();
    pair.estimate(REGION).assert_refused(&["right.png"]);
    std::fs::write(&calibration, "{\"image_size\": [640, 480]}").unwrap();
    pair.estimate(REGION).assert_refused(&["calib.json", "[PB3DP-CAL-006]"]);
}

#[test]
fn sizes_that_do_not_fit_are_named_with_both_sizes() {
    let pair = Pair::new();
    let text = std::fs::read_to_string(pair.file("calib.json")).unwrap();
    let mut value: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(numbers(&value["image_size"]), [640.0, 480.0]);
    value["image_size"] = serde_json::json!([800, 600]);
    let wrong = pair.file("wrong.json");
    std::fs::write(&wrong, value.to_string()).unwrap();
    pb3dp(&pair.words(&pair.file("left.png"), &pair.file("right.png"), &wrong, REGION)).assert_refused(&[
        "left.png",
        "wrong.json",
        "640x480",
        "800x600",
        "[PB3DP-IMG-006]",
    ]);
    let small = pair.file("small.png");
    image::open(pair.file("right.png")).unwrap().thumbnail_exact(320, 240).save(&small).unwrap();
    pb3dp(&pair.words(&pair.file("left.png"), &small, &pair.file("calib.json"), REGION)).assert_refused(&[
        "small.png",
        "320",
        "240",
        "640",
        "480",
    ]);
    let region = format!("mask:{}", small.display());
    pair.estimate(&region).assert_refused(&["mask", "320", "240", "640", "480"]);
    let photograph = format!("mask:{}", pair.file("left.png").display());
    pair.estimate(&photograph).assert_refused(&["left.png", "no black pixel"]);
}

#[test]
fn regions_that_can_not_serve_are_refused_with_what_to_do() {
    let pair = Pair::new();
    for (region, parts) in [
        ("rect:2000,100,50,50", &["outside the left image", "640", "[PB3DP-REG-"][..]),
        ("click:-5,10", &["(-5, 10)", "outside the left image", "[PB3DP-REG-"]),
        ("poly:-90,-90;-20,-90;-20,-20", &["outside the left image"]),
        ("rect:400,200,2,2", &["4 px", "larger area"]),
        ("rect:400,200,-20,20", &["must be positive"]),
        ("rect:1,2,3", &["has 3 numbers, expected 4"]),
        ("rect:0,0,999999,999999", &["999999 x 999999", "out of range"]),
        ("poly:0,0;1e300,0;0,1e300", &["vertex 1", "within 100000 px"]),
        ("poly:100,100;100,100;100,100", &["1 px", "larger area"]),
        ("circle:1,2,3", &["rect:", "poly:", "mask:", "click:"]),
    ] {
        pair.estimate(region).assert_refused(parts);
    }
}

#[test]
fn arguments_are_checked_before_anything_is_read() {
    let cases = real_cases();
    let with = |more: &[&str]| {
        let mut args = words(&[&"estimate", &"--cases", &cases, &"--json"]);
        args.extend(more.iter().map(OsString::from));
        pb3dp(&args)
    };
    let unknown = with(&["--method", "magic"]);
    unknown.assert_refused(&["'magic'", "published"]);
    assert_eq!(unknown.stdout, "");
    for bad in ["350", "650,350", "-1,5", "a,b", "0,100"] {
        with(&[&format!("--z-range={bad}")]).assert_refused(&["MIN,MAX", "millimetres"]);
    }
    with(&["--seed", "-1"]).assert_refused(&["-1", "whole number from 0"]);
    with(&["--deadline", "-1"]).assert_refused(&["-1", "milliseconds"]);
    with(&["--tilt-max", "95"]).assert_refused(&["95", "85 degrees"]);
    with(&["--left", "l.png"]).assert_refused(&["--cases", "--left"]);
    pb3dp(&words(&[&"estimate"])).assert_refused(&["--cases", "--left"]);
    pb3dp(&words(&[&"estimate", &"--left", &"l.png"])).assert_refused(&["--right", "--calib", "--region"]);
}

#[test]
fn configurations_are_refused_with_file_key_and_what_is_allowed() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mine.toml");
    let good = std::fs::read_to_string(repository().join("configs/estimator.toml")).unwrap();
    let run = |text: &str| {
        std::fs::write(&file, text).unwrap();
        pb3dp(&words(&[&"estimate", &"--cases", &real_cases(), &"--config", &file, &"--json"]))
    };
    run(&good).assert_success();
    let unknown = run(&replaced(&good, "\nelite = 1 ", "\nelites = 2\nelite = 1 "));
    unknown.assert_refused(&[
        "mine.toml",
        "published.rmga.elites",
        "unknown key",
        "did you mean elite?",
        "mine.toml:28:1",
    ]);
    run(&replaced(&good, "\nelite = 1 ", "\n# ")).assert_refused(&["mine.toml", "published.rmga", "elite", "missing"]);
    let far = run(&replaced(&good, "\nhue_tolerance_deg = 20.0 ", "\nhue_tolerance_deg = 200.0 "));
    far.assert_refused(&["mine.toml", "published.fitness.hue_tolerance_deg = 200", "0 to 180"]);
    run("[published\n").assert_refused(&["mine.toml"]);
    let setup = repository().join("configs/sim.toml");
    pb3dp(&words(&[&"estimate", &"--cases", &real_cases(), &"--config", &setup]))
        .assert_refused(&["sim.toml: this is a setup of `pb3dp run`", "configs/estimator.toml"]);
    pb3dp(&words(&[&"estimate", &"--cases", &real_cases(), &"--config", &dir.path().join("none.toml")]))
        .assert_refused(&["none.toml"]);
}

#[test]
fn a_folder_without_cases_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let empty = dir.path().join("empty");
    std::fs::create_dir(&empty).unwrap();
    pb3dp(&words(&[&"estimate", &"--cases", &empty])).assert_refused(&["case.json", "empty"]);
    pb3dp(&words(&[&"estimate", &"--cases", &dir.path().join("absent")])).assert_refused(&["absent"]);
    let refused = pb3dp(&words(&[&"track", &"--sequence", &empty]));
    refused.assert_refused(&["sequence.json", "empty", "[PB3DP-CAM-005]"]);
    assert!(!refused.stderr.contains("code="), "{}", refused.stderr);
}

/// A terminal that stands still, or a machine too busy to write the log: the program waited half a second, and said nothing.
#[test]
fn a_refusal_is_written_although_it_is_read_late() {
    let dir = tempfile::tempdir().unwrap();
    let (mut read, mut full) = std::io::pipe().unwrap();
    let has_room = |pipe: &PipeWriter| poll(&mut [PollFd::new(pipe, PollFlags::OUT)], Some(&Timespec::default()));
    while has_room(&full).unwrap() > 0 {
        full.write_all(&[b' '; 4096]).unwrap();
    }
    let mut child = Command::new(env!("CARGO_BIN_EXE_pb3dp"))
        .args(words(&[&"estimate", &"--cases", &dir.path()]))
        .stdout(Stdio::null())
        .stderr(full)
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    let mut text = String::new();
    read.read_to_string(&mut text).unwrap();
    assert!(!child.wait().unwrap().success());
    assert!(text.contains("case.json"), "{:?}", text.trim_start());
}

#[test]
fn a_damaged_case_costs_its_own_line_and_no_other() {
    let dir = tempfile::tempdir().unwrap();
    copy_of_real_cases(dir.path());
    let estimate = || pb3dp(&words(&[&"estimate", &"--cases", &dir.path(), &"--json"]));
    let whole = estimate().assert_success().json_lines(&ESTIMATE_KEYS);
    truncate(&dir.path().join("bb204_c0/left.png"), 5_000);
    std::fs::write(dir.path().join("bb209_c0/case.json"), "{ \"left\": ").unwrap();
    let finished = estimate();
    finished.assert_refused(&["bb204_c0", "left.png", "bb209_c0", "case.json"]);
    let lines = finished.json_lines(&ESTIMATE_KEYS);
    assert_eq!(lines.len(), whole.len());
    for (line, before) in lines.into_iter().zip(whole) {
        if ["bb204_c0", "bb209_c0"].contains(&line["case"].as_str().unwrap()) {
            assert_eq!((&line["case"], &line["status"]), (&before["case"], &"error".into()));
            assert!(ESTIMATE_KEYS[3..12].iter().all(|key| line[key].is_null()), "{line}");
            assert!(!line["reason"].as_str().unwrap().is_empty(), "{line}");
        } else {
            assert_eq!(without_time(line), without_time(before));
        }
    }
}

/// Shell history or a wrong --config must not move an arm; nothing is connected before the refusal.
#[test]
fn arms_that_are_not_emulated_do_not_move_by_a_command_line_alone() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let folder = setup_at(&listener.local_addr().unwrap().to_string());
    let (config, out) = (folder.path().join("cell.toml"), folder.path().join("out"));
    let run = |more: &[&str]| {
        let args = words(&[&"run", &"--config", &config, &"--out", &out]);
        let more = FIRST_RUN.iter().chain(more).map(|word| (*word).into());
        pb3dp(&args.into_iter().chain(more).collect::<Vec<_>>())
    };
    run(&[]).assert_refused(&["vs-robot: not emulated", "--operator console", "--move and type \"vs-robot\""]);
    run(&["--move"]).assert_refused(&["vs-robot was not typed", "nothing was moved"]);
    assert!(listener.accept().is_err(), "a port was opened");
    assert!(!out.exists());
}

/// Only the panel has a button to hold.
#[test]
fn commands_without_a_button_move_no_arm_that_needs_one_held() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let folder = setup_at(&listener.local_addr().unwrap().to_string());
    let (config, poses, out) =
        (folder.path().join("cell.toml"), folder.path().join("poses.toml"), folder.path().join("out"));
    let pose = Pose::from_parts(Vector3::new(0.66, 0.12, 0.25), so3::exp(&Vector3::new(0.0, 1.5, 0.1)));
    save_poses(&poses, &WantedPoses { arm: ArmOfPoses::Vs, poses: vec![pose] }).unwrap();
    let commands: [&[&dyn AsRef<OsStr>]; 5] = [
        &[&"arm", &"jog", &"--arm", &"vs", &"--axis", &"7", &"--by", &"1"],
        &[&"arm", &"home", &"--arm", &"vs"],
        &[&"arm", &"test", &"--arm", &"vs"],
        &[&"arm", &"visit", &"--emulated-board", &"9x6:20", &"--poses", &poses],
        &[&"identify", &"delay"],
    ];
    let set: [&dyn AsRef<OsStr>; 7] =
        [&"--move", &"--config", &config, &"--set", &"supervisor.hold_to_run=true", &"--out", &out];
    for command in commands {
        let refused = pb3dp(&words(&[command, &set].concat()));
        refused.assert_refused(&["supervisor.hold_to_run = true", "set supervisor.hold_to_run = false"]);
    }
    assert!(listener.accept().is_err(), "a port was opened");
    assert!(!out.exists());
}

/// Options by which a checklist starts its process are no way around the checks.
#[test]
fn options_of_a_checklist_move_nothing_without_its_settings() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let folder = setup_at(&address);
    let config = folder.path().join("cell.toml").display().to_string();
    let jog = ["jog", "--axis", "7", "--by", "1", "--move", "--alone"];
    let as_child = pb3dp_arm(&config, &[&jog[..], &["--report-joints"]].concat(), Some("vs-robot alone"));
    as_child.assert_refused(&["the settings have changed since the checklist began", "nothing was moved"]);
    let key = key_file().display().to_string();
    let elsewhere = [&jog[..], &["--line", &address, "--line-key", &key]].concat();
    let place = ["arm", "--config", &config, "--arm", "vs"];
    let refused = pb3dp(&[&place[..1], &elsewhere[..], &place[1..]].concat());
    assert!(!refused.success && refused.stderr.contains("--report-joints"), "{}", refused.stderr);
    assert!(listener.accept().is_err(), "a port was opened");
}

#[test]
fn fast_settings_of_arms_that_are_not_emulated_need_a_commissioning_record() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let folder = setup_at(&listener.local_addr().unwrap().to_string());
    let (config, record) = (folder.path().join("cell.toml"), folder.path().join("vs.json"));
    let run = |set: &[&str]| {
        let args = words(&[&"run", &"--operator", &"console", &"--config", &config]);
        let set = set.iter().flat_map(|set| ["--set", *set]).map(Into::into);
        pb3dp(&args.into_iter().chain(set).collect::<Vec<_>>())
    };
    let refused = run(&[]);
    refused.assert_refused(&["vs-robot is not emulated and may not move", "arms.vs.commissioning_record is not set"]);
    refused.assert_refused(&["arms.first_run = false", "arms.speed_scale = 0.6", "outlier.resume = \"by-itself\""]);
    refused.assert_refused(&["pb3dp arm test --arm vs --move"]);
    let file = format!("arms.vs.commissioning_record={}", record.display());
    run(&[&file]).assert_refused(&["vs.json: cannot be read"]);
    let steps = ["comms", "jog", "e-stop", "cable", "kill"];
    let write = |date: &str, emergency_stop: &str| {
        let steps: serde_json::Map<String, serde_json::Value> =
            steps.iter().map(|step| ((*step).to_owned(), date.into())).collect();
        let signals = serde_json::json!({
            "emergency_stop": emergency_stop,
            "limit_switch": "controller 0x2000 set",
            "dead_man": "controller 0x0001 clear",
            "power": "controller 0x0004 clear",
        });
        let value = serde_json::json!({
            "format": 2,
            "arm": "vs-robot",
            "fingerprint": { "arm_number": 1, "gateway": "x", "geometry": "unknown", "eeprom_deg": [] },
            "setup": {
                "signals": signals,
                "wire_format": "format B (big-endian, 6 and 10 bytes per axis)",
                "dialect": "gateway-v1",
                "operating_range_deg": vec![[-360.0, 360.0]; 7],
            },
            "gateway": {
                "cycle_us": 2000,
                "ramp_after_us": 20000,
                "stop_after_us": 50000,
                "controller_watchdog_us": 0,
                "brake_us": 200000,
                "range_deg": [],
            },
            "steps": steps,
        });
        std::fs::write(&record, value.to_string()).unwrap();
    };
    let signals = [
        "emergency_stop=controller 0x0008 set",
        "limit_switch=controller 0x2000 set",
        "dead_man=controller 0x0001 clear",
        "power=controller 0x0004 clear",
    ]
    .map(|signal| format!("arms.vs.gateway.signals.{signal}"));
    let all: Vec<&str> = signals.iter().chain([&file]).map(String::as_str).collect();
    write("2020-01-01T00:00:00Z", "controller 0x0010 set");
    run(&all).assert_refused(&[
        "signals.emergency_stop is \"controller 0x0008 set\", its steps were passed with \"controller 0x0010 set\"",
        "run `pb3dp arm test --arm vs --move`",
    ]);
    std::fs::write(&record, "{ \"format\": 1, \"arm\": \"vs-robot\" }").unwrap();
    run(&all).assert_refused(&["format is too old", "run `pb3dp arm test --arm vs --move`"]);
    write("2020-01-01T00:00:00Z", "controller 0x0008 set");
    run(&all).assert_refused(&["the step comms was passed on 2020-01-01T00:00:00Z, more than 90 days ago"]);
    assert!(listener.accept().is_err(), "a port was opened");
}

/// A measurement of the delays moves the hand, as a run does.
#[test]
fn a_measurement_of_the_delays_needs_what_a_run_needs() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let folder = setup_at(&listener.local_addr().unwrap().to_string());
    let config = folder.path().join("cell.toml");
    let delay = |set: &[&str]| {
        let args = words(&[&"identify", &"delay", &"--move", &"--config", &config, &"--out", &folder.path()]);
        pb3dp(&args.into_iter().chain(set.iter().map(Into::into)).collect::<Vec<_>>())
    };
    delay(&[]).assert_refused(&[
        "vs-robot is not emulated and may not move with arms.first_run = false",
        "arms.speed_scale = 0.6",
        "arms.vs.commissioning_record is not set",
    ]);
    delay(&FIRST_RUN).assert_refused(&["vs-robot was not typed", "nothing was moved"]);
    let unknown = ["--set", "arms.vs.gateway.wire_format=A"];
    delay(&[&FIRST_RUN[..], &unknown].concat())
        .assert_refused(&["arms.vs.gateway.signals.emergency_stop", "the arm may not move"]);
    assert!(listener.accept().is_err(), "a port was opened");
}

/// The target is out of sight for 6 s, and the hand resumes by itself: only a stale estimate has held it.
#[test]
fn a_longer_age_of_a_lost_target_needs_a_commissioning_record() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let folder = setup_at(&listener.local_addr().unwrap().to_string());
    let config = folder.path().join("cell.toml");
    let set = ["--set", "supervisor.policies.target_lost.age_s=10.0", "--set", "supervisor.search_max_s=20.0"];
    let args = words(&[&"run", &"--operator", &"console", &"--config", &config]);
    pb3dp(&args.into_iter().chain(FIRST_RUN.iter().chain(&set).map(Into::into)).collect::<Vec<_>>()).assert_refused(&[
        "vs-robot is not emulated and may not move",
        "supervisor.policies.target_lost.age_s = 10 (without a record: at most 1)",
        "supervisor.search_max_s = 20 (without a record: leave the key out)",
    ]);
    assert!(listener.accept().is_err(), "a port was opened");
}

/// A pipe would block the program, and a device would fill its memory.
#[test]
fn only_regular_files_are_read() {
    let pair = Pair::new();
    let (pipe, device) = (pair.file("pipe.png"), Path::new("/dev/zero"));
    rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR).unwrap();
    let [left, right, calibration] = ["left.png", "right.png", "calib.json"].map(|name| pair.file(name));
    let mask = format!("mask:{}", pipe.display());
    let is_pipe = ["pipe.png: ", "it is a named pipe (FIFO), not a regular file; copy the content into a file"];
    let is_device = ["/dev/zero: ", "it is a device, not a regular file"];
    pb3dp(&pair.words(&pipe, &right, &calibration, REGION)).assert_refused(&is_pipe);
    pb3dp(&pair.words(&left, device, &calibration, REGION)).assert_refused(&is_device);
    pb3dp(&pair.words(&left, &right, &pipe, REGION)).assert_refused(&is_pipe);
    pb3dp(&pair.words(&left, &right, &calibration, &mask)).assert_refused(&is_pipe);
    let gates = |file: &Path| {
        let board: [&dyn AsRef<OsStr>; 6] = [&"calibrate", &"stereo", &"--board", &"9x6", &"--square", &"25"];
        let files: [&dyn AsRef<OsStr>; 6] = [&"--recording", &left, &"--out", &"none.toml", &"--gates", &file];
        pb3dp(&words(&[board, files].concat()))
    };
    gates(&pipe).assert_refused(&is_pipe);
    gates(device).assert_refused(&is_device);
    for (name, is_in_folder) in [
        ("case.json", true),
        ("sequence.json", true),
        ("sequence.json", false),
        ("bag.mcap", false),
        ("words.txt", false),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join(name);
        rustix::fs::mkfifoat(rustix::fs::CWD, &pipe, rustix::fs::Mode::RUSR).unwrap();
        let path = if is_in_folder { folder.path() } else { &pipe };
        let args: [&dyn AsRef<OsStr>; 5] = [&"track", &"--sequence", &path, &"--region", &REGION];
        pb3dp(&words(&args)).assert_refused(&[name, is_pipe[1]]);
    }
}
