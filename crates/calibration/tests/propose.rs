//! Proposed poses: the whole board stays in both images despite uncertain inputs, and the poses allow a stereo calibration.

use nalgebra::{Isometry3, Vector3};
use pb3dp_calibration::fit::View;
use pb3dp_calibration::gates::{COVERAGE, Grade, Limits};
use pb3dp_calibration::hand_eye::propose::{ProposalRequest, ProposeError, propose};
use pb3dp_calibration::held_out::choose;
use pb3dp_calibration::lens::LensModel;
use pb3dp_calibration::quality::Quality;
use pb3dp_geometry::{Pose, StereoRig, so3};

use crate::arm::{GOOD, World};
use crate::support::{Random, SIZE, board, with_focal};

const RIGS: u32 = 20;
const REQUEST: ProposalRequest = ProposalRequest {
    count: 18,
    distance_m: 0.5,
    guess_error_m: 0.01,
    guess_error_rad: 3.0 * std::f64::consts::PI / 180.0,
    focal_error: 0.02,
};

/// The board approximately in the middle of the left image.
fn first_look(random: &mut Random, distance_m: f64) -> Isometry3<f64> {
    let middle = board().corner_in_board(8, 5).coords * 0.5;
    let at = Vector3::new(random.between(0.02, 0.07), random.between(-0.03, 0.03), distance_m);
    let turn = so3::exp(&Vector3::from_fn(|_, _| random.between(-0.2, 0.2)));
    Isometry3::from_parts(at.into(), turn) * Isometry3::translation(-middle.x, -middle.y, 0.0)
}

/// The stereo rig with another focal length.
fn rig_with_focal(rig: &StereoRig, factor: f64) -> StereoRig {
    let [left, right] = [rig.left(), rig.right()].map(|camera| with_focal(camera, factor));
    StereoRig::new(left, right, *rig.cam_right_from_cam_left()).expect("a head")
}

/// A uniformly distributed direction.
fn direction(random: &mut Random) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.normal()).normalize()
}

#[test]
fn the_board_stays_whole_and_the_views_calibrate_the_head() {
    let (mut whole, mut all) = (0, 0);
    let mut coverages = Vec::new();
    let mut refused = 0;
    for seed in 0..RIGS {
        let mut random = Random::new(4000 + seed);
        let world = World::in_room(&mut random);
        // The assumed values have the maximum allowed errors.
        let factor = if seed % 2 == 0 { 1.02 } else { 1.0 / 1.02 };
        let believed = rig_with_focal(&world.rig, factor);
        let (turn, shift) =
            (direction(&mut random) * REQUEST.guess_error_rad, direction(&mut random) * REQUEST.guess_error_m);
        let error = Isometry3::from_parts(shift.into(), so3::exp(&turn));
        let first = first_look(&mut random, 0.55);
        let mut first_believed = first;
        first_believed.translation.vector *= factor;
        let views = propose(&believed, &board(), &Pose::from_isometry(first_believed), &REQUEST)
            .unwrap_or_else(|error| panic!("seed {seed}: {error}"));
        assert_eq!(views.cam_left_from_board.len(), REQUEST.count);
        let mut detected_views = Vec::new();
        for (index, view) in views.cam_left_from_board.iter().enumerate() {
            let motion = error * (view.isometry() * first_believed.inverse()) * error.inverse();
            let sightings = world.sightings(&(motion * first), &GOOD, &mut random);
            detected_views.extend(sightings.map(|sightings| View { name: format!("{index:02}"), sightings }));
        }
        (whole, all) = (whole + detected_views.len(), all + REQUEST.count);
        let chosen = choose(&detected_views, &board(), SIZE, &[LensModel::Brown4]).expect("a calibration");
        let quality = Quality::of_stereo(&chosen, &detected_views, SIZE, 0.5).expect("judged");
        let verdicts = Limits::of_cameras().judge_cameras(&quality);
        let bad: Vec<_> =
            verdicts.iter().filter(|v| v.grade() != Grade::Good).map(|v| (v.gate.key, v.measured)).collect();
        println!(
            "seed {seed}, focal length {:.0}: coverage predicted {:.2?}, measured {:.2}, tilt {:.0} deg; not good: {bad:?}",
            world.rig.left().pinhole().fx,
            views.coverage,
            quality.coverage,
            quality.tilt_deg
        );
        coverages.push(quality.coverage);
        assert!(quality.tilt_deg >= 20.0, "seed {seed}: {}", quality.tilt_deg);
        refused += usize::from(verdicts.iter().any(|v| v.grade() == Grade::Refused && v.gate != COVERAGE));
    }
    coverages.sort_by(f64::total_cmp);
    println!(
        "{whole} of {all} views whole; coverage: median {:.2}, least {:.2}",
        coverages[coverages.len() / 2],
        coverages[0]
    );
    assert!(whole as f64 >= 0.98 * all as f64, "{whole} of {all}");
    assert_eq!(refused, 0);
}

#[test]
fn the_way_is_short_and_turns_about_both_axes() {
    let mut random = Random::new(17);
    let world = World::in_room(&mut random);
    let first = first_look(&mut random, 0.5);
    let views = propose(&world.rig, &board(), &Pose::from_isometry(first), &REQUEST).expect("views");
    let poses: Vec<_> = views.cam_left_from_board.iter().map(|view| *view.isometry()).collect();
    let turn = |a: &Isometry3<f64>, b: &Isometry3<f64>| a.rotation.angle_to(&b.rotation).to_degrees();
    let way: f64 = poses.windows(2).map(|pair| turn(&pair[0], &pair[1])).sum::<f64>() + turn(&first, &poses[0]);
    // Compared with an order given by a hash.
    let mut shuffled = poses.clone();
    for index in 0..shuffled.len() {
        let other = random.between(0.0, shuffled.len() as f64) as usize;
        shuffled.swap(index, other);
    }
    let other: f64 = shuffled.windows(2).map(|pair| turn(&pair[0], &pair[1])).sum();
    println!("rotation along the path: {way:.0} deg, in another order {other:.0} deg");
    assert!(way < 0.8 * other, "{way} and {other}");
    let mut spread = nalgebra::Matrix3::zeros();
    for pose in &poses {
        let turn = so3::log(&pose.rotation).map(f64::to_degrees);
        spread += turn * turn.transpose() / poses.len() as f64;
    }
    let mut axes: Vec<f64> = spread.symmetric_eigenvalues().iter().map(|square| square.sqrt()).collect();
    axes.sort_by(f64::total_cmp);
    println!("rotations about three axes, degrees rms: {axes:.1?}");
    assert!(axes[0] > 5.0 && axes[1] > 10.0, "{axes:?}");
}

#[test]
fn a_board_that_is_too_near_is_refused_with_numbers() {
    let mut random = Random::new(23);
    let world = World::in_room(&mut random);
    let first = first_look(&mut random, 0.5);
    let request = ProposalRequest { distance_m: 0.15, ..REQUEST };
    let error = propose(&world.rig, &board(), &Pose::from_isometry(first), &request).expect_err("too near");
    assert!(matches!(error, ProposeError::TooFew { found: 0, wanted: 18, .. }), "{error:?}");
    assert!(error.to_string().contains("150 mm") && error.to_string().contains("--distance"), "{error}");
}
