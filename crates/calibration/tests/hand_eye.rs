//! Simulated stereo rigs on arms: hand-eye calibrations compared with the ground truth and with OpenCV, and planted defects.

use crate::support;
use nalgebra::{Isometry3, Vector3};
use pb3dp_calibration::fit::Fit;
use pb3dp_calibration::gates::{Grade, Limits};
use pb3dp_calibration::hand_eye::gates::{ROTATION_SPREAD, SCALE};
use pb3dp_calibration::hand_eye::{CalibrationCovariance, Given, HandEyeError, HandEyeFit, HandEyeStop, RobotSigma};
use pb3dp_calibration::lens::LensModel;
use pb3dp_geometry::{StereoRig, se3, so3};
use pb3dp_record::calibration_files::ParameterCovariance;

use crate::arm::{GOOD, JointWorld, Visit, World};
use crate::support::{Random, Session, board, median_and_p95};
use pb3dp_test_support::sweep;

/// Number of rigs evaluated with OpenCV.
const RIGS: u32 = 100;

fn rigs() -> u32 {
    sweep(20, RIGS)
}

/// Number of rigs for slow tests: joints for each pose, a calibration of the stereo rig.
fn rigs_of_arm() -> u32 {
    sweep(10, 40)
}

/// Tolerance of the share within one standard deviation around 68.3 %: 0.08 for the long sweep, more for fewer rigs.
fn share_tolerance(rigs: u32, long: u32) -> f64 {
    0.08 * (f64::from(long) / f64::from(rigs)).sqrt()
}

/// Approximate distance of the board, metres.
const DISTANCE_M: f64 = 0.5;

fn fit(stops: &[HandEyeStop], rig: &StereoRig) -> Result<HandEyeFit, HandEyeError> {
    HandEyeFit::new(stops, &Given { rig, rig_covariance: None, board: &board(), robot: RobotSigma::default() })
}

fn poses(fit: &HandEyeFit) -> Vec<Isometry3<f64>> {
    fit.poses().into_iter().map(|(_, pose)| pose).collect()
}

/// Distance in mm and angle in degrees.
fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> [f64; 2] {
    [(a.translation.vector - b.translation.vector).norm() * 1e3, a.rotation.angle_to(&b.rotation).to_degrees()]
}

/// Results over a hundred rigs.
#[derive(Default)]
struct Tally {
    /// Errors of each pose: mm and degrees.
    errors: Vec<Vec<[f64; 2]>>,
    within: usize,
    all: usize,
    squares: f64,
    refused: usize,
    noise_ratios: Vec<f64>,
}

impl Tally {
    fn add(&mut self, seed: u32, fit: &HandEyeFit, truth: &[Isometry3<f64>]) {
        let found = poses(fit);
        self.errors.resize(found.len(), Vec::new());
        for (index, (found, truth)) in found.iter().zip(truth).enumerate() {
            self.errors[index].push(apart(found, truth));
            let off = se3::log(&(found.inverse() * truth));
            for (n, off) in off.iter().enumerate() {
                let error = off / fit.covariance[(6 * index + n, 6 * index + n)].sqrt();
                self.within += usize::from(error.abs() <= 1.0);
                self.all += 1;
                self.squares += error * error;
            }
        }
        self.noise_ratios.push(fit.robot_noise_ratio);
        let refused = refused(fit);
        if !refused.is_empty() {
            println!("seed {seed}: {refused:?}");
        }
        self.refused += usize::from(!refused.is_empty());
    }

    fn share(&self) -> f64 {
        self.within as f64 / self.all as f64
    }

    /// Median and 95th percentile of the errors of a pose.
    fn of(&self, pose: usize) -> [[f64; 2]; 2] {
        [0, 1].map(|which| median_and_p95(&self.errors[pose].iter().map(|error| error[which]).collect::<Vec<_>>()))
    }

    fn tell(&self, what: &str, names: &[&str]) {
        println!("{what}: {} rigs, {} refused", self.noise_ratios.len(), self.refused);
        for (index, name) in names.iter().enumerate() {
            let [mm, deg] = self.of(index);
            println!("  {name}: median {:.3} mm, {:.4} deg; p95 {:.3} mm, {:.4} deg", mm[0], deg[0], mm[1], deg[1]);
        }
        println!(
            "  within one stated sigma: {:.1} % of {} numbers, mean square {:.2}; robot noise over the stated noise: median {:.2}",
            100.0 * self.share(),
            self.all,
            self.squares / self.all as f64,
            median_and_p95(&self.noise_ratios)[0]
        );
    }
}

/// The gates that refuse.
fn refused(fit: &HandEyeFit) -> Vec<(&'static str, f64)> {
    let verdicts = Limits::of_hand_eye().judge_hand_eye(fit, DISTANCE_M);
    verdicts.iter().filter(|v| v.grade() == Grade::Refused).map(|v| (v.gate.key, v.measured)).collect()
}

fn visited(seed: u32, visit: &Visit) -> (World, Vec<HandEyeStop>) {
    let mut random = Random::new(seed);
    let world = World::in_room(&mut random);
    let stops = world.visit(visit, &mut random);
    (world, stops)
}

#[test]
fn exact_stops_give_back_the_exact_poses() {
    let visit = Visit { corner_sigma_px: 0.0, robot_sigma_m: 0.0, robot_sigma_rad: 0.0, ..GOOD };
    let mut random = Random::new(11);
    for world in [World::in_room(&mut random), World::carried(&mut random)] {
        let stops = world.visit(&visit, &mut random);
        let fit = fit(&stops, &world.rig).expect("a fit");
        for (found, truth) in poses(&fit).iter().zip(world.poses()) {
            assert!((found.to_homogeneous() - truth.to_homogeneous()).amax() < 1e-8, "{found}, {truth}");
        }
        let scales = fit.scales;
        assert!((scales.squares.factor - 1.0).abs() < 1e-8 && (scales.baseline.factor - 1.0).abs() < 1e-8);
        assert_eq!(fit.rejected().count(), 0);
    }
}

/// Fits the stops of each seed, and checks the errors of the poses with these numbers and the share within one stated standard deviation.
fn check_sweep(
    what: &str,
    names: &[&str],
    (count, long, refused_max): (u32, u32, usize),
    (checked, mm_max): (&[usize], f64),
    visited: impl Fn(u32) -> (World, Vec<HandEyeStop>),
) {
    let mut tally = Tally::default();
    for seed in 0..count {
        let (world, stops) = visited(seed);
        let fit = fit(&stops, &world.rig).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        tally.add(seed, &fit, &world.poses());
    }
    tally.tell(what, names);
    for pose in checked {
        let [mm, deg] = tally.of(*pose);
        assert!(mm[0] <= mm_max && deg[0] <= 0.05, "{}: {mm:?} mm, {deg:?} deg", names[*pose]);
    }
    assert!((tally.share() - 0.683).abs() <= share_tolerance(count, long), "{}", tally.share());
    assert!(tally.refused <= refused_max, "{}", tally.refused);
}

const IN_ROOM: [&str; 2] = ["flange_from_cam_left", "base_from_board"];

#[test]
fn a_head_on_an_arm_is_found_and_its_errors_are_stated() {
    let what = "0.1 mm and 0.02 deg of the flange, 0.1 px, 15 stops";
    check_sweep(what, &IN_ROOM, (rigs(), RIGS, sweep(1, 3)), (&[0], 0.3), |seed| visited(seed, &GOOD));
}

#[test]
fn noise_in_the_joints_of_a_pa10_that_visits_the_proposed_poses_is_borne() {
    let what = "joints of a PA-10, 0.1 mm at the flange";
    check_sweep(what, &IN_ROOM, (rigs_of_arm(), 40, 1), (&[0], 0.3), |seed| {
        let mut random = Random::new(3000 + seed);
        let arm = JointWorld::new(1e-4, &mut random);
        let stops = arm.visit(&GOOD, &mut random);
        (arm.world, stops)
    });
}

#[test]
fn base_to_base_and_flange_to_board_are_found_in_one_adjustment() {
    let names = ["flange_from_cam_left", "vs_base_from_tc_base", "tc_flange_from_board"];
    let what = "board on the other arm, 12 stops of each arm";
    check_sweep(what, &names, (rigs(), RIGS, sweep(1, 3)), (&[0, 2], 0.4), |seed| {
        let mut random = Random::new(2000 + seed);
        let world = World::carried(&mut random);
        let stops = world.visit(&Visit { stops: 24, ..GOOD }, &mut random);
        (world, stops)
    });
}

#[test]
fn errors_of_the_stereo_calibration_are_counted() {
    let (mut counted, mut left_out) = (Tally::default(), Tally::default());
    let (mut points_mm, mut squares) = (Vec::new(), 0.0);
    for seed in 0..rigs_of_arm() {
        let mut random = Random::new(5000 + seed);
        let world = World::in_room(&mut random);
        let views = support::views(&world.rig, &Session::GOOD, &mut random);
        let head = Fit::<2>::new(&views, &board(), support::SIZE, LensModel::Brown4).expect("a head");
        let covariance = head.covariance();
        let rows = covariance.matrix.row_iter().map(|row| row.iter().copied().collect()).collect();
        let covariance = ParameterCovariance { names: covariance.names.clone(), rows };
        let rig = head.rig().expect("a head");
        let covariance = CalibrationCovariance::new(&rig, &covariance).expect("of a head");
        let stops = world.visit(&GOOD, &mut random);
        let given = Given { rig: &rig, rig_covariance: None, board: &board(), robot: RobotSigma::default() };
        left_out.add(seed, &HandEyeFit::new(&stops, &given).expect("a fit"), &world.poses());
        let given = Given { rig_covariance: Some(&covariance), ..given };
        let fit = HandEyeFit::new(&stops, &given).expect("a fit");
        counted.add(seed, &fit, &world.poses());
        let error_m = world.point_error_m(&rig, &fit.flange_from_cam_left(), DISTANCE_M);
        points_mm.push(error_m * 1e3);
        squares += (error_m / fit.hand_error_m(DISTANCE_M)).powi(2) / f64::from(rigs_of_arm());
    }
    let [median, p95] = median_and_p95(&points_mm);
    println!(
        "a point 500 mm ahead, on the flange: median {median:.3}, p95 {p95:.3} mm; mean square over the stated variance {squares:.2}"
    );
    assert!((0.5..1.8).contains(&squares), "{squares}");
    counted.tell("stereo rigs calibrated from 15 views, errors included", &["flange_from_cam_left", "base_from_board"]);
    println!("  without: {:.1} % within one stated sigma", 100.0 * left_out.share());
    assert!((counted.share() - 0.683).abs() <= share_tolerance(rigs_of_arm(), 40), "{}", counted.share());
    assert!(counted.share() > left_out.share() + 0.05, "{}", left_out.share());
    let [mm, deg] = counted.of(0);
    assert!(mm[0] <= sweep(0.6, 0.45) && deg[0] <= 0.07, "{mm:?} mm, {deg:?} deg");
    assert!(counted.refused <= 1, "{}", counted.refused);
}

/// Results of OpenCV's five methods for the same stops (tests/data/hand_eye_by_opencv.py).
const OPENCV: &str = include_str!("data/opencv_4_14_hand_eye.csv");

#[test]
fn opencv_is_farther_from_the_truth_on_the_same_stops() {
    let truths: Vec<_> = (0..RIGS).map(|seed| visited(seed, &GOOD)).collect();
    let mut theirs: std::collections::BTreeMap<&str, Vec<[f64; 2]>> = std::collections::BTreeMap::new();
    for line in OPENCV.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let [rig, method, numbers @ ..] = &fields[..] else { panic!("{line}") };
        let numbers: Vec<f64> = numbers.iter().map(|number| number.parse().expect(line)).collect();
        let [rx, ry, rz, x, y, z] = numbers[..] else { panic!("{line}") };
        let found = Isometry3::from_parts(Vector3::new(x, y, z).into(), so3::exp(&Vector3::new(rx, ry, rz)));
        let truth = &truths[rig.parse::<usize>().expect(line)].0.flange_from_cam_left;
        theirs.entry(method).or_default().push(apart(&found, truth));
    }
    let of = |errors: &[[f64; 2]]| {
        [0, 1].map(|which| median_and_p95(&errors.iter().map(|error| error[which]).collect::<Vec<_>>()))
    };
    let tell = |name: &str, [mm, deg]: [[f64; 2]; 2]| {
        println!("{name:<10} median {:.3} mm, {:.4} deg; p95 {:.3} mm, {:.4} deg", mm[0], deg[0], mm[1], deg[1]);
    };
    let ours: Vec<[f64; 2]> = truths
        .iter()
        .map(|(world, stops)| {
            let fit = fit(stops, &world.rig).expect("a fit");
            apart(fit.flange_from_cam_left().isometry(), &world.flange_from_cam_left)
        })
        .collect();
    tell("ours", of(&ours));
    assert_eq!(theirs.len(), 5);
    for (method, errors) in &theirs {
        assert_eq!(errors.len(), RIGS as usize, "{method}");
        tell(method, of(errors));
        for which in [0, 1] {
            let (ours, theirs) = (of(&ours)[which][0], of(errors)[which][0]);
            assert!(ours < theirs, "{method}: {ours} and {theirs}");
        }
    }
}

#[test]
fn stops_that_were_recorded_while_moving_are_found() {
    for moving in [1, 4] {
        let (mut found, mut wrong) = (0, 0);
        let mut errors = Vec::new();
        for seed in 0..rigs() {
            let (world, stops) = visited(seed, &Visit { moving, ..GOOD });
            let fit = fit(&stops, &world.rig).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
            errors.push(apart(fit.flange_from_cam_left().isometry(), &world.flange_from_cam_left)[0]);
            let is_moving = |name: &str| {
                let index: usize = name.parse().expect("a number");
                index % (15 / moving) == 2 && index / (15 / moving) < moving
            };
            let rejected: Vec<_> = fit.rejected().collect();
            found += rejected.iter().filter(|stop| is_moving(&stop.name)).count();
            wrong += rejected.iter().filter(|stop| !is_moving(&stop.name)).count();
            for stop in rejected.iter().filter(|stop| is_moving(&stop.name)) {
                assert!((stop.left_out_mm - 5.0).abs() < 2.0, "{stop:?}");
            }
        }
        let [median_mm, p95_mm] = median_and_p95(&errors);
        println!(
            "{moving} of 15 stops with 5 mm error: {found} of {} found, {wrong} good stops rejected; errors: median {median_mm:.3}, p95 {p95_mm:.3} mm",
            moving * rigs() as usize
        );
        assert_eq!(found, moving * rigs() as usize);
        assert!(wrong <= 5, "{wrong}");
        assert!(median_mm <= 0.35, "{median_mm}");
    }
}

#[test]
fn wrong_squares_are_refused_and_named() {
    // Wrong square size in this calibration only, or in the stereo calibration as well, which makes its baseline wrong too.
    for both in [false, true] {
        for seed in 0..rigs() {
            let (world, stops) = visited(seed, &Visit { squares: 1.01, ..GOOD });
            let rig = &world.rig;
            let shift_m = rig.cam_right_from_cam_left().translation_m() / 1.01;
            let turn = rig.cam_right_from_cam_left().rotation();
            let small = StereoRig::new(*rig.left(), *rig.right(), pb3dp_geometry::Pose::from_parts(shift_m, turn));
            let small = small.expect("a head");
            let fit =
                fit(&stops, if both { &small } else { rig }).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
            let verdicts = Limits::of_hand_eye().judge_hand_eye(&fit, DISTANCE_M);
            let scale = verdicts.iter().find(|v| v.gate.key == SCALE.key).expect("judged");
            let scale_text = scale.to_string();
            if seed < 2 {
                println!("{scale_text}\n{:?}", fit.scales);
            }
            assert!(
                scale.grade() == Grade::Refused && scale_text.contains("measure the squares"),
                "seed {seed}: {scale_text}"
            );
            assert_eq!(scale_text.contains("calibrate the stereo rig"), both, "seed {seed}: {scale_text}");
        }
    }
}

/// Why a calibration is refused, as one word.
fn reason(fit: Result<HandEyeFit, HandEyeError>) -> String {
    match fit {
        Err(error) => format!("{error:?}").split([' ', '{']).next().unwrap_or_default().to_owned(),
        Ok(fit) => format!("{:?}", refused(&fit).iter().map(|(gate, _)| *gate).collect::<Vec<_>>()),
    }
}

#[test]
fn a_board_that_was_moved_and_the_wrong_robot_are_refused() {
    let mut reasons = std::collections::BTreeMap::<String, usize>::new();
    for seed in 0..rigs_of_arm() {
        let (world, stops) = visited(seed, &Visit { board_moved_m: 0.01, ..GOOD });
        let reason = reason(fit(&stops, &world.rig));
        assert_ne!(reason, "[]", "seed {seed}");
        *reasons.entry(format!("board moved: {reason}")).or_default() += 1;
    }
    for seed in 0..10 {
        let mut random = Random::new(6000 + seed);
        let arm = JointWorld::new(1e-4, &mut random).taken_for_the_first_generation();
        let reason = reason(fit(&arm.visit(&GOOD, &mut random), &arm.world.rig));
        assert_ne!(reason, "[]", "seed {seed}");
        *reasons.entry(format!("other robot: {reason}")).or_default() += 1;
    }
    println!("{reasons:#?}");
}

#[test]
fn turns_about_one_axis_are_refused_and_named() {
    let mut reasons = std::collections::BTreeMap::<String, usize>::new();
    for seed in 0..rigs() {
        let (world, stops) = visited(seed, &Visit { one_axis: true, ..GOOD });
        let reason = match fit(&stops, &world.rig) {
            Err(error @ (HandEyeError::Axes { .. } | HandEyeError::Undetermined { .. })) => {
                assert!(error.to_string().contains("two axes"), "{error}");
                format!("{error:?}").split([' ', '{']).next().unwrap_or_default().to_owned()
            }
            Err(error) => panic!("seed {seed}: {error}"),
            Ok(fit) => {
                let refused = refused(&fit);
                assert!(refused.iter().any(|(gate, _)| *gate == ROTATION_SPREAD.key), "seed {seed}: {refused:?}");
                "RotationSpread".to_owned()
            }
        };
        *reasons.entry(reason).or_default() += 1;
    }
    println!("{reasons:?}");
}
