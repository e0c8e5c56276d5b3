//! The table `[servo]`: desired pose, law, speeds and time-outs of the controller.

use std::ops::RangeInclusive;

use pb3dp_servo::{
    ApproachConfig, ArmResponse, CartesianSpeed, ControllerConfig, DampingConfig, FeedForwardConfig, FeedForwardGains,
    Gains, HybridConfig, ImageBasedConfig, LawConfig, PublishedConfig, RedundancyConfig, SearchConfig, SpeedConfig,
    TargetFilterConfig, Timeouts, UnstatedCovariance,
};
use serde::Deserialize;

use super::super::load::{Checker, within};
use super::super::table::{Builds, count, deg, mm, number, table};
use super::super::units::{in_deg, in_mm};
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

/// The control law.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
enum LawName {
    FeedForward,
    Published,
    ImageBased,
    Hybrid,
}

impl LawName {
    /// Its name in files.
    fn text(self) -> &'static str {
        match self {
            Self::FeedForward => "feed-forward",
            Self::Published => "published",
            Self::ImageBased => "image-based",
            Self::Hybrid => "hybrid",
        }
    }

    /// Its tables; others are refused.
    fn tables(self) -> &'static [&'static str] {
        match self {
            Self::FeedForward => &["arm_response", "feed_forward", "null_motion", "unstated", "target"],
            Self::Published => &["gains", "smoothing"],
            Self::ImageBased => &["image_based", "smoothing"],
            Self::Hybrid => &["hybrid", "smoothing"],
        }
    }
}

table! {
    struct ArmResponseSection builds ArmResponse {
        delay_millis: f64 => delay_s = millis(ArmResponse::DELAY_S);
        lag_millis: f64 => lag_s = millis(ArmResponse::LAG_S);
    }
}

table! {
    struct FeedForwardSection sets FeedForwardConfig {
        position_per_s: f64 => gains.position_per_s = number(FeedForwardGains::POSITION_PER_S);
        orientation_per_s: f64 => gains.orientation_per_s = number(FeedForwardGains::ORIENTATION_PER_S);
        linear_max_mm_per_s2: f64 => gains.linear_m_per_s2 = mm(FeedForwardGains::LINEAR_M_PER_S2);
        angular_max_deg_per_s2: f64 => gains.angular_rad_per_s2 = deg(FeedForwardGains::ANGULAR_RAD_PER_S2);
        observations_to_lock: i64 => observations_to_lock = count(FeedForwardConfig::OBSERVATIONS_TO_LOCK);
    }
}

table! {
    struct NullMotionSection builds RedundancyConfig {
        gain_deg_per_s: f64 => gain_rad_per_s = deg(RedundancyConfig::GAIN_RAD_PER_S);
        speed_max_deg_per_s: f64 => speed_max_rad_per_s = deg(RedundancyConfig::SPEED_MAX_RAD_PER_S);
    }
}

table! {
    struct UnstatedSection builds UnstatedCovariance {
        lateral_sigma_mm: f64 => lateral_m = mm(UnstatedCovariance::LATERAL_M);
        depth_sigma_mm: f64 => depth_m = mm(UnstatedCovariance::DEPTH_M);
        tilt_sigma_deg: f64 => tilt_rad = deg(UnstatedCovariance::TILT_RAD);
        about_normal_sigma_deg: f64 => about_normal_rad = deg(UnstatedCovariance::ABOUT_NORMAL_RAD);
    }
}

table! {
    struct GainsSection builds Gains {
        position_per_s: f64 => position_per_s = number(Gains::POSITION_PER_S);
        velocity: f64 => velocity = number(Gains::VELOCITY);
        orientation_per_s: f64 => orientation_per_s = number(Gains::ORIENTATION_PER_S);
        angular_velocity: f64 => angular_velocity = number(Gains::ANGULAR_VELOCITY);
    }
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ImageBasedSection {
    gain_per_s: f64,
    half_width_mm: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct HybridSection {
    gain_per_s: f64,
}

table! {
    struct SmoothingSection builds TargetFilterConfig {
        position_time_constant_s: f64 => position_time_constant_s = number(TargetFilterConfig::POSITION_TIME_CONSTANT_S);
        orientation_time_constant_s: f64 => orientation_time_constant_s = number(TargetFilterConfig::ORIENTATION_TIME_CONSTANT_S);
        gate_position_mm: f64 => gate_position_m = mm(TargetFilterConfig::GATE_POSITION_M);
        gate_orientation_deg: f64 => gate_orientation_rad = deg(TargetFilterConfig::GATE_ORIENTATION_RAD);
        observations_to_lock: i64 => observations_to_lock = count(TargetFilterConfig::OBSERVATIONS_TO_LOCK);
    }
}

table! {
    struct DampingSection builds DampingConfig {
        threshold: f64 => threshold = number(DampingConfig::THRESHOLD);
        factor_max: f64 => factor_max = number(DampingConfig::FACTOR_MAX);
        elbow_min_deg: f64 => elbow_min_rad = deg(DampingConfig::ELBOW_MIN_RAD);
    }
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

table! {
    /// Search motion for a lost target; without this table the hand holds.
    struct SearchSection builds SearchConfig {
        back_mm: f64 => back_m = mm(SearchConfig::BACK_M);
        radius_mm: f64 => radius_m = mm(SearchConfig::RADIUS_M);
        turns: f64 => turns = number(SearchConfig::TURNS);
        speed_mm_per_s: f64 => speed_m_per_s = mm(SearchConfig::SPEED_M_PER_S);
        time_s: f64 => time_s = number(SearchConfig::TIME_S);
    }
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

    /// Each key is checked separately, with the range of the controller; then the controller checks what depends on several keys.
    pub(super) fn build(&self, mounts: &Mounts, check: &mut Checker) -> ControllerConfig {
        let pose = &self.model_from_hand_desired;
        let refused = PublishedConfig { gains: Gains::default(), target_filter: TargetFilterConfig::default() };
        let samples = &self.joint_history_samples;
        let config = ControllerConfig {
            model_from_hand_desired: pose.build("servo.model_from_hand_desired", ON_THE_ARM_MM, check),
            hand_from_cam_left: mounts.hand_from_cam_left,
            flange_from_hand: mounts.flange_from_hand,
            law: self.law(check).unwrap_or(LawConfig::Published(refused)),
            damping: self.damping.build("servo.damping", check),
            speed: self.speed.build(check),
            approach: self.approach.build(&self.speed, check),
            timeouts: self.timeouts.build(check),
            search: self.search.build("servo.search", check),
            joint_history_samples: count(
                samples,
                "servo.joint_history_samples",
                check,
                ControllerConfig::JOINT_HISTORY_SAMPLES,
            ),
        };
        check.together("servo", config.validate());
        config
    }

    /// The law with its parameters; `None` if a table is missing.
    fn law(&self, check: &mut Checker) -> Option<LawConfig> {
        let name = self.law;
        let tables = [
            ("arm_response", self.arm_response.is_some()),
            ("feed_forward", self.feed_forward.is_some()),
            ("null_motion", self.null_motion.is_some()),
            ("unstated", self.unstated.is_some()),
            ("target", self.target.is_some()),
            ("gains", self.gains.is_some()),
            ("image_based", self.image_based.is_some()),
            ("hybrid", self.hybrid.is_some()),
            ("smoothing", self.smoothing.is_some()),
        ];
        let text = name.text();
        for (table, is_there) in tables {
            match (name.tables().contains(&table), is_there) {
                (true, false) => {
                    check.refuse(format!("servo.{table}: missing; servo.law = \"{text}\" needs it"));
                }
                (false, true) => {
                    check.refuse(format!("servo.{table}: servo.law = \"{text}\" has no such table"));
                }
                _ => {}
            }
        }
        Some(match name {
            LawName::FeedForward => LawConfig::FeedForward(self.feed_forward(check)?),
            LawName::Published => LawConfig::Published(PublishedConfig {
                gains: self.gains.as_ref()?.build("servo.gains", check),
                target_filter: self.smoothing.as_ref()?.build("servo.smoothing", check),
            }),
            LawName::ImageBased => LawConfig::ImageBased(self.image_based(check)?),
            LawName::Hybrid => LawConfig::Hybrid(HybridConfig {
                gain_per_s: number(
                    &self.hybrid.as_ref()?.gain_per_s,
                    "servo.hybrid.gain_per_s",
                    check,
                    HybridConfig::GAIN_PER_S,
                ),
                target_filter: self.smoothing.as_ref()?.build("servo.smoothing", check),
            }),
        })
    }

    fn feed_forward(&self, check: &mut Checker) -> Option<FeedForwardConfig> {
        let (arm, law) = (self.arm_response.as_ref()?, self.feed_forward.as_ref()?);
        let (null_motion, unstated, target) =
            (self.null_motion.as_ref()?, self.unstated.as_ref()?, self.target.as_ref()?);
        let arm = arm.build("servo.arm_response", check);
        let mut config = FeedForwardConfig {
            arm,
            // These and the observations: until the table of the law sets them.
            gains: FeedForwardGains::of(&arm),
            observations_to_lock: 1,
            unstated: unstated.build("servo.unstated", check),
            redundancy: null_motion.build("servo.null_motion", check),
            target: target.build(self.timeouts.observation_s, check),
        };
        law.set(&mut config, "servo.feed_forward", check);
        Some(config)
    }

    fn image_based(&self, check: &mut Checker) -> Option<ImageBasedConfig> {
        use ImageBasedConfig as Config;
        let (law, smoothing) = (self.image_based.as_ref()?, self.smoothing.as_ref()?);
        Some(Config {
            gain_per_s: number(&law.gain_per_s, "servo.image_based.gain_per_s", check, Config::GAIN_PER_S),
            half_width_m: mm(&law.half_width_mm, "servo.image_based.half_width_mm", check, Config::HALF_WIDTH_M),
            target_filter: smoothing.build("servo.smoothing", check),
        })
    }
}

impl SpeedSection {
    fn build(&self, check: &mut Checker) -> SpeedConfig {
        let key = |name: &str| format!("servo.speed.{name}");
        let (linear, angular) = (self.linear_max_mm_per_s, self.angular_max_deg_per_s);
        check.number(&key("linear_max_mm_per_s"), linear, linear_mm_per_s());
        check.number(&key("angular_max_deg_per_s"), angular, angular_deg_per_s());
        let (approach, start) = (&self.limit_approach_per_s, &self.soft_start_s);
        SpeedConfig {
            tracking: speed(linear, angular),
            limit_approach_per_s: number(
                approach,
                &key("limit_approach_per_s"),
                check,
                SpeedConfig::LIMIT_APPROACH_PER_S,
            ),
            soft_start_s: number(start, &key("soft_start_s"), check, SpeedConfig::SOFT_START_S),
        }
    }
}

impl ApproachSection {
    /// The approach is at most as fast as tracking.
    fn build(&self, tracking: &SpeedSection, check: &mut Checker) -> ApproachConfig {
        let key = |name: &str| format!("servo.approach.{name}");
        let at_most = |speed: f64, allowed: RangeInclusive<f64>| {
            let (min, max) = allowed.into_inner();
            min..=within(speed, min, max)
        };
        let (linear, angular) = (self.linear_max_mm_per_s, self.angular_max_deg_per_s);
        check.number(&key("linear_max_mm_per_s"), linear, at_most(tracking.linear_max_mm_per_s, linear_mm_per_s()));
        let angular_allowed = at_most(tracking.angular_max_deg_per_s, angular_deg_per_s());
        check.number(&key("angular_max_deg_per_s"), angular, angular_allowed);
        let (within_mm, within_deg) = (&self.done_within_mm, &self.done_within_deg);
        ApproachConfig {
            speed: speed(linear, angular),
            done_within_m: mm(within_mm, &key("done_within_mm"), check, ApproachConfig::DONE_WITHIN_M),
            done_within_rad: deg(within_deg, &key("done_within_deg"), check, ApproachConfig::DONE_WITHIN_RAD),
        }
    }
}

impl TimeoutsSection {
    fn build(&self, check: &mut Checker) -> Timeouts {
        let Self { observation_s, lost_s, joints_s } = *self;
        let config = Timeouts { observation_s, lost_s, joints_s };
        check.number("servo.timeouts.observation_s", observation_s, Timeouts::OBSERVATION_S);
        check.number("servo.timeouts.lost_s", lost_s, config.lost_s_allowed());
        check.number("servo.timeouts.joints_s", joints_s, Timeouts::JOINTS_S);
        config
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
