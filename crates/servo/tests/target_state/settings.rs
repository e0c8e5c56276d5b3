//! Settings out of range are refused with key, value and range.

use pb3dp_servo::{TargetState, TargetStateConfig};

/// One change of the settings.
type Change = fn(&mut TargetStateConfig, f64);

fn refused(change: Change, value: f64) -> Option<String> {
    let mut config = TargetStateConfig::default();
    change(&mut config, value);
    TargetState::new(config).err().map(|error| error.to_string())
}

#[test]
fn each_number_has_its_range() {
    let cases: [(&str, Change, &[f64]); 27] = [
        ("linear.acceleration_sigma_per_s2", |c, v| c.linear.acceleration_sigma_per_s2 = v, &[0.0, 101.0]),
        ("linear.correlation_time_s", |c, v| c.linear.correlation_time_s = v, &[0.0, 101.0]),
        ("linear.across_share", |c, v| c.linear.across_share = v, &[0.0, 1.1]),
        ("linear.start_velocity_sigma_per_s", |c, v| c.linear.start_velocity_sigma_per_s = v, &[0.0, 11.0]),
        (
            "linear.rest.drift_sigma_per_sqrt_s",
            |c, v| c.linear.rest.as_mut().unwrap().drift_sigma_per_sqrt_s = v,
            &[0.0, 0.2],
        ),
        (
            "linear.rest.onset_velocity_sigma_per_s",
            |c, v| c.linear.rest.as_mut().unwrap().onset_velocity_sigma_per_s = v,
            &[0.0, 11.0],
        ),
        ("linear.rest.mean_rest_s", |c, v| c.linear.rest.as_mut().unwrap().mean_rest_s = v, &[0.0, 1001.0]),
        ("linear.rest.mean_motion_s", |c, v| c.linear.rest.as_mut().unwrap().mean_motion_s = v, &[0.0, 1001.0]),
        ("angular.acceleration_sigma_per_s2", |c, v| c.angular.acceleration_sigma_per_s2 = v, &[0.0, 101.0]),
        ("angular.correlation_time_s", |c, v| c.angular.correlation_time_s = v, &[0.0, 101.0]),
        ("angular.across_share", |c, v| c.angular.across_share = v, &[0.0, 1.1]),
        ("angular.start_velocity_sigma_per_s", |c, v| c.angular.start_velocity_sigma_per_s = v, &[0.0, 11.0]),
        (
            "angular.rest.drift_sigma_per_sqrt_s",
            |c, v| c.angular.rest.as_mut().unwrap().drift_sigma_per_sqrt_s = v,
            &[0.0, 0.2],
        ),
        (
            "angular.rest.onset_velocity_sigma_per_s",
            |c, v| c.angular.rest.as_mut().unwrap().onset_velocity_sigma_per_s = v,
            &[0.0, 11.0],
        ),
        ("angular.rest.mean_rest_s", |c, v| c.angular.rest.as_mut().unwrap().mean_rest_s = v, &[0.0, 1001.0]),
        ("angular.rest.mean_motion_s", |c, v| c.angular.rest.as_mut().unwrap().mean_motion_s = v, &[0.0, 1001.0]),
        ("measurement.covariance_factor", |c, v| c.measurement.covariance_factor = v, &[0.0, 1001.0]),
        ("measurement.position_sigma_min_m", |c, v| c.measurement.position_sigma_min_m = v, &[0.0, 0.2]),
        ("measurement.orientation_sigma_min_rad", |c, v| c.measurement.orientation_sigma_min_rad = v, &[0.0, 0.6]),
        ("surprise.newest_share", |c, v| c.surprise.newest_share = v, &[0.0, 1.1]),
        ("surprise.from", |c, v| c.surprise.from = v, &[0.9, 101.0]),
        ("surprise.exponent", |c, v| c.surprise.exponent = v, &[-0.1, 8.1]),
        ("surprise.factor_max", |c, v| c.surprise.factor_max = v, &[0.9, 1_000_001.0]),
        ("gate_nis", |c, v| c.gate_nis = v, &[5.0, 10_001.0]),
        ("history_measurements", |c, v| c.history_measurements = v as usize, &[1.0, 1001.0]),
        ("horizon_s", |c, v| c.horizon_s = v, &[0.0, 6.0]),
        ("gap_max_s", |c, v| c.gap_max_s = v, &[0.4, 61.0]),
    ];
    for (key, change, bad) in cases {
        for &value in bad {
            let message = refused(change, value).unwrap_or_else(|| panic!("{key} = {value} was accepted"));
            assert!(message.contains(&format!("setting target_state.{key} is {value}: allowed is ")), "{message}");
        }
    }
    assert!(refused(|c, v| c.gate_nis = v, f64::NAN).unwrap().contains("gate_nis is NaN"));
    assert_eq!(refused(|c, v| c.gate_nis = v, 30.0), None);
    assert_eq!(refused(|c, _| c.angular.rest = None, 0.0), None);
}
