//! The operator of a checklist, who actuates switches and cables and watches the arm.

use std::time::Duration;

use anyhow::{Result, bail};
use pb3dp_arm_pa10_protocol::codec::Axis;
use pb3dp_cell::parts::ArmChoice;
use pb3dp_cell::terminal::print_line;
use pb3dp_hal_platform::signals::StopSignals;
use pb3dp_kinematics::JointVector;

use super::super::confirm::{Console, Line};

/// Something that a hand does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// Presses an emergency stop.
    PressEmergencyStop(ArmChoice),
    /// Releases it.
    ReleaseEmergencyStop(ArmChoice),
    /// Pulls the cable between this computer and a gateway.
    PullCable(ArmChoice),
    /// Plugs it in again.
    PlugCable(ArmChoice),
}

/// Something that the operator can see.
#[derive(Clone, Debug, PartialEq)]
pub enum Question {
    /// Whether the joints are where the program says.
    Pose {
        /// Where that is, rad.
        shown_rad: JointVector,
    },
    /// Whether one axis has turned since the operator was ready.
    Turned {
        /// Which.
        axis: Axis,
        /// By how much, rad.
        by_rad: f64,
    },
    /// Whether this arm stopped at once, and stands with its brakes closed.
    Stopped(ArmChoice),
}

/// The operator, who actuates switches and cables and watches the arm.
pub trait Operator {
    /// For the report.
    fn name(&self) -> &'static str;

    /// Whether the moment of an act is that of [`Self::act`].
    fn is_prompt(&self) -> bool;

    /// Says that arms may move, by typing this name.
    ///
    /// # Errors
    /// If something else is typed, or a signal asks to end.
    fn confirm(&mut self, name: &str, signals: &mut StopSignals) -> Result<()>;

    /// Does something at once, while an arm moves.
    ///
    /// # Errors
    /// If it cannot be done.
    fn act(&mut self, act: Act) -> Result<()>;

    /// Is told what comes, does what is asked for, and says when he is ready.
    ///
    /// # Errors
    /// If he does not want to go on, does not answer in time, or a signal asks to end.
    fn ready(&mut self, text: &str, act: Option<Act>, signals: &mut StopSignals) -> Result<()>;

    /// Says yes or no.
    ///
    /// # Errors
    /// If he does not answer in time, or a signal asks to end.
    fn ask(&mut self, question: &Question, signals: &mut StopSignals) -> Result<bool>;
}

/// Somebody at the keyboard.
pub struct Person {
    console: Console,
    patience: Duration,
}

impl Person {
    /// Somebody who has to answer within this time.
    pub fn new(console: Console, patience: Duration) -> Self {
        Self { console, patience }
    }

    fn line(&self, signals: &mut StopSignals) -> Result<String> {
        match self.console.line(Some(self.patience), signals)? {
            Line::Typed(line) => Ok(line.trim().to_lowercase()),
            Line::Ended => bail!("standard input has ended: nobody is there to answer; run it in a terminal"),
            Line::TimedOut => {
                bail!("nobody answered within {:?}; repeat this step, or give more --patience", self.patience)
            }
        }
    }
}

impl Operator for Person {
    fn name(&self) -> &'static str {
        "person"
    }

    fn is_prompt(&self) -> bool {
        false
    }

    fn confirm(&mut self, name: &str, signals: &mut StopSignals) -> Result<()> {
        self.console.typed(name, Some(self.patience), signals)
    }

    fn act(&mut self, act: Act) -> Result<()> {
        Ok(print_line(&format!("NOW: {act}"))?)
    }

    fn ready(&mut self, text: &str, act: Option<Act>, signals: &mut StopSignals) -> Result<()> {
        let act = act.map(|act| format!("{act}. ")).unwrap_or_default();
        self.console.forget();
        print_line(&format!("{act}{text}\nPress Enter when you are ready (or type anything else to end this step):"))?;
        match self.line(signals)?.as_str() {
            "" => Ok(()),
            other => bail!("the operator did not go on: {other:?}"),
        }
    }

    fn ask(&mut self, question: &Question, signals: &mut StopSignals) -> Result<bool> {
        loop {
            self.console.forget();
            print_line(&format!("{question} Type yes or no:"))?;
            match self.line(signals)?.as_str() {
                "yes" | "y" => return Ok(true),
                "no" | "n" => return Ok(false),
                _ => {}
            }
        }
    }
}

impl std::fmt::Display for Act {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::PressEmergencyStop(arm) => write!(f, "Press the emergency stop of the {}", arm.name()),
            Self::ReleaseEmergencyStop(arm) => write!(f, "Release the emergency stop of the {}", arm.name()),
            Self::PullCable(arm) => write!(f, "Pull the cable to the gateway of the {}", arm.name()),
            Self::PlugCable(arm) => write!(f, "Plug the cable to the gateway of the {} in again", arm.name()),
        }
    }
}

impl std::fmt::Display for Question {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Pose { shown_rad } => {
                let angles: Vec<_> = shown_rad.iter().map(|angle| format!("{:.1}", angle.to_degrees())).collect();
                write!(f, "Are the joints, from the base, at {} degrees, with these signs?", angles.join(", "))
            }
            Self::Turned { axis, by_rad } => write!(
                f,
                "Did {axis} alone turn, by {:+.2} degrees (positive as in the robot description), and did the arm not sag?",
                by_rad.to_degrees()
            ),
            Self::Stopped(arm) => {
                write!(f, "Did the {} stop at once, and does it stand with its brakes closed?", arm.name())
            }
        }
    }
}
