//! State of the target in `base`, in the form that the configured law needs.

use nalgebra::{Matrix6, Vector6};
use pb3dp_geometry::frames::{Base, Hand, Model};
use pb3dp_geometry::{MonotonicTime, Pose, Twist};

use crate::config::{
    FeedForwardConfig, HybridConfig, ImageBasedConfig, LawConfig, PublishedConfig, TargetFilterConfig,
    UnstatedCovariance,
};
use crate::config_error::ConfigError;
use crate::target_filter::{ObservationVerdict, TargetObservation, TargetTrack};
use crate::target_state::{MeasurementVerdict, PoseMeasurement, Prediction, TargetState};

/// No target, or a target with its motion. All memory is allocated at construction.
#[derive(Clone, Debug)]
#[expect(clippy::large_enum_variant, reason = "one per controller")]
pub(crate) enum KnownTarget {
    /// Smoothed pose, for the laws without feed-forward.
    Smoothed {
        /// Gate and smoothing.
        config: TargetFilterConfig,
        /// The target, if there is one.
        track: Option<TargetTrack>,
    },
    /// Predictable state, for the law with feed-forward.
    Predicted {
        /// How observations are used.
        config: FeedForwardConfig,
        /// The target, if there is one.
        state: TargetState,
        /// Observations in the state since the target was first seen.
        observations: u32,
    },
}

impl KnownTarget {
    /// Starts without a target.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub(crate) fn none(law: &LawConfig) -> Result<Self, ConfigError> {
        Ok(match law {
            LawConfig::Published(PublishedConfig { target_filter, .. })
            | LawConfig::ImageBased(ImageBasedConfig { target_filter, .. })
            | LawConfig::Hybrid(HybridConfig { target_filter, .. }) => {
                Self::Smoothed { config: *target_filter, track: None }
            }
            LawConfig::FeedForward(law) => {
                Self::Predicted { config: *law, state: TargetState::new(law.target)?, observations: 0 }
            }
        })
    }

    /// Drops the target.
    pub(crate) fn forget(&mut self) {
        match self {
            Self::Smoothed { track, .. } => *track = None,
            Self::Predicted { state, observations, .. } => {
                state.clear();
                *observations = 0;
            }
        }
    }

    /// Whether there is a target.
    pub(crate) fn is_known(&self) -> bool {
        self.observed_at().is_some()
    }

    /// Time of the last accepted exposure.
    pub(crate) fn observed_at(&self) -> Option<MonotonicTime> {
        match self {
            Self::Smoothed { track, .. } => track.map(|track| track.observed_at()),
            Self::Predicted { state, .. } => state.newest_accepted_at(),
        }
    }

    /// Whether enough consistent observations were accepted.
    pub(crate) fn is_locked(&self) -> bool {
        match self {
            Self::Smoothed { config, track } => track.is_some_and(|track| track.is_locked(config)),
            Self::Predicted { config, observations, .. } => *observations >= config.observations_to_lock,
        }
    }

    /// Adds an observation with the pose `observed` in `base`.
    pub(crate) fn take(&mut self, observed: &Pose<Base, Model>, observation: &TargetObservation) -> ObservationVerdict {
        let is_locked = self.is_locked();
        match self {
            Self::Smoothed { config, track: Some(track) } => track.update(config, observed, observation.at),
            Self::Smoothed { track, .. } => {
                *track = Some(TargetTrack::begin(*observed, observation.at));
                ObservationVerdict::Accepted
            }
            Self::Predicted { config, state, observations } => {
                let measured = measurement(config, observed, observation);
                let mut verdict = state.observe(&measured);
                if matches!(verdict, MeasurementVerdict::Outlier { .. }) && !is_locked {
                    // Earlier observations do not count any more.
                    state.clear();
                    verdict = state.observe(&measured);
                }
                *observations = match verdict {
                    MeasurementVerdict::Began => 1,
                    MeasurementVerdict::Accepted { .. } => observations.saturating_add(1),
                    _ => *observations,
                };
                verdict_of(verdict, observation)
            }
        }
    }

    /// Pose of the target at a time: predicted or smoothed.
    pub(crate) fn base_from_model_at(&self, time: MonotonicTime) -> Option<Pose<Base, Model>> {
        match self {
            Self::Smoothed { track, .. } => track.map(|track| *track.base_from_model()),
            Self::Predicted { state, .. } => state.base_from_model_at(time).ok(),
        }
    }

    /// State of the target at a time, if it is predictable.
    pub(crate) fn at(&self, time: MonotonicTime) -> Option<Prediction> {
        match self {
            Self::Smoothed { .. } => None,
            Self::Predicted { state, .. } => state.at(time).ok(),
        }
    }

    /// Motion of the desired hand from one smoothed pose to the next.
    pub(crate) fn smoothed_twist(&self, model_from_hand_desired: &Pose<Model, Hand>) -> Twist<Base> {
        match self {
            Self::Smoothed { track: Some(track), .. } => track.hand_desired_twist(model_from_hand_desired),
            _ => Twist::zero(),
        }
    }
}

/// Measurement for the filter.
fn measurement(
    config: &FeedForwardConfig,
    observed: &Pose<Base, Model>,
    observation: &TargetObservation,
) -> PoseMeasurement {
    let covariance = observation.covariance.unwrap_or_else(|| unstated(&config.unstated));
    PoseMeasurement { at: observation.at, base_from_model: *observed, covariance }
}

fn unstated(sigma: &UnstatedCovariance) -> Matrix6<f64> {
    let sigma = Vector6::new(
        sigma.lateral_m,
        sigma.lateral_m,
        sigma.depth_m,
        sigma.tilt_rad,
        sigma.tilt_rad,
        sigma.about_normal_rad,
    );
    Matrix6::from_diagonal(&sigma.component_mul(&sigma))
}

fn verdict_of(verdict: MeasurementVerdict, observation: &TargetObservation) -> ObservationVerdict {
    match verdict {
        MeasurementVerdict::Began | MeasurementVerdict::Accepted { .. } => ObservationVerdict::Accepted,
        MeasurementVerdict::Outlier { nis } => ObservationVerdict::Outlier { distance_squared: nis },
        MeasurementVerdict::BadCovariance if observation.covariance.is_some() => ObservationVerdict::BadCovariance,
        MeasurementVerdict::BadCovariance | MeasurementVerdict::NotFinite => ObservationVerdict::NotFinite,
        MeasurementVerdict::TooOld | MeasurementVerdict::Duplicate => ObservationVerdict::NoneNew,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_stated_is_in_axes_of_the_model() {
        let sigma = UnstatedCovariance { lateral_m: 0.001, depth_m: 0.002, tilt_rad: 0.03, about_normal_rad: 0.04 };
        let covariance = unstated(&sigma);
        let expected = Vector6::new(1e-6, 1e-6, 4e-6, 9e-4, 9e-4, 1.6e-3);
        assert!((covariance - Matrix6::from_diagonal(&expected)).amax() < 1e-15);
    }
}
