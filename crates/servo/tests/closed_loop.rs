//! Closed loop with joints and camera, without images: the convergence matches the gains, the lag matches theory, and the limits
//! are kept.

use crate::common;
use crate::common::{Cell, IDEAL, Plant, config, published, rotation, with_filter};
use nalgebra::Vector3;
use pb3dp_computing::rng::SplitMix64;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{Base, Model};
use pb3dp_kinematics::JointVector;
use pb3dp_servo::{
    Command, ControllerConfig, Gains, HoldReason, HybridConfig, ImageBasedConfig, LawConfig, Limitation, Mode,
    TargetFilterConfig,
};
use proptest::prelude::*;

#[test]
fn the_hand_goes_exactly_to_its_place_with_the_rates_of_the_gains() {
    let mut cell = Cell::new(config(), IDEAL, 0.066);
    let turn = rotation(0.1, -0.2, 0.15);
    let target = cell.target_for_hand_moved(Vector3::new(0.04, -0.06, 0.05), turn);
    let mut first = cell.step(&target);
    while first.position_error_m.is_none() {
        assert_eq!((first.mode, first.command), (Mode::Idle, Command::Hold));
        first = cell.step(&target);
    }
    let (e0, angle0) = (first.position_error_m.unwrap(), first.orientation_error_rad.unwrap());
    assert!((e0 - Vector3::new(0.04f64, -0.06, 0.05).norm()).abs() < 1e-9, "{e0}");
    assert!((angle0 - turn.angle()).abs() < 1e-9, "{angle0}");
    for step in 1..=2000 {
        let now = cell.step(&target);
        let t = f64::from(step) * cell.step_s;
        // r' = -K r, and angle' = -K_o sin(angle / 2), whose solution is tan(angle / 4) ~ exp(-K_o t / 2).
        let expected = e0 * (-3.0 * t).exp();
        let expected_angle = 4.0 * ((0.25 * angle0).tan() * (-3.0 * t).exp()).atan();
        if t < 1.0 {
            let (e, angle) = (now.position_error_m.unwrap(), now.orientation_error_rad.unwrap());
            assert!((e / expected - 1.0).abs() < 0.02, "{e} m, not {expected} m at {t} s");
            assert!((angle / expected_angle - 1.0).abs() < 0.02, "{angle} rad, not {expected_angle} rad at {t} s");
        }
    }
    let hand_from_model = cell.base_from_hand().inverse() * target;
    let wanted = cell.config.model_from_hand_desired.inverse();
    assert!((hand_from_model.translation_m() - wanted.translation_m()).norm() < 1e-5, "{hand_from_model:?}");
    assert!(hand_from_model.rotation().angle_to(&wanted.rotation()) < 1e-5, "{hand_from_model:?}");
}

/// Largest overshoot of the hand after a step of the target, as a share of the initial error.
fn overshoot(position_per_s: f64, plant: Plant, latency_s: f64) -> f64 {
    let gains = Gains { position_per_s, velocity: 0.0, orientation_per_s: 2.0 * position_per_s, angular_velocity: 0.0 };
    let law = LawConfig::Published(published(gains));
    let mut cell = Cell::new(ControllerConfig { law, ..config() }, plant, latency_s);
    let by = Vector3::new(0.02, -0.01, 0.015);
    let target = cell.target_for_hand_moved(by, rotation(0.0, 0.0, 0.0));
    let begin = cell.base_from_hand().translation_m();
    let mut farthest = 0.0f64;
    for _ in 0..2000 {
        cell.step(&target);
        let gone = (cell.base_from_hand().translation_m() - begin).dot(&by) / by.norm_squared();
        farthest = farthest.max(gone);
    }
    farthest - 1.0
}

#[test]
fn no_overshoot_up_to_the_bound_with_lag_and_delay_and_much_beyond_it() {
    let plant = Plant { delay_steps: 33, lag_s: 0.03 };
    let bound = Gains::without_overshoot(0.096);
    assert!((bound.position_per_s - 3.8320).abs() < 1e-3 && bound.orientation_per_s == 2.0 * bound.position_per_s);
    assert!(overshoot(bound.position_per_s, plant, 0.066) < 0.005);
    let far_beyond = overshoot(4.0 * bound.position_per_s, plant, 0.066);
    assert!(far_beyond > 0.2, "{far_beyond}");
}

#[test]
fn the_delay_of_the_camera_is_outside_the_loop() {
    // 20 1/s at 150 ms would be unstable (above pi/2) if the observation were transformed with the current joints.
    assert!(overshoot(20.0, IDEAL, 0.15) < 0.005);
}

#[test]
fn a_target_of_constant_speed_is_trailed_by_the_inverse_gain_plus_the_age_of_the_images() {
    for velocity in [0.0, 0.5] {
        let gains = Gains { position_per_s: 4.0, velocity, orientation_per_s: 8.0, angular_velocity: velocity };
        let law = LawConfig::Published(published(gains));
        let mut cell = Cell::new(ControllerConfig { law, ..config() }, IDEAL, 0.066);
        let speed = Vector3::new(0.02, 0.03, -0.01);
        let (mut sum, mut count) = (0.0, 0);
        for _ in 0..2500 {
            let elapsed_s = cell.time_s - 5.0;
            let target = target_moved(&cell, speed * elapsed_s);
            cell.step(&target);
            if elapsed_s > 3.0 {
                let desired = target * cell.config.model_from_hand_desired;
                let behind = desired.translation_m() - cell.base_from_hand().translation_m();
                sum += behind.dot(&speed) / speed.norm_squared();
                count += 1;
            }
        }
        // A frame is 66 to 99 ms old while it is used: 83 ms on average.
        let lag_s = sum / f64::from(count);
        assert!((lag_s - (0.25 + 0.083)).abs() < 0.006, "K_V {velocity}: lag {lag_s} s");
    }
}

/// Target pose for the start pose of the hand, shifted by `by`.
fn target_moved(cell: &Cell, by: Vector3<f64>) -> Pose<Base, Model> {
    let hand = cell.chain.forward(&common::START_RAD.into()) * cell.config.flange_from_hand;
    let model = hand * cell.config.model_from_hand_desired.inverse();
    Pose::from_parts(model.translation_m() + by, model.rotation())
}

#[test]
fn smoothing_quiets_the_hand_before_a_target_with_jitter() {
    let wander = |time_constant_s: f64| {
        let config = with_filter(config(), |filter| {
            filter.position_time_constant_s = time_constant_s;
            filter.orientation_time_constant_s = time_constant_s;
        });
        let mut cell = Cell::new(config, IDEAL, 0.066);
        cell.step_s = 0.01;
        let target = target_moved(&cell, Vector3::zeros());
        let begin = cell.base_from_hand().translation_m();
        let (mut random, mut sum) = (SplitMix64::new(1), 0.0);
        let mut noise = move || random.between(-0.05, 0.05);
        for step in 0..8500 {
            // Uniform, 1.7 degrees rms, about x and y of the target, where the published method is least accurate.
            let turned = target.rotation() * rotation(noise(), noise(), 0.0);
            cell.step(&Pose::from_parts(target.translation_m(), turned));
            if step >= 500 {
                sum += (cell.base_from_hand().translation_m() - begin).norm_squared();
            }
        }
        (sum / 8000.0f64).sqrt()
    };
    let (raw, smooth) = (wander(0.0), wander(0.5));
    // White jitter of sigma at an interval h after a low-pass of T has sigma sqrt(h / 2 T); a second low-pass of tau reduces it
    // by sqrt(T / (T + tau)). Here sigma is 0.1/sqrt(12) rad about two axes at a lever of 0.5 m; T = 1/3 s.
    let expected = 0.1 / 6f64.sqrt() * 0.5 * (1.0f64 / 30.0 / (2.0 / 3.0)).sqrt();
    assert!((raw / expected - 1.0).abs() < 0.15, "{raw}, expected {expected}");
    let quieter = (0.333f64 / 0.833).sqrt();
    assert!((smooth / raw / quieter - 1.0).abs() < 0.15, "{smooth} smoothed, {raw} raw");
}

#[test]
fn the_start_is_soft_and_the_approach_slower_than_tracking() {
    let mut config = config();
    config.speed.soft_start_s = 0.5;
    config.approach.speed.linear_m_per_s = 0.02;
    let mut cell = Cell::new(config, IDEAL, 0.0);
    let target = cell.target_for_hand_moved(Vector3::new(0.0, 0.05, -0.05), rotation(0.0, 0.1, 0.0));
    let mut fastest = 0.0f64;
    let mut reached = false;
    for step in 0..6000 {
        let before = cell.base_from_hand().translation_m();
        let now = cell.step(&target);
        let speed = (cell.base_from_hand().translation_m() - before).norm() / cell.step_s;
        if step == 0 {
            assert_eq!(now.command, Command::Velocity(JointVector::zeros()));
            assert_eq!(now.limited_by, Some(Limitation::SoftStart));
        }
        let ramp = 0.02 * f64::from(step) * cell.step_s / 0.5;
        assert!(speed <= ramp.min(0.02) * 1.01 + 1e-9, "{speed} m/s at step {step}");
        reached |= now.mode == Mode::Tracking;
        if !reached {
            assert_eq!(now.mode, Mode::Approaching);
            fastest = fastest.max(speed);
        }
    }
    assert!(reached && fastest > 0.0195, "{fastest}");
    // After the arrival the speed limit of tracking applies.
    let target = cell.target_for_hand_moved(Vector3::new(0.0, -0.05, 0.05), rotation(0.0, 0.0, 0.0));
    let before = cell.base_from_hand().translation_m();
    (0..100).for_each(|_| assert_eq!(cell.step(&target).mode, Mode::Tracking));
    assert!((cell.base_from_hand().translation_m() - before).norm() / 0.2 > 0.05);
}

#[test]
fn at_the_end_of_a_joint_the_hand_rests_with_the_reason() {
    let mut cell = Cell::new(config(), IDEAL, 0.0);
    // Far down and outwards: the shoulder would have to exceed its range.
    let target = cell.target_for_hand_moved(Vector3::new(0.1, 0.0, -0.45), rotation(0.0, 0.0, 0.0));
    let mut last = cell.step(&target);
    for _ in 0..5000 {
        last = cell.step(&target);
        assert!(cell.limits.operating().violation(&cell.joints.position_rad).is_none(), "{last:?}");
    }
    assert_eq!(last.limited_by, Some(Limitation::JointRange { joint: 1 }), "{last:?}");
    assert!(cell.joints.velocity_rad_per_s.amax() < 1e-3, "{last:?}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn commands_are_finite_and_within_the_limits(
        q in prop::array::uniform7(-0.999..0.999f64), shift in prop::array::uniform3(-1.0..1.0f64),
        turn in prop::array::uniform3(-2.0..2.0f64), scale in 0.05..1.0f64,
    ) {
        let mut config = config();
        let gains = Gains { position_per_s: 30.0, velocity: 0.0, orientation_per_s: 6.0, angular_velocity: 0.0 };
        config.law = LawConfig::Published(published(gains));
        let mut cell = Cell::at_speed_scale(scale, config, IDEAL, 0.0);
        cell.joints.position_rad = cell.limits.operating().position_max_rad().component_mul(&JointVector::from(q));
        let target = cell.target_for_hand_moved(shift.into(), rotation(turn[0], turn[1], turn[2]));
        for _ in 0..100 {
            let step = cell.step(&target);
            if let Command::Velocity(velocity) = step.command {
                let allowed = cell.limits.velocity_max_rad_per_s();
                for joint in 0..7 {
                    prop_assert!(velocity[joint].abs() <= allowed[joint] * (1.0 + 1e-12), "{velocity}");
                }
            }
            prop_assert!(cell.limits.operating().violation(&cell.joints.position_rad).is_none());
            prop_assert!(step.smallest_singular_value.is_some_and(f64::is_finite));
        }
    }
}

/// The image-based laws, without smoothing.
fn image_laws() -> [LawConfig; 2] {
    let target_filter: TargetFilterConfig = published(Gains::default()).target_filter;
    [
        LawConfig::ImageBased(ImageBasedConfig { gain_per_s: 3.0, half_width_m: 0.05, target_filter }),
        LawConfig::Hybrid(HybridConfig { gain_per_s: 3.0, target_filter }),
    ]
}

#[test]
fn the_laws_that_look_at_the_image_lead_the_hand_to_its_place() {
    for law in image_laws() {
        let mut cell = Cell::new(ControllerConfig { law, ..config() }, IDEAL, 0.066);
        let target = cell.target_for_hand_moved(Vector3::new(0.06, -0.08, 0.05), rotation(0.15, -0.2, 0.25));
        for _ in 0..2500 {
            cell.step(&target);
        }
        let hand_from_model = cell.base_from_hand().inverse() * target;
        let off = hand_from_model * cell.config.model_from_hand_desired;
        assert!(off.translation_m().norm() < 1e-4 && off.rotation_angle_rad() < 1e-4, "{law:?}: {off:?}");
    }
}

/// With the model behind the camera an image-based law has no velocity.
#[test]
fn a_target_behind_the_camera_is_reported_and_the_hand_holds() {
    for law in image_laws() {
        let mut cell = Cell::new(ControllerConfig { law, ..config() }, IDEAL, 0.066);
        let behind = cell.base_from_hand() * Pose::from_translation(Vector3::new(0.0, 0.0, -0.4));
        let step = (0..200).map(|_| cell.step(&behind)).last().unwrap();
        assert_eq!((step.command, step.mode), (Command::Hold, Mode::Holding(HoldReason::TargetNotBeforeCamera)));
        assert_eq!(step.mode.to_string(), "holding: the target is not in front of the camera");
    }
}
