//! Every file in `configs/` is read by the part of the program that it is for.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use crate::closed_loop::support::changed_setup;
use pb3dp_commissioning::gateway::file::read_gateway;
use pb3dp_geometry::ImageSize;
use pb3dp_kinematics::{Chain, DOF, JointVector};
use pb3dp_record::calibration_files::load_stereo;
use pb3dp_setup::estimator::read_estimator;
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
            // Where it listens is left to the command line.
            read_gateway(file, None, Some("serial:/dev/ttyUSB0")).unwrap_or_else(|error| panic!("{error}"));
            gateways += 1;
        } else if path.ends_with(".toml")
            && (path.starts_with("sim") || ["hil.toml", "rig.toml", "bare.toml"].contains(&path.as_str()))
        {
            read_setup(file).unwrap_or_else(|error| panic!("{error}"));
            setups += 1;
        } else if ["calibration_gates.toml", "calibration_verify.toml", "hand_eye_gates.toml"].contains(&path.as_str())
        {
            // Read by `pb3dp calibrate`, whose own tests compare it with the limits that are built in.
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
            assert_eq!(setup.rig.vs.key, format!("arms.{name}"));
        } else if path.starts_with("deploy/") {
            // Read by the system; `cargo xtask tidy` parses each of these, and refuses others.
        } else {
            panic!("{path}: no reader is known for this kind of file; name it in this test");
        }
    }
    assert!(setups > 1 && estimators == 1 && gateways == 1 && robots > 0, "{files:?}");
}

#[test]
fn the_estimator_file_and_the_setup_hold_the_documented_defaults() {
    let defaults = pb3dp_estimation::estimator::EstimatorConfig::default();
    assert_eq!(read_estimator(&repository().join("configs/estimator.toml")).unwrap(), defaults);
    for file in ["sim.toml", "sim_published.toml", "hil.toml", "rig.toml", "bare.toml"] {
        let mut of_setup = read_setup(&repository().join("configs").join(file)).unwrap();
        of_setup.estimator.published.rmga.seed = defaults.published.rmga.seed;
        assert_eq!(of_setup.estimator, defaults, "{file}");
    }
}

/// The two setups are the same cell and the same experiment, so that their figures can be compared.
#[test]
fn the_setups_differ_in_who_leads_and_in_his_law() {
    let (mut direct, mut published) = (table("sim.toml"), table("sim_published.toml"));
    for key in ["method", "compare"] {
        let of = |setup: &mut toml::Table| setup["estimator"].as_table_mut().unwrap().remove(key).unwrap();
        assert_ne!(of(&mut direct), of(&mut published));
    }
    let servo = |setup: &mut toml::Table, law: &str, tables: &[&str]| {
        let servo = setup["servo"].as_table_mut().unwrap();
        assert_eq!(servo.remove("law").unwrap().as_str(), Some(law));
        tables.iter().for_each(|table| drop(servo.remove(*table).unwrap()));
    };
    let of_feed_forward = ["arm_response", "feed_forward", "null_motion", "unstated", "target"];
    servo(&mut direct, "feed-forward", &of_feed_forward);
    servo(&mut published, "published", &["gains", "smoothing"]);
    assert_eq!(direct, published);
}

fn table(file: &str) -> toml::Table {
    std::fs::read_to_string(repository().join("configs").join(file)).unwrap().parse().unwrap()
}

/// Hardware in the loop is the same cell and the same experiment, too.
#[test]
fn the_setup_with_arms_behind_lines_differs_in_how_they_are_reached() {
    let (mut sim, mut hil) = (table("sim.toml"), table("hil.toml"));
    for arm in ["vs", "tc"] {
        let arm_of = |setup: &mut toml::Table| setup["arms"][arm].as_table_mut().unwrap().remove("backend").unwrap();
        assert_eq!((arm_of(&mut sim).as_str(), arm_of(&mut hil).as_str()), (Some("mock"), Some("emulated")));
        assert!(hil["arms"][arm].as_table_mut().unwrap().remove("gateway").is_some());
    }
    for (section, key) in [("run", "pace"), ("estimator", "compare")] {
        for setup in [&mut sim, &mut hil] {
            setup[section].as_table_mut().unwrap().remove(key).unwrap();
        }
    }
    // A line and a gateway take time, too.
    let delay_millis = |setup: &mut toml::Table| {
        let response = setup["servo"]["arm_response"].as_table_mut().unwrap();
        response.remove("delay_millis").unwrap().as_float().unwrap()
    };
    let (in_process, through_lines) = (delay_millis(&mut sim), delay_millis(&mut hil));
    assert!((1.0..=15.0).contains(&(through_lines - in_process)), "{in_process} and {through_lines} ms");
    assert_eq!(sim, hil);
}

/// The rig is the same cell, too: what differs is how it is seen and reached, and that it is slow and asks its operator.
#[test]
fn the_rig_differs_in_cameras_arms_and_caution() {
    let (mut hil, mut rig) = (table("hil.toml"), table("rig.toml"));
    let differing = [
        (&["camera"][..], &[][..]),
        (&["servo", "speed"], &["linear_max_mm_per_s", "angular_max_deg_per_s"]),
        (&["servo", "approach"], &["linear_max_mm_per_s", "angular_max_deg_per_s"]),
        (&["supervisor", "policies"], &["target_lost", "position_jump", "orientation_jump", "outlier"]),
        (&["arms"], &["speed_scale", "first_run"]),
        (&["arms", "vs"], &["backend"]),
        (&["arms", "tc"], &["backend"]),
        (&["experiment"], &["move_s"]),
    ];
    for setup in [&mut hil, &mut rig] {
        for (path, keys) in differing {
            let (last, above) = path.split_last().unwrap();
            let parent = above.iter().fold(&mut *setup, |table, key| table[*key].as_table_mut().unwrap());
            match keys {
                [] => drop(parent.remove(*last).unwrap()),
                keys => keys.iter().for_each(|key| drop(parent[*last].as_table_mut().unwrap().remove(*key).unwrap())),
            }
        }
    }
    assert!(hil.remove("scene").is_some() && !rig.contains_key("scene"));
    assert!(rig.remove("drift").is_some());
    assert!(hil["estimator"].as_table_mut().unwrap().remove("geometric").is_some());
    for arm in ["vs", "tc"] {
        let gateway = rig["arms"][arm]["gateway"].as_table_mut().unwrap();
        assert!(gateway.remove("port").is_some() && gateway.remove("baud").is_some());
    }
    assert_eq!(hil, rig);
}

/// The cameras of a rig by themselves are those of its setup.
#[test]
fn the_cameras_of_the_rig_can_be_read_alone() {
    let file = repository().join("configs/rig.toml");
    let cameras = read_cameras(&file).unwrap();
    assert_eq!(Some(&cameras), read_setup(&file).unwrap().real_cameras());
    assert_eq!(cameras.size(), ImageSize { width: 640, height: 480 });
    assert_eq!(cameras.calibration().unwrap().rig.baseline_m(), 0.1);
    let refused = read_cameras(&repository().join("configs/hil.toml")).unwrap_err().to_string();
    assert!(refused.contains("camera.backend = \"sim\""), "{refused}");
}
