//! `pb3dp run`: what it writes, and what it refuses to start.

use std::path::{Path, PathBuf};

use crate::cli::support::*;

/// The simulated setup of the repository with other values, in a folder of its own.
fn setup(dir: &Path, changes: &[(&str, &str)]) -> PathBuf {
    setup_from("sim.toml", dir, changes)
}

fn setup_from(file: &str, dir: &Path, changes: &[(&str, &str)]) -> PathBuf {
    let configs = repository().join("configs");
    std::fs::create_dir_all(dir.join("robots")).unwrap();
    std::fs::copy(configs.join("robots/pa10_gen2.urdf"), dir.join("robots/pa10_gen2.urdf")).unwrap();
    let text = std::fs::read_to_string(configs.join(file)).unwrap();
    let text = changes.iter().fold(text, |text, (from, to)| replaced(&text, from, to));
    let file = dir.join("mine.toml");
    std::fs::write(&file, text).unwrap();
    file
}

const SMALL: [(&str, &str); 3] = [
    ("width_px = 640", "width_px = 320"),
    ("height_px = 480", "height_px = 240"),
    ("focal_px = 740.0", "focal_px = 370.0"),
];

#[test]
fn a_run_leaves_report_summary_and_time_series() {
    let dir = tempfile::tempdir().unwrap();
    let config = setup(dir.path(), &SMALL);
    let out = dir.path().join("new/out");
    let finished =
        pb3dp(&words(&[&"run", &"--config", &config, &"--out", &out, &"--stop-after", &"0.4"])).assert_success();
    assert!(
        finished.stdout.contains("hand, position") && finished.stdout.contains("report.html"),
        "{}",
        finished.stdout
    );
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(
        page.contains("<figure class=\"plot\">") && page.contains("data:image/"),
        "plots and images are in the page itself"
    );
    assert!(!page.contains("<link") && !page.contains("<script src"), "nothing is loaded from elsewhere");
    let text = std::fs::read_to_string(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(summary["provenance"]["seed"], "1");
    assert_eq!(
        (&summary["provenance"]["method"], &summary["provenance"]["compared"]),
        (&"direct".into(), &"published".into())
    );
    let methods = summary["summary"]["methods"].as_array().unwrap();
    let leads: Vec<_> =
        methods.iter().map(|m| (m["method"].as_str().unwrap(), m["leads"].as_bool().unwrap())).collect();
    assert_eq!(leads, [("direct", true), ("published", false)], "both methods saw the same run");
    // Measured in virtual time: 1.6 mm and 7.5 mm.
    for (method, most_mm) in methods.iter().zip([3.0, 12.0]) {
        assert!(method["depth_mm"]["median"].as_f64().unwrap() < most_mm, "{method}");
        assert!(method["latency_p50_millis"].as_f64().unwrap() > 0.0, "{method}");
    }
    assert_eq!(methods[0]["rotation_about_normal_observed"], true);
    assert_eq!(methods[1]["rotation_about_normal_observed"], false);
    assert!(page.contains("direct (leads)") && page.contains(">published<"), "the report shows both methods");
    assert!(finished.stdout.contains("direct (leads)") && finished.stdout.contains("published"), "{}", finished.stdout);
    assert!(summary["summary"]["smallest_singular_value"].as_f64().unwrap() > 0.05);
    for (arm, name) in ["vs-robot", "tc-robot"].into_iter().enumerate() {
        let commands = &summary["summary"]["commands"][arm];
        let [velocities, changed, refused] =
            ["velocities", "changed", "refused"].map(|key| commands[key].as_u64().unwrap());
        assert!(commands["name"] == name && changed <= velocities && refused == 0, "{commands}");
        let line = format!("{velocities}, {changed} changed by the limiter, 0 refused");
        assert!(finished.stdout.contains(&line), "{line} in {}", finished.stdout);
        assert!([&finished.stdout, &page].iter().all(|text| text.contains("Changes by the limiter are normal")));
        assert!(page.contains(&format!("<td>{name}</td>")), "the page has a line of {name}");
    }
    let supervisor = &summary["summary"]["supervisor"];
    assert!(supervisor["share_by_state"]["selecting"].as_f64().unwrap() > 0.0, "{supervisor}");
    let transitions = supervisor["transitions"].as_array().unwrap();
    let events: Vec<_> = transitions.iter().take(2).map(|note| note["event"].as_str().unwrap()).collect();
    assert_eq!(events, ["select", "start"], "the command is the operator");
    for note in transitions {
        let line = note["why"].as_str().unwrap();
        assert!(note["t_s"].is_f64() && line.starts_with(note["to"].as_str().unwrap()), "{note}");
        assert!(page.contains(&line.replace('<', "&lt;")), "{line} is not in the page");
    }
    assert!(
        finished.stdout.contains("supervisor")
            && finished.stderr.contains("s  approaching")
            && !finished.stderr.contains("[PB3DP-"),
        "{}",
        finished.stderr
    );
    let csv = std::fs::read_to_string(out.join("timeseries.csv")).unwrap();
    let columns: Vec<usize> = csv.lines().map(|line| line.split(',').count()).collect();
    assert!(columns.len() > 40 && columns.iter().all(|&n| n == columns[0]), "a header and 41 steps of one width");
}

#[test]
fn a_run_without_images_says_so_and_needs_none() {
    let dir = tempfile::tempdir().unwrap();
    let geometric =
        [("method = \"direct\" ", "method = \"geometric\" "), ("compare = [\"published\"]", "compare = []")];
    let config = setup(dir.path(), &geometric);
    let out = dir.path().join("out");
    let run = |more: &[&dyn AsRef<std::ffi::OsStr>]| {
        let begin: Vec<&dyn AsRef<std::ffi::OsStr>> =
            vec![&"run", &"--config", &config, &"--out", &out, &"--stop-after", &"1.0"];
        pb3dp(&words(&[&begin[..], more].concat()))
    };
    let finished = run(&[&"--move", &"--nominal-calibration"]).assert_success();
    assert!(finished.stdout.contains("no image was rendered"), "{}", finished.stdout);
    for option in ["--move", "--nominal-calibration"] {
        let warning = format!("{option} has no effect: the arms of this setup are emulated");
        assert!(finished.stderr.contains(&warning), "{}", finished.stderr);
    }
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("No image was rendered") && !page.contains("data:image/"), "no images in the page");
    let text = std::fs::read_to_string(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(
        (&summary["provenance"]["method"], &summary["provenance"]["pictures"]),
        (&"geometric".into(), &"none".into())
    );
    assert_eq!(summary["summary"]["without_pictures"], true);
    run(&[&"--record", &dir.path().join("recording")]).assert_refused(&["--record", "geometric"]);
}

#[test]
fn experiments_of_other_kinds_have_reports_of_their_own() {
    let dir = tempfile::tempdir().unwrap();
    let sim = std::fs::read_to_string(repository().join("configs/sim.toml")).unwrap();
    let moves = &sim[sim.find("channels = ").unwrap()..sim.find("axes = \"target-at-start\"").unwrap()];
    let quick = [("method = \"direct\" ", "method = \"geometric\" "), ("compare = [\"published\"]", "compare = []")];
    let sine = "channels = [\"y\"]\ntranslation_mm = 50.0\nrotation_deg = 10.0\nperiod_s = 4.0\nperiods = 1\nlead_in_s = 1.0\n";
    let sudden =
        "channels = [\"x\"]\ntranslation_mm = 50.0\nrotation_deg = 15.0\nmove_s = 0.0\nhold_s = 4.0\nlead_in_s = 2.0\n";
    let (kind, free) = (("kind = \"steps\"", "kind = \"sine\""), ("target = \"carried\"", "target = \"free\""));
    for (changes, line, column) in [
        (&[kind, (moves, sine)][..], "y: gain ", "phase, deg"),
        (&[kind, free, (moves, sine)], "y: gain ", "gain, dB"),
        (&[free, (moves, sudden)], "x: ", "overshoot, %"),
    ] {
        let config = setup(dir.path(), &[&quick[..], changes].concat());
        let out = dir.path().join("out");
        let finished = pb3dp(&words(&[&"run", &"--config", &config, &"--out", &out])).assert_success();
        assert!(finished.stdout.contains(line), "{line} in {}", finished.stdout);
        let page = std::fs::read_to_string(out.join("report.html")).unwrap();
        assert!(page.contains(&format!("<th>{column}</th>")) && !page.contains("<th>rise delay, s</th>"), "{column}");
    }
    for (changes, parts) in [
        (&[(moves, sudden)][..], &["experiment.move_s = 0", "0.05 to 600"][..]),
        (
            &[kind],
            &["experiment.period_s: missing; kind = \"sine\"", "experiment.move_s: kind = \"sine\" does not use it"],
        ),
        (&[(moves, sine)], &["experiment.move_s: missing; kind = \"steps\"", "experiment.period_s: kind = \"steps\""]),
        (&[kind, (moves, &sine.replace("[\"y\"]", "[\"y\", \"z\"]"))], &["2 are named", "exactly one"]),
        (&[kind, (moves, &sine.replace("periods = 1", "periods = 0"))], &["experiment.periods = 0", "1 to 1000"]),
    ] {
        let config = setup(dir.path(), changes);
        let finished = pb3dp(&words(&[&"run", &"--config", &config, &"--out", &dir.path().join("refused")]));
        finished.assert_refused(&["mine.toml"]);
        finished.assert_refused(parts);
    }
}

#[test]
fn an_experiment_that_is_too_fast_is_refused_by_how_much() {
    let dir = tempfile::tempdir().unwrap();
    // Without these keys arms are slow.
    let config = setup(dir.path(), &[("speed_scale = 0.6 ", "# "), ("first_run = false ", "# ")]);
    let out = dir.path().join("out");
    let finished = pb3dp(&words(&[&"run", &"--config", &config, &"--out", &out]));
    finished.assert_refused(&["cannot follow the experiment", "axis ", "arms.speed_scale", "times too fast"]);
    assert!(!out.join("report.html").exists());
}

#[test]
fn setups_are_refused_with_file_key_and_what_is_allowed() {
    let dir = tempfile::tempdir().unwrap();
    for (from, to, parts) in [
        (
            "baseline_mm = 100.0",
            "baseline_mm = 100.0\nbaseline_m = 1",
            &["camera.baseline_m", "unknown key", "baseline_mm"][..],
        ),
        ("frame_rate_hz = 30.0", "", &["camera.frame_rate_hz", "missing"]),
        ("frame_rate_hz = 30.0", "frame_rate_hz = 300.0", &["camera.frame_rate_hz = 300", "1 to 240"]),
        ("speed_scale = 0.6 ", "speed_scale = 1.5 ", &["arms.speed_scale = 1.5", "0.01 to 1"]),
        (
            "\"cameras\", on = \"flange\"",
            "\"cameras\", on = \"joint 7\"",
            &["arms.vs.parts[4].on", "joint 0 to joint 6"],
        ),
        (
            "5.0] # acceleration limit",
            "5.1] # acceleration limit",
            &["arms.vs.acceleration_max_rad_per_s2[6] = 5.1", "0.01 to 5"],
        ),
        ("tracking_error_max_deg = 2.9 ", "tracking_error_max_deg = 3.0 ", &["arms.tracking_error_max_deg = 3", "2.9"]),
        (
            "tracking_error_millis = 100.0 ",
            "tracking_error_millis = 101.0 ",
            &["arms.tracking_error_millis = 101", "100"],
        ),
        (
            "270.0] # mechanical stops",
            "271.0] # mechanical stops",
            &["arms.vs.mechanical_range_deg[6] = 271", "255.01 to 270"],
        ),
        ("first_run = false ", "# ", &["arms.speed_scale = 0.6", "at most 0.25 on the first run", "arms.first_run"]),
        ("method = \"direct\"", "method = \"magic\"", &["estimator.method", "magic", "published"]),
        ("method = \"direct\"", "method = \"published\"", &["estimator.compare = [published]", "not `method` itself"]),
        (
            "compare = [\"published\"]",
            "compare = [\"published\", \"published\"]",
            &["estimator.compare = [published, published]", "once"],
        ),
        ("method = \"direct\"", "method = \"geometric\"", &["estimator.compare = [published]", "nobody can look on"]),
        (
            "turned_max_deg = 70.0 ",
            "turned_max_deg = 90.0 ",
            &["estimator.geometric.turned_max_deg = 90", "5.73 to 85.94"],
        ),
        ("compare = [\"published\"]", "compare = [\"publish\"]", &["estimator.compare", "publish", "known methods"]),
        ("target = \"crab\"", "target = \"lobster\"", &["scene.target", "lobster", "crab"]),
        ("channels = [\"x\"", "channels = [\"u\"", &["experiment.channels", "\"u\"", "rz"]),
    ] {
        let config = setup(dir.path(), &[(from, to)]);
        let finished = pb3dp(&words(&[&"run", &"--config", &config, &"--out", &dir.path().join("out")]));
        finished.assert_refused(&["mine.toml"]);
        finished.assert_refused(parts);
    }
    let config = setup(dir.path(), &[]);
    std::fs::remove_file(dir.path().join("robots/pa10_gen2.urdf")).unwrap();
    pb3dp(&words(&[&"run", &"--config", &config])).assert_refused(&["arms.vs.robot", "pa10_gen2.urdf"]);
    assert!(!dir.path().join("out").exists(), "nothing is written before the setup is accepted");
}

#[test]
fn policies_of_the_supervisor_that_are_too_weak_or_none_are_refused_by_key() {
    let dir = tempfile::tempdir().unwrap();
    for (from, to, parts) in [
        (
            "arm_fault = { action = \"fault\"",
            "arm_fault = { action = \"stop\"",
            &["supervisor.policies.arm_fault.action = stop", "allowed is fault"][..],
        ),
        (
            "age_s = 0.25, action = \"hold\", resume = \"by-itself\"",
            "age_s = 0.25, action = \"note\"",
            &["supervisor.policies.frame_stale.action = note", "allowed is hold or stop or fault"],
        ),
        (
            "target_changed = { action = \"hold\"",
            "target_changed = { resume = \"by-itself\", action = \"hold\"",
            &["supervisor.policies.target_changed.resume = by-itself", "allowed never for this condition"],
        ),
        (
            "frame_order = { action = \"hold\", resume = \"by-itself\"",
            "frame_order = { action = \"hold\"",
            &["supervisor.policies.frame_order.resume", "missing"],
        ),
        (
            "camera_skew = { skew_millis",
            "camera_skew = { age_s",
            &["supervisor.policies.camera_skew.skew_millis", "missing", "camera_skew.age_s = 5", "no such key"],
        ),
        ("action = \"slow\", share = 0.5", "action = \"slow\"", &["supervisor.policies.limit_near.share", "missing"]),
        (
            "target_lost = { age_s = 1.0",
            "target_lost = { age_s = 0.2",
            &["supervisor.policies.target_lost.age_s = 0.2", "0.3 to 10"],
        ),
        ("camera_skew = {", "camera_screw = {", &["supervisor.policies.camera_screw", "unknown key", "camera_skew"]),
    ] {
        let config = setup(dir.path(), &[(from, to)]);
        let finished = pb3dp(&words(&[&"run", &"--config", &config, &"--out", &dir.path().join("out")]));
        finished.assert_refused(&["mine.toml"]);
        finished.assert_refused(parts);
    }
}

#[test]
fn two_arms_behind_gateways_of_one_number_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let config = setup_from("hil.toml", dir.path(), &[("arm = 2\n", "arm = 1\n")]);
    let out = dir.path().join("out");
    let parts = ["mine.toml", "arms.tc.gateway.arm = 1", "arms.vs.gateway.arm is the same"];
    pb3dp(&words(&[&"run", &"--config", &config, &"--out", &out])).assert_refused(&parts);
    pb3dp(&words(&[&"arm", &"probe", &"--config", &config, &"--arm", &"tc"])).assert_refused(&parts);
    assert!(!out.exists(), "nothing is written before the setup is accepted");
}

#[test]
fn a_recorded_run_can_be_tracked() {
    let dir = tempfile::tempdir().unwrap();
    let config = setup(dir.path(), &SMALL);
    let (out, recording) = (dir.path().join("out"), dir.path().join("recording"));
    let run = || {
        pb3dp(&words(&[&"run", &"--config", &config, &"--out", &out, &"--stop-after", &"0.2", &"--record", &recording]))
    };
    let finished = run().assert_success();
    assert!(finished.stderr.contains("frames recorded"), "{}", finished.stderr);
    for (method, observed) in [("published", false), ("direct", true)] {
        let tracked =
            pb3dp(&words(&[&"track", &"--method", &method, &"--sequence", &recording, &"--json"])).assert_success();
        assert!(tracked.json_lines(&TRACK_KEYS).len() >= 5, "{}", tracked.stdout);
        assert!(tracked.stderr.contains("motion error"), "{}", tracked.stderr);
        assert_eq!(tracked.stderr.contains("normal is not observed"), !observed, "{method}: {}", tracked.stderr);
    }
    // Also as images with their calibration.
    let images = dir.path().join("images");
    pb3dp(&words(&[&"extract", &recording, &"--out", &images])).assert_success();
    let region = "rect:120,90,80,60";
    pb3dp(&words(&[&"track", &"--sequence", &images, &"--region", &region])).assert_success();
    // Before an arm is enabled, and before the report of the run before is lost.
    let report = std::fs::read(out.join("summary.json")).unwrap();
    let refused = run();
    refused.assert_refused(&["--record", "sequence.json"]);
    assert!(!refused.stderr.contains("selecting"), "{}", refused.stderr);
    assert_eq!(std::fs::read(out.join("summary.json")).unwrap(), report);
}

/// Cameras with a trigger are some microseconds apart. The second frame corrects the first pair for its motion, which is none here; on a
/// curved target the frame `model` is not on the plane that the relief is measured from.
#[test]
fn a_skew_of_microseconds_leaves_the_pose_of_a_curved_target() {
    let dir = tempfile::tempdir().unwrap();
    let (out, recording) = (dir.path().join("out"), dir.path().join("recording"));
    let run = [&"run" as &dyn AsRef<std::ffi::OsStr>, &"--config", &"sim", &"--stop-after", &"0.2"];
    pb3dp(&words(&[&run[..], &[&"--out", &out, &"--record", &recording]].concat())).assert_success();
    let file = recording.join("sequence.json");
    let mut sequence: serde_json::Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    let poses = || -> Vec<Vec<f64>> {
        let tracked = pb3dp(&words(&[&"track", &"--sequence", &recording, &"--json"])).assert_success();
        let lines = tracked.json_lines(&TRACK_KEYS);
        lines.iter().map(|line| serde_json::from_value(line["cam_left_from_model"].clone()).unwrap()).collect()
    };
    let at_once = poses();
    sequence["skew_s"] = vec![1e-6; at_once.len()].into();
    std::fs::write(&file, sequence.to_string()).unwrap();
    for (skewed, at_once) in poses().iter().zip(&at_once) {
        // Millimetres, and elements of a rotation: 0.05 degrees.
        let is_near = |(k, (a, b)): (usize, (&f64, &f64))| (a - b).abs() < if k % 4 == 3 { 0.05 } else { 1e-3 };
        assert!(skewed.iter().zip(at_once).enumerate().all(is_near), "{skewed:?} {at_once:?}");
    }
}

#[test]
fn times_that_are_none_are_refused() {
    for bad in ["nan", "inf", "-1", "soon"] {
        let argument = format!("--stop-after={bad}");
        pb3dp(&words(&[&"run", &"--config", &"x.toml", &argument])).assert_refused(&["--stop-after", bad]);
    }
    for filter in ["shout=loud", "nonsense", "info,loud"] {
        pb3dp(&words(&[&"--log", &filter, &"run", &"--config", &"x.toml"])).assert_refused(&["--log", filter]);
    }
}

/// At this speed the arms cannot follow a move that comes later; the run ends before.
#[test]
fn a_run_that_ends_early_need_not_follow_the_rest() {
    let dir = tempfile::tempdir().unwrap();
    let run = |more: &[&str]| {
        let args = words(&[&"run", &"--config", &"sim", &"--out", &dir.path().join("out")]);
        pb3dp(&[args, more.iter().map(|word| (*word).into()).collect()].concat())
    };
    let slow =
        ["--set", "arms.speed_scale=0.3", "--set", "estimator.method=geometric", "--set", "estimator.compare=[]"];
    run(&slow).assert_refused(&["arms.speed_scale", "too fast"]);
    run(&[&slow[..], &["--stop-after", "1"]].concat()).assert_success();
}

/// A run that a person leads by lines on standard input; simulated arms without images, at the pace of the wall clock.
fn led_by_a_person(dir: &std::path::Path) -> (std::process::Child, std::path::PathBuf) {
    led_by_a_person_with(dir, &[], "")
}

/// The same with these settings, and with this text at the end of the setup.
fn led_by_a_person_with(
    dir: &std::path::Path,
    settings: &[&str],
    more: &str,
) -> (std::process::Child, std::path::PathBuf) {
    use std::process::{Command, Stdio};

    let changes = [
        ("pace = \"fast\" ", "pace = \"real-time\" "),
        ("method = \"direct\" ", "method = \"geometric\" "),
        ("compare = [\"published\"]", "compare = []"),
    ];
    let (config, out) = (setup(dir, &changes), dir.join("out"));
    std::fs::write(&config, std::fs::read_to_string(&config).unwrap() + more).unwrap();
    let child = Command::new(env!("CARGO_BIN_EXE_pb3dp"))
        .args(words(&[&"run", &"--operator", &"console", &"--config", &config, &"--out", &out]))
        .args(settings)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    (child, out)
}

#[test]
fn a_run_ends_in_order_when_nobody_can_speak_any_more() {
    use std::io::Write as _;
    use std::time::Duration;

    let dir = tempfile::tempdir().unwrap();
    let (mut child, out) = led_by_a_person(dir.path());
    let mut input = child.stdin.take().unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    writeln!(input, "select").unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    drop(input);
    let finished = child.wait_with_output().unwrap();
    let text = String::from_utf8(finished.stdout).unwrap();
    assert!(finished.status.success(), "{text}");
    assert!(text.contains("end of input: stopping both arms, then writing the report"), "{text}");
    let summary = std::fs::read_to_string(out.join("summary.json")).unwrap();
    assert!(summary.contains("\"to\": \"selecting\"") && summary.contains("\"ended_by\": null"), "{summary}");
}

/// A person selects and starts, asks, and ends the run.
#[test]
fn a_person_at_a_console_leads_a_run() {
    use std::io::Write as _;
    use std::time::Duration;

    let dir = tempfile::tempdir().unwrap();
    let (mut child, out) = led_by_a_person(dir.path());
    let mut input = child.stdin.take().unwrap();
    for line in ["status", "select", "go", "status", "start", "status", "stop", "status", "quit"] {
        // A word counts from the step behind it.
        std::thread::sleep(Duration::from_millis(1500));
        writeln!(input, "{line}").unwrap();
    }
    let finished = child.wait_with_output().unwrap();
    let text = String::from_utf8(finished.stdout).unwrap();
    assert!(finished.status.success(), "{text}");
    let parts = [
        "idle: no target selected; use select",
        "unknown command \"go\": use select, start",
        "selecting: target seen, no active inhibit; use start",
        "stopped: by the operator; use reset",
        "stopping both arms, then writing the report",
        "report.html",
    ];
    let places: Vec<usize> = parts.map(|part| text.find(part).unwrap_or_else(|| panic!("{part}: {text}"))).into();
    assert!(places.is_sorted(), "{text}");
    let summary = std::fs::read_to_string(out.join("summary.json")).unwrap();
    assert!(summary.contains("\"event\": \"start\"") && summary.contains("\"ended_by\": null"), "{summary}");
}

/// The record holds the seconds around the stop, also if the person ends the run much later; a stop by command leaves none.
#[test]
fn a_stop_by_a_condition_leaves_a_flight_record_after_quit() {
    use std::io::Write as _;
    use std::time::Duration;

    let outage = "\n[[camera.faults]]\nkind = \"dropped\"\nshare = 1.0\nfrom_s = 5.0\nuntil_s = 100.0\n";
    for (more, last, has_record) in [(outage, "status", true), ("", "stop", false)] {
        let dir = tempfile::tempdir().unwrap();
        let settings = ["--set", "supervisor.policies.frame_stale.action=stop"];
        let (mut child, out) = led_by_a_person_with(dir.path(), &settings, more);
        let mut input = child.stdin.take().unwrap();
        for line in ["status", "select", "start", "status", "status", last, "quit"] {
            std::thread::sleep(Duration::from_millis(1200));
            writeln!(input, "{line}").unwrap();
        }
        let finished = child.wait_with_output().unwrap();
        let text = String::from_utf8(finished.stdout).unwrap();
        assert!(finished.status.success(), "{text}");
        for arm in ["vs-robot", "tc-robot"] {
            let record = std::fs::read_to_string(out.join(format!("flight-{arm}.jsonl")));
            assert_eq!(record.is_ok(), has_record, "{text}");
            assert!(!out.join(format!("flight-{arm}-2.jsonl")).exists());
            let Ok(record) = record else { continue };
            let head: serde_json::Value = serde_json::from_str(record.lines().next().unwrap()).unwrap();
            assert!(head["cause"].as_str().unwrap().starts_with("stopped: the newest frame pair is"), "{head}");
            assert!(record.contains("\"velocity\"") && record.contains("\"stop\""), "{text}");
        }
    }
}

#[test]
fn a_console_needs_a_pace_in_which_a_person_can_speak() {
    let config = repository().join("configs/sim.toml");
    let dir = tempfile::tempdir().unwrap();
    let refused = words(&[&"run", &"--operator", &"console", &"--config", &config, &"--out", &dir.path()]);
    pb3dp(&refused).assert_refused(&["--operator console", "real-time"]);
}

/// Killed in the middle of it, without a chance to write anything.
#[test]
fn hold_to_run_needs_the_panel() {
    let dir = tempfile::tempdir().unwrap();
    let set = "supervisor.hold_to_run=true";
    pb3dp(&words(&[&"run", &"--config", &"sim", &"--set", &set, &"--out", &dir.path().join("run")]))
        .assert_refused(&["supervisor.hold_to_run = true", "--panel"]);
}

#[test]
fn a_recording_whose_program_is_killed_can_be_tracked() {
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};

    let dir = tempfile::tempdir().unwrap();
    let (config, recording) = (repository().join("configs/sim.toml"), dir.path().join("recording"));
    let mut child = Command::new(env!("CARGO_BIN_EXE_pb3dp"))
        .args(words(&[&"run", &"--config", &config, &"--out", &dir.path().join("out"), &"--record", &recording]))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let begin = Instant::now();
    while !recording.join("right_0011.png").exists() {
        assert!(
            begin.elapsed() < Duration::from_secs(60) && child.try_wait().unwrap().is_none(),
            "nothing is recorded"
        );
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!recording.join("sequence.json").exists(), "it was not finished");
    let output = pb3dp(&words(&[&"track", &"--json", &"--sequence", &recording])).assert_success();
    assert!(output.stderr.contains("the recording was broken off"), "{}", output.stderr);
    let frames = output.stdout.lines().count();
    assert!(frames >= 11 && !output.stdout.contains("\"error\""), "{frames}: {}", output.stdout);
    let again = words(&[&"run", &"--config", &config, &"--out", &dir.path().join("again"), &"--record", &recording]);
    pb3dp(&again).assert_refused(&["sequence.unfinished.jsonl already exists; give an empty folder"]);
}

#[test]
fn the_log_says_how_far_the_cameras_have_moved() {
    let dir = tempfile::tempdir().unwrap();
    let config = setup(dir.path(), &[("compare = [\"published\"]", "compare = []")]);
    let fault = "\n[[camera.faults]]\nkind = \"miscalibrated\"\nfrom_s = 1.0\nuntil_s = 9.0\ncolumns_px = 0.0\nrows_px = 0.0\nroll_deg = 0.5\n\
                 scale = 1.0\n";
    std::fs::write(&config, std::fs::read_to_string(&config).unwrap() + fault).unwrap();
    let out = dir.path().join("out");
    let run: [&dyn AsRef<std::ffi::OsStr>; 9] =
        [&"run", &"--config", &config, &"--out", &out, &"--set", &"scene.target=card", &"--stop-after", &"3"];
    let finished = pb3dp(&words(&run)).assert_success();
    let warnings: Vec<_> =
        finished.stderr.lines().filter(|line| line.contains("miscalibrated: rows of the images")).collect();
    assert!(
        warnings.len() == 1 && warnings[0].contains("roll +0.5") && warnings[0].contains("WARN"),
        "{}",
        finished.stderr
    );
}
