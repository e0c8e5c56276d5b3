//! Runs without images: the whole loop with the true pose and stated noise instead of cameras and estimation.

use nalgebra::Vector3;
use pb3dp_cell::channels::Plan;
use pb3dp_cell::summary::{RunSummary, summarize};
use pb3dp_estimation::estimator::Method;
use pb3dp_servo::LawConfig;
use pb3dp_setup::setup::{Carrier, Leader, Setup};
use pb3dp_sim::geometric::{GeometricConfig, PoseSigma};
use pb3dp_sim::trajectory::{Channel, ExperimentAxes, MotionConfig, SineConfig};
use pb3dp_wiring::wire;

use crate::closed_loop::support::*;
use system_tests::watched::watched;

pub const QUIET: GeometricConfig = GeometricConfig {
    noise: PoseSigma { lateral_m: 0.0, depth_m: 0.0, tilt_rad: 0.0, about_normal_rad: 0.0 },
    lock: PoseSigma { lateral_m: 0.0, depth_m: 0.0, tilt_rad: 0.0, about_normal_rad: 0.0 },
    in_view_share_min: 0.5,
    turned_max_rad: 1.2,
    z_min_m: 0.35,
    z_max_m: 0.65,
    seed: 1,
};

const NOISY: GeometricConfig = GeometricConfig {
    noise: PoseSigma { lateral_m: 2e-5, depth_m: 1e-4, tilt_rad: 1e-3, about_normal_rad: 3e-4 },
    lock: PoseSigma { lateral_m: 0.0, depth_m: 2e-4, tilt_rad: 3e-3, about_normal_rad: 0.0 },
    ..QUIET
};

fn setup(config: GeometricConfig) -> Setup {
    Setup { leader: Leader::Geometric(config), ..whole_setup(Method::Direct) }
}

/// A target filter that treats the measurements as free of noise.
fn trusting(mut setup: Setup) -> Setup {
    if let LawConfig::FeedForward(law) = &mut setup.controller.law {
        law.target.measurement.orientation_sigma_min_rad = 1e-4;
    }
    setup
}

fn summary(setup: &Setup) -> RunSummary {
    let outcome = run(setup, None);
    summarize(&outcome.log, &outcome.plan)
}

#[test]
fn without_noise_the_hand_comes_to_rest_where_it_should_be() {
    let found = summary(&trusting(setup(QUIET)));
    assert!(found.without_images && found.rotation_about_normal_observed);
    assert_eq!(
        (found.frames_without_pose, found.channels.len(), found.methods[0].method.as_str()),
        (0, 6, "geometric")
    );
    for channel in &found.channels {
        // The remaining error is the end of the motion, and the resolution of the measured angles.
        let (mm, deg) = (channel.locked.hold_mm.unwrap(), channel.locked.hold_deg.unwrap());
        assert!(mm.max < 0.3 && deg.max < 0.05, "{channel:?}");
    }
    let lock = found.lock.unwrap();
    assert!(lock.hand_mm < 1e-6 && lock.tilt_deg < 1e-6, "{lock:?}");
    assert!(found.estimation_normal_deg.unwrap().p95 < 1e-6);
}

#[test]
fn the_error_of_the_lock_is_constant_and_reported() {
    let lock = PoseSigma { tilt_rad: 0.01, depth_m: 1e-3, ..PoseSigma::default() };
    let found = summary(&trusting(setup(GeometricConfig { lock, ..QUIET })));
    let lock_error = found.lock.unwrap();
    assert!(lock_error.hand_mm > 0.5 && lock_error.hand_mm < 40.0, "{lock_error:?}");
    let (locked, whole) = (found.locked.hold_mm.unwrap(), found.tracking_position_mm.unwrap());
    assert!(locked.max < 0.3, "relative to the initial lock the hand is at its desired pose: {locked:?}");
    assert!(whole.rms > 0.8 * lock_error.hand_mm, "before the true plane it is not: {whole:?}, {lock_error:?}");
}

#[test]
fn the_seed_decides_the_noise() {
    let mut setup = setup(NOISY);
    let trace = |setup: &Setup| {
        let mut log = run(setup, Some(6.0)).log;
        log.leading.frames.iter_mut().for_each(|frame| frame.latency_millis = 0.0);
        format!("{log:?}")
    };
    let first = trace(&setup);
    assert!(trace(&setup) == first, "the same seed gives the same run");
    setup.reseed(setup.seed + 1);
    assert!(trace(&setup) != first, "another seed gives another run");
}

#[test]
fn a_target_out_of_view_has_no_pose_and_the_hand_rests_until_it_is_back() {
    let mut setup = setup(NOISY);
    setup.experiment.carrier = Carrier::Nothing;
    let steps = steps_of(&mut setup);
    (steps.channels, steps.translation_m) = (vec![Channel::X], 0.6);
    (steps.move_s, steps.hold_s, steps.lead_in_s) = (0.0, 3.0, 1.0);
    let log = run(&setup, None).log;
    let at_s = |from: f64, to: f64| log.leading.frames.iter().filter(move |f| (from..to).contains(&f.t_s));
    assert!(at_s(0.0, 1.0).all(|f| f.status == "ok") && at_s(1.0, 4.0).all(|f| f.status == "lost"));
    assert!(at_s(4.0, 7.0).all(|f| f.status == "ok"), "the same target, found again");
    let (hand_mm, _) = ways_mm(&log, 2.5, 3.9);
    assert!(hand_mm.norm() < 0.1, "the hand moves {hand_mm} without a visible target");
    assert!(log.control.iter().any(|s| s.mode_name() == "lost" || s.mode_name() == "holding"));
}

#[test]
fn a_free_target_is_where_its_motion_says_and_the_second_arm_rests() {
    let mut setup = setup(QUIET);
    setup.experiment.carrier = Carrier::Nothing;
    let (amplitude, period_s) = (0.05, 4.0);
    let axes = ExperimentAxes::World;
    let sine = SineConfig { channel: Channel::Z, amplitude, period_s, periods: 1, lead_in_s: 1.0, axes };
    setup.experiment.motion = MotionConfig::Sine(sine);
    let (parts, _, tc) = watched(wire(&setup).unwrap());
    let log = pb3dp_cell::experiment::run(&setup, parts, None, None).unwrap().log;
    let start = at(&log, 0.0).world_from_target.translation_m();
    let there = at(&log, 1.0 + period_s + 1.0).world_from_target.translation_m();
    // A quarter of a period into the steady part; the sample is at most one control period late.
    assert!((there - start - Vector3::new(0.0, 0.0, amplitude)).norm() < 2e-5, "{}", there - start);
    let measured = tc.measured.lock().unwrap();
    let first = measured[0].position_rad;
    assert!(measured.iter().all(|state| state.position_rad == first), "the second arm does not move");
    let plan = Plan { motion: setup.experiment.motion.clone(), world_from_axes: nalgebra::UnitQuaternion::identity() };
    let channel = summarize(&log, &plan).channels[0].clone();
    assert!(channel.gain_db.unwrap().abs() < 3.0 && channel.phase_deg.unwrap() < 1.0, "{channel:?}");
}

#[test]
fn what_does_not_go_together_is_refused() {
    let geometric = setup(QUIET);
    let error = wire(&geometric)
        .and_then(|parts| {
            let folder = tempfile::tempdir()?;
            pb3dp_cell::experiment::run(&geometric, parts, None, Some(folder.path()))
        })
        .map(drop)
        .unwrap_err();
    assert!(format!("{error:#}").contains("--record: with estimator.method = \"geometric\""), "{error:#}");
    let mut with_images = whole_setup(Method::Direct);
    let parts = wire(&with_images).unwrap();
    with_images.leader = Leader::Geometric(QUIET);
    let error = pb3dp_cell::experiment::run(&with_images, parts, None, None).map(drop).unwrap_err();
    assert!(format!("{error:#}").contains("does not fit this camera"), "{error:#}");
}
