//! The table `[servo]`: desired pose, law, speeds and time-outs of the controller.

use std::ops::RangeInclusive;

use pb3dp_servo::{
    ApproachConfig, CartesianSpeed, ControllerConfig, DampingConfig, Gains, LawConfig, PublishedConfig, SearchConfig,
    SpeedConfig, TargetFilterConfig, Timeouts,
};
use serde::Deserialize;

use super::super::load::{Checker, whole, within};
use super::super::units::{in_deg, in_mm};
use super::law::{
    ArmResponseSection, FeedForwardSection, GainsSection, HybridSection, ImageBasedSection, LawName, LawTables,
    NullMotionSection, SmoothingSection, UnstatedSection,
};
use super::mounts::Mounts;
use super::target_state::TargetStateSection;
use super::{ON_THE_ARM_MM, PoseEntry};

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ServoSection {
    model_from_hand_desired: PoseEntry,
    law: LawName,
    arm_response: Option<ArmResponseSection>,
    feed_forward: Option<FeedForwardSection>,
    null_motion: Option<NullMotionSection>,
    unstated: Option<UnstatedSection>,
    target: Option<TargetStateSection>,
    gains: Option<GainsSection>,
    image_based: Option<ImageBasedSection>,
    hybrid: Option<HybridSection>,
    smoothing: Option<SmoothingSection>,
    damping: DampingSection,
    speed: SpeedSection,
    approach: ApproachSection,
    timeouts: TimeoutsSection,
    search: Option<SearchSection>,
    joint_history_samples: i64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DampingSection {
    threshold: f64,
    factor_max: f64,
    elbow_min_deg: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SpeedSection {
    linear_max_mm_per_s: f64,
    angular_max_deg_per_s: f64,
    limit_approach_per_s: f64,
    soft_start_s: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ApproachSection {
    linear_max_mm_per_s: f64,
    angular_max_deg_per_s: f64,
    done_within_mm: f64,
    done_within_deg: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct TimeoutsSection {
    observation_s: f64,
    lost_s: f64,
    joints_s: f64,
}

/// Search motion for a lost target; without this table the hand holds.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SearchSection {
    back_mm: f64,
    radius_mm: f64,
    turns: f64,
    speed_mm_per_s: f64,
    time_s: f64,
}

impl ServoSection {
    /// Speed limit of the hand, as stated in the file.
    pub(super) fn speed_max_m_per_s(&self) -> f64 {
        self.speed.linear_max_mm_per_s * 1e-3
    }

    /// Whether the hand searches for a lost target.
    pub(super) fn searches(&self) -> bool {
        self.search.is_some()
    }

    pub(super) fn build(&self, mounts: &Mounts, check: &mut Checker) -> ControllerConfig {
        let config = ControllerConfig {
            model_from_hand_desired: self.model_from_hand_desired.build(
                "servo.model_from_hand_desired",
                ON_THE_ARM_MM,
                check,
            ),
            hand_from_cam_left: mounts.hand_from_cam_left,
            flange_from_hand: mounts.flange_from_hand,
            law: self.law(check),
            damping: DampingConfig {
                threshold: self.damping.threshold,
                factor_max: self.damping.factor_max,
                elbow_min_rad: self.damping.elbow_min_deg.to_radians(),
            },
            speed: SpeedConfig {
                tracking: speed(self.speed.linear_max_mm_per_s, self.speed.angular_max_deg_per_s),
                limit_approach_per_s: self.speed.limit_approach_per_s,
                soft_start_s: self.speed.soft_start_s,
            },
            approach: ApproachConfig {
                speed: speed(self.approach.linear_max_mm_per_s, self.approach.angular_max_deg_per_s),
                done_within_m: self.approach.done_within_mm * 1e-3,
                done_within_rad: self.approach.done_within_deg.to_radians(),
            },
            timeouts: Timeouts {
                observation_s: self.timeouts.observation_s,
                lost_s: self.timeouts.lost_s,
                joints_s: self.timeouts.joints_s,
            },
            search: self.search.as_ref().map(|search| search.build(check)),
            joint_history_samples: whole(self.joint_history_samples),
        };
        self.check(&config, check);
        config
    }

    fn law(&self, check: &mut Checker) -> LawConfig {
        let tables = LawTables {
            arm_response: self.arm_response.as_ref(),
            feed_forward: self.feed_forward.as_ref(),
            null_motion: self.null_motion.as_ref(),
            unstated: self.unstated.as_ref(),
            target: self.target.as_ref(),
            gains: self.gains.as_ref(),
            image_based: self.image_based.as_ref(),
            hybrid: self.hybrid.as_ref(),
            smoothing: self.smoothing.as_ref(),
        };
        let refused = PublishedConfig { gains: Gains::default(), target_filter: TargetFilterConfig::default() };
        tables.build(self.law, self.timeouts.observation_s, check).unwrap_or(LawConfig::Published(refused))
    }

    /// Checks every key separately, so that messages use the keys and units of the file; then the controller checks what depends on
    /// several keys. The ranges are those of the controller.
    fn check(&self, config: &ControllerConfig, check: &mut Checker) {
        let DampingSection { threshold, factor_max, elbow_min_deg } = self.damping;
        check.number("servo.damping.threshold", threshold, DampingConfig::THRESHOLD);
        check.number("servo.damping.factor_max", factor_max, DampingConfig::FACTOR_MAX);
        check.number("servo.damping.elbow_min_deg", elbow_min_deg, in_deg(DampingConfig::ELBOW_MIN_RAD));
        self.speed.check(check);
        self.approach.check(&self.speed, check);
        self.timeouts.check(&config.timeouts, check);
        let samples = self.joint_history_samples;
        check.count("servo.joint_history_samples", samples, ControllerConfig::JOINT_HISTORY_SAMPLES);
        if let (true, Err(error)) = (check.is_clean(), config.validate()) {
            check.refuse(format!("servo: {error}"));
        }
    }
}

impl SpeedSection {
    fn check(&self, check: &mut Checker) {
        check.number("servo.speed.linear_max_mm_per_s", self.linear_max_mm_per_s, linear_mm_per_s());
        check.number("servo.speed.angular_max_deg_per_s", self.angular_max_deg_per_s, angular_deg_per_s());
        let limit_approach_per_s = self.limit_approach_per_s;
        check.number("servo.speed.limit_approach_per_s", limit_approach_per_s, SpeedConfig::LIMIT_APPROACH_PER_S);
        check.number("servo.speed.soft_start_s", self.soft_start_s, SpeedConfig::SOFT_START_S);
    }
}

impl ApproachSection {
    /// The approach is at most as fast as tracking.
    fn check(&self, tracking: &SpeedSection, check: &mut Checker) {
        let at_most = |speed: f64, allowed: RangeInclusive<f64>| {
            let (min, max) = allowed.into_inner();
            min..=within(speed, min, max)
        };
        let linear = at_most(tracking.linear_max_mm_per_s, linear_mm_per_s());
        let angular = at_most(tracking.angular_max_deg_per_s, angular_deg_per_s());
        check.number("servo.approach.linear_max_mm_per_s", self.linear_max_mm_per_s, linear);
        check.number("servo.approach.angular_max_deg_per_s", self.angular_max_deg_per_s, angular);
        let (within_mm, within_deg) = (self.done_within_mm, self.done_within_deg);
        check.number("servo.approach.done_within_mm", within_mm, in_mm(ApproachConfig::DONE_WITHIN_M));
        check.number("servo.approach.done_within_deg", within_deg, in_deg(ApproachConfig::DONE_WITHIN_RAD));
    }
}

impl TimeoutsSection {
    fn check(&self, config: &Timeouts, check: &mut Checker) {
        check.number("servo.timeouts.observation_s", self.observation_s, Timeouts::OBSERVATION_S);
        check.number("servo.timeouts.lost_s", self.lost_s, config.lost_s_allowed());
        check.number("servo.timeouts.joints_s", self.joints_s, Timeouts::JOINTS_S);
    }
}

impl SearchSection {
    fn build(&self, check: &mut Checker) -> SearchConfig {
        check.number("servo.search.back_mm", self.back_mm, in_mm(SearchConfig::BACK_M));
        check.number("servo.search.radius_mm", self.radius_mm, in_mm(SearchConfig::RADIUS_M));
        check.number("servo.search.turns", self.turns, SearchConfig::TURNS);
        check.number("servo.search.speed_mm_per_s", self.speed_mm_per_s, in_mm(SearchConfig::SPEED_M_PER_S));
        check.number("servo.search.time_s", self.time_s, SearchConfig::TIME_S);
        SearchConfig {
            back_m: self.back_mm * 1e-3,
            radius_m: self.radius_mm * 1e-3,
            turns: self.turns,
            speed_m_per_s: self.speed_mm_per_s * 1e-3,
            time_s: self.time_s,
        }
    }
}

/// Allowed speeds of the hand in [`SpeedSection`] and [`ApproachSection`].
pub(super) fn linear_mm_per_s() -> RangeInclusive<f64> {
    in_mm(CartesianSpeed::LINEAR_M_PER_S)
}

fn angular_deg_per_s() -> RangeInclusive<f64> {
    in_deg(CartesianSpeed::ANGULAR_RAD_PER_S)
}

fn speed(linear_mm_per_s: f64, angular_deg_per_s: f64) -> CartesianSpeed {
    CartesianSpeed { linear_m_per_s: linear_mm_per_s * 1e-3, angular_rad_per_s: angular_deg_per_s.to_radians() }
}
