//! The table `[supervisor]`: monitored conditions and their policies.

use std::ops::RangeInclusive;
use std::time::Duration;

use pb3dp_servo::supervisor::{Action, Condition, Policies, Policy, Resume, SupervisorConfig, ThresholdRule};
use serde::Deserialize;

use super::super::layers::{Layers, built_in};
use super::super::load::{Checker, within};
use super::super::units::{in_deg, in_millis, in_mm};

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SupervisorSection {
    resume_after_s: f64,
    go_after_s: f64,
    word_age_max_s: f64,
    operator_key_within_s: f64,
    pub(super) hold_to_run: bool,
    search_max_s: Option<f64>,
    policies: PoliciesSection,
}

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PoliciesSection {
    emergency_stop: PolicySection,
    arm_fault: PolicySection,
    arm_disabled: PolicySection,
    clock_stepped: PolicySection,
    operator_silent: PolicySection,
    joints_stale: PolicySection,
    target_changed: PolicySection,
    miscalibrated: PolicySection,
    frame_stale: PolicySection,
    frame_order: PolicySection,
    target_lost: PolicySection,
    estimate_stale: PolicySection,
    low_confidence: PolicySection,
    position_jump: PolicySection,
    orientation_jump: PolicySection,
    outlier: PolicySection,
    position_uncertain: PolicySection,
    orientation_uncertain: PolicySection,
    camera_skew: PolicySection,
    limit_near: PolicySection,
    singularity: PolicySection,
    controller_rests: PolicySection,
    late_images: PolicySection,
}

/// One policy; [`Threshold::of`] names the threshold of each condition.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PolicySection {
    action: ActionName,
    share: Option<f64>,
    for_s: Option<f64>,
    resume: Option<ResumeName>,
    age_s: Option<f64>,
    step_s: Option<f64>,
    distance_mm: Option<f64>,
    distance_deg: Option<f64>,
    angle_deg: Option<f64>,
    sigmas: Option<f64>,
    sigma_mm: Option<f64>,
    sigma_deg: Option<f64>,
    skew_millis: Option<f64>,
    late_millis: Option<f64>,
    singular_value: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ActionName {
    Note,
    Slow,
    Hold,
    Stop,
    Fault,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ResumeName {
    ByItself,
    ByOperator,
}

/// A range in SI units.
type SiRange = RangeInclusive<f64>;

/// A threshold in the units of the file.
struct Threshold {
    key: &'static str,
    /// Range of the supervisor.
    allowed: RangeInclusive<f64>,
    to_si: fn(f64) -> f64,
}

impl Threshold {
    fn of(condition: Condition) -> Option<Self> {
        let ThresholdRule { min, max, .. } = condition.rule().threshold?;
        let (key, in_file, to_si): (_, InFile, ToSi) = match condition {
            Condition::OperatorSilent
            | Condition::JointsStale
            | Condition::FrameStale
            | Condition::EstimateStale
            | Condition::TargetLost => ("age_s", same, same),
            Condition::ClockStepped => ("step_s", same, same),
            Condition::PositionJump => ("distance_mm", in_mm, from_millis),
            Condition::OrientationJump => ("angle_deg", in_deg, f64::to_radians),
            Condition::Outlier => ("sigmas", same, same),
            Condition::PositionUncertain => ("sigma_mm", in_mm, from_millis),
            Condition::OrientationUncertain => ("sigma_deg", in_deg, f64::to_radians),
            Condition::CameraSkew => ("skew_millis", in_millis, from_millis),
            Condition::LateImages => ("late_millis", in_millis, from_millis),
            Condition::LimitNear => ("distance_deg", in_deg, f64::to_radians),
            Condition::Singularity => ("singular_value", same, same),
            Condition::EmergencyStop
            | Condition::ArmFault
            | Condition::ArmDisabled
            | Condition::TargetChanged
            | Condition::Miscalibrated
            | Condition::FrameOrder
            | Condition::LowConfidence
            | Condition::ControllerRests => return None,
        };
        Some(Self { key, allowed: in_file(min..=max), to_si })
    }

    /// A value in SI units, in the unit of the file; without the rounding error of the conversion.
    fn in_file(&self, si: f64) -> f64 {
        (si / (self.to_si)(1.0) * 1e6).round() / 1e6
    }
}

/// Key of a condition's threshold, and two thresholds in the unit of the file; `None` if the condition has none.
pub(super) fn thresholds_in_file(condition: Condition, si: [f64; 2]) -> Option<(&'static str, [f64; 2])> {
    let threshold = Threshold::of(condition)?;
    Some((threshold.key, si.map(|si| threshold.in_file(si))))
}

/// A range in the unit of the file.
type InFile = fn(SiRange) -> RangeInclusive<f64>;
/// A value of the file in SI units.
type ToSi = fn(f64) -> f64;

/// Longest time without a key that a setup may allow, seconds: at 60 s an unattended arm moves for a minute.
const KEY_WITHIN_S: RangeInclusive<f64> = 5.0..=60.0;

/// For a value that has the same unit in the file.
fn same<T>(value: T) -> T {
    value
}

fn from_millis(value: f64) -> f64 {
    value / 1e3
}

impl SupervisorSection {
    /// The supervisor's settings of the built-in setup `rig`.
    pub(super) fn of_built_in_rig() -> Option<SupervisorConfig> {
        let layers = Layers::of_text("rig", built_in::setup("rig")?.text).ok()?;
        let section: Self = layers.figment().extract_inner("supervisor").ok()?;
        let mut check = Checker::default();
        // A lower bound of one age depends on the frame period.
        let config = section.build(Duration::ZERO, &mut check);
        check.is_clean().then_some(config)
    }

    /// Longest time without a key at the console of arms that are not emulated, seconds; checked by [`Self::build`].
    pub(super) fn key_within_s(&self) -> f64 {
        within(self.operator_key_within_s, *KEY_WITHIN_S.start(), *KEY_WITHIN_S.end())
    }

    /// The supervisor's settings for images with the period `frame_period`.
    pub(super) fn build(&self, frame_period: Duration, check: &mut Checker) -> SupervisorConfig {
        check.number("supervisor.operator_key_within_s", self.operator_key_within_s, KEY_WITHIN_S);
        self.policies.check_ages(frame_period, check);
        let search_max_s = self.search_max_s.unwrap_or(0.0);
        let config = SupervisorConfig {
            policies: Policies::of(|condition| self.policies.of(condition).build(condition, check)),
            resume_after_s: self.resume_after_s,
            go_after_s: self.go_after_s,
            word_age_max_s: self.word_age_max_s,
            search_max_s,
        };
        check.number("supervisor.resume_after_s", self.resume_after_s, SupervisorConfig::RESUME_AFTER_S);
        check.number("supervisor.go_after_s", self.go_after_s, config.go_after_s_allowed());
        check.number("supervisor.word_age_max_s", self.word_age_max_s, SupervisorConfig::COMMAND_AGE_MAX_S);
        // Without the key there is no search.
        if self.search_max_s.is_some() {
            check.number("supervisor.search_max_s", search_max_s, SupervisorConfig::SEARCH_MAX_S);
        }
        if let (true, Err(error)) = (check.is_clean(), config.validate()) {
            check.refuse(format!("supervisor.policies.{} = {}: allowed is {}", error.key, error.value, error.allowed));
        }
        config
    }
}

impl PoliciesSection {
    /// Checks ages whose lower bound depends on another setting; smaller ones are refused with the range of their condition.
    fn check_ages(&self, frame_period: Duration, check: &mut Checker) {
        let own_range = |condition, age_s: Option<f64>| {
            let (age_s, range) = (age_s?, Threshold::of(condition)?.allowed);
            (age_s >= *range.start()).then_some((age_s, range))
        };
        if let Some((lost_s, _)) = own_range(Condition::TargetLost, self.target_lost.age_s) {
            let allowed = SupervisorConfig::lost_s_allowed(self.estimate_stale.age_s.unwrap_or(0.0));
            check.number("supervisor.policies.target_lost.age_s", lost_s, allowed);
        }
        // Two periods are the minimum for detecting a missing image; with less the hand would hold between any two images.
        if let Some((stale_s, range)) = own_range(Condition::FrameStale, self.frame_stale.age_s) {
            let (min_s, max_s) = range.into_inner();
            let two_periods_s = within(2.0 * frame_period.as_secs_f64(), min_s, 0.99 * max_s);
            check.number("supervisor.policies.frame_stale.age_s", stale_s, two_periods_s..=max_s);
        }
    }

    fn of(&self, condition: Condition) -> &PolicySection {
        match condition {
            Condition::EmergencyStop => &self.emergency_stop,
            Condition::ArmFault => &self.arm_fault,
            Condition::ArmDisabled => &self.arm_disabled,
            Condition::ClockStepped => &self.clock_stepped,
            Condition::OperatorSilent => &self.operator_silent,
            Condition::JointsStale => &self.joints_stale,
            Condition::TargetChanged => &self.target_changed,
            Condition::Miscalibrated => &self.miscalibrated,
            Condition::FrameStale => &self.frame_stale,
            Condition::FrameOrder => &self.frame_order,
            Condition::TargetLost => &self.target_lost,
            Condition::EstimateStale => &self.estimate_stale,
            Condition::LowConfidence => &self.low_confidence,
            Condition::PositionJump => &self.position_jump,
            Condition::OrientationJump => &self.orientation_jump,
            Condition::Outlier => &self.outlier,
            Condition::PositionUncertain => &self.position_uncertain,
            Condition::OrientationUncertain => &self.orientation_uncertain,
            Condition::CameraSkew => &self.camera_skew,
            Condition::LimitNear => &self.limit_near,
            Condition::Singularity => &self.singularity,
            Condition::ControllerRests => &self.controller_rests,
            Condition::LateImages => &self.late_images,
        }
    }
}

impl PolicySection {
    fn build(&self, condition: Condition, check: &mut Checker) -> Policy {
        let (rule, table) = (condition.rule(), format!("supervisor.policies.{}", condition.key()));
        let wanted = Threshold::of(condition);
        let mut threshold = 0.0;
        for (key, value) in self.thresholds() {
            let wanted = wanted.as_ref().filter(|wanted| wanted.key == key);
            match (wanted, value) {
                (Some(wanted), Some(value)) => {
                    check.number(&format!("{table}.{key}"), value, wanted.allowed.clone());
                    threshold = (wanted.to_si)(value);
                }
                (Some(_), None) => check.refuse(format!("{table}.{key}: missing; the file must set it")),
                (None, Some(value)) => check.refuse(format!("{table}.{key} = {value}: this condition has no such key")),
                (None, None) => {}
            }
        }
        let has_time = rule.for_max_s > 0.0;
        let for_s = optional((&table, "for_s"), self.for_s, has_time, rule.for_s_allowed(), check);
        let share = optional((&table, "share"), self.share, self.action == ActionName::Slow, Action::SHARE, check);
        let may_choose = rule.may_resume_by_itself && self.action == ActionName::Hold;
        match (self.resume, may_choose) {
            (None, true) => check.refuse(format!("{table}.resume: missing; the file must set it")),
            (Some(ResumeName::ByItself), false) => {
                let when = if rule.may_resume_by_itself { "with action = hold" } else { "never for this condition" };
                check.refuse(format!("{table}.resume = by-itself: allowed {when}; leave the key out"));
            }
            _ => {}
        }
        let action = match self.action {
            ActionName::Note => Action::Note,
            ActionName::Slow => Action::Slow(share),
            ActionName::Hold => Action::Hold,
            ActionName::Stop => Action::Stop,
            ActionName::Fault => Action::Fault,
        };
        let resume = match self.resume {
            Some(ResumeName::ByItself) => Resume::ByItself,
            Some(ResumeName::ByOperator) | None => Resume::ByOperator,
        };
        Policy { threshold, for_s, action, resume }
    }

    fn thresholds(&self) -> [(&'static str, Option<f64>); 11] {
        [
            ("age_s", self.age_s),
            ("step_s", self.step_s),
            ("distance_mm", self.distance_mm),
            ("distance_deg", self.distance_deg),
            ("angle_deg", self.angle_deg),
            ("sigmas", self.sigmas),
            ("sigma_mm", self.sigma_mm),
            ("sigma_deg", self.sigma_deg),
            ("skew_millis", self.skew_millis),
            ("late_millis", self.late_millis),
            ("singular_value", self.singular_value),
        ]
    }
}

/// A number that must be present if and only if it is needed; 0 if it is not.
fn optional(
    (table, name): (&str, &str),
    value: Option<f64>,
    is_wanted: bool,
    allowed: RangeInclusive<f64>,
    check: &mut Checker,
) -> f64 {
    match (value, is_wanted) {
        (Some(value), true) => {
            check.number(&format!("{table}.{name}"), value, allowed);
            value
        }
        (None, true) => {
            check.refuse(format!("{table}.{name}: missing; the file must set it"));
            0.0
        }
        (Some(value), false) => {
            check.refuse(format!("{table}.{name} = {value}: this policy has no such key"));
            0.0
        }
        (None, false) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::read_setup;
    use super::*;

    /// Cells of the row of this condition in docs/supervisor.md.
    fn row(page: &str, condition: Condition) -> Vec<String> {
        let start = format!("| `{}` |", condition.key());
        let line = page.lines().find(|line| line.starts_with(&start));
        let line = line.unwrap_or_else(|| panic!("no row {start}"));
        line.split('|').skip(1).map(|cell| cell.trim().to_owned()).collect()
    }

    fn leading_number(cell: &str) -> Option<f64> {
        cell.split([' ', '°']).next()?.parse().ok()
    }

    #[test]
    fn the_page_says_what_the_file_and_the_code_do() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let page = std::fs::read_to_string(root.join("docs/supervisor.md")).unwrap();
        let file = root.join("configs/sim.toml");
        let policies = read_setup(&file).unwrap().supervisor.policies;
        let table: toml::Table = std::fs::read_to_string(&file).unwrap().parse().unwrap();
        for condition in Condition::ALL {
            let (key, rule, policy) = (condition.key(), condition.rule(), policies.get(condition));
            let [_, _, threshold, lasts, least, action, goes_on, ..] = &row(&page, condition)[..] else {
                panic!("{key}: a row of seven cells")
            };
            let stated = &table["supervisor"]["policies"][key];
            let in_file = Threshold::of(condition).map(|threshold| stated[threshold.key].as_float().unwrap());
            assert_eq!(leading_number(threshold), in_file, "{key}");
            assert_eq!(leading_number(lasts).unwrap_or(0.0), policy.for_s, "{key}");
            assert_eq!((least, action), (&rule.least.to_string(), &policy.action.to_string()), "{key}");
            let expected = match (policy.action, policy.resume) {
                (Action::Note | Action::Slow(_), _) => "",
                (Action::Hold, Resume::ByItself) => "automatically",
                (Action::Hold, Resume::ByOperator) => "operator",
                (Action::Stop | Action::Fault, _) => "after reset",
            };
            assert_eq!(goes_on, expected, "{key}");
        }
    }
}
