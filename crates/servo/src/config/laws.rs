//! Parameters of the control laws.

use pb3dp_geometry::ranges;

use super::ABOVE_ZERO;
use crate::target_state::TargetStateConfig;

/// The control law with its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "one per controller, and configurations are copied")]
pub enum LawConfig {
    /// Feed-forward of the target's velocity and compensation of the delays, see [`crate::law::feed_forward`].
    FeedForward(FeedForwardConfig),
    /// The law of the paper's authors, see [`crate::law::pose_based`].
    Published(PublishedConfig),
    /// Image-based law, see [`crate::law::image_based`].
    ImageBased(ImageBasedConfig),
    /// 2 1/2-D law, see [`crate::law::hybrid`].
    Hybrid(HybridConfig),
}

/// Classical image-based servoing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageBasedConfig {
    /// Gain on the image error, 1/s, 0 (exclusive) to 50.
    pub gain_per_s: f64,
    /// The points are the corners of a square of the model, at this distance from its origin along each axis, metres, 0.001 to 1.
    pub half_width_m: f64,
    /// Gate and smoothing of the observations.
    pub target_filter: TargetFilterConfig,
}

/// 2 1/2-D servoing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HybridConfig {
    /// Gain on the errors, 1/s, 0 (exclusive) to 50.
    pub gain_per_s: f64,
    /// Gate and smoothing of the observations.
    pub target_filter: TargetFilterConfig,
}

/// The law with feed-forward: model of the arm, gains, and model of the target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardConfig {
    /// Response of the arm to a command.
    pub arm: ArmResponse,
    /// Gains, and decelerations for large errors.
    pub gains: FeedForwardGains,
    /// Motion model of the target and measurement noise.
    pub target: TargetStateConfig,
    /// Accepted observations before the hand moves, 1 to 1000.
    pub observations_to_lock: u32,
    /// Standard deviations if the estimator reports no covariance.
    pub unstated: UnstatedCovariance,
    /// Null motion.
    pub redundancy: RedundancyConfig,
}

/// Response of the joints to a velocity command: a dead time and a first-order lag.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmResponse {
    /// Dead time from a command to its effect, seconds, 0 to 0.5.
    pub delay_s: f64,
    /// Time constant of the velocity, seconds, 0 to 0.5.
    pub lag_s: f64,
}

impl ArmResponse {
    /// Assumed share of delay and lag that is unknown.
    pub const UNKNOWN_SHARE: f64 = 0.5;
    /// Upper bound of the gains, 1/s, for any arm.
    pub const GAIN_MAX_PER_S: f64 = 20.0;

    /// The largest gain without overshoot, 1/s, if a share of delay and lag is not compensated: 1 / (e T), see
    /// [`Gains::without_overshoot`], with T = [`Self::UNKNOWN_SHARE`] of both; at most [`Self::GAIN_MAX_PER_S`].
    pub fn gain_without_overshoot(&self) -> f64 {
        let unknown_s = Self::UNKNOWN_SHARE * (self.delay_s + self.lag_s);
        (1.0 / (std::f64::consts::E * unknown_s)).min(Self::GAIN_MAX_PER_S)
    }
}

/// Gains of the law with feed-forward. Errors are metres and angles: equal gains converge equally fast.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FeedForwardGains {
    /// Speed of the hand per position error, 1/s, 0 (exclusive) to 50.
    pub position_per_s: f64,
    /// Angular speed per angle, 1/s, 0 (exclusive) to 50.
    pub orientation_per_s: f64,
    /// Deceleration that limits the speed of large corrections, m/s^2, 0.01 to 20.
    pub linear_m_per_s2: f64,
    /// The same for angles, rad/s^2, 0.01 to 50.
    pub angular_rad_per_s2: f64,
}

impl FeedForwardGains {
    /// Gains for this arm, see [`ArmResponse::gain_without_overshoot`], and the accelerations of a PA-10 with 2 rad/s^2 at its
    /// first joints and the hand 0.6 m away.
    pub fn of(arm: &ArmResponse) -> Self {
        let gain = arm.gain_without_overshoot();
        Self { position_per_s: gain, orientation_per_s: gain, linear_m_per_s2: 0.8, angular_rad_per_s2: 1.6 }
    }
}

/// Standard deviations of observations without a covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnstatedCovariance {
    /// Of the position perpendicular to the viewing direction, metres, 1e-6 to 0.1.
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

/// Null motion of a redundant arm, see [`crate::redundancy`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RedundancyConfig {
    /// Speed of the null motion (of all joints together) per slope of the cost, rad/s, 0 to 10.
    pub gain_rad_per_s: f64,
    /// Speed limit of the null motion, rad/s, 0 to 1; 0: no null motion.
    pub speed_max_rad_per_s: f64,
}

impl Default for RedundancyConfig {
    /// Slow compared with the motion of the hand.
    fn default() -> Self {
        Self { gain_rad_per_s: 0.2, speed_max_rad_per_s: 0.1 }
    }
}

/// The law of the paper's authors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublishedConfig {
    /// Gains of the law.
    pub gains: Gains,
    /// Gate and smoothing of the observations.
    pub target_filter: TargetFilterConfig,
}

/// Gains of the law of the paper's authors, see [`crate::law::pose_based`].
///
/// The orientation error of this law is the vector part of a quaternion, half the angle for small angles. For equal rates of
/// convergence `orientation_per_s` is twice `position_per_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// K_Pp: hand speed per position error, 1/s, 0 (exclusive) to 50. The hand lags a moving target by its inverse.
    pub position_per_s: f64,
    /// K_Vp: share of the rate of the position error that is added, 0 to 0.9.
    pub velocity: f64,
    /// K_Po: angular speed (rad/s) per vector part of the error quaternion, 1/s, 0 (exclusive) to 100.
    pub orientation_per_s: f64,
    /// K_Vo: share of the rate of the orientation error that is added, 0 to 0.9.
    pub angular_velocity: f64,
}

impl Gains {
    /// The largest gains without overshoot for a total delay from measured error to motion (1/(e T)), without velocity terms.
    ///
    /// `delay_s` is the delay inside the loop. The target pose is stored in `base`, computed with the joint angles at the time of
    /// exposure, so with exact calibration the camera's delay is outside the loop; include it as a reserve.
    pub fn without_overshoot(delay_s: f64) -> Self {
        let position_per_s = 1.0 / (std::f64::consts::E * delay_s);
        Self { position_per_s, velocity: 0.0, orientation_per_s: 2.0 * position_per_s, angular_velocity: 0.0 }
    }
}

impl Default for Gains {
    /// No gains are published. These have no overshoot up to a total delay of 92 ms, and lag by 0.25 s. Velocity terms are off,
    /// because differentiated estimates of the published method are mostly noise.
    fn default() -> Self {
        Self { position_per_s: 4.0, velocity: 0.0, orientation_per_s: 8.0, angular_velocity: 0.0 }
    }
}

/// Gate and smoothing of the observations. The paper has neither; its hand position jitters.
///
/// Position and orientation of the model in `base` pass separate first-order low-pass filters, because the depth of the method is
/// accurate and its tilt is not: one degree of tilt moves the desired hand by 8.7 mm at 500 mm. A time constant T divides the white
/// jitter of frames at an interval h by about sqrt(2 T / h), and adds a lag of T. 0 disables smoothing. The first observations are
/// averaged, so that the target is not initialised from a single one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetFilterConfig {
    /// Time constant for the position, seconds, 0 to 5.
    pub position_time_constant_s: f64,
    /// Time constant for the orientation, seconds, 0 to 5.
    pub orientation_time_constant_s: f64,
    /// Position gate: distance from the smoothed position beyond which an observation is rejected, metres, 0.001 to 10.
    pub gate_position_m: f64,
    /// Orientation gate, radians, 0.01 to pi.
    pub gate_orientation_rad: f64,
    /// Consistent observations (within the gate) before the hand moves, 1 to 1000.
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
    pub(super) fn validate(&self) -> Result<(), ranges::OutOfRange> {
        match self {
            Self::FeedForward(config) => config.validate(),
            Self::Published(config) => {
                config.gains.validate()?;
                config.target_filter.validate()
            }
            Self::ImageBased(config) => config.validate(),
            Self::Hybrid(config) => config.validate(),
        }
    }
}

impl ImageBasedConfig {
    ranges! {
        fn check_ranges "image_based.";
        gain_per_s, GAIN_PER_S: f64 = ABOVE_ZERO..=50.0;
        half_width_m, HALF_WIDTH_M: f64 = 1e-3..=1.0;
    }

    fn validate(&self) -> Result<(), ranges::OutOfRange> {
        self.check_ranges()?;
        self.target_filter.validate()
    }
}

impl HybridConfig {
    ranges! {
        fn check_ranges "hybrid.";
        gain_per_s, GAIN_PER_S: f64 = ABOVE_ZERO..=50.0;
    }

    fn validate(&self) -> Result<(), ranges::OutOfRange> {
        self.check_ranges()?;
        self.target_filter.validate()
    }
}

impl ArmResponse {
    ranges! {
        fn validate "feed_forward.arm.";
        delay_s, DELAY_S: f64 = 0.0..=0.5;
        lag_s, LAG_S: f64 = 0.0..=0.5;
    }
}

impl FeedForwardConfig {
    ranges! {
        fn check_ranges "feed_forward.";
        observations_to_lock, OBSERVATIONS_TO_LOCK: u32 = 1..=1000;
    }

    fn validate(&self) -> Result<(), ranges::OutOfRange> {
        self.arm.validate()?;
        self.gains.validate()?;
        self.target.validate()?;
        self.check_ranges()?;
        self.unstated.validate()?;
        self.redundancy.validate()
    }
}

impl FeedForwardGains {
    ranges! {
        fn validate "feed_forward.gains.";
        position_per_s, POSITION_PER_S: f64 = ABOVE_ZERO..=50.0;
        orientation_per_s, ORIENTATION_PER_S: f64 = ABOVE_ZERO..=50.0;
        linear_m_per_s2, LINEAR_M_PER_S2: f64 = 0.01..=20.0;
        angular_rad_per_s2, ANGULAR_RAD_PER_S2: f64 = 0.01..=50.0;
    }
}

impl UnstatedCovariance {
    ranges! {
        fn validate "feed_forward.unstated.";
        lateral_m, LATERAL_M: f64 = 1e-6..=0.1;
        depth_m, DEPTH_M: f64 = 1e-6..=0.1;
        tilt_rad, TILT_RAD: f64 = 1e-5..=1.0;
        about_normal_rad, ABOUT_NORMAL_RAD: f64 = 1e-5..=1.0;
    }
}

impl RedundancyConfig {
    ranges! {
        fn validate "feed_forward.redundancy.";
        gain_rad_per_s, GAIN_RAD_PER_S: f64 = 0.0..=10.0;
        speed_max_rad_per_s, SPEED_MAX_RAD_PER_S: f64 = 0.0..=1.0;
    }
}

impl Gains {
    ranges! {
        fn validate "gains.";
        position_per_s, POSITION_PER_S: f64 = ABOVE_ZERO..=50.0;
        velocity, VELOCITY: f64 = 0.0..=0.9;
        orientation_per_s, ORIENTATION_PER_S: f64 = ABOVE_ZERO..=100.0;
        angular_velocity, ANGULAR_VELOCITY: f64 = 0.0..=0.9;
    }
}

impl TargetFilterConfig {
    ranges! {
        fn validate "target_filter.";
        position_time_constant_s, POSITION_TIME_CONSTANT_S: f64 = 0.0..=5.0;
        orientation_time_constant_s, ORIENTATION_TIME_CONSTANT_S: f64 = 0.0..=5.0;
        gate_position_m, GATE_POSITION_M: f64 = 1e-3..=10.0;
        gate_orientation_rad, GATE_ORIENTATION_RAD: f64 = 0.01..=std::f64::consts::PI;
        observations_to_lock, OBSERVATIONS_TO_LOCK: u32 = 1..=1000;
    }
}
