//! Settings out of range are refused with key, value and range.
#![allow(clippy::unwrap_used, clippy::panic)] // In helpers of tests.

mod common;

use common::{chain, config, limits};
use nalgebra::{UnitQuaternion, Vector3};
use pb3dp_geometry::Pose;
use pb3dp_servo::{Controller, ControllerConfig, Gains};

/// One change of the settings.
type Change = fn(&mut ControllerConfig, f64);

fn refused(change: Change, value: f64) -> Option<String> {
    let mut config = config();
    change(&mut config, value);
    Controller::new(config, chain(), limits()).err().map(|error| error.to_string())
}

#[test]
fn each_number_has_its_range() {
    let cases: [(&str, Change, &[f64]); 22] = [
        ("gains.position_per_s", |c, v| c.gains.position_per_s = v, &[0.0, -1.0, 51.0]),
        ("gains.velocity", |c, v| c.gains.velocity = v, &[-0.1, 1.0]),
        ("gains.orientation_per_s", |c, v| c.gains.orientation_per_s = v, &[0.0, 101.0]),
        ("gains.angular_velocity", |c, v| c.gains.angular_velocity = v, &[-0.1, 1.0]),
        ("target_filter.position_time_constant_s", |c, v| c.target_filter.position_time_constant_s = v, &[-0.1, 6.0]),
        (
            "target_filter.orientation_time_constant_s",
            |c, v| c.target_filter.orientation_time_constant_s = v,
            &[-0.1, 6.0],
        ),
        ("target_filter.gate_position_m", |c, v| c.target_filter.gate_position_m = v, &[0.0, 11.0]),
        ("target_filter.gate_orientation_rad", |c, v| c.target_filter.gate_orientation_rad = v, &[0.0, 3.2]),
        ("target_filter.observations_to_lock", |c, v| c.target_filter.observations_to_lock = v as u32, &[0.0, 1001.0]),
        ("damping.threshold", |c, v| c.damping.threshold = v, &[0.0, 0.6]),
        ("damping.factor_max", |c, v| c.damping.factor_max = v, &[0.0, 0.6]),
        ("speed.tracking.linear_m_per_s", |c, v| c.speed.tracking.linear_m_per_s = v, &[0.0, 2.1]),
        ("speed.tracking.angular_rad_per_s", |c, v| c.speed.tracking.angular_rad_per_s = v, &[0.0, 6.1]),
        ("speed.joint_speed_scale", |c, v| c.speed.joint_speed_scale = v, &[0.0, 1.1]),
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
            let message = refused(change, value).unwrap_or_else(|| panic!("{key} = {value} was taken"));
            assert!(message.contains(&format!("setting {key} is {value}: allowed is ")), "{message}");
        }
    }
    assert!(refused(|c, v| c.gains.position_per_s = v, f64::NAN).unwrap().contains("gains.position_per_s is NaN"));
    assert_eq!(refused(|c, v| c.gains.position_per_s = v, 4.0), None);
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
