//! Every file in `configs/` is read by the part of the program that uses it.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::collections::{BTreeMap, BTreeSet};

use crate::closed_loop::support::changed_setup;
use pb3dp_commissioning::gateway::file::read_gateway;
use pb3dp_geometry::ImageSize;
use pb3dp_kinematics::{Chain, DOF, JointVector};
use pb3dp_record::calibration_files::load_stereo;
use pb3dp_setup::estimator::read_estimator;
use pb3dp_setup::layers::{Layers, SetupArgs};
use pb3dp_setup::setup::{read_cameras, read_setup};
use system_tests::{files_below, repository};

#[test]
fn every_configuration_is_accepted_by_its_reader() {
    let configs = repository().join("configs");
    let files = files_below(&configs).unwrap();
    let (mut setups, mut estimators, mut gateways, mut robots) = (0, 0, 0, 0);
    for file in &files {
        let path = file.strip_prefix(&configs).unwrap().to_string_lossy().replace('\\', "/");
        if path == "estimator.toml" {
            read_estimator(file).unwrap_or_else(|error| panic!("{error}"));
            estimators += 1;
        } else if path == "gateway.toml" {
            // The command line gives its address.
            read_gateway(file, None, Some("serial:/dev/ttyUSB0")).unwrap_or_else(|error| panic!("{error}"));
            gateways += 1;
        } else if path.ends_with(".toml")
            && ["sim.toml", "playground.toml", "hil.toml", "rig.toml", "bare.toml", "published.toml"]
                .contains(&path.as_str())
        {
            read_setup(file).unwrap_or_else(|error| panic!("{error}"));
            setups += 1;
        } else if ["calibration_gates.toml", "calibration_verify.toml", "hand_eye_gates.toml"].contains(&path.as_str())
        {
            // Read by `pb3dp calibrate`, whose own tests compare the file with the built-in limits.
        } else if path.starts_with("calibration/") {
            load_stereo(std::slice::from_ref(file)).unwrap_or_else(|error| panic!("{error}"));
        } else if path.starts_with("robots/") && path.ends_with(".urdf") {
            let chain = Chain::from_urdf_str(&std::fs::read_to_string(file).unwrap(), "base_link", "flange")
                .unwrap_or_else(|error| panic!("{path}: {error}"));
            let stretched = chain.forward(&JointVector::zeros()).translation_m();
            if path.contains("pa10") {
                assert!(stretched.norm() > 1.0 && stretched.norm() < 1.6, "{path}: a PA-10 reaches {stretched}");
                assert_eq!(chain.joints(), DOF);
            }
            robots += 1;
        } else if let Some(name) = path.strip_prefix("arms/").and_then(|name| name.strip_suffix(".toml")) {
            let named = format!("carries_cameras = {name:?}");
            let setup = changed_setup(&[("# carries_cameras = \"ur5e\"", &named)]);
            assert_eq!(setup.rig.arms.vs.key, format!("arms.{name}"));
        } else if path.starts_with("deploy/") {
            // Read by the operating system; `cargo xtask tidy` parses each of these, and rejects others.
        } else {
            panic!("{path}: no reader of this kind of file is known; add it to this test");
        }
    }
    assert!(setups > 1 && estimators == 1 && gateways == 1 && robots > 0, "{files:?}");
}

#[test]
fn the_estimator_file_and_the_setup_hold_the_documented_defaults() {
    let defaults = pb3dp_estimation::estimator::EstimatorConfig::default();
    assert_eq!(read_estimator(&repository().join("configs/estimator.toml")).unwrap(), defaults);
    for file in ["sim.toml", "published.toml", "hil.toml", "rig.toml", "bare.toml"] {
        let mut of_setup = read_setup(&repository().join("configs").join(file)).unwrap();
        of_setup.estimator.published.rmga.seed = defaults.published.rmga.seed;
        assert_eq!(of_setup.estimator, defaults, "{file}");
    }
}

/// The keys in which two setups differ, without the keys of these tables.
fn differing(a: &str, b: &str, but: &[&str]) -> Vec<String> {
    let of = |name: &str| -> BTreeMap<String, String> {
        let args = SetupArgs::of_file(&repository().join("configs").join(name));
        let all = Layers::read(&args).unwrap().effective();
        all.into_iter().map(|setting| (setting.key, setting.value)).collect()
    };
    let (a, b) = (of(a), of(b));
    let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    // The same robot description exists next to a file and in the program.
    let but: Vec<&str> = but.iter().copied().chain(["arms.vs.robot", "arms.tc.robot"]).collect();
    let is_other = |key: &&&String| a.get(**key) != b.get(**key) && !but.iter().any(|table| key.starts_with(table));
    keys.iter().filter(is_other).map(|key| (*key).clone()).collect()
}

/// The shipped setups have the same workcell and the same experiment, so that their figures are comparable.
#[test]
fn the_setups_differ_only_in_what_they_are_for() {
    let of_feed_forward =
        ["servo.arm_response.", "servo.feed_forward.", "servo.null_motion.", "servo.unstated.", "servo.target."];
    let laws = [&of_feed_forward[..], &["servo.gains.", "servo.smoothing."]].concat();
    assert_eq!(differing("sim.toml", "published.toml", &laws), ["estimator.compare", "estimator.method", "servo.law"]);
    let links = ["arms.vs.gateway.", "arms.tc.gateway."];
    assert_eq!(
        differing("sim.toml", "hil.toml", &links),
        ["arms.tc.backend", "arms.vs.backend", "estimator.compare", "run.pace", "servo.arm_response.delay_millis"]
    );
    assert_eq!(differing("sim.toml", "bare.toml", &["truth."]), ["estimator.compare"]);
    let prefixes = ["camera.", "scene.", "drift.", "estimator.geometric.", "arms.vs.gateway.", "arms.tc.gateway."];
    let cautious: Vec<String> = differing("hil.toml", "rig.toml", &prefixes);
    assert_eq!(
        cautious,
        [
            "arms.first_run",
            "arms.speed_scale",
            "arms.tc.backend",
            "arms.tc.commissioning_record",
            "arms.vs.backend",
            "arms.vs.commissioning_record",
            "experiment.move_s",
            "servo.approach.angular_max_deg_per_s",
            "servo.approach.linear_max_mm_per_s",
            "servo.speed.angular_max_deg_per_s",
            "servo.speed.linear_max_mm_per_s",
            "supervisor.policies.operator_silent.action",
            "supervisor.policies.orientation_jump.resume",
            "supervisor.policies.outlier.resume",
            "supervisor.policies.position_jump.resume",
            "supervisor.policies.target_lost.resume",
        ]
    );
}

/// The cameras of a rig alone equal those of its setup, except for the baseline, for which the calibration must be read.
#[test]
fn the_cameras_of_the_rig_can_be_read_alone() {
    let file = repository().join("configs/rig.toml");
    let (cameras, range) = read_cameras(&SetupArgs::of_file(&file)).unwrap();
    let setup = read_setup(&file).unwrap();
    let mut of_setup = setup.rig.real_cameras.clone().unwrap();
    assert_eq!(of_setup.stereo.skew_cost.baseline_m.take(), Some(0.1));
    assert_eq!((&cameras, range), (&of_setup, setup.range));
    assert_eq!(cameras.size(), ImageSize { width: 640, height: 480 });
    assert_eq!(cameras.calibration().unwrap().rig.baseline_m(), 0.1);
    let refused = read_cameras(&SetupArgs::of_file(&repository().join("configs/hil.toml"))).unwrap_err().to_string();
    assert!(refused.contains("camera.backend = \"sim\""), "{refused}");
}
