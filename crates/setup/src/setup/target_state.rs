//! The table `[servo.target]`: motion models of the target and measurement noise.

use pb3dp_servo::target_state::{MeasurementConfig, MotionConfig, RestConfig, SurpriseConfig, TargetStateConfig};
use serde::Deserialize;

use super::super::load::{Checker, whole};
use super::super::units::{in_deg, in_mm};

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

/// Millimetres.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LinearSection {
    acceleration_sigma_mm_per_s2: f64,
    correlation_time_s: f64,
    across_share: f64,
    start_velocity_sigma_mm_per_s: f64,
    rest: Option<LinearRestSection>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct LinearRestSection {
    drift_sigma_mm_per_sqrt_s: f64,
    onset_velocity_sigma_mm_per_s: f64,
    mean_rest_s: f64,
    mean_motion_s: f64,
}

/// Degrees.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct AngularSection {
    acceleration_sigma_deg_per_s2: f64,
    correlation_time_s: f64,
    across_share: f64,
    start_velocity_sigma_deg_per_s: f64,
    rest: Option<AngularRestSection>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct AngularRestSection {
    drift_sigma_deg_per_sqrt_s: f64,
    onset_velocity_sigma_deg_per_s: f64,
    mean_rest_s: f64,
    mean_motion_s: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct MeasurementSection {
    covariance_factor: f64,
    position_sigma_min_mm: f64,
    orientation_sigma_min_deg: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SurpriseSection {
    newest_share: f64,
    from: f64,
    exponent: f64,
    factor_max: f64,
}

impl TargetStateSection {
    /// The target must be predictable until the time-out of observations, `observation_s`.
    pub(super) fn build(&self, observation_s: f64, check: &mut Checker) -> TargetStateConfig {
        check.number("servo.target.gate_nis", self.gate_nis, TargetStateConfig::GATE_NIS);
        let measurements = self.history_measurements;
        check.count("servo.target.history_measurements", measurements, TargetStateConfig::HISTORY_MEASUREMENTS);
        let horizon_s = TargetStateConfig::horizon_s_allowed(observation_s);
        check.number("servo.target.horizon_s", self.horizon_s, horizon_s);
        let config = TargetStateConfig {
            linear: self.linear.build(check),
            angular: self.angular.build(check),
            measurement: self.measurement.build(check),
            surprise: self.surprise.build(check),
            gate_nis: self.gate_nis,
            history_measurements: whole(self.history_measurements),
            horizon_s: self.horizon_s,
            gap_max_s: self.gap_max_s,
        };
        check.number("servo.target.gap_max_s", self.gap_max_s, config.gap_max_s_allowed());
        config
    }
}

impl LinearSection {
    fn build(&self, check: &mut Checker) -> MotionConfig {
        let key = |name: &str| format!("servo.target.linear.{name}");
        check.number(
            &key("acceleration_sigma_mm_per_s2"),
            self.acceleration_sigma_mm_per_s2,
            in_mm(MotionConfig::ACCELERATION_SIGMA_PER_S2),
        );
        check.number(&key("correlation_time_s"), self.correlation_time_s, MotionConfig::CORRELATION_TIME_S);
        check.number(&key("across_share"), self.across_share, MotionConfig::ACROSS_SHARE);
        check.number(
            &key("start_velocity_sigma_mm_per_s"),
            self.start_velocity_sigma_mm_per_s,
            in_mm(MotionConfig::START_VELOCITY_SIGMA_PER_S),
        );
        MotionConfig {
            acceleration_sigma_per_s2: self.acceleration_sigma_mm_per_s2 * 1e-3,
            correlation_time_s: self.correlation_time_s,
            across_share: self.across_share,
            start_velocity_sigma_per_s: self.start_velocity_sigma_mm_per_s * 1e-3,
            rest: self.rest.as_ref().map(|rest| rest.build(check)),
        }
    }
}

impl LinearRestSection {
    fn build(&self, check: &mut Checker) -> RestConfig {
        let key = |name: &str| format!("servo.target.linear.rest.{name}");
        check.number(
            &key("drift_sigma_mm_per_sqrt_s"),
            self.drift_sigma_mm_per_sqrt_s,
            in_mm(RestConfig::DRIFT_SIGMA_PER_SQRT_S),
        );
        check.number(
            &key("onset_velocity_sigma_mm_per_s"),
            self.onset_velocity_sigma_mm_per_s,
            in_mm(RestConfig::ONSET_VELOCITY_SIGMA_PER_S),
        );
        check_durations(&key, self.mean_rest_s, self.mean_motion_s, check);
        RestConfig {
            drift_sigma_per_sqrt_s: self.drift_sigma_mm_per_sqrt_s * 1e-3,
            onset_velocity_sigma_per_s: self.onset_velocity_sigma_mm_per_s * 1e-3,
            mean_rest_s: self.mean_rest_s,
            mean_motion_s: self.mean_motion_s,
        }
    }
}

impl AngularSection {
    fn build(&self, check: &mut Checker) -> MotionConfig {
        let key = |name: &str| format!("servo.target.angular.{name}");
        check.number(
            &key("acceleration_sigma_deg_per_s2"),
            self.acceleration_sigma_deg_per_s2,
            in_deg(MotionConfig::ACCELERATION_SIGMA_PER_S2),
        );
        check.number(&key("correlation_time_s"), self.correlation_time_s, MotionConfig::CORRELATION_TIME_S);
        check.number(&key("across_share"), self.across_share, MotionConfig::ACROSS_SHARE);
        check.number(
            &key("start_velocity_sigma_deg_per_s"),
            self.start_velocity_sigma_deg_per_s,
            in_deg(MotionConfig::START_VELOCITY_SIGMA_PER_S),
        );
        MotionConfig {
            acceleration_sigma_per_s2: self.acceleration_sigma_deg_per_s2.to_radians(),
            correlation_time_s: self.correlation_time_s,
            across_share: self.across_share,
            start_velocity_sigma_per_s: self.start_velocity_sigma_deg_per_s.to_radians(),
            rest: self.rest.as_ref().map(|rest| rest.build(check)),
        }
    }
}

impl AngularRestSection {
    fn build(&self, check: &mut Checker) -> RestConfig {
        let key = |name: &str| format!("servo.target.angular.rest.{name}");
        check.number(
            &key("drift_sigma_deg_per_sqrt_s"),
            self.drift_sigma_deg_per_sqrt_s,
            in_deg(RestConfig::DRIFT_SIGMA_PER_SQRT_S),
        );
        check.number(
            &key("onset_velocity_sigma_deg_per_s"),
            self.onset_velocity_sigma_deg_per_s,
            in_deg(RestConfig::ONSET_VELOCITY_SIGMA_PER_S),
        );
        check_durations(&key, self.mean_rest_s, self.mean_motion_s, check);
        RestConfig {
            drift_sigma_per_sqrt_s: self.drift_sigma_deg_per_sqrt_s.to_radians(),
            onset_velocity_sigma_per_s: self.onset_velocity_sigma_deg_per_s.to_radians(),
            mean_rest_s: self.mean_rest_s,
            mean_motion_s: self.mean_motion_s,
        }
    }
}

fn check_durations(key: &impl Fn(&str) -> String, mean_rest_s: f64, mean_motion_s: f64, check: &mut Checker) {
    check.number(&key("mean_rest_s"), mean_rest_s, RestConfig::MEAN_REST_S);
    check.number(&key("mean_motion_s"), mean_motion_s, RestConfig::MEAN_MOTION_S);
}

impl MeasurementSection {
    fn build(&self, check: &mut Checker) -> MeasurementConfig {
        let key = |name: &str| format!("servo.target.measurement.{name}");
        check.number(&key("covariance_factor"), self.covariance_factor, MeasurementConfig::COVARIANCE_FACTOR);
        check.number(
            &key("position_sigma_min_mm"),
            self.position_sigma_min_mm,
            in_mm(MeasurementConfig::POSITION_SIGMA_MIN_M),
        );
        check.number(
            &key("orientation_sigma_min_deg"),
            self.orientation_sigma_min_deg,
            in_deg(MeasurementConfig::ORIENTATION_SIGMA_MIN_RAD),
        );
        MeasurementConfig {
            covariance_factor: self.covariance_factor,
            position_sigma_min_m: self.position_sigma_min_mm * 1e-3,
            orientation_sigma_min_rad: self.orientation_sigma_min_deg.to_radians(),
        }
    }
}

impl SurpriseSection {
    fn build(&self, check: &mut Checker) -> SurpriseConfig {
        let key = |name: &str| format!("servo.target.surprise.{name}");
        check.number(&key("newest_share"), self.newest_share, SurpriseConfig::NEWEST_SHARE);
        check.number(&key("from"), self.from, SurpriseConfig::FROM);
        check.number(&key("exponent"), self.exponent, SurpriseConfig::EXPONENT);
        check.number(&key("factor_max"), self.factor_max, SurpriseConfig::FACTOR_MAX);
        SurpriseConfig {
            newest_share: self.newest_share,
            from: self.from,
            exponent: self.exponent,
            factor_max: self.factor_max,
        }
    }
}
