//! Parameters of the controller and their check.

mod laws;

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Flange, Frame, Hand, Model};

use crate::config_error::{ConfigError, check};
use crate::search::SearchConfig;

pub use laws::{
    ArmResponse, FeedForwardConfig, FeedForwardGains, Gains, HybridConfig, ImageBasedConfig, LawConfig,
    PublishedConfig, RedundancyConfig, TargetFilterConfig, UnstatedCovariance,
};

/// All parameters of [`crate::Controller::new`] except those of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControllerConfig {
    /// Desired pose of the hand relative to the target (eq. 11 of the paper: translation (0, 0, -0.5) m, no rotation).
    pub model_from_hand_desired: Pose<Model, Hand>,
    /// Mounting of the left camera on the hand, from the hand-eye calibration.
    pub hand_from_cam_left: Pose<Hand, CamLeft>,
    /// Mounting of the hand on the flange.
    pub flange_from_hand: Pose<Flange, Hand>,
    /// The control law, and its use of the observations.
    pub law: LawConfig,
    /// Behaviour near singular poses.
    pub damping: DampingConfig,
    /// Speed limits of hand and joints.
    pub speed: SpeedConfig,
    /// Motion from the initialisation of the target to the desired pose.
    pub approach: ApproachConfig,
    /// Time-outs for old data.
    pub timeouts: Timeouts,
    /// Search motion for a lost target; `None`: the hand holds.
    pub search: Option<SearchConfig>,
    /// Number of stored joint samples, 8 to 10000: more than the control cycles between an exposure and the arrival of its
    /// estimate.
    pub joint_history_samples: usize,
}

/// Behaviour near singular poses: damping of the pseudo-inverse of the Jacobian (metres and radians), and a bound of the elbow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DampingConfig {
    /// Singular value below which motion in its direction is damped, 0.001 to 0.5.
    pub threshold: f64,
    /// Damping factor at a singular value of zero, 0.001 to 0.5.
    pub factor_max: f64,
    /// Least angle of the elbow (fourth joint), rad, 0 to 0.5; 0: no bound. An arm that an unreachable target has pulled straight
    /// cannot come back, because no joint moves the wrist inwards in that pose.
    pub elbow_min_rad: f64,
}

impl Default for DampingConfig {
    /// Acts only nearer to singular poses than the experiments (0.05). With the elbow at its bound (5 degrees) the smallest
    /// singular value of a PA-10 is about 0.02.
    fn default() -> Self {
        Self { threshold: 0.04, factor_max: 0.04, elbow_min_rad: 0.09 }
    }
}

/// Speed of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CartesianSpeed {
    /// Of the hand's origin, m/s, above 0 to 2.
    pub linear_m_per_s: f64,
    /// Angular speed, rad/s, above 0 to 6.
    pub angular_rad_per_s: f64,
}

impl CartesianSpeed {
    /// Interpolates linearly to other speeds.
    pub(crate) fn towards(&self, other: &Self, share: f64) -> Self {
        let between = |own: f64, other: f64| own + (other - own) * share;
        Self {
            linear_m_per_s: between(self.linear_m_per_s, other.linear_m_per_s),
            angular_rad_per_s: between(self.angular_rad_per_s, other.angular_rad_per_s),
        }
    }
}

/// Speed limits of the hand, and of joints near their limits. There are no defaults: these are safety limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedConfig {
    /// Speed limit of the hand while it follows the target.
    pub tracking: CartesianSpeed,
    /// Largest joint speed towards a limit per remaining angle, 1/s, 0.1 to 20.
    pub limit_approach_per_s: f64,
    /// Time over which the hand speeds up after a hold, seconds, 0 to 10.
    pub soft_start_s: f64,
}

/// Motion from the initialisation of the target to the desired pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ApproachConfig {
    /// Speed limit of the hand in this motion.
    pub speed: CartesianSpeed,
    /// Position error that ends the approach, metres, 0.0001 to 1.
    pub done_within_m: f64,
    /// Orientation error that ends the approach, radians, 0.001 to 1.
    pub done_within_rad: f64,
}

/// Time-outs for old data. There are no defaults: these are safety limits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timeouts {
    /// Age of the newest accepted observation at which the hand holds, seconds, 0.02 to 5.
    pub observation_s: f64,
    /// Age of the newest accepted observation at which the target is lost, seconds, `observation_s` to 60.
    pub lost_s: f64,
    /// Age of the joint sample at which the hand holds; also the longest gap between two joint samples for interpolation. Seconds,
    /// 0.002 to 0.5.
    pub joints_s: f64,
}

impl ControllerConfig {
    /// Checks every number.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check_pose("model_from_hand_desired", &self.model_from_hand_desired)?;
        check_pose("hand_from_cam_left", &self.hand_from_cam_left)?;
        check_pose("flange_from_hand", &self.flange_from_hand)?;
        self.law.validate()?;
        check("damping.threshold", self.damping.threshold, 1e-3, 0.5, "0.001 to 0.5")?;
        check("damping.factor_max", self.damping.factor_max, 1e-3, 0.5, "0.001 to 0.5")?;
        check("damping.elbow_min_rad", self.damping.elbow_min_rad, 0.0, 0.5, "0 to 0.5 rad")?;
        self.speed.validate()?;
        self.approach.validate()?;
        self.timeouts.validate()?;
        self.search.iter().try_for_each(SearchConfig::validate)?;
        if let LawConfig::FeedForward(law) = &self.law {
            let (horizon_s, least_s) = (law.target.horizon_s, self.timeouts.observation_s);
            check("target_state.horizon_s", horizon_s, least_s, f64::INFINITY, "timeouts.observation_s or more")?;
        }
        check("joint_history_samples", self.joint_history_samples as f64, 8.0, 1e4, "8 to 10000")
    }
}

impl SpeedConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        let CartesianSpeed { linear_m_per_s, angular_rad_per_s } = self.tracking;
        check("speed.tracking.linear_m_per_s", linear_m_per_s, TINY, 2.0, "above 0 to 2 m/s")?;
        check("speed.tracking.angular_rad_per_s", angular_rad_per_s, TINY, 6.0, "above 0 to 6 rad/s")?;
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

fn check_pose<A: Frame, B: Frame>(key: &'static str, pose: &Pose<A, B>) -> Result<(), ConfigError> {
    let value = pose.translation_m().norm();
    let allowed = "finite numbers, at most 5 m from origin to origin";
    if pose.is_finite() && value <= 5.0 { Ok(()) } else { Err(ConfigError { key, value, allowed }) }
}
