//! Visual-servo controller and supervisor: a pure `step(inputs, now)` without camera, arm, clock or thread.
//! Time and data come from the caller.
//!
//! * [`Servo::step`] is the entry point: one control cycle of controller and supervisor, and the command for the arm.
//! * [`Controller::step`] returns a [`Command`] and the [`Mode`], with the reason if the arm holds.
//! * [`TargetObservation`] is the output of the estimator: pose of the model and time of exposure.
//! * [`supervisor::Supervisor::step`] permits or inhibits the motion, with the reason and the remedy.
//! * [`ControllerConfig`] holds all parameters; [`Controller::new`] rejects bad ones with key, value and allowed range.
//!
//! Data flow: the [`joint_history`] gives the pose of the hand at the time of exposure. With it the observation is transformed to
//! `base`, gated, and fused into a predictable state ([`target_state`]) or smoothed ([`target_filter`]). The [`law`] turns the
//! error of the hand into a twist, the [`resolved_rate`] turns the twist into joint velocities within the limits, and the
//! [`redundancy`] adds the null motion.

pub mod config;
pub mod config_error;
pub mod controller;
pub mod given_commands;
mod held_directions;
pub mod identification;
pub mod joint_history;
mod known_target;
mod late_images;
pub mod law;
pub mod redundancy;
pub mod resolved_rate;
pub mod search;
pub mod servo;
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
pub use servo::{Servo, ServoInput, ServoStep};
pub use target_filter::{ObservationVerdict, TargetObservation};
pub use target_state::{
    Acceleration, MeasurementConfig, MeasurementVerdict, MotionConfig, NotPredictable, PoseMeasurement, Prediction,
    RestConfig, SurpriseConfig, TargetState, TargetStateConfig,
};

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
mod readme {}
