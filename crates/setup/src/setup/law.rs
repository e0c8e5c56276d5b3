//! The tables of the control laws: those of the chosen law are required, those of the others are refused.

use pb3dp_servo::{
    ArmResponse, FeedForwardConfig, FeedForwardGains, Gains, HybridConfig, ImageBasedConfig, LawConfig,
    PublishedConfig, RedundancyConfig, TargetFilterConfig, UnstatedCovariance,
};
use serde::Deserialize;

use super::super::load::{Checker, whole};
use super::super::units::{in_deg, in_millis, in_mm};
use super::target_state::TargetStateSection;

/// The control law.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "kebab-case")]
pub(super) enum LawName {
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

/// The keys of the table `[servo]` that belong to one law.
pub(super) struct LawTables<'a> {
    pub arm_response: Option<&'a ArmResponseSection>,
    pub feed_forward: Option<&'a FeedForwardSection>,
    pub null_motion: Option<&'a NullMotionSection>,
    pub unstated: Option<&'a UnstatedSection>,
    pub target: Option<&'a TargetStateSection>,
    pub gains: Option<&'a GainsSection>,
    pub image_based: Option<&'a ImageBasedSection>,
    pub hybrid: Option<&'a HybridSection>,
    pub smoothing: Option<&'a SmoothingSection>,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ArmResponseSection {
    delay_millis: f64,
    lag_millis: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FeedForwardSection {
    position_per_s: f64,
    orientation_per_s: f64,
    linear_max_mm_per_s2: f64,
    angular_max_deg_per_s2: f64,
    observations_to_lock: i64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct NullMotionSection {
    gain_deg_per_s: f64,
    speed_max_deg_per_s: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct UnstatedSection {
    lateral_sigma_mm: f64,
    depth_sigma_mm: f64,
    tilt_sigma_deg: f64,
    about_normal_sigma_deg: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GainsSection {
    position_per_s: f64,
    velocity: f64,
    orientation_per_s: f64,
    angular_velocity: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ImageBasedSection {
    gain_per_s: f64,
    half_width_mm: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HybridSection {
    gain_per_s: f64,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SmoothingSection {
    position_time_constant_s: f64,
    orientation_time_constant_s: f64,
    gate_position_mm: f64,
    gate_orientation_deg: f64,
    observations_to_lock: i64,
}

impl LawTables<'_> {
    /// The law with its parameters; `None` if a table is missing. `observation_s` is the time-out of observations.
    pub(super) fn build(&self, name: LawName, observation_s: f64, check: &mut Checker) -> Option<LawConfig> {
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
        match name {
            LawName::FeedForward => self.feed_forward(observation_s, check),
            LawName::Published => self.published(check),
            LawName::ImageBased => self.image_based(check),
            LawName::Hybrid => self.hybrid(check),
        }
    }

    fn feed_forward(&self, observation_s: f64, check: &mut Checker) -> Option<LawConfig> {
        let (arm, law) = (self.arm_response?, self.feed_forward?);
        let (null_motion, unstated, target) = (self.null_motion?, self.unstated?, self.target?);
        arm.check(check);
        law.check(check);
        null_motion.check(check);
        unstated.check(check);
        Some(LawConfig::FeedForward(FeedForwardConfig {
            arm: ArmResponse { delay_s: arm.delay_millis * 1e-3, lag_s: arm.lag_millis * 1e-3 },
            gains: FeedForwardGains {
                position_per_s: law.position_per_s,
                orientation_per_s: law.orientation_per_s,
                linear_m_per_s2: law.linear_max_mm_per_s2 * 1e-3,
                angular_rad_per_s2: law.angular_max_deg_per_s2.to_radians(),
            },
            observations_to_lock: whole(law.observations_to_lock),
            unstated: UnstatedCovariance {
                lateral_m: unstated.lateral_sigma_mm * 1e-3,
                depth_m: unstated.depth_sigma_mm * 1e-3,
                tilt_rad: unstated.tilt_sigma_deg.to_radians(),
                about_normal_rad: unstated.about_normal_sigma_deg.to_radians(),
            },
            redundancy: RedundancyConfig {
                gain_rad_per_s: null_motion.gain_deg_per_s.to_radians(),
                speed_max_rad_per_s: null_motion.speed_max_deg_per_s.to_radians(),
            },
            target: target.build(observation_s, check),
        }))
    }

    fn published(&self, check: &mut Checker) -> Option<LawConfig> {
        let (gains, smoothing) = (self.gains?, self.smoothing?);
        gains.check(check);
        Some(LawConfig::Published(PublishedConfig {
            gains: Gains {
                position_per_s: gains.position_per_s,
                velocity: gains.velocity,
                orientation_per_s: gains.orientation_per_s,
                angular_velocity: gains.angular_velocity,
            },
            target_filter: smoothing.build(check),
        }))
    }

    fn image_based(&self, check: &mut Checker) -> Option<LawConfig> {
        let (law, smoothing) = (self.image_based?, self.smoothing?);
        check.number("servo.image_based.gain_per_s", law.gain_per_s, ImageBasedConfig::GAIN_PER_S);
        let half_width_mm = in_mm(ImageBasedConfig::HALF_WIDTH_M);
        check.number("servo.image_based.half_width_mm", law.half_width_mm, half_width_mm);
        let (gain_per_s, half_width_m) = (law.gain_per_s, law.half_width_mm * 1e-3);
        Some(LawConfig::ImageBased(ImageBasedConfig {
            gain_per_s,
            half_width_m,
            target_filter: smoothing.build(check),
        }))
    }

    fn hybrid(&self, check: &mut Checker) -> Option<LawConfig> {
        let (law, smoothing) = (self.hybrid?, self.smoothing?);
        check.number("servo.hybrid.gain_per_s", law.gain_per_s, HybridConfig::GAIN_PER_S);
        Some(LawConfig::Hybrid(HybridConfig { gain_per_s: law.gain_per_s, target_filter: smoothing.build(check) }))
    }
}

impl ArmResponseSection {
    fn check(&self, check: &mut Checker) {
        check.number("servo.arm_response.delay_millis", self.delay_millis, in_millis(ArmResponse::DELAY_S));
        check.number("servo.arm_response.lag_millis", self.lag_millis, in_millis(ArmResponse::LAG_S));
    }
}

impl FeedForwardSection {
    fn check(&self, check: &mut Checker) {
        use FeedForwardGains as Gains;
        let key = |name: &str| format!("servo.feed_forward.{name}");
        check.number(&key("position_per_s"), self.position_per_s, Gains::POSITION_PER_S);
        check.number(&key("orientation_per_s"), self.orientation_per_s, Gains::ORIENTATION_PER_S);
        check.number(&key("linear_max_mm_per_s2"), self.linear_max_mm_per_s2, in_mm(Gains::LINEAR_M_PER_S2));
        check.number(&key("angular_max_deg_per_s2"), self.angular_max_deg_per_s2, in_deg(Gains::ANGULAR_RAD_PER_S2));
        let to_lock = self.observations_to_lock;
        check.count(&key("observations_to_lock"), to_lock, FeedForwardConfig::OBSERVATIONS_TO_LOCK);
    }
}

impl NullMotionSection {
    fn check(&self, check: &mut Checker) {
        let (gain, speed) = (self.gain_deg_per_s, self.speed_max_deg_per_s);
        check.number("servo.null_motion.gain_deg_per_s", gain, in_deg(RedundancyConfig::GAIN_RAD_PER_S));
        check.number("servo.null_motion.speed_max_deg_per_s", speed, in_deg(RedundancyConfig::SPEED_MAX_RAD_PER_S));
    }
}

impl UnstatedSection {
    fn check(&self, check: &mut Checker) {
        use UnstatedCovariance as Sigma;
        let key = |name: &str| format!("servo.unstated.{name}");
        check.number(&key("lateral_sigma_mm"), self.lateral_sigma_mm, in_mm(Sigma::LATERAL_M));
        check.number(&key("depth_sigma_mm"), self.depth_sigma_mm, in_mm(Sigma::DEPTH_M));
        check.number(&key("tilt_sigma_deg"), self.tilt_sigma_deg, in_deg(Sigma::TILT_RAD));
        check.number(&key("about_normal_sigma_deg"), self.about_normal_sigma_deg, in_deg(Sigma::ABOUT_NORMAL_RAD));
    }
}

impl GainsSection {
    fn check(&self, check: &mut Checker) {
        check.number("servo.gains.position_per_s", self.position_per_s, Gains::POSITION_PER_S);
        check.number("servo.gains.velocity", self.velocity, Gains::VELOCITY);
        check.number("servo.gains.orientation_per_s", self.orientation_per_s, Gains::ORIENTATION_PER_S);
        check.number("servo.gains.angular_velocity", self.angular_velocity, Gains::ANGULAR_VELOCITY);
    }
}

impl SmoothingSection {
    fn build(&self, check: &mut Checker) -> TargetFilterConfig {
        self.check(check);
        TargetFilterConfig {
            position_time_constant_s: self.position_time_constant_s,
            orientation_time_constant_s: self.orientation_time_constant_s,
            gate_position_m: self.gate_position_mm * 1e-3,
            gate_orientation_rad: self.gate_orientation_deg.to_radians(),
            observations_to_lock: whole(self.observations_to_lock),
        }
    }

    fn check(&self, check: &mut Checker) {
        use TargetFilterConfig as Filter;
        let key = |name: &str| format!("servo.smoothing.{name}");
        let (position_s, orientation_s) = (self.position_time_constant_s, self.orientation_time_constant_s);
        check.number(&key("position_time_constant_s"), position_s, Filter::POSITION_TIME_CONSTANT_S);
        check.number(&key("orientation_time_constant_s"), orientation_s, Filter::ORIENTATION_TIME_CONSTANT_S);
        check.number(&key("gate_position_mm"), self.gate_position_mm, in_mm(Filter::GATE_POSITION_M));
        check.number(&key("gate_orientation_deg"), self.gate_orientation_deg, in_deg(Filter::GATE_ORIENTATION_RAD));
        check.count(&key("observations_to_lock"), self.observations_to_lock, Filter::OBSERVATIONS_TO_LOCK);
    }
}
