//! All numbers of the controller, and the check that refuses bad ones.

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Flange, Frame, Hand, Model};

/// Everything that [`crate::Controller::new`] needs besides the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerConfig {
    /// Where the hand shall be before the target (eq. 11 of the paper: translation (0, 0, -0.5) m, no rotation).
    pub model_from_hand_desired: Pose<Model, Hand>,
    /// Mounting of the left camera on the hand, from the hand-eye calibration.
    pub hand_from_cam_left: Pose<Hand, CamLeft>,
    /// Mounting of the hand on the flange.
    pub flange_from_hand: Pose<Flange, Hand>,
    /// Gains of the law.
    pub gains: Gains,
    /// Gate and smoothing of the observations.
    pub target_filter: TargetFilterConfig,
    /// Behaviour near singular poses.
    pub damping: DampingConfig,
    /// How fast hand and joints may move.
    pub speed: SpeedConfig,
    /// The way to the first contact with the desired pose.
    pub approach: ApproachConfig,
    /// How long old data is used.
    pub timeouts: Timeouts,
    /// What happens after the target was lost.
    pub after_loss: AfterLoss,
    /// Joint samples that are kept to find the hand's pose at the time of exposure, 8 to 10000: more than the number of
    /// control cycles between an exposure and the arrival of its estimate.
    pub joint_history_samples: usize,
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

/// Damping of the pseudo-inverse of the Jacobian (metres and radians).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DampingConfig {
    /// Singular value below which motion along its direction is damped, 0.001 to 0.5.
    pub threshold: f64,
    /// Damping factor where the singular value is zero, 0.001 to 0.5.
    pub factor_max: f64,
}

impl Default for DampingConfig {
    /// Acts only nearer to singular poses than the experiments go (0.05).
    fn default() -> Self {
        Self { threshold: 0.04, factor_max: 0.04 }
    }
}

/// Speed of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CartesianSpeed {
    /// Of the hand's origin, m/s, above 0 to 2.
    pub linear_m_per_s: f64,
    /// Angular, rad/s, above 0 to 6.
    pub angular_rad_per_s: f64,
}

/// How fast hand and joints may move. There are no defaults: these are safety limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedConfig {
    /// Largest speed of the hand while it follows.
    pub tracking: CartesianSpeed,
    /// Share of the joints' speed limits that may be used, above 0 to 1.
    pub joint_speed_scale: f64,
    /// A joint approaches an end of its range at most with this rate times the remaining angle, 1/s, 0.1 to 20.
    pub limit_approach_per_s: f64,
    /// Time in which the hand gets up to speed after rest, seconds, 0 to 10.
    pub soft_start_s: f64,
}

/// The way from the lock to the first contact with the desired pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachConfig {
    /// Largest speed of the hand on this way.
    pub speed: CartesianSpeed,
    /// The approach has ended when the hand is this near, metres, 0.0001 to 1.
    pub done_within_m: f64,
    /// The approach has ended when the hand is turned by less than this, radians, 0.001 to 1.
    pub done_within_rad: f64,
}

/// How long old data is used. There are no defaults: these are safety limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timeouts {
    /// The hand rests when the newest accepted observation was exposed longer ago than this, seconds, 0.02 to 5.
    pub observation_s: f64,
    /// The target counts as lost when it was exposed longer ago than this, seconds, `observation_s` to 60.
    pub lost_s: f64,
    /// The hand rests when the joints were measured longer ago than this; also the longest gap between two joint samples
    /// that is interpolated. Seconds, 0.002 to 0.5.
    pub joints_s: f64,
}

/// What happens after the target was lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AfterLoss {
    /// Nothing moves until [`crate::Controller::acquire`] is called.
    WaitForOperator,
    /// The next trusted observations are locked on to, and the hand approaches again.
    Reacquire,
}

/// A number of the configuration that is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("servo setting {key} is {value}: allowed is {allowed}")]
pub struct ConfigError {
    /// Name of the setting as a path of field names.
    pub key: &'static str,
    /// Its value.
    pub value: f64,
    /// What is allowed.
    pub allowed: &'static str,
}

impl ControllerConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// The first setting that is out of its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check_pose("model_from_hand_desired", &self.model_from_hand_desired)?;
        check_pose("hand_from_cam_left", &self.hand_from_cam_left)?;
        check_pose("flange_from_hand", &self.flange_from_hand)?;
        self.gains.validate()?;
        self.target_filter.validate()?;
        check("damping.threshold", self.damping.threshold, 1e-3, 0.5, "0.001 to 0.5")?;
        check("damping.factor_max", self.damping.factor_max, 1e-3, 0.5, "0.001 to 0.5")?;
        self.speed.validate()?;
        self.approach.validate()?;
        self.timeouts.validate()?;
        check("joint_history_samples", self.joint_history_samples as f64, 8.0, 1e4, "8 to 10000")
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

impl SpeedConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        let CartesianSpeed { linear_m_per_s, angular_rad_per_s } = self.tracking;
        check("speed.tracking.linear_m_per_s", linear_m_per_s, TINY, 2.0, "above 0 to 2 m/s")?;
        check("speed.tracking.angular_rad_per_s", angular_rad_per_s, TINY, 6.0, "above 0 to 6 rad/s")?;
        check("speed.joint_speed_scale", self.joint_speed_scale, TINY, 1.0, "above 0 to 1")?;
        check("speed.limit_approach_per_s", self.limit_approach_per_s, 0.1, 20.0, "0.1 to 20 1/s")?;
        check("speed.soft_start_s", self.soft_start_s, 0.0, 10.0, "0 to 10 s")
    }
}

impl ApproachConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        let CartesianSpeed { linear_m_per_s, angular_rad_per_s } = self.speed;
        check("approach.speed.linear_m_per_s", linear_m_per_s, TINY, 2.0, "above 0 to 2 m/s")?;
        check("approach.speed.angular_rad_per_s", angular_rad_per_s, TINY, 6.0, "above 0 to 6 rad/s")?;
        check("approach.done_within_m", self.done_within_m, 1e-4, 1.0, "0.0001 to 1 m")?;
        check("approach.done_within_rad", self.done_within_rad, 1e-3, 1.0, "0.001 to 1 rad")
    }
}

impl Timeouts {
    fn validate(&self) -> Result<(), ConfigError> {
        check("timeouts.observation_s", self.observation_s, 0.02, 5.0, "0.02 to 5 s")?;
        check("timeouts.lost_s", self.lost_s, self.observation_s, 60.0, "observation_s to 60 s")?;
        check("timeouts.joints_s", self.joints_s, 0.002, 0.5, "0.002 to 0.5 s")
    }
}

const TINY: f64 = 1e-6;

pub(crate) fn check(
    key: &'static str,
    value: f64,
    min: f64,
    max: f64,
    allowed: &'static str,
) -> Result<(), ConfigError> {
    if value >= min && value <= max { Ok(()) } else { Err(ConfigError { key, value, allowed }) }
}

fn check_pose<A: Frame, B: Frame>(key: &'static str, pose: &Pose<A, B>) -> Result<(), ConfigError> {
    let value = pose.translation_m().norm();
    let allowed = "finite numbers, at most 5 m from origin to origin";
    if pose.is_finite() && value <= 5.0 { Ok(()) } else { Err(ConfigError { key, value, allowed }) }
}
