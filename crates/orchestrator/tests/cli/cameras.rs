//! `pb3dp cameras` on the machine of the tests, whatever that has; what it does with cameras is tested beside its code.

use crate::cli::support::{pb3dp, words};

#[test]
fn cameras_that_are_not_named_or_not_there_are_refused_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("sequence");
    pb3dp(&words(&[&"cameras", &"record", &"--out", &out])).assert_refused(&[
        "--config FILE",
        "--left NAME --right NAME",
        "cameras list",
    ]);
    let check = ["cameras", "check", "--left", "/dev/no_such_camera", "--right", "serial:none"];
    pb3dp(&check).assert_refused(&["/dev/no_such_camera: no such camera", "check plug and cable"]);
    pb3dp(&["cameras", "check", "--left", "/dev/video0"]).assert_refused(&["--right"]);
    pb3dp(&["cameras", "check", "--left", "front", "--right", "back"])
        .assert_refused(&["is not a camera name", "bus:PLACE"]);
    for view in [
        &["cameras", "view"][..],
        &["cameras", "view", "--left", "a", "--port", "9000"],
        &["cameras", "view", "--help"],
    ] {
        pb3dp(view).assert_refused(&["pb3dp panel --cameras", "--address in place of --port"]);
    }
    pb3dp(&["panel", "--cameras"]).assert_refused(&["no cameras are named"]);
    // A setup names them; its cameras are simulated, or not of this machine.
    let setup = |name: &str| crate::cli::support::repository().join("configs").join(name);
    pb3dp(&words(&[&"cameras", &"check", &"--config", &setup("sim.toml")])).assert_refused(&["camera.backend", "v4l2"]);
    let rig = pb3dp(&words(&[&"cameras", &"record", &"--config", &setup("rig.toml"), &"--out", &out]));
    rig.assert_refused(&["bus:usb-0000:00:14.0-1", "check plug and cable"]);
    let both = ["cameras", "check", "--config", "a", "--left", "/dev/video0", "--right", "/dev/video2"];
    pb3dp(&both).assert_refused(&["cannot be used with"]);
    // What a setup says itself is not typed beside it.
    for typed in [["--size", "1280x720"], ["--rate", "5"], ["--format", "GREY"], ["--skew-max", "9"], ["--calib", "a"]]
    {
        let both = [&["cameras", "check", "--config", "a"][..], &typed].concat();
        pb3dp(&both).assert_refused(&["cannot be used with", typed[0]]);
    }
    let negative = ["cameras", "check", "--left", "/dev/video0", "--right", "/dev/video2", "--exposure", "-4"];
    pb3dp(&negative).assert_refused(&["\"-4\": must be a number from 0.05 to 1000 ms"]);
    assert!(!out.exists());
}

#[test]
fn a_list_is_whole_or_says_why_not() {
    let list = pb3dp(&["cameras", "list", "--json"]);
    for line in list.stdout.lines() {
        let device: serde_json::Value = serde_json::from_str(line).unwrap();
        assert!(device["device"].as_str().is_some_and(|path| path.starts_with("/dev/")), "{line}");
    }
    // A machine of tests has none, as a rule.
    assert!(list.success || !list.stdout.is_empty() || list.stderr.contains("there is no camera"), "{}", list.stderr);
}
