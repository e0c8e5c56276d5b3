//! Comparison of two calibrations, and lengths, on simulated stereo rigs with exact ground truth.

use nalgebra::{Isometry3, Point3, Vector3};
use pb3dp_calibration::board::Chessboard;
use pb3dp_calibration::fit::Fit;
use pb3dp_calibration::gates::{Grade, Limits};
use pb3dp_calibration::lens::LensModel;
use pb3dp_calibration::verify::against::{Known, compare};
use pb3dp_calibration::verify::lens::decide_lens;
use pb3dp_calibration::verify::limits::{DIFFERENCE, SIGMAS};
use pb3dp_calibration::verify::touch::{Touch, touched};
use pb3dp_calibration::verify::{check, corner_in_cam_left, depth_sigma_m, length_ratio};
use pb3dp_geometry::{Camera, Distortion, Pose, StereoRig, so3};
use pb3dp_record::calibration_files::{CalibrationFormat, StereoCalibration};

use crate::support::{Random, SIZE, Session, board, rig, views};

fn calibrated(truth: &StereoRig, random: &mut Random) -> Known {
    let views = views(truth, &Session::GOOD, random);
    let fit = Fit::<2>::new(&views, &board(), SIZE, LensModel::Brown4).expect("a fit");
    let covariance = fit.covariance();
    Known { rig: fit.rig().expect("a head"), names: covariance.names.clone(), covariance: covariance.matrix.clone() }
}

/// The right camera rotated by a tenth of a degree about its vertical axis.
fn touched_head(rig: &StereoRig) -> StereoRig {
    let turn = Pose::from_parts(Vector3::zeros(), so3::exp(&Vector3::new(0.0, 0.1_f64.to_radians(), 0.0)));
    StereoRig::new(*rig.left(), *rig.right(), turn * *rig.cam_right_from_cam_left()).expect("a head")
}

#[test]
fn views_of_a_board_decide_an_unstated_lens_model() {
    let mut random = Random::new(4100);
    let truth = rig(&mut random);
    let views = views(&truth, &Session::GOOD, &mut random);
    let of_fisheye = |camera: &Camera| {
        let Distortion::BrownConrady5 { coefficients: [k1, k2, p1, p2, _] } = *camera.distortion() else { panic!() };
        let distortion = Distortion::Equidistant { coefficients: [k1, k2, p1, p2] };
        Camera::new(camera.size(), *camera.pinhole(), distortion).expect("a camera")
    };
    let (left, right) = (of_fisheye(truth.left()), of_fisheye(truth.right()));
    let other = StereoRig::new(left, right, *truth.cam_right_from_cam_left()).expect("a head");
    let decided = |rig: StereoRig, other_lens: StereoRig| {
        let open = StereoCalibration {
            rig,
            other_lens: Some(other_lens),
            format: CalibrationFormat::OpenCv,
            source: "stereo.yml".to_owned(),
            notes: Vec::new(),
            warnings: Vec::new(),
            not_measured: None,
            judgement: None,
        };
        decide_lens(open, &views, &board())
    };
    for (found, lens) in [(decided(truth, other), "Brown-Conrady"), (decided(other, truth), "equidistant")] {
        let found = found.expect("clear");
        assert_eq!((found.rig, found.other_lens), (truth, None));
        assert!(found.warnings[0].contains(&format!("no lens model: {lens}")), "{:?}", found.warnings);
    }
    let neither = decided(touched_head(&truth), touched_head(&other)).expect_err("neither").to_string();
    for part in ["the views of the board do not decide (reprojection errors of", "--calib-lens brown or --calib-lens"] {
        assert!(neither.contains(part), "{neither}");
    }
}

#[test]
fn two_calibrations_of_one_head_differ_by_chance_and_those_of_a_touched_one_do_not() {
    const HEADS: u32 = 30;
    let limits = Limits::of_checks();
    let (mut squares, mut refused) = (0.0, 0);
    for seed in 0..HEADS {
        let mut random = Random::new(4000 + seed);
        let truth = rig(&mut random);
        let [first, second] = [(); 2].map(|()| calibrated(&truth, &mut random));
        let sigmas = compare(&first, &second, 0.5).sigmas.expect("both say");
        squares += sigmas * sigmas;
        refused += u32::from(limits.judge(SIGMAS, sigmas).grade() == Grade::Refused);
        let after = calibrated(&touched_head(&truth), &mut random);
        let comparison = compare(&first, &after, 0.5);
        let touched = comparison.sigmas.expect("both say");
        assert_eq!(limits.judge(SIGMAS, touched).grade(), Grade::Refused, "seed {seed}: {touched}");
        let [depth_m, ..] = comparison.p95_m();
        assert_eq!(limits.judge(DIFFERENCE, depth_m * 1e3).grade(), Grade::Refused, "seed {seed}: {depth_m}");
    }
    let mean = squares / f64::from(HEADS);
    println!("same rig: mean square {mean:.2} of 1, {refused} of {HEADS} refused");
    assert!((0.7..1.4).contains(&mean) && refused == 0);
}

#[test]
fn a_point_moves_as_the_second_head_says() {
    let mut random = Random::new(77);
    let truth = rig(&mut random);
    let known = |rig: &StereoRig| Known { rig: *rig, names: Vec::new(), covariance: nalgebra::DMatrix::zeros(0, 0) };
    let same = compare(&known(&truth), &known(&truth), 0.6);
    assert!(same.p95_m().iter().all(|way| *way < 1e-9) && same.displacements.len() > 20 && same.sigmas.is_none());
    // A baseline that is 1 % longer puts everything 1 % farther away.
    let pose = truth.cam_right_from_cam_left();
    let longer = Pose::from_parts(pose.translation_m() * 1.01, pose.rotation());
    let longer = StereoRig::new(*truth.left(), *truth.right(), longer).expect("a head");
    let moved = compare(&known(&truth), &known(&longer), 0.6);
    for displacement in &moved.displacements {
        assert!((displacement.depth_m - 0.006).abs() < 1e-6, "{displacement:?}");
    }
}

#[test]
fn lengths_on_fresh_views_tell_the_scale_and_the_wrong_square() {
    let mut worst = 0.0_f64;
    for seed in 0..20 {
        let mut random = Random::new(5000 + seed);
        let truth = rig(&mut random);
        let known = calibrated(&truth, &mut random);
        let fresh = views(&truth, &Session::GOOD, &mut random);
        let good = check(&known.rig, &fresh, &board()).expect("checked").scale_at(0.5);
        worst = worst.max((good.scale - 1.0).abs());
        let typed = Chessboard::new(9, 6, 0.0255).expect("a board");
        let wrong = check(&known.rig, &fresh, &typed).expect("checked").scale_at(0.5);
        assert!((wrong.scale * 1.02 - good.scale).abs() < 1e-6, "seed {seed}: {wrong:?}, {good:?}");
        assert!(depth_sigma_m(&known, 0.5).is_some_and(|sigma_m| sigma_m < 0.003), "seed {seed}");
    }
    println!("worst scale of 20 rigs: {:.3} %", 100.0 * worst);
    assert!(worst < 0.003, "{worst}");
}

#[test]
fn touched_corners_are_where_the_cameras_say() {
    let mut random = Random::new(91);
    let truth = rig(&mut random);
    let session_views = views(&truth, &Session { corner_sigma_px: 0.0, ..Session::GOOD }, &mut random);
    // The board is stationary in the room, so each view has its own hand pose.
    let base_from_board = Isometry3::new(Vector3::new(0.5, -0.2, 0.1), Vector3::new(2.8, 0.3, -0.2));
    let corners = [[0, 0], [8, 1], [3, 5]];
    let poses: Vec<Isometry3<f64>> =
        session_views.iter().map(|view| base_from_board * board_from_cam_left(&truth, view)).collect();
    let touch = |corner: [u32; 2], off_m: f64| {
        let in_base_m = base_from_board * board().corner_in_board(corner[0], corner[1]) + Vector3::new(0.0, off_m, 0.0);
        Touch { board_corner: corner, in_base_m }
    };
    let touches = [touch(corners[0], 0.0), touch(corners[1], 0.004), touch(corners[2], 0.0)];
    let results = touched(&truth, &session_views, &poses, &touches).expect("seen");
    let errors_mm: Vec<f64> = results.iter().map(|result| result.error_m() * 1e3).collect();
    assert!(errors_mm[0] < 0.01 && (errors_mm[1] - 4.0).abs() < 0.01 && errors_mm[2] < 0.01, "{errors_mm:?}");
    assert!(touched(&truth, &session_views, &poses, &[touch([12, 0], 0.0)]).is_err());
}

/// The board frame from three triangulated corners: an independent computation, without the adjustment.
fn board_from_cam_left(rig: &StereoRig, view: &pb3dp_calibration::fit::View<2>) -> Isometry3<f64> {
    let [o, x, y]: [Point3<f64>; 3] =
        [[0, 0], [8, 0], [0, 5]].map(|corner| corner_in_cam_left(rig, view, corner).expect("seen"));
    let (x, z) = ((x - o).normalize(), (x - o).cross(&(y - o)).normalize());
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[x, z.cross(&x), z]));
    Isometry3::from_parts(o.coords.into(), rotation.into()).inverse()
}

#[test]
fn squares_that_were_typed_wrong_are_measured_by_the_head() {
    let mut random = Random::new(77);
    let truth = rig(&mut random);
    let views = views(&truth, &Session::GOOD, &mut random);
    let typed = Chessboard::new(9, 6, 0.020).expect("a board");
    let ratio =
        |board: &Chessboard| length_ratio(&truth, views.iter().map(|view| &view.sightings), board).expect("seen");
    assert!((ratio(&typed) - 1.25).abs() < 0.01 && (ratio(&board()) - 1.0).abs() < 0.01, "{}", ratio(&typed));
}
