//! What may be wrong, for how long it may be, and what follows: conditions, actions, and the policies that connect them.

use std::cmp::Ordering;
use std::fmt;

/// What may be wrong. Where several ask for the same action, the one that stands further up gives the reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Condition {
    /// An arm is stopped by an emergency stop.
    EmergencyStop,
    /// An arm has a fault.
    ArmFault,
    /// The drives of an arm are off.
    ArmDisabled,
    /// Time went back, or on by too much, between two steps; or a measurement comes from the future.
    ClockStepped,
    /// No sign of life of the operator.
    OperatorSilent,
    /// The joints of an arm were measured too long ago.
    JointsStale,
    /// The estimator follows another target than the one that was started.
    TargetChanged,
    /// The newest image is too old.
    FrameStale,
    /// Numbers and times of the images do not both increase.
    FrameOrder,
    /// The newest confident pose is so old that the target counts as lost.
    TargetLost,
    /// The newest confident pose is too old.
    EstimateStale,
    /// The newest pose has low confidence, or there is none.
    LowConfidence,
    /// The target jumped, or seems to have.
    PositionJump,
    /// The target turned at once, or seems to have.
    OrientationJump,
    /// The target is not where its motion so far leads to expect it.
    Outlier,
    /// The estimator is not sure of the position.
    PositionUncertain,
    /// The estimator is not sure of the orientation.
    OrientationUncertain,
    /// Both cameras were not exposed together.
    CameraSkew,
    /// A joint of the hand's arm is near an end of its range.
    LimitNear,
    /// The hand's arm is near a singular pose.
    Singularity,
    /// The controller gives no velocity.
    ControllerRests,
}

/// Some of the conditions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConditionSet(u32);

/// What follows, in the order of severity; of two shares the smaller one is the more severe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Action {
    /// It is counted.
    Note,
    /// The arm goes on with this share of its velocity, 0.05 to 0.95.
    Slow(f64),
    /// The arm rests.
    Hold,
    /// Both arms are stopped until the operator's reset.
    Stop,
    /// The same, as a fault.
    Fault,
}

/// How the arm goes on after a rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Resume {
    /// When the operator says so.
    ByOperator,
    /// When the cause has been gone for the time of [`SupervisorConfig::resume_after_s`].
    ByItself,
}

/// What follows when something is wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Policy {
    /// What is still allowed, in the unit of the condition's [`ThresholdRule`]; without meaning where there is none.
    pub threshold: f64,
    /// It must last for this time, seconds.
    pub for_s: f64,
    /// What follows.
    pub action: Action,
    /// How it goes on after [`Action::Hold`].
    pub resume: Resume,
}

/// A policy for every condition.
#[derive(Clone, Debug, PartialEq)]
pub struct Policies([Policy; Condition::COUNT]);

/// Everything that [`super::Supervisor::new`] needs. There are no defaults: these are safety limits.
#[derive(Clone, Debug, PartialEq)]
pub struct SupervisorConfig {
    /// What follows on what.
    pub policies: Policies,
    /// The arm goes on by itself only when nothing has spoken against it for this time, seconds, 0.05 to 60, up to the newest confident
    /// estimate.
    pub resume_after_s: f64,
    /// `start` and `resume` are obeyed only when nothing has spoken against motion for this time, seconds, 0.05 to
    /// [`Self::resume_after_s`]: what one image in some shows is not gone between two of them.
    pub go_after_s: f64,
    /// A word (other than stop and hold) that was said longer ago is not obeyed, seconds, 0.05 to 5.
    pub word_age_max_s: f64,
    /// How long the hand may look for a target that was lost, seconds since the loss, 0 to 60; 0: it rests.
    pub search_max_s: f64,
}

/// What a condition allows its policy to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// Name of the condition in configurations, logs and reports.
    pub key: &'static str,
    /// What the threshold is; none if the condition is there or not.
    pub threshold: Option<ThresholdRule>,
    /// The longest time that it may have to last, seconds.
    pub for_max_s: f64,
    /// The least that must follow.
    pub least: Action,
    /// Whether the arm may go on by itself after a rest for this reason.
    pub may_resume_by_itself: bool,
    /// Whether it counts when nothing is followed, too, and must be gone for a reset.
    pub counts_always: bool,
    /// Whether no arm may move while it is there, the one that carries the target included, whatever the state is.
    pub holds_every_arm: bool,
}

/// A threshold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThresholdRule {
    /// Its name, with the unit.
    pub name: &'static str,
    /// Smallest allowed value.
    pub min: f64,
    /// Largest allowed value.
    pub max: f64,
}

/// A setting that is refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("supervisor setting {key} is {value}: allowed is {allowed}")]
pub struct SupervisorError {
    /// Name of the setting.
    pub key: String,
    /// Its value.
    pub value: String,
    /// What is allowed.
    pub allowed: String,
}

impl Condition {
    /// How many there are.
    pub const COUNT: usize = 21;

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
    ];

    /// The name in configurations, logs and reports.
    pub fn key(self) -> &'static str {
        self.rule().key
    }

    /// What its policy may be.
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
        }
    }
}

impl ConditionSet {
    pub(super) fn insert(&mut self, condition: Condition) {
        self.0 |= 1 << condition as u32;
    }

    /// Whether it is one of them.
    pub fn contains(self, condition: Condition) -> bool {
        self.0 & (1 << condition as u32) != 0
    }

    /// They, in the order of [`Condition::ALL`].
    pub fn iter(self) -> impl Iterator<Item = Condition> {
        Condition::ALL.into_iter().filter(move |condition| self.contains(*condition))
    }
}

impl Action {
    fn severity(self) -> u8 {
        match self {
            Self::Note => 0,
            Self::Slow(_) => 1,
            Self::Hold => 2,
            Self::Stop => 3,
            Self::Fault => 4,
        }
    }

    /// Whether the arm does not move any more.
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

    /// The policy for a condition, to be changed.
    pub fn get_mut(&mut self, condition: Condition) -> &mut Policy {
        &mut self.0[condition as usize]
    }
}

impl SupervisorConfig {
    /// Checks every number, and that no policy is weaker than its condition allows.
    ///
    /// # Errors
    /// The first setting that is refused.
    pub fn validate(&self) -> Result<(), SupervisorError> {
        within(|| "resume_after_s".to_owned(), self.resume_after_s, 0.05, 60.0)?;
        within(|| "go_after_s".to_owned(), self.go_after_s, 0.05, self.resume_after_s)?;
        within(|| "word_age_max_s".to_owned(), self.word_age_max_s, 0.05, 5.0)?;
        within(|| "search_max_s".to_owned(), self.search_max_s, 0.0, 60.0)?;
        Condition::ALL.into_iter().try_for_each(|condition| self.policies.get(condition).validate(condition))?;
        let [stale, lost] =
            [Condition::EstimateStale, Condition::TargetLost].map(|condition| self.policies.get(condition).threshold);
        within(|| "target_lost.age_s".to_owned(), lost, stale, 10.0)
    }
}

impl Action {
    /// This action and all that are more severe, for messages.
    fn and_more(self) -> String {
        ["note", "slow", "hold", "stop", "fault"][usize::from(self.severity())..].join(" or ")
    }
}

impl Policy {
    fn validate(&self, condition: Condition) -> Result<(), SupervisorError> {
        let rule = condition.rule();
        let key = |part: &str| format!("{}.{part}", rule.key);
        if let Some(ThresholdRule { name, min, max }) = rule.threshold {
            within(|| key(name), self.threshold, min, max)?;
        }
        within(|| key("for_s"), self.for_s, 0.0, rule.for_max_s)?;
        if let Action::Slow(share) = self.action {
            within(|| key("share"), share, 0.05, 0.95)?;
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

/// Refuses what is not in a range; not a number is in none.
fn within(key: impl FnOnce() -> String, value: f64, min: f64, max: f64) -> Result<(), SupervisorError> {
    if value >= min && value <= max {
        return Ok(());
    }
    Err(SupervisorError { key: key(), value: value.to_string(), allowed: format!("{min} to {max}") })
}
