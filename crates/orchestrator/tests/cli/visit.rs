//! `pb3dp arm visit`: an arm goes to poses and takes pairs, in the simulated bare rig.

use std::path::Path;

use nalgebra::Vector3;
use pb3dp_bag::messages::JointState;
use pb3dp_bag::pairs::{PairOptions, StereoBag, decoded};
use pb3dp_geometry::frames::{Base, Flange};
use pb3dp_geometry::{Pose, so3};
use pb3dp_record::images::load_rgb;
use pb3dp_record::stops::{ArmOfPoses, Stops, WantedPoses, load_poses, load_stops, save_poses};

use crate::cli::support::{Finished, pb3dp, repository, words};

const BOARD: [&str; 2] = ["--emulated-board", "9x6:20"];

fn config(name: &str) -> String {
    repository().join("configs").join(name).display().to_string()
}

fn visit(config_name: &str, out: &Path, more: &[&str]) -> Finished {
    let config = config(config_name);
    let mut args = words(&[&"arm", &"visit", &"--config", &config, &"--out", &out]);
    args.extend(more.iter().map(std::ffi::OsString::from));
    pb3dp(&args)
}

/// The stop at which both arms begin.
fn look(folder: &Path) -> Stops {
    let finished = visit("bare.toml", folder, &[&["--here"], &BOARD[..]].concat()).assert_success();
    assert!(finished.stdout.contains("pair and joints recorded"), "{}", finished.stdout);
    load_stops(folder).unwrap()
}

/// Poses a little off one, in its own frame: millimetres and degrees.
fn off(from: &Pose<Base, Flange>, by: &[[f64; 6]]) -> Vec<Pose<Base, Flange>> {
    let moved = |by: &[f64; 6]| {
        let turn = Vector3::new(by[3], by[4], by[5]).map(f64::to_radians);
        *from * Pose::<Flange, Flange>::from_parts(Vector3::new(by[0], by[1], by[2]) * 1e-3, so3::exp(&turn))
    };
    by.iter().map(moved).collect()
}

#[test]
fn pairs_and_joints_are_taken_where_they_were_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let begin = look(&folder.path().join("look"));
    assert_eq!(begin.stops.len(), 1);
    for arm in [ArmOfPoses::Vs, ArmOfPoses::Tc] {
        let (moves, rests) = match arm {
            ArmOfPoses::Vs => (begin.stops[0].vs, begin.stops[0].tc.unwrap()),
            ArmOfPoses::Tc => (begin.stops[0].tc.unwrap(), begin.stops[0].vs),
        };
        let near =
            [[5.0, -8.0, 6.0, 2.0, -3.0, 4.0], [4000.0, 0.0, 0.0, 0.0, 0.0, 0.0], [-6.0, 4.0, 3.0, -2.0, 1.0, -5.0]];
        let wanted = WantedPoses { arm, poses: off(&moves.base_from_flange, &near) };
        let poses = folder.path().join("poses.toml");
        save_poses(&poses, &wanted).unwrap();
        let out = folder.path().join(arm.name());
        let poses = poses.display().to_string();
        let more = [&["--poses", poses.as_str()], &BOARD[..]].concat();

        let dry = visit("bare.toml", &out, &more).assert_success();
        assert!(
            dry.stdout.contains("dry run") && dry.stdout.contains("   -     2  skipped: out of reach"),
            "{}",
            dry.stdout
        );
        assert!(!out.exists(), "a dry run writes nothing");

        let file = folder.path().join(format!("{}.mcap", arm.name()));
        let file_name = file.display().to_string();
        let both = ["--move", "--record", &file_name];
        let done = visit("bare.toml", &out, &[&more[..], &both].concat()).assert_success();
        assert!(done.stdout.contains("2 of 2 stops recorded, returned to the start"), "{}", done.stdout);
        let taken = load_stops(&out).unwrap();
        let stands = taken.stops.iter().map(|stop| match arm {
            ArmOfPoses::Vs => (stop.vs, stop.tc.unwrap()),
            ArmOfPoses::Tc => (stop.tc.unwrap(), stop.vs),
        });
        for ((stood, other), wanted) in stands.zip([&wanted.poses[0], &wanted.poses[2]]) {
            let off = stood.base_from_flange.inverse() * *wanted;
            // Joints arrive within half a thousandth of a radian.
            assert!(off.translation_m().norm() < 2e-3 && off.rotation_angle_rad() < 2e-3, "{off:?}");
            let still = other.base_from_flange.inverse() * rests.base_from_flange;
            assert!(still.translation_m().norm() < 1e-3, "the other arm has moved: {still:?}");
        }
        let images = taken.stops.iter().flat_map(|stop| [&stop.left, &stop.right]);
        let images: Vec<_> = images.map(|name| load_rgb(&out.join(name)).unwrap()).collect();
        assert!(images.iter().all(|image| image.dimensions() == (640, 480)));
        assert!(images.windows(2).all(|two| two[0] != two[1]));

        recorded_in_one_file(&file, &out, &taken);

        visit("bare.toml", &out, &[&more[..], &["--move"]].concat())
            .assert_refused(&["contains a recording of stops already"]);
    }
}

/// The file has the same stops and images as the folder, and the way of both arms between them.
fn recorded_in_one_file(file: &Path, folder: &Path, taken: &Stops) {
    let bag = StereoBag::open(file, PairOptions::default()).unwrap();
    let stops = pb3dp_bag::stops::stops(bag.bag()).unwrap();
    let pairs: Vec<_> = bag.pairs().map(|pair| pair.unwrap()).collect();
    assert_eq!((stops.len(), pairs.len()), (taken.stops.len(), taken.stops.len()));
    for ((recorded, pair), stop) in stops.iter().zip(&pairs).zip(&taken.stops) {
        assert_eq!((recorded.at, recorded.vs, recorded.tc), (pair.exposed_at, stop.vs, stop.tc));
        let [left, right] = pair.images.as_ref().unwrap();
        assert_eq!(
            [left, right],
            [&stop.left, &stop.right].map(|name| load_rgb(&folder.join(name)).unwrap()).each_ref()
        );
    }
    let joints: Vec<JointState> = bag
        .bag()
        .messages_on(&["/vs_robot/joint_states"])
        .unwrap()
        .map(|message| decoded(&message.unwrap()).unwrap())
        .collect();
    assert!(joints.len() > 200 && joints.iter().all(|joints| joints.position.len() == joints.name.len()));
    let times: Vec<u64> = joints.iter().map(|joints| joints.header.stamp.nanos()).collect();
    assert!(times.is_sorted() && times[0] > 1_700_000_000_000_000_000, "stamps count since 1970");
    let last = stops.last().unwrap().at.as_nanos();
    assert!(times[0] < stops[0].at.as_nanos() && times[times.len() - 1] > last, "the way to the stops and back");
}

#[test]
fn one_file_is_enough_for_a_visit() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("new").join("look.mcap");
    let config = config("bare.toml");
    let visit = |record: &Path| {
        let words = words(&[
            &"arm",
            &"visit",
            &"--config",
            &config,
            &"--here",
            &"--emulated-board",
            &"9x6:20",
            &"--record",
            &record,
        ]);
        pb3dp(&words)
    };
    let done = visit(&file).assert_success();
    assert!(done.stdout.contains("look.mcap") && !done.stdout.contains("stops.toml"), "{}", done.stdout);
    visit(&file).assert_refused(&["exists already"]);
    visit(&folder.path().join("look")).assert_refused(&["use --out"]);
    let written: Vec<_> =
        std::fs::read_dir(file.parent().unwrap()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(written, std::slice::from_ref(&file), "nothing else is written");

    let poses = folder.path().join("poses.toml");
    let calib = repository().join("configs/calibration/nominal.json");
    let proposed = pb3dp(&words(&[
        &"calibrate",
        &"propose",
        &"--recording",
        &file,
        &"--calib",
        &calib,
        &"--board",
        &"9x6",
        &"--square",
        &"20",
        &"--arm",
        &"vs",
        &"--guess",
        &"0,0,0,0,0,0",
        &"--count",
        &"8",
        &"--out",
        &poses,
    ]));
    let text = format!("{}{}", proposed.stdout, proposed.stderr);
    assert!(text.contains("for the last stop") && load_poses(&poses).is_ok(), "{text}");
}

#[test]
fn unreachable_stops_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("stops");
    visit("bare.toml", &out, &["--here"]).assert_refused(&["use --emulated-board 9x6:20"]);
    visit("bare.toml", &out, &["--here", "--emulated-board", "9x6"]).assert_refused(&["inner corners and the side"]);
    visit("bare.toml", &out, &["--here", "--emulated-board", "2x6:20"]).assert_refused(&["target.corners"]);
    visit("bare.toml", &out, &BOARD).assert_refused(&["--poses"]);
    visit("rig.toml", &out, &[&["--here"], &BOARD[..]].concat())
        .assert_refused(&["the cameras of this setup are real"]);
    let far = Pose::from_parts(Vector3::new(4.0, 0.1, 0.2), so3::exp(&Vector3::new(0.1, 0.2, 0.3)));
    let poses = folder.path().join("poses.toml");
    save_poses(&poses, &WantedPoses { arm: ArmOfPoses::Vs, poses: vec![far] }).unwrap();
    let poses = poses.display().to_string();
    visit("bare.toml", &out, &[&["--poses", poses.as_str()], &BOARD[..]].concat())
        .assert_refused(&["no pose can be reached"]);
    assert!(!out.exists());
}
