//! A stereo rig on an arm, calibrated with the commands only, from rendered images: first view, proposed poses, stereo rig,
//! hand-eye, and the board on the other arm.

use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Vector3, Vector6};
use pb3dp_geometry::frames::{Base, Flange};
use pb3dp_geometry::{Camera, Pinhole, Pose, StereoRig, se3, so3};
use pb3dp_record::calibration_files::{
    BoardPlace, CameraIdentity, HandEye, load_hand_eye, load_stereo, save_cameras, save_json,
};
use pb3dp_record::images::{StoredFormat, save};
use pb3dp_record::stops::{ArmOfPoses, ArmStand, Stop, Stops, load_poses, save_stops};

use crate::arm::{GOOD, Place, World};
use crate::program::calibrate;
use crate::renderer::{Imaging, Renderer};
use crate::support::{Random, board};

/// A workcell with two arms, one of which carries the board.
struct Cell {
    world: World,
    cameras: [Renderer; 2],
    random: Random,
    folder: PathBuf,
}

impl Cell {
    fn base_from_board(&self, tc: &Isometry3<f64>) -> Isometry3<f64> {
        let Place::Carried { vs_base_from_tc_base, tc_flange_from_board } = self.world.place else { panic!("carried") };
        vs_base_from_tc_base * tc * tc_flange_from_board
    }

    /// Reported pose of an arm.
    fn stand(&mut self, flange: &Isometry3<f64>) -> ArmStand {
        let noise = Vector6::from_fn(|n, _| {
            self.random.normal() * if n < 3 { GOOD.robot_sigma_m } else { GOOD.robot_sigma_rad }
        });
        ArmStand { joints_rad: [0.0; 7], base_from_flange: Pose::from_isometry(flange * se3::exp(&noise)) }
    }

    /// Records images and stops at the given poses of both arms.
    fn record(&mut self, name: &str, poses: &[[Isometry3<f64>; 2]]) -> PathBuf {
        let folder = self.folder.join(name);
        fs::create_dir_all(&folder).expect("a folder");
        let mut stops = Vec::new();
        let mut resting: [Option<(Isometry3<f64>, ArmStand)>; 2] = [None; 2];
        for (index, arms) in poses.iter().enumerate() {
            let [vs, tc] = arms;
            let cam_left_from_board = (vs * self.world.flange_from_cam_left).inverse() * self.base_from_board(tc);
            let right = self.world.rig.cam_right_from_cam_left().isometry() * cam_left_from_board;
            let files = ["left", "right"].map(|side| format!("{side}_{index:02}.png"));
            for ((camera, pose), file) in self.cameras.iter().zip([cam_left_from_board, right]).zip(&files) {
                let imaging = Imaging { blur_px: 0.0, noise_grey: 1.0, contrast: 1.0 };
                let image = camera.image(&camera.light(&pose, &board()), imaging, &mut self.random);
                save(&image::DynamicImage::from(image).into_rgb8(), &folder.join(file), StoredFormat::Png)
                    .expect("written");
            }
            let [left, right] = files;
            // A stationary arm reports the same pose each time.
            let [vs, tc] = [0, 1].map(|arm| match resting[arm] {
                Some((pose, stand)) if pose == arms[arm] => stand,
                _ => self.stand(&arms[arm]),
            });
            resting = [Some((arms[0], vs)), Some((arms[1], tc))];
            stops.push(Stop { left, right, vs, tc: Some(tc) });
        }
        let cameras =
            ["A1", "B2"].map(|serial| CameraIdentity { serial: Some(serial.to_owned()), ..Default::default() });
        save_cameras(&cameras, &folder.join("cameras.toml")).expect("written");
        save_stops(&folder, &Stops { date: "2026-11-22T09:00:00Z".to_owned(), stops }).expect("written");
        folder
    }
}

/// The six numbers of a pose with an error of 10 mm and 3 degrees.
fn guess(pose: &Isometry3<f64>) -> String {
    let off =
        Isometry3::from_parts(Vector3::new(0.006, -0.006, 0.005).into(), so3::exp(&Vector3::new(0.03, 0.03, -0.03)));
    let pose = pose * off;
    let (t, turn) = (pose.translation.vector * 1e3, so3::log(&pose.rotation).map(f64::to_degrees));
    format!("{},{},{},{},{},{}", t.x, t.y, t.z, turn.x, turn.y, turn.z)
}

fn poses_of(file: &Path, arm: ArmOfPoses) -> Vec<Isometry3<f64>> {
    let wanted = load_poses(file).expect("poses");
    assert_eq!(wanted.arm, arm);
    wanted.poses.iter().map(|pose: &Pose<Base, Flange>| *pose.isometry()).collect()
}

#[track_caller]
fn check(name: &str, found: &Isometry3<f64>, truth: &Isometry3<f64>, [mm, deg]: [f64; 2]) {
    let distance = (found.translation.vector - truth.translation.vector).norm() * 1e3;
    let angle = found.rotation.angle_to(&truth.rotation).to_degrees();
    println!("{name}: {distance:.3} mm, {angle:.4} deg from the truth");
    assert!(distance < mm && angle < deg, "{name}: {distance} mm, {angle} deg");
}

/// The stereo rig with a 2 % error of the focal length, saved as a nominal calibration.
fn save_nominal(rig: &StereoRig, file: &Path) {
    let camera = |camera: &Camera| {
        let p = camera.pinhole();
        let pinhole = Pinhole { fx: p.fx * 1.02, fy: p.fy * 1.02, ..*p };
        Camera::new(camera.size(), pinhole, pb3dp_geometry::Distortion::None).expect("a camera")
    };
    let rig = StereoRig::new(camera(rig.left()), camera(rig.right()), *rig.cam_right_from_cam_left()).expect("a head");
    save_json(&rig, file).expect("written");
    let text = fs::read_to_string(file).expect("read");
    let text = text.replacen('{', "{\n  \"calibration_quality\": \"none: nominal\",", 1);
    fs::write(file, text).expect("written");
}

const TARGET: [&str; 4] = ["--board", "9x6", "--square", "25"];

/// Arm poses of the first view: the board is approximately in the middle of the images.
fn first_look(cell: &Cell) -> [Isometry3<f64>; 2] {
    let tc = Isometry3::from_parts(Vector3::new(0.9, 0.15, 0.6).into(), so3::exp(&Vector3::new(0.2, 1.5, 0.3)));
    let middle = board().corner_in_board(8, 5).coords * 0.5;
    let turn = so3::exp(&Vector3::new(0.1, -0.1, 0.05));
    let to_middle = Isometry3::from_parts(Vector3::new(0.05, 0.01, 0.5).into(), turn);
    let look_from_board = to_middle * Isometry3::translation(-middle.x, -middle.y, 0.0);
    [cell.base_from_board(&tc) * (cell.world.flange_from_cam_left * look_from_board).inverse(), tc]
}

#[test]
fn head_hand_and_both_arms_are_calibrated_by_the_commands_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let mut random = Random::new(77);
    let world = World::carried(&mut random);
    let cameras = [world.rig.left(), world.rig.right()].map(Renderer::new);
    let mut cell = Cell { world, cameras, random, folder: folder.path().to_path_buf() };
    let [calib, nominal, hand_eye, vs_poses] = ["calib.toml", "nominal.json", "hand_eye.toml", "vs.toml"].map(path);
    let first = first_look(&cell);
    let look = cell.record("look", &[first]).display().to_string();
    save_nominal(&cell.world.rig, Path::new(&nominal));

    // Poses of the arm with the cameras; then the stereo and hand-eye calibration from them.
    let guessed = guess(&cell.world.flange_from_cam_left);
    let from_look = ["propose", "--recording", &look, "--calib", &nominal];
    calibrate(&[&from_look, &TARGET, &["--guess", &guessed, "--out", &vs_poses]]).succeeded();
    let of_vs: Vec<_> = poses_of(Path::new(&vs_poses), ArmOfPoses::Vs).iter().map(|pose| [*pose, first[1]]).collect();
    assert_eq!(of_vs.len(), 18);
    let stops = cell.record("stops", &of_vs).display().to_string();
    let head = calibrate(&[&["stereo", "--left", &stops, "--right", &stops, "--out", &calib], &TARGET]).succeeded();
    head.contains_all(&["good     views = 18.000"]);
    let hand = ["hand-eye", "--recording", &stops, "--calib", &calib];
    let reported_hand = calibrate(&[&hand, &TARGET, &["--out", &hand_eye]]).succeeded();
    reported_hand.contains_all(&["the arm tc has not moved", "flange_from_hand = {"]);
    let found = load_hand_eye(Path::new(&hand_eye)).expect("a hand-eye calibration");
    check_hand(&found, &cell, &calib);
    assert!(matches!(found.board, BoardPlace::Room { .. }));
    assert_eq!(found.judgement.refusals().count(), 0);
    assert_eq!(found.judgement.cameras[1].serial.as_deref(), Some("B2"));
    assert_eq!(found.judgement.date, "2026-11-22T09:00:00Z");

    // Wrong square size.
    let wrong = calibrate(&[&hand, &["--board", "9x6", "--square", "25.25"]]).refused();
    wrong.contains_all(&["refused  scale_percent", "measure the squares"]);
    both_arms(&mut cell, first[0], [&look, &stops, &calib, &hand_eye]);
}

/// The same workcell with poses of the arm that carries the board.
fn both_arms(cell: &mut Cell, vs: Isometry3<f64>, [look, stops, calib, hand_eye]: [&str; 4]) {
    let Place::Carried { vs_base_from_tc_base, tc_flange_from_board } = cell.world.place else { panic!("carried") };
    let tc_poses = cell.folder.join("tc.toml").display().to_string();
    let bases = guess(&vs_base_from_tc_base);
    let known = ["--arm", "tc", "--count", "12", "--hand-eye", hand_eye, "--guess-bases", &bases, "--out", &tc_poses];
    let from_look = ["propose", "--recording", look, "--calib", calib];
    calibrate(&[&from_look, &TARGET, &known]).succeeded();
    let of_tc: Vec<_> = poses_of(Path::new(&tc_poses), ArmOfPoses::Tc).iter().map(|pose| [vs, *pose]).collect();
    let more = cell.record("more", &of_tc).display().to_string();
    let both = ["hand-eye", "--recording", stops, &more, "--calib", calib, "--out", hand_eye];
    let reported_both = calibrate(&[&both, &TARGET]).succeeded();
    reported_both.contains_all(&["the board is mounted on the flange of tc", "[arms.tc]"]);
    let found = load_hand_eye(Path::new(hand_eye)).expect("a hand-eye calibration");
    let BoardPlace::Carried { vs_base_from_tc_base: bases, tc_flange_from_board: on_flange } = found.board else {
        panic!("{:?}", found.board)
    };
    check_hand(&found, cell, calib);
    check("vs_base_from_tc_base", bases.isometry(), &vs_base_from_tc_base, [3.0, 0.15]);
    check("tc_flange_from_board", on_flange.isometry(), &tc_flange_from_board, [1.0, 0.15]);
}

/// Checks the camera pose on the flange, and the position of a visible point.
fn check_hand(found: &HandEye, cell: &Cell, calib: &str) {
    // The camera pose includes the errors of the stereo rig, whose lens model is simpler than the truth; a visible point does
    // not.
    check("flange_from_cam_left", found.flange_from_cam_left.isometry(), &cell.world.flange_from_cam_left, [2.0, 0.3]);
    let believed = load_stereo(&[PathBuf::from(calib)]).expect("a head").rig;
    let point_mm = cell.world.point_error_m(&believed, &found.flange_from_cam_left, 0.5) * 1e3;
    println!("a point 500 mm ahead, on the flange: error {point_mm:.3} mm");
    assert!(point_mm < 1.2, "{point_mm}");
}

#[test]
fn what_can_not_be_is_refused_with_the_way_out() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let nominal = path("nominal.json");
    save_nominal(&World::in_room(&mut Random::new(3)).rig, Path::new(&nominal));
    let here = folder.path().display().to_string();
    let [short, no_number] = ["[0, 0]", "[nan, 0, 0]"].map(|translation_mm| {
        let file = path(&format!("setup {translation_mm}.toml"));
        let pose = format!("{{ translation_mm = {translation_mm}, rotation_vector_deg = [0, 0, 0] }}");
        fs::write(&file, format!("[mounts]\nflange_from_hand = {pose}\n")).expect("written");
        file
    });
    let propose = ["propose", "--out", "x.toml"];
    let refused: [(&[&str], &[&str], &str); 6] = [
        (&["hand-eye"], &[], "stops.toml"),
        (&["hand-eye"], &["--robot-sigma", "0.1"], "MM,DEG"),
        (&propose, &[], "--guess X,Y,Z,RX,RY,RZ"),
        (&propose, &["--guess", "1,2,3,4,5"], "six numbers"),
        (&propose, &["--setup", &short], "mounts.flange_from_hand: must be"),
        (&propose, &["--setup", &no_number], "mounts.flange_from_hand: must be"),
    ];
    for (args, further, named) in refused {
        let recording = ["--recording", &here, "--calib", &nominal];
        calibrate(&[args, &recording, &TARGET, further]).refused().contains_all(&[named]);
    }
}
