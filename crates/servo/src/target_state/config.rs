//! Parameters of the target filter and their check.

use std::ops::RangeInclusive;

use pb3dp_geometry::ranges;

use crate::config_error::not_below;

/// All parameters of [`crate::TargetState::new`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetStateConfig {
    /// Linear motion of the model's origin: metres.
    pub linear: MotionConfig,
    /// Rotation of the model: radians.
    pub angular: MotionConfig,
    /// Measurement noise.
    pub measurement: MeasurementConfig,
    /// Adaptation to motion that no model explains.
    pub surprise: SurpriseConfig,
    /// Gate: a measurement with a larger squared Mahalanobis distance (6 degrees of freedom) is an outlier, 6 to 10000. For
    /// Gaussian measurements a gate of 16.8 rejects 1 %, 22.5 0.1 %, 27.9 0.01 %, 38.3 one in a million.
    pub gate_nis: f64,
    /// Number of stored measurements, for late ones, 2 to 1000. Each takes about 12 kB. A measurement may be late by
    /// up to this number of measurements, less two.
    pub history_measurements: usize,
    /// Longest prediction beyond the newest measurement, seconds, 0.01 to 5.
    pub horizon_s: f64,
    /// Longest gap between measurements, seconds, `horizon_s` to 60; after a longer one the target is initialised again.
    pub gap_max_s: f64,
}

/// Motion model of one part, linear or angular. `X` is metres or radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionConfig {
    /// Standard deviation of the acceleration of a target in motion, per axis, X/s^2, 0.0001 to 100.
    pub acceleration_sigma_per_s2: f64,
    /// Correlation time of this acceleration (to 1/e), seconds, 0.01 to 100.
    pub correlation_time_s: f64,
    /// Share of the acceleration's variance across the known direction of motion, 0.001 to 1. Few targets change their axis as fast
    /// as their speed; 1: equal in all directions.
    pub across_share: f64,
    /// Standard deviation of the velocity of a new target, per axis, X/s, 0.0001 to 10.
    pub start_velocity_sigma_per_s: f64,
    /// Model of rest; `None`: only the Singer model.
    pub rest: Option<RestConfig>,
}

/// Second model of a part: a target at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestConfig {
    /// Random walk of a target at rest, per axis and square root of a second, X/s^0.5, 1e-7 to 0.1.
    pub drift_sigma_per_sqrt_s: f64,
    /// Standard deviation of the velocity at the onset of motion, per axis, X/s, 1e-6 to 10.
    pub onset_velocity_sigma_per_s: f64,
    /// Mean duration of a rest, seconds, 0.1 to 1000.
    pub mean_rest_s: f64,
    /// Mean duration of a motion between rests, seconds, 0.1 to 1000.
    pub mean_motion_s: f64,
}

/// Adaptation to motion that no model explains: larger accelerations than configured, or a jerk.
///
/// The surprise is the smoothed squared Mahalanobis distance of the measurements per degree of freedom; outliers count with the
/// gate. Above a threshold the noise of motion, and the velocity at its onset, grow with a power of the surprise. A fast target is
/// therefore not lost at the gate, and a target away from its prediction is found again after a few frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurpriseConfig {
    /// Weight of the newest measurement in the smoothed surprise, 0.01 to 1.
    pub newest_share: f64,
    /// Largest surprise without effect, 1 to 100; 1 is expected for a target that moves as modelled.
    pub from: f64,
    /// Exponent of surprise over threshold by which variances grow, 0 to 8; 0 disables the adaptation.
    pub exponent: f64,
    /// Largest factor on the variances, 1 to 1e6.
    pub factor_max: f64,
}

/// Use of the measured covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasurementConfig {
    /// Factor on the covariance, 0.01 to 1000: k for an estimator whose mean squared Mahalanobis error is k per degree of freedom.
    pub covariance_factor: f64,
    /// Lower bound of the standard deviation of position in any direction, metres, 1e-6 to 0.1.
    pub position_sigma_min_m: f64,
    /// Lower bound of the standard deviation of orientation about any axis, radians, 1e-6 to 0.5.
    pub orientation_sigma_min_rad: f64,
}

impl Default for TargetStateConfig {
    /// For a target that moves by about 100 mm or 20 degrees within 2 s with rests between, observed at 30 Hz by the direct
    /// tracker; chosen by the measurement in `docs/servo.md`.
    fn default() -> Self {
        Self {
            linear: MotionConfig {
                acceleration_sigma_per_s2: 0.15,
                correlation_time_s: 1.0,
                across_share: 0.05,
                start_velocity_sigma_per_s: 0.1,
                rest: Some(RestConfig {
                    drift_sigma_per_sqrt_s: 5e-5,
                    onset_velocity_sigma_per_s: 0.012,
                    mean_rest_s: 10.0,
                    mean_motion_s: 6.0,
                }),
            },
            angular: MotionConfig {
                acceleration_sigma_per_s2: 0.3,
                correlation_time_s: 1.0,
                across_share: 0.05,
                start_velocity_sigma_per_s: 0.3,
                rest: Some(RestConfig {
                    drift_sigma_per_sqrt_s: 1e-4,
                    onset_velocity_sigma_per_s: 0.03,
                    mean_rest_s: 10.0,
                    mean_motion_s: 6.0,
                }),
            },
            measurement: MeasurementConfig {
                covariance_factor: 1.5,
                position_sigma_min_m: 1e-4,
                orientation_sigma_min_rad: 5e-4,
            },
            surprise: SurpriseConfig { newest_share: 0.3, from: 1.5, exponent: 4.0, factor_max: 100.0 },
            gate_nis: 80.0,
            history_measurements: 32,
            horizon_s: 0.5,
            gap_max_s: 2.0,
        }
    }
}

impl TargetStateConfig {
    ranges! {
        fn check_ranges "target_state.";
        gate_nis, GATE_NIS: f64 = 6.0..=1e4;
        history_measurements, HISTORY_MEASUREMENTS: usize = 2..=1000;
        horizon_s, HORIZON_S: f64 = 0.01..=5.0;
    }

    /// Allowed values of `horizon_s` for a controller with this time-out of observations, seconds: the target must be predictable
    /// until then.
    pub fn horizon_s_allowed(observation_s: f64) -> RangeInclusive<f64> {
        not_below(observation_s, &Self::HORIZON_S)
    }

    /// Allowed values of `gap_max_s`.
    pub fn gap_max_s_allowed(&self) -> RangeInclusive<f64> {
        not_below(self.horizon_s, &Self::HORIZON_S).into_inner().0..=60.0
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), ranges::OutOfRange> {
        self.linear.validate(&LINEAR_KEYS)?;
        self.angular.validate(&ANGULAR_KEYS)?;
        self.measurement.validate()?;
        self.surprise.validate()?;
        self.check_ranges()?;
        ranges::check_range("target_state.gap_max_s", self.gap_max_s, self.gap_max_s_allowed())
    }
}

/// Names of the settings of a [`MotionConfig`], in the order of its fields.
type MotionKeys = [&'static str; 8];

const LINEAR_KEYS: MotionKeys = [
    "target_state.linear.acceleration_sigma_per_s2",
    "target_state.linear.correlation_time_s",
    "target_state.linear.across_share",
    "target_state.linear.start_velocity_sigma_per_s",
    "target_state.linear.rest.drift_sigma_per_sqrt_s",
    "target_state.linear.rest.onset_velocity_sigma_per_s",
    "target_state.linear.rest.mean_rest_s",
    "target_state.linear.rest.mean_motion_s",
];

const ANGULAR_KEYS: MotionKeys = [
    "target_state.angular.acceleration_sigma_per_s2",
    "target_state.angular.correlation_time_s",
    "target_state.angular.across_share",
    "target_state.angular.start_velocity_sigma_per_s",
    "target_state.angular.rest.drift_sigma_per_sqrt_s",
    "target_state.angular.rest.onset_velocity_sigma_per_s",
    "target_state.angular.rest.mean_rest_s",
    "target_state.angular.rest.mean_motion_s",
];

impl MotionConfig {
    ranges! {
        ACCELERATION_SIGMA_PER_S2: f64 = 1e-4..=100.0;
        CORRELATION_TIME_S: f64 = 0.01..=100.0;
        ACROSS_SHARE: f64 = 1e-3..=1.0;
        START_VELOCITY_SIGMA_PER_S: f64 = 1e-4..=10.0;
    }

    fn validate(&self, keys: &MotionKeys) -> Result<(), ranges::OutOfRange> {
        ranges::check_range(keys[0], self.acceleration_sigma_per_s2, Self::ACCELERATION_SIGMA_PER_S2)?;
        ranges::check_range(keys[1], self.correlation_time_s, Self::CORRELATION_TIME_S)?;
        ranges::check_range(keys[2], self.across_share, Self::ACROSS_SHARE)?;
        ranges::check_range(keys[3], self.start_velocity_sigma_per_s, Self::START_VELOCITY_SIGMA_PER_S)?;
        let Some(rest) = &self.rest else { return Ok(()) };
        ranges::check_range(keys[4], rest.drift_sigma_per_sqrt_s, RestConfig::DRIFT_SIGMA_PER_SQRT_S)?;
        ranges::check_range(keys[5], rest.onset_velocity_sigma_per_s, RestConfig::ONSET_VELOCITY_SIGMA_PER_S)?;
        ranges::check_range(keys[6], rest.mean_rest_s, RestConfig::MEAN_REST_S)?;
        ranges::check_range(keys[7], rest.mean_motion_s, RestConfig::MEAN_MOTION_S)
    }
}

impl RestConfig {
    ranges! {
        DRIFT_SIGMA_PER_SQRT_S: f64 = 1e-7..=0.1;
        ONSET_VELOCITY_SIGMA_PER_S: f64 = 1e-6..=10.0;
        MEAN_REST_S: f64 = 0.1..=1000.0;
        MEAN_MOTION_S: f64 = 0.1..=1000.0;
    }
}

impl MeasurementConfig {
    ranges! {
        fn validate "target_state.measurement.";
        covariance_factor, COVARIANCE_FACTOR: f64 = 0.01..=1000.0;
        position_sigma_min_m, POSITION_SIGMA_MIN_M: f64 = 1e-6..=0.1;
        orientation_sigma_min_rad, ORIENTATION_SIGMA_MIN_RAD: f64 = 1e-6..=0.5;
    }
}

impl SurpriseConfig {
    ranges! {
        fn validate "target_state.surprise.";
        newest_share, NEWEST_SHARE: f64 = 0.01..=1.0;
        from, FROM: f64 = 1.0..=100.0;
        exponent, EXPONENT: f64 = 0.0..=8.0;
        factor_max, FACTOR_MAX: f64 = 1.0..=1e6;
    }

    /// Factor on the variances.
    pub(super) fn noise_factor(&self, surprise: f64) -> f64 {
        (surprise / self.from).max(1.0).powf(self.exponent).min(self.factor_max)
    }
}
