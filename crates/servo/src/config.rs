//! Parameters of the controller and their check.

mod laws;

use std::ops::RangeInclusive;

use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Flange, Frame, Hand, Model};
use pb3dp_geometry::ranges;

use crate::config_error::{ConfigError, not_below};
use crate::search::SearchConfig;
use crate::target_state::TargetStateConfig;

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
    /// Largest distance between two frames on the arm, and between hand and target, metres.
    pub const LENGTH_MAX_M: f64 = 5.0;

    ranges! {
        fn check_ranges "";
        joint_history_samples, JOINT_HISTORY_SAMPLES: usize = 8..=10_000;
    }

    /// Checks every number.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        check_pose("model_from_hand_desired", &self.model_from_hand_desired)?;
        check_pose("hand_from_cam_left", &self.hand_from_cam_left)?;
        check_pose("flange_from_hand", &self.flange_from_hand)?;
        self.law.validate()?;
        self.damping.validate()?;
        self.speed.validate()?;
        self.approach.validate()?;
        self.timeouts.validate()?;
        self.search.iter().try_for_each(SearchConfig::validate)?;
        if let LawConfig::FeedForward(law) = &self.law {
            let allowed = TargetStateConfig::horizon_s_allowed(self.timeouts.observation_s);
            ranges::check_range("target_state.horizon_s", law.target.horizon_s, allowed)?;
        }
        Ok(self.check_ranges()?)
    }
}

impl DampingConfig {
    ranges! {
        fn validate "damping.";
        threshold, THRESHOLD: f64 = 1e-3..=0.5;
        factor_max, FACTOR_MAX: f64 = 1e-3..=0.5;
        elbow_min_rad, ELBOW_MIN_RAD: f64 = 0.0..=0.5;
    }
}

impl CartesianSpeed {
    ranges! {
        LINEAR_M_PER_S: f64 = ABOVE_ZERO..=2.0;
        ANGULAR_RAD_PER_S: f64 = ABOVE_ZERO..=6.0;
    }

    fn validate(&self, [linear, angular]: [&'static str; 2]) -> Result<(), ranges::OutOfRange> {
        ranges::check_range(linear, self.linear_m_per_s, Self::LINEAR_M_PER_S)?;
        ranges::check_range(angular, self.angular_rad_per_s, Self::ANGULAR_RAD_PER_S)
    }
}

impl SpeedConfig {
    ranges! {
        fn check_ranges "speed.";
        limit_approach_per_s, LIMIT_APPROACH_PER_S: f64 = 0.1..=20.0;
        soft_start_s, SOFT_START_S: f64 = 0.0..=10.0;
    }

    fn validate(&self) -> Result<(), ranges::OutOfRange> {
        self.tracking.validate(["speed.tracking.linear_m_per_s", "speed.tracking.angular_rad_per_s"])?;
        self.check_ranges()
    }
}

impl ApproachConfig {
    ranges! {
        fn check_ranges "approach.";
        done_within_m, DONE_WITHIN_M: f64 = 1e-4..=1.0;
        done_within_rad, DONE_WITHIN_RAD: f64 = 1e-3..=1.0;
    }

    fn validate(&self) -> Result<(), ranges::OutOfRange> {
        self.speed.validate(["approach.speed.linear_m_per_s", "approach.speed.angular_rad_per_s"])?;
        self.check_ranges()
    }
}

impl Timeouts {
    ranges! {
        fn check_ranges "timeouts.";
        observation_s, OBSERVATION_S: f64 = 0.02..=5.0;
        joints_s, JOINTS_S: f64 = 0.002..=0.5;
    }

    /// Allowed values of `lost_s`.
    pub fn lost_s_allowed(&self) -> RangeInclusive<f64> {
        not_below(self.observation_s, &Self::OBSERVATION_S).into_inner().0..=60.0
    }

    fn validate(&self) -> Result<(), ranges::OutOfRange> {
        self.check_ranges()?;
        ranges::check_range("timeouts.lost_s", self.lost_s, self.lost_s_allowed())
    }
}

/// Least value of a setting that must be above 0.
const ABOVE_ZERO: f64 = 1e-6;

fn check_pose<A: Frame, B: Frame>(key: &'static str, pose: &Pose<A, B>) -> Result<(), ConfigError> {
    let length_m = pose.translation_m().norm();
    let most_m = ControllerConfig::LENGTH_MAX_M;
    if pose.is_finite() && length_m <= most_m {
        return Ok(());
    }
    let allowed = format!("finite numbers, at most {most_m} m from origin to origin");
    Err(ConfigError { key, value: length_m.to_string(), allowed })
}
