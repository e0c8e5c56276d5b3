//! Settings that arms which are not emulated may have only after they were commissioned.

use pb3dp_servo::supervisor::{Action, Condition, Resume};

use super::Setup;
use super::arms::{ArmSetup, FIRST_RUN_SPEED_SCALE};

/// After these conditions only a person can judge whether the target is still the right one.
const FOR_PERSONS: [Condition; 4] =
    [Condition::TargetLost, Condition::PositionJump, Condition::OrientationJump, Condition::Outlier];

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
        let Some((signals, table)) = self.link.signals() else { return Ok(()) };
        let keys: Vec<_> =
            signals.unknown().map(|signal| format!("{}.{table}.signals.{}", self.key, signal.key())).collect();
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
        found
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::read_setup;

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
}
