//! `pb3dp config`: what a setup says, whether a run would accept it, and how one begins.

use std::fs;
use std::process::Command;

use crate::cli::support::key_file;
use crate::real_time::arm::{FIRST_RUN, setup_at};

/// What `pb3dp config` left behind.
#[derive(Debug)]
struct Finished {
    code: Option<i32>,
    stdout: String,
    stderr: String,
}

fn config(args: &[&str]) -> Finished {
    let output = Command::new(env!("CARGO_BIN_EXE_pb3dp")).arg("config").args(args).output().unwrap();
    let [stdout, stderr] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    Finished { code: output.status.code(), stdout, stderr }
}

#[test]
fn values_for_programs_have_the_types_of_json() {
    for setup in ["sim", "playground", "hil", "rig", "bare", "published"] {
        let shown = config(&["show", "--config", setup, "--json"]);
        assert_eq!(shown.code, Some(0), "{shown:?}");
        let values: serde_json::Value = serde_json::from_str(&shown.stdout).unwrap();
        assert!(values.as_object().unwrap().len() > 50, "{setup}");
        assert_eq!(shown.stderr, "", "{setup}");
    }
    let mistyped = config(&["show", "--config", "sim", "--set", "scene.taget=card"]);
    let warns = mistyped.stderr.contains("scene.taget: unknown key; did you mean target?");
    assert!(warns && mistyped.code == Some(0), "{mistyped:?}");
    let shown = config(&["show", "--config", "sim", "--set", "run.seed=7", "--json"]);
    let values: serde_json::Value = serde_json::from_str(&shown.stdout).unwrap();
    assert_eq!(values["run.seed"], serde_json::json!({ "value": 7, "origin": "--set" }));
    assert_eq!(values["scene.target"]["value"], "crab");
    assert_eq!(values["arms.first_run"]["value"], false);
    assert_eq!(values["arms.vs.start_deg"]["value"].as_array().unwrap().len(), 7);
}

#[test]
fn a_setup_that_is_begun_is_accepted_or_says_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    for kind in ["sim", "hil", "rig", "arms"] {
        let file = folder.path().join(format!("{kind}.toml"));
        fs::write(&file, config(&["init", kind]).stdout).unwrap();
        let checked = config(&["check", "--config", file.to_str().unwrap()]);
        assert_eq!(checked.code, Some(0), "{kind}: {checked:?}");
    }
    let cameras = folder.path().join("cameras.toml");
    fs::write(&cameras, config(&["init", "cameras"]).stdout).unwrap();
    let checked = config(&["check", "--config", cameras.to_str().unwrap()]);
    assert_eq!(checked.code, Some(0), "{checked:?}");
    for expected in ["accepted for `pb3dp cameras`", "calibration.toml: does not exist yet; `pb3dp calibrate stereo`"] {
        assert!(checked.stdout.contains(expected), "{checked:?}");
    }
    let missing = config(&["check", "--config", "rig"]);
    assert_eq!(missing.code, Some(1));
    for key in ["mounts", "camera.left.device", "camera.calibration", "arms.vs", "arms.tc"] {
        assert!(missing.stderr.contains(&format!("  {key}: missing")), "{key}: {}", missing.stderr);
    }
}

/// A setup has no options for its calibration.
#[test]
fn what_a_calibration_leaves_unstated_is_warned_of_or_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("stereo.yml");
    let check = |lens: &str| {
        let camera = "[[700, 0, 319.5], [0, 700, 239.5], [0, 0, 1]]";
        let text = format!(
            "%YAML:1.0\n---\nK1: {camera}\nK2: {camera}\nD1: {lens}\nD2: {lens}\nR: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: [-64.3, 0, 0]\n"
        );
        fs::write(&file, text).unwrap();
        config(&["check", "--config", "sim", "--set", &format!("camera.calibration=[\"{}\"]", file.display())])
    };
    let warned = check("[0.001, 0, 0, 0, 0]");
    assert_eq!(warned.code, Some(0), "{warned:?}");
    for part in ["camera.calibration: ", "states no image size: that of the images, 640x480", "mm is used, because the"]
    {
        assert!(warned.stderr.contains(part), "{warned:?}");
    }
    let refused = check("[0.001, 0, 0, 0]");
    assert_eq!(refused.code, Some(1), "{refused:?}");
    for part in ["`pb3dp calibrate convert` with the option writes a file", "--calib-lens brown or --calib-lens equid"]
    {
        assert!(refused.stderr.contains(part), "{refused:?}");
    }
}

#[test]
fn an_experiment_that_a_run_refuses_is_refused_before() {
    let checked = config(&["check", "--config", "sim", "--set", "arms.tc.start_deg=[0,0,0,0,0,0,0]"]);
    assert_eq!(checked.code, Some(1), "{checked:?}");
    for part in ["`pb3dp run` would refuse this setup", "cannot follow the experiment"] {
        assert!(checked.stderr.contains(part), "{checked:?}");
    }
}

/// A run would find it only when it opens the links; nothing of a key is printed.
#[test]
fn the_key_files_of_links_are_checked() {
    use std::os::unix::fs::PermissionsExt as _;

    let folder = setup_at("127.0.0.1:9");
    let (setup, key) = (folder.path().join("cell.toml"), folder.path().join("my.key"));
    let text = fs::read_to_string(&setup).unwrap().replace(key_file().to_str().unwrap(), key.to_str().unwrap());
    fs::write(&setup, text).unwrap();
    let check = || config(&[&["check", "--config", setup.to_str().unwrap()], &FIRST_RUN[..]].concat());
    let contents = fs::read_to_string(key_file()).unwrap();
    let secret = contents.trim();
    for (contents, mode, part) in [
        (None, 0o600, "cannot be read"),
        (Some(secret), 0o644, "chmod 600"),
        (Some(&secret[..20]), 0o600, "holds no key"),
        (Some("a word of mine that is not hexadecimal"), 0o600, "holds no key"),
    ] {
        if let Some(contents) = contents {
            fs::remove_file(&key).ok();
            fs::write(&key, contents).unwrap();
            fs::set_permissions(&key, fs::Permissions::from_mode(mode)).unwrap();
        }
        let checked = check();
        assert_eq!(checked.code, Some(1), "{part}: {checked:?}");
        for part in ["`pb3dp run` would refuse this setup", "arms.vs.gateway.key_file", "my.key", part] {
            assert!(checked.stderr.contains(part), "{part}: {checked:?}");
        }
        for part in [&secret[..8], "a word of mine"] {
            assert!(!checked.stderr.contains(part) && !checked.stdout.contains(part), "{checked:?}");
        }
    }
    fs::write(&key, secret).unwrap();
    let checked = check();
    assert!(!checked.stderr.contains("key_file") && !checked.stderr.contains(&secret[..8]), "{checked:?}");
    assert!(!checked.stdout.contains(&secret[..8]), "{checked:?}");
}

#[test]
fn differences_and_their_absence_have_exit_codes() {
    let same = config(&["diff", "sim", "sim"]);
    assert_eq!((same.code, same.stdout.as_str()), (Some(0), ""));
    let as_integer = config(&["diff", "sim", "sim", "--set", "arms.least_room_mm=50"]);
    assert_eq!((as_integer.code, as_integer.stdout.as_str()), (Some(0), ""), "50 and 50.0 are the same setting");
    let other = config(&["diff", "sim", "sim", "--set", "run.seed=7"]);
    assert_eq!(other.code, Some(3), "{other:?}");
    assert!(other.stdout.starts_with("run.seed\n") && other.stdout.contains("7"), "{}", other.stdout);
}

#[test]
fn a_key_is_explained_without_a_setup_and_a_typo_names_the_nearest() {
    let known = config(&["explain", "arms.vs.start_deg"]);
    assert_eq!(known.code, Some(0), "{known:?}");
    assert!(known.stdout.contains("unit: deg") && known.stdout.contains("allowed: "), "{}", known.stdout);
    let typo = config(&["explain", "arms.vs.start_degs"]);
    assert_eq!(typo.code, Some(1));
    assert!(typo.stderr.contains("did you mean arms.vs.start_deg?"), "{}", typo.stderr);
}
