//! The table `[servo]`: desired pose, law, speeds and time-outs of the controller.

use std::ops::RangeInclusive;

use pb3dp_servo::{
    ApproachConfig, CartesianSpeed, ControllerConfig, DampingConfig, Gains, LawConfig, PublishedConfig, SearchConfig,
    SpeedConfig, TargetFilterConfig, Timeouts,
};
use serde::Deserialize;

use super::super::load::{Checker, whole, within};
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

    /// Checks every key separately, so that messages use the keys and units of the file; then the controller checks all values
    /// again. The ranges are those of the controller in the units of the file, rounded inwards.
    fn check(&self, config: &ControllerConfig, check: &mut Checker) {
        check.number("servo.damping.threshold", self.damping.threshold, 0.001..=0.5);
        check.number("servo.damping.factor_max", self.damping.factor_max, 0.001..=0.5);
        check.number("servo.damping.elbow_min_deg", self.damping.elbow_min_deg, 0.0..=28.6);
        check.number("servo.speed.linear_max_mm_per_s", self.speed.linear_max_mm_per_s, LINEAR_MM_PER_S);
        check.number("servo.speed.angular_max_deg_per_s", self.speed.angular_max_deg_per_s, ANGULAR_DEG_PER_S);
        check.number("servo.speed.limit_approach_per_s", self.speed.limit_approach_per_s, 0.1..=20.0);
        check.number("servo.speed.soft_start_s", self.speed.soft_start_s, 0.0..=10.0);
        // The approach is at most as fast as tracking.
        let at_most = |speed: f64, allowed: RangeInclusive<f64>| {
            let (min, max) = allowed.into_inner();
            min..=within(speed, min, max)
        };
        let linear = at_most(self.speed.linear_max_mm_per_s, LINEAR_MM_PER_S);
        let angular = at_most(self.speed.angular_max_deg_per_s, ANGULAR_DEG_PER_S);
        check.number("servo.approach.linear_max_mm_per_s", self.approach.linear_max_mm_per_s, linear);
        check.number("servo.approach.angular_max_deg_per_s", self.approach.angular_max_deg_per_s, angular);
        check.number("servo.approach.done_within_mm", self.approach.done_within_mm, 0.1..=1000.0);
        check.number("servo.approach.done_within_deg", self.approach.done_within_deg, 0.06..=57.0);
        let observation_s = self.timeouts.observation_s;
        check.number("servo.timeouts.observation_s", observation_s, 0.02..=5.0);
        check.number("servo.timeouts.lost_s", self.timeouts.lost_s, within(observation_s, 0.02, 5.0)..=60.0);
        check.number("servo.timeouts.joints_s", self.timeouts.joints_s, 0.002..=0.5);
        check.count("servo.joint_history_samples", self.joint_history_samples, 8..=10_000);
        if let (true, Err(error)) = (check.is_clean(), config.validate()) {
            check.refuse(format!("servo: {error}"));
        }
    }
}

impl SearchSection {
    fn build(&self, check: &mut Checker) -> SearchConfig {
        check.number("servo.search.back_mm", self.back_mm, 0.0..=200.0);
        check.number("servo.search.radius_mm", self.radius_mm, 1.0..=200.0);
        check.number("servo.search.turns", self.turns, 1.0..=10.0);
        check.number("servo.search.speed_mm_per_s", self.speed_mm_per_s, 1.0..=100.0);
        check.number("servo.search.time_s", self.time_s, 1.0..=60.0);
        SearchConfig {
            back_m: self.back_mm * 1e-3,
            radius_m: self.radius_mm * 1e-3,
            turns: self.turns,
            speed_m_per_s: self.speed_mm_per_s * 1e-3,
            time_s: self.time_s,
        }
    }
}

/// Speeds of the hand in [`SpeedSection`] and [`ApproachSection`].
pub(super) const LINEAR_MM_PER_S: RangeInclusive<f64> = 0.001..=2000.0;
const ANGULAR_DEG_PER_S: RangeInclusive<f64> = 0.0001..=343.7;

fn speed(linear_mm_per_s: f64, angular_deg_per_s: f64) -> CartesianSpeed {
    CartesianSpeed { linear_m_per_s: linear_mm_per_s * 1e-3, angular_rad_per_s: angular_deg_per_s.to_radians() }
}
