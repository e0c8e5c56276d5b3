//! Settings that arms which are not emulated may have only after they were commissioned.

use pb3dp_servo::supervisor::{Action, Condition, Resume};

use super::Setup;
use super::arms::{ArmSetup, FIRST_RUN_SPEED_SCALE};
use super::supervisor::{SupervisorSection, thresholds_in_file};

/// After these conditions only a person can judge whether the target is still the right one.
const FOR_PERSONS: [Condition; 4] =
    [Condition::TargetLost, Condition::PositionJump, Condition::OrientationJump, Condition::Outlier];

/// Their thresholds, and that of a stale estimate, decide how long the hand moves on without sight of the target, and which jump it
/// follows, and how uncertain a pose may be. A larger one is looser for each of them.
const NOT_LOOSER: [Condition; 7] = [
    Condition::TargetLost,
    Condition::EstimateStale,
    Condition::PositionUncertain,
    Condition::OrientationUncertain,
    Condition::PositionJump,
    Condition::OrientationJump,
    Condition::Outlier,
];

/// An emergency stop, a limit switch, a released dead-man switch or missing power of this arm would not be noticed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{} unknown: the meaning of the arm's status words is not known, so the arm may not move. `pb3dp arm signals` finds the bits with \
     closed brakes and prints these lines; allowed are \"controller 0x0008 set\" (status word, bits, level), \"wired\" for an input of \
     the gateway, and \"absent\" for a switch that the arm does not have (docs/commissioning.md)",
    .keys.join(", ")
)]
pub struct UnknownSignals {
    /// The keys.
    pub keys: Vec<String>,
}

impl ArmSetup {
    /// Checks that every signal of the arm is noticed, if it has a link.
    ///
    /// # Errors
    /// The keys of those that are not.
    pub fn check_signals(&self) -> Result<(), UnknownSignals> {
        let Some(signals) = self.link.signals() else { return Ok(()) };
        let keys: Vec<_> =
            signals.unknown().map(|signal| format!("{}.gateway.signals.{}", self.key, signal.key())).collect();
        if keys.is_empty() { Ok(()) } else { Err(UnknownSignals { keys }) }
    }
}

impl Setup {
    /// The settings that need a commissioning record of each arm that is not emulated: key, value, and the value that needs none.
    pub fn settings_that_need_commissioning(&self) -> Vec<String> {
        let mut found = Vec::new();
        if !self.rig.first_run {
            found.push("arms.first_run = false (without a record: true)".to_owned());
        }
        if self.rig.speed_scale > FIRST_RUN_SPEED_SCALE {
            let value = self.rig.speed_scale;
            found.push(format!("arms.speed_scale = {value} (without a record: at most {FIRST_RUN_SPEED_SCALE})"));
        }
        for condition in FOR_PERSONS {
            let (key, policy) = (condition.key(), self.supervisor.policies.get(condition));
            if policy.action < Action::Hold {
                found.push(format!(
                    "supervisor.policies.{key}.action = \"{}\" (without a record: \"hold\")",
                    policy.action
                ));
            } else if policy.action == Action::Hold && policy.resume == Resume::ByItself {
                found.push(format!(
                    "supervisor.policies.{key}.resume = \"by-itself\" (without a record: \"by-operator\")"
                ));
            }
        }
        self.add_looser_thresholds(&mut found);
        found
    }

    /// Adds the settings that let the hand follow a larger jump or a less certain pose than the built-in setup `rig` does, that do less about
    /// a condition, or let it continue by itself after
    /// it lost sight of the target for a longer time. Such an estimate is only stale, not lost: the hand resumes without a command.
    fn add_looser_thresholds(&self, found: &mut Vec<String>) {
        let Some(built_in) = SupervisorSection::of_built_in_rig() else {
            found.push("supervisor.policies (the built-in ones cannot be read)".to_owned());
            return;
        };
        for condition in Condition::ALL.into_iter().filter(|condition| !FOR_PERSONS.contains(condition)) {
            let [action, most] = [&self.supervisor, &built_in].map(|config| config.policies.get(condition).action);
            if action < most {
                let key = condition.key();
                found.push(format!("supervisor.policies.{key}.action = \"{action}\" (without a record: \"{most}\")"));
            }
        }
        let mut not_above = |key: &str, value: f64, most: f64| {
            if value > most {
                found.push(format!("supervisor.{key} = {value} (without a record: at most {most})"));
            }
        };
        for condition in NOT_LOOSER {
            let [policy, most] = [&self.supervisor, &built_in].map(|config| config.policies.get(condition));
            let table = format!("policies.{}", condition.key());
            if let Some((key, [value, most])) = thresholds_in_file(condition, [policy.threshold, most.threshold]) {
                not_above(&format!("{table}.{key}"), value, most);
            }
            not_above(&format!("{table}.for_s"), policy.for_s, most.for_s);
        }
        let search_max_s = self.supervisor.search_max_s;
        if search_max_s > built_in.search_max_s {
            found.push(format!("supervisor.search_max_s = {search_max_s} (without a record: leave the key out)"));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::{read_layers, read_setup};
    use crate::layers::SetupArgs;

    #[test]
    fn a_simulation_needs_a_record_on_real_arms_and_the_shipped_rig_needs_none() {
        let read =
            |name: &str| read_setup(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs").join(name)).unwrap();
        let needed = read("hil.toml").settings_that_need_commissioning();
        let keys = [
            "arms.first_run = false",
            "arms.speed_scale = 0.6",
            "policies.target_lost.resume",
            "policies.position_jump.resume",
            "policies.orientation_jump.resume",
            "policies.outlier.resume",
        ];
        assert_eq!(needed.len(), keys.len(), "{needed:?}");
        assert!(needed.iter().zip(keys).all(|(line, key)| line.contains(key)), "{needed:?}");
        assert_eq!(read("rig.toml").settings_that_need_commissioning(), [""; 0]);
    }

    /// The hand holds for a stale estimate and resumes by itself; only a lost target waits for the operator.
    #[test]
    fn looser_thresholds_and_a_search_need_a_record() {
        let rig = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/rig.toml");
        let needed = |set: &[&str]| {
            let mut args = SetupArgs::of_file(&rig);
            args.set = set.iter().map(|set| (*set).to_owned()).collect();
            read_layers(&args).unwrap().settings_that_need_commissioning()
        };
        for (set, line) in [
            ("target_lost.age_s = 10.0", "target_lost.age_s = 10 (without a record: at most 1)"),
            ("estimate_stale.age_s = 0.9", "estimate_stale.age_s = 0.9 (without a record: at most 0.3)"),
            ("position_jump.distance_mm = 1000.0", "position_jump.distance_mm = 1000 (without a record: at most 100)"),
            ("position_jump.for_s = 1.0", "position_jump.for_s = 1 (without a record: at most 0.1)"),
            ("orientation_jump.angle_deg = 170.0", "orientation_jump.angle_deg = 170 (without a record: at most 35)"),
            ("orientation_jump.for_s = 0.5", "orientation_jump.for_s = 0.5 (without a record: at most 0.1)"),
            ("outlier.sigmas = 1000.0", "outlier.sigmas = 1000 (without a record: at most 6)"),
            ("outlier.for_s = 0.1", "outlier.for_s = 0.1 (without a record: at most 0.06)"),
            ("position_uncertain.sigma_mm = 100.0", "position_uncertain.sigma_mm = 100 (without a record: at most 20)"),
            (
                "position_uncertain.action = \"note\"",
                "position_uncertain.action = \"note\" (without a record: \"hold\")",
            ),
            ("orientation_uncertain.for_s = 0.5", "orientation_uncertain.for_s = 0.5 (without a record: at most 0.2)"),
        ] {
            let found = needed(&[&format!("supervisor.policies.{}", set.replace(" = ", "="))]);
            assert_eq!(found, [format!("supervisor.policies.{line}")]);
        }
        let search = ["back_mm=30.0", "radius_mm=20.0", "turns=2.0", "speed_mm_per_s=20.0", "time_s=20.0"]
            .map(|key| format!("servo.search.{key}"));
        let search: Vec<&str> = search.iter().map(String::as_str).chain(["supervisor.search_max_s=20.0"]).collect();
        assert_eq!(needed(&search), ["supervisor.search_max_s = 20 (without a record: leave the key out)"]);
        let stricter = [
            "target_lost.age_s=0.5",
            "estimate_stale.age_s=0.2",
            "position_jump.distance_mm=99.9",
            "orientation_jump.angle_deg=34.9",
            "outlier.sigmas=5.0",
            "outlier.for_s=0.05",
        ]
        .map(|set| format!("supervisor.policies.{set}"));
        assert_eq!(needed(&stricter.each_ref().map(String::as_str)), [""; 0]);
    }
}
