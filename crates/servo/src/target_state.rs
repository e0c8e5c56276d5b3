//! Pose and motion of the target: an error-state Kalman filter on SE(3), in `base`.
//!
//! State: pose of the model, velocity and acceleration of the model's origin, angular velocity and acceleration of the model.
//! The linear and the angular part are each in motion (Singer's model of a correlated acceleration) or at rest. The filter weights
//! these four hypotheses by their likelihood, see [`TargetStateConfig`] and `docs/servo.md`.
//!
//! [`TargetState::observe`] adds measured poses with their time of exposure, in any order; [`TargetState::at`] predicts the target.
//! Neither allocates.

use std::collections::VecDeque;

use nalgebra::{Matrix6, Vector3};
use pb3dp_geometry::frames::{Base, Frame, Model};
use pb3dp_geometry::{MonotonicTime, Pose, Twist, se3};

use crate::config_error::ConfigError;

mod bank;
mod config;
mod gaussian;
mod measurement;
mod motion;

use bank::{Bank, Correction, Mixture};
pub use config::{MeasurementConfig, MotionConfig, RestConfig, SurpriseConfig, TargetStateConfig};
use measurement::BaseMeasurement;
pub use measurement::PoseMeasurement;

/// What happened to a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MeasurementVerdict {
    /// The first measurement, or one after a long gap: it initialises the target.
    Began,
    /// Used in the state.
    Accepted {
        /// Squared Mahalanobis distance from the prediction, 6 degrees of freedom.
        nis: f64,
    },
    /// Outside the gate. It is kept, and used if a late measurement makes it consistent.
    Outlier {
        /// Squared Mahalanobis distance from the prediction, 6 degrees of freedom.
        nis: f64,
    },
    /// Older than the history.
    TooOld,
    /// There is already a measurement with this time.
    Duplicate,
    /// The pose contains a number that is not finite.
    NotFinite,
    /// The covariance is not finite, not symmetric or not positive semidefinite.
    BadCovariance,
}

/// Why there is no prediction.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NotPredictable {
    /// There is no measurement yet.
    #[error("no measurement of the target yet")]
    NoTarget,
    /// The time is before the history.
    #[error("the time is {behind_s:.3} s before the oldest stored measurement")]
    TooOld {
        /// Time before the oldest measurement, seconds.
        behind_s: f64,
    },
    /// The time is too far after the newest measurement.
    #[error("the time is {ahead_s:.3} s after the newest measurement, the horizon is {horizon_s:.3} s")]
    TooFar {
        /// Time after the newest measurement, seconds.
        ahead_s: f64,
        /// Allowed time, seconds.
        horizon_s: f64,
    },
}

/// Linear and angular acceleration of a rigid body, expressed in frame `In`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Acceleration<In: Frame> {
    /// Of the origin of the moving frame, m/s^2.
    pub linear_m_per_s2: Vector3<f64>,
    /// Angular, rad/s^2.
    pub angular_rad_per_s2: Vector3<f64>,
    frame: std::marker::PhantomData<In>,
}

/// State of the target at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// The time.
    pub at: MonotonicTime,
    /// Pose of the model.
    pub base_from_model: Pose<Base, Model>,
    /// Velocity of the model's origin, and angular velocity of the model.
    pub twist: Twist<Base>,
    /// Acceleration of the model's origin, and angular acceleration of the model.
    pub acceleration: Acceleration<Base>,
    /// Covariance of `xi = [rho; phi]` (metres, radians; axes of `model`) in `true = predicted * exp(xi)`.
    pub covariance: Matrix6<f64>,
    /// Probability that the model's origin is in motion, 0 to 1.
    pub linear_motion: f64,
    /// Probability that the model is turning, 0 to 1.
    pub angular_motion: f64,
}

/// The filter.
#[derive(Clone, Debug)]
pub struct TargetState {
    config: TargetStateConfig,
    /// In the order of exposure, each with the state after it.
    history: VecDeque<Entry>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Entry {
    measured: BaseMeasurement,
    bank: Bank,
    verdict: MeasurementVerdict,
    outliers_in_a_row: u32,
}

impl TargetState {
    /// Creates a filter without a target and allocates all memory.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn new(config: TargetStateConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self { config, history: VecDeque::with_capacity(config.history_measurements) })
    }

    /// Adds a measurement. A late one is inserted at its time, and the newer ones are processed again: the state equals that of
    /// ordered measurements. Never blocks, never allocates.
    pub fn observe(&mut self, measurement: &PoseMeasurement) -> MeasurementVerdict {
        if !measurement.base_from_model.is_finite() {
            return MeasurementVerdict::NotFinite;
        }
        let Some(measured) = BaseMeasurement::new(&self.config.measurement, measurement) else {
            return MeasurementVerdict::BadCovariance;
        };
        let Some(newest_at) = self.newest_at() else { return self.begin(measured) };
        if measured.at.seconds_since(newest_at) > self.config.gap_max_s {
            return self.begin(measured);
        }
        let place = self.history.partition_point(|entry| entry.measured.at < measured.at);
        if self.history.get(place).is_some_and(|entry| entry.measured.at == measured.at) {
            return MeasurementVerdict::Duplicate;
        }
        self.insert(place, measured)
    }

    /// Drops the target.
    pub fn clear(&mut self) {
        self.history.clear();
    }

    /// State of the target at a time, also before the newest measurement. Changes nothing, never allocates.
    ///
    /// # Errors
    /// If there is no measurement, or the time is before the history or beyond the horizon.
    pub fn at(&self, time: MonotonicTime) -> Result<Prediction, NotPredictable> {
        let (bank, ahead_s) = self.known_at(time)?;
        Ok(Prediction::new(time, &bank.mixture(&self.config, ahead_s)))
    }

    /// The pose of [`Self::at`] only, at a fraction of the cost.
    ///
    /// # Errors
    /// As [`Self::at`].
    pub fn base_from_model_at(&self, time: MonotonicTime) -> Result<Pose<Base, Model>, NotPredictable> {
        let (bank, ahead_s) = self.known_at(time)?;
        Ok(bank.pose_after(&self.config, ahead_s))
    }

    /// The newest state before a time, and its age, seconds.
    fn known_at(&self, time: MonotonicTime) -> Result<(&Bank, f64), NotPredictable> {
        let behind = self.history.partition_point(|entry| entry.measured.at <= time);
        let Some(entry) = behind.checked_sub(1).and_then(|before| self.history.get(before)) else {
            let oldest = self.history.front().ok_or(NotPredictable::NoTarget)?;
            return Err(NotPredictable::TooOld { behind_s: oldest.measured.at.seconds_since(time) });
        };
        let (ahead_s, horizon_s) = (time.seconds_since(entry.measured.at), self.config.horizon_s);
        if behind == self.history.len() && ahead_s > horizon_s {
            return Err(NotPredictable::TooFar { ahead_s, horizon_s });
        }
        Ok((&entry.bank, ahead_s))
    }

    /// Time of the newest measurement, outliers included.
    pub fn newest_at(&self) -> Option<MonotonicTime> {
        self.history.back().map(|entry| entry.measured.at)
    }

    /// Time of the newest kept measurement that is used in the state.
    pub fn newest_accepted_at(&self) -> Option<MonotonicTime> {
        let accepted = self.history.iter().rev().find(|entry| entry.outliers_in_a_row == 0);
        accepted.map(|entry| entry.measured.at)
    }

    /// Number of consecutive outliers up to the newest measurement.
    pub fn consecutive_outliers(&self) -> u32 {
        self.history.back().map_or(0, |entry| entry.outliers_in_a_row)
    }

    fn begin(&mut self, measured: BaseMeasurement) -> MeasurementVerdict {
        self.history.clear();
        let verdict = MeasurementVerdict::Began;
        let bank = Bank::begin(&self.config, &measured);
        self.history.push_back(Entry { measured, bank, verdict, outliers_in_a_row: 0 });
        verdict
    }

    fn insert(&mut self, mut place: usize, measured: BaseMeasurement) -> MeasurementVerdict {
        let is_full = self.history.len() >= self.config.history_measurements;
        let Some(before) = place.checked_sub(1) else { return MeasurementVerdict::TooOld };
        if is_full && before == 0 && place < self.history.len() {
            return MeasurementVerdict::TooOld;
        }
        let Some(entry) = self.history.get(before).map(|before| self.next(before, measured)) else {
            return MeasurementVerdict::TooOld;
        };
        if entry.verdict == MeasurementVerdict::BadCovariance {
            return entry.verdict;
        }
        if is_full {
            self.history.pop_front();
            place -= 1;
        }
        self.history.insert(place, entry);
        for later in place + 1..self.history.len() {
            self.history[later] = self.next(&self.history[later - 1], self.history[later].measured);
        }
        entry.verdict
    }

    /// Processes the entry after another one.
    fn next(&self, before: &Entry, measured: BaseMeasurement) -> Entry {
        let dt_s = measured.at.seconds_since(before.measured.at);
        let predicted = before.bank.predicted(&self.config, dt_s);
        let (bank, correction) = predicted.corrected(&self.config, &measured);
        let verdict = match correction {
            Correction::Accepted { nis } => MeasurementVerdict::Accepted { nis },
            Correction::Outlier { nis } => MeasurementVerdict::Outlier { nis },
            Correction::Failed => MeasurementVerdict::BadCovariance,
        };
        let is_accepted = matches!(correction, Correction::Accepted { .. });
        let outliers_in_a_row = if is_accepted { 0 } else { before.outliers_in_a_row.saturating_add(1) };
        Entry { measured, bank, verdict, outliers_in_a_row }
    }
}

impl<In: Frame> Acceleration<In> {
    /// Asserts that both parts are expressed in `In`.
    pub fn new(linear_m_per_s2: Vector3<f64>, angular_rad_per_s2: Vector3<f64>) -> Self {
        Self { linear_m_per_s2, angular_rad_per_s2, frame: std::marker::PhantomData }
    }
}

impl Prediction {
    fn new(at: MonotonicTime, mixture: &Mixture) -> Self {
        let state = &mixture.state;
        let model_from_base = state.base_from_model.rotation_matrix().transpose();
        let mut covariance = Matrix6::zeros();
        for (row, column) in [(0, 0), (0, 3), (3, 0), (3, 3)] {
            let block =
                model_from_base * mixture.covariance.fixed_view::<3, 3>(row, column) * model_from_base.transpose();
            covariance.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        }
        let (linear, angular) = se3::split(&state.acceleration);
        Self {
            at,
            base_from_model: state.base_from_model,
            twist: Twist::from_vector(&state.rate),
            acceleration: Acceleration::new(linear, angular),
            covariance: (covariance + covariance.transpose()) * 0.5,
            linear_motion: mixture.linear_motion,
            angular_motion: mixture.angular_motion,
        }
    }

    /// Velocity of a frame fixed to the model, for example the desired hand: of its origin, and angular.
    pub fn twist_of<Fixed: Frame>(&self, model_from_fixed: &Pose<Model, Fixed>) -> Twist<Base> {
        let lever = self.base_from_model.transform_vector(&model_from_fixed.translation_m());
        let angular = self.twist.angular_rad_per_s;
        Twist::new(self.twist.linear_m_per_s + angular.cross(&lever), angular)
    }

    /// Acceleration of a frame fixed to the model: of its origin, and angular.
    pub fn acceleration_of<Fixed: Frame>(&self, model_from_fixed: &Pose<Model, Fixed>) -> Acceleration<Base> {
        let lever = self.base_from_model.transform_vector(&model_from_fixed.translation_m());
        let (velocity, angular) = (self.twist.angular_rad_per_s, self.acceleration.angular_rad_per_s2);
        let linear =
            self.acceleration.linear_m_per_s2 + angular.cross(&lever) + velocity.cross(&velocity.cross(&lever));
        Acceleration::new(linear, angular)
    }

    /// Covariance of the pose of a frame fixed to the model: of `xi = [rho; phi]` (metres, radians; axes of that frame) in `true =
    /// predicted * exp(xi)`.
    pub fn covariance_of<Fixed: Frame>(&self, model_from_fixed: &Pose<Model, Fixed>) -> Matrix6<f64> {
        let adjoint = model_from_fixed.inverse().adjoint();
        let covariance = adjoint * self.covariance * adjoint.transpose();
        (covariance + covariance.transpose()) * 0.5
    }
}
