//! The hand tracks a visible target, keeps its limits, and holds without a confident pose.

use pb3dp_cell::experiment;
use pb3dp_cell::figures::TrackingError;
use pb3dp_cell::journal::Outcome;
use pb3dp_cell::log::RunLog;
use pb3dp_cell::summary::summarize;
use pb3dp_estimation::estimator::Method;
use pb3dp_hal_api::JointCommand;
use pb3dp_kinematics::DOF;
use pb3dp_setup::setup::ArmSetup;
use pb3dp_sim::targets::TargetConfig;
use pb3dp_sim::trajectory::Channel;
use pb3dp_wiring::wire;
use system_tests::watched::{Notes, watched};

use crate::closed_loop::support::*;

/// Largest error of the hand while holding, and in its motions along x and about y. Chosen: 1.5 times the values measured
/// with two seeds, and far less than the error of a hand that never moves.
struct Limits {
    rms_mm: f64,
    rms_deg: f64,
    max_mm: f64,
    max_deg: f64,
    way_x_mm: f64,
    way_ry_mm: f64,
}

#[test]
fn with_the_published_method_the_hand_follows_the_crab_and_both_arms_keep_their_limits() {
    let limits = Limits { rms_mm: 20.0, rms_deg: 2.0, max_mm: 26.0, max_deg: 3.0, way_x_mm: 18.0, way_ry_mm: 30.0 };
    let log = follow_the_crab(Method::Published, &limits);
    let without_pose = log.leading.frames.iter().filter(|frame| frame.depth_error_m.is_none()).count();
    let frames = log.leading.frames.len();
    assert!(without_pose * 20 < frames, "{without_pose} of {frames} frames without a pose");
}

/// The crab's shell is 10 mm high: the plane through it is not the true one, which causes most of the error while holding.
#[test]
fn with_the_direct_method_the_hand_follows_the_crab_and_both_arms_keep_their_limits() {
    let limits = Limits { rms_mm: 8.0, rms_deg: 1.0, max_mm: 9.0, max_deg: 1.2, way_x_mm: 1.0, way_ry_mm: 2.5 };
    let log = follow_the_crab(Method::Direct, &limits);
    assert!(log.leading.frames.iter().all(|frame| frame.status == "ok"), "no frame lost, no low confidence");
    assert!(log.leading.rotation_about_normal_observed);
}

/// A shell of 25 mm is far from any plane. Once the target was cut down to the front slope of the shell, 20 degrees off and with a standard
/// deviation of 0.05 degrees.
#[test]
fn on_a_steep_shell_the_first_pose_is_as_uncertain_as_its_plane() {
    let setup = changed_setup(&[("relief_mm = 10.0 ", "relief_mm = 25.0 ")]);
    let Outcome { log, plan, .. } = run(&setup, Some(0.4));
    let lock = summarize(&log, &plan).lock.unwrap();
    let sigma_deg = lock.tilt_sigma_deg.unwrap();
    assert!(sigma_deg > 0.5 && lock.tilt_deg < 3.0 * sigma_deg && lock.tilt_deg < 8.0, "{lock:?}");
}

/// Runs the experiment along x and about y, and checks the position of the hand.
fn follow_the_crab(method: Method, limits: &Limits) -> RunLog {
    let mut setup = quick_setup(method, Pixels::More, &[Channel::X, Channel::Ry]);
    // Tracked without lag, the rotation within one second demands 2.6 rad/s of E2 and 2.18 rad/s^2 of the elbow: refused.
    steps_of(&mut setup).move_s = 1.5;
    let (parts, vs, tc) = watched(wire(&setup).unwrap());
    let outcome = experiment::run(&setup, parts, None, None).unwrap();
    let log = &outcome.log;
    assert_eq!(log.marks.len(), 4);
    assert!(log.control.last().unwrap().t_s > 10.98 && log.leading.frames.len() > 325, "the run is complete");
    assert_eq!(log.pairs_lost, 0);
    for (number, mark) in log.marks.iter().enumerate() {
        let Errors { rms_mm, max_mm, rms_deg, max_deg } = errors(log, mark.at_s + 2.1, mark.at_s + 2.5);
        let what = format!(
            "{method}, hold {number}: rms {rms_mm:.1} mm, {rms_deg:.1} deg; max {max_mm:.1} mm, {max_deg:.1} deg"
        );
        assert!(rms_mm < limits.rms_mm && rms_deg < limits.rms_deg, "{what}");
        assert!(max_mm < limits.max_mm && max_deg < limits.max_deg, "{what}");
    }
    let (hand_mm, wanted_mm) = ways_mm(log, 0.9, 3.45);
    assert!((wanted_mm.norm() - 100.0).abs() < 2.0, "the target moved 100 mm: {wanted_mm}");
    assert!((hand_mm - wanted_mm).norm() < limits.way_x_mm, "the hand moved {hand_mm}, desired {wanted_mm}");
    // The rotation of 20 degrees about y moves the desired hand position by 2 x 500 mm x sin 10 degrees.
    let (hand_mm, wanted_mm) = ways_mm(log, 5.95, 8.45);
    assert!((wanted_mm.norm() - 173.6).abs() < 5.0, "{wanted_mm}");
    assert!((hand_mm - wanted_mm).norm() < limits.way_ry_mm, "the hand moved {hand_mm}, desired {wanted_mm}");
    assert!(log.control.iter().all(|sample| sample.smallest_singular_value > 0.15));
    keeps_its_speeds("vs-robot", &setup.rig.arms.vs, &vs);
    keeps_its_speeds("tc-robot", &setup.rig.arms.tc, &tc);
    outcome.log
}

/// Speeds as the arm tells them, and as its angles tell them.
fn keeps_its_speeds(name: &str, arm: &ArmSetup, notes: &Notes) {
    let measured = notes.measured.lock().unwrap();
    let allowed = arm.limits.velocity_max_rad_per_s();
    assert!(measured.len() > 1000);
    let mut fastest: f64 = 0.0;
    // The first two samples are of one moment: one for the start, one of the first control step.
    for pair in measured.windows(2).filter(|pair| pair[1].at > pair[0].at) {
        let seconds = pair[1].at.seconds_since(pair[0].at);
        for joint in 0..DOF {
            let by_angle = (pair[1].position_rad[joint] - pair[0].position_rad[joint]) / seconds;
            let commanded = pair[1].velocity_rad_per_s[joint];
            // One count of the resolver in one control period is 0.8 mrad/s.
            assert!(by_angle.abs() < allowed[joint] + 2e-3, "{name}, joint {joint}: {by_angle} of {}", allowed[joint]);
            assert!(
                commanded.abs() <= allowed[joint] + 1e-9,
                "{name}, joint {joint}: {commanded} of {}",
                allowed[joint]
            );
            fastest = fastest.max(commanded.abs() / allowed[joint]);
        }
    }
    assert!(fastest > 0.4, "{name} moved: {fastest} of the limit");
}

#[test]
fn with_the_published_method_the_card_is_followed_as_well() {
    let mut setup = quick_setup(Method::Published, Pixels::Few, &[Channel::X]);
    setup.world.as_mut().unwrap().scene.target = TargetConfig::card();
    let log = run(&setup, Some(3.0)).log;
    let Errors { rms_mm, rms_deg, .. } = errors(&log, 2.6, 3.0);
    assert!(rms_mm < 45.0 && rms_deg < 6.0, "the error of the hand is {rms_mm:.1} mm and {rms_deg:.1} degrees");
    let (hand_mm, wanted_mm) = ways_mm(&log, 0.9, 2.95);
    // With the seed of the file 36 mm, with another seed 3 mm; a hand that never moves is 100 mm away.
    assert!((hand_mm - wanted_mm).norm() < 45.0, "moved {hand_mm}, desired {wanted_mm}");
}

/// Grey is no worse than colour, and the rotation about the normal is tracked like any other.
#[test]
fn with_the_direct_method_card_and_grey_box_are_followed_to_a_millimetre() {
    for target in [TargetConfig::card(), TargetConfig::grey_box()] {
        let mut setup = quick_setup(Method::Direct, Pixels::Few, &[Channel::Rz]);
        setup.world.as_mut().unwrap().scene.target = target;
        let log = run(&setup, Some(3.0)).log;
        let Errors { rms_mm, rms_deg, .. } = errors(&log, 2.7, 3.0);
        let last = TrackingError::of(log.control.last().unwrap());
        let about_deg = last.orientation_rad.to_degrees();
        let what = format!("{target:?}: error {rms_mm:.2} mm, tilt {rms_deg:.2}, total {about_deg:.2} degrees");
        assert!(rms_mm < 0.8 && rms_deg < 0.1 && about_deg < 0.12, "{what}");
        assert!(log.leading.frames.iter().all(|frame| frame.status == "ok"), "{what}");
        let turned =
            log.control[0].world_from_hand.rotation().angle_to(&log.control.last().unwrap().world_from_hand.rotation());
        assert!((turned.to_degrees() - 20.0).abs() < 0.3, "the hand rotated by {} degrees", turned.to_degrees());
    }
}

/// The potato's hue is close to that of the sand behind it, and the potato is not a plane: the published method has no
/// confident pose, and the hand holds.
#[test]
fn with_the_published_method_the_hand_rests_before_the_potato() {
    let (log, sure) = before_the_potato(Method::Published);
    assert_eq!(sure, 0);
    let (hand_mm, wanted_mm) = ways_mm(&log, 0.0, 2.95);
    assert!(hand_mm.norm() < 1e-9, "moved by {hand_mm} without a confident estimate");
    assert!(wanted_mm.norm() > 80.0, "the target itself did move: {wanted_mm}");
}

/// The error at first is that of the plane that the direct method fits to a round target; the motion from there is the target's.
#[test]
fn with_the_direct_method_the_potato_is_followed() {
    let (log, sure) = before_the_potato(Method::Direct);
    assert_eq!(sure, log.leading.frames.len());
    for frame in &log.leading.frames {
        let off_mm = frame.depth_error_m.unwrap().abs() * 1e3;
        assert!(off_mm < 10.0, "confident at {:.2} s with a depth error of {off_mm:.1} mm", frame.t_s);
    }
    let (hand_mm, wanted_mm) = ways_mm(&log, 0.9, 2.95);
    assert!((wanted_mm.norm() - 100.0).abs() < 2.0, "the target moved 100 mm: {wanted_mm}");
    let apart_mm = (hand_mm - wanted_mm).norm();
    // Measured: 45 mm, mostly along the camera axis. A hand that never moves is 100 mm away.
    assert!(apart_mm < 65.0, "the hand moved {hand_mm}, desired {wanted_mm}");
}

/// A run with the potato, and its number of frames with a confident pose.
fn before_the_potato(method: Method) -> (RunLog, usize) {
    let mut setup = quick_setup(method, Pixels::Few, &[Channel::X]);
    setup.world.as_mut().unwrap().scene.target = TargetConfig::potato();
    let log = run(&setup, Some(3.0)).log;
    assert!(log.leading.frames.len() > 85, "{}", log.leading.frames.len());
    let sure = log.leading.frames.iter().filter(|frame| ["ok", "weak-tilt"].contains(&frame.status.as_str())).count();
    (log, sure)
}

/// The hand does not move. While the box is in the marked region, no frame has a pose; later that region may show some of
/// the coloured room, but never with confidence.
#[test]
fn with_the_published_method_the_hand_rests_before_a_grey_box() {
    let mut setup = quick_setup(Method::Published, Pixels::Few, &[Channel::X]);
    setup.world.as_mut().unwrap().scene.target = TargetConfig::grey_box();
    let (parts, vs, _) = watched(wire(&setup).unwrap());
    let log = experiment::run(&setup, parts, Some(2.2), None).unwrap().log;
    assert!(log.leading.frames.len() > 60);
    for frame in &log.leading.frames {
        assert!(!["ok", "weak-tilt"].contains(&frame.status.as_str()), "{} at {} s", frame.status, frame.t_s);
        if frame.t_s < steps_of(&mut setup).lead_in_s {
            assert!(["not-observable", "lost"].contains(&frame.status.as_str()), "{} at {} s", frame.status, frame.t_s);
            assert_eq!(frame.depth_error_m, None, "a pose at {} s", frame.t_s);
        }
    }
    assert_eq!(log.leading.frames[0].status, "not-observable");
    assert!(vs.commands.lock().unwrap().iter().all(|command| *command == JointCommand::Hold));
    let first = log.control[0].world_from_hand;
    assert!(log.control.iter().all(|sample| sample.world_from_hand == first), "the hand must not move at all");
    let target = |i: usize| log.control[i].world_from_target.translation_m();
    assert!((target(log.control.len() - 1) - target(0)).norm() > 0.08, "the target itself did move");
}
