//! Conditions, actions, and the policies that connect them.

use std::cmp::Ordering;
use std::fmt;
use std::ops::RangeInclusive;

use pb3dp_geometry::ranges;

use crate::config_error::not_below;

/// A monitored condition. If several active ones have the same action, the first one in this order gives the reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Condition {
    /// An arm reports an emergency stop.
    EmergencyStop,
    /// An arm reports a fault.
    ArmFault,
    /// The drives of an arm are disabled.
    ArmDisabled,
    /// Time went backwards, or forwards by too much, between two steps; or a measurement has a future time.
    ClockStepped,
    /// The operator has given no sign of life for too long.
    OperatorSilent,
    /// The newest joint sample of an arm is too old.
    JointsStale,
    /// The estimator follows another target than the started one.
    TargetChanged,
    /// The newest image is too old.
    FrameStale,
    /// Numbers or times of the images do not increase.
    FrameOrder,
    /// The images contradict the calibration of the cameras.
    Miscalibrated,
    /// The newest confident pose is so old that the target is lost.
    TargetLost,
    /// The newest confident pose is too old.
    EstimateStale,
    /// The newest pose has low confidence, or there is none.
    LowConfidence,
    /// The observed target position jumped.
    PositionJump,
    /// The observed target orientation jumped.
    OrientationJump,
    /// The observed target pose is too far from its prediction.
    Outlier,
    /// The estimator's standard deviation of the position is too large.
    PositionUncertain,
    /// The estimator's standard deviation of the orientation is too large.
    OrientationUncertain,
    /// The two cameras were not exposed at the same time.
    CameraSkew,
    /// A joint of the camera arm is near its limit.
    LimitNear,
    /// The camera arm is near a singular pose.
    Singularity,
    /// The controller commands no velocity.
    ControllerRests,
    /// Images are older than their time stamps: the target seems to move with the hand.
    LateImages,
}

/// A set of conditions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConditionSet(u32);

/// Actions by severity; of two shares the smaller one is more severe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// The report counts the condition.
    Note,
    /// The arm moves with this share of its velocity, 0.05 to 0.95.
    Slow(f64),
    /// The arm holds.
    Hold,
    /// Both arms are stopped until the operator's reset.
    Stop,
    /// The same, as a fault.
    Fault,
}

/// How the arm resumes after a hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Resume {
    /// By the operator's `resume`.
    ByOperator,
    /// Automatically, after [`SupervisorConfig::resume_after_s`] without the cause.
    ByItself,
}

/// Reaction to a condition.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Policy {
    /// Limit in the unit of the condition's [`ThresholdRule`]; unused if the condition has none.
    pub threshold: f64,
    /// Time for which the condition must last, seconds.
    pub for_s: f64,
    /// The action.
    pub action: Action,
    /// How the arm resumes after [`Action::Hold`].
    pub resume: Resume,
}

/// A policy for every condition.
#[derive(Clone, Debug, PartialEq)]
pub struct Policies([Policy; Condition::COUNT]);

/// All parameters of [`super::Supervisor::new`]. There are no defaults: these are safety limits.
#[derive(Clone, Debug, PartialEq)]
pub struct SupervisorConfig {
    /// The policy of each condition.
    pub policies: Policies,
    /// The arm resumes automatically only after this time without an active inhibit, counted up to the newest confident estimate.
    /// Seconds, 0.05 to 60.
    pub resume_after_s: f64,
    /// `start` and `resume` are accepted only after this time without an active inhibit, so that a condition of single images is
    /// not gone between two images. Seconds, 0.05 to [`Self::resume_after_s`].
    pub go_after_s: f64,
    /// Older commands (except stop and hold) are refused, seconds, 0.05 to 5.
    pub word_age_max_s: f64,
    /// Longest search for a lost target, seconds since the loss, 0.1 to 60; 0: the arm holds.
    pub search_max_s: f64,
}

/// What the policy of a condition may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// Name of the condition in configurations, logs and reports.
    pub key: &'static str,
    /// The threshold, if the condition has one.
    pub threshold: Option<ThresholdRule>,
    /// Upper bound of `for_s`, seconds.
    pub for_max_s: f64,
    /// The least severe action that is allowed.
    pub least: Action,
    /// Whether the arm may resume automatically after a hold for this condition.
    pub may_resume_by_itself: bool,
    /// Whether the condition also counts when no target is followed, and inhibits a reset.
    pub counts_always: bool,
    /// Whether the condition inhibits all arms, including the one that carries the target, in every state.
    pub holds_every_arm: bool,
}

/// A threshold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThresholdRule {
    /// Name with unit.
    pub name: &'static str,
    /// Smallest allowed value.
    pub min: f64,
    /// Largest allowed value.
    pub max: f64,
}

/// A refused setting.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("supervisor setting {key} is {value}: allowed is {allowed}")]
pub struct SupervisorError {
    /// Name of the setting.
    pub key: String,
    /// Its value.
    pub value: String,
    /// The allowed values.
    pub allowed: String,
}

impl Condition {
    /// Number of conditions.
    pub const COUNT: usize = 23;

    /// All conditions.
    pub const ALL: [Self; Self::COUNT] = [
        Self::EmergencyStop,
        Self::ArmFault,
        Self::ArmDisabled,
        Self::ClockStepped,
        Self::OperatorSilent,
        Self::JointsStale,
        Self::TargetChanged,
        Self::FrameStale,
        Self::FrameOrder,
        Self::Miscalibrated,
        Self::TargetLost,
        Self::EstimateStale,
        Self::LowConfidence,
        Self::PositionJump,
        Self::OrientationJump,
        Self::Outlier,
        Self::PositionUncertain,
        Self::OrientationUncertain,
        Self::CameraSkew,
        Self::LimitNear,
        Self::Singularity,
        Self::ControllerRests,
        Self::LateImages,
    ];

    /// The name in configurations, logs and reports.
    pub fn key(self) -> &'static str {
        self.rule().key
    }

    /// What the policy of this condition may be.
    #[rustfmt::skip]
    pub fn rule(self) -> Rule {
        use Action::{Fault, Hold, Note};
        let rule = |key, threshold: Option<(&'static str, f64, f64)>, for_max_s, least, may_resume_by_itself| Rule {
            key,
            threshold: threshold.map(|(name, min, max)| ThresholdRule { name, min, max }),
            for_max_s,
            least,
            may_resume_by_itself,
            counts_always: false,
            holds_every_arm: false,
        };
        match self {
            Self::EmergencyStop => Rule { counts_always: true, ..rule("emergency_stop", None, 0.0, Fault, false) },
            Self::ArmFault => Rule { counts_always: true, ..rule("arm_fault", None, 0.0, Fault, false) },
            Self::ArmDisabled => Rule { holds_every_arm: true, ..rule("arm_disabled", None, 0.0, Hold, false) },
            Self::ClockStepped => Rule { holds_every_arm: true, ..rule("clock_stepped", Some(("step_s", 0.02, 1.0)), 0.0, Hold, false) },
            Self::OperatorSilent => Rule { holds_every_arm: true, ..rule("operator_silent", Some(("age_s", 0.1, 10.0)), 0.0, Hold, false) },
            Self::JointsStale => Rule { holds_every_arm: true, ..rule("joints_stale", Some(("age_s", 0.002, 0.5)), 0.0, Hold, true) },
            Self::TargetChanged => rule("target_changed", None, 0.0, Hold, false),
            Self::FrameStale => rule("frame_stale", Some(("age_s", 0.02, 1.0)), 0.0, Hold, true),
            Self::FrameOrder => rule("frame_order", None, 0.0, Hold, true),
            Self::Miscalibrated => rule("miscalibrated", None, 0.0, Hold, false),
            Self::TargetLost => rule("target_lost", Some(("age_s", 0.05, 10.0)), 0.0, Hold, true),
            Self::EstimateStale => rule("estimate_stale", Some(("age_s", 0.02, 1.0)), 0.0, Hold, true),
            Self::LowConfidence => rule("low_confidence", None, 1.0, Note, true),
            Self::PositionJump => rule("position_jump", Some(("distance_m", 0.001, 1.0)), 1.0, Note, true),
            Self::OrientationJump => rule("orientation_jump", Some(("angle_rad", 0.01, 3.0)), 1.0, Note, true),
            Self::Outlier => rule("outlier", Some(("sigmas", 1.0, 1000.0)), 0.1, Note, true),
            Self::PositionUncertain => rule("position_uncertain", Some(("sigma_m", 0.0001, 0.1)), 1.0, Note, true),
            Self::OrientationUncertain => rule("orientation_uncertain", Some(("sigma_rad", 0.001, 0.5)), 1.0, Note, true),
            Self::CameraSkew => rule("camera_skew", Some(("skew_s", 0.0001, 0.05)), 1.0, Note, true),
            Self::LimitNear => rule("limit_near", Some(("distance_rad", 0.001, 0.5)), 1.0, Note, true),
            Self::Singularity => rule("singularity", Some(("singular_value", 0.001, 0.2)), 1.0, Note, true),
            Self::ControllerRests => rule("controller_rests", None, 0.0, Hold, true),
            Self::LateImages => rule("late_images", Some(("late_s", 0.01, 0.2)), 0.5, Note, true),
        }
    }
}

impl ConditionSet {
    pub(super) fn insert(&mut self, condition: Condition) {
        self.0 |= 1 << condition as u32;
    }

    /// Whether the set contains this condition.
    pub fn contains(self, condition: Condition) -> bool {
        self.0 & (1 << condition as u32) != 0
    }

    /// The conditions in the order of [`Condition::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Condition> {
        Condition::ALL.into_iter().filter(move |condition| self.contains(*condition))
    }
}

impl Rule {
    /// Allowed values of `for_s`.
    pub fn for_s_allowed(&self) -> RangeInclusive<f64> {
        0.0..=self.for_max_s
    }
}

impl Action {
    ranges! {
        SHARE: f64 = 0.05..=0.95;
    }

    fn severity(self) -> u8 {
        match self {
            Self::Note => 0,
            Self::Slow(_) => 1,
            Self::Hold => 2,
            Self::Stop => 3,
            Self::Fault => 4,
        }
    }

    /// Whether the arm stops moving.
    pub fn is_rest(self) -> bool {
        self >= Self::Hold
    }
}

impl PartialOrd for Action {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        match (self, other) {
            (Self::Slow(own), Self::Slow(others)) => others.partial_cmp(own),
            _ => Some(self.severity().cmp(&other.severity())),
        }
    }
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Note => write!(f, "note"),
            Self::Slow(share) => write!(f, "slow to {share}"),
            Self::Hold => write!(f, "hold"),
            Self::Stop => write!(f, "stop"),
            Self::Fault => write!(f, "fault"),
        }
    }
}

impl Policies {
    /// One policy for each condition.
    pub fn of(policy: impl FnMut(Condition) -> Policy) -> Self {
        Self(Condition::ALL.map(policy))
    }

    /// The policy for a condition.
    pub fn get(&self, condition: Condition) -> &Policy {
        &self.0[condition as usize]
    }

    /// Mutable access to the policy of a condition.
    pub fn get_mut(&mut self, condition: Condition) -> &mut Policy {
        &mut self.0[condition as usize]
    }
}

impl SupervisorConfig {
    ranges! {
        RESUME_AFTER_S: f64 = 0.05..=60.0;
        COMMAND_AGE_MAX_S: f64 = 0.05..=5.0;
        SEARCH_MAX_S: f64 = 0.1..=60.0;
    }

    /// Checks every number, and that no policy is weaker than its condition allows.
    ///
    /// # Errors
    /// The first setting that is refused.
    pub fn validate(&self) -> Result<(), SupervisorError> {
        within(|| "resume_after_s".to_owned(), self.resume_after_s, Self::RESUME_AFTER_S)?;
        within(|| "go_after_s".to_owned(), self.go_after_s, self.go_after_s_allowed())?;
        within(|| "word_age_max_s".to_owned(), self.word_age_max_s, Self::COMMAND_AGE_MAX_S)?;
        if self.search_max_s != 0.0 {
            within(|| "search_max_s".to_owned(), self.search_max_s, Self::SEARCH_MAX_S)?;
        }
        Condition::ALL.into_iter().try_for_each(|condition| self.policies.get(condition).validate(condition))?;
        let [stale, lost] =
            [Condition::EstimateStale, Condition::TargetLost].map(|condition| self.policies.get(condition).threshold);
        within(|| "target_lost.age_s".to_owned(), lost, Self::lost_s_allowed(stale))
    }

    /// Allowed values of `go_after_s`.
    pub fn go_after_s_allowed(&self) -> RangeInclusive<f64> {
        let least = *Self::RESUME_AFTER_S.start();
        // Of NaN and a number, `max` gives the number.
        least..=self.resume_after_s.max(least).min(*Self::RESUME_AFTER_S.end())
    }

    /// Allowed ages of the newest pose at which the target is lost, if an estimate is stale at the age `stale_s`. Seconds.
    pub fn lost_s_allowed(stale_s: f64) -> RangeInclusive<f64> {
        let range = Condition::TargetLost.rule().threshold.map_or(0.0..=0.0, |threshold| threshold.min..=threshold.max);
        not_below(stale_s, &range)
    }
}

impl Action {
    /// This action and all more severe ones, for messages.
    fn and_more(self) -> String {
        ["note", "slow", "hold", "stop", "fault"][usize::from(self.severity())..].join(" or ")
    }
}

impl Policy {
    fn validate(&self, condition: Condition) -> Result<(), SupervisorError> {
        let rule = condition.rule();
        let key = |part: &str| format!("{}.{part}", rule.key);
        if let Some(ThresholdRule { name, min, max }) = rule.threshold {
            within(|| key(name), self.threshold, min..=max)?;
        }
        within(|| key("for_s"), self.for_s, rule.for_s_allowed())?;
        if let Action::Slow(share) = self.action {
            within(|| key("share"), share, Action::SHARE)?;
        }
        let refused = |part: &str, value: &dyn fmt::Display, allowed: String| {
            Err(SupervisorError { key: key(part), value: value.to_string(), allowed })
        };
        if self.action < rule.least {
            return refused("action", &self.action, rule.least.and_more());
        }
        if self.resume == Resume::ByItself && !rule.may_resume_by_itself {
            return refused("resume", &"by-itself", "by-operator".to_owned());
        }
        Ok(())
    }
}

/// Refuses a value out of range, or NaN.
fn within(key: impl FnOnce() -> String, value: f64, allowed: RangeInclusive<f64>) -> Result<(), SupervisorError> {
    if allowed.contains(&value) {
        return Ok(());
    }
    let (min, max) = allowed.into_inner();
    Err(SupervisorError { key: key(), value: value.to_string(), allowed: format!("{min} to {max}") })
}
