//! The visual-servo controller: where the target is, how the hand should move, and whether it may, as a pure
//! `step(joints, newest observation, now)`. No camera, no arm, no clock, no thread; time and data come from the caller.
//!
//! * [`Controller::step`] is the one entry: it returns a [`Command`] and the [`Mode`] with the reason why the arm rests.
//! * [`TargetObservation`] is what the estimator says: pose of the model and time of exposure.
//! * [`supervisor::Supervisor::step`] says whether the arm may do that, and if not, why and what to do.
//! * [`ControllerConfig`] holds all numbers; [`Controller::new`] refuses bad ones by key, value and allowed range.
//!
//! The way of a number: the hand's pose at the time of exposure comes from the [`joint_history`]; with it the observation is
//! carried to `base`, gated, and made part of a state that can be predicted ([`target_state`]), or smoothed ([`target_filter`]);
//! the [`law`] turns the error of the hand into a twist; the [`resolved_rate`] turns the twist into joint velocities within the
//! limits, and the [`redundancy`] adds what the seventh joint can do.

pub mod config;
pub mod config_error;
pub mod controller;
pub mod given_commands;
pub mod identification;
pub mod joint_history;
mod known_target;
pub mod law;
pub mod redundancy;
pub mod resolved_rate;
pub mod search;
pub mod supervisor;
pub mod target_filter;
pub mod target_state;

pub use crate::config_error::ConfigError;
pub use config::{
    ApproachConfig, ArmResponse, CartesianSpeed, ControllerConfig, DampingConfig, FeedForwardConfig, FeedForwardGains,
    Gains, HybridConfig, ImageBasedConfig, LawConfig, PublishedConfig, RedundancyConfig, SpeedConfig,
    TargetFilterConfig, Timeouts, UnstatedCovariance,
};
pub use controller::{Command, ControlStep, Controller, HoldReason, Mode};
pub use joint_history::{JointHistory, NotInHistory};
pub use resolved_rate::Limitation;
pub use search::SearchConfig;
pub use target_filter::{ObservationVerdict, TargetObservation};
pub use target_state::{
    Acceleration, MeasurementConfig, MeasurementVerdict, MotionConfig, NotPredictable, PoseMeasurement, Prediction,
    RestConfig, SurpriseConfig, TargetState, TargetStateConfig,
};
