//! What each control law needs.

use super::TINY;
use crate::config_error::{ConfigError, check};
use crate::target_state::TargetStateConfig;

/// Which law leads the hand, with its numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "one per controller, and configurations are copied")]
pub enum LawConfig {
    /// Feed-forward of the target's velocity and compensation of the delays, see [`crate::law::feed_forward`].
    FeedForward(FeedForwardConfig),
    /// The law of the paper's group, see [`crate::law::pose_based`].
    Published(PublishedConfig),
    /// Points of the model led through the image, see [`crate::law::image_based`].
    ImageBased(ImageBasedConfig),
    /// One point and its depth in the image, and the turn that is left, see [`crate::law::hybrid`].
    Hybrid(HybridConfig),
}

/// Classical image-based servoing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageBasedConfig {
    /// Share of the error in the image that is taken away per second, 1/s, 0 (exclusive) to 50.
    pub gain_per_s: f64,
    /// The points are the corners of a square of the model, this far to either side of its origin, metres, 0.001 to 1.
    pub half_width_m: f64,
    /// Gate and smoothing of the observations.
    pub target_filter: TargetFilterConfig,
}

/// 2 1/2-D servoing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HybridConfig {
    /// Share of the errors that is taken away per second, 1/s, 0 (exclusive) to 50.
    pub gain_per_s: f64,
    /// Gate and smoothing of the observations.
    pub target_filter: TargetFilterConfig,
}

/// The law with feed-forward: what is known of the arm, gains, and what is known of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardConfig {
    /// From a command to its effect.
    pub arm: ArmResponse,
    /// Gains, and how hard errors are braked away.
    pub gains: FeedForwardGains,
    /// How the target moves, and how far observations are believed.
    pub target: TargetStateConfig,
    /// Observations that are accepted before the hand moves, 1 to 1000.
    pub observations_to_lock: u32,
    /// How sure an observation is if the estimator does not say.
    pub unstated: UnstatedCovariance,
    /// What the seventh joint is used for.
    pub redundancy: RedundancyConfig,
}

/// How the joints answer a velocity command: after a dead time, with a first-order lag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmResponse {
    /// From a command to the beginning of its effect, seconds, 0 to 0.5.
    pub delay_s: f64,
    /// Time constant with which the velocity then follows, seconds, 0 to 0.5.
    pub lag_s: f64,
}

impl ArmResponse {
    /// Share of delay and lag that may be unknown.
    pub const UNKNOWN_SHARE: f64 = 0.5;
    /// Largest gain of the errors, 1/s, that is used however quick an arm is.
    pub const GAIN_MAX_PER_S: f64 = 20.0;

    /// The largest gain, 1/s, that is free of overshoot if a share of delay and lag is not compensated: 1 / (e T), see
    /// [`Gains::without_overshoot`], where T is [`Self::UNKNOWN_SHARE`] of both; at most [`Self::GAIN_MAX_PER_S`].
    pub fn gain_without_overshoot(&self) -> f64 {
        let unknown_s = Self::UNKNOWN_SHARE * (self.delay_s + self.lag_s);
        (1.0 / (std::f64::consts::E * unknown_s)).min(Self::GAIN_MAX_PER_S)
    }
}

/// Gains of the law with feed-forward. Errors are metres and angles: equal gains are equally fast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardGains {
    /// Hand speed per position error, 1/s, 0 (exclusive) to 50.
    pub position_per_s: f64,
    /// Angular speed per angle, 1/s, 0 (exclusive) to 50.
    pub orientation_per_s: f64,
    /// Large errors are corrected no faster than can be braked with this, m/s^2, 0.01 to 20.
    pub linear_m_per_s2: f64,
    /// The same for angles, rad/s^2, 0.01 to 50.
    pub angular_rad_per_s2: f64,
}

impl FeedForwardGains {
    /// Gains for this arm, see [`ArmResponse::gain_without_overshoot`], and accelerations that a PA-10 has at 2 rad/s^2 of its
    /// first joints with the hand 0.6 m away.
    pub fn of(arm: &ArmResponse) -> Self {
        let gain = arm.gain_without_overshoot();
        Self { position_per_s: gain, orientation_per_s: gain, linear_m_per_s2: 0.8, angular_rad_per_s2: 1.6 }
    }
}

/// Standard deviations of observations of an estimator that does not state them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnstatedCovariance {
    /// Of the position across the viewing direction, metres, 1e-6 to 0.1.
    pub lateral_m: f64,
    /// Of the position along the model's normal, metres, 1e-6 to 0.1.
    pub depth_m: f64,
    /// Of the tilt, radians, 1e-5 to 1.
    pub tilt_rad: f64,
    /// Of the rotation about the model's normal, radians, 1e-5 to 1.
    pub about_normal_rad: f64,
}

impl Default for UnstatedCovariance {
    /// Of the published method on a colourful target at 500 mm, from its accuracy on rendered scenes.
    fn default() -> Self {
        Self { lateral_m: 0.001, depth_m: 0.002, tilt_rad: 0.05, about_normal_rad: 0.05 }
    }
}

/// What the seventh joint is used for, see [`crate::redundancy`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RedundancyConfig {
    /// Speed of the null motion (of all joints together) per slope of the cost, rad/s, 0 to 10.
    pub gain_rad_per_s: f64,
    /// Largest speed of the null motion, rad/s, 0 to 1; 0: the seventh joint is not used.
    pub speed_max_rad_per_s: f64,
}

impl Default for RedundancyConfig {
    /// Slow beside the motion of the hand.
    fn default() -> Self {
        Self { gain_rad_per_s: 0.2, speed_max_rad_per_s: 0.1 }
    }
}

/// The law of the paper's group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublishedConfig {
    /// Gains of the law.
    pub gains: Gains,
    /// Gate and smoothing of the observations.
    pub target_filter: TargetFilterConfig,
}

/// Gains of the law of the paper's group, see [`crate::law::pose_based`].
///
/// The orientation error of the law is the vector part of a quaternion, half the angle where that is small: for equal rates of
/// convergence `orientation_per_s` is twice `position_per_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// K_Pp: hand speed per position error, 1/s, 0 (exclusive) to 50. The hand trails a moving target by its inverse.
    pub position_per_s: f64,
    /// K_Vp: share of the rate of the position error that is added, 0 to 0.9.
    pub velocity: f64,
    /// K_Po: angular speed (rad/s) per vector part of the error quaternion, 1/s, 0 (exclusive) to 100.
    pub orientation_per_s: f64,
    /// K_Vo: share of the rate of the orientation error that is added, 0 to 0.9.
    pub angular_velocity: f64,
}

impl Gains {
    /// The largest gains without overshoot for a total delay from measured error to motion (1/(e T)), no velocity terms.
    ///
    /// `delay_s` counts what lies inside the loop. The pose of the target is kept in `base`, found with the joint angles at
    /// the time of exposure, so with exact calibration the camera's delay is outside; it is wise to count it all the same.
    pub fn without_overshoot(delay_s: f64) -> Self {
        let position_per_s = 1.0 / (std::f64::consts::E * delay_s);
        Self { position_per_s, velocity: 0.0, orientation_per_s: 2.0 * position_per_s, angular_velocity: 0.0 }
    }
}

impl Default for Gains {
    /// No gains are published. These are free of overshoot up to a total delay of 92 ms and trail by 0.25 s; velocity terms
    /// are off, because differentiated estimates of the published method are mostly noise.
    fn default() -> Self {
        Self { position_per_s: 4.0, velocity: 0.0, orientation_per_s: 8.0, angular_velocity: 0.0 }
    }
}

/// Gate and smoothing of the observations. The paper has neither; its hand wanders.
///
/// The observed pose of the model in `base` passes a first-order low-pass, position and orientation apart, because the
/// method's depth is good and its tilt is not: one degree of tilt moves the desired hand by 8.7 mm at 500 mm. A time
/// constant T divides white jitter of frames at an interval h by about sqrt(2 T / h) and lets the hand trail by T more. 0 is
/// no smoothing. The first observations are averaged, so that a lock does not start from a single one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetFilterConfig {
    /// Time constant for the position, seconds, 0 to 5.
    pub position_time_constant_s: f64,
    /// Time constant for the orientation, seconds, 0 to 5.
    pub orientation_time_constant_s: f64,
    /// An observation farther than this from the smoothed position is not used, metres, 0.001 to 10.
    pub gate_position_m: f64,
    /// An observation turned by more than this against the smoothed orientation is not used, radians, 0.01 to pi.
    pub gate_orientation_rad: f64,
    /// Observations in agreement (within the gate) before the hand moves, 1 to 1000.
    pub observations_to_lock: u32,
}

impl Default for TargetFilterConfig {
    /// For the published method on a target that moves by up to 0.1 m/s and 20 degrees/s.
    fn default() -> Self {
        Self {
            position_time_constant_s: 0.05,
            orientation_time_constant_s: 0.15,
            gate_position_m: 0.1,
            gate_orientation_rad: 0.6,
            observations_to_lock: 3,
        }
    }
}

impl LawConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        match self {
            Self::FeedForward(config) => config.validate(),
            Self::Published(config) => {
                config.gains.validate()?;
                config.target_filter.validate()
            }
            Self::ImageBased(config) => {
                check("image_based.gain_per_s", config.gain_per_s, TINY, 50.0, "above 0 to 50 1/s")?;
                check("image_based.half_width_m", config.half_width_m, 1e-3, 1.0, "0.001 to 1 m")?;
                config.target_filter.validate()
            }
            Self::Hybrid(config) => {
                check("hybrid.gain_per_s", config.gain_per_s, TINY, 50.0, "above 0 to 50 1/s")?;
                config.target_filter.validate()
            }
        }
    }
}

impl FeedForwardConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        check("feed_forward.arm.delay_s", self.arm.delay_s, 0.0, 0.5, "0 to 0.5 s")?;
        check("feed_forward.arm.lag_s", self.arm.lag_s, 0.0, 0.5, "0 to 0.5 s")?;
        self.gains.validate()?;
        self.target.validate()?;
        let to_lock = f64::from(self.observations_to_lock);
        check("feed_forward.observations_to_lock", to_lock, 1.0, 1000.0, "1 to 1000")?;
        self.unstated.validate()?;
        self.redundancy.validate()
    }
}

impl FeedForwardGains {
    fn validate(&self) -> Result<(), ConfigError> {
        check("feed_forward.gains.position_per_s", self.position_per_s, TINY, 50.0, "above 0 to 50 1/s")?;
        check("feed_forward.gains.orientation_per_s", self.orientation_per_s, TINY, 50.0, "above 0 to 50 1/s")?;
        check("feed_forward.gains.linear_m_per_s2", self.linear_m_per_s2, 0.01, 20.0, "0.01 to 20 m/s^2")?;
        check("feed_forward.gains.angular_rad_per_s2", self.angular_rad_per_s2, 0.01, 50.0, "0.01 to 50 rad/s^2")
    }
}

impl UnstatedCovariance {
    fn validate(&self) -> Result<(), ConfigError> {
        check("feed_forward.unstated.lateral_m", self.lateral_m, 1e-6, 0.1, "0.000001 to 0.1 m")?;
        check("feed_forward.unstated.depth_m", self.depth_m, 1e-6, 0.1, "0.000001 to 0.1 m")?;
        check("feed_forward.unstated.tilt_rad", self.tilt_rad, 1e-5, 1.0, "0.00001 to 1 rad")?;
        check("feed_forward.unstated.about_normal_rad", self.about_normal_rad, 1e-5, 1.0, "0.00001 to 1 rad")
    }
}

impl RedundancyConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        check("feed_forward.redundancy.gain_rad_per_s", self.gain_rad_per_s, 0.0, 10.0, "0 to 10 rad/s")?;
        check("feed_forward.redundancy.speed_max_rad_per_s", self.speed_max_rad_per_s, 0.0, 1.0, "0 to 1 rad/s")
    }
}

impl Gains {
    fn validate(&self) -> Result<(), ConfigError> {
        check("gains.position_per_s", self.position_per_s, TINY, 50.0, "above 0 to 50 1/s")?;
        check("gains.velocity", self.velocity, 0.0, 0.9, "0 to 0.9")?;
        check("gains.orientation_per_s", self.orientation_per_s, TINY, 100.0, "above 0 to 100 1/s")?;
        check("gains.angular_velocity", self.angular_velocity, 0.0, 0.9, "0 to 0.9")
    }
}

impl TargetFilterConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        let (position_s, orientation_s) = (self.position_time_constant_s, self.orientation_time_constant_s);
        check("target_filter.position_time_constant_s", position_s, 0.0, 5.0, "0 to 5 s")?;
        check("target_filter.orientation_time_constant_s", orientation_s, 0.0, 5.0, "0 to 5 s")?;
        check("target_filter.gate_position_m", self.gate_position_m, 1e-3, 10.0, "0.001 to 10 m")?;
        let pi = std::f64::consts::PI;
        check("target_filter.gate_orientation_rad", self.gate_orientation_rad, 0.01, pi, "0.01 to pi rad")?;
        let to_lock = f64::from(self.observations_to_lock);
        check("target_filter.observations_to_lock", to_lock, 1.0, 1000.0, "1 to 1000")
    }
}
