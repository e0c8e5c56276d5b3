//! The table `[servo.target]`: motion models of the target and measurement noise.

use pb3dp_servo::target_state::{MeasurementConfig, MotionConfig, RestConfig, SurpriseConfig, TargetStateConfig};
use serde::Deserialize;

use super::super::load::{Checker, whole};
use super::super::table::{Builds, table};

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TargetStateSection {
    linear: LinearSection,
    angular: AngularSection,
    measurement: MeasurementSection,
    surprise: SurpriseSection,
    gate_nis: f64,
    history_measurements: i64,
    horizon_s: f64,
    gap_max_s: f64,
}

table! {
    struct LinearSection builds MotionConfig {
        acceleration_sigma_mm_per_s2: f64 => acceleration_sigma_per_s2 = mm(MotionConfig::ACCELERATION_SIGMA_PER_S2);
        correlation_time_s: f64 => correlation_time_s = number(MotionConfig::CORRELATION_TIME_S);
        across_share: f64 => across_share = number(MotionConfig::ACROSS_SHARE);
        start_velocity_sigma_mm_per_s: f64 => start_velocity_sigma_per_s = mm(MotionConfig::START_VELOCITY_SIGMA_PER_S);
        rest: Option<LinearRestSection> => rest = inner();
    }
}

table! {
    struct LinearRestSection builds RestConfig {
        drift_sigma_mm_per_sqrt_s: f64 => drift_sigma_per_sqrt_s = mm(RestConfig::DRIFT_SIGMA_PER_SQRT_S);
        onset_velocity_sigma_mm_per_s: f64 => onset_velocity_sigma_per_s = mm(RestConfig::ONSET_VELOCITY_SIGMA_PER_S);
        mean_rest_s: f64 => mean_rest_s = number(RestConfig::MEAN_REST_S);
        mean_motion_s: f64 => mean_motion_s = number(RestConfig::MEAN_MOTION_S);
    }
}

table! {
    struct AngularSection builds MotionConfig {
        acceleration_sigma_deg_per_s2: f64 => acceleration_sigma_per_s2 = deg(MotionConfig::ACCELERATION_SIGMA_PER_S2);
        correlation_time_s: f64 => correlation_time_s = number(MotionConfig::CORRELATION_TIME_S);
        across_share: f64 => across_share = number(MotionConfig::ACROSS_SHARE);
        start_velocity_sigma_deg_per_s: f64 => start_velocity_sigma_per_s = deg(MotionConfig::START_VELOCITY_SIGMA_PER_S);
        rest: Option<AngularRestSection> => rest = inner();
    }
}

table! {
    struct AngularRestSection builds RestConfig {
        drift_sigma_deg_per_sqrt_s: f64 => drift_sigma_per_sqrt_s = deg(RestConfig::DRIFT_SIGMA_PER_SQRT_S);
        onset_velocity_sigma_deg_per_s: f64 => onset_velocity_sigma_per_s = deg(RestConfig::ONSET_VELOCITY_SIGMA_PER_S);
        mean_rest_s: f64 => mean_rest_s = number(RestConfig::MEAN_REST_S);
        mean_motion_s: f64 => mean_motion_s = number(RestConfig::MEAN_MOTION_S);
    }
}

table! {
    struct MeasurementSection builds MeasurementConfig {
        covariance_factor: f64 => covariance_factor = number(MeasurementConfig::COVARIANCE_FACTOR);
        position_sigma_min_mm: f64 => position_sigma_min_m = mm(MeasurementConfig::POSITION_SIGMA_MIN_M);
        orientation_sigma_min_deg: f64 => orientation_sigma_min_rad = deg(MeasurementConfig::ORIENTATION_SIGMA_MIN_RAD);
    }
}

table! {
    struct SurpriseSection builds SurpriseConfig {
        newest_share: f64 => newest_share = number(SurpriseConfig::NEWEST_SHARE);
        from: f64 => from = number(SurpriseConfig::FROM);
        exponent: f64 => exponent = number(SurpriseConfig::EXPONENT);
        factor_max: f64 => factor_max = number(SurpriseConfig::FACTOR_MAX);
    }
}

impl TargetStateSection {
    /// The target must be predictable until the time-out of observations, `observation_s`.
    pub(super) fn build(&self, observation_s: f64, check: &mut Checker) -> TargetStateConfig {
        let key = |name: &str| format!("servo.target.{name}");
        let config = TargetStateConfig {
            linear: self.linear.build(&key("linear"), check),
            angular: self.angular.build(&key("angular"), check),
            measurement: self.measurement.build(&key("measurement"), check),
            surprise: self.surprise.build(&key("surprise"), check),
            gate_nis: self.gate_nis,
            history_measurements: whole(self.history_measurements),
            horizon_s: self.horizon_s,
            gap_max_s: self.gap_max_s,
        };
        let measurements = self.history_measurements;
        check.number(&key("gate_nis"), self.gate_nis, TargetStateConfig::GATE_NIS);
        check.count(&key("history_measurements"), measurements, TargetStateConfig::HISTORY_MEASUREMENTS);
        check.number(&key("horizon_s"), self.horizon_s, TargetStateConfig::horizon_s_allowed(observation_s));
        check.number(&key("gap_max_s"), self.gap_max_s, config.gap_max_s_allowed());
        config
    }
}
