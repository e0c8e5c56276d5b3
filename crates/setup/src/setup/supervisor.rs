//! The table `[supervisor]`: monitored conditions and their policies.

use std::ops::RangeInclusive;
use std::time::Duration;

use pb3dp_servo::supervisor::{Action, Condition, Policies, Policy, Resume, SupervisorConfig};
use serde::Deserialize;

use super::super::load::{Checker, within};

#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SupervisorSection {
    resume_after_s: f64,
    go_after_s: f64,
    word_age_max_s: f64,
    operator_key_within_s: f64,
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

/// A threshold in the units of the file.
struct Threshold {
    key: &'static str,
    /// Range of the supervisor, rounded inwards.
    allowed: RangeInclusive<f64>,
    to_si: fn(f64) -> f64,
}

impl Threshold {
    fn of(condition: Condition) -> Option<Self> {
        let of = |key, allowed, to_si| Some(Self { key, allowed, to_si });
        let as_it_is: fn(f64) -> f64 = |value| value;
        let from_millis: fn(f64) -> f64 = |value| value / 1e3;
        let seconds = |allowed| of("age_s", allowed, as_it_is);
        match condition {
            Condition::ClockStepped => of("step_s", 0.02..=1.0, as_it_is),
            Condition::OperatorSilent => seconds(0.1..=10.0),
            Condition::JointsStale => seconds(0.002..=0.5),
            Condition::FrameStale | Condition::EstimateStale => seconds(0.02..=1.0),
            Condition::TargetLost => seconds(0.05..=10.0),
            Condition::PositionJump => of("distance_mm", 1.0..=1000.0, from_millis),
            Condition::OrientationJump => of("angle_deg", 0.6..=171.0, f64::to_radians),
            Condition::Outlier => of("sigmas", 1.0..=1000.0, as_it_is),
            Condition::PositionUncertain => of("sigma_mm", 0.1..=100.0, from_millis),
            Condition::OrientationUncertain => of("sigma_deg", 0.06..=28.6, f64::to_radians),
            Condition::CameraSkew => of("skew_millis", 0.1..=50.0, from_millis),
            Condition::LimitNear => of("distance_deg", 0.06..=28.6, f64::to_radians),
            Condition::Singularity => of("singular_value", 0.001..=0.2, as_it_is),
            Condition::EmergencyStop
            | Condition::ArmFault
            | Condition::ArmDisabled
            | Condition::TargetChanged
            | Condition::FrameOrder
            | Condition::LowConfidence
            | Condition::ControllerRests => None,
        }
    }
}

/// Longest time without a key that a setup may allow, seconds: at 60 s an unattended arm moves for a minute.
const KEY_WITHIN_S: RangeInclusive<f64> = 5.0..=60.0;

impl SupervisorSection {
    /// Longest time without a key at the console of arms that are not emulated, seconds; checked by [`Self::build`].
    pub(super) fn key_within_s(&self) -> f64 {
        within(self.operator_key_within_s, *KEY_WITHIN_S.start(), *KEY_WITHIN_S.end())
    }

    /// The supervisor's settings for images with the period `frame_period`.
    pub(super) fn build(&self, frame_period: Duration, check: &mut Checker) -> SupervisorConfig {
        check.number("supervisor.resume_after_s", self.resume_after_s, 0.05..=60.0);
        check.number("supervisor.go_after_s", self.go_after_s, 0.05..=within(self.resume_after_s, 0.05, 60.0));
        check.number("supervisor.word_age_max_s", self.word_age_max_s, 0.05..=5.0);
        check.number("supervisor.operator_key_within_s", self.operator_key_within_s, KEY_WITHIN_S);
        // Without the key there is no search.
        if let Some(search_max_s) = self.search_max_s {
            check.number("supervisor.search_max_s", search_max_s, 0.1..=60.0);
        }
        let search_max_s = self.search_max_s.unwrap_or(0.0);
        let stale_s = self.policies.estimate_stale.age_s.unwrap_or(0.0);
        let lost_s = self.policies.target_lost.age_s.unwrap_or(f64::NAN);
        if lost_s >= 0.05 {
            check.number("supervisor.policies.target_lost.age_s", lost_s, within(stale_s, 0.05, 1.0)..=10.0);
        }
        // Two periods are the minimum for detecting a missing image; with less the hand would hold between any two images.
        let frame_stale_s = self.policies.frame_stale.age_s.unwrap_or(f64::NAN);
        if frame_stale_s >= 0.02 {
            let two_periods_s = within(2.0 * frame_period.as_secs_f64(), 0.02, 0.99);
            check.number("supervisor.policies.frame_stale.age_s", frame_stale_s, two_periods_s..=1.0);
        }
        let policies = Policies::of(|condition| self.policies.of(condition).build(condition, check));
        let config = SupervisorConfig {
            policies,
            resume_after_s: self.resume_after_s,
            go_after_s: self.go_after_s,
            word_age_max_s: self.word_age_max_s,
            search_max_s,
        };
        if let (true, Err(error)) = (check.is_clean(), config.validate()) {
            check.refuse(format!("supervisor.policies.{} = {}: allowed is {}", error.key, error.value, error.allowed));
        }
        config
    }
}

impl PoliciesSection {
    fn of(&self, condition: Condition) -> &PolicySection {
        match condition {
            Condition::EmergencyStop => &self.emergency_stop,
            Condition::ArmFault => &self.arm_fault,
            Condition::ArmDisabled => &self.arm_disabled,
            Condition::ClockStepped => &self.clock_stepped,
            Condition::OperatorSilent => &self.operator_silent,
            Condition::JointsStale => &self.joints_stale,
            Condition::TargetChanged => &self.target_changed,
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
        let for_s = optional((&table, "for_s"), self.for_s, has_time, 0.0..=rule.for_max_s, check);
        let share = optional((&table, "share"), self.share, self.action == ActionName::Slow, 0.05..=0.95, check);
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

    fn thresholds(&self) -> [(&'static str, Option<f64>); 10] {
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
