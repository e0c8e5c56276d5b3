//! Settings out of range are refused with key, value and range.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

use crate::common::{chain, config, feed_forward, feed_forward_config, limits};
use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_servo::{
    ArmResponse, Controller, ControllerConfig, FeedForwardConfig, FeedForwardGains, Gains, LawConfig, PublishedConfig,
};

/// One change of the settings.
type Change = fn(&mut ControllerConfig, f64);

fn published(config: &mut ControllerConfig) -> &mut PublishedConfig {
    let LawConfig::Published(law) = &mut config.law else { panic!("no published law") };
    law
}

fn refused(change: Change, value: f64) -> Option<String> {
    let mut config = config();
    change(&mut config, value);
    Controller::new(config, chain(), limits(1.0)).err().map(|error| error.to_string())
}

#[test]
fn each_number_has_its_range() {
    let cases: [(&str, Change, &[f64]); 22] = [
        ("gains.position_per_s", |c, v| published(c).gains.position_per_s = v, &[0.0, -1.0, 51.0]),
        ("gains.velocity", |c, v| published(c).gains.velocity = v, &[-0.1, 1.0]),
        ("gains.orientation_per_s", |c, v| published(c).gains.orientation_per_s = v, &[0.0, 101.0]),
        ("gains.angular_velocity", |c, v| published(c).gains.angular_velocity = v, &[-0.1, 1.0]),
        (
            "target_filter.position_time_constant_s",
            |c, v| published(c).target_filter.position_time_constant_s = v,
            &[-0.1, 6.0],
        ),
        (
            "target_filter.orientation_time_constant_s",
            |c, v| published(c).target_filter.orientation_time_constant_s = v,
            &[-0.1, 6.0],
        ),
        ("target_filter.gate_position_m", |c, v| published(c).target_filter.gate_position_m = v, &[0.0, 11.0]),
        ("target_filter.gate_orientation_rad", |c, v| published(c).target_filter.gate_orientation_rad = v, &[0.0, 3.2]),
        (
            "target_filter.observations_to_lock",
            |c, v| published(c).target_filter.observations_to_lock = v as u32,
            &[0.0, 1001.0],
        ),
        ("damping.threshold", |c, v| c.damping.threshold = v, &[0.0, 0.6]),
        ("damping.elbow_min_rad", |c, v| c.damping.elbow_min_rad = v, &[-0.1, 0.6]),
        ("damping.factor_max", |c, v| c.damping.factor_max = v, &[0.0, 0.6]),
        ("speed.tracking.linear_m_per_s", |c, v| c.speed.tracking.linear_m_per_s = v, &[0.0, 2.1]),
        ("speed.tracking.angular_rad_per_s", |c, v| c.speed.tracking.angular_rad_per_s = v, &[0.0, 6.1]),
        ("speed.limit_approach_per_s", |c, v| c.speed.limit_approach_per_s = v, &[0.0, 21.0]),
        ("speed.soft_start_s", |c, v| c.speed.soft_start_s = v, &[-0.1, 11.0]),
        ("approach.speed.linear_m_per_s", |c, v| c.approach.speed.linear_m_per_s = v, &[0.0, 2.1]),
        ("approach.done_within_m", |c, v| c.approach.done_within_m = v, &[0.0, 1.1]),
        ("timeouts.observation_s", |c, v| c.timeouts.observation_s = v, &[0.01, 5.1]),
        ("timeouts.lost_s", |c, v| c.timeouts.lost_s = v, &[0.29, 61.0]),
        ("timeouts.joints_s", |c, v| c.timeouts.joints_s = v, &[0.001, 0.6]),
        ("joint_history_samples", |c, v| c.joint_history_samples = v as usize, &[7.0, 10_001.0]),
    ];
    for (key, change, bad) in cases {
        for &value in bad {
            let message = refused(change, value).unwrap_or_else(|| panic!("{key} = {value} was accepted"));
            assert!(message.contains(&format!("setting {key} is {value}: allowed is ")), "{message}");
        }
    }
    assert!(
        refused(|c, v| published(c).gains.position_per_s = v, f64::NAN)
            .unwrap()
            .contains("gains.position_per_s is NaN")
    );
    assert_eq!(refused(|c, v| published(c).gains.position_per_s = v, 4.0), None);
}

#[test]
fn poses_must_be_finite_and_near() {
    let far = |c: &mut ControllerConfig, v: f64| c.model_from_hand_desired = Pose::from_translation(Vector3::z() * v);
    assert!(refused(far, -500.0).unwrap().contains("model_from_hand_desired is 500"), "millimetres given as metres");
    assert!(refused(far, f64::NAN).unwrap().contains("model_from_hand_desired"));
    let camera = |c: &mut ControllerConfig, v: f64| c.hand_from_cam_left = Pose::from_translation(Vector3::x() * v);
    assert!(refused(camera, f64::INFINITY).unwrap().contains("hand_from_cam_left"));
    let mount = |c: &mut ControllerConfig, v: f64| {
        let rotation = UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(v, 0.0, 0.0, 0.0));
        c.flange_from_hand = Pose::from_parts(Vector3::zeros(), rotation);
    };
    assert!(refused(mount, f64::NAN).unwrap().contains("flange_from_hand"));
    assert_eq!(refused(mount, 1.0), None);
}

#[test]
fn the_default_gains_are_those_without_overshoot_at_92_ms() {
    let bound = Gains::without_overshoot(0.09197);
    let gains = Gains::default();
    assert!((bound.position_per_s - gains.position_per_s).abs() < 1e-3);
    assert!((bound.orientation_per_s - gains.orientation_per_s).abs() < 2e-3);
}

/// One change of the settings of the law with feed-forward.
type LawChange = fn(&mut FeedForwardConfig, f64);

const ARM: ArmResponse = ArmResponse { delay_s: 0.02, lag_s: 0.03 };

#[test]
fn each_number_of_the_law_with_feed_forward_has_its_range() {
    let cases: [(&str, LawChange, &[f64]); 15] = [
        ("feed_forward.arm.delay_s", |c, v| c.arm.delay_s = v, &[-0.01, 0.6]),
        ("feed_forward.arm.lag_s", |c, v| c.arm.lag_s = v, &[-0.01, 0.6]),
        ("feed_forward.gains.position_per_s", |c, v| c.gains.position_per_s = v, &[0.0, 51.0]),
        ("feed_forward.gains.orientation_per_s", |c, v| c.gains.orientation_per_s = v, &[0.0, 51.0]),
        ("feed_forward.gains.linear_m_per_s2", |c, v| c.gains.linear_m_per_s2 = v, &[0.0, 21.0]),
        ("feed_forward.gains.angular_rad_per_s2", |c, v| c.gains.angular_rad_per_s2 = v, &[0.0, 51.0]),
        ("feed_forward.observations_to_lock", |c, v| c.observations_to_lock = v as u32, &[0.0, 1001.0]),
        ("feed_forward.unstated.lateral_m", |c, v| c.unstated.lateral_m = v, &[0.0, 0.2]),
        ("feed_forward.unstated.depth_m", |c, v| c.unstated.depth_m = v, &[0.0, 0.2]),
        ("feed_forward.unstated.tilt_rad", |c, v| c.unstated.tilt_rad = v, &[0.0, 1.1]),
        ("feed_forward.unstated.about_normal_rad", |c, v| c.unstated.about_normal_rad = v, &[0.0, 1.1]),
        ("feed_forward.redundancy.gain_rad_per_s", |c, v| c.redundancy.gain_rad_per_s = v, &[-0.1, 11.0]),
        ("feed_forward.redundancy.speed_max_rad_per_s", |c, v| c.redundancy.speed_max_rad_per_s = v, &[-0.1, 1.1]),
        ("target_state.gate_nis", |c, v| c.target.gate_nis = v, &[5.0, 2e4]),
        // The hand moves for up to 0.3 s without a new observation.
        ("target_state.horizon_s", |c, v| c.target.horizon_s = v, &[0.299]),
    ];
    let refusal = |change: LawChange, value: f64| {
        let mut law = feed_forward(ARM);
        change(&mut law, value);
        Controller::new(feed_forward_config(law), chain(), limits(1.0)).err().map(|error| error.to_string())
    };
    for (key, change, bad) in cases {
        for &value in bad.iter().chain(&[f64::NAN]) {
            // A count has no NaN.
            if value.is_nan() && key.ends_with("to_lock") {
                continue;
            }
            let message = refusal(change, value).unwrap_or_else(|| panic!("{key} = {value} was accepted"));
            assert!(message.contains(&format!("setting {key} is {value}: allowed is ")), "{message}");
        }
    }
    assert_eq!(refusal(|c, v| c.target.horizon_s = v, 0.3), None);
}

#[test]
fn the_gain_for_an_arm_is_free_of_overshoot_with_half_of_it_unknown_and_bounded() {
    let bound = Gains::without_overshoot(0.025).position_per_s;
    assert_eq!(ARM.gain_without_overshoot(), bound);
    let gains = FeedForwardGains::of(&ARM);
    assert_eq!((gains.position_per_s, gains.orientation_per_s), (bound, bound));
    for quick in [ArmResponse { delay_s: 0.0, lag_s: 0.0 }, ArmResponse { delay_s: 0.001, lag_s: 0.001 }] {
        assert_eq!(quick.gain_without_overshoot(), ArmResponse::GAIN_MAX_PER_S);
    }
}
