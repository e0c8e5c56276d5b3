//! An operator for emulated arms: causes the faults of the emulation, and reads the true joints.

use std::time::Duration;

use anyhow::{Context, Result};
use pb3dp_arm_pa10_emulation::line::mock_server::MockServer;
use pb3dp_arm_pa10_protocol::codec::Signal;
use pb3dp_cell::attended_motion::EndedByPerson;
use pb3dp_cell::parts::ArmChoice;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_kinematics::JointVector;

use super::super::confirm::Console;
use super::limits::REST_RAD_PER_S;
use super::operator::{Act, Operator, Question};

/// Accuracy with which an operator sees a joint, rad.
const OBSERVED_WITHIN_RAD: f64 = 0.01;
/// Time that an emulated thread needs to pull or plug a cable.
const MOMENT: Duration = Duration::from_millis(50);

/// The emulated operator.
pub struct Emulated {
    console: Console,
    patience: Duration,
    arms: Vec<(ArmChoice, MockServer)>,
    /// Joints of the first arm when the operator was last ready, rad.
    before_rad: JointVector,
}

impl Emulated {
    /// The operator of these arms, the tested one first. A person still types the confirmation to begin.
    pub fn new((console, patience): (Console, Duration), arms: Vec<(ArmChoice, MockServer)>) -> Self {
        let before_rad = arms.first().map_or_else(JointVector::zeros, |(_, arm)| arm.report().position_rad);
        Self { console, patience, arms, before_rad }
    }

    fn arm(&self, choice: ArmChoice) -> Result<&MockServer> {
        let found = self.arms.iter().find(|(name, _)| *name == choice);
        found.map(|(_, arm)| arm).with_context(|| format!("the {} is not emulated here", choice.name()))
    }

    fn tested(&self) -> Result<&MockServer> {
        self.arms.first().map(|(_, arm)| arm).context("no emulated arm")
    }
}

impl Operator for Emulated {
    fn name(&self) -> &'static str {
        "emulated"
    }

    fn is_prompt(&self) -> bool {
        true
    }

    fn confirm(&mut self, name: &str, signals: &mut StopSignals) -> Result<()> {
        self.console.typed(name, Some(self.patience), signals)
    }

    fn act(&mut self, act: Act) -> Result<()> {
        match act {
            Act::PressEmergencyStop(choice) => self.arm(choice)?.command_line("e-stop press")?,
            Act::ReleaseEmergencyStop(choice) => self.arm(choice)?.command_line("e-stop release")?,
            Act::PullCable(choice) => self.arm(choice)?.unplug(),
            Act::PlugCable(choice) => self.arm(choice)?.plug(),
            Act::Switch(choice, signal, is_on) => {
                let [on, off] = match signal {
                    Signal::EmergencyStop => ["e-stop press", "e-stop release"],
                    Signal::LimitSwitch => ["limit-switch open", "limit-switch close"],
                    Signal::DeadMan => ["dead-man release", "dead-man hold"],
                    Signal::Power => ["servo-power off", "servo-power on"],
                };
                self.arm(choice)?.command_line(if is_on { on } else { off })?
            }
        }
        Ok(())
    }

    fn goes_on(&mut self) -> Result<(), EndedByPerson> {
        Ok(())
    }

    fn ready(&mut self, text: &str, act: Option<Act>, _signals: &mut StopSignals) -> Result<()> {
        print_line(&format!("emulated operator: {}{text}", act.map(|act| format!("{act}. ")).unwrap_or_default()))?;
        if let Some(act) = act {
            self.act(act)?;
            std::thread::sleep(MOMENT);
        }
        self.before_rad = self.tested()?.report().position_rad;
        Ok(())
    }

    fn ask(&mut self, question: &Question, _signals: &mut StopSignals) -> Result<bool> {
        let yes = match question {
            Question::Pose { shown_rad } => {
                (self.tested()?.report().position_rad - shown_rad).amax() <= OBSERVED_WITHIN_RAD
            }
            Question::Turned { axis, by_rad } => {
                let mut off_rad = self.tested()?.report().position_rad - self.before_rad;
                off_rad[axis.index()] -= by_rad;
                off_rad.amax() <= OBSERVED_WITHIN_RAD
            }
            Question::HasSwitch(_) => true,
            // The emergency stop cuts the servo power.
            Question::Shared { signal, other, .. } => (*signal, *other) == (Signal::Power, Signal::EmergencyStop),
            Question::Stopped(choice) => {
                let arm_report = self.arm(*choice)?.report();
                arm_report.is_braked && arm_report.velocity_rad_per_s.amax() <= REST_RAD_PER_S
            }
        };
        print_line(&format!("{question} emulated operator: {}", if yes { "yes" } else { "no" }))?;
        Ok(yes)
    }
}
