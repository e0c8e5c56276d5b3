//! Recordings of stops and poses to visit: bit-exact round trip, and refused files.

#![allow(clippy::unwrap_used, reason = "helpers of tests may fail loudly, as tests do")]

use std::fs;

use crate::check_changes;
use nalgebra::Vector3;
use pb3dp_geometry::{Pose, so3};
use pb3dp_record::stops::{
    ArmOfPoses, ArmStand, STOPS_FILE, Stop, Stops, WantedPoses, load_poses, load_stops, save_poses, save_stops,
};

fn stand(seed: f64) -> ArmStand {
    let base_from_flange = Pose::from_parts(
        Vector3::new(0.4 / seed, -0.1 * seed, 1e-9 / 7.0),
        so3::exp(&Vector3::new(0.3 * seed, -1.1, 0.7 / seed)),
    );
    ArmStand { joints_rad: [0.1, -0.2, 0.3 / 0.7, 1.4 * seed, -0.5, 0.6, -2.7], base_from_flange }
}

fn stops() -> Stops {
    let stop = |number: usize, tc: Option<ArmStand>| Stop {
        left: format!("left/{number:06}.png"),
        right: format!("right/{number:06}.png"),
        vs: stand(1.0 + number as f64 / 3.0),
        tc,
    };
    Stops { date: "2026-11-22T09:00:00Z".to_owned(), stops: vec![stop(0, Some(stand(0.7))), stop(1, None)] }
}

#[test]
fn stops_come_back_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    save_stops(folder.path(), &stops()).unwrap();
    assert_eq!(load_stops(folder.path()).unwrap(), stops());
}

#[test]
fn poses_come_back_bit_by_bit() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("poses.toml");
    for arm in [ArmOfPoses::Vs, ArmOfPoses::Tc] {
        let wanted = WantedPoses { arm, poses: vec![stand(0.9).base_from_flange, stand(1.3).base_from_flange] };
        save_poses(&file, &wanted).unwrap();
        assert_eq!(load_poses(&file).unwrap(), wanted);
    }
}

#[test]
fn mistakes_are_named_with_their_keys() {
    let folder = tempfile::tempdir().unwrap();
    save_stops(folder.path(), &stops()).unwrap();
    let file = folder.path().join(STOPS_FILE);
    let good = fs::read_to_string(&file).unwrap();
    let changes = [
        ("pb3dp stops 1", "pb3dp stops 9", "format: is \"pb3dp stops 9\""),
        ("joints_rad = [0.1, ", "joints_rad = [", "stop[0].vs.joints_rad: has 6 numbers, 7 are needed"),
        ("left/000001.png", "../000001.png", "stop[1].left: must be a file in or below this folder"),
        ("left/000001.png", "/000001.png", "stop[1].left: must be a file in or below this folder"),
        ("rotation_wxyz = [", "rotation_wxyz = [2.0, ", "stop[0].vs.base_from_flange.rotation_wxyz: has 5 numbers"),
        ("[stop.tc]", "[stop.arm]", "stop[0].arm: unknown key"),
        ("left = \"left/000000.png\"", "", "stop[0].left: is missing"),
    ];
    check_changes(&good, &changes, |text| {
        fs::write(&file, text).unwrap();
        let error = load_stops(folder.path()).unwrap_err().to_string();
        assert!(error.contains(STOPS_FILE), "{error}");
        error
    });
}
